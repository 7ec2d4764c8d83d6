//! Lines without a pause at any output period. The model knows outputs each millisecond only, so here rules alone hold:
//! no reset, a watchdog that is fed, outputs that come, and a reply to each line.

use zwidth::period::SAMPLES_PER_MS;

use super::run::{End, Run, differs};
use crate::{board::Powered, mcu::RENDER};

/// Longest time from one feeding of the watchdog to the next, ms.
const FED_MS: f64 = 20.0;
/// Samples in which a line has to be answered, in the mean.
const ANSWERED: u64 = 200;

/// Whether a line has one reply and says nothing later, leaves period and flash as they are, and is not blank.
pub(super) fn is_answered_once(line: &str) -> bool {
    let word = line.split_whitespace().next().unwrap_or_default().to_lowercase();
    let others =
        ["hit", "walk", "calibrate", "pulses", "selftest", "save", "load", "period", "alive"];
    !word.is_empty() && !others.contains(&word.as_str())
}

/// So many replies.
fn replies(text: &str) -> usize {
    text.lines().filter(|line| line.starts_with("ok ") || line.starts_with("error: ")).count()
}

impl Run<'_> {
    pub(super) fn flood(&mut self, period: u32, text: &str) -> Result<(), End> {
        self.answered()?;
        let lines: Vec<&str> = text.lines().filter(|line| is_answered_once(line)).collect();
        // Every part of a session is a session: it may stand anywhere.
        for line in ["stop", "disarm", &format!("period {period}")] {
            self.world.ask(line)?;
        }
        self.world.run(100)?;
        self.world.replies.clear();
        let mcu = &mut self.world.powered.mcu;
        mcu.watch_mut().clear();
        let (resets, hz) = (mcu.resets(), mcu.core_hz());
        let bytes = lines.iter().map(|line| format!("{line}\n")).collect::<String>().into_bytes();
        let (mut rest, mut samples) = (&bytes[..], 0);
        while !rest.is_empty() || replies(&self.world.replies) < lines.len() {
            let Powered { mcu, rtt, .. } = &mut self.world.powered;
            rest = &rest[rtt.write(mcu, 0, rest)..];
            self.world.run(SAMPLES_PER_MS.into())?;
            samples += u64::from(SAMPLES_PER_MS);
            if samples > ANSWERED * (1 + lines.len() as u64) {
                break;
            }
        }
        let mcu = &self.world.powered.mcu;
        let watch = mcu.watch();
        #[expect(clippy::cast_precision_loss, reason = "for people")]
        let fed_ms = watch.longest_unfed as f64 / hz as f64 * 1e3;
        let outputs = watch.tasks.get(&RENDER).map_or(0, |task| task.runs);
        let expected = samples / u64::from(period);
        let said = replies(&self.world.replies);
        if mcu.resets() != resets {
            return differs("a flood of lines resets the board");
        }
        if fed_ms > FED_MS {
            return differs(format!(
                "in a flood of lines the watchdog is fed after {fed_ms:.1} ms"
            ));
        }
        if outputs != expected {
            return differs(format!("a flood of lines leaves {outputs} outputs of {expected}"));
        }
        if said != lines.len() {
            return differs(format!("{said} replies to a flood of {} lines", lines.len()));
        }
        self.mind.counts.floods += 1;
        self.world.powered.mcu.take_counter_readings();
        self.restart(true)
    }
}
