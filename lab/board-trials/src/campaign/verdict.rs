//! Measures the result of a fault.

use serde::Serialize;
use virtual_board::{
    board::Powered,
    world::{Seen, World},
};
use zwidth::{
    safety::{Fault, FaultRecord},
    telemetry::{Decoder, Flags},
};

use super::{kept::BACKUP, row::SOON_S};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// The force was right at all times.
    NoEffect,
    /// The force was wrong by at most 5 % of full scale, or for at most 2 ms.
    Bounded,
    /// The force was off within the allowed time.
    OffInTime,
    /// The force was off, but later than allowed.
    OffLate,
    /// A wrong force stayed on.
    Unnoticed,
    /// The force stayed on, right or wrong, and `disarm` did not switch it off.
    Unheard,
}

pub const CLASSES: [Class; 6] = [
    Class::NoEffect,
    Class::Bounded,
    Class::OffInTime,
    Class::OffLate,
    Class::Unnoticed,
    Class::Unheard,
];

impl Class {
    pub const fn text(self) -> &'static str {
        match self {
            Self::NoEffect => "no effect",
            Self::Bounded => "bounded",
            Self::OffInTime => "off in time",
            Self::OffLate => "off late",
            Self::Unnoticed => "unnoticed",
            Self::Unheard => "disarm unheard",
        }
    }
}

/// Result of one fault. In JSON, each row has these fields.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Verdict {
    pub class: Class,
    /// Time from the fault until enable is inactive, in s.
    pub off_s: Option<f64>,
    /// Total time for which the force was wrong or too old, in s.
    #[serde(skip)]
    pub wrong_s: f64,
    /// Speed that the handle gains until the force is off, in m/s. In free motion, this is the increase of speed since
    /// the fault while no hand holds the handle. In contact, this is the speed of an imagined handle, which is released
    /// at the fault. The wrong force drives this handle over at most 5 mm.
    pub speed_m_per_s: f64,
    /// Travel of the handle until the force is off, in m.
    pub travel_m: f64,
    /// Code of the fault that the board reports.
    pub code: Option<u8>,
    /// Whether the force was on with a latched fault, or came back without a command.
    #[serde(skip)]
    pub on_in_fault: bool,
}

impl Verdict {
    pub const fn of(class: Class) -> Self {
        Self {
            class,
            off_s: None,
            wrong_s: 0.0,
            speed_m_per_s: 0.0,
            travel_m: 0.0,
            code: None,
            on_in_fault: false,
        }
    }

    /// The reason why this result is a failure, or `None` for a good result. `reason` says why the fault cannot be
    /// found, if this is so.
    pub fn wrong(&self, reason: Option<&str>) -> Option<String> {
        let fast = self.off_s.is_some_and(|off_s| off_s <= SOON_S);
        if self.class >= Class::OffLate && reason.is_none() {
            Some(self.class.text().to_owned())
        } else if self.on_in_fault {
            Some("on in a fault".to_owned())
        } else if fast && self.speed_m_per_s > GAIN_MOST_M_PER_S {
            Some(format!("off within 3 ms, and faster by {:.3} m/s", self.speed_m_per_s))
        } else {
            None
        }
    }
}

/// Settings of a measurement. They say how a fault is watched, its time limit, and what the handle does.
#[derive(Clone, Copy)]
pub struct Measure<'a> {
    /// Cycle of the fault.
    pub begun: u64,
    /// Number of samples for which the board is watched if the force stays on.
    pub samples: u64,
    /// Whether the watch ends after half of the samples, provided that the force is right then.
    pub half_if_right: bool,
    /// The motor's force without the fault.
    pub reference: &'a [Seen],
    /// Output period, in samples.
    pub period: u64,
    /// Whether the fault code is read from the backup RAM, since the damaged program may not report it.
    pub from_memory: bool,
    /// Time within which the force must be off, in s. For a named fault it is counted from the fault. For a flip it is
    /// counted only while the force is wrong or too old.
    pub allowed_s: f64,
    /// Whether the force is treated as wrong from the fault on, even while it is still right.
    pub from_fault: bool,
    /// Whether no hand holds the handle.
    pub free: bool,
    /// Full-scale force divided by the handle's mass, in m/s^2.
    pub full_m_per_s2: f64,
}

/// Largest difference of the force that is treated as zero, as a fraction of full scale. Such differences occur because
/// the simulation runs in whole samples.
const SAME: f64 = 0.01;
/// Largest difference of the force that is treated as small, as a fraction of full scale.
const SMALL: f64 = 0.05;
/// Longest time of a difference above [`SMALL`] that is still treated as bounded, in s.
pub(super) const SHORT_S: f64 = 2e-3;
/// Number of samples by which a force may be kept longer than the output period. After that the force is too old. One
/// sample is for the simulation in whole samples, the other for the time of `render`.
const OLD: u64 = 2;
const LET_GO_M: f64 = 5e-3;
const SAMPLE_S: f64 = 1e-4;

/// Largest allowed gain of speed since the fault, if the force is off within [`SOON_S`], in m/s.
const GAIN_MOST_M_PER_S: f64 = 0.1;

/// Number of samples for which the board is watched after the force is off. If the board reports no fault, it is
/// watched for up to `TOLD` samples.
const AFTER: u64 = 60;
const TOLD: u64 = 2_000;
/// Number of samples for which a board with a damaged program is watched after the force is off. This covers an output
/// period and the time of the output watchdog.
const AFTER_FROM_MEMORY: u64 = 30;

/// Number of samples within which `disarm` must switch the force off, and how often a person sends it.
const HEARD: usize = 1_000;
const DISARMS: usize = 2;

/// Sends `disarm`. Returns whether the force goes off.
pub fn hears_disarm(world: &mut World<'_>) -> bool {
    (0..DISARMS).any(|_| {
        let mut rest = &b"disarm\n"[..];
        (0..HEARD).any(|_| {
            let Powered { mcu, rtt, .. } = &mut world.powered;
            rest = &rest[rtt.write(mcu, 0, rest)..];
            // As in `watch`, only the force counts.
            let _ = world.sample();
            !world.powered.amplifier.is_enabled()
        })
    })
}

/// Whether the force of the last 10 ms equals the force in `right`.
fn is_right(world: &World<'_>, right: &[Seen]) -> bool {
    let seen = world.seen.as_deref().unwrap_or_default();
    let last = seen.iter().zip(right).skip(seen.len().saturating_sub(100));
    !right.is_empty()
        && last.into_iter().all(|(now, right)| (now.force - right.force).abs() <= SAME)
}

/// The fault code in the backup RAM. `None` for the code that means a reset while armed, because every such reset
/// stores this code.
fn kept_code(world: &mut World<'_>) -> Option<u8> {
    let words = std::array::from_fn(|n| {
        world.powered.mcu.peek(BACKUP + 4 * u32::try_from(n).unwrap_or_default())
    });
    let record = FaultRecord::from_words(&words)?;
    (record.fault != Fault::ResetWhileArmed).then(|| record.fault.code())
}

#[derive(Default)]
struct Watched {
    off_at: Option<u64>,
    back: bool,
    decoder: Decoder,
    code: Option<u8>,
    on_with_code: bool,
}

impl Measure<'_> {
    /// Runs until the force is off and the board has reported the fault, or until the watch ends.
    pub fn verdict(&self, world: &mut World<'_>) -> Verdict {
        let watched = self.watch(world);
        let seen = world.seen.take().unwrap_or_default();
        self.judge(&watched, &seen, world.powered.board.cycles_per_sample())
    }

    fn watch(&self, world: &mut World<'_>) -> Watched {
        let &Self { begun, samples, from_memory, .. } = self;
        let mut watched = Watched::default();
        let mut after = 0;
        for n in 1..=samples + TOLD {
            // An unreadable log or a halted core does not end the measurement, since only the force counts.
            let _ = world.sample();
            if n % 50 == 0 {
                watched.listen(world, from_memory);
            }
            let enabled = world.powered.amplifier.is_enabled();
            match watched.off_at {
                None if !enabled => {
                    let off = world.powered.amplifier.changes().disabled_at;
                    watched.off_at = Some(off.filter(|&at| at >= begun).unwrap_or(begun));
                }
                None if n >= samples
                    || n == samples / 2
                        && self.half_if_right
                        && is_right(world, self.reference) =>
                {
                    break;
                }
                None => {}
                Some(_) if enabled => {
                    watched.listen(world, from_memory);
                    // There is no fault code yet. So only an output was missing, and the force may come back.
                    if watched.code.is_none() {
                        (watched.off_at, after) = (None, 0);
                    } else {
                        watched.back = true;
                        break;
                    }
                }
                Some(_) => {
                    after += 1;
                    let least = if from_memory { AFTER_FROM_MEMORY } else { AFTER };
                    if after >= least && (watched.code.is_some() || after >= TOLD) {
                        break;
                    }
                }
            }
        }
        watched.listen(world, from_memory);
        watched
    }

    /// Compares the force with the reference.
    fn judge(&self, watched: &Watched, seen: &[Seen], cycles_per_sample: u64) -> Verdict {
        let hz = cycles_per_sample as f64 / SAMPLE_S;
        let (mut larger, mut other, mut stale) = (0u32, false, 0u32);
        let (mut speed, mut travel, mut most) = (0.0f64, 0.0f64, 0.0f64);
        let end = watched.off_at.unwrap_or(u64::MAX);
        let fault = seen.iter().rposition(|now| now.at <= self.begun).unwrap_or_default();
        for (n, now) in seen.iter().enumerate().skip(1) {
            if n <= fault || seen[n - 1].at > end {
                continue;
            }
            let away = self.reference.get(n).map_or(0.0, |right| (now.force - right.force).abs());
            let on = now.enabled || now.force != 0.0;
            let before_off = now.at <= end;
            let wrong = on && before_off && away > SMALL;
            let old = on
                && now.at.saturating_sub(now.written_at) > (self.period + OLD) * cycles_per_sample;
            other |= on && before_off && away > SAME;
            larger += u32::from(wrong);
            stale += u32::from(old || wrong);
            if self.free {
                let moved =
                    |n: usize| (seen[n].position_m - seen[n - 1].position_m).abs() / SAMPLE_S;
                if !now.held {
                    most = most.max(moved(n) - moved(fault.max(1)));
                }
                travel = now.position_m - seen[fault].position_m;
            } else if travel.abs() < LET_GO_M {
                if self.from_fault || wrong || old {
                    speed += now.force * self.full_m_per_s2 * SAMPLE_S;
                }
                travel += speed * SAMPLE_S;
                most = most.max(speed.abs());
            }
        }
        let off_s = watched.off_at.map(|at| (at - self.begun.min(at)) as f64 / hz);
        let class = match off_s {
            Some(off_s) => {
                let lasted_s = if self.from_fault { off_s } else { f64::from(stale) * SAMPLE_S };
                if lasted_s <= self.allowed_s { Class::OffInTime } else { Class::OffLate }
            }
            None if f64::from(larger) * SAMPLE_S > SHORT_S => Class::Unnoticed,
            None if other || stale > 0 => Class::Bounded,
            None => Class::NoEffect,
        };
        let moved = class != Class::NoEffect;
        Verdict {
            class,
            off_s,
            wrong_s: f64::from(stale) * SAMPLE_S,
            speed_m_per_s: if moved { most } else { 0.0 },
            travel_m: if moved { travel.abs() } else { 0.0 },
            code: watched.code,
            on_in_fault: watched.back || watched.off_at.is_none() && watched.on_with_code,
        }
    }
}

impl Watched {
    fn listen(&mut self, world: &mut World<'_>, from_memory: bool) {
        let _ = world.probe();
        if from_memory && self.off_at.is_some() {
            self.code = self.code.or(kept_code(world));
        }
        for byte in std::mem::take(&mut world.telemetry) {
            if let Some(frame) = self.decoder.push(byte)
                && !frame.record.flags.contains(Flags::REPLAY)
            {
                if frame.record.fault != 0 {
                    self.code.get_or_insert(frame.record.fault);
                }
                self.on_with_code =
                    frame.record.fault != 0 && frame.record.flags.contains(Flags::ON);
            }
        }
        world.lines.clear();
        world.replies.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If the force is off within 3 ms of a fault, the handle must not gain more than 0.1 m/s. If the force is off
    /// later, the handle may gain more.
    #[test]
    fn what_is_off_soon_must_not_have_gained_speed() {
        let off = |off_s, speed_m_per_s| Verdict {
            off_s: Some(off_s),
            speed_m_per_s,
            ..Verdict::of(Class::OffInTime)
        };
        assert_eq!(off(2.9e-3, 0.1).wrong(None), None);
        assert_eq!(off(50e-3, 0.16).wrong(None), None);
        let wrong = off(2.9e-3, 0.101).wrong(None);
        assert_eq!(wrong.as_deref(), Some("off within 3 ms, and faster by 0.101 m/s"));
        assert_eq!(off(2.9e-3, 0.101).wrong(Some("a reason is for what stays")), wrong);
    }

    #[test]
    fn what_stays_needs_a_reason_and_force_in_a_fault_has_none() {
        for class in [Class::OffLate, Class::Unnoticed, Class::Unheard] {
            assert_eq!(Verdict::of(class).wrong(None).as_deref(), Some(class.text()));
            assert_eq!(Verdict::of(class).wrong(Some("it looks the same")), None);
        }
        let on = Verdict { on_in_fault: true, ..Verdict::of(Class::Bounded) };
        assert_eq!(on.wrong(Some("it looks the same")).as_deref(), Some("on in a fault"));
    }
}
