//! A filter of the search. Its parameters are the four numbers of `biquad` or the eight of `biquad-2`. This module also
//! has the ranges of the parameters, and values that are computed from the parameters without a walk.

use std::f64::consts::PI;

use nalgebra::Complex;
use serde::Serialize;
use zwidth::{Design, VelocitySettings};

use crate::{
    analysis::linear::{TransferFunction, transfer_function},
    notation::rounded,
};

/// Number of parameters of a section.
pub const NUMBERS: usize = 4;

/// Frequencies that the search may use, as a fraction of the sample rate. At 10 kHz they are 30 to 2000 Hz.
const FREQUENCY: [f64; 2] = [3e-3, 0.2];
/// Damping ratios that the search may use.
const DAMPING: [f64; 2] = [0.02, 3.0];
/// Range of the pole frequency of the second section, divided by the pole frequency of the first section.
const RATIO: [f64; 2] = [0.25, 8.0];
/// Frequency of a second section that has no effect, as a fraction of the sample rate. With a lower frequency the sum
/// of coefficients would overflow.
const FREE: f64 = 0.1;
/// Leads that the search may use, in units of `1 / w`, where w is the frequency of the poles. A Butterworth low-pass
/// has a lead of -1.4.
const LEAD: [f64; 2] = [-2.0, 4.0];
/// Largest lead that the second zero may add, in units of `1 / w`.
const SECOND: f64 = 3.0;
/// Number of frequencies, up to half the sample rate, at which the gain is computed.
const LOOKS: u32 = 400;
/// Lowest frequency at which the gain is computed, as a fraction of half the sample rate.
const LOWEST: f64 = 1e-3;

/// The parameters of `estimator = "biquad"`, and those of a second section if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shape {
    /// Frequency of the poles, in Hz.
    pub frequency_hz: f64,
    /// Damping ratio of the poles.
    pub damping: f64,
    /// Lead of the estimate in a slow motion, in s.
    pub lead_s: f64,
    /// The second zero, as a point in the z-plane.
    pub zero: f64,
    pub second: Option<Second>,
}

/// The parameters that `estimator = "biquad-2"` has for its second section.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Second {
    /// Frequency of the second section's poles, divided by the frequency of the first section's poles.
    pub ratio: f64,
    /// Damping ratio of the second section's poles.
    pub damping: f64,
    /// Lead that the second section adds in a slow motion, in s.
    pub lead_s: f64,
    /// The second zero of the second section, as a point in the z-plane.
    pub zero: f64,
}

fn between([low, high]: [f64; 2], part: f64) -> f64 {
    low * (high / low).powf(part)
}

impl Shape {
    /// The filter that belongs to a point of the search. Each coordinate is 0 to 1. Each parameter is rounded to four
    /// digits or less. Eight coordinates give two sections.
    pub fn at(place: &[f64], rate_hz: f64) -> Self {
        let number = |n: usize| place.get(n).copied().unwrap_or_default();
        let of = |n: usize, frequency_hz: f64| {
            let per_sample = 2.0 * PI * frequency_hz / rate_hz;
            let lead = LEAD[0] + (LEAD[1] - LEAD[0]) * number(n + 1);
            // The lead of the second zero grows with the square of the coordinate. At low leads the zero moves fast. So
            // the steps are finer there.
            let h = -0.5 + number(n + 2).powi(2) * (0.5 + SECOND / per_sample);
            let zero = (h / (1.0 + h) * 1e4).round() / 1e4;
            [rounded(between(DAMPING, number(n)), 3), rounded(lead / per_sample / rate_hz, 4), zero]
        };
        let frequency_hz = rounded(between(FREQUENCY, number(0)) * rate_hz, 4);
        let [damping, lead_s, zero] = of(1, frequency_hz);
        let second = (place.len() > NUMBERS).then(|| {
            let ratio = rounded(between(RATIO, number(NUMBERS)), 4);
            let [damping, lead_s, zero] = of(NUMBERS + 1, ratio * frequency_hz);
            Second { ratio, damping, lead_s, zero }
        });
        Self { frequency_hz, damping, lead_s, zero, second }
    }

    /// Changes a point so that its second section has no effect: its two poles are equal, and both zeros are on these
    /// poles. The frequency of the second section must be in the range of the search.
    pub fn without_second(place: &mut [f64], rate_hz: f64) {
        let ratio = FREE * rate_hz / Self::at(place, rate_hz).frequency_hz;
        let ratio = (ratio / RATIO[0]).ln() / (RATIO[1] / RATIO[0]).ln();
        if let Some(place) = place.get_mut(NUMBERS) {
            *place = ratio.clamp(0.0, 1.0);
        }
        let shape = Self::at(place, rate_hz);
        let (Some(second), [.., d, lead, zero]) = (shape.second, place) else { return };
        *d = -DAMPING[0].ln() / (DAMPING[1] / DAMPING[0]).ln();
        *lead = -LEAD[0] / (LEAD[1] - LEAD[0]);
        let per_sample = 2.0 * PI * shape.frequency_hz * second.ratio / rate_hz;
        let h = 1.0 / per_sample.exp_m1();
        *zero = ((h + 0.5) / (0.5 + SECOND / per_sample)).sqrt();
    }

    pub fn settings(&self) -> VelocitySettings {
        let Self { frequency_hz, damping, lead_s, zero, second } = *self;
        match second {
            None => VelocitySettings::Biquad { frequency_hz, damping, lead_s, zero },
            Some(second) => VelocitySettings::Biquad2 {
                frequency_hz,
                damping,
                lead_s,
                zero,
                second_ratio: second.ratio,
                second_damping: second.damping,
                second_lead_s: second.lead_s,
                second_zero: second.zero,
            },
        }
    }

    /// Lead of both sections together in a slow motion, in s.
    pub fn led_s(&self) -> f64 {
        self.lead_s + self.second.map_or(0.0, |second| second.lead_s)
    }

    /// Response from the position to the estimate; `None` if the core refuses the filter.
    pub fn response(&self, design: &Design) -> Option<TransferFunction> {
        transfer_function(&self.settings(), design).ok().flatten()
    }

    /// Largest gain from the true velocity to the estimate, in dB. `None` if the core refuses the filter.
    pub fn gain_peak_db(&self, design: &Design) -> Option<f64> {
        self.response(design).map(|response| gain_peak_db(&response, design.rate_hz))
    }

    /// The same filter with its frequencies or its damping ratios multiplied by a factor. `place` says which of the
    /// two. The leads stay within the range of the core.
    fn off(&self, place: usize, factor: f64, design: &Design) -> Option<Self> {
        let mut other = *self;
        match place {
            0 => other.frequency_hz *= factor,
            _ => {
                other.damping *= factor;
                other.second.iter_mut().for_each(|second| second.damping *= factor);
            }
        }
        for _ in 0..2 {
            let Err(error) = other.settings().build(design) else { return Some(other) };
            let lead_s = match (error.parameter, &mut other.second) {
                ("lead_s", _) => &mut other.lead_s,
                ("second_lead_s", Some(second)) => &mut second.lead_s,
                _ => return None,
            };
            *lead_s = lead_s.clamp(*error.range.start(), *error.range.end());
        }
        other.settings().build(design).is_ok().then_some(other)
    }

    /// The mistuned filters: the frequencies or the damping ratios are multiplied or divided by the factor.
    pub fn mistuned(&self, by: f64, design: &Design) -> Vec<Self> {
        let ways = [0, 1].into_iter().flat_map(|place| [(place, 1.0 / by), (place, by)]);
        ways.filter_map(|(place, factor)| self.off(place, factor, design)).collect()
    }
}

/// Largest gain from the true velocity to the estimate, in dB.
pub fn gain_peak_db(response: &TransferFunction, rate_hz: f64) -> f64 {
    let gains = (0..=LOOKS).map(|n| {
        let w = PI * LOWEST.powf(1.0 - f64::from(n) / f64::from(LOOKS)); // rad per sample
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
        // At frequencies far below the sample rate, a second-order filter without zeros has a peak of 1 / (2 zeta
        // sqrt(1 - zeta^2)).
        for damping in [0.05, 0.2, 0.5] {
            let late = -2.0 * damping / (2.0 * PI * 50.0);
            let lead_s = late + 5e-5;
            let shape = Shape { frequency_hz: 50.0, damping, lead_s, zero: 0.0, second: None };
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
            let place: [f64; NUMBERS] = std::array::from_fn(|k| {
                crate::numerics::random::uniform(7, NUMBERS as u64 * n + k as u64)
            });
            let shape = Shape::at(&place, 1e4);
            assert!(format!("{}", shape.frequency_hz).len() <= 6, "{shape:?}");
            taken += u32::from(shape.gain_peak_db(&design).is_some());
        }
        assert!((200..900).contains(&taken), "{taken}");
    }

    #[test]
    fn a_mistuned_filter_is_off_by_as_much_and_accepted() {
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        let second = None;
        let shape = Shape { frequency_hz: 500.0, damping: 0.5, lead_s: 2e-4, zero: 0.2, second };
        let all = shape.mistuned(1.2, &design);
        assert_eq!(all.len(), 4);
        assert!((all[1].frequency_hz - 600.0).abs() < 1e-9 && all[1].damping == 0.5);
        assert!((all[2].damping - 0.5 / 1.2).abs() < 1e-9);
        assert!(all.iter().all(|shape| shape.gain_peak_db(&design).is_some()));
    }

    #[test]
    fn a_second_section_may_change_nothing_and_is_mistuned_too() {
        let design = NamedScene::load("paper-1um").unwrap().scene.design();
        let mut place = [0.62, 0.4, 0.35, 0.3, 0.55, 0.2, 0.9, 0.1];
        Shape::without_second(&mut place, 1e4);
        let both = Shape::at(&place, 1e4);
        let one = Shape { second: None, ..both };
        let [a, b] = [both, one].map(|shape| shape.response(&design).unwrap());
        for w in [0.001f64, 0.03, 0.3, 1.0, 3.0] {
            let z = Complex::new(w.cos(), -w.sin());
            let off = (a.at(z) / b.at(z) - 1.0).norm();
            assert!(off < 2e-3, "{off} at {w}: {both:?}");
        }
        assert!((both.led_s() - one.led_s()).abs() < 1e-9);
        let all = both.mistuned(1.2, &design);
        assert_eq!(all.len(), 4);
        let dampings = all[3].second.unwrap().damping / both.second.unwrap().damping;
        assert!(
            (dampings - 1.2).abs() < 1e-9 && (all[3].damping / both.damping - 1.2).abs() < 1e-9
        );
    }
}
