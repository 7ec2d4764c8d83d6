//! An accelerometer. Its noise depends only on the number of the reading, so every hit has the same noise. In lanes,
//! `engine/estimator/accelerometer.rs` does the same calculation. Tests compare the two.

use std::sync::Arc;

use zwidth::units::Acceleration;

use crate::{numerics::random, scene::Accelerometer};

/// An accelerometer in units of counts and samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sensor {
    pub full_scale: f64,
    /// Smallest step between two readings. It is 0 without quantisation.
    pub resolution: f64,
    pub bias: f64,
    /// RMS of the noise of one reading.
    noise: f64,
    /// Fraction of a change that passes the low-pass in one sample. It is 1 without a low-pass.
    pub follows: f64,
    filtered: f64,
    drawn: u64,
}

impl Sensor {
    /// Factor from counts per sample^2 to LSB of an [`Acceleration`].
    pub const LSB: f64 = (1u32 << Acceleration::FRACTION_BITS) as f64;

    /// A sensor at rest, before its first reading.
    pub fn new(sensor: &Accelerometer, rate_hz: f64, resolution_m: f64) -> Self {
        let per_unit = 1.0 / (resolution_m * rate_hz * rate_hz);
        let bandwidth_hz = sensor.bandwidth_hz.unwrap_or(f64::INFINITY);
        Self {
            full_scale: sensor.full_scale_m_per_s2 * per_unit,
            resolution: sensor.resolution_m_per_s2 * per_unit,
            bias: sensor.bias_m_per_s2 * per_unit,
            // the noise density, integrated over a band of half the sampling rate
            noise: sensor.noise_m_per_s2_per_sqrt_hz * (0.5 * rate_hz).sqrt() * per_unit,
            follows: -libm::expm1(-2.0 * core::f64::consts::PI * bandwidth_hz / rate_hz),
            filtered: 0.0,
            drawn: 0,
        }
    }

    /// The reading for a mean acceleration. `acceleration` is in counts per sample^2.
    pub fn read(&mut self, acceleration: f64) -> Acceleration {
        let shown = self.shown(acceleration);
        Acceleration::saturating_from_bits(round(shown * Self::LSB))
    }

    /// The reading in counts per sample^2, before its conversion to LSB.
    pub fn shown(&mut self, acceleration: f64) -> f64 {
        self.filtered += self.follows * (acceleration - self.filtered);
        let noise = self.noise();
        let reading = (self.filtered + noise + self.bias).clamp(-self.full_scale, self.full_scale);
        if self.resolution > 0.0 {
            (reading / self.resolution).round() * self.resolution
        } else {
            reading
        }
    }

    /// Noise of the next reading in counts per sample^2.
    fn noise(&mut self) -> f64 {
        if self.noise > 0.0 { self.noise * self.normal() } else { 0.0 }
    }

    fn normal(&mut self) -> f64 {
        let n = self.drawn;
        self.drawn += 2;
        let [radius, angle] = [n, n + 1].map(|n| random::uniform_with_zero(0, n));
        random::box_muller(1.0 - radius, angle)
    }
}

/// An accelerometer with its noise, for many hits side by side.
#[derive(Clone, Debug)]
pub(crate) struct Readings {
    pub sensor: Sensor,
    /// Factor from m/s to counts per sample.
    pub speed: f64,
    /// Noise of the reading at each sample of a hit, in counts per sample^2. At sample 0 there is no reading yet. So
    /// the value of sample 0 is minus the bias.
    pub noise: Arc<[f64]>,
}

impl Readings {
    /// Computes the noise of the sensor for hits of `samples` samples. `sensor` must be at rest.
    pub fn new(sensor: Sensor, speed: f64, samples: u32) -> Self {
        let mut drawing = sensor;
        let read = if sensor.noise > 0.0 { samples.saturating_sub(1) } else { 0 };
        let noise = (0..read).map(|_| drawing.noise());
        let noise = std::iter::once(-sensor.bias).chain(noise).collect();
        Self { sensor, speed, noise }
    }
}

/// The nearest integer, saturated to the range of `i32`.
pub(super) fn round(value: f64) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "saturates, as it must")]
    let nearest = value.round() as i32;
    nearest
}
