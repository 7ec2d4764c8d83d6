//! The optional elements of a scene. Each element has one table. An absent element is not modelled and needs no time.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use zwidth::velocity::Sense;

use super::Scene;
use crate::scene::element::Nonlinear;

/// Optional element: quantisation of the command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Quantisation {
    /// A DAC with offset binary codes.
    Dac {
        /// Bits of a code. Full scale is `2^(bits-1) - 1` codes from the middle.
        bits: u32,
    },
    /// PWM of sign and magnitude.
    Pwm {
        /// Timer ticks per PWM period; at full scale the output is on for all ticks.
        steps: u32,
    },
}

impl Scene {
    pub(super) fn check_elements(&self) -> Result<(), String> {
        let sample_s = 1.0 / self.control.rate_hz;
        self.amplifier.map_or(Ok(()), |amplifier| amplifier.check())?;
        self.amplifier_error.map_or(Ok(()), |error| error.check())?;
        self.mode.map_or(Ok(()), |mode| mode.check())?;
        self.backlash.map_or(Ok(()), |backlash| backlash.check())?;
        if self.backlash.is_some() && self.mode.is_none() {
            return Err(
                "[mode] is missing, needed with backlash: the gap lies before this second mass"
                    .into(),
            );
        }
        self.offset.map_or(Ok(()), |offset| offset.check())?;
        self.arm.map_or(Ok(()), |arm| arm.check("arm"))?;
        self.arms.iter().try_for_each(|(name, arm)| arm.check(&format!("arms.{name}")))?;
        self.friction.map_or(Ok(()), |friction| friction.check())?;
        self.cogging.map_or(Ok(()), |cogging| cogging.check())?;
        self.travel.map_or(Ok(()), |travel| travel.check(&self.device))?;
        self.encoder_error.map_or(Ok(()), |error| error.check())?;
        self.encoder_noise.map_or(Ok(()), |noise| noise.check())?;
        let latency_s = self.actuator.latency * sample_s;
        self.jitter.map_or(Ok(()), |jitter| jitter.check(latency_s, sample_s))?;
        let nonlinear = self.nonlinear();
        match self.integrator {
            Some(integrator) => {
                integrator.check(&self.chain().step_demand(&nonlinear), sample_s)
            }
            None if nonlinear == Nonlinear::default() => Ok(()),
            None => Err("[integrator] is missing, needed with friction, cogging, travel or backlash: method = \"rk4\", \
                         \"semi-implicit-euler\" or \"dormand-prince\""
                .into()),
        }
    }

    /// Whether the scene can provide this input. The input `Edges` needs the exact times of the counts. Encoder noise
    /// and jitter change only once per sample, so a scene with noise or jitter cannot provide edges.
    pub fn feeds(&self, sense: Sense) -> bool {
        match sense {
            Sense::Force => true,
            Sense::Edge => self.encoder_noise.is_none() && self.jitter.is_none(),
            Sense::Acceleration => self.accelerometer.is_some(),
        }
    }

    /// Checks that the scene provides the input that its estimator needs.
    pub(super) fn check_senses(&self) -> Result<(), String> {
        let Some(sense) = self.velocity.sense().filter(|sense| !self.feeds(*sense)) else {
            return Ok(());
        };
        Err(format!(
            "velocity.estimator is {}, allowed {}",
            self.velocity.name(),
            match sense {
                Sense::Edge => "without the tables encoder_noise and jitter only",
                _ => "with a table accelerometer only",
            }
        ))
    }

    /// Tables of this scene that linear analysis cannot model.
    pub fn nonlinear_elements(&self) -> Vec<&'static str> {
        [
            ("output", self.output.is_some()),
            ("friction", self.friction.is_some()),
            ("cogging", self.cogging.is_some()),
            ("travel", self.travel.is_some()),
            ("backlash", self.backlash.is_some()),
            ("amplifier_error", self.amplifier_error.is_some()),
            ("encoder_error", self.encoder_error.is_some()),
            ("encoder_noise", self.encoder_noise.is_some()),
            ("jitter", self.jitter.is_some()),
            ("passivity", self.passivity.is_some()),
        ]
        .into_iter()
        .filter_map(|(name, present)| present.then_some(name))
        .collect()
    }
}
