//! Amplitude spectrum of a stretch of samples, by a radix-2 transform (Cooley and Tukey 1965) under a Hann window.

use std::f64::consts::PI;

/// Amplitudes at the frequencies `n / (N T)`, n from 0 to N/2, of the values with their mean taken off. A sine of
/// amplitude A at one of them gives A. The number of values is a power of two.
pub fn amplitudes(values: &[f64]) -> Vec<f64> {
    let count = values.len();
    assert!(count.is_power_of_two(), "a power of two");
    #[expect(clippy::cast_precision_loss, reason = "some thousand")]
    let n = count as f64;
    let mean = values.iter().sum::<f64>() / n;
    #[expect(clippy::cast_precision_loss, reason = "some thousand")]
    let window = |place: usize| 0.5 - 0.5 * (2.0 * PI * place as f64 / n).cos();
    let windowed = values.iter().enumerate().map(|(place, value)| (value - mean) * window(place));
    let mut bins: Vec<[f64; 2]> = windowed.map(|value| [value, 0.0]).collect();
    transform(&mut bins);
    // The window's mean is a half, and half of a sine is at the negative frequency.
    bins[..=count / 2].iter().map(|[re, im]| 4.0 / n * re.hypot(*im)).collect()
}

fn transform(bins: &mut [[f64; 2]]) {
    let count = bins.len();
    let bits = count.trailing_zeros();
    for place in 0..count {
        let other = place.reverse_bits() >> (usize::BITS - bits.max(1)) & (count - 1);
        if place < other {
            bins.swap(place, other);
        }
    }
    let mut half = 1;
    while half < count {
        for k in 0..half {
            #[expect(clippy::cast_precision_loss, reason = "some thousand")]
            let (im, re) = (-PI * k as f64 / half as f64).sin_cos();
            for first in (k..count).step_by(2 * half) {
                let ([a, b], [c, d]) = (bins[first], bins[first + half]);
                let [e, f] = [c * re - d * im, c * im + d * re];
                bins[first] = [a + e, b + f];
                bins[first + half] = [a - e, b - f];
            }
        }
        half *= 2;
    }
}

/// The largest amplitude in each of about `count` bands of equal ratio, with the frequency that it has: bin, amplitude.
/// Bin 0, the mean, is left out.
pub fn bands(amplitudes: &[f64], count: u32) -> Vec<(usize, f64)> {
    let last = amplitudes.len().saturating_sub(1);
    let mut found: Vec<(usize, f64)> = Vec::new();
    let mut from = 1;
    #[expect(clippy::cast_precision_loss, reason = "some thousand")]
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
        #[expect(clippy::cast_precision_loss, reason = "some thousand")]
        {
            end = end.max(to as f64);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_gives_its_amplitude_and_the_mean_nothing() {
        for (count, bin) in [(64, 5), (4096, 500)] {
            #[expect(clippy::cast_precision_loss, reason = "small")]
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
