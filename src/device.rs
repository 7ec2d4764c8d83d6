//! The device that a board controls: what is built and cannot be tuned while it runs, and what follows from it.
//!
//! A [`Device`] is plain numbers. Here they are checked and turned into what the loop, the experiments and the
//! supervisor take, together with the settings that a person may change.

use crate::{
    Design, HitSettings, LoopParameters, Settings, SettingsError,
    experiment::{
        CalibrationPlan, CalibrationSettings, DutySettings, Gains, HitSequencePlan, Order,
        PeriodPlan, ReturnSettings, WalkSettings,
    },
    period::{PERIODS, TooSlow, leaves_time},
    range::within,
    safety::{
        BlackBox, Fault, FaultRecord, SafetyPlan, SafetySettings,
        envelope::{Envelope, Key, Outside},
    },
    store::{DeviceKey, Loaded, Signs, Source, Stored},
    units::Position,
    velocity::{EstimatorName, Sense},
};

/// A device, in SI units.
#[derive(Clone, Copy, Debug)]
pub struct Device {
    /// Name, as in the scene and in the envelope; of the board too.
    pub key: DeviceKey,
    /// What is built. A calibration may find another force at full command, and the output period may be set.
    pub design: Design,
    /// From the counter's reading to the force, samples.
    pub latency_samples: f64,
    /// What an estimator can look at beside the count.
    pub senses: &'static [Sense],
    /// The walls that are predicted to be stable.
    pub envelope: &'static Envelope<'static>,
    /// Limits of the supervisor. No hit starts outside its travel.
    pub safety: SafetySettings,
    /// What the motor stands.
    pub duty: DutySettings,
    /// The return move to the start; the start is that of the settings.
    pub back: ReturnSettings,
    /// A calibration; its force is that of the command.
    pub calibration: CalibrationSettings,
    /// Estimator and wall of a board to which nothing was ever saved.
    pub settings: Settings,
    /// Hit of such a board, shortened to what the motor stands.
    pub hit: HitSettings,
    /// Grid of its walk.
    pub walk: WalkSettings,
}

/// The force at full command may differ from that of [`Device::design`] by this factor; more is a typing error.
const FULL_SCALE_FACTOR: f64 = 3.0;

/// Records of the black box: half a second at 1 kHz.
pub const HISTORY: usize = 500;

/// Why a board cannot take settings, whatever their ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unfit {
    /// The estimator needs this sense, which the board has not.
    Sense(EstimatorName, Sense),
    /// The estimator leaves no time for the output period.
    TooSlow(TooSlow),
    /// There is no such output period, samples.
    Period(f64),
}

/// What a board starts with.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// The settings in force.
    pub stored: Stored,
    /// Where they come from.
    pub source: Source,
    /// The same in integers.
    pub control: LoopParameters,
    /// Limits of the supervisor.
    pub safety: SafetyPlan,
    /// What goes by the output period.
    pub period: PeriodPlan,
    /// The fault of the last run, that of settings that cannot be used, or both.
    pub fault: Option<FaultRecord>,
}

impl Device {
    /// The design with the force at full command that was calibrated.
    ///
    /// # Errors
    /// It is too far from that of the design.
    pub fn calibrated(&self, full_scale_n: f64) -> Result<Design, SettingsError> {
        let nominal = self.design.full_scale_n;
        let range = nominal / FULL_SCALE_FACTOR..=nominal * FULL_SCALE_FACTOR;
        within("full_scale_n", full_scale_n, range)?;
        Ok(Design { full_scale_n, ..self.design })
    }

    /// The design with what of it is set.
    fn design(&self, stored: &Stored) -> Result<Design, SettingsError> {
        Ok(Design { period: stored.period, ..self.calibrated(stored.full_scale_n)? })
    }

    /// What goes by the output period of those settings.
    ///
    /// # Errors
    /// Names what is out of range.
    pub fn period(&self, stored: &Stored) -> Result<PeriodPlan, SettingsError> {
        let design = Design { period: stored.period, ..self.design };
        let keep = BlackBox::<HISTORY>::every(1000 * design.samples_per_ms(), stored.period);
        Ok(PeriodPlan { duty: self.duty.build(&design, 0)?, keep })
    }

    /// What a board starts with that found `loaded` in its flash, and the fault `boot` of its last run.
    ///
    /// Settings that cannot be built, or whose estimator needs a sense that the board has not, leave the defaults in
    /// force, with the fault `settings`.
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
        self.hit_sequence(&defaults, false)?;
        let default = self.control(&defaults)?;
        let fits = self.unfit(&loaded.stored).is_none();
        let built = self.control(&loaded.stored).ok().filter(|_| fits);
        let stored = if built.is_some() { loaded.stored } else { defaults };
        let usable = loaded.stored == stored;
        let source = if usable { loaded.source } else { Source::Unusable };
        let refused = (!usable).then(|| FaultRecord::bare(Fault::Settings));
        let fault = match (boot, refused) {
            (Some(boot), Some(refused)) => {
                Some(FaultRecord { causes: boot.causes.union(refused.causes), ..boot })
            }
            (boot, refused) => boot.or(refused),
        };
        let (safety, period) = (safety.at(stored.period), self.period(&stored)?);
        Ok(Start { stored, source, control: built.unwrap_or(default), safety, period, fault })
    }

    /// A hit with those settings and what comes before it; `early`: its verdict as soon as it is certain.
    ///
    /// # Errors
    /// Names what is out of range; a start at or behind the wall is, and a wall in front of which there is no start.
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
        within("start_m", stored.start_m, travel_low_m..=last_m)?;
        let look = if early { plan.look } else { HitSequencePlan::NEVER };
        Ok(HitSequencePlan { look, ..plan })
    }

    /// The same as far as the settings of experiments say it, so that each of them can be set whatever the wall is: where
    /// the wall has to be follows when one begins, see [`hit_sequence`](Self::hit_sequence).
    ///
    /// # Errors
    /// Names what is out of range.
    pub fn experiment(&self, stored: &Stored) -> Result<HitSequencePlan, SettingsError> {
        let design = self.design(stored)?;
        let Stored { push_n, settle_s, window_s, rms_limit_m, .. } = *stored;
        let hit = HitSettings { push_n, settle_s, window_s, rms_limit_m }.build(&design)?;
        let start_m = stored.start_m;
        // A motor weaker than it was taken for brings the handle back with what it has.
        let force_n = self.back.force_n.min(design.full_scale_n / 2.0);
        let SafetySettings { travel_low_m, travel_high_m, .. } = self.safety;
        within("start_m", start_m, travel_low_m..=travel_high_m)?;
        let back = ReturnSettings { start_m, force_n, ..self.back }.build(&design)?;
        // What heats is the current: its part of full scale stays, whatever force a calibration found there.
        let part = design.full_scale_n / self.design.full_scale_n;
        let continuous_force_n = self.duty.continuous_force_n * part;
        let duty = DutySettings { continuous_force_n, ..self.duty };
        let longest_s = duty.longest_hit_s(&design);
        let together_s = settle_s + window_s;
        let same = libm::fabs(together_s - longest_s) < 0.5 / design.rate_hz;
        let value = if same { longest_s } else { together_s };
        within("settle_s and window_s together", value, 0.0..=longest_s)?;
        // Each is rounded to samples, both together by up to one: the model has outputs to spare for that.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturating")]
        let longest = libm::round(longest_s * design.rate_hz) as u32;
        let duty = duty.build(&design, hit.settle.saturating_add(hit.window).min(longest))?;
        let look = HitSequencePlan::LOOK_MS * design.outputs_per_ms();
        Ok(HitSequencePlan { hit, back, duty, look })
    }

    /// A calibration at that part of full scale.
    ///
    /// # Errors
    /// It is too much.
    pub fn calibration(
        &self,
        stored: &Stored,
        percent: f64,
    ) -> Result<CalibrationPlan, SettingsError> {
        CalibrationSettings { percent, ..self.calibration }.build(&self.design(stored)?)
    }

    /// Settings of a board to which nothing was ever saved.
    pub fn defaults(&self) -> Stored {
        let HitSettings { push_n, settle_s, window_s, rms_limit_m } = self.hit;
        // As much of the hit as the motor stands, less 1 % for rounding.
        let longest_s = 0.99 * self.duty.longest_hit_s(&self.design);
        let part = f64::min(1.0, longest_s / (settle_s + window_s));
        Stored {
            device: self.key,
            settings: self.settings,
            period: self.design.period,
            push_n,
            signs: Signs::default(),
            start_m: self.back.start_m,
            settle_s: settle_s * part,
            window_s: window_s * part,
            rms_limit_m,
            full_scale_n: self.design.full_scale_n,
            grid: self.walk,
        }
    }

    /// Why the board cannot take those settings, whatever their ranges, if so: a sense that the estimator needs, or the
    /// output period.
    pub fn unfit(&self, stored: &Stored) -> Option<Unfit> {
        let (estimator, period) = (stored.settings.velocity.name(), stored.period);
        if !PERIODS.contains(&period) {
            return Some(Unfit::Period(period.into()));
        }
        let missing = estimator.missing(self.senses).map(|sense| Unfit::Sense(estimator, sense));
        missing.or(leaves_time(estimator, period).err().map(Unfit::TooSlow))
    }

    /// The integers of those settings.
    ///
    /// # Errors
    /// Names what is out of range.
    pub fn control(&self, stored: &Stored) -> Result<LoopParameters, SettingsError> {
        stored.settings.build(&self.design(stored)?)
    }

    /// What of the envelope holds for those settings.
    pub fn key<'a>(&self, stored: &'a Stored) -> Key<'a> {
        let velocity = &stored.settings.velocity;
        Key {
            device: stored.device.name(),
            estimator: velocity.name().text(),
            // A table holds for the default of the second parameter; of another one nothing is known.
            cutoff_hz: match velocity.second() {
                Some((parameter, value)) if value != parameter.default => f64::NAN,
                _ => velocity.tuning().map_or(0.0, |(_, value)| value),
            },
            latency_samples: self.latency_samples,
            period_samples: f64::from(stored.period),
        }
    }

    /// Whether their gains lie inside the envelope.
    ///
    /// # Errors
    /// Says what is allowed.
    pub fn inside(&self, stored: &Stored) -> Result<(), Outside> {
        let wall = &stored.settings.wall;
        let (k, b) = (wall.stiffness_n_per_m, wall.damping_n_s_per_m);
        self.envelope.allows(&self.key(stored), k, b)
    }

    /// The order to take them.
    ///
    /// # Errors
    /// Names what is out of range.
    pub fn order(&self, stored: &Stored) -> Result<Order, SettingsError> {
        let gains = if self.inside(stored).is_ok() { Gains::Inside } else { Gains::Outside };
        Ok(Order::LoopParameters(self.control(stored)?, gains))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{
        Output, VelocitySettings, WallSettings,
        safety::{
            FaultSet,
            envelope::{Boundary, Point},
        },
    };

    const fn point(damping_n_s_per_m: f64, stiffness_high_n_per_m: f64) -> Point {
        Point { damping_n_s_per_m, stiffness_low_n_per_m: 0.0, stiffness_high_n_per_m }
    }

    static ENVELOPE: Envelope<'static> = Envelope {
        boundaries: &[Boundary {
            key: Key {
                device: "bench",
                estimator: "butterworth",
                cutoff_hz: 1500.0,
                latency_samples: 0.115,
                period_samples: 10.0,
            },
            points: &[point(0.0, 4000.0), point(50.0, 20_000.0)],
        }],
    };

    /// The paper's device, without a sense beside the force.
    pub(crate) static DEVICE: Device = Device {
        key: DeviceKey::of("bench"),
        design: Design {
            rate_hz: 10_000.0,
            resolution_m: 1e-6,
            full_scale_n: 5.906,
            period: 10,
            output: Output::Dac { bits: 12 },
        },
        latency_samples: 0.115,
        senses: &[Sense::Force],
        envelope: &ENVELOPE,
        safety: SafetySettings {
            speed_max_m_per_s: 1.0,
            speed_believable_m_per_s: 5.0,
            travel_low_m: -0.04,
            travel_high_m: 0.11,
            ramp_in_s: 0.2,
            sign_test_force: 0.05,
            sign_test_counts: 200,
        },
        duty: DutySettings { continuous_force_n: 4.1, time_constant_s: 30.0 },
        back: ReturnSettings::SOFT,
        calibration: CalibrationSettings {
            percent: 0.0,
            rise_percent_per_s: 2.0,
            hold_s: 30.0,
            travel_m: 1e-3,
        },
        settings: Settings {
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
            wall: WallSettings {
                position_m: 0.07,
                stiffness_n_per_m: 0.0,
                damping_n_s_per_m: 0.0,
                push_only: true,
            },
        },
        hit: HitSettings { push_n: 0.0, settle_s: 4.0, window_s: 2.0, rms_limit_m: 1.5e-5 },
        walk: WalkSettings {
            stiffness_start_n_per_m: 2000.0,
            stiffness_step_n_per_m: 2000.0,
            stiffness_max_n_per_m: 1e7,
            damping_start_n_s_per_m: 10.0,
            damping_step_n_s_per_m: 10.0,
            damping_max_n_s_per_m: 4000.0,
        },
    };

    fn loaded(stored: Stored) -> Loaded {
        Loaded { stored, source: Source::Newest, damaged: 0 }
    }

    #[track_caller]
    fn refused<T: core::fmt::Debug>(result: Result<T, SettingsError>, parameter: &str) {
        assert_eq!(result.unwrap_err().parameter, parameter);
    }

    #[test]
    fn defaults_are_the_devices_and_can_be_run() {
        let stored = DEVICE.defaults();
        assert_eq!((stored.device.name(), stored.settings), ("bench", DEVICE.settings));
        assert_eq!((stored.settle_s, stored.window_s, stored.start_m), (4.0, 2.0, 0.0));
        assert_eq!((stored.full_scale_n, stored.grid), (5.906, DEVICE.walk));
        let plan = DEVICE.hit_sequence(&stored, true).unwrap();
        let late = DEVICE.hit_sequence(&stored, false).unwrap();
        assert_eq!((plan.look, late.look), (32, HitSequencePlan::NEVER));
        // a motor that stands less gets a shorter hit of the same proportions
        let weak = Device { duty: DutySettings { time_constant_s: 3.0, ..DEVICE.duty }, ..DEVICE };
        let short = weak.defaults();
        assert!(short.settle_s < 2.0 && (short.settle_s - 2.0 * short.window_s).abs() < 1e-12);
        assert!(weak.hit_sequence(&short, false).is_ok());
        refused(weak.hit_sequence(&stored, false), "settle_s and window_s together");
    }

    #[test]
    fn a_hit_starts_inside_the_travel_and_before_the_wall() {
        let with = |start_m, position_m| {
            let mut stored = Stored { start_m, ..DEVICE.defaults() };
            stored.settings.wall.position_m = position_m;
            DEVICE.hit_sequence(&stored, false)
        };
        assert!(with(-0.04, 0.07).is_ok() && with(0.069_99, 0.07).is_ok());
        for (start_m, wall_m) in [(-0.0401, 0.07), (0.07, 0.07), (0.11, 0.2), (f64::NAN, 0.07)] {
            refused(with(start_m, wall_m), "start_m");
        }
        assert!(with(0.1099, 0.2).is_ok());
    }

    /// Whatever the wall is, the settings of experiments can be set one by one; what is printed is then accepted.
    #[test]
    fn settings_of_experiments_do_not_wait_for_a_wall_and_their_printed_ends_are_accepted() {
        for position_m in [-1.0, -0.04, 0.0, 0.07, 1.0] {
            let mut stored = DEVICE.defaults();
            stored.settings.wall.position_m = position_m;
            for start_m in [-0.04, 0.0, 0.11] {
                let stored = Stored { start_m, ..stored };
                assert!(DEVICE.experiment(&stored).is_ok());
                let Err(error) = DEVICE.hit_sequence(&stored, false) else { continue };
                assert!(error.range.start() < error.range.end(), "{error}");
                let [low, high] = crate::ends(&error.range);
                for end in [low, high] {
                    let mut stored = stored;
                    match error.parameter {
                        "start_m" => stored.start_m = end,
                        "position_m" => {
                            stored.settings.wall.position_m = end;
                            stored.start_m = -0.04;
                        }
                        other => panic!("{other}"),
                    }
                    assert_eq!(DEVICE.hit_sequence(&stored, false).err(), None, "{error}");
                }
            }
        }
        for time_constant_s in [3.0, 7.1, 9.7, 13.3] {
            let duty = DutySettings { time_constant_s, ..DEVICE.duty };
            let device = Device { duty, ..DEVICE };
            let long = Stored { settle_s: 50.0, window_s: 50.0, ..device.defaults() };
            let error = device.experiment(&long).unwrap_err();
            assert_eq!(error.parameter, "settle_s and window_s together");
            let [_, most] = crate::ends(&error.range);
            for part in [0.1, 0.333_33, 0.500_05, 2.0 / 3.0] {
                let settle_s = (most * part * 1e5).round() / 1e5;
                let stored = Stored { settle_s, window_s: most - settle_s, ..long };
                assert_eq!(device.experiment(&stored).err(), None, "{most} {part}");
            }
        }
    }

    #[test]
    fn a_calibrated_full_scale_scales_what_the_motor_stands_and_bounds_the_return() {
        let with = |full_scale_n| {
            let stored = Stored { full_scale_n, ..DEVICE.defaults() };
            DEVICE.hit_sequence(&stored, false)
        };
        let nominal = with(5.906).unwrap();
        let weak = with(2.0).unwrap();
        assert_eq!(weak.duty, nominal.duty);
        assert!(weak.back.force() > nominal.back.force());
        for full_scale_n in [5.906 / 3.01, 5.906 * 3.01, f64::NAN] {
            refused(with(full_scale_n), "full_scale_n");
            let stored = Stored { full_scale_n, ..DEVICE.defaults() };
            refused(DEVICE.control(&stored), "full_scale_n");
        }
        assert!(with(5.906 * 2.99).is_ok());
    }

    #[test]
    fn a_board_starts_with_what_was_saved_or_with_the_defaults_and_a_fault() {
        let mut saved = DEVICE.defaults();
        saved.settings.wall.stiffness_n_per_m = 1000.0;
        let start = DEVICE.start(&loaded(saved), None).unwrap();
        assert_eq!((start.stored, start.source, start.fault), (saved, Source::Newest, None));
        assert_eq!(start.control, DEVICE.control(&saved).unwrap());
        let boot = FaultRecord { sample: 7, ..FaultRecord::bare(Fault::WatchdogReset) };
        assert_eq!(DEVICE.start(&loaded(saved), Some(boot)).unwrap().fault, Some(boot));
        // settings that cannot be built, and an estimator that needs what the board has not
        let mut wrong = saved;
        wrong.settings.wall.stiffness_n_per_m = 1e9;
        let blind = blind_estimator().map(|name| {
            let mut blind = saved;
            blind.settings.velocity = name.settings([1000.0, 1.0]);
            blind
        });
        for bad in [Some(wrong), blind].into_iter().flatten() {
            let start = DEVICE.start(&loaded(bad), None).unwrap();
            let found = (start.stored, start.source);
            assert_eq!(found, (DEVICE.defaults(), Source::Unusable));
            assert_eq!(start.control, DEVICE.control(&DEVICE.defaults()).unwrap());
            assert_eq!(start.fault, Some(FaultRecord::bare(Fault::Settings)));
            let both = DEVICE.start(&loaded(bad), Some(boot)).unwrap().fault.unwrap();
            assert_eq!((both.fault, both.sample), (Fault::WatchdogReset, 7));
            let causes = FaultSet::EMPTY.with(Fault::WatchdogReset).with(Fault::Settings);
            assert_eq!(both.causes, causes);
        }
    }

    #[test]
    fn a_board_starts_with_the_period_that_was_saved_if_there_is_one_and_time_for_it() {
        for period in [0, 1, 2, 3, 5, 10, 11, u32::MAX] {
            let saved = Stored { period, ..DEVICE.defaults() };
            let start = DEVICE.start(&loaded(saved), None).unwrap();
            let known = PERIODS.contains(&period);
            let in_force = if known { period } else { 10 };
            assert_eq!((start.stored.period, start.control.period.get()), (in_force, in_force));
            assert_eq!(start.fault.is_none(), known);
            let plan = DEVICE.period(&Stored { period: in_force, ..saved }).unwrap();
            assert_eq!((start.period, plan.keep), (plan, 10 / in_force));
            let safety = DEVICE.safety.build(&Design { period: in_force, ..DEVICE.design });
            assert_eq!(Ok(start.safety), safety);
            assert_eq!(DEVICE.hit_sequence(&start.stored, true).unwrap().look, 320 / in_force);
        }
        // with an estimator that leaves no time for it
        let slow = EstimatorName::ALL.iter().find(|name| leaves_time(**name, 1).is_err());
        if let Some(&name) = slow {
            let [first, second] = name.parameters().map(|p| p.map_or(0.0, |p| p.default));
            let mut saved = Stored { period: 1, ..DEVICE.defaults() };
            saved.settings.velocity = name.settings([first, second]);
            assert_eq!(DEVICE.start(&loaded(saved), None).unwrap().source, Source::Unusable);
            saved.period = 2;
            assert_eq!(DEVICE.start(&loaded(saved), None).unwrap().source, Source::Newest);
        }
    }

    /// An estimator that needs more than the board has, if this build knows one.
    pub(crate) fn blind_estimator() -> Option<EstimatorName> {
        let names = EstimatorName::ALL.iter().copied();
        names.into_iter().find(|name| name.missing(DEVICE.senses).is_some())
    }

    #[test]
    fn numbers_of_the_device_that_are_not_allowed_are_named() {
        let named = |device: Device, parameter| {
            refused(device.start(&loaded(DEVICE.defaults()), None), parameter);
        };
        let safety = SafetySettings { ramp_in_s: 0.0, ..DEVICE.safety };
        named(Device { safety, ..DEVICE }, "ramp_in_s");
        let duty = DutySettings { continuous_force_n: 6.0, ..DEVICE.duty };
        named(Device { duty, ..DEVICE }, "duty_continuous_force_n");
        let back = ReturnSettings { speed_m_per_s: 2.0, ..DEVICE.back };
        named(Device { back, ..DEVICE }, "return_speed_m_per_s");
    }

    #[test]
    fn the_envelope_is_asked_for_what_is_in_force() {
        let mut stored = DEVICE.defaults();
        stored.settings.wall.stiffness_n_per_m = 4000.0;
        assert_eq!(DEVICE.inside(&stored), Ok(()));
        let expected = Order::LoopParameters(DEVICE.control(&stored).unwrap(), Gains::Inside);
        assert_eq!(DEVICE.order(&stored).unwrap(), expected);
        stored.settings.wall.stiffness_n_per_m = 4001.0;
        assert!(matches!(DEVICE.inside(&stored), Err(Outside::Stiffness { .. })));
        let order = DEVICE.order(&stored).unwrap();
        assert!(matches!(order, Order::LoopParameters(_, Gains::Outside)));
        stored.settings.wall.stiffness_n_per_m = 1000.0;
        stored.settings.velocity = VelocitySettings::Butterworth { cutoff_hz: 1400.0 };
        assert_eq!(DEVICE.inside(&stored), Err(Outside::UnknownKey));
        let late = Device { latency_samples: 5.0, ..DEVICE };
        assert_eq!(late.inside(&DEVICE.defaults()), Ok(())); // no wall is no question
        stored.settings.velocity = DEVICE.settings.velocity;
        assert_eq!(late.inside(&stored), Err(Outside::UnknownKey));
        let fast = Stored { period: 1, ..stored };
        assert_eq!(DEVICE.inside(&stored), Ok(()));
        assert_eq!(DEVICE.inside(&fast), Err(Outside::UnknownKey));
    }

    #[test]
    fn a_calibration_is_bounded() {
        assert!(DEVICE.calibration(&DEVICE.defaults(), 20.0).is_ok());
        refused(DEVICE.calibration(&DEVICE.defaults(), 31.0), "calibrate");
    }
}
