//! Compares the program in flash with its checksum, which the build puts into the image.
//!
//! A linker computes no checksums. It leaves one word behind the vectors, with all bits set. This word is the seal
//! (`_seal` of memory.x). After linking, the package `seal` writes the checksum to this word. The checksum covers
//! vectors, code, constants and the data that is copied to RAM at boot. The linker's symbols give the first and last
//! word of each part. The gaps between the parts are never read. Sectors that are written later are not covered. The
//! settings have checksums of their own and are read only at `load`. The device record also has its own checksum. Each
//! pass checks the record too, because the program reads envelope and designs from the record all the time.
//!
//! | when | by | wrong |
//! |------|----|-------|
//! | boot, before any task | [`Image::check`] | nothing runs; the console says why |
//! | always, a [slice](SLICE) each time that `idle` wakes | [`Pass`] | off, [`Fault::Image`](crate::safety::Fault::Image), reset |
//! | with each pass of `link` | [`PassWatch`] | the same, if a pass was wrong, or if none has ended for [`LONGEST`] |
//!
//! Two independent checks find a wrong image while the force may be on. `idle` adds the checksums of each pass to a
//! sum. `link` accepts only steps of [`RIGHT`] in this sum. If a flipped bit stops one of the two checks, the other
//! check finds the wrong image.

use core::fmt;

use crate::{
    crc::{RESIDUE, Sum},
    period::SAMPLES_PER_MS,
};

/// The seal of an image that is not sealed.
pub const UNSEALED: u32 = u32::MAX;

/// Words that `idle` reads each time that it wakes. A slice has 64 words, which are 256 bytes. `idle` wakes at least
/// every 0.1 ms, so it reads at least 2.56 MB/s. For an image of 256 KiB a pass takes a tenth of a second. A bit that
/// flips just behind the read position is found at the end of the next pass.
pub const SLICE: usize = 64;

/// The longest allowed time from the end of one pass to the end of the next, in samples. It is 0.5 s. A pass takes a
/// fifth of this time, even while a host sends without a pause.
pub const LONGEST: u32 = 500 * SAMPLES_PER_MS;

/// The sum of the two CRCs of a pass if nothing is wrong. The first CRC covers the image and its stored checksum, the
/// second the record and its stored checksum.
pub const RIGHT: u32 = RESIDUE.wrapping_mul(2);

/// Number of parts of an image, without its seal.
const PARTS: usize = 4;

/// An image in flash.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    /// The four parts: vectors, code, constants, and the data that is copied to RAM.
    pub parts: [&'a [u32]; PARTS],
    /// Expected checksum of the parts.
    pub seal: &'a [u32; 1],
}

/// What is wrong with an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadImage {
    /// The image has no checksum.
    Unsealed,
    /// The checksum is wrong, so the image differs from the image that was sealed.
    Damaged,
}

impl Image<'_> {
    /// The checksum of the words in flash.
    pub fn checksum(&self) -> u32 {
        let mut sum = Sum::new();
        self.parts.iter().for_each(|part| sum.add(part));
        sum.get()
    }

    /// The expected checksum.
    pub const fn sealed(&self) -> u32 {
        let [seal] = *self.seal;
        seal
    }

    /// Checks that the image is unchanged since it was sealed.
    ///
    /// # Errors
    /// The image has no seal, or differs from the sealed image.
    pub fn check(&self) -> Result<(), BadImage> {
        match self.sealed() {
            UNSEALED => Err(BadImage::Unsealed),
            sealed if sealed == self.checksum() => Ok(()),
            _ => Err(BadImage::Damaged),
        }
    }
}

impl fmt::Display for BadImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unsealed => "it is not sealed: cargo seal ELF, then flash that",
            Self::Damaged => "it is not what was built: flash it again",
        })
    }
}

impl core::error::Error for BadImage {}

/// Checks image and device record in slices, again and again.
pub struct Pass<'a> {
    /// What is checked, in this order: the parts of the image, its seal, the record.
    parts: [&'a [u32]; PARTS + 2],
    /// Number of the part that is being read. `rest` are the words of this part that are still to be read.
    part: usize,
    rest: &'a [u32],
    sum: Sum,
    /// Sum of the checksums of this pass.
    found: u32,
}

impl<'a> Pass<'a> {
    /// Begins a pass over this image and this record. The last word of the record is its checksum.
    pub const fn new(image: &Image<'a>, record: &'a [u32]) -> Self {
        let [vectors, code, constants, variables] = image.parts;
        let parts = [vectors, code, constants, variables, image.seal.as_slice(), record];
        Self { parts, part: 0, rest: vectors, sum: Sum::new(), found: 0 }
    }

    /// Reads the next slice, or up to the end of a part. At the end of the pass it returns the sum of the checksums.
    /// The sum is [`RIGHT`] if nothing is wrong.
    #[inline]
    pub fn go_on(&mut self) -> Option<u32> {
        let (slice, rest) = self.rest.split_at_checked(SLICE).unwrap_or((self.rest, &[]));
        self.sum.add(slice);
        self.rest = rest;
        if rest.is_empty() { self.end_part() } else { None }
    }

    #[inline(never)]
    fn end_part(&mut self) -> Option<u32> {
        self.part += 1;
        if self.part > PARTS {
            self.found = self.found.wrapping_add(self.sum.get());
            self.sum = Sum::new();
        }
        if let Some(part) = self.parts.get(self.part) {
            self.rest = part;
            return None;
        }
        self.part = 0;
        [self.rest, ..] = self.parts;
        Some(core::mem::take(&mut self.found))
    }
}

/// Checks that passes end in time, and that no pass was wrong. For this it uses the sum over all passes.
#[derive(Clone, Copy, Debug, Default)]
pub struct PassWatch {
    sum: u32,
    /// Low 32 bits of the sample's number at the end of the last pass.
    ended: u32,
}

impl PassWatch {
    /// Whether the last pass was wrong, or no pass has ended for too long. `sample` is the number of the present
    /// sample, and `sum` the sum over all passes.
    pub fn is_wrong(&mut self, sample: u32, sum: u32) -> bool {
        if sum == self.sum.wrapping_add(RIGHT) {
            *self = Self { sum, ended: sample };
        }
        sum != self.sum || sample.wrapping_sub(self.ended) > LONGEST
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crc;
    use std::{string::ToString, vec, vec::Vec};

    /// Parts of an image, and their correct seal. The lengths of the parts are no multiples of a slice, and one part is
    /// empty.
    fn parts() -> ([Vec<u32>; PARTS], u32) {
        let of = |length: u32, seed: u32| (0..length).map(|n| seed.wrapping_mul(n + 1)).collect();
        let parts = [of(98, 0x9E37_79B9), of(1_003, 77), of(240, 0xDEAD_BEEF), vec![]];
        let sum = crc::of_pieces(parts.each_ref().map(Vec::as_slice));
        (parts, sum)
    }

    fn record() -> Vec<u32> {
        let body: Vec<u32> = (0..131).map(|n| n * 0x0101_0101).collect();
        let sum = crc::of_words(&body);
        [body, vec![sum]].concat()
    }

    fn image<'a>(parts: &'a [Vec<u32>; PARTS], seal: &'a [u32; 1]) -> Image<'a> {
        Image { parts: parts.each_ref().map(Vec::as_slice), seal }
    }

    /// Runs the next pass. Returns the sum of its checksums, and the number of calls.
    fn pass(pass: &mut Pass<'_>) -> (u32, usize) {
        (1..10_000).find_map(|n| Some((pass.go_on()?, n))).expect("it ends")
    }

    #[test]
    fn an_image_is_what_was_sealed_or_says_what_to_do() {
        let (mut parts, sum) = parts();
        assert_eq!(image(&parts, &[sum]).check(), Ok(()));
        assert_eq!(image(&parts, &[sum ^ 1]).check(), Err(BadImage::Damaged));
        assert_eq!(image(&parts, &[UNSEALED]).check(), Err(BadImage::Unsealed));
        parts[2][239] ^= 1 << 31;
        assert_eq!(image(&parts, &[sum]).check(), Err(BadImage::Damaged));
        assert!(BadImage::Unsealed.to_string().contains("cargo seal ELF"));
    }

    #[test]
    fn a_pass_ends_again_and_again_and_finds_every_flipped_bit_and_none_else() {
        let ((mut parts, sum), mut record) = (parts(), record());
        let slices = [98, 1_003, 240, 0, 1, 132].map(|words: usize| words.div_ceil(SLICE).max(1));
        let seal = [sum];
        let mut under_way = Pass::new(&image(&parts, &seal), &record);
        for _ in 0..3 {
            assert_eq!(pass(&mut under_way), (RIGHT, slices.iter().sum()));
        }
        for part in 0..PARTS {
            for word in 0..parts[part].len() {
                let bit = 1 << (word % 32);
                parts[part][word] ^= bit;
                let found = pass(&mut Pass::new(&image(&parts, &[sum]), &record)).0;
                assert_ne!(found, RIGHT, "part {part} word {word}");
                parts[part][word] ^= bit;
            }
        }
        for bit in 0..32 {
            let seal = [sum ^ 1 << bit];
            assert_ne!(pass(&mut Pass::new(&image(&parts, &seal), &record)).0, RIGHT);
        }
        for word in 0..record.len() {
            record[word] ^= 1 << (word % 32);
            assert_ne!(pass(&mut Pass::new(&image(&parts, &[sum]), &record)).0, RIGHT, "{word}");
            record[word] ^= 1 << (word % 32);
        }
    }

    #[test]
    fn passes_follow_each_other_in_time_and_none_is_wrong() {
        let mut watch = PassWatch::default();
        assert!(!watch.is_wrong(LONGEST, 0));
        assert!(watch.is_wrong(LONGEST + 1, 0));
        assert!(!watch.is_wrong(LONGEST + 2, RIGHT) && !watch.is_wrong(2 * LONGEST + 2, RIGHT));
        assert!(watch.is_wrong(2 * LONGEST + 3, RIGHT));
        let two = RIGHT.wrapping_mul(2);
        assert!(!watch.is_wrong(2 * LONGEST + 4, two));
        for sum in [RIGHT, RIGHT.wrapping_mul(4), two + 1, two.wrapping_add(RIGHT ^ 1 << 7), 0] {
            assert!({ watch }.is_wrong(2 * LONGEST + 5, sum), "{sum}");
        }
        let mut watch = PassWatch { sum: u32::MAX, ended: u32::MAX - 5 };
        let next = u32::MAX.wrapping_add(RIGHT);
        assert!(!watch.is_wrong(10, u32::MAX) && !watch.is_wrong(20, next));
    }
}
