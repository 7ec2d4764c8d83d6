//! The amplitude spectrum of samples. The samples are weighted with a Hann window.
#![expect(clippy::cast_precision_loss, reason = "some thousand")]

use std::f64::consts::PI;

use host_sim::numerics::fft::RealSpectrum;

/// Amplitudes of the values without their mean. They are at the frequencies `n / (N T)` for n from 0 to N/2. A sine of
/// amplitude A at one of these frequencies gives A. The number of values must be a power of two.
pub fn amplitudes(values: &[f64]) -> Vec<f64> {
    let count = values.len();
    assert!(count.is_power_of_two(), "a power of two");
    let n = count as f64;
    let mean = values.iter().sum::<f64>() / n;
    let window = |place: usize| 0.5 - 0.5 * (2.0 * PI * place as f64 / n).cos();
    let windowed = values.iter().enumerate().map(|(place, value)| (value - mean) * window(place));
    let powers = RealSpectrum::new(count).powers(&windowed.collect::<Vec<_>>(), 0..count / 2 + 1);
    // The mean of the window is one half, and half of a sine's amplitude is at the negative frequency. So the factor is
    // 4.
    powers.into_iter().map(|power| 4.0 / n * power.sqrt()).collect()
}

/// Divides the spectrum into about `count` bands with equal ratios of frequency. Returns the bin and the value of the
/// largest amplitude in each band. Bin 0, which is the mean, is left out.
pub fn bands(amplitudes: &[f64], count: u32) -> Vec<(usize, f64)> {
    let last = amplitudes.len().saturating_sub(1);
    let mut found: Vec<(usize, f64)> = Vec::new();
    let mut from = 1;
    let ratio = (last.max(2) as f64).powf(1.0 / f64::from(count.max(1)));
    let mut end = 1.0;
    while from <= last {
        end *= ratio;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some thousand"
        )]
        let to = (end as usize).clamp(from, last);
        let best = (from..=to).max_by(|a, b| amplitudes[*a].total_cmp(&amplitudes[*b]));
        found.extend(best.map(|bin| (bin, amplitudes[bin])));
        from = to + 1;
        end = end.max(to as f64);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_gives_its_amplitude_and_the_mean_nothing() {
        for (count, bin) in [(64, 5), (4096, 500)] {
            let wave =
                |n: usize| 3.0 + 0.25 * (2.0 * PI * (bin * n) as f64 / count as f64 + 0.3).sin();
            let values: Vec<f64> = (0..count).map(wave).collect();
            let found = amplitudes(&values);
            assert_eq!(found.len(), count / 2 + 1);
            assert!((found[bin] - 0.25).abs() < 1e-12, "{}", found[bin]);
            assert!(found[0] < 1e-12 && found[bin + 3] < 1e-12);
        }
    }

    #[test]
    fn bands_keep_every_peak_and_cover_all() {
        let mut all = vec![1e-3; 2049];
        all[1777] = 1.0;
        let found = bands(&all, 200);
        assert!(found.len() < 300);
        assert!(found.contains(&(1777, 1.0)));
        assert!(found.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!(found[0].0, 1);
    }
}
