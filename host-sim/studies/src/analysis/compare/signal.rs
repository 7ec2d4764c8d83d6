//! Delay and noise of an estimator alone, on prescribed motions, in the core's arithmetic.
//!
//! | figure | motion | driven by |
//! |--------|--------|-----------|
//! | delay, phase | a sine of up to 100 counts per sample, within the speed that the actuator's force allows | the hand, then the motor |
//! | noise at rest | the count flickers at random between two neighbours, the worst position at rest | nothing |
//! | noise in motion | constant speeds of 0.01 to 3 counts per sample, none a simple fraction | the hand |
//!
//! As on a device, an estimator that uses a force gets only the *motor's* force, never the hand's. If the motor drives,
//! its force gives the device the prescribed motion: `m x'' + b x' + k x`. This force contains the scene's damping and
//! spring, which the estimator does not model. The estimator gets the force when it is granted, as in the firmware. The
//! force acts after the actuator's latency (whole samples). With `actuator.latency_known` the estimator gets the force
//! when it acts.
//!
//! Other inputs are ideal: an accelerometer's reading of the whole motion, and the encoder's edges. Counts and edges
//! come from the same reading of the position. This reading has the scene's rounding and periodic error, but no noise
//! and no jitter. At rest the periodic error is constant and is left out.

use std::f64::consts::PI;

use zwidth::{SettingsError, VelocitySettings, units::Force};

use crate::{
    scene::{Rounding, Scene},
    simulation::{
        controller::{Controller, Fixed},
        quantiser::Quantiser,
        senses::{Full, Handle, Sensing},
    },
};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Delay of the estimate in a slow sine, in s. It is negative if the estimate leads.
    pub delay_s: Driven,
    /// Phase of the estimate against the true velocity at 100 Hz, in degrees. It is negative if the estimate is late.
    pub phase_100_hz_deg: Driven,
    /// RMS of the estimate when the handle rests and the count flickers, in m/s.
    pub noise_at_rest_m_per_s: f64,
    /// RMS of the estimate's error at a constant speed, in m/s. It is the largest value over all speeds.
    pub noise_in_motion_m_per_s: f64,
}

/// A result for two motions: one is driven by the hand, the other by the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Driven {
    /// Result if the hand moves the device. The estimator does not get the hand's force.
    pub hand: f64,
    /// Result if the motor moves the device. The estimator gets the whole motor force.
    pub motor: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum Drive {
    Hand,
    Motor,
}

/// Frequency of the sine with which the delay is measured, as a fraction of the sample rate.
const SLOW: f64 = 5e-4;
/// Largest speed of the sines, in counts per sample.
const FAST_COUNTS: f64 = 100.0;
/// Number of samples before the measurement. After these samples even the slowest filters have settled.
const WARM_UP: u32 = 20_000;
const SAMPLES: u32 = 40_000;
/// Speeds at which the noise in motion is measured, in counts per sample.
const SPEEDS: [f64; 6] = [0.010_618, 0.038_197, 0.123_606, 0.381_966, 1.127_3, 2.902_7];

/// A motion: a function that gives position and speed at a sample number. The position is in counts, with edges at
/// whole numbers. The speed is in counts per sample.
type Motion<'a> = dyn FnMut(u32) -> [f64; 2] + 'a;

/// Measures the filter `velocity` with the values of the scene.
pub fn measure(scene: &Scene, velocity: VelocitySettings) -> Result<Signal, SettingsError> {
    let bench = Bench { scene, velocity };
    let count_per_sample = scene.encoder.resolution_m * scene.control.rate_hz;
    let rate_hz = scene.control.rate_hz;
    let driven = |frequency: f64, scale: f64| {
        let [hand, motor] = [Drive::Hand, Drive::Motor].map(|by| bench.sine(frequency, by));
        Ok::<_, SettingsError>(Driven { hand: scale * hand?, motor: scale * motor? })
    };
    let delay_s = driven(SLOW, -1.0 / (2.0 * PI * SLOW * rate_hz))?;
    let phase_100_hz_deg = driven(100.0 / rate_hz, 180.0 / PI)?;
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut flicker = |_| {
        // Xorshift64 gives the same flicker in every run and on every machine.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        [if state >> 40 & 1 == 1 { 1.25 } else { 0.75 }, 0.0]
    };
    let still = Scene { encoder_error: None, ..scene.clone() };
    let at_rest = Bench { scene: &still, velocity }.noise(&mut flicker, 0.0)?;
    let mut in_motion = 0f64;
    for speed in SPEEDS {
        in_motion = in_motion.max(bench.noise(&mut |n| [speed * f64::from(n), speed], speed)?);
    }
    Ok(Signal {
        delay_s,
        phase_100_hz_deg,
        noise_at_rest_m_per_s: at_rest * count_per_sample,
        noise_in_motion_m_per_s: in_motion * count_per_sample,
    })
}

struct Bench<'a> {
    scene: &'a Scene,
    velocity: VelocitySettings,
}

impl Bench<'_> {
    /// RMS of the difference between the estimate and `speed`, in counts per sample.
    fn noise(&self, motion: &mut Motion<'_>, speed: f64) -> Result<f64, SettingsError> {
        let mut sum = 0.0;
        self.run(motion, Drive::Hand, |_, velocity| sum += (velocity - speed).powi(2))?;
        Ok((sum / f64::from(SAMPLES)).sqrt())
    }

    /// Largest speed of a sine, in counts per sample. At this speed the device needs 80 % of the actuator's force.
    fn fastest(&self, omega: f64) -> f64 {
        let (device, rate_hz) = (&self.scene.device, self.scene.control.rate_hz);
        let per_s = omega * rate_hz;
        let reactance = device.mass_kg * per_s - device.stiffness_n_per_m / per_s;
        let impedance = reactance.hypot(device.damping_n_s_per_m);
        0.8 * self.scene.full_scale_n() / impedance / (rate_hz * self.scene.encoder.resolution_m)
    }

    /// Phase of the estimate against the true velocity, in rad. The sine is near `frequency`, in cycles per sample.
    fn sine(&self, frequency: f64, by: Drive) -> Result<f64, SettingsError> {
        // The number of periods and the number of samples have no common factor. Otherwise the same few counts would
        // repeat, always with the same rounding errors.
        let periods = whole(f64::from(SAMPLES) * frequency);
        let samples = (1..=SAMPLES).rev().find(|&n| gcd(n, periods) == 1).unwrap_or(SAMPLES);
        let omega = 2.0 * PI * f64::from(periods) / f64::from(samples);
        let fast = FAST_COUNTS.min(self.fastest(omega));
        let amplitude = fast / omega;
        let (mut re, mut im) = (0.0, 0.0);
        let mut motion = |n| {
            let angle = omega * f64::from(n);
            [amplitude * angle.sin(), fast * angle.cos()]
        };
        self.run(&mut motion, by, |n, velocity| {
            if n < samples {
                let angle = omega * f64::from(n + WARM_UP);
                re += velocity * angle.cos();
                im += velocity * angle.sin();
            }
        })?;
        // The true velocity is in phase with cos(angle). A late velocity is cos(angle + phi), with phi < 0.
        Ok((-im).atan2(re))
    }

    /// Mean force that the device needs during one sample of this motion, in N.
    fn force_n(&self, [x0, v0]: [f64; 2], [x1, v1]: [f64; 2]) -> f64 {
        let (device, rate_hz) = (&self.scene.device, self.scene.control.rate_hz);
        let counts = device.mass_kg * (v1 - v0) * rate_hz * rate_hz
            + device.damping_n_s_per_m * (x1 - x0) * rate_hz
            + device.stiffness_n_per_m * (x0 + x1) / 2.0;
        counts * self.scene.encoder.resolution_m
    }

    /// Runs the motion. After the warm-up, calls `each` with the sample number and with the velocity in counts per
    /// sample.
    fn run(
        &self,
        motion: &mut Motion<'_>,
        by: Drive,
        mut each: impl FnMut(u32, f64),
    ) -> Result<(), SettingsError> {
        let scene = self.scene;
        let (resolution_m, rate_hz) = (scene.encoder.resolution_m, scene.control.rate_hz);
        let first_border = match scene.encoder.rounding {
            Rounding::Floor => 0.0,
            Rounding::Round => 0.5,
        };
        let handle = |[position, speed]: [f64; 2]| Handle {
            position_m: (position - first_border) * resolution_m,
            speed_m_per_s: speed * resolution_m * rate_hz,
        };
        let encoder = Quantiser::of(&scene.encoder);
        let count = |motion: [f64; 2]| {
            let Handle { position_m, .. } = handle(motion);
            let error_m = scene.encoder_error.map_or(0.0, |error| error.error_m(position_m));
            encoder.count(position_m + error_m)
        };
        let mut here = motion(0);
        let settings = scene.settings(self.velocity, 0.0, 0.0);
        let mut core = Fixed::new(&settings, &scene.design(), Force::ZERO, count(here))?;
        let mut senses = Full::new(scene, self.velocity.name().sense());
        let latency = scene.actuator.latency_samples();
        for n in 1..WARM_UP + SAMPLES {
            let force_n = match by {
                Drive::Hand => 0.0,
                Drive::Motor => self.force_n(motion(n + latency - 1), motion(n + latency)),
            };
            let there = motion(n);
            senses.granted(force_n / scene.full_scale_n());
            senses.moved(handle(here), handle(there));
            here = there;
            core.sample(count(here), senses.senses());
            if n >= WARM_UP {
                each(n - WARM_UP, core.velocity());
            }
        }
        Ok(())
    }
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn whole(value: f64) -> u32 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below SAMPLES")]
    let whole = value.round() as u32;
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{NamedScene, element::EncoderError};
    use nalgebra::Complex;

    fn signal(settings: VelocitySettings) -> Signal {
        of(0.0, false, settings)
    }

    fn of(latency: f64, latency_known: bool, settings: VelocitySettings) -> Signal {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        scene.actuator.latency = latency;
        scene.actuator.latency_known = latency_known;
        measure(&scene, settings).unwrap()
    }

    #[test]
    fn edges_go_with_the_counts_whatever_the_encoder_does() {
        let settings = VelocitySettings::TimeStamps { span_samples: 8 };
        let measured = |edit: fn(&mut Scene)| {
            let mut scene = NamedScene::load("paper-1um").unwrap().scene;
            edit(&mut scene);
            measure(&scene, settings).unwrap()
        };
        let plain = measured(|_| ());
        // Rounding to the nearest count is equal to adding half a count and rounding down.
        let rounded = measured(|scene| scene.encoder.rounding = Rounding::Round);
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-3;
        assert_eq!(rounded.noise_at_rest_m_per_s, plain.noise_at_rest_m_per_s);
        assert!(
            near(rounded.noise_in_motion_m_per_s, plain.noise_in_motion_m_per_s),
            "{rounded:?} {plain:?}"
        );
        assert!((rounded.phase_100_hz_deg.hand - plain.phase_100_hz_deg.hand).abs() < 1e-2);
        // The periodic error has the slope `0.0628 sin`. At 2.9 counts per sample this slope adds a velocity of 0.0129
        // m/s RMS. Other errors are small.
        let wrong = measured(|scene| {
            let (cycle_m, first_m) = (1e-3, 1e-5);
            let (second_m, phase_rad) = (0.0, 0.3);
            scene.encoder_error = Some(EncoderError { cycle_m, first_m, second_m, phase_rad });
        });
        let of_error = SPEEDS[5] * 0.01 * 2.0 * PI * 0.01 / 2f64.sqrt();
        let ratio = wrong.noise_in_motion_m_per_s / of_error;
        assert!((ratio - 1.0).abs() < 0.02, "{wrong:?} {of_error}");
        assert_eq!(wrong.noise_at_rest_m_per_s, plain.noise_at_rest_m_per_s);
    }

    #[test]
    fn a_coarse_encoder_does_not_move_the_phase() {
        // For every size of a count, the delay is half a sample. At 100 Hz this is 1.8 degrees.
        for resolution_m in [1e-6, 1e-5, 2e-5, 4e-5] {
            let mut scene = NamedScene::load("paper-1um").unwrap().scene;
            scene.encoder.resolution_m = resolution_m;
            let phase =
                measure(&scene, VelocitySettings::Difference {}).unwrap().phase_100_hz_deg.hand;
            assert!((phase + 1.8).abs() < 0.05, "{resolution_m}: {phase}");
        }
    }

    #[test]
    fn delays_and_noise_are_those_of_theory() {
        // The delay is T/2 for the difference, and T/2 + sqrt(2) / wc with the filter.
        let plain = signal(VelocitySettings::Difference {});
        assert!((plain.delay_s.hand / 5e-5 - 1.0).abs() < 0.02, "{plain:?}");
        assert!((plain.phase_100_hz_deg.hand + 1.8).abs() < 0.05, "{plain:?}");
        // An estimator that uses only the position gives the same result for the hand and the motor.
        assert_eq!(plain.delay_s.hand, plain.delay_s.motor);
        let butterworth = signal(VelocitySettings::Butterworth { cutoff_hz: 500.0 });
        assert!((butterworth.delay_s.hand / 5.0e-4 - 1.0).abs() < 0.01, "{butterworth:?}");
        assert!((butterworth.phase_100_hz_deg.hand + 18.2).abs() < 0.1, "{butterworth:?}");
        // The count changes with probability 1/2 per sample. So half of the differences are +-1 count, the others 0.
        // One count per sample is 10 mm/s.
        assert!((plain.noise_at_rest_m_per_s / (0.01 * 0.5f64.sqrt()) - 1.0).abs() < 0.02);
        assert!(butterworth.noise_at_rest_m_per_s < 0.1 * plain.noise_at_rest_m_per_s);
        assert!(butterworth.noise_in_motion_m_per_s < plain.noise_in_motion_m_per_s);
        let window = VelocitySettings::LeastSquares1 { window_samples: 20 };
        assert!((signal(window).delay_s.hand / 1e-3 - 1.0).abs() < 0.01);
        // With the motor's force the observer has almost no delay. The observer does not get the hand's force. So when
        // the hand moves the device, the observer is a filter of the position with its poles at w. The delay of this
        // filter is 3 atan(x) - atan(3 x), where x is 100 Hz divided by the bandwidth.
        let observer = signal(VelocitySettings::Observer { bandwidth_hz: 100.0, mass_kg: 0.416 });
        // The observer does not know the force of the device's damping b, so it leads by 3 b / (m w^2).
        let lead = 3.0 * 5.5195 / 0.416 / (2.0 * PI * 100.0).powi(2);
        assert!((observer.delay_s.motor / -lead - 1.0).abs() < 0.1, "{observer:?} {lead}");
        assert!(observer.phase_100_hz_deg.motor.abs() < 1.0, "{observer:?}");
        let late = (3.0 * 1f64.atan() - 3f64.atan()).to_degrees();
        assert!((observer.phase_100_hz_deg.hand + late).abs() < 2.5, "{observer:?} {late}");
        // If the observer gets the force 0.3 ms before it acts, the velocity leads. The response of the observer to the
        // force is (s^3 + 3 w s^2) / (s + w)^3. The force U that the observer gets is (1 + b / (m s)) e^(s t) times the
        // correct value.
        let s = Complex::new(0.0, 2.0 * PI * 100.0);
        let w = 2.0 * PI * 100.0;
        let passed = (s * s * s + s * s * 3.0 * w) / ((s + w) * (s + w) * (s + w));
        let told_of_right = (Complex::new(5.5195 / 0.416, 0.0) / s + 1.0) * (s * 3e-4).exp();
        let early = (passed * (told_of_right - 1.0) + 1.0).arg().to_degrees();
        let settings = VelocitySettings::Observer { bandwidth_hz: 100.0, mass_kg: 0.416 };
        let told = of(3.0, false, settings);
        assert!(early > 4.0 && observer.phase_100_hz_deg.motor < 1.0);
        assert!((told.phase_100_hz_deg.motor - early).abs() < 0.6, "{told:?} {early}");
        assert_eq!(told.phase_100_hz_deg.hand, observer.phase_100_hz_deg.hand);
        // With known latency the observer gets the force in time. The result is the same as without latency.
        assert_eq!(of(3.0, true, settings), observer);
        // With a mass that is 20 % too large, the motor's force explains only five sixths of the acceleration. The
        // observer attributes the last sixth to the hand.
        let wrong = VelocitySettings::Observer { bandwidth_hz: 100.0, mass_kg: 1.2 * 0.416 };
        let off = signal(wrong).phase_100_hz_deg;
        assert!(off.motor < -2.0 && off.motor > off.hand, "{off:?}");
        let stamps = signal(VelocitySettings::TimeStamps { span_samples: 8 });
        assert!(
            stamps.noise_in_motion_m_per_s < 1e-2 * plain.noise_in_motion_m_per_s,
            "{stamps:?}"
        );
    }
}
