//! Delay and noise of an estimator alone, on prescribed motions, by the core's own arithmetic.
//!
//! | figure | motion |
//! |--------|--------|
//! | delay, phase | a sine of 100 counts per sample at its fastest, so that counting hardly matters |
//! | noise at rest | the count flickers between two neighbours at random, the worst place to rest |
//! | noise in motion | constant speeds of 0.01 to 3 counts per sample, none a simple fraction |

use std::f64::consts::PI;

use zwidth::{
    Control, CounterWidth, Design, Sampler, Settings, SettingsError, VelocitySettings,
    WallSettings, units::Velocity, velocity::Senses,
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

/// Measures one estimator.
///
/// # Errors
/// A parameter is out of range.
pub fn measure(settings: &VelocitySettings, design: &Design) -> Result<Signal, SettingsError> {
    let wall = WallSettings {
        position_m: 0.0,
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
        push_only: true,
    };
    let control = Settings { velocity: *settings, wall }.build(design)?;
    let count_per_sample = design.resolution_m * design.rate_hz;
    let slow_hz = SLOW * design.rate_hz;
    let (_, slow) = sine(&control, SLOW);
    let (_, fast) = sine(&control, 100.0 / design.rate_hz);
    let noise = |motion: &mut dyn FnMut(u32) -> f64, speed: f64| {
        let error = |velocity: f64| (velocity - speed).powi(2);
        (run(&control, motion, |_, velocity| error(velocity)) / f64::from(SAMPLES)).sqrt()
    };
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut flicker = |_| {
        // xorshift64: the flicker must be the same in every run and on every machine
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        f64::from(u8::from(state >> 40 & 1 == 1))
    };
    let at_rest = noise(&mut flicker, 0.0);
    let in_motion = SPEEDS.map(|speed| noise(&mut |n| speed * f64::from(n), speed));
    Ok(Signal {
        delay_s: -slow / (2.0 * PI * slow_hz),
        phase_100_hz_deg: fast.to_degrees(),
        noise_at_rest_m_per_s: at_rest * count_per_sample,
        noise_in_motion_m_per_s: in_motion.into_iter().fold(0.0, f64::max) * count_per_sample,
    })
}

/// Gain and phase in radians at `frequency` cycles per sample, against the true velocity.
fn sine(control: &Control, frequency: f64) -> (f64, f64) {
    let omega = 2.0 * PI * frequency;
    let amplitude = FAST_COUNTS / omega;
    // a whole number of periods
    let samples = (f64::from(SAMPLES) * frequency).floor() / frequency;
    let (mut re, mut im) = (0.0, 0.0);
    run(control, &mut |n| amplitude * (omega * f64::from(n)).sin(), |n, velocity| {
        if f64::from(n) < samples {
            let angle = omega * f64::from(n + WARM_UP);
            re += velocity * angle.cos();
            im += velocity * angle.sin();
        }
        0.0
    });
    // the true velocity is FAST_COUNTS cos(angle); late by phi it is cos(angle + phi), phi < 0
    ((re * re + im * im).sqrt() * 2.0 / samples / FAST_COUNTS, (-im).atan2(re))
}

/// Feeds `motion`, in counts over samples, and sums `each` of sample number and velocity in counts
/// per sample after the warm-up.
fn run(
    control: &Control,
    motion: &mut dyn FnMut(u32) -> f64,
    mut each: impl FnMut(u32, f64) -> f64,
) -> f64 {
    let lsb = 1.0 / f64::from(1u32 << Velocity::FRACTION_BITS);
    let count = |position: f64| -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "far within i32")]
        let count = position.floor() as i32;
        count.cast_unsigned()
    };
    let mut sampler = Sampler::new(count(motion(0)), CounterWidth::Bits32);
    let mut sum = 0.0;
    for n in 1..WARM_UP + SAMPLES {
        let motion = sampler.sense(control, count(motion(n)), &Senses::default());
        if n >= WARM_UP {
            sum += each(n - WARM_UP, f64::from(motion.velocity.bits()) * lsb);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    fn signal(settings: VelocitySettings) -> Signal {
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        measure(&settings, &design).unwrap()
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
    }
}
