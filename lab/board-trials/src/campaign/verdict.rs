//! What came of a fault.

use serde::Serialize;
use virtual_board::world::{Seen, World};
use zwidth::{
    safety::{Fault, FaultRecord},
    telemetry::{Decoder, Flags},
};

use super::{kept::BACKUP, row::SOON_S};

/// How a fault ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// The force was what it should be, all the time.
    NoEffect,
    /// It was not, by 5 % of full scale at most, or for 2 ms at most.
    Bounded,
    /// Off within the time that is allowed.
    OffInTime,
    /// Off, but later than that.
    OffLate,
    /// A wrong force stayed on.
    Unnoticed,
}

pub const CLASSES: [Class; 5] =
    [Class::NoEffect, Class::Bounded, Class::OffInTime, Class::OffLate, Class::Unnoticed];

impl Class {
    pub const fn text(self) -> &'static str {
        match self {
            Self::NoEffect => "no effect",
            Self::Bounded => "bounded",
            Self::OffInTime => "off in time",
            Self::OffLate => "off late",
            Self::Unnoticed => "unnoticed",
        }
    }
}

/// What came of one fault; JSON has the columns of a row.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Verdict {
    pub class: Class,
    /// From the fault to enable inactive, s.
    pub off_s: Option<f64>,
    /// For which the force was wrong or old until then, s.
    #[serde(skip)]
    pub wrong_s: f64,
    /// What the handle gets until then, m/s: in free motion more than its speed at the fault, while no hand holds it; in
    /// contact that of a handle that is let go at the fault, by the force that should not be there, over 5 mm at most.
    pub speed_m_per_s: f64,
    /// Travel of the handle until then, m.
    pub travel_m: f64,
    /// Code of the fault that the board tells.
    pub code: Option<u8>,
    /// Force is on, and a fault is latched; or it came back by itself.
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

    /// Why it must not be, if it must not; `reason`: why it cannot be found.
    pub fn wrong(&self, reason: Option<&str>) -> Option<String> {
        let fast = self.off_s.is_some_and(|off_s| off_s <= SOON_S);
        if matches!(self.class, Class::OffLate | Class::Unnoticed) && reason.is_none() {
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

/// How a fault is watched, what counts as time, and for which handle.
#[derive(Clone, Copy)]
pub struct Measure<'a> {
    /// Cycle of the fault.
    pub begun: u64,
    /// Samples for which it is watched if it is not off before.
    pub samples: u64,
    /// Half of them do where the force is right then.
    pub half_if_right: bool,
    /// What the motor does without the fault.
    pub reference: &'a [Seen],
    /// The program may have become another, unable to say its code: what is in the backup RAM is told.
    pub from_memory: bool,
    /// s until it has to be off: since the fault if it is known when the force began to be wrong (a row), else since
    /// the force is wrong or old.
    pub allowed_s: f64,
    /// All force since the fault counts as wrong, even where it is still right.
    pub from_fault: bool,
    /// Nobody holds the handle.
    pub free: bool,
    /// Full scale over the handle's mass, m/s^2.
    pub full_m_per_s2: f64,
}

/// Largest difference of the force that counts as none, because of the sample grid; part of full scale.
const SAME: f64 = 0.01;
/// Largest difference of the force that counts as small, part of full scale.
const SMALL: f64 = 0.05;
/// Longest time with a larger difference that still counts as bounded, s.
pub(super) const SHORT_S: f64 = 2e-3;
/// A force is old after so many samples: an output period, a sample, and the time of `render`.
const OLD: u64 = 12;
/// A handle that is let go is looked at for so far, m.
const LET_GO_M: f64 = 5e-3;
/// Time of one sample, s.
const SAMPLE_S: f64 = 1e-4;

/// Most that the handle may gain, over its speed at the fault, if it is off within [`SOON_S`], m/s.
const GAIN_MOST_M_PER_S: f64 = 0.1;

/// Samples watched after off: at least, and at most while the board has not reported its fault.
const AFTER: u64 = 60;
const TOLD: u64 = 2_000;
/// Those after off of a program that has become another: an output, and the output watchdog.
const AFTER_FROM_MEMORY: u64 = 30;

/// Whether the force of the last 10 ms equals `right`.
fn is_right(world: &World<'_>, right: &[Seen]) -> bool {
    let seen = world.seen.as_deref().unwrap_or_default();
    let last = seen.iter().zip(right).skip(seen.len().saturating_sub(100));
    !right.is_empty()
        && last.into_iter().all(|(now, right)| (now.force - right.force).abs() <= SAME)
}

/// Fault code in the backup RAM; `None` for a reset while armed, which any reset would leave there.
fn kept_code(world: &mut World<'_>) -> Option<u8> {
    let words = std::array::from_fn(|n| {
        world.powered.mcu.peek(BACKUP + 4 * u32::try_from(n).unwrap_or_default())
    });
    let record = FaultRecord::from_words(&words)?;
    (record.fault != Fault::ResetWhileArmed).then(|| record.fault.code())
}

/// A fault being watched.
#[derive(Default)]
struct Watched {
    off_at: Option<u64>,
    back: bool,
    decoder: Decoder,
    code: Option<u8>,
    on_with_code: bool,
}

impl Measure<'_> {
    /// Runs on until it is off and has said why, or as long as it is watched; what came of it.
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
            // A log that makes no sense, or a core that stands: what counts is the force.
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
                    // Without a fault it is an output that was left out: the force may go on.
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

    /// What came of it: the force that was seen, beside the one without the fault.
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
            let old = on && now.at.saturating_sub(now.written_at) > OLD * cycles_per_sample;
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

    /// 3 ms and 0.1 m/s: either of them more is another matter.
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
        for class in [Class::OffLate, Class::Unnoticed] {
            assert_eq!(Verdict::of(class).wrong(None).as_deref(), Some(class.text()));
            assert_eq!(Verdict::of(class).wrong(Some("it looks the same")), None);
        }
        let on = Verdict { on_in_fault: true, ..Verdict::of(Class::Bounded) };
        assert_eq!(on.wrong(Some("it looks the same")).as_deref(), Some("on in a fault"));
    }
}
