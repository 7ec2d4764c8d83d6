//! What the board tells: one record per output, and its form on the wire.
//!
//! A frame is 40 bytes, least significant byte first; `docs/telemetry.md` has the table. The sample
//! index is sent whole: its low 32 bits would wrap within a day at 50 kHz and leave every reader to
//! guess, for 4 bytes less. The CRC covers everything before it, magic included, so that a false
//! frame in garbage passes once in 2^32 times where the magic happens to stand.

use crate::{
    crc,
    units::{Force, OutputCode, Position, Velocity},
};

/// Facts of one output, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(u16);

impl Flags {
    /// The handle is inside the wall.
    pub const CONTACT: Self = Self(1);
    /// An output was computed with this sample.
    pub const RENDERED: Self = Self(2);
    /// The actuator could not give all that was asked for.
    pub const SATURATED: Self = Self(4);
    /// The output is on: the force acts.
    pub const ON: Self = Self(8);
    /// Force is complete: sign test and ramp are over.
    pub const ARMED: Self = Self(16);
    /// A change of settings is fading in.
    pub const CHANGING: Self = Self(32);
    /// A fault is latched.
    pub const FAULT: Self = Self(64);
    /// The count was zeroed since the reset.
    pub const ZEROED: Self = Self(128);
    /// The emergency stop is closed: force is possible.
    pub const STOP_CLOSED: Self = Self(256);
    /// Gains beyond the predicted-stable envelope are allowed.
    pub const UNLOCKED: Self = Self(512);
    /// Not live: a record from before the fault, read out of the black box.
    pub const REPLAY: Self = Self(1024);

    /// As bits.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Of bits; those without a meaning are kept.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// Whether all of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// With `other`, if `set`.
    #[must_use]
    #[inline]
    pub const fn with_if(self, other: Self, set: bool) -> Self {
        if set { Self(self.0 | other.0) } else { self }
    }
}

/// One output, in the integers of the control itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Record {
    /// Index of the sample that the output answers.
    pub sample: u64,
    /// Position, counts.
    pub position: Position,
    /// Velocity.
    pub velocity: Velocity,
    /// Force that the output gives, after ramps; 0 while it is off.
    pub force: Force,
    /// DAC or PWM code that the hardware was given.
    pub command: OutputCode,
    /// Facts.
    pub flags: Flags,
    /// Number of the settings in force, modulo 2^16: counts up with every change.
    pub settings: u16,
    /// Code of the latched fault; 0: none.
    pub fault: u8,
}

/// A record with its place in the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Counts up by 1 with every frame that was made, sent or not; wraps. A gap is a drop.
    pub sequence: u32,
    /// The record.
    pub record: Record,
}

impl Frame {
    /// First two bytes of every frame.
    pub const MAGIC: [u8; 2] = *b"ZW";
    /// Version of the layout, the third byte.
    pub const VERSION: u8 = 1;
    /// Length on the wire, bytes.
    pub const LEN: usize = 40;
}

impl Record {
    /// At rest at zero, with nothing to say.
    pub const EMPTY: Self = Self {
        sample: 0,
        position: Position::from_counts(0),
        velocity: Velocity::ZERO,
        force: Force::ZERO,
        command: OutputCode(0),
        flags: Flags(0),
        settings: 0,
        fault: 0,
    };
}

impl Frame {
    /// The frame's bytes.
    #[inline]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let record = &self.record;
        let mut bytes = [0; Self::LEN];
        let mut rest: &mut [u8] = &mut bytes;
        put(&mut rest, &Self::MAGIC);
        put(&mut rest, &[Self::VERSION, record.fault]);
        put(&mut rest, &self.sequence.to_le_bytes());
        put(&mut rest, &record.sample.to_le_bytes());
        put(&mut rest, &record.position.counts().to_le_bytes());
        put(&mut rest, &record.velocity.bits().to_le_bytes());
        put(&mut rest, &record.force.bits().to_le_bytes());
        put(&mut rest, &record.command.code().to_le_bytes());
        put(&mut rest, &record.flags.bits().to_le_bytes());
        put(&mut rest, &record.settings.to_le_bytes());
        let check = bytes.split_last_chunk::<4>().map_or(0, |(body, _)| crc::of_bytes(body));
        if let Some((_, place)) = bytes.split_last_chunk_mut::<4>() {
            *place = check.to_le_bytes();
        }
        bytes
    }

    /// The frame in those bytes, if they are one of this version.
    pub fn decode(bytes: &[u8; Self::LEN]) -> Option<Self> {
        let mut rest: &[u8] = bytes;
        if take(&mut rest)? != Self::MAGIC {
            return None;
        }
        let [version, fault] = take(&mut rest)?;
        if version != Self::VERSION {
            return None;
        }
        let (body, check) = bytes.split_last_chunk::<4>()?;
        if crc::of_bytes(body) != u32::from_le_bytes(*check) {
            return None;
        }
        Some(Self {
            sequence: u32::from_le_bytes(take(&mut rest)?),
            record: Record {
                sample: u64::from_le_bytes(take(&mut rest)?),
                position: Position::from_counts(i32::from_le_bytes(take(&mut rest)?)),
                velocity: Velocity::saturating_from_bits(i32::from_le_bytes(take(&mut rest)?)),
                force: Force::saturating_from_bits(i32::from_le_bytes(take(&mut rest)?)),
                command: OutputCode(i32::from_le_bytes(take(&mut rest)?)),
                flags: Flags::from_bits(u16::from_le_bytes(take(&mut rest)?)),
                settings: u16::from_le_bytes(take(&mut rest)?),
                fault,
            },
        })
    }
}

/// Writes `bytes` at the start of `rest`, which goes on behind them.
fn put<const N: usize>(rest: &mut &mut [u8], bytes: &[u8; N]) {
    if let Some((place, behind)) = core::mem::take(rest).split_first_chunk_mut::<N>() {
        *place = *bytes;
        *rest = behind;
    }
}

/// The first bytes of `rest`, which goes on behind them.
fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (bytes, behind) = rest.split_first_chunk::<N>()?;
    *rest = behind;
    Some(*bytes)
}

/// Finds the frames in a stream that may begin anywhere and hold anything.
///
/// After garbage it looks for the next frame at every byte, so a damaged frame costs itself only.
#[derive(Clone, Copy, Debug)]
pub struct Decoder {
    window: [u8; Frame::LEN],
    filled: usize,
    next: Option<u32>,
    /// Frames that were found.
    pub frames: u64,
    /// Frames that are missing between those that were found, as their sequence tells.
    pub dropped: u64,
    /// Bytes that belong to no frame.
    pub garbage: u64,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub const fn new() -> Self {
        Self { window: [0; Frame::LEN], filled: 0, next: None, frames: 0, dropped: 0, garbage: 0 }
    }

    /// Takes one byte; answers with the frame that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Frame> {
        if let Some(place) = self.window.get_mut(self.filled) {
            *place = byte;
            self.filled += 1;
        }
        if self.filled < Frame::LEN {
            return None;
        }
        let Some(frame) = Frame::decode(&self.window) else {
            self.skip();
            return None;
        };
        self.filled = 0;
        self.frames += 1;
        let gap = self.next.map_or(0, |next| frame.sequence.wrapping_sub(next));
        // A sequence that seems to go back is a board that began anew, not four billion drops.
        if gap < u32::MAX / 2 {
            self.dropped += u64::from(gap);
        }
        self.next = Some(frame.sequence.wrapping_add(1));
        Some(frame)
    }

    /// The end of the stream: bytes of an unfinished frame are garbage too.
    pub fn finish(&mut self) {
        self.garbage += self.filled as u64;
        self.filled = 0;
    }

    /// Drops bytes up to the next one that could begin a frame.
    fn skip(&mut self) {
        let [first, second] = Frame::MAGIC;
        let may_start = |place: usize| {
            self.window.get(place) == Some(&first)
                && self.window.get(place + 1).is_none_or(|&byte| byte == second)
        };
        let start = (1..Frame::LEN).find(|&place| may_start(place)).unwrap_or(Frame::LEN);
        self.garbage += start as u64;
        self.window.rotate_left(start % Frame::LEN);
        self.filled = Frame::LEN - start;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    prop_compose! {
        fn frames()(
            sequence in any::<u32>(), sample in any::<u64>(), position in any::<i32>(),
            velocity in -(32_767i32 << 16)..=32_767 << 16, force in -(1i32 << 30)..=1 << 30,
            command in any::<i32>(), flags in any::<u16>(), settings in any::<u16>(),
            fault in any::<u8>(),
        ) -> Frame {
            Frame {
                sequence,
                record: Record {
                    sample,
                    position: Position::from_counts(position),
                    velocity: Velocity::saturating_from_bits(velocity),
                    force: Force::saturating_from_bits(force),
                    command: OutputCode(command),
                    flags: Flags::from_bits(flags),
                    settings,
                    fault,
                },
            }
        }
    }

    fn frame(sequence: u32) -> Frame {
        Frame { sequence, ..Frame::default() }
    }

    /// The bytes that `docs/telemetry.md` shows.
    const EXAMPLE: [u8; Frame::LEN] = [
        0x5A, 0x57, 1, 0, 7, 0, 0, 0, 0x10, 0x27, 0, 0, 0, 0, 0, 0, 0x70, 0x11, 1, 0, 0, 0x80, 0,
        0, 0, 0, 0, 0xE0, 0, 4, 0, 0, 0x9B, 1, 3, 0, 0, 0, 0, 0,
    ];

    #[test]
    fn the_layout_is_the_documented_one() {
        let bytes = Frame {
            sequence: 7,
            record: Record {
                sample: 10_000,
                position: Position::from_counts(70_000),
                velocity: Velocity::saturating_from_bits(1 << 15),
                force: Force::saturating_from_bits(-(1 << 29)),
                command: OutputCode(1024),
                flags: Flags::from_bits(0x019B),
                settings: 3,
                fault: 0,
            },
        }
        .encode();
        assert_eq!(bytes[..36], EXAMPLE[..36]);
        assert_eq!(bytes[36..], crc::of_bytes(&EXAMPLE[..36]).to_le_bytes());
        let document = include_str!("../docs/telemetry.md");
        let dump: Vec<_> = bytes.iter().map(|b| std::format!("{b:02X}")).collect();
        let shown = document.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(shown.contains(&dump.join(" ")), "{}", dump.join(" "));
    }

    #[test]
    fn drops_are_counted_across_the_wrap_and_a_restart_is_none() {
        let mut decoder = Decoder::new();
        for sequence in [u32::MAX - 1, u32::MAX, 0, 3, 4, 0, 1] {
            let found: Vec<_> = frame(sequence)
                .encode()
                .into_iter()
                .filter_map(|byte| decoder.push(byte))
                .collect();
            assert_eq!(found, [frame(sequence)]);
        }
        assert_eq!((decoder.frames, decoder.dropped, decoder.garbage), (7, 2, 0));
    }

    /// Frames in a stream, and bytes of garbage before each.
    const PARTS: usize = if cfg!(miri) { 3 } else { 20 };
    const NOISE: usize = if cfg!(miri) { 8 } else { 90 };

    proptest! {
        #[test]
        fn any_frame_comes_back_and_no_flipped_byte_passes(
            frame in frames(), place in 0..Frame::LEN, flip in 1u8..
        ) {
            let mut bytes = frame.encode();
            prop_assert_eq!(Frame::decode(&bytes), Some(frame));
            bytes[place] ^= flip;
            prop_assert_eq!(Frame::decode(&bytes), None);
        }

        #[test]
        fn every_whole_frame_is_found_between_garbage(
            parts in prop::collection::vec(
                (frames(), prop::collection::vec(prop_oneof![Just(b'Z'), Just(b'W'), any::<u8>()], 0..NOISE)),
                0..PARTS,
            )
        ) {
            let mut decoder = Decoder::new();
            let (mut found, mut sent, mut garbage) = (Vec::new(), Vec::new(), 0);
            for (frame, noise) in &parts {
                sent.push(*frame);
                garbage += noise.len() as u64;
                for byte in noise.iter().copied().chain(frame.encode()) {
                    found.extend(decoder.push(byte));
                }
            }
            decoder.finish();
            prop_assert_eq!(found, sent);
            prop_assert_eq!(decoder.garbage, garbage);
        }

        #[test]
        fn a_cut_frame_costs_itself_only(cut in 1..Frame::LEN) {
            let mut decoder = Decoder::new();
            let stream = [&frame(0).encode()[..], &frame(1).encode()[cut..], &frame(2).encode()]
                .concat();
            let found: Vec<_> = stream.into_iter().filter_map(|b| decoder.push(b)).collect();
            prop_assert_eq!(found, [frame(0), frame(2)]);
            prop_assert_eq!(decoder.dropped, 1);
        }
    }
}
