//! The discrete Fourier transform of any length: the same bits on every machine, which transforms written with a
//! machine's vector instructions do not give.
//!
//! Powers of two by decimation in time (Cooley and Tukey, Math. Comp. 19, 1965), other lengths as a convolution with
//! a chirp (Bluestein, IEEE Trans. Audio Electroacoust. 18, 1970).

use core::f64::consts::PI;

use nalgebra::Complex;

/// `X[k] = sum over n of x[n] exp(-2 pi i k n / N)`.
pub fn forward(signal: &[Complex<f64>]) -> Vec<Complex<f64>> {
    let length = signal.len();
    if length.is_power_of_two() || length == 0 {
        let mut values = signal.to_vec();
        radix_2(&mut values);
        return values;
    }
    // k n = (k^2 + n^2 - (k - n)^2) / 2
    let chirp: Vec<Complex<f64>> =
        (0..length).map(|n| half_turns(-square(n, length), length)).collect();
    let room = (2 * length - 1).next_power_of_two();
    let zero = Complex::new(0.0, 0.0);
    let (mut values, mut kernel) = (vec![zero; room], vec![zero; room]);
    for (n, (value, chirp)) in signal.iter().zip(&chirp).enumerate() {
        values[n] = value * chirp;
        kernel[n] = chirp.conj();
        kernel[(room - n) % room] = chirp.conj();
    }
    radix_2(&mut values);
    radix_2(&mut kernel);
    for (value, kernel) in values.iter_mut().zip(&kernel) {
        *value = (*value * kernel).conj(); // the conjugate's transform is the inverse's conjugate
    }
    radix_2(&mut values);
    let scale = 1.0 / float(room);
    values.iter().zip(&chirp).map(|(value, chirp)| value.conj() * scale * chirp).collect()
}

/// `n^2` less full turns of the chirp.
fn square(n: usize, length: usize) -> f64 {
    float((n * n) % (2 * length))
}

/// `exp(pi i steps / of)`.
fn half_turns(steps: f64, of: usize) -> Complex<f64> {
    let angle = PI * steps / float(of);
    Complex::new(libm::cos(angle), libm::sin(angle))
}

fn float(number: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "lengths far below 2^53")]
    let number = number as f64;
    number
}

/// In place, for a power of two.
fn radix_2(values: &mut [Complex<f64>]) {
    let length = values.len();
    if length < 2 {
        return;
    }
    let bits = length.trailing_zeros();
    for n in 0..length {
        let mirrored = n.reverse_bits() >> (usize::BITS - bits);
        if n < mirrored {
            values.swap(n, mirrored);
        }
    }
    let turns: Vec<Complex<f64>> =
        (0..length / 2).map(|n| half_turns(-2.0 * float(n), length)).collect();
    let mut half = 1;
    while half < length {
        let stride = length / (2 * half);
        for block in values.chunks_exact_mut(2 * half) {
            let (even, odd) = block.split_at_mut(half);
            for (n, (even, odd)) in even.iter_mut().zip(odd).enumerate() {
                let turned = *odd * turns[n * stride];
                (*even, *odd) = (*even + turned, *even - turned);
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn it_is_the_sum_that_defines_it() {
        for length in [0, 1, 2, 3, 5, 8, 12, 31, 64, 100, 125, 257] {
            let draw = |n: usize| random::gaussian(7, n as u64);
            let signal: Vec<Complex<f64>> =
                (0..length).map(|n| Complex::new(draw(2 * n), draw(2 * n + 1))).collect();
            let found = forward(&signal);
            assert_eq!(found.len(), length);
            for (k, found) in found.iter().enumerate() {
                let term = |(n, x): (usize, &Complex<f64>)| {
                    x * half_turns(-2.0 * float(k * n % length), length)
                };
                let sum: Complex<f64> = signal.iter().enumerate().map(term).sum();
                assert!((found - sum).norm() < 1e-12 * float(length), "{length}: {k}");
            }
        }
    }

    #[test]
    fn a_long_signal_keeps_its_power() {
        for length in [2000usize, 4096, 30_011] {
            let signal: Vec<Complex<f64>> =
                (0..length).map(|n| Complex::new(random::gaussian(3, n as u64), 0.0)).collect();
            let power = |values: &[Complex<f64>]| values.iter().map(Complex::norm_sqr).sum::<f64>();
            let ratio = power(&forward(&signal)) / power(&signal) / float(length);
            assert!((ratio - 1.0).abs() < 1e-12, "{length}: {ratio}");
        }
    }
}
