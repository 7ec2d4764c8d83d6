//! Roughness of a wall in the hand: RMS of the force above 100 Hz in the measurement window of a wall hit. The hand
//! feels vibration best near 250 Hz, and a wall does not command a force above 100 Hz. The force of a hit is chaotic:
//! its roughness varies by 15 % from start to start. So there are [`HITS`] hits, with starts spread over a count. The
//! hits run with all elements of the scene. The force is the controller's output with quantisation, before the
//! amplifier.

use std::{f64::consts::PI, sync::atomic::AtomicBool};

use nalgebra::Complex;
use rayon::prelude::*;

use crate::{
    error::Error,
    interrupt,
    numerics::fft,
    simulation::prepared::{HitError, HitReport, Numeric, PreparedScene, WallHit},
    study::sweep::start_offset_counts,
};

#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// Whether the wall is stable with this estimator from every start.
    pub stable: bool,
    /// RMS of the force above [`ROUGH_ABOVE_HZ`] in each hit, in N.
    pub roughness_n: Vec<f64>,
}

/// Frequency above which force components count as roughness, in Hz.
pub const ROUGH_ABOVE_HZ: f64 = 100.0;
pub const HITS: u32 = 16;

/// Measures the contact with the estimator of the prepared scene.
///
/// # Errors
/// `stop` was set.
pub fn measure(
    prepared: &PreparedScene,
    numeric: Numeric,
    wall: &WallHit,
    stop: &AtomicBool,
) -> Result<Contact, Error> {
    let hits: Vec<(bool, f64)> = (0..HITS)
        .into_par_iter()
        .map(|n| {
            interrupt::unless(stop)?;
            let start_offset_counts = start_offset_counts(n, HITS);
            let wall = WallHit { start_offset_counts, ..*wall };
            let (report, roughness_n) = of_hit(prepared, numeric, &wall);
            Ok((report.is_ok_and(|report| report.is_stable()), roughness_n))
        })
        .collect::<Result<_, Error>>()?;
    Ok(Contact {
        stable: hits.iter().all(|(stable, _)| *stable),
        roughness_n: hits.into_iter().map(|(_, roughness_n)| roughness_n).collect(),
    })
}

/// Result of one hit, and the roughness of its force in N.
pub fn of_hit(
    prepared: &PreparedScene,
    numeric: Numeric,
    wall: &WallHit,
) -> (Result<HitReport, HitError>, f64) {
    let mut forces_n = vec![];
    let settle = u64::from(prepared.plan().settle);
    let report = prepared.hit(numeric, wall, |sample| {
        if let Some(rendered) = sample.rendered.filter(|_| sample.index >= settle) {
            forces_n.push(rendered.output * prepared.design().full_scale_n);
        }
    });
    let output_hz = prepared.design().rate_hz / f64::from(prepared.design().period);
    (report, rms_above(&forces_n, output_hz, ROUGH_ABOVE_HZ))
}

/// RMS of a signal above `above_hz`. The mean is subtracted first. A Hann window keeps slow drift from leaking into
/// high frequencies.
fn rms_above(signal: &[f64], rate_hz: f64, above_hz: f64) -> f64 {
    let length = signal.len() as f64;
    if signal.is_empty() {
        return 0.0;
    }
    let mean = signal.iter().sum::<f64>() / length;
    let window = |n: usize| {
        let n = n as f64;
        0.5 - 0.5 * (2.0 * PI * n / length).cos()
    };
    let windowed: Vec<Complex<f64>> = signal
        .iter()
        .enumerate()
        .map(|(n, value)| Complex::new((value - mean) * window(n), 0.0))
        .collect();
    let spectrum = fft::forward(&windowed);
    let window_power: f64 = (0..signal.len()).map(|n| window(n).powi(2)).sum();
    let power: f64 = spectrum
        .iter()
        .enumerate()
        .filter(|(bin, _)| {
            let mirrored = (*bin).min(spectrum.len() - bin);
            let frequency = mirrored as f64 * rate_hz / length;
            frequency > above_hz
        })
        .map(|(_, bin)| bin.norm_sqr())
        .sum();
    (power / length / window_power).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn power_is_split_at_the_frequency() {
        let tone = |hz: f64, n: i32| (2.0 * PI * hz * f64::from(n) / 1000.0).sin();
        let signal: Vec<f64> =
            (0..2000).map(|n| 5.0 + 3.0 * tone(20.0, n) + 0.4 * tone(210.0, n)).collect();
        let rough = rms_above(&signal, 1000.0, 100.0);
        assert!((rough / (0.4 / 2f64.sqrt()) - 1.0).abs() < 1e-3, "{rough}");
        assert_eq!(rms_above(&[], 1000.0, 100.0), 0.0);
    }
}
