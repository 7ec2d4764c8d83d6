//! Allowed values of a scene: ranges, and the message for a wrong value.

use zwidth::{SettingsError, experiment::quiet};

use super::{
    Criterion, HAND_SWAY, LATENCY_KNOWN_MAX, Protocol, PushBy, Scene,
    velocity::{CUTOFF, key_of},
};
use crate::range::{refused, within};

/// Shortest window with `protocol = "hand"`, in s. The spectrum of a shorter window cannot separate a hand's sway from
/// faster motion.
const WINDOW_OF_HAND_S: f64 = 0.5;
/// Lowest output rate with `protocol = "hand"`, in Hz. Slower outputs cannot show motion that is faster than a hand's
/// sway.
const OUTPUT_OF_HAND_HZ: f64 = 100.0;

/// Allowed ranges of values that only the simulator uses.
pub mod ranges {
    use std::ops::RangeInclusive;

    pub const MASS_KG: RangeInclusive<f64> = 1e-3..=100.0;
    pub const DAMPING_N_S_PER_M: RangeInclusive<f64> = 0.0..=1e6;
    pub const STIFFNESS_N_PER_M: RangeInclusive<f64> = 0.0..=1e9;
    pub const POSITION_M: RangeInclusive<f64> = -1e3..=1e3;
    pub const GAIN_N_PER_V: RangeInclusive<f64> = 1e-6..=1e6;
    /// Largest command of an actuator in V.
    pub const LIMIT_V: RangeInclusive<f64> = 1e-3..=1e3;
    /// Largest number of values in a list.
    pub const VALUES_MAX: usize = 10_000;
    /// Limit of the sensation level in dB.
    pub const FELT_DB: RangeInclusive<f64> = -60.0..=120.0;
    pub const FORCE_RMS_N: RangeInclusive<f64> = 1e-9..=1e6;
    /// Push of a hand in N.
    pub const HAND_N: RangeInclusive<f64> = -1e5..=1e5;
    /// Delay from the encoder's reading to the force, in samples.
    pub const LATENCY: RangeInclusive<f64> = 0.0..=1000.0;
}

/// Shortest window with a sensation level, in s. A shorter window has no frequency bin at 2 Hz.
const FELT_WINDOW_S: f64 = 0.5;
/// Longest window with a sensation level, in samples. The motion of a longer window would take too much memory in
/// lanes.
const FELT_SAMPLES_MAX: u32 = 1 << 17;

impl Scene {
    /// Shortest and longest window with a sensation level, in s.
    pub fn felt_window_s(&self) -> [f64; 2] {
        [FELT_WINDOW_S, f64::from(FELT_SAMPLES_MAX) / self.control.rate_hz]
    }

    /// Checks that a hit of this scene starts before the wall.
    pub(super) fn check_start(&self) -> Result<(), String> {
        let before_wall = *ranges::POSITION_M.start()..=self.wall.position_m;
        within("device.start_position_m", self.device.start_position_m, before_wall)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// One line with key, value and allowed range.
    pub fn check(&self) -> Result<(), String> {
        self.check_loop().and_then(|()| self.check_sweep())
    }

    /// Checks every value except the cutoffs of the sweep. A filter that replaces the scene's filter may not allow
    /// these cutoffs.
    ///
    /// # Errors
    /// The errors of [`check`](Self::check).
    pub fn check_loop(&self) -> Result<(), String> {
        let Self { device, actuator, wall, .. } = self;
        within("device.mass_kg", device.mass_kg, ranges::MASS_KG)?;
        within("device.damping_n_s_per_m", device.damping_n_s_per_m, ranges::DAMPING_N_S_PER_M)?;
        within("device.stiffness_n_per_m", device.stiffness_n_per_m, ranges::STIFFNESS_N_PER_M)?;
        within("device.rest_position_m", device.rest_position_m, ranges::POSITION_M)?;
        within("device.start_position_m", device.start_position_m, ranges::POSITION_M)?;
        within("wall.position_m", wall.position_m, ranges::POSITION_M)?;
        within("actuator.gain_n_per_v", actuator.gain_n_per_v, ranges::GAIN_N_PER_V)?;
        within("actuator.limit_v", actuator.limit_v, ranges::LIMIT_V)?;
        within("actuator.latency", actuator.latency, ranges::LATENCY)?;
        if actuator.latency_known {
            let known = 0.0..=f64::from(LATENCY_KNOWN_MAX);
            within("actuator.latency with latency_known", actuator.latency, known)?;
        }
        let keyed = |error: SettingsError| in_scene(&error);
        self.design().check().map_err(keyed)?;
        self.hit_settings().build(&self.design()).map_err(keyed)?;
        within(
            "wall_hit.push_n with push_by = \"hand\"",
            self.push_n(PushBy::Hand),
            ranges::HAND_N,
        )?;
        within("wall_hit.felt_limit_db", self.wall_hit.felt_limit_db, ranges::FELT_DB)?;
        if self.wall_hit.criterion == Criterion::Felt {
            let (window_s, [least_s, most_s]) = (self.wall_hit.window_s, self.felt_window_s());
            within("wall_hit.window_s with criterion = \"felt\"", window_s, least_s..=most_s)?;
        }
        if let Some(limit_n) = self.wall_hit.force_rms_limit_n {
            within("wall_hit.force_rms_limit_n", limit_n, ranges::FORCE_RMS_N)?;
        }
        self.check_pushes()?;
        self.check_elements()?;
        self.check_accelerometer()?;
        self.check_passivity()?;
        self.check_uncertainty()?;
        self.check_senses()?;
        self.check_board()?;
        self.check_designs()?;
        self.walk_plan().check().map_err(|error| {
            refused(&format!("walk.{}", error.parameter), error.value, &error.range)
        })?;
        self.velocity.check().map_err(keyed)?;
        let Some(filter) = self.velocity.settings() else { return Ok(()) };
        self.settings(filter, 0.0, 0.0).build(&self.design()).map_err(keyed).map(|_| ())
    }

    /// Checks that every push of the criterion and the protocol is within the motor's force.
    fn check_pushes(&self) -> Result<(), String> {
        let hit = &self.wall_hit;
        let (share, why) = match (hit.criterion, hit.protocol) {
            (Criterion::Quiet, Protocol::Hand) => (
                quiet::PUSH_MAX * (1.0 + HAND_SWAY),
                "with quiet walls and protocol = \"hand\", 34 % more",
            ),
            (_, Protocol::Hand) => (1.0 + HAND_SWAY, "with protocol = \"hand\", 30 % more"),
            (Criterion::Quiet, _) => {
                (quiet::PUSH_MAX, "with criterion = \"quiet\", which also tries 3 % more")
            }
            _ => (1.0, "of the motor"),
        };
        let most_n = self.full_scale_n() / share;
        within(&format!("wall_hit.push_n {why}"), self.push_n(PushBy::Motor), -most_n..=most_n)?;
        if !hit.protocol.varies() {
            return Ok(());
        }
        let of = |key: &str| format!("{key} with protocol = \"{}\"", hit.protocol.name());
        if hit.criterion == Criterion::Felt {
            let key = of("wall_hit.criterion");
            return Err(format!("{key} is felt, allowed rms, unsaturated and quiet"));
        }
        if hit.protocol == Protocol::Taps {
            let (start_m, count_m) = (self.device.start_position_m, self.encoder.resolution_m);
            let before_wall = -1000.0..=self.wall.position_m - count_m;
            return within(&of("device.start_position_m"), start_m, before_wall);
        }
        within(&of("wall_hit.window_s"), hit.window_s, WINDOW_OF_HAND_S..=f64::INFINITY)?;
        let output_hz = self.control.rate_hz / f64::from(self.actuator.period);
        within(
            &of("outputs a second, control.rate_hz / actuator.period,"),
            output_hz,
            OUTPUT_OF_HAND_HZ..=self.control.rate_hz,
        )?;
        Ok(())
    }

    fn check_sweep(&self) -> Result<(), String> {
        if self.sweep.cutoffs_hz.is_empty() {
            return Err("sweep.cutoffs_hz is empty, allowed one cutoff or more".into());
        }
        let cutoffs = self.sweep.cutoffs_hz.len();
        if cutoffs > ranges::VALUES_MAX {
            let allowed = ranges::VALUES_MAX;
            return Err(format!("sweep.cutoffs_hz has {cutoffs} values, allowed 1 to {allowed}"));
        }
        for &cutoff_hz in &self.sweep.cutoffs_hz {
            let built = self.settings(self.velocity.at(cutoff_hz), 0.0, 0.0).build(&self.design());
            built.map_err(|error| match key_of(error.parameter) {
                Some(CUTOFF) => refused("sweep.cutoffs_hz", error.value, &error.range),
                _ => in_scene(&error),
            })?;
        }
        Ok(())
    }
}

/// The core's error text. The core's name of the value is replaced by the key of the scene.
fn in_scene(error: &SettingsError) -> String {
    let key = match error.parameter {
        "rate_hz" => "control.rate_hz",
        "resolution_m" => "encoder.resolution_m",
        "full_scale_n" => "actuator.gain_n_per_v * actuator.limit_v",
        "period" => "actuator.period",
        "bits" => "output.bits",
        "steps" => "output.steps",
        "position_m" => "wall.position_m",
        "push_n" => "wall_hit.push_n",
        "settle_s" => "wall_hit.settle_s",
        "window_s" => "wall_hit.window_s",
        "rms_limit_m" => "wall_hit.rms_limit_m",
        other => match key_of(other) {
            Some(key) => return refused(&format!("velocity.{key}"), error.value, &error.range),
            None => other,
        },
    };
    refused(key, error.value, &error.range)
}
