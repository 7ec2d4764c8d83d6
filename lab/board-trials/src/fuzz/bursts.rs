//! Bursts: up to 2,000 lines without a pause, at each output period, while the board does each of its activities. The
//! host reads the replies often, seldom or late. The rules of [`Properties`] must hold, and each output must come. The
//! library is not compared, because the time of a write to flash varies.

use std::collections::BTreeMap;

use host_sim::{error::Error, interrupt};
use serde::Serialize;
use virtual_board::{
    board::Powered,
    device,
    mcu::{LINK, RENDER},
    session::Session,
    world::{Snapshot, World},
};
use zwidth::{device::Device, period::PERIODS};

use super::{
    action::Action,
    campaign::Failure,
    counts::Counts,
    generate::{any, useful},
    oracle::Observed,
    properties::Properties,
    rule,
    run::End,
};
use crate::{
    random::Random,
    threads::{cores, on_threads},
};

/// Position of the wall, in m. The handle starts in front of it.
const WALL_M: f64 = 0.005;
/// Lines that let the board arm with a wall. The hit and the walk take longer than a burst.
const SETUP: &str = "zero\nunlock envelope\nk 2000\nb 10\npush 1\nsettle 3\nwindow 2";
/// Speed of the hand that moves the handle into the wall, in m/s, and the number of samples. It stops 0.2 mm behind the
/// wall's face.
const INTO_WALL: (f64, u64) = (0.052, 1_000);
/// Largest share of a burst's time that `link` may take.
const LINK_MOST: f64 = 0.3;
/// Number of samples from `arm` until the board is armed.
const ARMS: u64 = 3_400;
/// Largest number of lines of a burst.
const MOST: f64 = 2_000.0;
/// Longest time for which the host does not read, in samples.
const SILENT: u64 = 8_000;
/// Number of samples from one reading to the next of a host that reads often, and of one that reads seldom.
const READS: [u64; 2] = [20, 500];
/// First words of the lines that end an activity or change the period.
const ENDS: [&str; 10] =
    ["disarm", "stop", "arm", "period", "zero", "load", "save", "clear", "hit", "walk"];

/// What the board does when the burst begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Doing {
    Off,
    Saving,
    Armed,
    Contact,
    Hit,
    Walk,
}

impl Doing {
    /// A part of the reply to `status` then.
    fn status(self) -> &'static str {
        match self {
            Self::Off | Self::Saving => "ok status off, fault none, idle",
            Self::Armed => "ok status armed, fault none, idle",
            Self::Contact => "in contact",
            Self::Hit => "ok status armed, fault none, hit",
            Self::Walk => "ok status armed, fault none, walk",
        }
    }
}

const DOING: [Doing; 6] =
    [Doing::Off, Doing::Saving, Doing::Armed, Doing::Contact, Doing::Hit, Doing::Walk];

/// Results of the bursts at one output period.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    pub period: u32,
    pub bursts: u64,
    pub lines: u64,
    pub obeyed: u64,
    pub refused: u64,
    /// Number of lines that the board has ignored and counted, because the host read late.
    pub ignored: u64,
    /// Number of replies and reports that had no room, and that the board has counted.
    pub lost: u64,
    /// Number of outputs during the bursts. None is missing.
    pub outputs: u64,
    /// Longest time from one feeding of the watchdog to the next, in ms, in bursts without `save`.
    pub fed_ms: f64,
    /// The same time in bursts with `save`.
    pub fed_saving_ms: f64,
    /// Longest time from a sampling event to the write of the force, in us.
    pub output_us: f64,
    /// Largest fraction of a burst's time that `link` takes, among bursts without `save` of at least 0.1 s.
    pub link: f64,
    /// The same fraction in bursts with `save`, where `link` also waits for the flash.
    pub link_saving: f64,
}

impl Row {
    fn add(&mut self, other: &Self) {
        self.bursts += other.bursts;
        self.lines += other.lines;
        self.obeyed += other.obeyed;
        self.refused += other.refused;
        self.ignored += other.ignored;
        self.lost += other.lost;
        self.outputs += other.outputs;
        self.fed_ms = self.fed_ms.max(other.fed_ms);
        self.fed_saving_ms = self.fed_saving_ms.max(other.fed_saving_ms);
        self.output_us = self.output_us.max(other.output_us);
        self.link = self.link.max(other.link);
        self.link_saving = self.link_saving.max(other.link_saving);
    }
}

/// Sends `count` random bursts at each output period.
///
/// # Errors
/// The board does not start, or the user pressed Ctrl-C.
pub fn bursts(
    session: &Session,
    seed: u64,
    count: u64,
) -> Result<Result<Vec<Row>, Failure>, Error> {
    let jobs = usize::try_from(count).unwrap_or(usize::MAX).saturating_mul(PERIODS.len());
    let work = |host: &mut Host<'_>, job: usize| {
        let (period, number) = (PERIODS[job % PERIODS.len()], (job / PERIODS.len()) as u64);
        let random = Random::of_case(seed, u64::from(period) << 32 | number);
        match host.burst(random, period) {
            Err(End::Interrupted) => Err(Error::Interrupted),
            Err(End::Difference(what)) => Ok(Err(Failure {
                what: format!("period {period}: {what}"),
                session: number,
                after_commands: host.counts.commands,
                after_s: 0.0,
                actions: std::mem::take(&mut host.actions),
            })),
            Ok(row) => Ok(Ok(row)),
        }
    };
    let all = on_threads(jobs, cores(), || Host::boot(session), work)?;
    let mut rows = PERIODS.map(|period| Row { period, ..Row::default() }).to_vec();
    for burst in all {
        match burst {
            Err(failure) => return Ok(Err(failure)),
            Ok(burst) => rows
                .iter_mut()
                .filter(|row| row.period == burst.period)
                .for_each(|row| row.add(&burst)),
        }
    }
    Ok(Ok(rows))
}

/// State of a board and of the rules, and the actions that led to it.
type State = (Snapshot, Properties, Vec<Action>);

/// A host at a board.
struct Host<'a> {
    world: World<'a>,
    device: &'static Device<'static>,
    rules: Properties,
    counts: Counts,
    /// The states from which bursts begin, and the state after the board's start.
    kept: BTreeMap<(u32, Doing), State>,
    start: State,
    /// What was done since the board's start. It can be run again by `--script`.
    actions: Vec<Action>,
    /// Number of outputs of the burst so far, number of samples since the last one, and number of samples of the burst.
    outputs: u64,
    since: u64,
    samples: u64,
}

impl<'a> Host<'a> {
    fn boot(session: &'a Session) -> Result<Self, Error> {
        let scene = &session.scene.scene;
        let rest_m = scene.device.rest_position_m;
        let mut world = World::new(session.board, &session.elf, &session.table, scene, rest_m)
            .map_err(Error::Internal)?;
        let failed = |ended| Error::Internal(format!("the board does not start: {ended:?}"));
        world.run(300).map_err(failed)?;
        world.hold(rest_m, false);
        world.run(300).map_err(failed)?;
        world.replies.clear();
        world.telemetry.clear();
        let rules = Properties::new(session.board.supply_mv).for_late_host();
        Ok(Self {
            start: (world.snapshot(), rules.clone(), vec![Action::Free, Action::Wait(300)]),
            device: device::built_in(session.board),
            world,
            rules,
            counts: Counts::default(),
            kept: BTreeMap::new(),
            actions: Vec::new(),
            outputs: 0,
            since: 0,
            samples: 0,
        })
    }

    /// Brings the board to the state from which a burst begins.
    fn begin(&mut self, period: u32, doing: Doing) -> Result<(), End> {
        if let Some(kept) = self.kept.get(&(period, doing)).cloned() {
            self.restore(&kept);
            return Ok(());
        }
        self.restore(&self.start.clone());
        self.act(&format!("{SETUP}\nwall {WALL_M}\nperiod {period}"))?;
        if !matches!(doing, Doing::Off | Doing::Saving) {
            self.act("arm")?;
            self.wait(ARMS)?;
        }
        match doing {
            Doing::Off | Doing::Saving | Doing::Armed => {}
            Doing::Contact => {
                let (m_per_s, samples) = INTO_WALL;
                self.actions.push(Action::Lead(m_per_s, samples));
                self.world.lead(m_per_s);
                (0..samples).try_for_each(|_| self.pass(10, true))?;
                self.world.lead(0.0);
                self.wait(200)?;
            }
            Doing::Hit | Doing::Walk => {
                self.act(if doing == Doing::Hit { "hit" } else { "walk" })?;
                self.wait(1_500)?;
            }
        }
        let status = self.world.ask("status")?;
        rule(status.contains(doing.status()), || format!("{doing:?}, but {status}"))
            .map_err(End::Difference)?;
        let kept = (self.world.snapshot(), self.rules.clone(), self.actions.clone());
        self.kept.insert((period, doing), kept);
        Ok(())
    }

    fn restore(&mut self, (world, rules, actions): &State) {
        self.world.restore(world);
        self.rules = rules.clone();
        self.actions.clone_from(actions);
        self.outputs = self.output_count();
        self.since = 0;
    }

    fn act(&mut self, text: &str) -> Result<(), End> {
        self.actions.push(Action::Say(text.into()));
        self.send(text, 10, READS[0], 0)
    }

    fn wait(&mut self, samples: u64) -> Result<(), End> {
        self.actions.push(Action::Wait(samples));
        (0..samples).try_for_each(|n| self.pass(10, n % READS[0] == 0))
    }

    /// One burst. The host reads every `reads` samples, but not within the first `silent` samples.
    fn burst(&mut self, mut random: Random, period: u32) -> Result<Row, End> {
        let random = &mut random;
        let doing = random.of(&DOING);
        self.begin(period, doing)?;
        self.wait(random.below(500))?;
        let lines = lines(random, self.device, doing);
        let has = |words: &[&str]| {
            let is = |line: &String| words.iter().any(|word| line.to_lowercase().contains(word));
            lines.iter().any(is)
        };
        let has_period = has(&["period", "load"]);
        let longest =
            if has_period { u64::from(PERIODS[PERIODS.len() - 1]) } else { period.into() };
        let reads = random.of(&READS);
        let silent = if random.once_in(3) { random.below(SILENT) } else { 0 };
        self.actions.push(Action::Say(lines.join("\n")));

        self.world.powered.mcu.watch_mut().clear();
        (self.outputs, self.since, self.samples, self.counts) = (0, 0, 0, Counts::default());
        let begun = self.world.powered.mcu.now();
        self.send(&lines.join("\n"), longest, reads, silent).map_err(|end| match end {
            End::Difference(what) => End::Difference(format!(
                "{doing:?}, {} lines, read every {reads} samples after {silent}: {what}",
                lines.len()
            )),
            End::Interrupted => end,
        })?;
        let saves = has(&["save"]);
        let due = if saves { 0 } else { self.samples / longest };
        rule(self.output_count() + 1 >= due, || {
            format!("{} outputs, {due} are due", self.output_count())
        })
        .map_err(End::Difference)?;
        let mcu = &self.world.powered.mcu;
        let (watch, hz) = (mcu.watch(), mcu.core_hz() as f64);
        let took_s = (mcu.now() - begun) as f64 / hz;
        let fed_ms = watch.longest_unfed as f64 / hz * 1e3;
        let link = if took_s < 0.1 { 0.0 } else { watch.tasks[&LINK].total as f64 / hz / took_s };
        rule(saves || link <= LINK_MOST, || format!("`link` takes {:.1} %", link * 100.0))
            .map_err(End::Difference)?;
        Ok(Row {
            period,
            bursts: 1,
            lines: self.counts.commands,
            obeyed: self.counts.obeyed,
            refused: self.counts.refused,
            ignored: self.counts.ignored,
            lost: self.counts.lost,
            outputs: self.output_count(),
            fed_ms: if saves { 0.0 } else { fed_ms },
            fed_saving_ms: if saves { fed_ms } else { 0.0 },
            output_us: watch.commands.most as f64 / hz * 1e6,
            link: if saves { 0.0 } else { link },
            link_saving: if saves { link } else { 0.0 },
        })
    }

    /// Sends the lines and waits until each has its reply, or is counted by the board. If the last replies are missing,
    /// one more command lets the board say so.
    fn send(&mut self, text: &str, longest: u64, reads: u64, silent: u64) -> Result<(), End> {
        let mut bytes = Vec::new();
        self.ask(text, &mut bytes);
        let (mut at, mut n) = (0, 0);
        while at < bytes.len() || !(self.rules.is_answered() || self.rules.is_over()) {
            let Powered { mcu, rtt, .. } = &mut self.world.powered;
            at += rtt.write(mcu, 0, &bytes[at..]);
            n += 1;
            if n > silent {
                self.rules.sample();
            }
            self.pass(longest, n > silent && n % reads == 0)?;
            if at == bytes.len() && self.rules.is_silent() {
                self.ask("version", &mut bytes);
            }
            if n.is_multiple_of(64) && interrupt::is_requested() {
                return Err(End::Interrupted);
            }
        }
        Ok(())
    }

    fn ask(&mut self, text: &str, bytes: &mut Vec<u8>) {
        for line in text.split('\n') {
            self.counts.commands += 1;
            self.rules.ask(line);
        }
        bytes.extend(text.bytes().chain([b'\n']));
    }

    /// Runs one sample. `longest` is the largest number of samples from one output to the next.
    fn pass(&mut self, longest: u64, reads: bool) -> Result<(), End> {
        self.world.sample()?;
        self.samples += 1;
        let saves = self.rules.saves();
        let outputs = self.output_count();
        self.since = if outputs == self.outputs { self.since + 1 } else { 0 };
        self.outputs = outputs;
        // At the end of the sample in which it is due, an output may still be running.
        rule(self.since <= longest || saves, || format!("no output for {} samples", self.since))
            .and_then(|()| {
                if !reads {
                    let enabled = self.world.powered.amplifier.is_enabled();
                    return self.rules.outside(&self.world, enabled);
                }
                self.world.probe().map_err(|ended| format!("the program ended: {ended:?}"))?;
                self.world.lines.clear();
                let observed = Observed {
                    counts: Vec::new(),
                    entries: Vec::new(),
                    replies: std::mem::take(&mut self.world.replies).into_bytes(),
                    telemetry: std::mem::take(&mut self.world.telemetry),
                    saves,
                };
                self.rules.check(&self.world, &observed, &mut self.counts)
            })
            .map_err(End::Difference)
    }

    fn output_count(&self) -> u64 {
        self.world.powered.mcu.watch().tasks.get(&RENDER).map_or(0, |cycles| cycles.runs)
    }
}

/// The lines of a burst: all kinds of lines; none that saves; none that ends what the board does; or one line again and
/// again.
fn lines(random: &mut Random, device: &Device<'_>, doing: Doing) -> Vec<String> {
    let count = MOST.powf(random.between(0.0, 1.0)).round();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "up to 2,000")]
    let count = count as usize;
    let kind = random.below(4);
    let mut one = || match random.below(20) {
        0 => "get".to_owned(),
        1 => random.of(&["arm", "disarm", "stop", "help", "faults"]).to_owned(),
        // Shorter than the channel, because the library cannot follow a longer line when the script is run again.
        2 => "x".repeat(usize::try_from(random.below(200)).unwrap_or_default() + 1),
        3..8 => any(random),
        _ => useful(random, device, WALL_M),
    };
    let mut lines = Vec::new();
    if doing == Doing::Saving {
        lines.push("save".to_owned());
    }
    while lines.len() < count.max(1) {
        let line = one();
        let is = |word: &&str| line.to_lowercase().contains(word);
        let left_out = match kind {
            0 => line.trim().is_empty(),
            1 => line.trim().is_empty() || is(&"save"),
            _ => line.trim().is_empty() || ENDS.iter().any(is),
        };
        if left_out {
            continue;
        }
        let times = if kind == 3 { count } else { 1 };
        lines.extend(std::iter::repeat_n(line, times));
    }
    lines
}
