//! One settings record as flash words.
//!
//! A record has 44 words of 32 bits, least significant byte first. A double (IEEE 754) has two words, low word first.
//! Values are in SI units.
//!
//! | words | field |
//! |---|---|
//! | 0 | "ZWS" and the version, 5 |
//! | 1 | sequence number, rises with every save that writes |
//! | 2 to 5 | device name, up to 16 bytes, then zeros |
//! | 6 | hash of the device record |
//! | 7 | flags: 1 push only, 2 motor reversed, 4 encoder reversed, 8 `quiet`, 16 `force_rms` set; from bit 8 the estimator's number |
//! | 8 to 11 | first two parameters of the estimator, or 0 |
//! | 12 to 21 | K, B, wall, push, start |
//! | 22, 23 | force at full command |
//! | 24 to 29 | walk: first K, step, cap |
//! | 30 to 35 | walk: first B, step, cap |
//! | 36 to 41 | settle, window, limit of the RMS |
//! | 42 | output period, samples |
//! | 43 | CRC-32/ISO-HDLC over words 0 to 42 |
//!
//! With more than two parameters, or with `force_rms`, a second record precedes this record. It has "ZWP" and version
//! 3, sequence, six parameters from the third on, `force_rms`, zeros, CRC.

use crate::{
    Settings, WallSettings, crc,
    experiment::{Criterion, WalkSettings},
    velocity::{EstimatorName, PARAMETERS},
};

/// The settings that a person saves, and the device for which they were made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stored {
    /// The device that the settings are for.
    pub device: DeviceKey,
    /// Estimator and wall in SI units.
    pub settings: Settings,
    /// Samples from output to output.
    pub period: u32,
    /// Push of the experiments, in N.
    pub push_n: f64,
    /// Directions of motor and encoder.
    pub signs: Signs,
    /// Start of hits, in m.
    pub start_m: f64,
    /// Time before a hit is judged, in s.
    pub settle_s: f64,
    /// Time over which a hit is judged, in s.
    pub window_s: f64,
    /// Limit of a stable hit's RMS, in m.
    pub rms_limit_m: f64,
    /// Criterion of a stable hit.
    pub criterion: Criterion,
    /// Limit of the force's RMS for the criterion `quiet`, in N. With `None` the limit is [a
    /// share](crate::experiment::quiet::FORCE_SHARE) of the push.
    pub force_rms_limit_n: Option<f64>,
    /// Force at full command, in N, from the calibration.
    pub full_scale_n: f64,
    /// Grid of the walk, with the largest K and B.
    pub grid: WalkSettings,
}

/// The device record to which settings belong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceKey {
    /// Name of the device, which is the name of its scene.
    pub name: Name,
    /// Hash of the record. It is 0 for settings that were saved in a layout without a hash.
    pub hash: u32,
}

impl DeviceKey {
    /// Makes the key of a device without a record.
    ///
    /// # Panics
    /// The name is longer than [`Name::LEN`]. A constant of such a name does not compile.
    pub const fn of(name: &str) -> Self {
        Self { name: Name::of(name), hash: 0 }
    }
}

/// A name of up to 16 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Name([u8; Self::LEN]);

impl Name {
    /// Length of the longest name, in bytes.
    pub const LEN: usize = 16;
    pub(crate) const WORDS: usize = Self::LEN / 4;

    /// Makes a name, if `name` is not too long and has no zero byte.
    pub fn new(name: &str) -> Option<Self> {
        if name.bytes().any(|byte| byte == 0) {
            return None;
        }
        let mut bytes = [0; Self::LEN];
        bytes.get_mut(..name.len())?.copy_from_slice(name.as_bytes());
        Some(Self(bytes))
    }

    /// Makes a name from a constant. A constant that is too long does not compile. It is not cut off, because two names
    /// could then become equal.
    ///
    /// # Panics
    /// The name is longer than [`LEN`](Self::LEN).
    pub const fn of(name: &str) -> Self {
        let mut bytes = [0; Self::LEN];
        assert!(name.len() <= Self::LEN, "the name is longer than 16 bytes");
        bytes.split_at_mut(name.len()).0.copy_from_slice(name.as_bytes());
        Self(bytes)
    }

    /// Returns the name as text, or an empty text if the bytes are not valid UTF-8.
    pub fn text(&self) -> &str {
        let text = self.0.split(|&byte| byte == 0).next().unwrap_or_default();
        core::str::from_utf8(text).unwrap_or_default()
    }

    pub(crate) fn to_words(self) -> [u32; Self::WORDS] {
        let (words, _) = self.0.as_chunks();
        core::array::from_fn(|n| words.get(n).map_or(0, |&word| u32::from_le_bytes(word)))
    }

    pub(crate) fn from_words(words: [u32; Self::WORDS]) -> Self {
        let mut bytes = [0; Self::LEN];
        for (place, byte) in bytes.iter_mut().zip(words.map(u32::to_le_bytes).as_flattened()) {
            *place = *byte;
        }
        Self(bytes)
    }
}

/// Directions in which motor and encoder are mounted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signs {
    /// Whether a positive command pushes out of the wall.
    pub motor_reversed: bool,
    /// Whether the count falls when the handle moves into the wall.
    pub encoder_reversed: bool,
}

/// Length of a record, in flash words.
pub const RECORD_WORDS: usize = 44;

/// The content of a further record. It holds what does not fit into the main record: the estimator's parameters after
/// the second one, and a limit of the force's RMS. It is written just before the main record.
pub(super) type Further = [f64; FURTHER + 1];
const KEPT: usize = 2;
const FURTHER: usize = PARAMETERS - KEPT;

/// How many numbers a record has. Each takes two words.
const NUMBERS: usize = 17;

/// Version of the layout.
pub const LAYOUT: u8 = 5;
/// First word of a record: "ZWS" and the version.
const HEAD: u32 = u32::from_le_bytes([b'Z', b'W', b'S', LAYOUT]);
/// First word of layout 4, which had only the criterion `rms`.
const HEAD_4: u32 = u32::from_le_bytes(*b"ZWS\x04");
/// First word of layout 3, which had a word of flags in place of the device's hash.
const HEAD_3: u32 = u32::from_le_bytes(*b"ZWS\x03");
/// First word of layout 2. It was like layout 3, but with 0 in place of the output period, which was always 1 ms.
const HEAD_2: u32 = u32::from_le_bytes(*b"ZWS\x02");
const PERIOD_2: u32 = 10;
/// First word of a further record.
const HEAD_FURTHER: u32 = u32::from_le_bytes(*b"ZWP\x03");
/// Number of flag bits. The number of the estimator is above them.
const FLAG_BITS: u32 = 8;
const PUSH_ONLY: u32 = 1;
const MOTOR_REVERSED: u32 = 2;
const ENCODER_REVERSED: u32 = 4;
/// Flags of the layouts up to 4.
const FLAGS_4: u32 = 7;
const QUIET: u32 = 8;
const FORCE_LIMIT: u32 = 16;

#[expect(clippy::cast_possible_truncation, reason = "halves of 64-bit words")]
fn halves(value: f64) -> [u32; 2] {
    let bits = value.to_bits();
    [bits as u32, (bits >> 32) as u32]
}

fn whole(low: u32, high: u32) -> f64 {
    f64::from_bits(u64::from(low) | u64::from(high) << 32)
}

/// Makes a record of these words. Zeros fill it up, and the last word is a CRC over all other words.
fn checked(body: impl Iterator<Item = u32>) -> [u32; RECORD_WORDS] {
    let mut words = [0; RECORD_WORDS];
    let [places @ .., check] = &mut words;
    for (place, word) in places.iter_mut().zip(body) {
        *place = word;
    }
    *check = crc::of_words(places);
    words
}

/// Whether these words look like a damaged record. They do if three of the first four bytes are right. Any other words
/// look like this with a probability of one in four million. A valid record of another layout, or with an estimator
/// that this image lacks, belongs to another image and is not damaged.
pub(super) fn looks_like_a_record(words: &[u32; RECORD_WORDS]) -> bool {
    let [body @ .., check] = words;
    if crc::of_words(body) == *check {
        return false;
    }
    let [z, w, kind, version] = body[0].to_le_bytes();
    let right =
        [z == b'Z', w == b'W', matches!(kind, b'S' | b'P'), (1..=LAYOUT).contains(&version)];
    right.into_iter().filter(|&right| right).count() >= 3
}

/// Reads a further record from these words. Returns its sequence number and its content, or `None` if the words are no
/// further record.
pub(super) fn further_of_words(words: &[u32; RECORD_WORDS]) -> Option<(u32, Further)> {
    let [body @ .., check] = words;
    let [HEAD_FURTHER, sequence, numbers @ ..] = body else { return None };
    if crc::of_words(body) != *check {
        return None;
    }
    let (pairs, _) = numbers.as_chunks::<2>();
    let number = |n| pairs.get(n).map_or(0.0, |&[low, high]: &[u32; 2]| whole(low, high));
    Some((*sequence, core::array::from_fn(number)))
}

impl Stored {
    /// Whether some settings do not fit into one record, so that a further record is needed.
    pub(super) fn has_further(&self) -> bool {
        let of_estimator = self.settings.velocity.name().parameters()[KEPT].is_some();
        of_estimator || self.force_rms_limit_n.is_some()
    }

    pub(super) fn further_to_words(&self, sequence: u32) -> Option<[u32; RECORD_WORDS]> {
        if !self.has_further() {
            return None;
        }
        let (_, parameters) = EstimatorName::of(&self.settings.velocity);
        let limit = self.force_rms_limit_n.unwrap_or_default();
        let numbers = parameters.into_iter().skip(KEPT).chain([limit]).flat_map(halves);
        Some(checked([HEAD_FURTHER, sequence].into_iter().chain(numbers)))
    }

    /// Returns these settings, completed with the values of the further record.
    #[must_use]
    pub(super) fn with_further(mut self, further: &Further) -> Self {
        let [parameters @ .., limit] = further;
        for (n, number) in parameters.iter().enumerate() {
            self.settings.velocity = self.settings.velocity.with_parameter(KEPT + n, *number);
        }
        self.force_rms_limit_n = self.force_rms_limit_n.map(|_| *limit);
        self
    }

    /// The settings as words. The last word is a CRC over all other words.
    pub fn to_words(&self, sequence: u32) -> [u32; RECORD_WORDS] {
        let (estimator, parameters) = EstimatorName::of(&self.settings.velocity);
        let wall = &self.settings.wall;
        let flag = |set: bool, bit: u32| if set { bit } else { 0 };
        let flags = flag(wall.push_only, PUSH_ONLY)
            | flag(self.signs.motor_reversed, MOTOR_REVERSED)
            | flag(self.signs.encoder_reversed, ENCODER_REVERSED)
            | flag(self.criterion == Criterion::Quiet, QUIET)
            | flag(self.force_rms_limit_n.is_some(), FORCE_LIMIT);
        let numbers = [
            parameters[0],
            parameters[1],
            wall.stiffness_n_per_m,
            wall.damping_n_s_per_m,
            wall.position_m,
            self.push_n,
            self.start_m,
            self.full_scale_n,
            self.grid.stiffness_start_n_per_m,
            self.grid.stiffness_step_n_per_m,
            self.grid.stiffness_max_n_per_m,
            self.grid.damping_start_n_s_per_m,
            self.grid.damping_step_n_s_per_m,
            self.grid.damping_max_n_s_per_m,
            self.settle_s,
            self.window_s,
            self.rms_limit_m,
        ];
        checked(
            [HEAD, sequence]
                .into_iter()
                .chain(self.device.name.to_words())
                .chain([self.device.hash, estimator.id() << FLAG_BITS | flags])
                .chain(numbers.into_iter().flat_map(halves))
                .chain([self.period]),
        )
    }

    /// Reads a record of this layout or of layout 4, 3 or 2. Returns its sequence number and its settings. The values
    /// that a further record holds are still 0.
    pub fn from_words(words: &[u32; RECORD_WORDS]) -> Option<(u32, Self)> {
        let [body @ .., check] = words;
        if crc::of_words(body) != *check {
            return None;
        }
        let [head, sequence, n0, n1, n2, n3, first, second, numbers @ ..] = *body;
        let name = Name::from_words([n0, n1, n2, n3]);
        let (pairs, rest) = numbers.as_chunks::<2>();
        let &[period] = rest else { return None };
        let (hash, estimator, flags, period) = match head {
            HEAD => (first, second >> FLAG_BITS, second, period),
            HEAD_4 => (first, second >> FLAG_BITS, second & FLAGS_4, period),
            HEAD_3 => (0, first, second & FLAGS_4, period),
            HEAD_2 => (0, first, second & FLAGS_4, PERIOD_2),
            _ => return None,
        };
        let device = DeviceKey { name, hash };
        let numbers: [f64; NUMBERS] =
            core::array::from_fn(|n| pairs.get(n).map_or(0.0, |&[low, high]| whole(low, high)));
        let [
            p,
            q,
            k,
            b,
            wall,
            push_n,
            start_m,
            full_scale_n,
            k0,
            dk,
            k_max,
            b0,
            db,
            b_max,
            settle_s,
            window_s,
            rms_limit_m,
        ] = numbers;
        let stored = Self {
            device,
            settings: Settings {
                velocity: EstimatorName::from_id(estimator)?
                    .settings(core::array::from_fn(|n| [p, q].get(n).copied().unwrap_or_default())),
                wall: WallSettings {
                    position_m: wall,
                    stiffness_n_per_m: k,
                    damping_n_s_per_m: b,
                    push_only: flags & PUSH_ONLY != 0,
                },
            },
            period,
            push_n,
            signs: Signs {
                motor_reversed: flags & MOTOR_REVERSED != 0,
                encoder_reversed: flags & ENCODER_REVERSED != 0,
            },
            start_m,
            settle_s,
            window_s,
            rms_limit_m,
            criterion: if flags & QUIET == 0 { Criterion::Rms } else { Criterion::Quiet },
            force_rms_limit_n: (flags & FORCE_LIMIT != 0).then_some(0.0),
            full_scale_n,
            grid: WalkSettings {
                stiffness_start_n_per_m: k0,
                stiffness_step_n_per_m: dk,
                stiffness_max_n_per_m: k_max,
                damping_start_n_s_per_m: b0,
                damping_step_n_s_per_m: db,
                damping_max_n_s_per_m: b_max,
            },
        };
        Some((sequence, stored))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::VelocitySettings;
    use proptest::prelude::*;

    pub fn stored(stiffness_n_per_m: f64) -> Stored {
        Stored {
            device: DeviceKey { name: Name::of("paper-1um"), hash: 0x1234_5678 },
            settings: Settings {
                velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
                wall: WallSettings {
                    position_m: 0.07,
                    stiffness_n_per_m,
                    damping_n_s_per_m: 50.0,
                    push_only: true,
                },
            },
            period: 10,
            push_n: 2.835,
            signs: Signs { motor_reversed: true, encoder_reversed: false },
            start_m: 0.0,
            settle_s: 4.0,
            window_s: 2.0,
            rms_limit_m: 1.5e-5,
            criterion: Criterion::Rms,
            force_rms_limit_n: None,
            full_scale_n: 5.906,
            grid: grid([2000.0, 1000.0, 1e7, 10.0, 20.0, 4000.0]),
        }
    }

    pub fn grid([k0, dk, k_max, b0, db, b_max]: [f64; 6]) -> WalkSettings {
        WalkSettings {
            stiffness_start_n_per_m: k0,
            stiffness_step_n_per_m: dk,
            stiffness_max_n_per_m: k_max,
            damping_start_n_s_per_m: b0,
            damping_step_n_s_per_m: db,
            damping_max_n_s_per_m: b_max,
        }
    }

    #[test]
    fn names_are_kept_up_to_16_bytes() {
        for name in ["", "a", "paper-1um", "0123456789abcdef"] {
            assert_eq!(Name::new(name).unwrap().text(), name);
        }
        assert_eq!(Name::new("0123456789abcdefg"), None);
        assert_eq!(Name::new("a\0b"), None);
        assert_eq!(Name([0xFF; 16]).text(), "");
    }

    #[test]
    fn a_record_with_an_unknown_version_or_estimator_is_none() {
        for (word, value) in [(0, HEAD + (1 << 24)), (7, 999 << FLAG_BITS)] {
            let mut words = stored(1.0).to_words(1);
            words[word] = value;
            sign(&mut words);
            assert_eq!(Stored::from_words(&words), None);
        }
    }

    fn sign(words: &mut [u32; RECORD_WORDS]) {
        let (body, check) = words.split_at_mut(RECORD_WORDS - 1);
        check[0] = crc::of_words(body);
    }

    /// Settings of the layouts before the device record belong to no device. Settings of the layouts before the output
    /// period have outputs at 1 kHz.
    #[test]
    fn records_of_layouts_2_to_4_are_read_and_before_4_are_no_devices() {
        let saved = Stored { period: 1, ..stored(1.0) };
        let mut words = saved.to_words(7);
        assert_eq!(Stored::from_words(&words), Some((7, saved)));
        words[0] = HEAD_4;
        sign(&mut words);
        assert_eq!(Stored::from_words(&words), Some((7, saved)));
        let (estimator, flags) = (words[7] >> FLAG_BITS, words[7] & 0xFF);
        [words[0], words[6], words[7]] = [HEAD_3, estimator, flags];
        sign(&mut words);
        let old = Stored { device: DeviceKey::of("paper-1um"), ..saved };
        assert_eq!(Stored::from_words(&words), Some((7, old)));
        (words[0], words[RECORD_WORDS - 2]) = (HEAD_2, 0);
        sign(&mut words);
        assert_eq!(Stored::from_words(&words), Some((7, Stored { period: PERIOD_2, ..old })));
    }

    proptest! {
        #[test]
        fn a_record_comes_back_bit_for_bit(
            numbers in any::<[f64; 10]>(), walk in any::<[f64; 6]>(), flags in any::<[bool; 4]>(), sequence in any::<u32>(),
            name in "[a-z0-9-]{0,16}", hash in any::<u32>(), period in any::<u32>(),
        ) {
            let record = Stored {
                device: DeviceKey { name: Name::new(&name).unwrap(), hash },
                settings: Settings {
                    velocity: EstimatorName::ALL[usize::from(flags[0])].settings(core::array::from_fn(|n| if n == 0 { numbers[0] } else { 0.0 })),
                    wall: WallSettings {
                        position_m: numbers[1],
                        stiffness_n_per_m: numbers[2],
                        damping_n_s_per_m: numbers[3],
                        push_only: flags[1],
                    },
                },
                period,
                push_n: numbers[4],
                signs: Signs { motor_reversed: flags[2], encoder_reversed: flags[3] },
                start_m: numbers[5],
                settle_s: numbers[7],
                window_s: numbers[8],
                rms_limit_m: numbers[9],
                criterion: if flags[1] { Criterion::Quiet } else { Criterion::Rms },
                force_rms_limit_n: flags[3].then_some(numbers[0]),
                full_scale_n: numbers[6],
                grid: grid(walk),
            };
            let words = record.to_words(sequence);
            let (number, back) = Stored::from_words(&words).unwrap();
            let further = record.further_to_words(sequence).map(|words| further_of_words(&words).unwrap());
            prop_assert_eq!(further.is_some(), flags[3]);
            let back = further.map_or(back, |(same, further)| {
                assert_eq!(same, sequence);
                back.with_further(&further)
            });
            prop_assert_eq!(back.force_rms_limit_n.map(f64::to_bits), record.force_rms_limit_n.map(f64::to_bits));
            prop_assert_eq!(back.criterion, record.criterion);
            prop_assert_eq!((number, back.to_words(number)), (sequence, words));
            prop_assert_eq!((back.device, back.period), (record.device, period));
            prop_assert_eq!(back.rms_limit_m.to_bits(), numbers[9].to_bits());
            prop_assert_eq!(back.full_scale_n.to_bits(), numbers[6].to_bits());
            prop_assert_eq!(back.grid.damping_max_n_s_per_m.to_bits(), walk[5].to_bits());
        }

        #[test]
        fn arbitrary_words_never_panic(words in any::<[u32; RECORD_WORDS]>()) {
            let _ = Stored::from_words(&words);
        }
    }
}
