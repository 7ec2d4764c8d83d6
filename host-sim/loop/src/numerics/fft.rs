//! Discrete Fourier transforms that give the same bits on every machine. The vector instructions of a machine would
//! change bits, so none are used.
//!
//! Powers of two use Stockham's form in radix 4, with a last stage in radix 2 (C. Van Loan, *Computational Frameworks
//! for the Fast Fourier Transform*, 1992, sections 1.7 and 4.4). Other lengths use a convolution with a chirp
//! (Bluestein, IEEE Trans. Audio Electroacoust. 18, 1970).

use core::f64::consts::{PI, TAU};

use nalgebra::Complex;

/// `X[k] = sum over n of x[n] exp(-2 pi i k n / N)`, for any length.
pub fn forward(signal: &[Complex<f64>]) -> Vec<Complex<f64>> {
    let length = signal.len();
    if length == 0 {
        return vec![];
    }
    // k n = (k^2 + n^2 - (k - n)^2) / 2
    let chirp: Vec<Complex<f64>> =
        (0..length).map(|n| half_turns(-float((n * n) % (2 * length)), length)).collect();
    let room = (2 * length - 1).next_power_of_two();
    let table = Table::new(room);
    let zero = Complex::new(0.0, 0.0);
    let (mut values, mut kernel) = (vec![zero; room], vec![zero; room]);
    for (n, (value, chirp)) in signal.iter().zip(&chirp).enumerate() {
        values[n] = value * chirp;
        kernel[n] = chirp.conj();
        kernel[(room - n) % room] = chirp.conj();
    }
    let (mut values, kernel) = (table.of(values), table.of(kernel));
    for (value, kernel) in values.iter_mut().zip(&kernel) {
        *value = (*value * kernel).conj(); // for the inverse transform
    }
    let scale = 1.0 / float(room);
    let values = table.of(values);
    values.iter().zip(&chirp).map(|(value, chirp)| value.conj() * scale * chirp).collect()
}

/// The spectrum of a real signal, padded with zeros to a power of two. The tables are made only once, to save time.
#[derive(Clone, Debug, PartialEq)]
pub struct RealSpectrum {
    /// Tables for a complex signal of half the length. Each complex sample contains two real samples.
    table: Table,
}

impl RealSpectrum {
    /// Makes the tables for a signal of at most `samples` samples.
    pub fn new(samples: usize) -> Self {
        Self { table: Table::new(samples.max(4).next_power_of_two() / 2) }
    }

    /// Number of samples of the padded signal, including the zeros.
    pub fn length(&self) -> usize {
        2 * self.table.length
    }

    /// `|X[k]|^2` for the bins `bins`. All bins must be below half the length.
    pub fn powers(&self, signal: &[f64], bins: core::ops::Range<usize>) -> Vec<f64> {
        let half = self.table.length;
        let part = |odd: usize| -> Vec<f64> {
            let at = |n: usize| signal.get(2 * n + odd).copied().unwrap_or(0.0);
            (0..half).map(at).collect()
        };
        let [re, im] = self.table.transformed([part(0), part(1)]);
        let power = |k: usize| {
            let (a, b) = (k % half, (half - k) % half);
            // spectra of the even and of the odd samples, then one step of decimation in time
            let even = [0.5 * (re[a] + re[b]), 0.5 * (im[a] - im[b])];
            let odd = [0.5 * (im[a] + im[b]), 0.5 * (re[b] - re[a])];
            let (x, y) = times((self.table.turns[0][k], self.table.turns[1][k]), (odd[0], odd[1]));
            let (x, y) = (even[0] + x, even[1] + y);
            x * x + y * y
        };
        bins.map(power).collect()
    }
}

/// Real and imaginary parts.
type Parts = [Vec<f64>; 2];

/// Tables for transforms of one length, a power of two.
#[derive(Clone, Debug, PartialEq)]
struct Table {
    length: usize,
    /// `exp(-pi i k / length)` over the whole circle, as real and imaginary parts.
    turns: Parts,
}

impl Table {
    fn new(length: usize) -> Self {
        let angle = |k: usize| TAU * (float(k) / float(2 * length));
        let cosines = (0..2 * length).map(|k| libm::cos(angle(k))).collect();
        let sines = (0..2 * length).map(|k| -libm::sin(angle(k))).collect();
        Self { length, turns: [cosines, sines] }
    }

    fn of(&self, values: Vec<Complex<f64>>) -> Vec<Complex<f64>> {
        let parts = values.into_iter().map(|value| (value.re, value.im)).unzip();
        let [re, im] = self.transformed(parts.into());
        re.into_iter().zip(im).map(|(re, im)| Complex::new(re, im)).collect()
    }

    fn transformed(&self, mut from: Parts) -> Parts {
        let mut to = [vec![0.0; self.length], vec![0.0; self.length]];
        let (mut length, mut stride) = (self.length, 1);
        while length > 1 {
            if length == 2 {
                halves(&from, &mut to, stride);
            } else {
                self.quarters(&from, &mut to, length, stride);
            }
            core::mem::swap(&mut from, &mut to);
            (length, stride) = (length / 4, stride * 4);
        }
        from
    }

    /// One stage of radix 4 over transforms of length `length`. `stride` transforms are side by side.
    fn quarters(&self, from: &Parts, to: &mut Parts, length: usize, stride: usize) {
        let quarter = length / 4;
        let [re, im] = from;
        let [to_re, to_im] = to;
        for p in 0..quarter {
            let turn = |times: usize| {
                let k = 2 * times * p * stride % (2 * self.length);
                (self.turns[0][k], self.turns[1][k])
            };
            let (w1, w2, w3) = (turn(1), turn(2), turn(3));
            let row = |n: usize| stride * (p + n * quarter)..stride * (p + n * quarter + 1);
            let rows = [0, 1, 2, 3].map(|n| (&re[row(n)], &im[row(n)]));
            let out = 4 * stride * p..4 * stride * (p + 1);
            let (re0, rest) = to_re[out.clone()].split_at_mut(stride);
            let (re1, rest) = rest.split_at_mut(stride);
            let (re2, re3) = rest.split_at_mut(stride);
            let (im0, rest) = to_im[out].split_at_mut(stride);
            let (im1, rest) = rest.split_at_mut(stride);
            let (im2, im3) = rest.split_at_mut(stride);
            for q in 0..stride {
                let [a, b, c, d] = [0, 1, 2, 3].map(|n: usize| (rows[n].0[q], rows[n].1[q]));
                let (apc, amc) = ((a.0 + c.0, a.1 + c.1), (a.0 - c.0, a.1 - c.1));
                let bpd = (b.0 + d.0, b.1 + d.1);
                let jbmd = (d.1 - b.1, b.0 - d.0); // i (b - d)
                (re0[q], im0[q]) = (apc.0 + bpd.0, apc.1 + bpd.1);
                (re1[q], im1[q]) = times(w1, (amc.0 - jbmd.0, amc.1 - jbmd.1));
                (re2[q], im2[q]) = times(w2, (apc.0 - bpd.0, apc.1 - bpd.1));
                (re3[q], im3[q]) = times(w3, (amc.0 + jbmd.0, amc.1 + jbmd.1));
            }
        }
    }
}

#[inline(always)]
fn times(w: (f64, f64), z: (f64, f64)) -> (f64, f64) {
    (w.0 * z.0 - w.1 * z.1, w.0 * z.1 + w.1 * z.0)
}

fn halves(from: &Parts, to: &mut Parts, stride: usize) {
    for (from, to) in from.iter().zip(to) {
        for q in 0..stride {
            (to[q], to[q + stride]) = (from[q] + from[q + stride], from[q] - from[q + stride]);
        }
    }
}

/// `exp(pi i steps / of)`.
fn half_turns(steps: f64, of: usize) -> Complex<f64> {
    let angle = PI * steps / float(of);
    Complex::new(libm::cos(angle), libm::sin(angle))
}

fn float(number: usize) -> f64 {
    number as f64 // exact: lengths are far below 2^53
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

    #[test]
    fn it_is_the_spectrum_of_the_padded_signal() {
        for samples in [3, 4, 7, 8, 16, 33, 100, 500, 1024, 2000] {
            let noise = |n: u64| random::gaussian(samples, n);
            let signal: Vec<f64> = (0..samples).map(noise).collect();
            let spectrum = RealSpectrum::new(signal.len());
            let mut padded: Vec<_> = signal.iter().map(|&x| Complex::new(x, 0.0)).collect();
            padded.resize(spectrum.length(), Complex::new(0.0, 0.0));
            let expected = forward(&padded);
            let powers = spectrum.powers(&signal, 0..spectrum.length() / 2);
            for (k, power) in powers.iter().enumerate() {
                let off = power - expected[k].norm_sqr();
                assert!(off.abs() < 1e-11 * samples as f64, "{samples} {k}: {off:e}");
            }
        }
    }
}
