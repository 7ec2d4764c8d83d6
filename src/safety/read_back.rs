//! Reads back the voltage of the force output and the current of the motor.
//!
//! Both are read once per output, at the beginning of the output. By then the previous output has had a whole period to
//! settle. See docs/safety.md.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use crate::{
    Output,
    actuator::Actuator,
    period::SAMPLES_PER_MS,
    range::{SettingsError, within},
    units::OutputCode,
};

/// The command of a written output, and whether it was mirrored about zero force.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Code of the output's command.
    pub command: OutputCode,
    /// Whether the motor is mounted the other way round.
    pub mirrored: bool,
}

impl Written {
    /// The code that the hardware gets, relative to the code of zero force. The mirroring is included.
    #[inline]
    fn codes(self, zero: i32) -> i32 {
        let codes = self.command.code() - zero;
        if self.mirrored { -codes } else { codes }
    }
}

/// Readings of the A/D converters. Each is below [`Readings::RANGE`]. It is `None` if the converter did not answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Readings {
    /// Voltage of the force output.
    pub output: Option<u16>,
    /// Voltage with which the amplifier reports the motor's current.
    pub current: Option<u16>,
}

impl Readings {
    /// Number of codes of a reading, which has 12 bits. They cover the analogue supply voltage.
    pub const RANGE: i32 = 4096;
}

/// Compares the force output with its code, on boards that can read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputWatch {
    zero: i32,
    /// The lowest and the highest code between which the output surely follows its command.
    swing: [i32; 2],
}

impl OutputWatch {
    /// Largest allowed error of a reading, in codes. It is 2 % of the range. Offset, gain and linearity of DAC and
    /// converter together cause some 1 %.
    pub const ALLOWED: i32 = 82;
    /// Number of wrong readings in a row that are a fault. A single wrong reading may be a disturbance.
    pub const MISSES: u8 = 2;

    /// Makes the check of this output. `swing` has the lowest and the highest code that the output surely reaches.
    ///
    /// # Errors
    /// `bits` or `steps` of the output is out of range.
    pub fn new(output: Output, swing: [i32; 2]) -> Result<Self, SettingsError> {
        Ok(Self { zero: Actuator::new(output)?.zero().code(), swing })
    }

    /// Takes a reading. `written` is the output that was read. If it is `None`, the output is off and nothing is
    /// compared. `misses` counts the wrong readings in a row. Returns whether there is a fault.
    #[inline]
    pub fn follow(&self, misses: &mut u8, written: Option<Written>, read: Option<u16>) -> bool {
        let Some(written) = written else {
            *misses = 0;
            return false;
        };
        let code = self.zero + written.codes(self.zero);
        let [low, high] = self.swing;
        let least = code.min(high) - Self::ALLOWED;
        let most = code.max(low) + Self::ALLOWED;
        if read.is_some_and(|read| (least..=most).contains(&i32::from(read))) {
            *misses = 0;
            return false;
        }
        cold_path();
        *misses = misses.saturating_add(1);
        *misses >= Self::MISSES
    }
}

/// How an amplifier reports its current: as a voltage at an input of the board. The voltages are given as parts of the
/// analogue supply.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CurrentSettings {
    /// Voltage without current.
    pub rest: f64,
    /// Voltage with the current of the highest command. The voltage of the lowest command is its mirror image about
    /// `rest`. If both voltages are 0, the input is not used.
    pub full: f64,
}

impl CurrentSettings {
    /// The settings if the input is not used.
    pub const UNUSED: Self = Self { rest: 0.0, full: 0.0 };
    /// The least allowed distance from `rest` to `full`. A quarter of it is some 30 codes.
    pub const LEAST: f64 = 0.03;

    /// Makes the check, with all values as integers. Returns `None` if the input is not used.
    ///
    /// # Errors
    /// A voltage is outside the supply, or the two voltages are too close.
    #[cfg_attr(not(test), expect(clippy::float_arithmetic, reason = "at set-up"))]
    pub fn build(&self, output: Output) -> Result<Option<CurrentWatch>, SettingsError> {
        let Self { rest, full } = *self;
        if *self == Self::UNUSED {
            return Ok(None);
        }
        within("current_sense_rest", rest, Self::LEAST..=1.0 - Self::LEAST)?;
        let room = rest.min(1.0 - rest);
        let range = if full < rest {
            rest - room..=rest - Self::LEAST
        } else {
            rest + Self::LEAST..=rest + room
        };
        within("current_sense_full", full, range)?;
        let actuator = Actuator::new(output)?;
        let codes = |part: f64| part * f64::from(Readings::RANGE);
        #[expect(clippy::cast_possible_truncation, reason = "at most 2^12 times 2^16")]
        let integer = |number: f64| libm::round(number) as i32;
        let full = codes(full - rest);
        let unit = f64::from(1 << CurrentWatch::SLOPE_BITS);
        Ok(Some(CurrentWatch {
            zero: actuator.zero().code(),
            rest: integer(codes(rest)),
            slope: integer(full * unit / f64::from(actuator.codes_per_full_scale())),
            allowed: integer(libm::fabs(full) * CurrentWatch::ALLOWED),
        }))
    }
}

/// Compares the motor's current with the force output. A difference of more than a quarter of full scale, in the mean
/// over some 13 ms, is a fault.
///
/// With each output of the period T the mean changes by `T (error - mean) / 12.8 ms`. A difference of x times full
/// scale is found after `12.8 ms ln(x / (x - 1/4))`: 3.7 ms for full scale, 8.9 ms for half of it. An amplifier with a
/// time constant of 1 ms causes no fault. After a step from one end of the range to the other end, the mean is at most
/// `2 * 1 / 12.8` = 16 % of full scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CurrentWatch {
    zero: i32,
    rest: i32,
    slope: i32,
    allowed: i32,
}

impl CurrentWatch {
    /// Largest mean of the error that is no fault, as a part of full scale.
    pub const ALLOWED: f64 = 0.25;
    /// Replaces the reading of a converter that does not answer. It is far from every right reading.
    const NO_ANSWER: i32 = -4096;
    /// Binary places of the slope.
    const SLOPE_BITS: u32 = 16;
    /// The time constant of the mean is 2^`MEAN_BITS` samples, 12.8 ms.
    const MEAN_BITS: u32 = 7;

    /// Takes a reading. `mean` is the mean error so far, in 2^-7 codes. `written` is the output that was read, or
    /// `None` if the output is off. `samples` is the number of samples since the last reading. A missing answer counts
    /// as the largest error. Returns whether the current is wrong.
    #[inline]
    pub fn follow(
        &self,
        mean: &mut i32,
        written: Option<Written>,
        (read, samples): (Option<u16>, u32),
    ) -> bool {
        let Some(written) = written else {
            *mean = 0;
            return false;
        };
        let asked = i64::from(self.slope) * i64::from(written.codes(self.zero));
        #[expect(clippy::cast_possible_truncation, reason = "at most the range of the converter")]
        let expected = self.rest + (asked >> Self::SLOPE_BITS) as i32;
        let error = read.map_or(Self::NO_ANSWER, i32::from) - expected;
        let weight = samples.min(SAMPLES_PER_MS).cast_signed();
        *mean += weight * (error - (*mean >> Self::MEAN_BITS));
        (*mean >> Self::MEAN_BITS).abs() > self.allowed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAC: Output = Output::Dac { bits: 12 };
    const SWING: [i32; 2] = [248, 3847];

    fn written(code: i32, mirrored: bool) -> Option<Written> {
        Some(Written { command: OutputCode(code), mirrored })
    }

    /// Whether two readings in a row are wrong.
    fn wrong(code: i32, mirrored: bool, read: i32) -> bool {
        let (watch, mut misses) = (OutputWatch::new(DAC, SWING).unwrap(), 0);
        let read = u16::try_from(read).ok();
        assert!(!watch.follow(&mut misses, written(code, mirrored), read));
        watch.follow(&mut misses, written(code, mirrored), read)
    }

    #[test]
    fn an_output_that_is_off_by_more_than_2_percent_twice_in_a_row_is_wrong() {
        for code in [300, 1000, 2048, 3000, 3800] {
            for (off, expected) in [(0, false), (82, false), (83, true), (1000, true)] {
                assert_eq!(wrong(code, false, code + off), expected, "{code} {off}");
                assert_eq!(wrong(code, false, code - off), expected, "{code} {off}");
            }
            assert!(!wrong(code, true, 4096 - code));
        }
        let (watch, mut misses) = (OutputWatch::new(DAC, SWING).unwrap(), 0);
        for read in [Some(0), Some(2100), None, Some(2000), Some(4095)] {
            assert!(!watch.follow(&mut misses, written(2048, false), read), "one in a row");
            assert!(!watch.follow(&mut misses, written(2048, false), Some(2048)));
        }
        assert!(!watch.follow(&mut misses, written(2048, false), None));
        assert!(
            watch.follow(&mut misses, written(2048, false), None),
            "a converter that does not answer"
        );
        assert!(watch.follow(&mut misses, written(2048, false), Some(0)), "and so on");
        assert!(!watch.follow(&mut misses, None, Some(0)), "off");
        assert!(!watch.follow(&mut misses, written(2048, false), Some(0)), "begins anew");
    }

    #[test]
    fn beyond_its_swing_an_output_may_stay_at_it_or_go_on() {
        for read in [3847 - 82, 3847, 4000, 4095] {
            assert!(!wrong(4095, false, read), "{read}");
        }
        assert!(wrong(4095, false, 3847 - 83));
        for read in [0, 100, 248, 248 + 82] {
            assert!(!wrong(1, false, read), "{read}");
        }
        assert!(wrong(1, false, 248 + 83));
    }

    const SENSE: CurrentSettings = CurrentSettings { rest: 0.5, full: 0.8 };

    /// The reading of an amplifier that gives this part of full scale.
    fn reading(settings: CurrentSettings, part: f64) -> Option<u16> {
        let part = settings.rest + part * (settings.full - settings.rest);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 4095")]
        Some((part * 4096.0) as u16)
    }

    /// Returns the time, in s, until a difference of this part of full scale is found. Outputs come every `samples`
    /// samples. It tries at most a second.
    fn found_s(
        output: Output,
        settings: CurrentSettings,
        told: f64,
        given: f64,
        samples: u32,
    ) -> Option<f64> {
        let (watch, mut mean) = (settings.build(output).unwrap().unwrap(), 0);
        let actuator = Actuator::new(output).unwrap();
        #[expect(clippy::cast_possible_truncation, reason = "a code")]
        let code = actuator.zero().code()
            + (told * f64::from(actuator.codes_per_full_scale())).round() as i32;
        let period_s = f64::from(samples) * 1e-4;
        (1..=10_000 / samples)
            .find(|_| {
                watch.follow(&mut mean, written(code, false), (reading(settings, given), samples))
            })
            .map(|outputs| f64::from(outputs) * period_s)
    }

    #[test]
    fn a_current_that_is_not_asked_for_is_found_within_the_stated_time() {
        let falling = CurrentSettings { rest: 0.5, full: 0.05 };
        for output in [DAC, Output::Pwm { steps: 4200 }] {
            for settings in [SENSE, falling] {
                for samples in [1, 2, 5, 10] {
                    for (told, given) in
                        [(0.0, 1.0), (0.4, -1.0), (1.0, 0.0), (0.5, 0.0), (0.0, -0.3)]
                    {
                        let x = f64::abs(told - given);
                        let expected = 12.8e-3 * (x / (x - 0.25)).ln();
                        let found = found_s(output, settings, told, given, samples).unwrap();
                        assert!(
                            found < 1.15 * expected + 1.5e-3,
                            "{x} {samples} {found} {expected}"
                        );
                        assert!(
                            found > 0.75 * expected - 1.5e-3,
                            "{x} {samples} {found} {expected}"
                        );
                    }
                    assert_eq!(found_s(output, settings, 0.0, 0.24, samples), None);
                    assert_eq!(found_s(output, settings, -1.0, -0.77, samples), None);
                }
            }
        }
    }

    #[test]
    fn an_amplifier_of_160_hz_is_no_fault_whatever_it_is_told() {
        for samples in [1u32, 10] {
            // The command steps from one end of the range to the other and back, with different times between the
            // steps.
            for half in [1, 3, 10, 30, 100] {
                let (watch, mut mean) = (SENSE.build(DAC).unwrap().unwrap(), 0);
                let (mut given, step_s) = (0.0, f64::from(samples) * 1e-4);
                for output in 0..2000 {
                    let told = if output / half % 2 == 0 { 1.0 } else { -1.0 };
                    given += (told - given) * (1.0 - (-step_s / 1e-3_f64).exp());
                    let code = if told > 0.0 { 4095 } else { 1 };
                    assert!(!watch.follow(
                        &mut mean,
                        written(code, false),
                        (reading(SENSE, given), samples)
                    ));
                }
            }
        }
    }

    #[test]
    fn a_mirrored_motor_has_the_current_the_other_way_round() {
        let (watch, mut mean) = (SENSE.build(DAC).unwrap().unwrap(), 0);
        assert!((0..1000).all(|_| !watch.follow(
            &mut mean,
            written(4095, true),
            (reading(SENSE, -1.0), 10)
        )));
        let silent = (0..10).any(|_| watch.follow(&mut mean, written(4095, true), (None, 10)));
        assert!(silent, "a converter that does not answer");
        assert!(!watch.follow(&mut mean, None, (None, 10)));
    }

    #[test]
    fn voltages_that_cannot_be_are_refused() {
        assert_eq!(CurrentSettings::UNUSED.build(DAC), Ok(None));
        for (rest, full, name) in [
            (0.0, 0.3, "current_sense_rest"),
            (0.98, 0.9, "current_sense_rest"),
            (f64::NAN, 0.3, "current_sense_rest"),
            (0.5, 1.01, "current_sense_full"),
            (0.3, 0.61, "current_sense_full"), // full force the other way would be below 0
            (0.8, 0.59, "current_sense_full"),
            (0.5, 0.48, "current_sense_full"),
            (0.5, 0.5, "current_sense_full"),
            (0.5, f64::NAN, "current_sense_full"),
        ] {
            let error = CurrentSettings { rest, full }.build(DAC).unwrap_err();
            assert_eq!(error.parameter, name, "{rest} {full}");
        }
        assert!(CurrentSettings { rest: 0.3, full: 0.6 }.build(DAC).unwrap().is_some());
        let error = CurrentSettings { rest: 0.5, full: 0.5 }.build(DAC).unwrap_err();
        assert!(*error.range.start() > 0.5, "rising is what people wire: {:?}", error.range);
    }

    #[test]
    fn a_converter_that_does_not_answer_is_found_whatever_the_code() {
        for settings in [SENSE, CurrentSettings { rest: 0.5, full: 0.05 }] {
            let watch = settings.build(DAC).unwrap().unwrap();
            for code in [0, 1, 1024, 2048, 4095] {
                let mut mean = 0;
                let mut silent =
                    (0..8).map(|_| watch.follow(&mut mean, written(code, false), (None, 10)));
                assert!(silent.any(|wrong| wrong), "{code}");
            }
        }
    }

    #[test]
    fn a_mean_at_the_limit_is_none_yet() {
        let begun = SENSE.build(DAC).unwrap().unwrap();
        for (over, wrong) in [(0, false), (1, true)] {
            let error = begun.allowed + over;
            let mut mean = error << CurrentWatch::MEAN_BITS;
            let read = u16::try_from(begun.rest + error).ok();
            assert_eq!(
                begun.follow(&mut mean, written(begun.zero, false), (read, 10)),
                wrong,
                "{over}"
            );
        }
    }
}
