//! Speed against accuracy, measured: number formats and forms of the velocity filter, and ways to advance the plant.
//!
//! # The filter
//!
//! Every [`Variant`] (number format and form, `idsp`'s and CMSIS-DSP's filters among them; crate `filter-forms`) is run, not
//! computed from its coefficients, at every cutoff, on the same inputs:
//!
//! | what | how | module |
//! |------|-----|--------|
//! | error of the response | sines of half the full scale of Q15 at 1/4 to 2 times the -3 dB frequency (up to 0.45 of the rate), in whole periods after the transient: the largest `abs(H - H_exact)` of a DC gain of 1 | [`response`] |
//! | error of the -3 dB frequency | the frequency at which the measured gain is 0.707 | [`response`] |
//! | DC drift and bias | span of `sum(out - in)` over 10^6 samples at constant speeds (the counts' own ripple is about 1 count); the same per sample | [`drift`] |
//! | noise | RMS distance from the exact filter on a flickering count and on a quantised ramp, from the first sample on | [`noise`] |
//! | limit cycle | largest output from 20 / fc after the input has stopped | [`rest`] |
//! | headroom | largest speed whose sudden reversal is filtered without wrap or clip | [`headroom`] |
//! | cycles | worst case on the Cortex-M4 core of the virtual board, velocity bits in and out | [`cost`] |
//! | area | the scene's boundary walks with this filter in the controller's place of the velocity filter | [`area`] |
//!
//! *Exact* is the bilinear transform in closed form, and for signals a state-variable filter in
//! double-double arithmetic ([`mod@reference`]): `f64` has an error too.
//!
//! A variant *would do* at a cutoff if no [`Criterion`] is missed: what it does wrong is then below what the encoder
//! does anyway.
//!
//! # The plant
//!
//! Every way to advance the plant replays the commands of one wall hit, repeats hits on both sides of the boundary, and
//! follows the boundary ([`plant`]). Cost is counted: evaluations of the plant's equation times their operations.
//!
//! # Reproducible
//!
//! All but the columns named `*_ns` is the same in every run, to the last digit, on any number of threads. Figures
//! show counted cost, never wall time.

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

/// What the filters of a scene have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bench {
    /// Samples per second, Hz.
    pub rate_hz: f64,
    /// Length of a count, m per count.
    pub resolution_m: f64,
    /// Fractional bits of a signal in Q15.
    pub q15_fraction: u32,
}

impl Bench {
    /// Q15 is scaled to the scene: its full scale is the smallest power of two, in counts per sample, above the speed at which
    /// the handle can hit the wall, which is that of the push and the device's spring without its friction.
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

    /// Full scale of Q15, counts per sample.
    pub fn q15_full_scale_counts(&self) -> f64 {
        full_scale_counts(self.q15_fraction)
    }

    /// m/s per count per sample.
    pub fn m_per_s(&self) -> f64 {
        self.resolution_m * self.rate_hz
    }

    /// The filter at rest.
    pub fn filter(&self, variant: Variant, cutoff_hz: f64) -> Result<Filter, Refused> {
        Filter::new(variant, cutoff_hz, self.rate_hz, self.q15_fraction)
    }

    /// `periods` of the cutoff, in samples.
    fn samples(&self, periods: f64, cutoff_hz: f64) -> u32 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let samples = (periods * self.rate_hz / cutoff_hz).ceil() as u32;
        samples
    }
}

fn full_scale_counts(q15_fraction: u32) -> f64 {
    f64::from(1u32 << (15 - q15_fraction))
}

/// The larger; infinity where something is no number, because a filter has blown up.
fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// LSB of the core's velocity per count per sample.
const LSB_PER_COUNT: f64 = 65_536.0;

/// Cutoffs that are tried unless others are asked for: from 0.1 Hz in steps of 1, 2, 5, and 0.45 of the rate.
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
        // 0.98 m/s without friction, 98 counts per sample; with it the handle hits at 0.49 m/s
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
