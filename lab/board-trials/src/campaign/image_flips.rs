//! Flips single bits of the program in flash, with the force on and the handle in contact. Reports which check finds
//! the flip, and the force until then.

use host_sim::error::Error;
use seal::SEAL;
use serde::Serialize;
use virtual_board::{elf::Elf, world::World};
use zwidth::{image::LONGEST, safety::Fault};

use super::{
    situation::Stage,
    verdict::{Class, Measure, SHORT_S, Verdict},
};
use crate::random::Random;

/// Longest time that one complete image check takes at output period 10, in s. No wrong force may last longer.
pub const PASS_S: f64 = 0.2;
/// Number of samples for which the board is watched after a flip. The firmware needs fewer samples to detect an image
/// check that does not end.
pub const WATCHED: u64 = LONGEST as u64 + 1_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// The vector table and the checksum that follows it.
    Vectors,
    /// The instructions and the data between them.
    Code,
    Constants,
    /// Initial values that are copied to RAM at boot.
    Variables,
    /// The device record.
    Record,
}

pub const PARTS: [Part; 5] =
    [Part::Vectors, Part::Code, Part::Constants, Part::Variables, Part::Record];

impl Part {
    pub const fn text(self) -> &'static str {
        match self {
            Self::Vectors => "vectors",
            Self::Code => "code",
            Self::Constants => "constants",
            Self::Variables => "variables",
            Self::Record => "device record",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// The check found the flip. Until then the force was wrong for 2 ms at most.
    Harmless,
    /// The check found the flip, but before that the force was wrong for longer than 2 ms.
    Wrong,
    /// Something else switched the force off before the check found the flip.
    Other,
    /// A wrong force lasted longer than one complete image check.
    Late,
    /// Nothing found the flip.
    Unnoticed,
}

pub const ENDS: [End; 5] = [End::Harmless, End::Wrong, End::Other, End::Late, End::Unnoticed];

impl End {
    pub const fn text(self) -> &'static str {
        match self {
            Self::Harmless => "found by the check, force right",
            Self::Wrong => "found by the check, force wrong before",
            Self::Other => "off by something else",
            Self::Late => "force wrong for longer than a pass",
            Self::Unnoticed => "unnoticed",
        }
    }

    /// Whether this result makes the campaign fail.
    pub const fn is_bad(self) -> bool {
        matches!(self, Self::Late | Self::Unnoticed)
    }

    fn of(verdict: &Verdict) -> Self {
        let by_check = verdict.code == Some(Fault::Image.code());
        match verdict {
            Verdict { off_s: None, .. } => Self::Unnoticed,
            Verdict { class: Class::OffLate, .. } => Self::Late,
            Verdict { wrong_s, .. } if by_check && *wrong_s <= SHORT_S => Self::Harmless,
            _ if by_check => Self::Wrong,
            _ => Self::Other,
        }
    }
}

pub struct ImageFlip {
    pub part: Part,
    /// Place and time of the flip, for printed results.
    pub what: String,
    pub end: End,
    pub verdict: Verdict,
}

/// The words of the image in which a bit can flip.
pub struct Image {
    /// The address range of each part: its first address, and the address after its last byte.
    spans: Vec<(Part, [u32; 2])>,
}

impl Image {
    /// Finds the words of an ELF that the board checks while it runs.
    ///
    /// # Errors
    /// The ELF has no checksum.
    pub fn of(elf: &Elf) -> Result<Self, Error> {
        let [vectors, code, constants, variables] = seal::parts(elf).map_err(Error::input)?;
        let seal = elf.address_of(SEAL).unwrap_or_default();
        let (record, bytes) = elf.section(".device").unwrap_or_default();
        let spans = vec![
            (Part::Vectors, vectors),
            (Part::Vectors, [seal, seal + 4]),
            (Part::Code, code),
            (Part::Constants, constants),
            (Part::Variables, variables),
            (Part::Record, [record, record + bytes]),
        ];
        Ok(Self { spans })
    }

    /// Finds a word by its number. The words of all parts are counted as one sequence. Returns the part and the
    /// address.
    fn word(&self, mut number: u32) -> Option<(Part, u32)> {
        self.spans.iter().find_map(|&(part, [from, to])| {
            let words = (to - from) / 4;
            let inside = number < words;
            let address = from + 4 * number;
            number = number.wrapping_sub(if inside { 0 } else { words });
            inside.then_some((part, address))
        })
    }

    fn words(&self) -> u32 {
        self.spans.iter().map(|(_, [from, to])| (to - from) / 4).sum()
    }
}

/// Runs the flip with this number from this seed. Each bit of the image has the same probability.
///
/// # Errors
/// The board does not reach the time of the flip.
pub fn flip(
    world: &mut World<'_>,
    (stage, image): (&Stage, &Image),
    (seed, number): (u64, u64),
    full_m_per_s2: f64,
) -> Result<ImageFlip, Error> {
    let mut random = Random(seed.wrapping_mul(0x9FB2_1C65_1E98_DF25).wrapping_add(number));
    let start = random.one(&stage.starts);
    world.restore(&start.snapshot);
    let begin = world.powered.mcu.now();
    let sample = world.powered.board.cycles_per_sample();
    let at = begin + random.below(10 * sample);
    world.run_to(at).map_err(|ended| Error::Internal(format!("before a fault: {ended:?}")))?;
    let begun = world.powered.mcu.now();
    let word = u32::try_from(random.below(image.words().into())).unwrap_or_default();
    let bit = random.small(32);
    let place = image.word(word);
    let (part, address) = place.ok_or_else(|| Error::Internal("a word of none".into()))?;
    let flipped = world.powered.mcu.peek(address) ^ 1 << bit;
    world.powered.mcu.program(address, &flipped.to_le_bytes());
    let measure = Measure {
        begun,
        samples: WATCHED,
        half_if_right: false,
        reference: &stage.seen[start.index..],
        period: 10,
        from_memory: true,
        allowed_s: PASS_S,
        from_fault: false,
        free: false,
        full_m_per_s2,
    };
    let verdict = measure.verdict(world);
    let cycle = begun - begin;
    let what = format!(
        "{}: {address:#x} bit {bit} at cycle {cycle} of start {}",
        part.text(),
        start.index
    );
    Ok(ImageFlip { part, what, end: End::of(&verdict), verdict })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_of_the_spans_is_one_and_none_is_twice() {
        let spans =
            vec![(Part::Vectors, [0, 8]), (Part::Code, [64, 72]), (Part::Variables, [80, 80])];
        let image = Image { spans };
        let words: Vec<_> = (0..=image.words()).map(|number| image.word(number)).collect();
        let (vectors, code) = (Part::Vectors, Part::Code);
        let all = [(vectors, 0), (vectors, 4), (code, 64), (code, 68)].map(Some);
        assert_eq!(words, [&all[..], &[None]].concat());
    }

    #[test]
    fn how_a_flip_ends_is_told_by_code_and_force() {
        let off = |class, wrong_s, code| Verdict {
            off_s: Some(0.1),
            wrong_s,
            code,
            ..Verdict::of(class)
        };
        let end = |verdict: Verdict| End::of(&verdict);
        assert_eq!(end(off(Class::OffInTime, 2e-3, Some(46))), End::Harmless);
        assert_eq!(end(off(Class::OffInTime, 2.1e-3, Some(46))), End::Wrong);
        assert_eq!(end(off(Class::OffInTime, 0.0, Some(42))), End::Other);
        assert_eq!(end(off(Class::OffInTime, 0.0, None)), End::Other);
        assert_eq!(end(off(Class::OffLate, 0.21, Some(46))), End::Late);
        assert_eq!(end(Verdict::of(Class::NoEffect)), End::Unnoticed);
    }
}
