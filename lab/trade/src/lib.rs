//! Measures speed against accuracy: number formats and forms of the velocity filter, and methods to advance the plant.
//!
//! # The filter
//!
//! A [`Variant`] is a number format with a form (crate `filter-forms`). The filters of `idsp` and CMSIS-DSP are also
//! variants. Each variant runs on the same inputs at every cutoff. No result is computed from the coefficients:
//! | what | how | module |
//! |------|-----|--------|
//! | error of the response | largest `abs(H - H_exact)` for a DC gain of 1, from sines of half the full scale of Q15. The frequencies of the sines are 1/4 to 2 times the -3 dB frequency, up to 0.45 of the rate. Whole periods after the transient are measured | [`response`] |
//! | error of the -3 dB frequency | the frequency at which the measured gain is 0.707 | [`response`] |
//! | DC drift and bias | span of `sum(out - in)` over 10^6 samples at constant speeds. The span includes about 1 count of ripple. Bias is the drift per sample | [`drift`] |
//! | noise | RMS distance from the exact filter on a flickering count and on a quantised ramp, including the first sample | [`noise`] |
//! | limit cycle | largest output later than 20 / fc after the stop of the input | [`rest`] |
//! | headroom | largest speed at which a sudden reversal neither wraps nor clips | [`headroom`] |
//! | cycles | worst case on the virtual board's Cortex-M4, with conversion from and to velocity bits | [`cost`] |
//! | area | area of the scene's boundary walks with this velocity filter in the controller | [`area`] |
//!
//! *Exact* means the bilinear transform in closed form. For signals, *exact* means a state-variable filter in
//! double-double arithmetic ([`mod@reference`]), because `f64` also has a rounding error.
//!
//! A variant *would do* at a cutoff if it exceeds no [`Criterion`]. The error of this variant is then below the
//! encoder's error.
//!
//! # The plant
//!
//! Every method to advance the plant replays the commands of one wall hit, repeats hits on both sides of the boundary,
//! and walks along the boundary ([`plant`]). The cost of a method is a number of operations: evaluations of the plant's
//! equation times the operations of one evaluation.
//!
//! # Reproducible
//!
//! All columns except `*_ns` are the same in every run, to the last digit, with any number of threads. The figures of
//! methods show the number of operations and never a time.

pub mod area;
pub mod cost;
pub mod criterion;
pub mod drift;
pub mod filters;
pub mod headroom;
pub mod noise;
pub mod plant;
pub mod reference;
pub mod response;
pub mod rest;
pub mod table;
pub mod tone;

pub use criterion::Criterion;
pub use filter_forms::{Filter, Form, Format, Refused, Variant};

use sim_loop::{engine, error, numerics, plant as sim_plant, scene, scene::Scene, simulation};
use sim_studies::{analysis, study};

/// Settings that all filters of a scene share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bench {
    pub rate_hz: f64,
    pub resolution_m: f64,
    /// Number of fractional bits of a signal in Q15.
    pub q15_fraction: u32,
}

impl Bench {
    /// The settings of a scene. Q15 is scaled to the scene: the full scale of Q15, in counts per sample, is the
    /// smallest power of two above the highest speed at which the handle can hit the wall. This speed follows from the
    /// push and the device's spring, without friction.
    pub fn of(scene: &Scene) -> Self {
        let (device, hit) = (&scene.device, &scene.wall_hit);
        let spring = |x: f64| 0.5 * device.stiffness_n_per_m * (x - device.rest_position_m).powi(2);
        let (start, wall) = (device.start_position_m, scene.wall.position_m);
        let energy_j = hit.push_n * (wall - start) + spring(start) - spring(wall);
        let speed_m_per_s = (2.0 * energy_j.max(0.0) / device.mass_kg).sqrt();
        let rate_hz = scene.control.rate_hz;
        let counts = speed_m_per_s / (scene.encoder.resolution_m * rate_hz);
        let mut q15_fraction = 15;
        while q15_fraction > 0 && full_scale_counts(q15_fraction) < counts {
            q15_fraction -= 1;
        }
        Self { rate_hz, resolution_m: scene.encoder.resolution_m, q15_fraction }
    }

    /// Full scale of Q15, in counts per sample.
    pub fn q15_full_scale_counts(&self) -> f64 {
        full_scale_counts(self.q15_fraction)
    }

    /// Speed of one count per sample, in m/s.
    pub fn m_per_s(&self) -> f64 {
        self.resolution_m * self.rate_hz
    }

    pub fn filter(&self, variant: Variant, cutoff_hz: f64) -> Result<Filter, Refused> {
        Filter::new(variant, cutoff_hz, self.rate_hz, self.q15_fraction)
    }

    fn samples(&self, periods: f64, cutoff_hz: f64) -> u32 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let samples = (periods * self.rate_hz / cutoff_hz).ceil() as u32;
        samples
    }
}

fn full_scale_counts(q15_fraction: u32) -> f64 {
    f64::from(1u32 << (15 - q15_fraction))
}

/// The larger value. Infinity if one value is NaN, since the filter has then diverged.
fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// Number of LSB of the core's velocity in one count per sample.
const LSB_PER_COUNT: f64 = 65_536.0;

/// The default cutoffs. They begin at 0.1 Hz and have the steps 1, 2 and 5 in each decade. The last one is 0.45 of the
/// rate.
pub fn default_cutoffs_hz(rate_hz: f64) -> Vec<f64> {
    let highest = 0.45 * rate_hz;
    let decades = (-1..6).map(|exponent| 10f64.powi(exponent));
    let steps = decades.flat_map(|decade| [decade, 2.0 * decade, 5.0 * decade]);
    let mut cutoffs: Vec<f64> = steps.take_while(|hz| *hz < 0.75 * highest).collect();
    cutoffs.push(highest);
    cutoffs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    #[test]
    fn q15_is_scaled_to_the_speed_of_impact() {
        let bench = Bench::of(&NamedScene::load("paper-1um").unwrap().scene);
        // Without friction the speed is 0.98 m/s, or 98 counts per sample. With friction the handle hits the wall at
        // 0.49 m/s.
        assert_eq!(bench.q15_full_scale_counts(), 128.0);
        let bench = Bench::of(&NamedScene::load("paper-2um").unwrap().scene);
        assert_eq!(bench.q15_full_scale_counts(), 64.0);
    }

    #[test]
    fn the_cutoffs_go_from_a_tenth_of_a_hertz_to_0_45_of_the_rate() {
        let cutoffs = default_cutoffs_hz(1e4);
        assert_eq!(cutoffs.first(), Some(&0.1));
        assert_eq!(cutoffs[cutoffs.len() - 2..], [2000.0, 4500.0]);
        assert!(cutoffs.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
