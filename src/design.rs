//! The fixed data of a device, and the conversion of SI units to counts, samples and fractions of full scale.

use crate::{
    actuator::{Actuator, Output},
    range::{SettingsError, limits, widen, within},
    units::{Force, Position},
};

/// Fixed data of a device. They do not change while the loop runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Design {
    /// Encoder samples per second, in Hz.
    pub rate_hz: f64,
    /// Encoder resolution, in m per count.
    pub resolution_m: f64,
    /// Force at full command, in N.
    pub full_scale_n: f64,
    /// Samples per output. For example, it is 10 if samples come at 10 kHz and outputs at 1 kHz.
    pub period: u32,
    /// The kind of the force output, and its resolution.
    pub output: Output,
}

impl Design {
    /// Checks every field.
    ///
    /// # Errors
    /// Names the parameter that is out of range, and its range.
    pub fn check(&self) -> Result<(), SettingsError> {
        within("rate_hz", self.rate_hz, limits::RATE_HZ)?;
        within("resolution_m", self.resolution_m, limits::RESOLUTION_M)?;
        within("full_scale_n", self.full_scale_n, limits::FULL_SCALE_N)?;
        within("period", f64::from(self.period), widen(&limits::PERIOD))?;
        Actuator::new(self.output)?;
        Ok(())
    }

    pub(crate) fn period_s(&self) -> f64 {
        f64::from(self.period) / self.rate_hz
    }

    /// Number of samples in a millisecond, rounded up. It is 1 to 50.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 50")]
    pub(crate) fn samples_per_ms(&self) -> u32 {
        libm::ceil(self.rate_hz / 1000.0) as u32
    }

    /// Outputs per millisecond, at least 1. Work that must not run more often than at 1 kHz runs once in this number of
    /// outputs.
    pub(crate) fn outputs_per_ms(&self) -> u32 {
        (self.samples_per_ms() / self.period.max(1)).max(1)
    }

    /// Converts `metres` to counts, rounds to the nearest count, and checks the range of [`Position`].
    ///
    /// # Errors
    /// The position is beyond 2^30 counts.
    pub(crate) fn position(
        &self,
        parameter: &'static str,
        metres: f64,
    ) -> Result<Position, SettingsError> {
        let reach = f64::from(Position::LIMIT) * self.resolution_m;
        within(parameter, metres, -reach..=reach)?;
        #[expect(clippy::cast_possible_truncation, reason = "at most 2^30 by the check above")]
        Ok(Position::from_counts(libm::round(metres / self.resolution_m) as i32))
    }

    /// Converts `newtons` to a fraction of full scale. The fraction must lie within +-1.
    pub(crate) fn force(
        &self,
        parameter: &'static str,
        newtons: f64,
    ) -> Result<Force, SettingsError> {
        within(parameter, newtons, -self.full_scale_n..=self.full_scale_n)?;
        let full = f64::from(Force::FULL_SCALE.bits());
        #[expect(clippy::cast_possible_truncation, reason = "at most 2^30 by the check above")]
        Ok(Force::saturating_from_bits(libm::round(newtons / self.full_scale_n * full) as i32))
    }

    /// Converts `seconds` to samples, and rounds to the nearest sample.
    pub(crate) fn samples(
        &self,
        parameter: &'static str,
        seconds: f64,
    ) -> Result<u32, SettingsError> {
        let allowed = widen(&limits::PHASE_SAMPLES);
        let range = allowed.start() / self.rate_hz..=allowed.end() / self.rate_hz;
        within(parameter, seconds, range)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 2^24 by the check above"
        )]
        Ok(libm::round(seconds * self.rate_hz) as u32)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub const DESIGN: Design = Design {
        rate_hz: 1e4,
        resolution_m: 1e-6,
        full_scale_n: 5.906,
        period: 10,
        output: Output::Continuous,
    };
}
