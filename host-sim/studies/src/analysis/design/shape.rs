//! A filter of the search: the four numbers of `biquad`, where they are searched, and what follows from them alone.

use std::f64::consts::PI;

use nalgebra::Complex;
use serde::Serialize;
use zwidth::{Design, VelocitySettings};

use crate::analysis::linear::{TransferFunction, transfer_function};

/// Numbers of a filter.
pub const NUMBERS: usize = 4;

/// Frequencies that are searched, of the rate: 30 to 2000 Hz at 10 kHz.
const FREQUENCY: [f64; 2] = [3e-3, 0.2];
/// Damping ratios that are searched.
const DAMPING: [f64; 2] = [0.02, 3.0];
/// Leads that are searched, in units of `1 / w`, w the poles' frequency: a Butterworth low-pass is at -1.4.
const LEAD: [f64; 2] = [-2.0, 4.0];
/// Farthest that the second zero leads, in the same unit.
const SECOND: f64 = 3.0;
/// Frequencies at which the gain is looked at, from a part of half the rate to half the rate.
const LOOKS: u32 = 400;
const LOWEST: f64 = 1e-3;

/// The numbers of `estimator = "biquad"`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shape {
    /// Of the poles, Hz.
    pub frequency_hz: f64,
    /// Of the poles.
    pub damping: f64,
    /// By which a slow motion is led, s.
    pub lead_s: f64,
    /// Place of the second zero.
    pub zero: f64,
}

/// With so many digits: what is found is typed into scenes.
fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

impl Shape {
    /// The filter at a place of the search, 0 to 1 each, with four digits of each number.
    pub fn at([f, d, lead, second]: [f64; NUMBERS], rate_hz: f64) -> Self {
        let between = |[low, high]: [f64; 2], part: f64| low * (high / low).powf(part);
        let frequency_hz = rounded(between(FREQUENCY, f) * rate_hz, 4);
        let per_sample = 2.0 * PI * frequency_hz / rate_hz;
        let lead = LEAD[0] + (LEAD[1] - LEAD[0]) * lead;
        // even in how far it leads, finer below, where its place moves fast
        let h = -0.5 + second * second * (0.5 + SECOND / per_sample);
        Self {
            frequency_hz,
            damping: rounded(between(DAMPING, d), 3),
            lead_s: rounded(lead / per_sample / rate_hz, 4),
            zero: (h / (1.0 + h) * 1e4).round() / 1e4,
        }
    }

    /// As the core takes it.
    pub fn settings(&self) -> VelocitySettings {
        let Self { frequency_hz, damping, lead_s, zero } = *self;
        VelocitySettings::Biquad { frequency_hz, damping, lead_s, zero }
    }

    /// From the position to the velocity; `None` if the core refuses it.
    pub fn response(&self, design: &Design) -> Option<TransferFunction> {
        transfer_function(&self.settings(), design).ok().flatten()
    }

    /// Largest gain of the velocity over the true one, dB; `None` if the core refuses it.
    pub fn gain_peak_db(&self, design: &Design) -> Option<f64> {
        self.response(design).map(|response| gain_peak_db(&response, design.rate_hz))
    }

    /// The same filter with one number off by a factor, and its lead within what the core takes.
    fn off(&self, place: usize, factor: f64, design: &Design) -> Option<Self> {
        let mut other = *self;
        match place {
            0 => other.frequency_hz *= factor,
            _ => other.damping *= factor,
        }
        match other.settings().build(design) {
            Ok(_) => Some(other),
            Err(error) if error.parameter == "lead_s" => {
                other.lead_s = other.lead_s.clamp(*error.range.start(), *error.range.end());
                other.settings().build(design).is_ok().then_some(other)
            }
            Err(_) => None,
        }
    }

    /// The filters that a person may take for this one: frequency or damping off by that factor, either way.
    pub fn mistuned(&self, by: f64, design: &Design) -> Vec<Self> {
        let ways = [0, 1].into_iter().flat_map(|place| [(place, 1.0 / by), (place, by)]);
        ways.filter_map(|(place, factor)| self.off(place, factor, design)).collect()
    }
}

/// Largest gain of an estimate over the true velocity, dB.
pub fn gain_peak_db(response: &TransferFunction, rate_hz: f64) -> f64 {
    let gains = (0..=LOOKS).map(|n| {
        let w = PI * LOWEST.powf(1.0 - f64::from(n) / f64::from(LOOKS)); // of a sample
        let value = response.at(Complex::new(w.cos(), -w.sin()));
        value.norm() / (w * rate_hz)
    });
    20.0 * gains.fold(0.0, f64::max).log10()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;

    #[test]
    fn the_peak_is_that_of_a_resonance() {
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        // far below the rate a filter of second order without zeros peaks by 1 / (2 zeta sqrt(1 - zeta^2))
        for damping in [0.05, 0.2, 0.5] {
            let late = -2.0 * damping / (2.0 * PI * 50.0);
            let shape = Shape { frequency_hz: 50.0, damping, lead_s: late + 5e-5, zero: 0.0 };
            let peak = 20.0 * (0.5 / damping / (1.0f64 - damping * damping).sqrt()).log10();
            let found = shape.gain_peak_db(&design).unwrap();
            assert!((found - peak).abs() < 0.1, "{damping}: {found} dB of {peak}");
        }
    }

    #[test]
    fn a_place_has_few_digits_and_most_places_are_accepted() {
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        let mut taken = 0;
        for n in 0..1000 {
            let place = std::array::from_fn(|k| {
                crate::numerics::random::uniform(7, NUMBERS as u64 * n + k as u64)
            });
            let shape = Shape::at(place, 1e4);
            assert!(format!("{}", shape.frequency_hz).len() <= 6, "{shape:?}");
            taken += u32::from(shape.gain_peak_db(&design).is_some());
        }
        assert!((200..900).contains(&taken), "{taken}");
    }

    #[test]
    fn a_mistuned_filter_is_off_by_as_much_and_accepted() {
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        let shape = Shape { frequency_hz: 500.0, damping: 0.5, lead_s: 2e-4, zero: 0.2 };
        let all = shape.mistuned(1.2, &design);
        assert_eq!(all.len(), 4);
        assert!((all[1].frequency_hz - 600.0).abs() < 1e-9 && all[1].damping == 0.5);
        assert!((all[2].damping - 0.5 / 1.2).abs() < 1e-9);
        assert!(all.iter().all(|shape| shape.gain_peak_db(&design).is_some()));
    }
}
