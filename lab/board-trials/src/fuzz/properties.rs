//! Rules that do not depend on the library, since the library could be wrong too. The rules check the board's pins,
//! registers, resets, replies and frames of telemetry.

use virtual_board::{board::Force as Wired, world::World};
use zwidth::{
    console::{Unread, is_answer},
    telemetry::{Decoder, Flags, Frame},
    units::Force,
};

use super::{counts::Counts, oracle::Observed, rule};

/// Longest time from one feeding of the watchdog to the next, in ms.
const FED_MS: u64 = 20;
/// Number of samples within which a line must be answered. The time includes the answers to earlier lines, and an erase
/// of flash.
const ANSWER: u64 = 3_000;
const LINE: u64 = 200;
const SAVED: u64 = 25_000;
/// Highest voltage that is treated as a low supply, in mV. Sessions set no voltage between `LOW_MV` and the lowest
/// normal supply of the board.
const LOW_MV: u32 = 2_800;

/// What the rules remember from one check to the next.
#[derive(Clone, Debug, Default)]
pub struct Properties {
    /// Number of lines without a reply. `waited` is the number of samples since the first of these lines.
    asked: u64,
    waited: u64,
    /// Whether one of the lines without a reply is `arm`. `saves` tells whether one of them is `save`.
    arms: bool,
    saves: bool,
    /// Whether the board has obeyed `arm`, and has obeyed no `disarm` since then.
    armed: bool,
    pub stop_open: bool,
    pub supply_mv: u32,
    /// Number of samples since the supply fell.
    low_for: u64,
    resets: u64,
    decoder: Decoder,
    /// Whether the host reads late. Frames may be missing then, and the board may ignore lines.
    is_late: bool,
    /// Number of lines that the board could not send to a host that reads late.
    lost: u64,
    sequence: Option<u32>,
    line: String,
    pub frame: Option<Frame>,
}

impl Properties {
    pub fn new(supply_mv: u32) -> Self {
        Self { supply_mv, ..Self::default() }
    }

    /// The rules for a host that reads late.
    pub fn for_late_host(self) -> Self {
        Self { is_late: true, ..self }
    }

    /// Remembers that a line was typed and needs a reply.
    pub fn ask(&mut self, line: &str) {
        let word = line.split_whitespace().next().unwrap_or_default();
        if self.asked == 0 {
            self.waited = 0;
        }
        self.asked += 1;
        self.arms |= word.eq_ignore_ascii_case("arm");
        self.saves |= word.eq_ignore_ascii_case("save");
    }

    /// Remembers that the session has restarted the board.
    pub fn reset(&mut self) {
        let Self { stop_open, supply_mv, resets, .. } = *self;
        *self = Self { stop_open, resets: resets + 1, ..Self::new(supply_mv) };
    }

    pub fn sample(&mut self) {
        self.waited += 1;
        self.low_for = if self.is_supply_low() { self.low_for + 1 } else { 0 };
    }

    pub fn is_supply_low(&self) -> bool {
        self.supply_mv <= LOW_MV
    }

    /// Whether every line has a reply.
    pub fn is_answered(&self) -> bool {
        self.asked == 0
    }

    /// Whether the lines without a reply are at most as many as the lost lines, and no further reply comes. If so,
    /// forgets them.
    pub fn is_over(&mut self) -> bool {
        let patience = if self.saves { SAVED } else { 3 * LINE };
        let over = self.asked <= self.lost && self.waited > patience;
        if over {
            (self.asked, self.lost, self.arms, self.saves) = (0, 0, false, false);
        }
        over
    }

    /// Whether all lines may have been handled, and the replies to the last of them are lost. The next reply tells.
    pub fn is_silent(&self) -> bool {
        self.asked > self.lost && self.waited == 3 * LINE
    }

    /// Whether flash may be busy with a save.
    pub fn saves(&self) -> bool {
        self.saves
    }

    /// Checks the board's new output and its present state.
    pub fn check(
        &mut self,
        world: &World<'_>,
        observed: &Observed,
        counts: &mut Counts,
    ) -> Result<(), String> {
        let enabled = world.powered.amplifier.is_enabled();
        self.line.push_str(&String::from_utf8_lossy(&observed.replies));
        while let Some((line, rest)) = self.line.split_once('\n') {
            let (line, rest) = (line.to_owned(), rest.to_owned());
            self.line = rest;
            self.reply(&line, enabled, counts)?;
        }
        for byte in &observed.telemetry {
            if let Some(newest) = self.decoder.push(*byte) {
                self.frame(newest, enabled, counts)?;
            }
        }
        rule(self.decoder.garbage == 0, || "telemetry has bytes of no frame".into())?;
        self.outside(world, enabled)
    }

    /// Checks pins, registers and resets. In contrast to [`check`](Self::check), the board's replies are not needed.
    ///
    /// # Errors
    /// A rule is broken.
    pub fn outside(&self, world: &World<'_>, enabled: bool) -> Result<(), String> {
        let mcu = &world.powered.mcu;
        rule(mcu.resets() == self.resets, || "the board has reset itself".into())?;
        let off =
            |holds: bool, why: &str| rule(!enabled || holds, || format!("enable is active {why}"));
        off(!self.stop_open, "with the stop open")?;
        off(self.low_for <= 1, "with a low supply")?;
        off(self.armed || self.arms && self.asked > 0, "without arm")?;
        let most = match world.powered.board.wiring.force {
            Wired::Dac { .. } => 2047,
            Wired::Pwm { .. } => 4200,
        };
        let code = output_code(world);
        rule(!enabled || code.abs() <= most, || {
            format!("the output is {code} codes from zero, beyond full scale")
        })?;
        let fed = mcu.watch().longest_unfed * 1000 / mcu.core_hz();
        rule(fed <= FED_MS || self.saves, || format!("the watchdog was fed after {fed} ms"))?;
        let patience = ANSWER + LINE * self.asked + if self.saves { SAVED } else { 0 };
        rule(self.asked == 0 || self.waited <= patience, || {
            format!("{} lines are not answered", self.asked)
        })
    }

    fn reply(&mut self, line: &str, enabled: bool, counts: &mut Counts) -> Result<(), String> {
        if let Ok(Unread { ignored, lost }) = line.parse() {
            let [ignored, lost] = [ignored, lost].map(u64::from);
            rule(self.is_late && ignored <= self.asked, || line.into())?;
            self.asked -= ignored;
            self.lost += lost;
            counts.ignored += ignored;
            counts.lost += lost;
        }
        if !is_answer(line) || self.asked == 0 {
            return Ok(()); // the board sends these lines by itself
        }
        self.waited = 0;
        self.asked -= 1;
        let count = if line.starts_with("ok ") { &mut counts.obeyed } else { &mut counts.refused };
        *count += 1;
        match line {
            "ok arm" => self.armed = true,
            "ok disarm" => {
                self.armed = false;
                rule(!enabled || self.arms, || {
                    "disarm is answered before the force is off".into()
                })?;
            }
            _ => {}
        }
        if self.asked == 0 {
            (self.arms, self.saves) = (false, false);
        }
        Ok(())
    }

    fn frame(&mut self, newest: Frame, enabled: bool, counts: &mut Counts) -> Result<(), String> {
        rule(self.is_late || self.sequence.is_none_or(|next| next == newest.sequence), || {
            format!("a frame is missing before sample {}", newest.record.sample)
        })?;
        self.sequence = Some(newest.sequence.wrapping_add(1));
        let outputs: Vec<Frame> = self.decoder.outputs(newest).collect();
        for Frame { record, .. } in &outputs {
            let is = |flag| record.flags.contains(flag);
            if is(Flags::REPLAY) {
                continue;
            }
            let at = record.sample;
            let last = self.frame.map(|frame| frame.record);
            rule(last.is_none_or(|last| last.sample < at), || format!("sample {at} comes late"))?;
            let may_be_on = record.fault == 0 && is(Flags::STOP_CLOSED);
            rule(!is(Flags::ON) || may_be_on, || {
                format!("on at sample {at} with a fault or the stop open")
            })?;
            let is_told = is(Flags::FAULT) == (record.fault != 0);
            rule((!is(Flags::ARMED) || is(Flags::ON)) && is_told, || {
                format!("flags {:?} at sample {at}", record.flags)
            })?;
            rule(is(Flags::ON) || record.force == Force::ZERO, || {
                format!("a force at sample {at} while it is off")
            })?;
            let before = last.map_or(0, |last| last.fault);
            counts.faults += u64::from(record.fault != before && record.fault != 0);
            counts.armed += u64::from(is(Flags::ARMED));
            counts.forces += u64::from(record.force != Force::ZERO);
            self.frame = Some(Frame { record: *record, ..newest });
        }
        let is_now = enabled && !newest.record.flags.contains(Flags::REPLAY);
        rule(newest.record.fault == 0 || !is_now, || {
            format!("enable is active with fault {}", newest.record.fault)
        })
    }
}

/// The output code of the hardware. It is 0 at zero force.
pub fn output_code(world: &World<'_>) -> i32 {
    let [magnitude, sign, dac] = world.powered.mcu.force_registers().map(u32::cast_signed);
    match world.powered.board.wiring.force {
        Wired::Dac { .. } => dac - 2048,
        Wired::Pwm { .. } if sign == 0 => magnitude,
        Wired::Pwm { .. } => -magnitude,
    }
}
