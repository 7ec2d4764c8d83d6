//! Varies the encoder rate and the output rate. The same device is walked in loops with other rates.
//!
//! Each pair of rates is a loop, and is walked as in [`levers`](super::levers). The latency and the phases of the hit
//! keep their duration at any sample rate. The estimator keeps its parameters, so a window of n samples becomes shorter
//! at a higher rate. An output needs a sample, so only pairs with a whole-number ratio are used.

use super::levers::{Between, Lever, takes};
use crate::{error::Error, scene::NamedScene};

/// The requested rates in Hz. A list is empty if the scene's own rates are used.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rates {
    /// Sample rates of the encoder, in Hz.
    pub encoder_hz: Vec<f64>,
    pub output_hz: Vec<f64>,
}

/// Tolerance within which the ratio of two rates counts as a whole number.
const WHOLE: f64 = 1e-6;

/// Number of samples from output to output; `None` if the ratio of the rates is not a whole number.
fn period(encoder_hz: f64, output_hz: f64) -> Option<u32> {
    let ratio = encoder_hz / output_hz;
    let whole = ratio.round();
    let divides = whole >= 1.0 && (ratio / whole - 1.0).abs() < WHOLE;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a scene's check refuses what is too long"
    )]
    divides.then(|| whole.min(f64::from(u32::MAX)) as u32)
}

impl Rates {
    /// The loops for these rates, ordered by encoder rate, then by output rate.
    ///
    /// # Errors
    /// A rate has no whole-number ratio to any other rate, or the scene does not allow it.
    pub fn loops(&self, scene: &NamedScene) -> Result<Vec<Lever>, Error> {
        let own = &scene.scene;
        let own_hz = own.control.rate_hz;
        let or_own = |asked: &[f64], own_hz: f64| match asked {
            [] => vec![own_hz],
            _ => super::sweep::ascending(asked),
        };
        let encoder_hz = or_own(&self.encoder_hz, own_hz);
        let output_hz = or_own(&self.output_hz, own_hz / f64::from(own.actuator.period));
        for (which, rates) in [("encoder", &encoder_hz), ("output", &output_hz)] {
            if let Some(hz) = rates.iter().find(|hz| !(**hz > 0.0 && hz.is_finite())) {
                return Err(Error::Input(format!("{which} rate is {hz} Hz, allowed above 0")));
            }
        }
        let listed =
            |rates: &[f64]| rates.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        for &hz in &output_hz {
            if encoder_hz.iter().all(|&encoder| period(encoder, hz).is_none()) {
                return Err(Error::Input(format!(
                    "output rate {hz} Hz divides no encoder rate, which are {} Hz: an output comes with a sample",
                    listed(&encoder_hz)
                )));
            }
        }
        let mut loops = vec![];
        for &encoder in &encoder_hz {
            let before = loops.len();
            for &output in &output_hz {
                let Some(period) = period(encoder, output) else { continue };
                let mut changed = own.clone();
                changed.control.rate_hz = encoder;
                changed.actuator.period = period;
                changed.actuator.latency = own.actuator.latency * (encoder / own_hz);
                changed.velocity = changed.velocity.with_cutoff(None); // the cutoffs come from the sweep
                let all = std::mem::take(&mut changed.sweep.cutoffs_hz);
                changed.sweep.cutoffs_hz =
                    all.into_iter().filter(|hz| takes(&changed, *hz)).collect();
                changed.check().map_err(|why| {
                    Error::Input(format!(
                        "with an encoder rate of {encoder} Hz and outputs at {output} Hz: {why}"
                    ))
                })?;
                loops.push(Lever {
                    of_loop: scene.name.clone(),
                    between: Between::Nothing,
                    scene: changed,
                });
            }
            if loops.len() == before {
                return Err(Error::Input(format!(
                    "encoder rate {encoder} Hz is a multiple of no output rate, which are {} Hz: an output comes with a sample",
                    listed(&output_hz)
                )));
            }
        }
        Ok(loops)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(encoder_hz: &[f64], output_hz: &[f64]) -> Result<Vec<(f64, u32, f64)>, String> {
        let scene = NamedScene::load("paper-1um").unwrap();
        let rates = Rates { encoder_hz: encoder_hz.to_vec(), output_hz: output_hz.to_vec() };
        let loops = rates.loops(&scene).map_err(|error| error.to_string())?;
        let said = loops.iter().map(|lever| {
            let scene = &lever.scene;
            (scene.control.rate_hz, scene.actuator.period, scene.actuator.latency)
        });
        Ok(said.collect())
    }

    #[test]
    fn each_pair_that_divides_is_a_loop_with_the_same_latency_in_time() {
        assert_eq!(of(&[], &[]).unwrap(), [(1e4, 10, 10.0)]);
        assert_eq!(
            of(&[2e4, 5e3], &[1e3, 5e3]).unwrap(),
            [(5e3, 5, 5.0), (5e3, 1, 5.0), (2e4, 20, 20.0), (2e4, 4, 20.0)]
        );
        // 5 kHz is no multiple of 2 kHz. A repeated rate is used once.
        assert_eq!(of(&[2e3, 1e4], &[5e3, 1e3]).unwrap().len(), 3);
        assert_eq!(of(&[1e4, 1e4], &[1e3]).unwrap().len(), 1);
        // Rates with rounded decimals also give a whole-number ratio.
        assert_eq!(of(&[2_857.142_857], &[285.714_285]).unwrap()[0].1, 10);
    }

    #[test]
    fn rates_that_go_with_none_and_loops_that_cannot_be_are_refused_by_name() {
        let refused = |encoder: &[f64], output: &[f64]| of(encoder, output).unwrap_err();
        assert!(refused(&[1e4], &[3e3]).contains("output rate 3000 Hz divides no encoder rate"));
        let encoder = refused(&[7e3, 1e4], &[1e4]);
        assert!(
            encoder.contains("encoder rate 7000 Hz is a multiple of no output rate"),
            "{encoder}"
        );
        let fast = refused(&[1e9], &[1e3]);
        assert!(fast.contains("with an encoder rate of 1000000000 Hz"), "{fast}");
        assert_eq!(refused(&[-5.0], &[]), "encoder rate is -5 Hz, allowed above 0");
        assert!(refused(&[], &[0.0]).contains("output rate is 0 Hz"));
        assert!(refused(&[], &[f64::NAN]).contains("output rate is NaN Hz"));
    }
}
