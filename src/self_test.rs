//! The parts of a board's self-test, which runs with the force off, and the results that pass.
//!
//! A board measures part by part ([`SelfTest`](crate::contract::SelfTest)). This module judges and prints the numbers.

use core::fmt;

use crate::{image::UNSEALED, period::OUTPUT_WATCHDOG_US};

/// A part of the self-test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Whether the chip is the chip that the image is for.
    Chip,
    /// Whether the brown-out reset is on.
    BrownOutReset,
    /// Vector table and flash.
    Image,
    /// Whether program and emergency stop control the pin of enable.
    Enable,
    /// The time after which enable is switched off without outputs.
    OutputWatchdog,
    /// The force output, compared with its codes.
    Output,
    /// The encoder's counter. The board itself gives it edges.
    Encoder,
    /// How long after its beginning a sample reads the counter.
    Delay,
    /// The clock, compared with the watchdog's oscillator.
    Clock,
}

impl Part {
    /// All parts, in the order of the test.
    pub const ALL: [Self; 9] = [
        Self::Chip,
        Self::BrownOutReset,
        Self::Image,
        Self::Enable,
        Self::OutputWatchdog,
        Self::Output,
        Self::Encoder,
        Self::Delay,
        Self::Clock,
    ];

    /// Whether the part switches enable on, or moves the force output.
    pub const fn drives(self) -> bool {
        matches!(self, Self::Enable | Self::OutputWatchdog | Self::Output)
    }

    /// Name in the reply.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Chip => "chip",
            Self::BrownOutReset => "brown-out reset",
            Self::Image => "image",
            Self::Enable => "enable",
            Self::OutputWatchdog => "output watchdog",
            Self::Output => "output",
            Self::Encoder => "encoder",
            Self::Delay => "delay",
            Self::Clock => "clock",
        }
    }
}

/// How long after their beginning samples read the counter. The unit is a tick of the sample timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delays {
    /// Number of samples that were measured.
    pub samples: u32,
    /// The shortest delay, in ticks.
    pub least: u32,
    /// The longest delay, in ticks.
    pub most: u32,
    /// Histogram of the delays. Bin 0 begins at the shortest delay, and each bin has [`Self::BIN`] ticks. The last bin
    /// also counts all longer delays.
    pub bins: [u32; Self::BINS],
}

impl Delays {
    /// Number of bins of the histogram.
    pub const BINS: usize = 8;
    /// Width of a bin, in ticks.
    pub const BIN: u32 = 4;
    /// Largest allowed difference between the longest and the shortest delay, in ticks. It is half a microsecond.
    /// Instructions that cannot be interrupted, and the entry into the interrupt, cause less.
    const SPREAD: u32 = 45;
    /// Number of samples that are measured.
    pub const SAMPLES: usize = 100;

    /// Computes shortest and longest delay and the histogram from these delays, in ticks.
    pub fn of(times: &[u32]) -> Self {
        let least = times.iter().copied().min().unwrap_or_default();
        let most = times.iter().copied().max().unwrap_or_default();
        let mut bins = [0; Self::BINS];
        for time in times {
            let bin = ((time - least) / Self::BIN) as usize;
            if let Some(count) = bins.get_mut(bin.min(Self::BINS - 1)) {
                *count += 1;
            }
        }
        let samples = u32::try_from(times.len()).unwrap_or(u32::MAX);
        Self { samples, least, most, bins }
    }
}

/// Result of one part of the self-test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// The type of the chip.
    Chip {
        /// `DEV_ID` of the chip found.
        id: u32,
        /// `DEV_ID` that the board's chip should have.
        expected: u32,
    },
    /// The level of the brown-out reset (`BOR_LEV`). With 3 it is off.
    BrownOutReset {
        /// Level that is set in the option bytes.
        level: u32,
        /// Right level for the board's supply.
        expected: u32,
    },
    /// The image in flash.
    Image {
        /// The first vector that does not point into the image, if there is one.
        bad_vector: Option<u32>,
        /// CRC-32 of all sealed words.
        crc: u32,
        /// Expected CRC-32, from the seal.
        sealed: u32,
    },
    /// Levels of the pin of enable.
    Enable {
        /// Whether the emergency stop was closed.
        stop_closed: bool,
        /// Whether the pin was high with the main output off.
        off: bool,
        /// Whether the pin was high with the main output on. It is on for a few cycles, at zero force.
        on: bool,
        /// Whether the pin was high when the main output was off again.
        after: bool,
    },
    /// How soon hardware switches enable off when no outputs come. The test runs at zero force.
    OutputWatchdog {
        /// Whether the emergency stop was closed. If it is open, enable cannot be on.
        stop_closed: bool,
        /// Microseconds until hardware switched enable off, or `None` if it did not.
        micros: Option<u32>,
    },
    /// The force output, read back.
    Output {
        /// The code with the largest error, and the code that was read for it.
        worst: [u32; 2],
        /// Largest error that passes, in codes.
        allowed: u32,
    },
    /// Edges that the board gave to its counter by two wires, forwards and back.
    Encoder {
        /// Number of edges that the board gave forwards, and again back.
        sent: u32,
        /// Counts after the edges forwards.
        there: i32,
        /// Counts after the edges back.
        back: i32,
        /// Edges that the board gave per second.
        rate_hz: u32,
        /// Smallest number of edges per second that passes.
        least_hz: u32,
    },
    /// Times at which samples read the counter.
    Delay(Delays),
    /// Frequency of the watchdog's oscillator, in Hz, measured with the clock of this board. It is 0 if the oscillator
    /// does not run.
    Clock(u32),
}

/// Number of edges that the board gives forwards, and again back.
pub const EDGES: u32 = 2000;

/// Time after which the output watchdog must act, in us.
const WATCHDOG_US: core::ops::RangeInclusive<u32> =
    OUTPUT_WATCHDOG_US - OUTPUT_WATCHDOG_US / 25..=OUTPUT_WATCHDOG_US + OUTPUT_WATCHDOG_US / 25;

/// Frequency of the watchdog's oscillator that the data sheets allow, in Hz.
const OSCILLATOR_HZ: core::ops::RangeInclusive<u32> = 17_000..=47_000;

/// Number of edges per second that the processor can surely make. Wait states of the flash may take half of its time.
const FASTEST_HZ: f64 = 2.5e6;

impl Found {
    /// Sets the smallest rate that passes. It is the rate of edges in the fastest believable motion of the device.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within 0 and the processor's"
    )]
    pub fn of_fastest(mut self, hz: f64) -> Self {
        if let Self::Encoder { least_hz, .. } = &mut self {
            *least_hz = hz.clamp(0.0, FASTEST_HZ) as u32;
        }
        self
    }

    /// Whether the result passes.
    pub fn is_right(&self) -> bool {
        match *self {
            Self::Chip { id, expected } => id == expected,
            Self::BrownOutReset { level, expected } => level == expected,
            Self::Image { bad_vector, crc, sealed } => {
                bad_vector.is_none() && crc == sealed && sealed != UNSEALED
            }
            Self::Enable { stop_closed, off, on, after } => !off && on == stop_closed && !after,
            Self::OutputWatchdog { stop_closed, micros } => {
                stop_closed && micros.is_some_and(|micros| WATCHDOG_US.contains(&micros))
            }
            Self::Output { worst: [told, read], allowed } => told.abs_diff(read) <= allowed,
            Self::Encoder { sent, there, back, rate_hz, least_hz } => {
                there.unsigned_abs() == sent && back == 0 && rate_hz >= least_hz
            }
            Self::Delay(Delays { samples, least, most, .. }) => {
                samples as usize == Delays::SAMPLES && most - least <= Delays::SPREAD
            }
            Self::Clock(hz) => OSCILLATOR_HZ.contains(&hz),
        }
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wrong = !self.is_right();
        f.write_str(if wrong { "fail, " } else { "pass, " })?;
        match *self {
            Self::Chip { id, expected } => {
                write!(f, "id {id:x}")?;
                if wrong { write!(f, ", this image is for {expected:x}") } else { Ok(()) }
            }
            Self::BrownOutReset { level, expected } => {
                write!(f, "level {level}")?;
                if level == 3 {
                    f.write_str(" is off")?;
                }
                if wrong { write!(f, ", this board wants {expected}") } else { Ok(()) }
            }
            Self::Image { bad_vector: Some(number), .. } => {
                write!(f, "vector {number} leads nowhere")
            }
            Self::Image { crc, sealed, .. } => {
                write!(f, "crc {crc:08x}")?;
                if wrong { write!(f, ", the seal is {sealed:08x}") } else { Ok(()) }
            }
            Self::Enable { off: true, .. } => f.write_str("the pin is high with the output off"),
            Self::Enable { after: true, .. } => f.write_str("the pin stays high"),
            Self::Enable { stop_closed: true, on: false, .. } => f.write_str("the pin stays low"),
            Self::Enable { stop_closed: false, on: true, .. } => {
                f.write_str("the open stop does not hold the pin low")
            }
            Self::Enable { stop_closed: true, .. } => f.write_str("stop closed: the pin follows"),
            Self::Enable { .. } => f.write_str("stop open: the pin stays low"),
            Self::OutputWatchdog { stop_closed: false, .. } => {
                f.write_str("the stop is open: close it and try again")
            }
            Self::OutputWatchdog { micros: None, .. } => {
                f.write_str("enable stays on without outputs")
            }
            Self::OutputWatchdog { micros: Some(micros), .. } => {
                write!(f, "enable drops {micros} us after the last output")?;
                let (least, most) = WATCHDOG_US.into_inner();
                if wrong { write!(f, ", allowed {least} to {most}") } else { Ok(()) }
            }
            Self::Output { worst: [told, read], allowed } => {
                write!(f, "code {told} reads as {read}, allowed is {allowed} more or less")
            }
            Self::Encoder { there: 0, back: 0, .. } => {
                f.write_str("nothing is counted: are both wires there?")
            }
            Self::Encoder { sent, there, back, rate_hz, least_hz } => {
                write!(
                    f,
                    "{sent} edges at {rate_hz} per second and back: {there} and {back} counts"
                )?;
                if rate_hz < least_hz {
                    write!(f, ", wanted {least_hz} per second")
                } else {
                    Ok(())
                }
            }
            Self::Delay(Delays { samples: 0, .. }) => f.write_str("no samples"),
            Self::Delay(Delays { samples, least, most, bins }) => {
                write!(
                    f,
                    "{samples} samples, {least} to {most} ticks after the timer, by {}:",
                    Delays::BIN
                )?;
                bins.iter().try_for_each(|count| write!(f, " {count}"))
            }
            Self::Clock(0) => f.write_str("the watchdog's oscillator does not run"),
            Self::Clock(hz) => {
                let (least, most) = OSCILLATOR_HZ.into_inner();
                write!(f, "the watchdog's oscillator has {hz} Hz, allowed {least} to {most}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[track_caller]
    fn says(found: Found, text: &str) {
        assert_eq!(found.to_string(), text);
        assert_eq!(found.is_right(), text.starts_with("pass, "));
    }

    #[test]
    fn each_part_passes_and_fails_with_what_was_found() {
        says(Found::Chip { id: 0x421, expected: 0x421 }, "pass, id 421");
        says(Found::Chip { id: 0x413, expected: 0x421 }, "fail, id 413, this image is for 421");
        says(Found::BrownOutReset { level: 0, expected: 0 }, "pass, level 0");
        says(
            Found::BrownOutReset { level: 3, expected: 1 },
            "fail, level 3 is off, this board wants 1",
        );
        says(Found::BrownOutReset { level: 2, expected: 1 }, "fail, level 2, this board wants 1");
        let image = |bad_vector, crc, sealed| Found::Image { bad_vector, crc, sealed };
        says(image(None, 0xAB, 0xAB), "pass, crc 000000ab");
        says(image(None, 0xAB, 0xBA), "fail, crc 000000ab, the seal is 000000ba");
        says(image(None, UNSEALED, UNSEALED), "fail, crc ffffffff, the seal is ffffffff");
        says(image(Some(7), 0xAB, 0xAB), "fail, vector 7 leads nowhere");
        let output = |read| Found::Output { worst: [1000, read], allowed: 40 };
        says(output(960), "pass, code 1000 reads as 960, allowed is 40 more or less");
        says(output(1040), "pass, code 1000 reads as 1040, allowed is 40 more or less");
        says(output(1041), "fail, code 1000 reads as 1041, allowed is 40 more or less");
        says(output(959), "fail, code 1000 reads as 959, allowed is 40 more or less");
        says(
            Found::Clock(32_000),
            "pass, the watchdog's oscillator has 32000 Hz, allowed 17000 to 47000",
        );
        says(
            Found::Clock(16_999),
            "fail, the watchdog's oscillator has 16999 Hz, allowed 17000 to 47000",
        );
        says(
            Found::Clock(47_001),
            "fail, the watchdog's oscillator has 47001 Hz, allowed 17000 to 47000",
        );
        says(Found::Clock(0), "fail, the watchdog's oscillator does not run");
    }

    #[test]
    fn enable_follows_a_closed_stop_and_no_open_one() {
        let enable = |stop_closed, off, on, after| Found::Enable { stop_closed, off, on, after };
        says(enable(true, false, true, false), "pass, stop closed: the pin follows");
        says(enable(false, false, false, false), "pass, stop open: the pin stays low");
        says(enable(true, false, false, false), "fail, the pin stays low");
        says(enable(false, false, true, false), "fail, the open stop does not hold the pin low");
        for closed in [false, true] {
            says(enable(closed, true, closed, false), "fail, the pin is high with the output off");
            says(enable(closed, false, closed, true), "fail, the pin stays high");
        }
    }

    #[test]
    fn enable_drops_in_time_without_outputs() {
        let found = |micros| Found::OutputWatchdog { stop_closed: true, micros };
        says(found(Some(2400)), "pass, enable drops 2400 us after the last output");
        says(found(Some(2600)), "pass, enable drops 2600 us after the last output");
        let late = "fail, enable drops 2601 us after the last output, allowed 2400 to 2600";
        says(found(Some(2601)), late);
        assert!(!found(Some(2399)).is_right());
        says(found(None), "fail, enable stays on without outputs");
        let open = Found::OutputWatchdog { stop_closed: false, micros: Some(0) };
        says(open, "fail, the stop is open: close it and try again");
    }

    #[test]
    fn an_encoder_counts_every_edge_in_either_direction_and_comes_back() {
        let encoder = |there, back| {
            let (sent, rate_hz, least_hz) = (2000, 5_000_000, 0);
            Found::Encoder { sent, there, back, rate_hz, least_hz }
        };
        says(
            encoder(2000, 0),
            "pass, 2000 edges at 5000000 per second and back: 2000 and 0 counts",
        );
        assert!(encoder(-2000, 0).is_right(), "a mounting that counts the other way round");
        for (there, back) in [(1999, 0), (2000, 1), (-2001, 0), (2000, -4000), (1, 0)] {
            assert!(!encoder(there, back).is_right(), "{there} {back}");
        }
        says(encoder(0, 0), "fail, nothing is counted: are both wires there?");
        // The edges must be as fast as the device can move, or at least as fast as the processor can make them.
        assert!(encoder(2000, 0).of_fastest(4_999_999.0).is_right());
        assert!(encoder(2000, 0).of_fastest(1e9).is_right());
        let slow =
            Found::Encoder { sent: 2000, there: 2000, back: 0, rate_hz: 10_000, least_hz: 0 };
        says(
            slow.of_fastest(10_001.0),
            "fail, 2000 edges at 10000 per second and back: 2000 and 0 counts, wanted 10001 per second",
        );
    }

    #[test]
    fn delays_have_their_ends_and_a_histogram() {
        let mut times = [20; Delays::SAMPLES];
        times[0] = 23;
        times[1] = 24;
        times[2] = 65;
        let delays = Delays::of(&times);
        assert_eq!((delays.samples, delays.least, delays.most), (100, 20, 65));
        assert_eq!(delays.bins, [98, 1, 0, 0, 0, 0, 0, 1]);
        says(
            Found::Delay(delays),
            "pass, 100 samples, 20 to 65 ticks after the timer, by 4: 98 1 0 0 0 0 0 1",
        );
        times[2] = 66;
        assert!(!Found::Delay(Delays::of(&times)).is_right());
        assert!(!Found::Delay(Delays::of(&times[3..])).is_right(), "samples are missing");
        says(Found::Delay(Delays::of(&[])), "fail, no samples");
    }

    #[test]
    fn every_part_has_a_name_of_its_own() {
        for (n, part) in Part::ALL.iter().enumerate() {
            assert!(Part::ALL[..n].iter().all(|other| other.text() != part.text()), "{part:?}");
        }
    }
}
