//! The designs of a device: named velocity filters. Each design has its own rows in the envelope.
//!
//! In the device record each design has its name (16 bytes, text and then zeros), the number of its estimator, and
//! eight parameters. A parameter is an IEEE 754 double, low word first. Designs are numbered from 1, in their order. A
//! design is skipped if this build lacks its estimator. Settings use a design if their estimator and every parameter
//! are equal to those of the design, to the last bit. So saved settings need no further field for the design.

use crate::{
    VelocitySettings,
    store::Name,
    velocity::{EstimatorName, PARAMETERS},
};

/// The largest number of designs of a device. Telemetry has five bits for the number of a design.
pub const DESIGNS_MAX: usize = 16;
const WORDS: usize = Name::WORDS + 1 + 2 * PARAMETERS;

/// A velocity filter with a name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NamedFilter {
    /// The name. It consists of `a` to `z`, digits and `-`.
    pub name: Name,
    /// Estimator with all its parameters.
    pub velocity: VelocitySettings,
}

/// All designs of a device, as words of its record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Designs<'a> {
    /// The words of the record that hold the designs. They are already checked.
    words: &'a [[u32; WORDS]],
}

/// Whether a person can type this name.
pub fn is_design_name(name: &str) -> bool {
    let allowed = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
    !name.is_empty() && name.len() <= Name::LEN && name.bytes().all(allowed)
}

fn read(words: &[u32; WORDS]) -> Option<NamedFilter> {
    let (&name, rest) = words.split_first_chunk::<{ Name::WORDS }>()?;
    let (&id, numbers) = rest.split_first()?;
    let mut numbers = numbers.as_chunks::<2>().0.iter();
    let mut next = || match numbers.next() {
        Some(&[low, high]) => f64::from_bits(u64::from(low) | u64::from(high) << 32),
        None => 0.0,
    };
    let velocity = EstimatorName::from_id(id)?.settings(core::array::from_fn(|_| next()));
    Some(NamedFilter { name: Name::from_words(name), velocity })
}

/// The two words of a number, the low word first.
#[expect(clippy::cast_possible_truncation, reason = "halves of 64-bit words")]
pub(super) fn halves(value: f64) -> [u32; 2] {
    let bits = value.to_bits();
    [bits as u32, (bits >> 32) as u32]
}

impl<'a> Designs<'a> {
    /// No designs at all.
    pub const NONE: Self = Self { words: &[] };

    /// Splits `words` into the first `count` designs and the words behind them. Returns `None` if the designs are not
    /// complete, or if a name is not allowed or occurs twice.
    pub(crate) fn split(count: usize, words: &'a [u32]) -> Option<(Self, &'a [u32])> {
        if count > DESIGNS_MAX {
            return None;
        }
        let (front, rest) = words.split_at_checked(count * WORDS)?;
        let words = front.as_chunks::<WORDS>().0;
        let mut before = words.iter();
        while let Some(last) = before.next_back() {
            let name = last.first_chunk::<{ Name::WORDS }>()?;
            let twice = before.clone().any(|other| other.starts_with(name));
            if twice || !is_design_name(Name::from_words(*name).text()) {
                return None;
            }
        }
        Some((Self { words }, rest))
    }

    /// Writes the designs to the front of `words`. Returns the number of written words, or `None` if there is no room.
    pub(crate) fn put(designs: &[NamedFilter], words: &mut [u32]) -> Option<usize> {
        let places = words.as_chunks_mut::<WORDS>().0.get_mut(..designs.len())?;
        for (place, NamedFilter { name, velocity }) in places.iter_mut().zip(designs) {
            let (estimator, values) = EstimatorName::of(velocity);
            let values = values.into_iter().flat_map(halves);
            let all = name.to_words().into_iter().chain([estimator.id()]).chain(values);
            place.iter_mut().zip(all).for_each(|(place, word)| *place = word);
        }
        Some(designs.len() * WORDS)
    }

    /// Number of designs, including those whose estimator this build lacks.
    pub const fn count(&self) -> usize {
        self.words.len()
    }

    /// Designs that this build can run, with their numbers.
    pub fn iter(&self) -> impl Iterator<Item = (u8, NamedFilter)> + use<'a> {
        (1..).zip(self.words).filter_map(|(number, words)| Some((number, read(words)?)))
    }

    /// Number of the design that equals these settings, or 0 if no design equals them.
    pub fn number_of(&self, velocity: &VelocitySettings) -> u8 {
        self.iter().find(|(_, design)| design.velocity == *velocity).map_or(0, |(number, _)| number)
    }

    /// Name of the design with this number, or `none` if there is no such design.
    pub fn name_of(&self, number: u8) -> Name {
        let found = self.iter().find(|(known, _)| *known == number);
        found.map_or(const { Name::of("none") }, |(_, design)| design.name)
    }

    /// The design of that name.
    pub fn named(&self, name: &Name) -> Option<NamedFilter> {
        self.iter().map(|(_, design)| design).find(|design| design.name == *name)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::vec::Vec;

    /// Two designs for tests. Both are low-passes, which every build has. The first has the longest possible name.
    pub(crate) const NAMED: [NamedFilter; 2] = [
        NamedFilter {
            name: Name::of("0123456789abcdef"),
            velocity: VelocitySettings::Butterworth { cutoff_hz: 512.3 },
        },
        NamedFilter {
            name: Name::of("paper"),
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1500.0 },
        },
    ];

    pub(crate) fn words(designs: &[NamedFilter]) -> Vec<u32> {
        let mut words = [0; 64];
        let length = Designs::put(designs, &mut words).unwrap();
        words[..length].to_vec()
    }

    #[test]
    fn designs_come_back_by_name_number_and_settings() {
        let mut words = words(&NAMED);
        words.push(7);
        let (designs, rest) = Designs::split(2, &words).unwrap();
        assert_eq!((designs.count(), rest), (2, &[7][..]));
        assert!(designs.iter().eq([(1, NAMED[0]), (2, NAMED[1])]));
        for (number, design) in designs.iter() {
            assert_eq!(designs.named(&design.name), Some(design));
            assert_eq!(designs.name_of(number), design.name);
            assert_eq!(designs.number_of(&design.velocity), number);
        }
        let near = VelocitySettings::Butterworth { cutoff_hz: 1500.0f64.next_up() };
        assert_eq!(designs.number_of(&near), 0);
        assert_eq!((designs.name_of(0).text(), designs.name_of(3).text()), ("none", "none"));
        assert_eq!(designs.named(&Name::of("Paper")), None);
    }

    #[test]
    fn words_that_are_no_designs_are_refused_and_an_unknown_estimator_is_passed_over() {
        let whole = words(&NAMED);
        for length in 0..whole.len() {
            assert_eq!(Designs::split(2, &whole[..length]), None, "{length}");
        }
        let with = |place: usize, word: u32| {
            let mut words = whole.clone();
            words[place] = word;
            words
        };
        for bad in [with(0, 0), with(0, u32::MAX), with(0, u32::from_le_bytes(*b"a b-"))] {
            assert_eq!(Designs::split(2, &bad), None, "{bad:x?}");
        }
        assert_eq!(Designs::split(2, &words(&[NAMED[0], NAMED[0]])), None);
        let many = std::vec![0; (DESIGNS_MAX + 1) * WORDS];
        assert_eq!(Designs::split(DESIGNS_MAX + 1, &many), None);
        let unknown = with(Name::WORDS, 999);
        let (designs, _) = Designs::split(2, &unknown).unwrap();
        assert!(designs.iter().eq([(2, NAMED[1])]));
        assert_eq!(Designs::put(&NAMED, &mut [0; 2 * WORDS - 1]), None);
    }
}
