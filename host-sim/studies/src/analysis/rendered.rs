//! Computes the impedance that the sampled loop renders. A sine moves the handle inside the wall, and the loop responds
//! with a force.
//!
//! The loop of the scene (encoder, estimator in the core's integers, wall, output period, latency) runs with a
//! prescribed motion of [`AMPLITUDE_COUNTS`]. The ratio of the Fourier coefficients of force and motion is the
//! impedance. For a non-linear estimator, this impedance comes from the describing function of the estimator at this
//! amplitude. For a linear estimator, the impedance comes from the frequency response, except for the rounding of the
//! counts. A prescribed motion needs no arm, because any hand feels the force that belongs to the motion. The arm only
//! decides which walls are stable.
//!
//! **Magnitude.** [`Rendered`] stores the estimator's response at [`HZ`], 1 to 30 Hz: `V = a X + c F`. `a` is the
//! velocity per motion. `c` is the velocity per force, for an estimator that gets the force. `c` is 0 except for
//! observers. So one run gives every wall:
//! ```text
//! F = -(K X + B V) at the outputs  =>  V = (a - c K) / (1 + c B),   Z = (K + B V) sinc(w T/2) A(w),   T the output period
//! ```
//! where A is the amplifier. The error of a wall is the maximum of `| |Z| / |K + jwB| - 1 |` over these frequencies.
//! Hold and latency change the phase, and are equal for all estimators. So the error comes from the estimator. With
//! outputs at 1 kHz, the hold adds less than 0.15 %. If the estimator does not get the force, the error depends only on
//! K / B. In this case, the walls with an error above a limit form a sector from the origin in the plane of K and B.

use std::f64::consts::PI;

use nalgebra::Complex;
use zwidth::{VelocitySettings, units::Force, velocity::Sense};

use crate::{
    error::Error,
    numerics::random,
    plant,
    scene::Scene,
    simulation::{
        controller::{Controller, Fixed},
        prepared::WallHit,
        quantiser::Quantiser,
        senses::{Full, Handle, Sensing},
    },
};

/// Amplitude of the motion, in counts. It is as small as in a contact, but covers many counts.
pub const AMPLITUDE_COUNTS: f64 = 100.0;
/// Length of the record, in s. A sine of 1 Hz has two periods in it.
const RECORD_S: f64 = 2.0;
/// Time that the loop settles before the record, in s.
const SETTLE_S: f64 = 1.0;

/// Frequencies at which the magnitude is compared, in Hz. The exact frequencies differ a little. They cover the motion
/// of a hand.
pub const HZ: [f64; 12] = [1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.5, 10.0, 13.0, 17.0, 23.0, 30.0];
/// Stiffness of the wall with which an observer's response to the force is measured, in N/m. This value is so high that
/// the LSB of the force has no effect.
const PROBE_N_PER_M: f64 = 2000.0;

/// The scene with an actuator that does not saturate in the wall, at frequencies up to `highest_hz`.
pub(super) fn unlimited(scene: &Scene, wall: &WallHit, highest_hz: f64) -> Scene {
    let mut scene = scene.clone();
    let depth_m = 4.0 * AMPLITUDE_COUNTS * scene.encoder.resolution_m;
    let fastest = 2.0 * PI * highest_hz * AMPLITUDE_COUNTS * scene.encoder.resolution_m;
    // Noise may add one count per sample to the velocity. The factor 10 is a margin.
    let noise = 10.0 * scene.encoder.resolution_m * scene.control.rate_hz;
    let most_n = wall.stiffness_n_per_m * depth_m + wall.damping_n_s_per_m * (fastest + noise);
    scene.actuator.limit_v *= (2.0 * most_n / scene.full_scale_n()).max(1.0);
    scene.output = None;
    scene.wall.push_only = false; // a wall that only pushes would clip at high B
    scene
}

/// The encoder of a scene. The motion of the handle is prescribed.
struct Encoder<'a> {
    scene: &'a Scene,
    /// Number of this motion. Each motion has its own noise.
    hit: u64,
}

impl Encoder<'_> {
    fn count(&self, sample: u64, position_m: impl Fn(f64) -> f64) -> i32 {
        let scene = self.scene;
        let mut time = sample as f64;
        if let Some(jitter) = &scene.jitter {
            time += jitter.delay_s(jitter.level(self.hit, sample)) * scene.control.rate_hz;
        }
        let shown_m = plant::Sensing::of(scene).shown_m(position_m(time), self.hit, sample);
        Quantiser::of(&scene.encoder).count(shown_m)
    }
}

/// The loop of a scene while a sine moves the handle.
pub(super) struct Sine<'a> {
    scene: &'a Scene,
    pub(super) wall: &'a WallHit,
    /// Number of outputs that the record has.
    outputs: f64,
    /// Exact frequency of the sine, in Hz.
    pub(super) frequency_hz: f64,
}

/// One output of the record.
pub(super) struct Output {
    /// Factor from the force to its contribution to the fundamental. A held force acts like a short push in the middle
    /// of the hold.
    pub(super) acts: Complex<f64>,
    /// Depth behind the surface according to the counts, in m.
    pub(super) depth_m: f64,
    /// True speed of the motion, in m/s.
    pub(super) speed_m_per_s: f64,
    /// Velocity that the estimator gives, in m/s.
    pub(super) velocity_m_per_s: f64,
    /// Force that the wall requests, in N.
    pub(super) force_n: f64,
}

impl<'a> Sine<'a> {
    /// Makes a sine near this frequency. The number of its periods and the number of outputs have no common factor. So
    /// no pattern of counts repeats.
    pub(super) fn new(scene: &'a Scene, wall: &'a WallHit, about_hz: f64) -> Self {
        let output_hz = scene.control.rate_hz / f64::from(scene.actuator.period);
        let periods = (RECORD_S * about_hz).round();
        let mut outputs = (RECORD_S * output_hz).round();
        let common = |mut a: f64, mut b: f64| {
            while b > 0.0 {
                (a, b) = (b, a % b);
            }
            a > 1.0
        };
        while outputs % 2.0 == 0.0 || outputs % 5.0 == 0.0 || common(outputs, periods) {
            outputs -= 1.0;
        }
        Self { scene, wall, outputs, frequency_hz: periods * output_hz / outputs }
    }

    /// Runs the loop. Calls `each` with every output of the record.
    pub(super) fn run(&self, each: impl FnMut(&Output)) -> Result<(), Error> {
        self.run_at(false, each)
    }

    /// Runs the loop. If `samples` is false, calls `each` with every output. If it is true, calls `each` with every
    /// sample and the force of the last output.
    fn run_at(&self, samples: bool, mut each: impl FnMut(&Output)) -> Result<(), Error> {
        let Self { scene, wall, .. } = self;
        let design = scene.design();
        let (resolution_m, rate_hz) = (design.resolution_m, design.rate_hz);
        let settings =
            scene.settings(wall.velocity, wall.stiffness_n_per_m, wall.damping_n_s_per_m);
        let surface = settings.build(&design).map_err(Error::input)?.wall.surface().counts();
        let omega = self.omega();
        let centre = f64::from(surface) + 2.0 * AMPLITUDE_COUNTS;
        let position_m =
            |sample: f64| (centre + AMPLITUDE_COUNTS * (omega * sample).sin()) * resolution_m;
        let speed_m_per_s = |sample: f64| {
            AMPLITUDE_COUNTS * omega * (omega * sample).cos() * resolution_m * rate_hz
        };
        let handle = |sample: f64| Handle {
            position_m: position_m(sample),
            speed_m_per_s: speed_m_per_s(sample),
        };
        let encoder = Encoder { scene, hit: random::bits(self.frequency_hz.to_bits(), 0) };
        let first = encoder.count(0, position_m);
        let mut core = Fixed::new(&settings, &design, Force::ZERO, first).map_err(Error::input)?;
        let mut senses = Full::new(scene, wall.velocity.name().sense());
        let latency = scene.actuator.latency;
        let period = f64::from(design.period);
        let settle = (SETTLE_S * rate_hz / period).round() * period;
        let end = settle + self.outputs * period;
        let (mut index, mut sample, mut force_n) = (0u64, 0.0, 0.0);
        while sample < end {
            let count = encoder.count(index, position_m);
            let due = core.sample(count, senses.senses());
            if due {
                let rendered = core.render();
                senses.granted(rendered.force);
                force_n = rendered.output * design.full_scale_n;
            }
            if sample >= settle && (due || samples) {
                let turn = -omega * (sample + latency + period / 2.0);
                each(&Output {
                    acts: Complex::from_polar(1.0, turn),
                    depth_m: f64::from(count - surface) * resolution_m,
                    speed_m_per_s: speed_m_per_s(sample),
                    velocity_m_per_s: core.velocity() * resolution_m * rate_hz,
                    force_n,
                });
            }
            senses.moved(handle(sample), handle(sample + 1.0));
            (index, sample) = (index + 1, sample + 1.0);
        }
        Ok(())
    }

    /// Angle by which the sine advances per sample, in rad.
    fn omega(&self) -> f64 {
        2.0 * PI * self.frequency_hz / self.scene.control.rate_hz
    }

    /// Fourier coefficient of the force. `sum` is the sum of the contributions of all outputs in the record.
    pub(super) fn force_n(&self, sum: Complex<f64>) -> Complex<f64> {
        let [hold, lag] = self.held();
        sum / self.outputs * hold * lag
    }

    /// Response of the hold, and response of the amplifier.
    fn held(&self) -> [Complex<f64>; 2] {
        let half = self.omega() * f64::from(self.scene.actuator.period) / 2.0;
        let lag = self.scene.amplifier.map_or(Complex::new(1.0, 0.0), |amplifier| {
            Complex::new(1.0, self.frequency_hz / amplifier.bandwidth_hz).inv()
        });
        [(half.sin() / half).into(), lag]
    }

    /// Fourier coefficient of the motion, in m. The motion is x = A sin = A (e - e*) / 2j, where e* is the conjugate of
    /// e.
    pub(super) fn motion(&self) -> Complex<f64> {
        Complex::new(0.0, -AMPLITUDE_COUNTS * self.scene.encoder.resolution_m / 2.0)
    }
}

/// The estimator's response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Answer {
    omega_per_s: f64,
    /// Ratio of the measured position to the motion. The ratio is 1 except for rounding, error and noise of the
    /// encoder.
    position: Complex<f64>,
    /// Velocity divided by the motion, in 1/s.
    by_motion: Complex<f64>,
    /// Velocity divided by the force that the estimator gets, in m/s per N.
    by_force: Complex<f64>,
    /// Response of hold and amplifier. It includes the latency.
    held: Complex<f64>,
}

/// Response of an estimator to the motion of a hand. The frequencies are 1 to 30 Hz.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    answers: Vec<Answer>,
}

impl Rendered {
    /// Measures the response of a filter in a scene.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn of(scene: &Scene, velocity: VelocitySettings) -> Result<Self, Error> {
        let wall = |stiffness_n_per_m| WallHit {
            velocity,
            stiffness_n_per_m,
            damping_n_s_per_m: 0.0,
            start_offset_counts: 0.0,
        };
        let is_told = velocity.name().sense() == Some(Sense::Force);
        let (free, spring) = (wall(0.0), wall(PROBE_N_PER_M));
        let scene = unlimited(scene, &spring, HZ[HZ.len() - 1]);
        let answer = |about_hz: f64| {
            let sine = Sine::new(&scene, &free, about_hz);
            let [position, by_motion, _] = sine.coefficients(is_told)?;
            let by_force = match is_told {
                false => Complex::new(0.0, 0.0),
                true => {
                    let [_, velocity, force] =
                        Sine::new(&scene, &spring, about_hz).coefficients(true)?;
                    (velocity - by_motion) / force
                }
            };
            // The coefficients already contain the delay of hold and latency, so this delay is not added again.
            let [hold, lag] = sine.held();
            let held = hold * lag;
            let omega_per_s = 2.0 * PI * sine.frequency_hz;
            Ok(Answer { omega_per_s, position, by_motion, by_force, held })
        };
        HZ.iter()
            .map(|&hz| answer(hz))
            .collect::<Result<_, Error>>()
            .map(|answers| Self { answers })
    }

    /// Largest relative error of the rendered impedance's magnitude. The commanded impedance is K + jwB.
    pub fn error(&self, stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> f64 {
        let (k, b) = (stiffness_n_per_m, damping_n_s_per_m);
        let error = |answer: &Answer| {
            let commanded = k.hypot(answer.omega_per_s * b);
            (answer.impedance(k, b).norm() / commanded - 1.0).abs()
        };
        self.answers.iter().map(error).fold(0.0, f64::max)
    }
}

impl Answer {
    /// Impedance that the loop renders for this wall, in N/m.
    fn impedance(&self, k: f64, b: f64) -> Complex<f64> {
        let pull = self.by_force * self.position * k;
        let velocity = (self.by_motion - pull) / (self.by_force * b + 1.0);
        (self.position * k + velocity * b) * self.held
    }
}

impl Sine<'_> {
    /// Fourier coefficients of position, velocity and granted force, each divided by that of the motion. An estimator
    /// without a force input does not depend on the output period. So for this estimator all samples are used, and not
    /// only the outputs. This reduces the ripple of the counts.
    fn coefficients(&self, is_told: bool) -> Result<[Complex<f64>; 3], Error> {
        let (mut sums, mut count) = ([Complex::new(0.0, 0.0); 3], 0.0);
        self.run_at(!is_told, |output| {
            let values = [output.depth_m, output.velocity_m_per_s, output.force_n];
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += output.acts * value;
            }
            count += 1.0;
        })?;
        Ok(sums.map(|sum| sum / count / self.motion()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{analysis::linear::transfer_function, scene::NamedScene};
    use zwidth::velocity::EstimatorName;

    fn paper() -> Scene {
        NamedScene::load("paper-1um").unwrap().scene
    }

    /// Walls with K in N/m and B in N s/m. They lie on both sides of K = w B, and in the middle of the sector.
    const WALLS: [[f64; 2]; 5] =
        [[20_000.0, 10.0], [20_000.0, 100.0], [20_000.0, 300.0], [5000.0, 300.0], [0.0, 50.0]];

    /// The error that follows from the estimator's transfer function, at the same frequencies.
    fn linear(scene: &Scene, filter: VelocitySettings, [k, b]: [f64; 2]) -> Option<f64> {
        let design = scene.design();
        let of = transfer_function(&filter, &design).unwrap()?;
        let rendered = Rendered::of(scene, filter).unwrap();
        let error = |answer: &Answer| {
            let w = answer.omega_per_s;
            let velocity = of.at(Complex::from_polar(1.0, -w / design.rate_hz));
            let half = 0.5 * w * f64::from(design.period) / design.rate_hz;
            let rendered = (velocity * b + k).norm() * half.sin() / half;
            (rendered / k.hypot(w * b) - 1.0).abs()
        };
        Some(rendered.answers.iter().map(error).fold(0.0, f64::max))
    }

    /// Error that quantisation causes at an amplitude of 100 counts.
    const ROUNDING: f64 = 1.5e-3;
    /// Error that quantisation causes if a wall is measured alone, only at its outputs, and the damper gives most of
    /// its force. This error is larger for estimators that chatter.
    const ROUNDING_OF_OUTPUTS: f64 = 0.015;
    const CHATTER: f64 = 0.1;

    #[test]
    fn every_linear_estimator_renders_what_its_transfer_function_says() {
        let (mut tried, mut largest) = (0, 0f64);
        for &name in EstimatorName::ALL {
            let settings = match name {
                EstimatorName::Butterworth => VelocitySettings::Butterworth { cutoff_hz: 100.0 },
                _ => name.defaults(),
            };
            let scene = paper();
            for wall in WALLS {
                if let Some(theory) = linear(&scene, settings, wall) {
                    let [k, b] = wall;
                    let error = Rendered::of(&scene, settings).unwrap().error(k, b);
                    assert!(
                        (error - theory).abs() < ROUNDING,
                        "{name:?} {wall:?}: {error} {theory}"
                    );
                    (tried, largest) = (tried + 1, largest.max(theory));
                }
            }
        }
        assert!(tried >= 50 && largest > 0.1, "{tried} {largest}");
    }

    /// Compares the result for each wall with a separate run of the loop at this wall. The estimators have a force
    /// input or are non-linear.
    #[test]
    fn the_walls_follow_from_one_run_as_each_of_them_alone() {
        let observer = |bandwidth_hz| VelocitySettings::Observer { bandwidth_hz, mass_kg: 0.416 };
        let mut largest = 0f64;
        for settings in [
            observer(12.0),
            observer(150.0),
            EstimatorName::LevantExplicit.defaults(),
            EstimatorName::FoawEnd.defaults(),
            EstimatorName::Kalman3.defaults(),
        ] {
            let scene = paper();
            let rendered = Rendered::of(&scene, settings).unwrap();
            for [stiffness_n_per_m, damping_n_s_per_m] in WALLS {
                let (k, b) = (stiffness_n_per_m, damping_n_s_per_m);
                let start_offset_counts = 0.0;
                let wall = WallHit {
                    velocity: settings,
                    stiffness_n_per_m,
                    damping_n_s_per_m,
                    start_offset_counts,
                };
                let scene = unlimited(&scene, &wall, 30.0);
                let alone = HZ.map(|hz| {
                    let sine = Sine::new(&scene, &wall, hz);
                    let mut sum = Complex::new(0.0, 0.0);
                    sine.run(|output| sum += output.acts * output.force_n).unwrap();
                    let rendered = (sine.force_n(sum) / sine.motion()).norm();
                    (rendered / k.hypot(2.0 * PI * sine.frequency_hz * b) - 1.0).abs()
                });
                let alone = alone.into_iter().fold(0.0, f64::max);
                let error = rendered.error(k, b);
                let chatters = matches!(settings, VelocitySettings::LevantExplicit { .. });
                let rounding = if chatters { CHATTER } else { ROUNDING_OF_OUTPUTS };
                let near = (error - alone).abs() < rounding + 0.02 * alone;
                assert!(near, "{settings:?} {k} {b}: {error} {alone}");
                largest = largest.max(alone);
            }
        }
        assert!(largest > 0.5, "{largest}");
    }

    #[test]
    fn a_slow_output_and_an_amplifier_take_from_the_magnitude() {
        let (mut scene, filter) = (paper(), VelocitySettings::Butterworth { cutoff_hz: 1500.0 });
        let spring = |scene: &Scene| Rendered::of(scene, filter).unwrap().error(20_000.0, 0.0);
        (scene.actuator.period, scene.actuator.latency) = (100, 0.0);
        let half = PI * Sine::new(&scene, &free(filter), 30.0).frequency_hz / 100.0;
        let held = 1.0 - half.sin() / half;
        assert!(
            held > 0.1 && (spring(&scene) - held).abs() < ROUNDING,
            "{} {held}",
            spring(&scene)
        );
        scene.actuator.period = 10;
        scene.amplifier = Some(crate::scene::element::Amplifier { bandwidth_hz: 100.0 });
        let lag = 1.0 - 1.0 / 1f64.hypot(0.3);
        assert!((spring(&scene) - lag).abs() < 2.0 * ROUNDING, "{} {lag}", spring(&scene));
    }

    fn free(velocity: VelocitySettings) -> WallHit {
        WallHit {
            velocity,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            start_offset_counts: 0.0,
        }
    }

    #[test]
    fn without_a_model_the_error_depends_on_the_ratio_of_k_and_b() {
        let filter = VelocitySettings::Butterworth { cutoff_hz: 100.0 };
        let rendered = Rendered::of(&paper(), filter).unwrap();
        let one = rendered.error(20_000.0, 100.0);
        assert!((one / rendered.error(2000.0, 10.0) - 1.0).abs() < 1e-12);
        // With a delay of 2.3 ms, at K = w B and 30 Hz, the error is half of w times the delay.
        let middle = rendered.error(2.0 * PI * 30.0 * 100.0, 100.0);
        assert!((middle / (0.5 * 2.0 * PI * 30.0 * 2.3e-3) - 1.0).abs() < 0.15, "{middle}");
        assert!(rendered.error(1e6, 100.0) < 0.02 && one > 0.1, "{one}");
    }
}
