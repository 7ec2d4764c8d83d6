//! Turns a force into a DAC or PWM code. This is the last stage of the loop, and it runs for every output. An earlier
//! stage, [`Demand::saturate`](crate::units::Demand::saturate), has limited the force to full scale. So nothing is
//! clamped here.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::ops::RangeInclusive;

use crate::{
    range::{SettingsError, widen, within},
    units::{Force, OutputCode},
};

/// The kind of hardware that takes the force command, and its resolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// The simulator's ideal output, without quantisation. The code is the force in LSB of 2^-30.
    Continuous,
    /// A DAC with offset binary codes `0 ..= 2^bits - 1`. Zero force is at `2^(bits-1)`. Full scale is `2^(bits-1) - 1`
    /// codes away from zero force, on both sides.
    Dac {
        /// Resolution, 2 to 24 bits.
        bits: u32,
    },
    /// Sign-magnitude PWM with the codes `-steps ..= steps`. A direction pin carries the sign.
    Pwm {
        /// Timer ticks per PWM period, 2 to 2^24.
        steps: u32,
    },
}

/// Turns forces into codes. [`Settings::build`](crate::Settings::build) makes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Actuator {
    zero: i32,
    per_full_scale: i32,
    shift: u32,
}

impl Actuator {
    /// Allowed `bits` of a DAC.
    pub const DAC_BITS: RangeInclusive<u32> = 2..=24;
    /// Allowed `steps` of a PWM.
    pub const PWM_STEPS: RangeInclusive<u32> = 2..=1 << 24;

    /// Makes the actuator for this output.
    ///
    /// # Errors
    /// `bits` or `steps` is out of range.
    pub fn new(output: Output) -> Result<Self, SettingsError> {
        let shift = Force::FRACTION_BITS;
        Ok(match output {
            Output::Continuous => Self { zero: 0, per_full_scale: 1, shift: 0 },
            Output::Dac { bits } => {
                within("bits", f64::from(bits), widen(&Self::DAC_BITS))?;
                let zero = 1 << (bits - 1);
                Self { zero, per_full_scale: zero - 1, shift }
            }
            Output::Pwm { steps } => {
                within("steps", f64::from(steps), widen(&Self::PWM_STEPS))?;
                Self { zero: 0, per_full_scale: steps.cast_signed(), shift }
            }
        })
    }

    /// Returns the code nearest to the force. A force midway between two codes gets the code farther from zero force,
    /// on both sides.
    #[inline]
    pub fn command(&self, force: Force) -> OutputCode {
        let bits = i64::from(force.bits());
        let scaled = bits.abs() * i64::from(self.per_full_scale);
        let half = (1i64 << self.shift) >> 1;
        #[expect(clippy::cast_possible_truncation, reason = "at most per_full_scale, an i32")]
        let codes = ((scaled + half) >> self.shift) as i32;
        OutputCode(self.zero + if bits < 0 { -codes } else { codes })
    }

    /// The code of zero force.
    pub fn zero(&self) -> OutputCode {
        OutputCode(self.zero)
    }

    /// Number of codes from zero force to full scale.
    pub fn codes_per_full_scale(&self) -> u32 {
        self.per_full_scale.unsigned_abs() << (Force::FRACTION_BITS - self.shift)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(output: Output, force: Force) -> i32 {
        Actuator::new(output).unwrap().command(force).code()
    }

    #[test]
    fn a_12_bit_dac_is_symmetric_about_its_zero_code() {
        let dac = Output::Dac { bits: 12 };
        assert_eq!(code(dac, Force::ZERO), 2048);
        assert_eq!(code(dac, Force::FULL_SCALE), 4095);
        assert_eq!(code(dac, Force::saturating_from_bits(-(1 << 30))), 1);
        assert_eq!(code(dac, Force::saturating_from_bits(i32::MIN)), 1);
        assert_eq!(Actuator::new(dac).unwrap().codes_per_full_scale(), 2047);
    }

    #[test]
    fn pwm_is_sign_magnitude_and_rounds_to_nearest() {
        let pwm = Output::Pwm { steps: 4500 };
        assert_eq!(code(pwm, Force::FULL_SCALE), 4500);
        assert_eq!(code(pwm, Force::saturating_from_bits(i32::MIN)), -4500);
        let one = (1 << 30) / 4500;
        assert_eq!(code(pwm, Force::saturating_from_bits(one / 2 - 1)), 0);
        assert_eq!(code(pwm, Force::saturating_from_bits(one / 2 + 1)), 1);
        let coarse = Output::Pwm { steps: 3 };
        let half = 1 << 29; // 1.5 codes
        assert_eq!(code(coarse, Force::saturating_from_bits(half)), 2);
        assert_eq!(code(coarse, Force::saturating_from_bits(-half)), -2);
    }

    #[test]
    fn a_continuous_output_passes_the_saturated_force_on() {
        assert_eq!(code(Output::Continuous, Force::saturating_from_bits(12_345)), 12_345);
        assert_eq!(code(Output::Continuous, Force::saturating_from_bits(i32::MAX)), 1 << 30);
        assert_eq!(Actuator::new(Output::Continuous).unwrap().codes_per_full_scale(), 1 << 30);
    }

    #[test]
    fn zero_is_the_code_of_no_force() {
        for output in [Output::Dac { bits: 12 }, Output::Pwm { steps: 4500 }, Output::Continuous] {
            let zero = Actuator::new(output).unwrap().zero();
            assert_eq!(zero.code(), code(output, Force::ZERO));
        }
        assert_eq!(Actuator::new(Output::Dac { bits: 12 }).unwrap().zero().code(), 2048);
    }

    #[test]
    fn impossible_resolutions_are_refused() {
        assert_eq!(Actuator::new(Output::Dac { bits: 1 }).unwrap_err().parameter, "bits");
        assert_eq!(Actuator::new(Output::Pwm { steps: 0 }).unwrap_err().parameter, "steps");
    }
}
