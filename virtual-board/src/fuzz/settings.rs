//! The settings, written down once more from the pages: what each command sets, what it is refused for, what `get`
//! says. Nothing here is the firmware's but the type in which the core takes a wall and an estimator.

use zwidth::{
    Design, LoopParameters, Output, Settings as CoreSettings, VelocitySettings, WallSettings,
};

use crate::board::{Board, Force};

use super::envelope::Envelope;

/// Estimators of the shipped images: name, whether it has a cutoff, the range of that, Hz.
const ESTIMATORS: [(&str, Option<[f64; 2]>); 5] = [
    ("butterworth", Some([0.35, 4990.0])),
    ("butterworth-prewarped", Some([0.35, 3800.0])),
    ("first-order", Some([0.35, 4990.0])),
    ("first-order-prewarped", Some([0.35, 3800.0])),
    ("difference", None),
];

/// The same in the order of the error that lists them.
const LISTED: &str =
    "butterworth butterworth-prewarped first-order first-order-prewarped difference";

/// Force at full command that the image was built for, N: not 5.906 to the last place, so `fullscale 5.906` changes it.
pub(super) const FULL_SCALE_N: f64 = 0.5906 * 10.0;
/// Travel, m.
const TRAVEL_M: [f64; 2] = [-0.04, 0.11];
/// One count, m.
const COUNT_M: f64 = 1e-6;
/// What the motor stands, N, and over what time, s.
const CONTINUOUS: [f64; 2] = [4.1, 30.0];

/// All that is set.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    pub k: f64,
    pub b: f64,
    pub wall_m: f64,
    /// Its place among [`ESTIMATORS`].
    pub estimator: usize,
    pub cutoff_hz: f64,
    pub push_n: f64,
    pub motor_reversed: bool,
    pub encoder_reversed: bool,
    pub full_scale_n: f64,
    pub start_m: f64,
    pub settle_s: f64,
    pub window_s: f64,
    pub rms_m: f64,
    /// K: start, step, cap; B: the same.
    pub grid: [f64; 6],
}

/// Why a value is refused: its name in the reply, the value, and what is allowed.
#[derive(Clone, Debug, PartialEq)]
pub struct OutOfRange {
    pub name: &'static str,
    pub value: f64,
    pub allowed: [f64; 2],
}

fn within(name: &'static str, value: f64, allowed: [f64; 2]) -> Result<(), OutOfRange> {
    let [low, high] = allowed;
    if low <= value && value <= high { Ok(()) } else { Err(OutOfRange { name, value, allowed }) }
}

/// The words of the console that set the grid, in the order of [`Settings::grid`].
pub const GRID: [(&str, &str); 6] = [
    ("kstart", "N/m"),
    ("kstep", "N/m"),
    ("kmax", "N/m"),
    ("bstart", "N s/m"),
    ("bstep", "N s/m"),
    ("bmax", "N s/m"),
];

impl Settings {
    /// Of a board to which nothing was ever saved: no wall, 1500 Hz, the paper's hit as long as the motor stands.
    pub fn defaults() -> Self {
        let longest = 0.99 * longest_hit_s(FULL_SCALE_N);
        let part = f64::min(1.0, longest / 6.0);
        Self {
            k: 0.0,
            b: 0.0,
            wall_m: 0.07,
            estimator: 0,
            cutoff_hz: 1500.0,
            push_n: 0.0,
            motor_reversed: false,
            encoder_reversed: false,
            full_scale_n: FULL_SCALE_N,
            start_m: 0.0,
            settle_s: 4.0 * part,
            window_s: 2.0 * part,
            rms_m: 1.5e-5,
            grid: [2000.0, 5000.0, 1e7, 10.0, 10.0, 1000.0],
        }
    }

    /// Name of the estimator.
    pub fn estimator(&self) -> &'static str {
        ESTIMATORS[self.estimator].0
    }

    /// Its place, by its name in any case.
    pub fn estimator_named(name: &str) -> Option<usize> {
        ESTIMATORS.iter().position(|(known, _)| known.eq_ignore_ascii_case(name))
    }

    /// The names, as the error lists them.
    pub fn estimators() -> &'static str {
        LISTED
    }

    /// It has a cutoff.
    pub fn is_tuned(&self) -> bool {
        ESTIMATORS[self.estimator].1.is_some()
    }

    /// Another estimator keeps the cutoff, or starts with 1500 Hz if the last one had none.
    pub fn take_estimator(&mut self, estimator: usize) {
        if !self.is_tuned() {
            self.cutoff_hz = 1500.0;
        }
        self.estimator = estimator;
    }

    /// Wall and estimator in their ranges: what the loop is made of.
    pub fn loop_range(&self) -> Result<(), OutOfRange> {
        let factor = FULL_SCALE_N / 3.0;
        within("full_scale_n", self.full_scale_n, [factor, FULL_SCALE_N * 3.0])?;
        within("stiffness_n_per_m", self.k, [0.0, 1e7])?;
        within("damping_n_s_per_m", self.b, [0.0, 1e4])?;
        if let Some(range) = ESTIMATORS[self.estimator].1 {
            within("cutoff_hz", self.cutoff_hz, range)?;
        }
        within("position_m", self.wall_m, [-1073.741824, 1073.741824])?;
        // A gain is a product with 2^30 / full scale, at least 2^-33 of what the force counts in.
        let lsb_per_n = 2f64.powi(30) / self.full_scale_n;
        for (name, value, lsb) in [
            ("stiffness_n_per_m", self.k, COUNT_M * lsb_per_n),
            ("damping_n_s_per_m", self.b, COUNT_M * 1e4 / 65_536.0 * lsb_per_n),
        ] {
            if value != 0.0 {
                within(name, value, [2f64.powi(-32) / lsb, 2f64.powi(53) / lsb])?;
            }
        }
        Ok(())
    }

    /// What a hit is made of, whatever the wall is.
    pub fn experiment_range(&self) -> Result<(), OutOfRange> {
        let full = self.full_scale_n;
        within("full_scale_n", full, [FULL_SCALE_N / 3.0, FULL_SCALE_N * 3.0])?;
        within("rms_limit_m", self.rms_m, [1e-3 * COUNT_M, 65_535.0 * COUNT_M])?;
        within("push_n", self.push_n, [-full, full])?;
        let longest = f64::from(1 << 24) / 1e4;
        within("settle_s", self.settle_s, [1e-4, longest])?;
        within("window_s", self.window_s, [1e-4, longest])?;
        within("start_m", self.start_m, TRAVEL_M)?;
        let both = self.settle_s + self.window_s;
        within("settle_s and window_s together", both, [0.0, longest_hit_s(full)])
    }

    /// The same with the wall: a hit starts within the travel and before the wall.
    pub fn hit_range(&self) -> Result<(), OutOfRange> {
        self.experiment_range()?;
        let [low, high] = TRAVEL_M;
        within("position_m", self.wall_m, [low + COUNT_M, 1073.741824])?;
        within("start_m", self.start_m, [low, f64::min(self.wall_m, high) - COUNT_M])
    }

    /// What a pulse train of that force needs: no wall with a force, a start before its surface.
    pub fn pulses_range(&self, push_n: f64) -> Result<(), OutOfRange> {
        within("stiffness_n_per_m", self.k, [0.0, 0.0])?;
        within("damping_n_s_per_m", self.b, [0.0, 0.0])?;
        self.hit_range()?;
        within("push_n", push_n, [-self.full_scale_n, self.full_scale_n])
    }

    /// What a walk is made of.
    pub fn grid_range(&self) -> Result<(), OutOfRange> {
        let [k, k_step, k_max, b, b_step, b_max] = self.grid;
        let steps = |max: f64| [f64::max(max / 1e6, 1e-9), max];
        within("stiffness_max_n_per_m", k_max, [1e-9, 1e7])?;
        within("stiffness_start_n_per_m", k, [1e-9, k_max])?;
        within("stiffness_step_n_per_m", k_step, steps(k_max))?;
        within("damping_max_n_s_per_m", b_max, [1e-9, 1e4])?;
        within("damping_start_n_s_per_m", b, [0.0, b_max])?;
        within("damping_step_n_s_per_m", b_step, steps(b_max))
    }

    /// Whether the wall is inside the envelope.
    pub fn inside(&self, envelope: &Envelope) -> Result<(), String> {
        let cutoff_hz = if self.is_tuned() { self.cutoff_hz } else { 0.0 };
        envelope.allows(self.estimator(), cutoff_hz, self.k, self.b)
    }

    /// What the core makes of wall and estimator.
    pub fn parameters(&self, board: Board) -> Option<LoopParameters> {
        let cutoff_hz = self.cutoff_hz;
        let velocity = match self.estimator() {
            "butterworth" => VelocitySettings::Butterworth { cutoff_hz },
            "butterworth-prewarped" => VelocitySettings::ButterworthPrewarped { cutoff_hz },
            "first-order" => VelocitySettings::FirstOrder { cutoff_hz },
            "first-order-prewarped" => VelocitySettings::FirstOrderPrewarped { cutoff_hz },
            _ => VelocitySettings::Difference {},
        };
        let wall = WallSettings {
            position_m: self.wall_m,
            stiffness_n_per_m: self.k,
            damping_n_s_per_m: self.b,
            push_only: true,
        };
        let design = Design {
            rate_hz: 1e4,
            resolution_m: COUNT_M,
            full_scale_n: self.full_scale_n,
            period: 10,
            output: match board.wiring.force {
                Force::Dac { .. } => Output::Dac { bits: 12 },
                Force::Pwm { .. } => Output::Pwm { steps: 4200 },
            },
        };
        CoreSettings { velocity, wall }.build(&design).ok()
    }

    /// What `get` says.
    pub fn text(&self, device: &str) -> String {
        let sign = |reversed| if reversed { '-' } else { '+' };
        let [k, k_step, k_max, b, b_step, b_max] = self.grid;
        let cutoff =
            if self.is_tuned() { format!("cutoff {} Hz, ", self.cutoff_hz) } else { String::new() };
        format!(
            "ok get k {} N/m, b {} N s/m, wall {} m, {cutoff}estimator {}, push {} N, push only, device {device}, \
             motor {}, encoder {}, full scale {} N, start {} m, settle {} s, window {} s, rms {} m, \
             walk k {k} step {k_step} to {k_max} N/m, b {b} step {b_step} to {b_max} N s/m, period 10 samples",
            self.k,
            self.b,
            self.wall_m,
            self.estimator(),
            self.push_n,
            sign(self.motor_reversed),
            sign(self.encoder_reversed),
            self.full_scale_n,
            self.start_m,
            self.settle_s,
            self.window_s,
            self.rms_m,
        )
    }
}

/// The longest hit at full force that leaves a cold motor below its limit: it warms by 1 - exp(-t / tau), one part
/// in a thousand is kept in reserve, and 50 outputs for the force to come and go.
fn longest_hit_s(full_scale_n: f64) -> f64 {
    let [force_n, tau_s] = CONTINUOUS;
    // A calibration finds another force for the same current.
    let part = force_n * (full_scale_n / FULL_SCALE_N) / full_scale_n;
    let kept = (1.0 - part * part) / (1.0 - 1e-3);
    let outputs = kept.ln() / (-1e-3 / tau_s).ln_1p();
    f64::max(0.0, (outputs - 50.0).floor() * 1e-3)
}
