//! Delay and noise of an estimator alone, on prescribed motions, by the core's own arithmetic.
//!
//! | figure | motion |
//! |--------|--------|
//! | delay, phase | a sine of up to 100 counts per sample, as fast as the actuator's force can make it |
//! | noise at rest | the count flickers between two neighbours at random, the worst place to rest |
//! | noise in motion | constant speeds of 0.01 to 3 counts per sample, none a simple fraction |

use std::f64::consts::PI;

use zwidth::{SettingsError, units::Force};

use crate::{
    controller::{Controller, Fixed},
    scene::Scene,
    sensing::{Full, Handle, Sensing},
};

/// Delay and noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Delay of a slow sine, s; negative if it leads.
    pub delay_s: f64,
    /// Phase at 100 Hz against the true velocity, degrees; negative is late.
    pub phase_100_hz_deg: f64,
    /// RMS of the velocity at rest with a flickering count, m/s.
    pub noise_at_rest_m_per_s: f64,
    /// RMS of the error at constant speeds, m/s: the largest over the speeds.
    pub noise_in_motion_m_per_s: f64,
}

/// Frequency at which the delay is read, as a fraction of the rate.
const SLOW: f64 = 5e-4;
/// Fastest speed of the sines, counts per sample.
const FAST_COUNTS: f64 = 100.0;
/// Samples before anything is looked at: the slowest filters have settled.
const WARM_UP: u32 = 20_000;
const SAMPLES: u32 = 40_000;
/// Speeds, counts per sample.
const SPEEDS: [f64; 6] = [0.010_618, 0.038_197, 0.123_606, 0.381_966, 1.127_3, 2.902_7];

/// A motion: position in counts and speed in counts per sample, at a sample.
type Motion<'a> = dyn FnMut(u32) -> [f64; 2] + 'a;

/// Measures the estimator of that scene at that cutoff. What it needs beside the position it is
/// given: the force that a free mass would need for the motion, its acceleration, its edges.
///
/// # Errors
/// A parameter is out of range.
pub fn measure(scene: &Scene, cutoff_hz: f64) -> Result<Signal, SettingsError> {
    let bench = Bench { scene, cutoff_hz };
    let count_per_sample = scene.encoder.resolution_m * scene.control.rate_hz;
    let rate_hz = scene.control.rate_hz;
    let slow = bench.sine(SLOW)?;
    let fast = bench.sine(100.0 / rate_hz)?;
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut flicker = |_| {
        // xorshift64: the flicker must be the same in every run and on every machine
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        [if state >> 40 & 1 == 1 { 1.25 } else { 0.75 }, 0.0]
    };
    let at_rest = bench.noise(&mut flicker, 0.0)?;
    let mut in_motion = 0f64;
    for speed in SPEEDS {
        in_motion = in_motion.max(bench.noise(&mut |n| [speed * f64::from(n), speed], speed)?);
    }
    Ok(Signal {
        delay_s: -slow / (2.0 * PI * SLOW * rate_hz),
        phase_100_hz_deg: fast.to_degrees(),
        noise_at_rest_m_per_s: at_rest * count_per_sample,
        noise_in_motion_m_per_s: in_motion * count_per_sample,
    })
}

struct Bench<'a> {
    scene: &'a Scene,
    cutoff_hz: f64,
}

impl Bench<'_> {
    /// RMS of the velocity's distance from `speed`, counts per sample.
    fn noise(&self, motion: &mut Motion<'_>, speed: f64) -> Result<f64, SettingsError> {
        let mut sum = 0.0;
        self.run(motion, |_, velocity| sum += (velocity - speed).powi(2))?;
        Ok((sum / f64::from(SAMPLES)).sqrt())
    }

    /// Speed of a sine whose acceleration takes 80 % of the actuator's force, counts per sample: an
    /// observer cannot be told more.
    fn fastest(&self, omega: f64) -> f64 {
        let (scene, rate_hz) = (self.scene, self.scene.control.rate_hz);
        let acceleration = 0.8 * scene.full_scale_n() / scene.device.mass_kg;
        acceleration / (rate_hz * rate_hz * scene.encoder.resolution_m) / omega
    }

    /// Phase in radians at `frequency` cycles per sample, against the true velocity.
    fn sine(&self, frequency: f64) -> Result<f64, SettingsError> {
        let omega = 2.0 * PI * frequency;
        let fast = FAST_COUNTS.min(self.fastest(omega));
        let amplitude = fast / omega;
        // a whole number of periods
        let samples = (f64::from(SAMPLES) * frequency).floor() / frequency;
        let (mut re, mut im) = (0.0, 0.0);
        let mut motion = |n| {
            let angle = omega * f64::from(n);
            [amplitude * angle.sin(), fast * angle.cos()]
        };
        self.run(&mut motion, |n, velocity| {
            if f64::from(n) < samples {
                let angle = omega * f64::from(n + WARM_UP);
                re += velocity * angle.cos();
                im += velocity * angle.sin();
            }
        })?;
        // the true velocity is in phase with cos(angle); late by phi it is cos(angle + phi), phi < 0
        Ok((-im).atan2(re))
    }

    /// Feeds the motion; `each` sees sample number and velocity, counts per sample, after the warm-up.
    fn run(
        &self,
        motion: &mut Motion<'_>,
        mut each: impl FnMut(u32, f64),
    ) -> Result<(), SettingsError> {
        let scene = self.scene;
        let (resolution_m, rate_hz) = (scene.encoder.resolution_m, scene.control.rate_hz);
        let handle = |[position, speed]: [f64; 2]| Handle {
            position_m: position * resolution_m,
            speed_m_per_s: speed * resolution_m * rate_hz,
        };
        #[expect(clippy::cast_possible_truncation, reason = "far within i32")]
        let count = |[position, _]: [f64; 2]| position.floor() as i32;
        let mut here = motion(0);
        let settings = scene.settings(self.cutoff_hz, 0.0, 0.0);
        let mut core = Fixed::new(&settings, &scene.design(), Force::ZERO, count(here))?;
        let mut senses = Full::new(scene);
        for n in 1..WARM_UP + SAMPLES {
            let there = motion(n);
            let acceleration = (there[1] - here[1]) * resolution_m * rate_hz * rate_hz;
            let force_n = scene.device.mass_kg * acceleration;
            senses.moved(handle(here), handle(there), force_n, force_n);
            here = there;
            senses.sample(&mut core, count(here));
            if n >= WARM_UP {
                each(n - WARM_UP, core.velocity());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;
    use zwidth::VelocitySettings;

    fn signal(settings: VelocitySettings) -> Signal {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let (scene, cutoff_hz) = crate::compare::with_estimator(&scene, &settings);
        measure(&scene, cutoff_hz).unwrap()
    }

    #[test]
    fn delays_and_noise_are_those_of_theory() {
        // T/2 for the difference; T/2 + sqrt(2) / wc with the filter
        let plain = signal(VelocitySettings::Difference);
        assert!((plain.delay_s / 5e-5 - 1.0).abs() < 0.02, "{plain:?}");
        assert!((plain.phase_100_hz_deg + 1.8).abs() < 0.05, "{plain:?}");
        let butterworth =
            signal(VelocitySettings::Butterworth { cutoff_hz: 500.0, prewarp: false });
        assert!((butterworth.delay_s / 5.0e-4 - 1.0).abs() < 0.01, "{butterworth:?}");
        assert!((butterworth.phase_100_hz_deg + 18.2).abs() < 0.1, "{butterworth:?}");
        // a fair coin per sample: half of the differences are +-1 count, 10 mm/s each
        assert!((plain.noise_at_rest_m_per_s / (0.01 * 0.5f64.sqrt()) - 1.0).abs() < 0.02);
        assert!(butterworth.noise_at_rest_m_per_s < 0.1 * plain.noise_at_rest_m_per_s);
        assert!(butterworth.noise_in_motion_m_per_s < plain.noise_in_motion_m_per_s);
        let window = VelocitySettings::LeastSquares { degree: 1, window_samples: 20 };
        assert!((signal(window).delay_s / 1e-3 - 1.0).abs() < 0.01);
        // told the force, the observer is not late, and edge times tell a constant speed
        let observer = signal(VelocitySettings::Observer { bandwidth_hz: 100.0, mass_kg: 0.416 });
        assert!(observer.delay_s.abs() < 2e-5, "{observer:?}");
        assert!(observer.phase_100_hz_deg.abs() < 1.0, "{observer:?}");
        let stamps = signal(VelocitySettings::TimeStamps { span_samples: 8 });
        assert!(
            stamps.noise_in_motion_m_per_s < 1e-2 * plain.noise_in_motion_m_per_s,
            "{stamps:?}"
        );
    }
}
