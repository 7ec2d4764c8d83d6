//! What the hand feels of an estimator in contact.
//!
//! **Roughness**: RMS of the part of the force above 100 Hz, over the window of a wall hit. The hand
//! feels vibration best at some 250 Hz, and what lies above 100 Hz belongs to no wall.
//!
//! **Fidelity** (Chawda, Celik, O'Malley, IEEE/ASME T-Mech 23(2), 2018, plot it over the Z-width): the
//! impedance that is rendered against the one that is commanded, `K + j w B`. The handle is moved
//! inside the wall by a sine, the very loop of the scene (encoder, estimator, wall, output period,
//! latency) answers with a force, and the ratio of their Fourier coefficients is the impedance.
//! Saturation is put out of reach and the wall may pull; the encoder floors, and the scene's elements
//! are left out.

use std::f64::consts::PI;

use rustfft::{FftPlanner, num_complex::Complex};
use zwidth::{Design, units::Force};

use super::Place;
use crate::{
    controller::{Controller, Fixed},
    error::Error,
    rig::{Numeric, Rig, WallHit},
    sensing::{Full, Handle, Sensing},
};

/// What a contact showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The wall at which all are compared is stable with this estimator.
    pub stable: bool,
    /// RMS of the measured position about its mean, m.
    pub rms_m: f64,
    /// RMS of the force above [`ROUGH_ABOVE_HZ`], N.
    pub roughness_n: f64,
    /// `|rendered - commanded| / |commanded|` of the impedance, RMS over [`FREQUENCIES_HZ`].
    pub impedance_error: f64,
}

/// Force above this frequency is roughness, Hz.
pub const ROUGH_ABOVE_HZ: f64 = 100.0;
/// Frequencies at which the impedance is compared, Hz: what a hand does and feels of a wall.
pub const FREQUENCIES_HZ: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0];

/// Measures one estimator; the rig's scene holds it.
///
/// # Errors
/// A setting is out of range.
pub fn measure(
    rig: &Rig,
    numeric: Numeric,
    cutoff_hz: f64,
    place: &Place,
) -> Result<Contact, Error> {
    let wall = WallHit {
        cutoff_hz,
        stiffness_n_per_m: place.stiffness_n_per_m,
        damping_n_s_per_m: place.damping_n_s_per_m,
        start_offset_counts: 0.0,
    };
    let mut forces_n = vec![];
    let settle = u64::from(rig.plan().settle);
    let report = rig.hit(numeric, &wall, |sample| {
        if let Some(rendered) = sample.rendered.filter(|_| sample.index >= settle) {
            forces_n.push(rendered.output * rig.design().full_scale_n);
        }
    });
    let (stable, rms_m) = match &report {
        Ok(report) => (report.is_stable(), report.rms_m),
        Err(_) => (false, f64::INFINITY),
    };
    let output_hz = rig.design().rate_hz / f64::from(rig.design().period);
    Ok(Contact {
        stable,
        rms_m,
        roughness_n: rms_above(&forces_n, output_hz, ROUGH_ABOVE_HZ),
        impedance_error: impedance_error(rig, &wall)?,
    })
}

/// RMS of what lies above `above_hz` in a signal of that rate. The mean is taken off first; a Hann
/// window keeps a drift at low frequencies from leaking up.
fn rms_above(signal: &[f64], rate_hz: f64, above_hz: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "at most 2^24 samples")]
    let length = signal.len() as f64;
    if signal.is_empty() {
        return 0.0;
    }
    let mean = signal.iter().sum::<f64>() / length;
    let window = |n: usize| {
        #[expect(clippy::cast_precision_loss, reason = "at most 2^24 samples")]
        let n = n as f64;
        0.5 - 0.5 * (2.0 * PI * n / length).cos()
    };
    let mut spectrum: Vec<Complex<f64>> = signal
        .iter()
        .enumerate()
        .map(|(n, value)| Complex::new((value - mean) * window(n), 0.0))
        .collect();
    FftPlanner::new().plan_fft_forward(spectrum.len()).process(&mut spectrum);
    let window_power: f64 = (0..signal.len()).map(|n| window(n).powi(2)).sum();
    let power: f64 = spectrum
        .iter()
        .enumerate()
        .filter(|(bin, _)| {
            let mirrored = (*bin).min(spectrum.len() - bin);
            #[expect(clippy::cast_precision_loss, reason = "at most 2^24 bins")]
            let frequency = mirrored as f64 * rate_hz / length;
            frequency > above_hz
        })
        .map(|(_, bin)| bin.norm_sqr())
        .sum();
    (power / length / window_power).sqrt()
}

/// RMS over the frequencies of the relative error of the impedance.
fn impedance_error(rig: &Rig, wall: &WallHit) -> Result<f64, Error> {
    let (k, b) = (wall.stiffness_n_per_m, wall.damping_n_s_per_m);
    let mut sum = 0.0;
    for frequency_hz in FREQUENCIES_HZ {
        let commanded = Complex::new(k, 2.0 * PI * frequency_hz * b);
        let rendered = impedance(rig, wall, frequency_hz)?;
        sum += (rendered - commanded).norm_sqr() / commanded.norm_sqr();
    }
    #[expect(clippy::cast_precision_loss, reason = "a handful of frequencies")]
    let count = FREQUENCIES_HZ.len() as f64;
    Ok((sum / count).sqrt())
}

/// Force against the motion over motion at one frequency, N/m.
fn impedance(rig: &Rig, wall: &WallHit, frequency_hz: f64) -> Result<Complex<f64>, Error> {
    /// Amplitude of the motion, counts: small, as in a contact, but many counts.
    const AMPLITUDE_COUNTS: f64 = 100.0;
    /// Time before anything is looked at, s.
    const SETTLE_S: f64 = 1.0;
    /// Full scale so large that nothing saturates.
    const OUT_OF_REACH: f64 = 1000.0;
    let scene = rig.scene();
    let design = Design { full_scale_n: rig.design().full_scale_n * OUT_OF_REACH, ..*rig.design() };
    let mut settings =
        scene.settings(wall.cutoff_hz, wall.stiffness_n_per_m, wall.damping_n_s_per_m);
    settings.wall.push_only = false; // it would clip at high B, where velocity outweighs depth
    let surface = settings.build(&design).map_err(Error::input)?.wall.surface().counts();
    let omega = 2.0 * PI * frequency_hz / design.rate_hz;
    let position = |sample: f64| {
        f64::from(surface) + 2.0 * AMPLITUDE_COUNTS + AMPLITUDE_COUNTS * (omega * sample).sin()
    };
    #[expect(clippy::cast_possible_truncation, reason = "within 2^30 by the scene's check")]
    let count = |sample: f64| position(sample).floor() as i32;
    let mut core = Fixed::new(&settings, &design, Force::ZERO, count(0.0)).map_err(Error::input)?;
    let mut senses = Full::new(scene);
    let handle = |sample: f64| Handle {
        position_m: position(sample) * design.resolution_m,
        speed_m_per_s: AMPLITUDE_COUNTS
            * omega
            * (omega * sample).cos()
            * design.resolution_m
            * design.rate_hz,
    };
    let mut held_n = 0.0;
    let settle = (SETTLE_S * design.rate_hz).round();
    let periods = (frequency_hz * 2.0).ceil().max(2.0);
    let end = settle + periods * design.rate_hz / frequency_hz;
    let half_step = f64::from(design.period) / 2.0;
    let mut sum = Complex::new(0.0, 0.0);
    let mut outputs = 0.0;
    let mut sample = 0.0;
    while sample < end {
        if senses.sample(&mut core, count(sample)) {
            let force_n = core.render().output * design.full_scale_n;
            held_n = force_n;
            if sample >= settle {
                // A held step of force acts as if it came at the middle of its hold, with the
                // gain of a hold, which at these frequencies is one to within 1e-2.
                let acts = sample + scene.actuator.latency + half_step;
                sum += Complex::from_polar(force_n, -omega * acts);
                outputs += 1.0;
            }
        }
        senses.moved(handle(sample), handle(sample + 1.0), held_n, held_n);
        sample += 1.0;
    }
    // x = A sin = A (e - e*) / 2j: its coefficient is A / 2j; the wall pushes back, hence the sign
    let hold = (omega * half_step).sin() / (omega * half_step);
    let motion = Complex::new(0.0, -AMPLITUDE_COUNTS * design.resolution_m / 2.0);
    Ok(-(sum / outputs * hold) / motion)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    #[test]
    fn power_is_split_at_the_frequency() {
        let tone = |hz: f64, n: i32| (2.0 * PI * hz * f64::from(n) / 1000.0).sin();
        let signal: Vec<f64> =
            (0..2000).map(|n| 5.0 + 3.0 * tone(20.0, n) + 0.4 * tone(210.0, n)).collect();
        let rough = rms_above(&signal, 1000.0, 100.0);
        assert!((rough / (0.4 / 2f64.sqrt()) - 1.0).abs() < 1e-3, "{rough}");
        assert_eq!(rms_above(&[], 1000.0, 100.0), 0.0);
    }

    #[test]
    fn a_fast_loop_renders_what_is_commanded_and_a_late_one_does_not() {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        let wall = WallHit {
            cutoff_hz: 4000.0,
            stiffness_n_per_m: 20_000.0,
            damping_n_s_per_m: 50.0,
            start_offset_counts: 0.0,
        };
        let late = impedance_error(&Rig::new(&scene).unwrap(), &wall).unwrap();
        scene.actuator.latency = 0.0;
        scene.actuator.period = 1;
        let fast = impedance_error(&Rig::new(&scene).unwrap(), &wall).unwrap();
        assert!(fast < 0.02, "{fast}");
        // 1.5 ms at 50 Hz are 27 degrees, an error of 0.47; at 1 Hz nothing
        assert!((0.15..0.25).contains(&late), "{late}");
    }
}
