//! The device that a board controls. It has fixed data, from which the plans of loop, experiments and supervisor are
//! computed.
//!
//! A [`Device`] has the content of a [device record](record) and the facts of its board. This module checks the numbers
//! of the record. These numbers and the settings that a person may change are the input of loop, experiments and
//! supervisor.

pub mod designs;
pub mod record;

use core::ops::RangeInclusive;

use self::designs::Designs;
use crate::{
    Design, HitSettings, LoopParameters, Settings, SettingsError,
    experiment::{
        ApproachPlan, CalibrationPlan, CalibrationSettings, Criterion, DutySettings, Gains,
        HitSequencePlan, Order, PeriodPlan, PulseTrainPlan, ReturnSettings, WalkSettings,
        pulse_train, quiet,
    },
    period::{PERIODS, TooSlow, leaves_time},
    range::within,
    safety::{
        BlackBox, CurrentSettings, CurrentWatch, Fault, FaultRecord, SafetyPlan, SafetySettings,
        envelope::{Envelope, Key, Outside},
        sum,
    },
    store::{DeviceKey, Loaded, Name, Signs, Source, Stored},
    units::{Force, Position},
    velocity::{EstimatorName, Sense},
};

/// A device, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Device<'a> {
    /// The board that the device is on.
    pub board: Name,
    /// Name of the device and hash of its record. Saved settings with another key are not used.
    pub key: DeviceKey,
    /// Hash of the scene.
    pub scene_hash: u32,
    /// Fixed data. Two of its values can be replaced: the force at full command by a calibrated force, the output
    /// period by a setting.
    pub design: Design,
    /// Time from the reading of the counter to the force, in samples.
    pub latency_samples: f64,
    /// Senses that an estimator can use beside the count.
    pub senses: &'static [Sense],
    /// The envelope: walls that are predicted to be stable.
    pub envelope: Envelope<'a>,
    /// The device's named filters.
    pub designs: Designs<'a>,
    /// Limits of the supervisor. A hit must start inside the travel of these limits.
    pub safety: SafetySettings,
    /// Thermal limits of the motor.
    pub duty: DutySettings,
    /// Scale of the voltage with which the amplifier reports its current.
    pub current: CurrentSettings,
    /// Distance of the handle from the axis of a rotary device, in m. It is 0 if the handle moves straight.
    pub radius_m: f64,
    /// The return move to the start of a hit. Its `start_m` is only a default: the start that is used comes from the
    /// stored settings.
    pub back: ReturnSettings,
    /// Data of a calibration, without the force. The command that starts a calibration gives the force.
    pub calibration: CalibrationSettings,
    /// Directions of motor and encoder on a board without saved settings.
    pub signs: Signs,
    /// Estimator and wall of a board without saved settings.
    pub settings: Settings,
    /// Hit of a board without saved settings, shortened to the motor's thermal limits.
    pub hit: HitSettings,
    /// Criterion of a stable wall on a board without saved settings.
    pub criterion: Criterion,
    /// Grid of the walk on a board without saved settings.
    pub walk: WalkSettings,
}

/// The largest factor by which a calibrated force at full command may differ from the force of [`Device::design`]. A
/// larger factor can only be a typing error.
const FULL_SCALE_FACTOR: f64 = 3.0;

/// Number of records in the black box. With outputs at 1 kHz they cover half a second.
pub const HISTORY: usize = 500;

/// Why a board cannot run settings that are all within their ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unfit {
    /// The estimator needs this sense. The board does not have it.
    Sense(EstimatorName, Sense),
    /// The estimator leaves no time for the output period.
    TooSlow(TooSlow),
    /// The board does not have this output period, in samples.
    Period(f64),
}

/// State of a board at its start.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// The settings in force.
    pub stored: Stored,
    /// Source of these settings.
    pub source: Source,
    /// The settings in force as integers.
    pub control: LoopParameters,
    /// Limits of the supervisor.
    pub safety: SafetyPlan,
    /// Values that depend on the output period.
    pub period: PeriodPlan,
    /// Check of the motor's current, if the amplifier reports it.
    pub current: Option<CurrentWatch>,
    /// Fault of the last run, or the fault of unusable saved settings, or both.
    pub fault: Option<FaultRecord>,
}

impl Device<'_> {
    /// Allowed radii of a rotary handle, in m. A linear handle has radius 0.
    pub const RADIUS_M: RangeInclusive<f64> = 1e-3..=10.0;
    /// The longest latency that a record may have, in samples. On the present boards it is half a second.
    pub const LATENCY_MAX_SAMPLES: f64 = 5000.0;
    /// Farthest end of the travel from zero, in m. A handle may turn several times.
    pub const TRAVEL_MAX_M: f64 = 10.0;
    /// Highest believable speed that a record may have, in m/s.
    pub const SPEED_MAX_M_PER_S: f64 = 100.0;
    /// Allowed values for the mass of the heaviest handle, in kg. The upper end stands for an unknown mass.
    pub const HEAVIEST_MASS_KG: RangeInclusive<f64> = 1e-4..=1e6;

    /// Returns the design with this calibrated force at full command.
    ///
    /// # Errors
    /// This force is too far from the force of the design.
    pub fn calibrated(&self, full_scale_n: f64) -> Result<Design, SettingsError> {
        let nominal = self.design.full_scale_n;
        let range = nominal / FULL_SCALE_FACTOR..=nominal * FULL_SCALE_FACTOR;
        within("full_scale_n", full_scale_n, range)?;
        Ok(Design { full_scale_n, ..self.design })
    }

    /// The design with the output period and the calibrated full scale of the settings.
    pub(crate) fn design(&self, stored: &Stored) -> Result<Design, SettingsError> {
        Ok(Design { period: stored.period, ..self.calibrated(stored.full_scale_n)? })
    }

    /// The plan that depends on the output period of these settings.
    ///
    /// # Errors
    /// Names the value that is out of range.
    pub fn period(&self, stored: &Stored) -> Result<PeriodPlan, SettingsError> {
        let design = Design { period: stored.period, ..self.design };
        let keep = BlackBox::<HISTORY>::every(1000 * design.samples_per_ms(), stored.period);
        Ok(PeriodPlan { duty: self.duty.build(&design, 0)?, keep })
    }

    /// Computes the state of a board at its start. `loaded` are the settings from its flash, and `boot` is the fault of
    /// its last run.
    ///
    /// If settings cannot be built, or their estimator needs a sense that the board lacks, the defaults are in force.
    /// The fault is then `settings`.
    ///
    /// # Errors
    /// Names the first number of the device itself that is out of range.
    pub fn start(
        &self,
        loaded: &Loaded,
        boot: Option<FaultRecord>,
    ) -> Result<Start, SettingsError> {
        let safety = self.safety.build(&self.design)?;
        let defaults = self.defaults();
        self.period(&defaults)?;
        let current = self.current.build(self.design.output)?;
        self.hit_sequence(&defaults, false)?;
        let default = self.control(&defaults)?;
        let fits = self.unfit(&loaded.stored).is_none();
        let built = self.control(&loaded.stored).ok().filter(|_| fits);
        let stored = if built.is_some() { loaded.stored } else { defaults };
        let usable = loaded.stored == stored && loaded.source != Source::Unusable;
        let source = if usable { loaded.source } else { Source::Unusable };
        let refused = (!usable).then(|| FaultRecord::bare(Fault::Settings));
        let fault = match (boot, refused) {
            (Some(boot), Some(refused)) => {
                Some(FaultRecord { causes: boot.causes.union(refused.causes), ..boot })
            }
            (boot, refused) => boot.or(refused),
        };
        let (safety, period) = (safety.at(stored.period), self.period(&stored)?);
        let control = built.unwrap_or(default);
        Ok(Start { stored, source, control, safety, period, current, fault })
    }

    /// Plans a hit with these settings, and the return move before it. With `early` the hit gives its verdict as soon
    /// as it is certain.
    ///
    /// # Errors
    /// Names the value that is out of range. A start at or behind the wall is out of range. A wall is also out of range
    /// if no start is possible in front of it.
    pub fn hit_sequence(
        &self,
        stored: &Stored,
        early: bool,
    ) -> Result<HitSequencePlan, SettingsError> {
        let plan = self.experiment(stored)?;
        let Design { resolution_m, .. } = self.design;
        let SafetySettings { travel_low_m, travel_high_m, .. } = self.safety;
        let wall_m = stored.settings.wall.position_m;
        let reach_m = f64::from(Position::LIMIT) * resolution_m;
        within("position_m", wall_m, travel_low_m + resolution_m..=reach_m)?;
        let last_m = wall_m.min(travel_high_m) - resolution_m;
        within("start_m", stored.start_m, travel_low_m..=last_m)?; // the return move does not pass the wall
        let look = if early { plan.look } else { HitSequencePlan::NEVER };
        Ok(HitSequencePlan { look, ..plan })
    }

    /// Like [`hit_sequence`](Self::hit_sequence), but it does not check the wall. So a user can change the settings of
    /// an experiment whatever the wall is. When an experiment begins, `hit_sequence` checks the wall.
    ///
    /// # Errors
    /// Names the value that is out of range.
    pub fn experiment(&self, stored: &Stored) -> Result<HitSequencePlan, SettingsError> {
        let design = self.design(stored)?;
        let Stored { push_n, settle_s, window_s, rms_limit_m, .. } = *stored;
        let rms_limit_m = match stored.criterion {
            Criterion::Rms => rms_limit_m,
            Criterion::Quiet => quiet::rms_limit_m(design.resolution_m),
        };
        if stored.criterion == Criterion::Quiet {
            let most_n = design.full_scale_n / quiet::PUSH_MAX;
            within("push_n", push_n, -most_n..=most_n)?;
        }
        if let Some(limit_n) = stored.force_rms_limit_n {
            within("force_rms_limit_n", limit_n, 0.0..=design.full_scale_n)?;
        }
        let hit = HitSettings { push_n, settle_s, window_s, rms_limit_m }.build(&design)?;
        let start_m = stored.start_m;
        // If the motor is weaker than assumed, the return move uses half of its force.
        let force_n = self.back.force_n.min(design.full_scale_n / 2.0);
        let SafetySettings { travel_low_m, travel_high_m, .. } = self.safety;
        within("start_m", start_m, travel_low_m..=travel_high_m)?;
        let back = ReturnSettings { start_m, force_n, ..self.back }.build(&design)?;
        let duty = self.duty_at(&design);
        let longest_s = duty.longest_hit_s(&design);
        let together_s = settle_s + window_s;
        let same = libm::fabs(together_s - longest_s) < 0.5 / design.rate_hz;
        let value = if same { longest_s } else { together_s };
        within("settle_s and window_s together", value, 0.0..=longest_s)?;
        // Settle time and window are each rounded to samples. Their sum is wrong by up to one sample. The model has
        // spare outputs for this error.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturating")]
        let longest = libm::round(longest_s * design.rate_hz) as u32;
        let duty = duty.build(&design, hit.settle.saturating_add(hit.window).min(longest))?;
        let look = HitSequencePlan::LOOK_MS * design.outputs_per_ms();
        let approach = ApproachPlan { back, duty };
        Ok(HitSequencePlan { hit, approach, approach_sum: sum(&approach), look })
    }

    /// Thermal limits for this design. Only the current heats the motor, and the continuous force divided by full scale
    /// is a ratio of two currents. So a calibration of the force does not change this ratio.
    fn duty_at(&self, design: &Design) -> DutySettings {
        let part = design.full_scale_n / self.design.full_scale_n;
        let continuous_force_n = self.duty.continuous_force_n * part;
        DutySettings { continuous_force_n, ..self.duty }
    }

    /// Plans a pulse train with this force. There must be no wall.
    ///
    /// # Errors
    /// Names the value that is out of range. A wall with a force is out of range too.
    pub fn pulse_train(
        &self,
        stored: &Stored,
        push_n: f64,
    ) -> Result<PulseTrainPlan, SettingsError> {
        let wall = &stored.settings.wall;
        within("stiffness_n_per_m", wall.stiffness_n_per_m, 0.0..=0.0)?;
        within("damping_n_s_per_m", wall.damping_n_s_per_m, 0.0..=0.0)?;
        let (design, hit) = (self.design(stored)?, self.hit_sequence(stored, false)?);
        let outputs = |seconds| Ok(design.samples("pulse_s", seconds)? / design.period.max(1));
        let longest = design.samples("pulse_s", pulse_train::LONG_S)?;
        let mut pulses = [(Force::ZERO, 0); pulse_train::PULSES];
        let parts = pulse_train::PARTS.into_iter().zip(pulse_train::LENGTHS_S);
        for (pulse, (part, seconds)) in pulses.iter_mut().zip(parts) {
            *pulse = (design.force("push_n", part * push_n)?, outputs(seconds)?);
        }
        let duty = self.duty_at(&design).build(&design, longest)?;
        let approach = ApproachPlan { back: hit.approach.back, duty };
        Ok(PulseTrainPlan {
            pulses,
            rest: outputs(pulse_train::REST_S)?,
            approach,
            approach_sum: sum(&approach),
        })
    }

    /// Plans a calibration with this part of full scale.
    ///
    /// # Errors
    /// The force is too large.
    pub fn calibration(
        &self,
        stored: &Stored,
        percent: f64,
    ) -> Result<CalibrationPlan, SettingsError> {
        CalibrationSettings { percent, ..self.calibration }.build(&self.design(stored)?)
    }

    /// Settings of a board without saved settings.
    pub fn defaults(&self) -> Stored {
        let HitSettings { push_n, settle_s, window_s, rms_limit_m } = self.hit;
        // The hit is shortened to what the motor can bear. 1 % is left for rounding.
        let longest_s = 0.99 * self.duty.longest_hit_s(&self.design);
        let part = f64::min(1.0, longest_s / (settle_s + window_s));
        Stored {
            device: self.key,
            settings: self.settings,
            period: self.design.period,
            push_n,
            signs: self.signs,
            start_m: self.back.start_m,
            settle_s: settle_s * part,
            window_s: window_s * part,
            rms_limit_m,
            criterion: self.criterion,
            force_rms_limit_n: None,
            full_scale_n: self.design.full_scale_n,
            grid: self.walk,
        }
    }

    /// Says why the board cannot run these settings, although each is within its range. The board may lack a sense that
    /// the estimator needs, or the output period may not fit.
    pub fn unfit(&self, stored: &Stored) -> Option<Unfit> {
        let (estimator, period) = (stored.settings.velocity.name(), stored.period);
        if !PERIODS.contains(&period) {
            return Some(Unfit::Period(period.into()));
        }
        let missing = estimator.missing(self.senses).map(|sense| Unfit::Sense(estimator, sense));
        missing.or(leaves_time(estimator, period).err().map(Unfit::TooSlow))
    }

    /// Converts these settings to integers.
    ///
    /// # Errors
    /// Names the value that is out of range.
    pub fn control(&self, stored: &Stored) -> Result<LoopParameters, SettingsError> {
        stored.settings.build(&self.design(stored)?)
    }

    /// Key under which the envelope lists these settings.
    pub fn key(&self, stored: &Stored) -> Key {
        let velocity = &stored.settings.velocity;
        let design = self.designs.number_of(velocity);
        Key {
            estimator: velocity.name(),
            // A table of the envelope is valid for a design, or for an estimator whose further parameters have their
            // defaults. About other values nothing is known. So the key gets NaN as its cutoff, which equals no cutoff.
            cutoff_hz: match design > 0 || velocity.differs_by_tuning_only() {
                false => f64::NAN,
                true => velocity.tuning().map_or(0.0, |(_, value)| value),
            },
            period: stored.period,
            design,
        }
    }

    /// Checks that the gains of these settings are inside the envelope.
    ///
    /// # Errors
    /// Says which gains are allowed.
    pub fn inside(&self, stored: &Stored) -> Result<(), Outside> {
        let wall = &stored.settings.wall;
        let (k, b) = (wall.stiffness_n_per_m, wall.damping_n_s_per_m);
        self.envelope.allows(&self.key(stored), k, b)
    }

    /// Makes the order that puts these settings in force.
    ///
    /// # Errors
    /// Names the value that is out of range.
    pub fn order(&self, stored: &Stored) -> Result<Order, SettingsError> {
        let gains = if self.inside(stored).is_ok() { Gains::Inside } else { Gains::Outside };
        Ok(Order::LoopParameters(self.control(stored)?, gains))
    }
}

#[cfg(test)]
pub(crate) mod tests;
