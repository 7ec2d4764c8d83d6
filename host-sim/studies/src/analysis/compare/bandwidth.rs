//! A common measure for the tunings of all estimators: the -3 dB frequency of the response from the position to the
//! estimate. All searches cover the same range of this bandwidth. A tuning that is called "wrong by 20 %" has a
//! bandwidth that is wrong by 20 %.
//!
//! | estimator | its bandwidth |
//! |-----------|---------------|
//! | linear in the position | highest frequency at which `V(z) / (j w)` is above -3 dB; half the rate if it is always above |
//! | observer, fusion | the same for their response to the position alone; above this frequency these estimators follow force or acceleration |
//! | adaptive windowing | the same with its longest window |
//! | time stamps | the same with an edge in every sample |
//! | Levant's differentiator | the same for the equivalent linear loop at an error of one count, see below |
//!
//! **Levant's differentiator** is nonlinear, so its bandwidth depends on the size of the error. For `e = sin(w t)`
//! counts, the describing function of the sign term is `4 / pi`. The describing function of the root term is 1.1128 (`2
//! / pi` times the integral of `sin^(3/2)` from 0 to pi). With these describing functions, the equivalent linear loop
//! is:
//!
//! ```text
//! V / (s X) = (p s + i) / (s^2 + p s + i),   p = 1.1128 lambda,   i = 4 alpha / pi     explicit
//!                     i / (s^2 + p s + i)                                             implicit: u1
//! ```
//!
//! The differentiator is homogeneous, so all its frequencies are proportional to sqrt(C). So a bandwidth larger by 20 %
//! needs a C larger by 44 %.

use std::f64::consts::PI;

use nalgebra::Complex;
use zwidth::{Design, SettingsError, VelocitySettings, velocity::LevantDesign};

use crate::analysis::linear::position_response;

/// Lowest frequency of the grid, as a fraction of the sample rate.
const LOWEST: f64 = 1e-5;
/// Number of grid points from `LOWEST` to half the sample rate. A decade has 80 points.
const POINTS: u32 = 376;

/// Bandwidth in Hz: the frequency at which the response from the position to the estimate is -3 dB.
pub fn bandwidth_hz(settings: &VelocitySettings, design: &Design) -> Result<f64, SettingsError> {
    let of_rate = match *settings {
        VelocitySettings::LevantExplicit { acceleration_max_m_per_s2, lambda_ratio }
        | VelocitySettings::LevantImplicit { acceleration_max_m_per_s2, lambda_ratio } => {
            let implicit = matches!(settings, VelocitySettings::LevantImplicit { .. });
            let sizes = LevantDesign::new(acceleration_max_m_per_s2, lambda_ratio, design)?;
            let (p, i) = (1.1128 * sizes.lambda, 4.0 / PI * sizes.alpha);
            highest(|of_rate| {
                let s = Complex::new(0.0, 2.0 * PI * of_rate);
                let over = if implicit { Complex::new(i, 0.0) } else { s * p + i };
                (over / (s * s + s * p + i)).norm()
            })
        }
        _ => match position_response(settings, design)? {
            None => 0.5,
            Some(function) => highest(|of_rate| {
                let w = 2.0 * PI * of_rate;
                let back = Complex::new(w.cos(), -w.sin());
                function.at(back).norm() / (w * design.rate_hz)
            }),
        },
    };
    Ok(of_rate * design.rate_hz)
}

/// The highest frequency at which a magnitude is above -3 dB, as a fraction of the sample rate.
fn highest(magnitude: impl Fn(f64) -> f64) -> f64 {
    let above = |of_rate: f64| magnitude(of_rate) >= 0.5f64.sqrt();
    let at = |n: u32| LOWEST * (0.5 / LOWEST).powf(f64::from(n) / f64::from(POINTS));
    let Some(last) = (0..=POINTS).rev().find(|&n| above(at(n))) else { return LOWEST };
    if last == POINTS {
        return 0.5;
    }
    let (mut low, mut high) = (at(last), at(last + 1));
    for _ in 0..40 {
        let middle = (low * high).sqrt();
        if above(middle) { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NamedScene;
    use zwidth::velocity::EstimatorName;

    fn of(settings: VelocitySettings) -> f64 {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        bandwidth_hz(&settings, &scene.design()).unwrap()
    }

    #[test]
    fn bandwidths_are_those_of_theory() {
        let near = |got: f64, want: f64, within: f64| {
            assert!((got / want - 1.0).abs() < within, "{got} Hz, not {want}");
        };
        // The position is differenced over one sample. At this low frequency that has little effect: sinc(200 / 10000)
        // is 0.9993.
        near(of(VelocitySettings::ButterworthPrewarped { cutoff_hz: 200.0 }), 200.0, 1e-3);
        near(of(VelocitySettings::TrackingLoop { bandwidth_hz: 200.0 }), 0.6436 * 200.0, 0.01);
        // sin(x) / x = 1 / sqrt(2) at x = 1.3916
        near(of(VelocitySettings::Difference {}), 1e4 * 1.391_557 / PI, 1e-5);
        for window_samples in [1, 4, 16] {
            let windowed = of(VelocitySettings::FoawEnd { window_samples, noise_counts: 1.0 });
            near(windowed, 1e4 * 1.391_557 / PI / f64::from(window_samples), 1e-5);
            near(of(VelocitySettings::TimeStamps { span_samples: window_samples }), windowed, 1e-9);
        }
        // (1 + 9 x^2) / (1 + x^2)^3 = 1/2 at x = 1.6426
        near(of(VelocitySettings::Fusion { crossover_hz: 20.0 }), 1.6426 * 20.0, 0.01);
        near(of(VelocitySettings::Observer { bandwidth_hz: 20.0, mass_kg: 0.416 }), 32.9, 0.01);
        // The bandwidth is proportional to sqrt(C). The implicit form uses the integrator alone, and has a lower
        // bandwidth.
        let levant = |name: EstimatorName, c| of(name.defaults().with_tuning(c).with_second(1.0));
        let [explicit, implicit] = [EstimatorName::LevantExplicit, EstimatorName::LevantImplicit];
        near(levant(implicit, 4.0) / levant(implicit, 1.0), 2.0, 1e-6);
        assert!(levant(implicit, 1.0) < levant(explicit, 1.0));
        // The estimator fits a parabola through three samples. Its response is never below -3 dB.
        assert_eq!(of(VelocitySettings::Taylor2 {}), 5000.0);
    }
}
