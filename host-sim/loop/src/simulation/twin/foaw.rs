//! First-order adaptive windowing as published: each window length is checked against every sample in the window.

use super::LENGTH;

#[derive(Clone, Copy, Debug)]
pub struct Foaw {
    /// Whether the line is the least-squares fit to all samples of the window. Otherwise the line goes through the two
    /// ends of the window.
    pub best: bool,
    /// Length of the longest window, in samples.
    pub window: u32,
    /// Noise bound in counts: a sample may be this far from the line.
    pub noise: f64,
}

impl Foaw {
    /// Rounds the noise bound to 1/16 count, as the documentation of the setting says.
    pub(super) fn new(best: bool, window: u32, noise_counts: f64) -> Self {
        Self { best, window, noise: (16.0 * noise_counts).round() / 16.0 }
    }

    /// The velocity after a change of the count by `input`. `past` has the last differences, newest first.
    #[inline(never)] // so that the other estimators' state stays in registers
    pub(super) fn update(&self, past: &mut [f64; LENGTH], input: f64) -> f64 {
        past.rotate_right(1);
        past[0] = input;
        // s[j]: change of the count over the last j samples
        let mut s = [0.0; LENGTH];
        for j in 1..LENGTH {
            s[j] = s[j - 1] + past[j - 1];
        }
        let mut velocity = past[0];
        for i in 2..=self.window {
            let (number, over) = self.slope(&s, i);
            // all numbers are whole, so the comparison is exact; a sample exactly at the noise bound is inside
            let within = (0..i)
                .zip(&s)
                .all(|(j, s)| (s * over - f64::from(j) * number).abs() <= self.noise * over);
            if !within {
                break;
            }
            velocity = number / over;
        }
        velocity
    }

    /// Slope over `i` samples, as numerator and denominator of a fraction.
    fn slope(&self, s: &[f64; LENGTH], i: u32) -> (f64, f64) {
        let n = f64::from(i);
        if self.best {
            let sum: f64 = (0..=i).zip(s).map(|(j, s)| (2.0 * f64::from(j) - n) * s).sum();
            (sum, n * (n + 1.0) * (n + 2.0) / 6.0)
        } else {
            (s[i as usize], n)
        }
    }
}
