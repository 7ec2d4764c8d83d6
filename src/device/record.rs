//! The device record. With it, an image becomes the firmware of one device. `cargo sim prepare` writes the record, and
//! the board stores it in a separate flash sector.
//!
//! The record consists of 32-bit words, least significant byte first. A number is an IEEE 754 double, low word first.
//!
//! | words | field |
//! |---|---|
//! | 0 | "ZWD" and the version of the layout, 4 |
//! | 1 | length of the record in words, with the last one |
//! | 2 | hash of the scene |
//! | 3 to 6 | board: up to 16 bytes of text, then zeros |
//! | 7 to 10 | device, which is the scene: the same format |
//! | 11 | flags: 1 push only, 2 motor reversed, 4 encoder reversed, 8 criterion `quiet`; bits 8 to 15: number of designs |
//! | 12 | samples per output |
//! | 13, 14 | output: 0 continuous; 1 DAC, number of bits; 2 PWM, number of steps |
//! | 15 | counts that the sign test must see |
//! | 16 | number of the estimator |
//! | 17 to 110 | numbers, see below |
//! | 111 .. | the [designs](super::designs), then the [envelope](crate::safety::envelope) |
//! | last | the record's hash: CRC-32/ISO-HDLC over all words before it |
//!
//! The numbers, in this order:
//! * sample rate Hz, resolution m, force at full command N, latency samples;
//! * speed limit and believable speed m/s, travel low and high m, ramp s;
//! * sign test's force as a part of full scale, heaviest handle kg and N s/m;
//! * the passivity controller's acceleration m/s^2 or 0;
//! * continuous force N, time constant s;
//! * current's voltage at rest and at full command, as parts of the analogue supply;
//! * radius of the handle m;
//! * return move: start m, speed m/s, force N, K N/m, B N s/m, integral N/(m s), tolerance m, timeout s;
//! * calibration: rise %/s, hold s, travel m;
//! * eight parameters of the estimator;
//! * wall m;
//! * hit: settle s, window s, RMS m;
//! * walk: K start, step, cap N/m, B start, step, cap N s/m.

use super::{
    Device,
    designs::{Designs, NamedFilter, halves},
};
use crate::{
    Design, HitSettings, Output, Settings, SettingsError, WallSettings, crc,
    experiment::{CalibrationSettings, Criterion, DutySettings, ReturnSettings, WalkSettings},
    range::within,
    safety::{
        CurrentSettings, SafetySettings,
        envelope::{Boundary, Envelope},
    },
    store::{DeviceKey, Loaded, Name, Signs, Source},
    velocity::{EstimatorName, PARAMETERS, Sense},
};

/// Length of the longest record, in words. It fills a flash sector of 16 KiB.
pub const WORDS_MAX: usize = 4096;
/// Version of the layout.
pub const LAYOUT: u8 = 4;
/// Offset of the board's name, in bytes.
pub const BOARD_AT: usize = 12;

const MAGIC: u32 = u32::from_le_bytes(*b"ZWD\0");
const HEAD: u32 = MAGIC | (LAYOUT as u32) << 24;
const BLANK: u32 = u32::MAX;
/// Number of words before the numbers. `BEFORE_TABLES` is the number of words before designs and envelope.
const FIXED: usize = 17;
const BEFORE_TABLES: usize = FIXED + 2 * NUMBERS;

const PUSH_ONLY: u32 = 1;
const MOTOR_REVERSED: u32 = 2;
const ENCODER_REVERSED: u32 = 4;
const QUIET: u32 = 8;
/// Lowest bit of the number of designs in the word of flags.
const DESIGNS: u32 = 8;

const NUMBERS: usize = 39 + KEPT;
/// How many of the record's numbers are parameters of the estimator.
const KEPT: usize = 8;
// If `PARAMETERS` changes, the layout needs a new version.
const _: () = assert!(PARAMETERS == KEPT);

/// Properties of a board that do not depend on the device. A record must match them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardFacts {
    /// Name of the board.
    pub name: &'static str,
    /// Samples per second, in Hz.
    pub rate_hz: f64,
    /// Kind of the board's force output.
    pub output: Output,
    /// Senses that an estimator can use beside the count.
    pub senses: &'static [Sense],
    /// Time from the reading of the counter to the force, in samples. The latency of a record must not be shorter.
    pub latency_samples: f64,
}

/// Hash of a scene's text. A record has the hash of its scene.
pub fn hash_of(text: &[u8]) -> u32 {
    crc::of_bytes(text)
}

/// Why a board refuses a record, for the console.
#[derive(Clone, Debug, PartialEq)]
pub enum BadRecord {
    /// The sector is erased.
    Blank,
    /// The words do not begin like a record.
    Foreign,
    /// The record has this other version of the layout.
    Layout(u8),
    /// The record is cut short, or longer than the sector. The value is the length that the record states, in words.
    Length(u32),
    /// The record's checksum is wrong.
    Damaged,
    /// The record is for this other board.
    Board(Name),
    /// A name in the record is not valid text.
    Name,
    /// The record has flags that this layout does not know, or a value for a parameter that the estimator does not
    /// have.
    Unknown,
    /// The record states another kind of output than the board has.
    Output,
    /// This build has no estimator of that number.
    Estimator(u32),
    /// The words of the designs are not valid.
    Designs,
    /// The words of the envelope are not valid.
    Envelope,
    /// The board cannot run the record's estimator with its output period.
    Unfit,
    /// A number is out of range.
    Range(SettingsError),
}

impl From<SettingsError> for BadRecord {
    fn from(error: SettingsError) -> Self {
        Self::Range(error)
    }
}

/// Length of the shortest record, in words.
pub const WORDS_MIN: usize = BEFORE_TABLES + 1;

/// Checks a record. Returns its fixed words, the words of its tables, and its hash.
fn whole(words: &[u32]) -> Result<(&[u32; FIXED], &[u32], u32), BadRecord> {
    let Some(([head, length, ..], _)) = words.split_first_chunk::<FIXED>() else {
        return Err(BadRecord::Foreign);
    };
    match *head {
        BLANK => return Err(BadRecord::Blank),
        HEAD => {}
        other if other & 0x00FF_FFFF == MAGIC => {
            return Err(BadRecord::Layout((other >> 24) as u8));
        }
        _ => return Err(BadRecord::Foreign),
    }
    let bad_length = BadRecord::Length(*length);
    let Some((check, body)) = stated(words).and_then(<[u32]>::split_last) else {
        return Err(bad_length);
    };
    let Some((fixed, rest)) = body.split_first_chunk::<FIXED>() else { return Err(bad_length) };
    if rest.len() < 2 * NUMBERS || body.len() >= WORDS_MAX {
        return Err(bad_length);
    }
    if crc::of_words(body) != *check {
        return Err(BadRecord::Damaged);
    }
    Ok((fixed, rest, *check))
}

/// Returns the record at the front of these words, without the words behind it. If the length that it states is not
/// possible, returns all words. The last word of a record is the checksum of all words before it.
pub fn record_in(words: &[u32]) -> &[u32] {
    stated(words).unwrap_or(words)
}

/// Cuts `words` to the length of the record, which is the second word.
fn stated(words: &[u32]) -> Option<&[u32]> {
    words.get(..usize::try_from(*words.get(1)?).ok()?)
}

fn output_of(kind: u32, size: u32) -> Option<Output> {
    match kind {
        0 => Some(Output::Continuous),
        1 => Some(Output::Dac { bits: size }),
        2 => Some(Output::Pwm { steps: size }),
        _ => None,
    }
}

fn words_of(output: Output) -> [u32; 2] {
    match output {
        Output::Continuous => [0, 0],
        Output::Dac { bits } => [1, bits],
        Output::Pwm { steps } => [2, steps],
    }
}

impl<'a> Device<'a> {
    /// Reads the device from the record at the front of `words`, for this board, and checks all its numbers.
    ///
    /// # Errors
    /// Says what is wrong with the record.
    pub fn from_record(words: &'a [u32], board: &BoardFacts) -> Result<Self, BadRecord> {
        let device = Self::decode(words, board)?;
        if device.board.text() != board.name {
            return Err(BadRecord::Board(device.board));
        }
        if device.design.output != board.output {
            return Err(BadRecord::Output);
        }
        within("rate_hz", device.design.rate_hz, board.rate_hz..=board.rate_hz)?;
        // The envelope of a board with less latency may contain walls that are not stable on this board.
        let latency = board.latency_samples..=Self::LATENCY_MAX_SAMPLES;
        within("latency_samples", device.latency_samples, latency)?;
        device.check()?;
        Ok(device)
    }

    /// Makes all checks that are possible before anything runs.
    fn check(&self) -> Result<(), BadRecord> {
        let defaults = self.defaults();
        if self.unfit(&defaults).is_some() {
            return Err(BadRecord::Unfit);
        }
        self.calibration(&defaults, 0.0)?;
        self.walk.check()?;
        self.check_size()?;
        for (_, design) in self.designs.iter() {
            let mut stored = defaults;
            stored.settings.velocity = design.velocity;
            self.control(&stored)?;
        }
        self.back.build(&self.design)?;
        let loaded = Loaded { stored: defaults, source: Source::Empty, damaged: 0 };
        self.start(&loaded, None)?;
        Ok(())
    }

    /// Checks that a person could hold this device.
    fn check_size(&self) -> Result<(), BadRecord> {
        let Self { safety, radius_m, .. } = self;
        within(
            "speed_believable_m_per_s",
            safety.speed_believable_m_per_s,
            0.0..=Self::SPEED_MAX_M_PER_S,
        )?;
        within("travel_low_m", safety.travel_low_m, -Self::TRAVEL_MAX_M..=0.0)?;
        within("travel_high_m", safety.travel_high_m, 0.0..=Self::TRAVEL_MAX_M)?;
        within("heaviest_mass_kg", safety.heaviest_mass_kg, Self::HEAVIEST_MASS_KG)?;
        if *radius_m != 0.0 {
            within("radius_m", *radius_m, Self::RADIUS_M)?;
        }
        Ok(())
    }

    fn decode(words: &'a [u32], board: &BoardFacts) -> Result<Self, BadRecord> {
        let (fixed, rest, hash) = whole(words)?;
        let [_, _, scene_hash, b0, b1, b2, b3, d0, d1, d2, d3, flags, period, kind, size, sign, id] =
            *fixed;
        let [on, name] = [[b0, b1, b2, b3], [d0, d1, d2, d3]].map(Name::from_words);
        if on.text().is_empty() || name.text().is_empty() {
            return Err(BadRecord::Name);
        }
        let output = output_of(kind, size).ok_or(BadRecord::Output)?;
        let estimator = EstimatorName::from_id(id).ok_or(BadRecord::Estimator(id))?;
        const KNOWN: u32 = PUSH_ONLY | MOTOR_REVERSED | ENCODER_REVERSED | QUIET | 0xFF << DESIGNS;
        if flags & !KNOWN != 0 {
            return Err(BadRecord::Unknown);
        }
        let (stated, tables) = rest.split_at_checked(2 * NUMBERS).unwrap_or_default();
        let count = (flags >> DESIGNS & 0xFF) as usize;
        let (designs, envelope) = Designs::split(count, tables).ok_or(BadRecord::Designs)?;
        let mut numbers = stated.as_chunks::<2>().0.iter();
        // Returns the next number, in the order of the function `numbers`.
        let mut next = || match numbers.next() {
            Some(&[low, high]) => f64::from_bits(u64::from(low) | u64::from(high) << 32),
            None => f64::NAN,
        };
        let device = Self {
            board: on,
            key: DeviceKey { name, hash },
            scene_hash,
            design: Design {
                rate_hz: next(),
                resolution_m: next(),
                full_scale_n: next(),
                period,
                output,
            },
            latency_samples: next(),
            senses: board.senses,
            envelope: Envelope::read(envelope).ok_or(BadRecord::Envelope)?,
            designs,
            safety: SafetySettings {
                speed_max_m_per_s: next(),
                speed_believable_m_per_s: next(),
                travel_low_m: next(),
                travel_high_m: next(),
                ramp_in_s: next(),
                sign_test_force: next(),
                sign_test_counts: sign,
                heaviest_mass_kg: next(),
                heaviest_damping_n_s_per_m: next(),
                passive_acceleration_m_per_s2: next(),
            },
            duty: DutySettings { continuous_force_n: next(), time_constant_s: next() },
            current: CurrentSettings { rest: next(), full: next() },
            radius_m: next(),
            back: ReturnSettings {
                start_m: next(),
                speed_m_per_s: next(),
                force_n: next(),
                stiffness_n_per_m: next(),
                damping_n_s_per_m: next(),
                integral_n_per_m_s: next(),
                tolerance_m: next(),
                timeout_s: next(),
            },
            calibration: CalibrationSettings {
                percent: 0.0,
                rise_percent_per_s: next(),
                hold_s: next(),
                travel_m: next(),
            },
            signs: Signs {
                motor_reversed: flags & MOTOR_REVERSED != 0,
                encoder_reversed: flags & ENCODER_REVERSED != 0,
            },
            settings: Settings {
                velocity: estimator.settings(core::array::from_fn(|_| next())),
                wall: WallSettings {
                    position_m: next(),
                    stiffness_n_per_m: 0.0,
                    damping_n_s_per_m: 0.0,
                    push_only: flags & PUSH_ONLY != 0,
                },
            },
            hit: HitSettings {
                push_n: 0.0,
                settle_s: next(),
                window_s: next(),
                rms_limit_m: next(),
            },
            criterion: if flags & QUIET == 0 { Criterion::Rms } else { Criterion::Quiet },
            walk: WalkSettings {
                stiffness_start_n_per_m: next(),
                stiffness_step_n_per_m: next(),
                stiffness_max_n_per_m: next(),
                damping_start_n_s_per_m: next(),
                damping_step_n_s_per_m: next(),
                damping_max_n_s_per_m: next(),
            },
        };
        // If the estimator has no parameter here, the number must be 0.
        let same = device.numbers().into_iter().flat_map(halves).eq(stated.iter().copied());
        if same { Ok(device) } else { Err(BadRecord::Unknown) }
    }

    fn numbers(&self) -> [f64; NUMBERS] {
        let Self { design, safety, duty, current, back, calibration, settings, hit, walk, .. } =
            self;
        let (_, [p0, p1, p2, p3, p4, p5, p6, p7]) = EstimatorName::of(&settings.velocity);
        [
            design.rate_hz,
            design.resolution_m,
            design.full_scale_n,
            self.latency_samples,
            safety.speed_max_m_per_s,
            safety.speed_believable_m_per_s,
            safety.travel_low_m,
            safety.travel_high_m,
            safety.ramp_in_s,
            safety.sign_test_force,
            safety.heaviest_mass_kg,
            safety.heaviest_damping_n_s_per_m,
            safety.passive_acceleration_m_per_s2,
            duty.continuous_force_n,
            duty.time_constant_s,
            current.rest,
            current.full,
            self.radius_m,
            back.start_m,
            back.speed_m_per_s,
            back.force_n,
            back.stiffness_n_per_m,
            back.damping_n_s_per_m,
            back.integral_n_per_m_s,
            back.tolerance_m,
            back.timeout_s,
            calibration.rise_percent_per_s,
            calibration.hold_s,
            calibration.travel_m,
            p0,
            p1,
            p2,
            p3,
            p4,
            p5,
            p6,
            p7,
            settings.wall.position_m,
            hit.settle_s,
            hit.window_s,
            hit.rms_limit_m,
            walk.stiffness_start_n_per_m,
            walk.stiffness_step_n_per_m,
            walk.stiffness_max_n_per_m,
            walk.damping_start_n_s_per_m,
            walk.damping_step_n_s_per_m,
            walk.damping_max_n_s_per_m,
        ]
    }

    /// Writes the record of this device to the front of `words`, with these designs and boundaries instead of its own.
    /// K, B and push are left out, because a record has no wall and no push. The hash is left out too.
    ///
    /// Returns `None` if there is no room.
    pub fn to_record<'b>(
        &self,
        designs: &[NamedFilter],
        boundaries: &[Boundary<'_>],
        words: &'b mut [u32; WORDS_MAX],
    ) -> Option<&'b [u32]> {
        let flag = |set: bool, bit: u32| if set { bit } else { 0 };
        let flags = flag(self.settings.wall.push_only, PUSH_ONLY)
            | flag(self.signs.motor_reversed, MOTOR_REVERSED)
            | flag(self.signs.encoder_reversed, ENCODER_REVERSED)
            | flag(self.criterion == Criterion::Quiet, QUIET)
            | u32::from(u8::try_from(designs.len()).ok()?) << DESIGNS;
        let [kind, size] = words_of(self.design.output);
        let id = self.settings.velocity.name().id();
        let (front, rest) = words.split_at_mut(BEFORE_TABLES);
        let named = Designs::put(designs, rest)?;
        let table = Envelope::put(boundaries, rest.get_mut(named..)?)?.len();
        let length = BEFORE_TABLES + named + table;
        let total = u32::try_from(length + 1).ok()?;
        let fixed = [HEAD, total, self.scene_hash]
            .into_iter()
            .chain(self.board.to_words())
            .chain(self.key.name.to_words())
            .chain([flags, self.design.period, kind, size, self.safety.sign_test_counts, id]);
        let numbers = self.numbers().into_iter().flat_map(halves);
        for (place, word) in front.iter_mut().zip(fixed.chain(numbers)) {
            *place = word;
        }
        let check = crc::of_words(words.get(..length)?);
        *words.get_mut(length)? = check;
        words.get(..=length)
    }
}

#[cfg(test)]
mod tests;
