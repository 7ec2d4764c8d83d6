//! Sines with a whole number of periods in a whole number of samples. The response is computed as a sum over exactly
//! these samples. So there is no spectral leakage.

use std::f64::consts::PI;

use nalgebra::Complex;

/// A sine and its window of measurement.
#[derive(Clone, Debug)]
pub struct Tone {
    /// Frequency in cycles per sample.
    pub frequency: f64,
    window: u32,
    /// Input at each sample of the window, in LSB of the core's velocity.
    input: Vec<i32>,
    /// Cosine and sine at each sample of the window.
    phasor: Vec<Complex<f64>>,
    /// The sum of each rounded input times its phasor over the window.
    spectrum: Complex<f64>,
}

/// Shortest window of a tone, in samples.
const WINDOW_MIN: f64 = 4096.0;

impl Tone {
    /// The tone nearest to `frequency`, in cycles per sample. `amplitude` is in LSB.
    pub fn near(frequency: f64, amplitude: f64) -> Self {
        let cycles = (WINDOW_MIN * frequency).ceil().max(1.0);
        let length = (cycles / frequency).round();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let (window, step) = (length as u32, cycles as u64);
        let phasor: Vec<Complex<f64>> = (0..u64::from(window))
            .map(|n| {
                #[expect(clippy::cast_precision_loss, reason = "below the window's length")]
                let place = (n * step % u64::from(window)) as f64;
                Complex::cis(-2.0 * PI * place / length)
            })
            .collect();
        #[expect(clippy::cast_possible_truncation, reason = "the amplitude is far within i32")]
        let input: Vec<i32> = phasor.iter().map(|p| (-amplitude * p.im).round() as i32).collect();
        let spectrum = input.iter().zip(&phasor).map(|(&x, p)| p * f64::from(x)).sum();
        Self { frequency: cycles / length, window, input, phasor, spectrum }
    }

    pub fn window(&self) -> u32 {
        self.window
    }

    /// The input at a sample, in LSB.
    #[inline]
    pub fn input(&self, n: u32) -> i32 {
        self.input[(n % self.window) as usize]
    }

    /// The weight of an output sample.
    #[inline]
    pub fn phasor(&self, n: u32) -> Complex<f64> {
        self.phasor[(n % self.window) as usize]
    }

    /// The filter's response. `sum` is the sum of each output times its phasor over a window, in LSB.
    pub fn response(&self, sum: Complex<f64>) -> Complex<f64> {
        sum / self.spectrum
    }
}
