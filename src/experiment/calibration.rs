//! The force calibration. Outside the wall, a force rises slowly and is then held constant, so that a weight or a force
//! gauge can measure it. The calibration ends by itself when the handle moves.
//!
//! docs/tuning.md has two ways to use it. In the first way a gauge holds the handle and shows the force. In the second
//! way a weight rests on the handle. The board reports the force that lifts the weight.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use crate::{
    Design,
    range::{SettingsError, within},
    safety::Doubled,
    units::{Force, Position},
};

/// Settings of the calibration, in SI units and percent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSettings {
    /// Target force, in percent of full scale. The range is -30 to 30.
    pub percent: f64,
    /// Rise of the force, in percent of full scale per second.
    pub rise_percent_per_s: f64,
    /// Time to hold the force, in s.
    pub hold_s: f64,
    /// Distance after which the handle counts as moved, in m. The distance is measured from the position of the first
    /// output.
    pub travel_m: f64,
}

impl CalibrationSettings {
    /// Allowed forces, in percent of full scale.
    pub const PERCENT: core::ops::RangeInclusive<f64> = -30.0..=30.0;

    /// Checks and converts the settings.
    ///
    /// # Errors
    /// Names the first parameter that is out of range, and the range.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::float_arithmetic,
        reason = "design time; every value is bounded by the check before it"
    )]
    pub fn build(&self, design: &Design) -> Result<CalibrationPlan, SettingsError> {
        design.check()?;
        let outputs_per_s = design.rate_hz / f64::from(design.period);
        let percent = within("calibrate", self.percent, Self::PERCENT)?;
        let rise = within("rise_percent_per_s", self.rise_percent_per_s, 0.1..=100.0)?;
        let hold_s = within("hold_s", self.hold_s, 1.0..=60.0)?;
        let widest = f64::from(1 << 20) * design.resolution_m;
        within("travel_m", self.travel_m, 4.0 * design.resolution_m..=widest)?;
        let lsb = f64::from(Force::FULL_SCALE.bits()) / 100.0;
        Ok(CalibrationPlan {
            target: (percent * lsb) as i32,
            step: ((rise * lsb / outputs_per_s) as i32).max(1),
            hold: libm::ceil(hold_s * outputs_per_s) as u32,
            longest: libm::ceil(LONGEST_S * outputs_per_s) as u32,
            travel: (self.travel_m / design.resolution_m) as u32,
        })
    }
}

/// The longest time of a calibration, in s, even if the force is changed again and again.
const LONGEST_S: f64 = 120.0;

/// The calibration in integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CalibrationPlan {
    /// Force to reach, in LSB of [`Force`].
    target: i32,
    /// Change of the force per output, in LSB of [`Force`].
    step: i32,
    /// Time to hold the force, in outputs.
    hold: u32,
    /// Longest time of the whole calibration, in outputs.
    longest: u32,
    /// Travel that ends the calibration, in counts.
    travel: u32,
}

/// Why a calibration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationEnd {
    /// The handle moved. With a weight on the handle, this force lifts it.
    Moved,
    /// The handle is in the wall.
    Contact,
    /// The time is up.
    TimeUp,
    /// The force went off.
    Off,
}

impl CalibrationEnd {
    /// The reason in plain words.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Moved => "the handle moved",
            Self::Contact => "the handle is in the wall",
            Self::TimeUp => "the time is up",
            Self::Off => "the force went off: see status and faults",
        }
    }
}

/// A calibration in progress.
#[derive(Clone, Copy, Debug)]
pub struct Calibration {
    plan: Doubled<CalibrationPlan>,
    progress: Doubled<Progress>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Progress {
    /// Position of the handle at the first output.
    origin: Option<Position>,
    force: i32,
    /// Number of outputs since the force reached its target.
    held: u32,
    /// Outputs since the calibration began.
    outputs: u32,
}

impl Calibration {
    /// Makes a calibration whose first output is still to come.
    pub fn new(plan: CalibrationPlan) -> Self {
        Self { plan: Doubled::new(plan), progress: Doubled::new(Progress::default()) }
    }

    /// Flips a bit of the second copy of the plan.
    #[cfg(test)]
    pub fn spoil(&mut self) {
        self.plan.spoil(CalibrationPlan { hold: self.plan.hold ^ 1, ..*self.plan });
    }

    /// Whether plan and progress are unchanged.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.plan.is_whole() && self.progress.is_whole()
    }

    /// Continues from the present force to another force. The total time does not start again. It must stay limited,
    /// because the check for a push without motion is off during a calibration.
    pub fn retarget(&mut self, plan: CalibrationPlan) {
        self.plan.set(plan);
        self.progress.change(|progress| progress.held = 0);
    }

    /// Returns the push for this output. `contact` says whether the handle is inside the wall.
    ///
    /// # Errors
    /// The calibration is over. There is no push any more.
    pub fn output(&mut self, position: Position, contact: bool) -> Result<Force, CalibrationEnd> {
        let plan = &*self.plan;
        self.progress.change(|progress| progress.output(plan, position, contact))
    }

    /// Whether the force has reached its target at this output for the first time.
    pub fn is_complete_now(&self) -> bool {
        self.progress.held == 1
    }
}

impl Progress {
    fn output(
        &mut self,
        plan: &CalibrationPlan,
        position: Position,
        contact: bool,
    ) -> Result<Force, CalibrationEnd> {
        let origin = *self.origin.get_or_insert(position);
        if contact {
            return Err(CalibrationEnd::Contact);
        }
        if position.wrapping_since(origin).unsigned_abs() > plan.travel {
            return Err(CalibrationEnd::Moved);
        }
        self.outputs = self.outputs.saturating_add(1);
        if self.outputs > plan.longest {
            return Err(CalibrationEnd::TimeUp);
        }
        let step = plan.step;
        // Both forces are within +-0.3 of full scale, so the difference cannot overflow.
        self.force += (plan.target - self.force).max(-step).min(step); // clamp could panic
        if self.force == plan.target {
            self.held = self.held.saturating_add(1);
            if self.held > plan.hold {
                return Err(CalibrationEnd::TimeUp);
            }
        }
        Ok(Force::saturating_from_bits(self.force))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::return_move::tests::{DESIGN, Handle};

    const SETTINGS: CalibrationSettings = CalibrationSettings {
        percent: 20.0,
        rise_percent_per_s: 2.0,
        hold_s: 20.0,
        travel_m: 1e-3,
    };

    fn at(counts: i32) -> Position {
        Position::from_counts(counts)
    }

    #[test]
    #[cfg_attr(miri, ignore = "60 s in steps of 1 ms")]
    fn it_rises_slowly_holds_and_ends() {
        for percent in [20.0, -20.0] {
            let plan = CalibrationSettings { percent, ..SETTINGS }.build(&DESIGN).unwrap();
            let mut calibration = Calibration::new(plan);
            let (mut last, mut complete) = (0i32, None);
            for n in 0.. {
                match calibration.output(at(100 + n % 900), false) {
                    Ok(force) => {
                        assert!((force.bits() - last).abs() <= (1 << 30) / 50_000 + 1);
                        last = force.bits();
                        if calibration.is_complete_now() {
                            complete = Some(n);
                        }
                    }
                    Err(end) => {
                        assert_eq!((end, n - complete.unwrap()), (CalibrationEnd::TimeUp, 20_000));
                        break;
                    }
                }
            }
            assert!((f64::from(last) / 2f64.powi(30) - percent / 100.0).abs() < 1e-6);
            assert!((9_990..10_010).contains(&complete.unwrap()), "{complete:?}");
        }
    }

    #[test]
    fn a_bit_of_the_progress_that_flips_stays_visible() {
        let mut calibration = Calibration::new(SETTINGS.build(&DESIGN).unwrap());
        for _ in 0..100 {
            calibration.output(at(0), false).unwrap();
        }
        for bit in 0..u32::BITS {
            let flips: [fn(&mut Progress, u32); 3] = [
                |progress, bit| progress.outputs ^= 1 << bit,
                |progress, bit| progress.held ^= 1 << bit,
                |progress, bit| progress.force ^= 1 << bit.min(29),
            ];
            for flip in flips {
                let (mut broken, mut copy) = (calibration, *calibration.progress);
                flip(&mut copy, bit);
                broken.progress.spoil(copy);
                broken.output(at(0), false).unwrap();
                assert!(!broken.is_whole(), "{bit}");
            }
        }
    }

    #[test]
    fn motion_either_way_and_contact_end_it_at_once() {
        for moved in [1_001, -1_001] {
            let mut calibration = Calibration::new(SETTINGS.build(&DESIGN).unwrap());
            for n in 0..=10 {
                assert!(calibration.output(at(moved / 11 * n), false).is_ok());
            }
            assert_eq!(calibration.output(at(moved), false), Err(CalibrationEnd::Moved));
        }
        let mut calibration = Calibration::new(SETTINGS.build(&DESIGN).unwrap());
        assert_eq!(calibration.output(at(0), true), Err(CalibrationEnd::Contact));
    }

    #[test]
    fn travel_is_4_to_2_to_the_20_counts_and_just_as_much_is_no_motion() {
        for (travel_m, allowed) in [(3e-6, false), (4.5e-6, true), (1.048, true), (1.049, false)] {
            let plan = CalibrationSettings { travel_m, ..SETTINGS }.build(&DESIGN);
            assert_eq!(plan.is_ok(), allowed, "{travel_m}");
        }
        for side in [-1, 1] {
            let settings = CalibrationSettings { travel_m: 4.5e-6, ..SETTINGS };
            let mut calibration = Calibration::new(settings.build(&DESIGN).unwrap());
            for counts in [0, 4 * side] {
                assert!(calibration.output(at(counts), false).is_ok());
            }
            assert_eq!(calibration.output(at(5 * side), false), Err(CalibrationEnd::Moved));
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "two minutes in steps of 1 ms")]
    fn however_often_the_force_is_changed_it_ends_after_two_minutes() {
        let plan = |percent| CalibrationSettings { percent, ..SETTINGS }.build(&DESIGN).unwrap();
        let mut calibration = Calibration::new(plan(20.0));
        let ended = (0..200_000u32).find_map(|n| {
            if n % 5_000 == 0 {
                calibration.retarget(plan(if n % 10_000 == 0 { 20.0 } else { 19.0 }));
            }
            calibration.output(at(0), false).err().map(|end| (n, end))
        });
        assert_eq!(ended, Some((120_000, CalibrationEnd::TimeUp)));
    }

    #[test]
    fn another_force_is_reached_from_the_present_one() {
        let mut calibration = Calibration::new(SETTINGS.build(&DESIGN).unwrap());
        let mut last = 0;
        for _ in 0..12_000 {
            last = calibration.output(at(0), false).unwrap().bits();
        }
        let less = CalibrationSettings { percent: 10.0, ..SETTINGS }.build(&DESIGN).unwrap();
        calibration.retarget(less);
        let next = calibration.output(at(0), false).unwrap().bits();
        assert!(next < last && last - next <= (1 << 30) / 50_000 + 1);
    }

    /// Simulates the weighing of docs/tuning.md. Returns the force, in percent of full scale, at which a weight on a
    /// handle with dry friction has moved by 1 mm. If `lifted`, a force that rises to 15 % lifts the weight off a
    /// block. If not, the force falls from 15 % to 5 %, with a block above the handle and none below.
    fn weighed(weight_percent: f64, friction_n: f64, lifted: bool) -> f64 {
        let plan = |percent| CalibrationSettings { percent, ..SETTINGS }.build(&DESIGN).unwrap();
        let weight_n = weight_percent / 100.0 * DESIGN.full_scale_n;
        let mut handle = Handle { rest_m: 0.0, ..Handle::at(0.0) };
        handle.mass_kg += weight_n / 9.81;
        let mut calibration = Calibration::new(plan(15.0));
        let mut last = Force::ZERO;
        for _ in 0..30_000 {
            if !lifted && calibration.progress.held == 1_000 {
                calibration.retarget(plan(5.0));
            }
            match calibration.output(handle.position(), false) {
                Ok(force) => last = force,
                Err(end) => {
                    assert_eq!(end, CalibrationEnd::Moved);
                    return f64::from(last.bits()) / 2f64.powi(30) * 100.0;
                }
            }
            let push_n = f64::from(last.bits()) / 2f64.powi(30) * DESIGN.full_scale_n - weight_n;
            let held = handle.v == 0.0 && push_n.abs() <= friction_n;
            let against_n = if held { push_n } else { friction_n * push_n.signum() };
            let net = (push_n - against_n) / DESIGN.full_scale_n;
            #[expect(clippy::cast_possible_truncation, reason = "within full scale")]
            handle.go(Force::saturating_from_bits((net * 2f64.powi(30)) as i32));
            let below =
                lifted || calibration.progress.held < 1_000 && *calibration.plan == plan(15.0);
            if (below && handle.x < 0.0) || (!lifted && handle.x > 0.0) {
                (handle.x, handle.v) = (0.0, 0.0);
            }
        }
        panic!("it never moves");
    }

    /// Limits that docs/tuning.md states, in percent of full scale. `LIFTING` is how much the force may exceed weight
    /// and friction while the handle moves by 1 mm. `MEAN_OFF` is the error of the mean of both ways to weigh.
    const LIFTING: f64 = 0.8;
    const MEAN_OFF: f64 = 0.005;

    #[test]
    #[cfg_attr(miri, ignore = "a minute in steps of 1 ms")]
    fn lifting_reads_high_lowering_reads_low_and_their_mean_is_the_weight() {
        for friction_n in [0.0, 0.1] {
            let (up, down) = (weighed(10.0, friction_n, true), weighed(10.0, friction_n, false));
            let least = 100.0 * friction_n / DESIGN.full_scale_n;
            for off in [up - 10.0, 10.0 - down] {
                assert!((off - least - LIFTING).abs() < 0.01, "{up} {down}");
            }
            assert!((up.midpoint(down) - 10.0).abs() < MEAN_OFF, "{up} {down}");
        }
    }

    #[test]
    fn only_a_part_of_full_scale_is_allowed() {
        for percent in [30.1, -31.0, f64::NAN, 100.0] {
            let error = CalibrationSettings { percent, ..SETTINGS }.build(&DESIGN).unwrap_err();
            assert_eq!((error.parameter, *error.range.end()), ("calibrate", 30.0));
        }
    }
}
