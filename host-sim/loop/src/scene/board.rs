//! The tables that a board needs and the simulator does not: `[board]`, `[safety]`, `[motor]` and `[return]`.
//!
//! The simulator only checks these tables. A value for an absent key is guessed here from the rest of the scene.
//! `prepare` lists the guesses. The guesses are scaled from the values of the paper's device.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use zwidth::{
    experiment::{CalibrationSettings, DutySettings, ReturnSettings},
    period::PERIODS,
    safety::{CurrentSettings, SafetySettings},
    store::{Name, Signs},
    velocity::{EstimatorName, Sense},
};

use super::{Scene, Units};
use crate::scene::element::Travel;

/// The board, and the firmware's settings at the first start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoardTable {
    /// `nucleo-f446re` or `discovery-f407`.
    pub name: String,
    /// Cutoff of a board without saved settings. The envelope contains the walls of this cutoff. Absent:
    /// `velocity.cutoff_hz`, else the cutoff that quiet walls recommend.
    pub cutoff_hz: Option<f64>,
    /// Name of the active design of a board without saved settings. Absent: the first estimator is active.
    pub design: Option<String>,
    /// Estimators of the envelope, beside the designs. The first is active at the start. Absent: the scene's estimator.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub estimators: Vec<String>,
    /// Output periods of the envelope, in samples, beside `actuator.period`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub periods: Vec<u32>,
    /// Direction of the motor. `-`: a positive command pushes out of the wall. Absent: `+`.
    pub motor: Option<Sign>,
    /// Direction of the encoder. `-`: the count falls on the way into the wall. Absent: `+`.
    pub encoder: Option<Sign>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Sign {
    /// A positive count or command goes into the wall.
    #[serde(rename = "+")]
    Plus,
    /// A positive count or command goes out of the wall.
    #[serde(rename = "-")]
    Minus,
}

/// Limits of the supervisor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SafetyTable {
    /// Speed above which the force is switched off. Absent: 1, or the largest speed that the velocity can represent.
    pub speed_max_m_per_s: Option<f64>,
    /// Largest possible speed of the handle; a larger speed is a fault. Absent: five times `speed_max_m_per_s`.
    pub speed_believable_m_per_s: Option<f64>,
    /// Lowest position at which force may be on, inside a rigid stop. Absent: the end of `[travel]`, else 40 mm before
    /// the start.
    pub travel_low_m: Option<f64>,
    /// Highest position at which force may be on. Absent: the end of `[travel]`, else 40 mm beyond the wall.
    pub travel_high_m: Option<f64>,
    /// Time of the ramp from no force to full force. Absent: 0.2.
    pub ramp_in_s: Option<f64>,
    /// Force of the sign test, as a fraction of full scale. Absent: 0.05.
    pub sign_test_force: Option<f64>,
    /// Counts that the sign test must detect. Absent: 22 % of the free handle's motion.
    pub sign_test_counts: Option<u32>,
    /// Mass of the heaviest handle for a push, including hand and arm. Absent: 20 times the device's mass.
    pub heaviest_mass_kg: Option<f64>,
    /// Damping of the heaviest handle. Absent: 20 times the device's damping, and at least the heaviest mass divided by
    /// 0.1 s.
    pub heaviest_damping_n_s_per_m: Option<f64>,
    /// Motion of the handle that ends a calibration. Absent: 1 mm, at least 4 counts.
    pub calibration_travel_m: Option<f64>,
}

/// Limits of the motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotorTable {
    /// Force that the motor can give without a time limit. Absent: 70 % of full scale.
    pub continuous_force_n: Option<f64>,
    /// Thermal time constant of the winding. Absent: 30.
    pub time_constant_s: Option<f64>,
    /// Voltage of the amplifier's current output at zero current, as a fraction of the board's analogue supply. Absent:
    /// the input is not used, and `current_sense_full` must be absent too.
    pub current_sense_rest: Option<f64>,
    /// Voltage of the amplifier's current output at full command, as a fraction of the board's analogue supply.
    pub current_sense_full: Option<f64>,
}

impl MotorTable {
    /// Checks that the scene has both keys of the current signal, or neither of them. The firmware would read an absent
    /// key as 0.
    fn check_current(&self) -> Result<(), String> {
        let (rest, full) = ("motor.current_sense_rest", "motor.current_sense_full");
        let (missing, key, value) = match (self.current_sense_rest, self.current_sense_full) {
            (Some(value), None) => (full, rest, value),
            (None, Some(value)) => (rest, full, value),
            _ => return Ok(()),
        };
        Err(format!("{missing} is missing, {key} is {value}, allowed both or neither"))
    }

    /// The settings of the current input. Without the two keys the input is not used.
    fn current(&self) -> CurrentSettings {
        CurrentSettings {
            rest: self.current_sense_rest.unwrap_or_default(),
            full: self.current_sense_full.unwrap_or_default(),
        }
    }
}

/// The return move between two hits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReturnTable {
    /// Speed of the return.
    pub speed_m_per_s: Option<f64>,
    /// Largest force of the return.
    pub force_n: Option<f64>,
    /// Proportional gain of the return's controller.
    pub stiffness_n_per_m: Option<f64>,
    /// Derivative gain of the return's controller.
    pub damping_n_s_per_m: Option<f64>,
    /// Integral gain of the return's controller.
    pub integral_n_per_m_s: Option<f64>,
    /// Distance from the start at which the return ends. Absent: 50 um, at least 4 counts.
    pub tolerance_m: Option<f64>,
    /// Longest time of the return. Absent: 10.
    pub timeout_s: Option<f64>,
}

/// All values of a device that a board needs.
#[derive(Clone, Debug, PartialEq)]
pub struct OnBoard {
    pub safety: SafetySettings,
    pub calibration: CalibrationSettings,
    pub duty: DutySettings,
    /// Scale of the amplifier's current output.
    pub current: CurrentSettings,
    pub back: ReturnSettings,
    pub signs: Signs,
    pub guessed: Vec<Guess>,
}

/// A key that the scene leaves out, and the value that is guessed for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guess {
    key: &'static str,
    at_handle: f64,
}

impl Guess {
    /// The guess as the text `KEY VALUE`, in the scene's units.
    pub fn told(&self, units: Units) -> String {
        match units.key(self.key) {
            Some((key, factor)) => {
                format!("{key} {}", zwidth::shorten(Units::told(self.at_handle, factor)))
            }
            None => format!("{} {}", self.key, self.at_handle),
        }
    }

    /// The key as a linear scene names it.
    pub fn key(&self) -> &'static str {
        self.key
    }
}

/// Reads keys from tables, and guesses absent values.
struct Keys(Vec<Guess>);

impl Keys {
    fn or(&mut self, key: &'static str, given: Option<f64>, guess: f64) -> f64 {
        given.unwrap_or_else(|| {
            let at_handle = zwidth::shorten(guess);
            self.0.push(Guess { key, at_handle });
            at_handle
        })
    }
}

/// Full scale of the paper's device in N. Guesses are scaled from this force.
const PAPER_FULL_SCALE_N: f64 = 5.906;
/// Part of the free handle's motion that the sign test must detect.
const SIGN_PART: f64 = 0.22;
/// Guessed mass of the heaviest handle, divided by the mass of the device. The factor allows for a hand on the handle
/// and for the error of the guess.
const HEAVIEST: f64 = 20.0;
/// Longest time constant (mass / damping) of the heaviest handle, in s.
const HEAVIEST_S: f64 = 0.1;
/// A quarter of the time that the sign test takes, in s. `src/safety/sign.rs` has the equation.
const SIGN_QUARTER_S: f64 = 0.025;
/// Smallest distance that is guessed, in counts. It is four counts, and a margin for the digits that a shortened guess
/// loses.
const LEAST_COUNTS: f64 = 4.0 * (1.0 + 1e-8);
/// Travel before the start and beyond the wall if the scene has no `[travel]`, in m.
const ROOM_M: f64 = 0.04;

impl Scene {
    /// Motion of the free handle in the sign test, in m. It is 2 f h^2 / m. `force` is a fraction of full scale.
    pub fn sign_test_m(&self, force: f64) -> f64 {
        2.0 * force * self.full_scale_n() * SIGN_QUARTER_S.powi(2) / self.device.mass_kg
    }

    /// All values that a board needs, with guesses for absent keys.
    pub fn on_board(&self) -> OnBoard {
        let full_n = self.full_scale_n();
        let count_m = self.encoder.resolution_m;
        let fastest = 32_766.0 * count_m * self.control.rate_hz;
        let safety = self.safety.unwrap_or_default();
        let motor = self.motor.unwrap_or_default();
        let back = self.back.unwrap_or_default();
        let mut keys = Keys(vec![]);
        let [low_m, high_m] = match self.travel {
            Some(Travel::Spring { low_m, high_m, .. } | Travel::Rigid { low_m, high_m, .. }) => {
                [low_m, high_m]
            }
            None => [self.device.start_position_m - ROOM_M, self.wall.position_m + ROOM_M],
        };
        let force = keys.or("safety.sign_test_force", safety.sign_test_force, 0.05);
        let counts =
            (SIGN_PART * self.sign_test_m(force) / count_m).round().clamp(10.0, 1_048_576.0);
        let counts = safety
            .sign_test_counts
            .map(f64::from)
            .unwrap_or_else(|| keys.or("safety.sign_test_counts", None, counts));
        let speed = keys.or("safety.speed_max_m_per_s", safety.speed_max_m_per_s, fastest.min(1.0));
        let believable = (5.0 * speed).min(fastest);
        let heaviest = keys.or(
            "safety.heaviest_mass_kg",
            safety.heaviest_mass_kg,
            HEAVIEST * self.device.mass_kg,
        );
        let settings = SafetySettings {
            speed_max_m_per_s: speed,
            speed_believable_m_per_s: keys.or(
                "safety.speed_believable_m_per_s",
                safety.speed_believable_m_per_s,
                believable,
            ),
            travel_low_m: keys.or("safety.travel_low_m", safety.travel_low_m, low_m.min(-count_m)),
            travel_high_m: keys.or(
                "safety.travel_high_m",
                safety.travel_high_m,
                high_m.max(count_m),
            ),
            ramp_in_s: keys.or("safety.ramp_in_s", safety.ramp_in_s, 0.2),
            sign_test_force: force,
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "10 to 2^20"
            )]
            sign_test_counts: counts as u32,
            heaviest_mass_kg: heaviest,
            heaviest_damping_n_s_per_m: keys.or(
                "safety.heaviest_damping_n_s_per_m",
                safety.heaviest_damping_n_s_per_m,
                f64::max(HEAVIEST * self.device.damping_n_s_per_m, heaviest / HEAVIEST_S),
            ),
            passive_acceleration_m_per_s2: self.passivity.map_or(0.0, |_| self.acceleration()),
        };
        let travel_m = f64::max(1e-3, LEAST_COUNTS * count_m);
        let calibration = CalibrationSettings {
            percent: 0.0,
            rise_percent_per_s: 2.0, // slow enough for a person to follow the push and stop it
            hold_s: 30.0,
            travel_m: keys.or("safety.calibration_travel_m", safety.calibration_travel_m, travel_m),
        };
        let duty = DutySettings {
            continuous_force_n: keys.or(
                "motor.continuous_force_n",
                motor.continuous_force_n,
                0.7 * full_n,
            ),
            time_constant_s: keys.or("motor.time_constant_s", motor.time_constant_s, 30.0),
        };
        let (soft, part) = (ReturnSettings::SOFT, f64::min(1.0, full_n / PAPER_FULL_SCALE_N));
        let tolerance_m = soft.tolerance_m.max(LEAST_COUNTS * count_m);
        let back = ReturnSettings {
            start_m: self.device.start_position_m,
            speed_m_per_s: keys.or("return.speed_m_per_s", back.speed_m_per_s, soft.speed_m_per_s),
            force_n: keys.or("return.force_n", back.force_n, soft.force_n * part),
            stiffness_n_per_m: keys.or(
                "return.stiffness_n_per_m",
                back.stiffness_n_per_m,
                soft.stiffness_n_per_m * part,
            ),
            damping_n_s_per_m: keys.or(
                "return.damping_n_s_per_m",
                back.damping_n_s_per_m,
                soft.damping_n_s_per_m * part,
            ),
            integral_n_per_m_s: keys.or(
                "return.integral_n_per_m_s",
                back.integral_n_per_m_s,
                soft.integral_n_per_m_s * part,
            ),
            tolerance_m: keys.or("return.tolerance_m", back.tolerance_m, tolerance_m),
            timeout_s: keys.or("return.timeout_s", back.timeout_s, soft.timeout_s),
        };
        let minus = |sign: fn(&BoardTable) -> Option<Sign>| {
            self.board.as_ref().and_then(sign) == Some(Sign::Minus)
        };
        let signs = Signs {
            motor_reversed: minus(|board| board.motor),
            encoder_reversed: minus(|board| board.encoder),
        };
        let current = motor.current();
        OnBoard { safety: settings, calibration, duty, current, back, signs, guessed: keys.0 }
    }

    /// Checks the tables that a board needs. A table that the scene does not have is not checked.
    pub(super) fn check_board(&self) -> Result<(), String> {
        let Self { board, safety, motor, back, .. } = self;
        if let Some(board) = board {
            board.check(self)?;
        }
        let design = self.design();
        let OnBoard { safety: limits, calibration, duty, current, back: returned, .. } =
            self.on_board();
        let keyed = |table: &'static str| {
            move |error: zwidth::SettingsError| {
                let name = error.parameter;
                let bare = name.strip_prefix("return_").or(name.strip_prefix("duty_"));
                let key = match (bare.unwrap_or(name), table) {
                    ("travel_m", _) => "calibration_travel_m",
                    (key, _) => key,
                };
                crate::range::refused(&format!("{table}.{key}"), error.value, &error.range)
            }
        };
        if safety.is_some() {
            limits.build(&design).map_err(keyed("safety"))?;
            calibration.build(&design).map_err(keyed("safety"))?;
        }
        if let Some(motor) = motor {
            motor.check_current()?;
            duty.build(&design, 0).map_err(keyed("motor"))?;
            current.build(design.output).map_err(keyed("motor"))?;
        }
        if back.is_some() {
            returned.build(&design).map_err(keyed("return"))?;
        }
        Ok(())
    }

    /// The estimators that an envelope for a board covers. The first is active at the start.
    ///
    /// # Errors
    /// A name is not an estimator, or the board lacks what an estimator needs.
    pub fn board_estimators(&self) -> Result<Vec<EstimatorName>, String> {
        let named = self.board.as_ref().map_or(&[][..], |board| &board.estimators);
        let own = self.velocity.estimator();
        let names = named.iter().map(|name| {
            let known = EstimatorName::ALL.iter().map(|name| name.text());
            let known = || known.clone().collect::<Vec<_>>().join(", ");
            name.parse().map_err(|_| match EstimatorName::replacing(name) {
                Some(other) => {
                    format!("board.estimators has `{name}`, which is no more: use {other}")
                }
                None => format!("board.estimators has `{name}`, allowed {}", known()),
            })
        });
        let names: Vec<EstimatorName> = names.collect::<Result<_, _>>()?;
        let names = if names.is_empty() { vec![own] } else { names };
        for name in &names {
            if let Some(sense) = name.missing(&[Sense::Force]) {
                let (name, sense) = (name.text(), sense.text());
                return Err(format!("board.estimators has `{name}`, which needs {sense}"));
            }
        }
        Ok(names)
    }

    /// The output periods that an envelope for a board covers. The scene's own period is the first.
    pub fn board_periods(&self) -> Vec<u32> {
        let named = self.board.as_ref().map_or(&[][..], |board| &board.periods);
        let own = self.actuator.period;
        std::iter::once(own).chain(named.iter().copied().filter(|&other| other != own)).collect()
    }
}

impl BoardTable {
    fn check(&self, scene: &Scene) -> Result<(), String> {
        if Name::new(&self.name).is_none() || self.name.is_empty() {
            let most = Name::LEN;
            return Err(format!("board.name is `{}`, allowed 1 to {most} bytes", self.name));
        }
        // Without `board.estimators`, the only estimator is the scene's estimator. Any estimator is accepted here,
        // because `prepare` checks the scene's estimator.
        let estimators = match self.estimators.is_empty() {
            true => vec![scene.velocity.estimator()],
            false => scene.board_estimators()?,
        };
        let twice = |n: usize| estimators.iter().skip(n + 1).any(|other| *other == estimators[n]);
        if let Some(n) = (0..estimators.len()).find(|&n| twice(n)) {
            return Err(format!("board.estimators has `{}` twice", estimators[n].text()));
        }
        let allowed = PERIODS.map(|period| period.to_string()).join(", ");
        for period in scene.board_periods() {
            if !PERIODS.contains(&period) {
                return Err(format!("board.periods has {period}, allowed {allowed}"));
            }
        }
        if let Some(cutoff_hz) = self.cutoff_hz {
            let settings = estimators[0].defaults().with_tuning(cutoff_hz);
            if settings.cutoff_hz().is_none() {
                let name = estimators[0].text();
                return match self.estimators.is_empty() {
                    true => Ok(()), // the cutoff is only for estimators that have one
                    false => Err(format!(
                        "board.cutoff_hz is {cutoff_hz}, the estimator {name} has none"
                    )),
                };
            }
            settings.build(&scene.design()).map_err(|error| {
                crate::range::refused("board.cutoff_hz", error.value, &error.range)
            })?;
        }
        Ok(())
    }
}
