//! The telemetry that the board sends: a record of each output, and the layout of its bytes.
//!
//! A frame of layout 2 has the outputs of a millisecond and the counts of all its samples. Every 100 ms a frame is a
//! key frame. A reader that has a key frame can compute every later sample. The black box has one record per
//! millisecond. Such a record is a frame of layout 1, 40 bytes. The least significant byte comes first.
//! `docs/telemetry.md` has the tables.
//!
//! The sample index is sent with all 64 bits. An index of 32 bits would save only 4 bytes. It would wrap within a day
//! at 50 kHz, and every reader would have to guess the upper bits. The CRC covers everything before it, including the
//! magic bytes. If garbage contains the magic bytes by chance, its CRC is right only once in 2^32 times.

mod decoder;
mod parts;
#[cfg(test)]
mod tests;

pub use decoder::Decoder;
pub use parts::{FrameWriter, InForce, Key, Parts, STATE_MAX};

use crate::{
    crc,
    units::{Force, OutputCode, Position, Velocity},
};

/// Facts of one output, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(u16);

impl Flags {
    /// Whether the handle is inside the wall.
    pub const CONTACT: Self = Self(1);
    /// Whether an output was computed with this sample.
    pub const RENDERED: Self = Self(2);
    /// Whether the actuator could not give the whole force.
    pub const SATURATED: Self = Self(4);
    /// Whether the output is on, so that the force acts.
    pub const ON: Self = Self(8);
    /// Whether sign test and ramp are over, so that the full force acts.
    pub const ARMED: Self = Self(16);
    /// Whether a change of the settings fades in, or the passivity controller reduces the wall's force.
    pub const CHANGING: Self = Self(32);
    /// Whether a fault is latched.
    pub const FAULT: Self = Self(64);
    /// Whether the count was zeroed and the zero was not lost since then.
    pub const ZEROED: Self = Self(128);
    /// Whether the emergency stop is closed, so that force is possible.
    pub const STOP_CLOSED: Self = Self(256);
    /// Whether gains outside the envelope of stable walls are allowed.
    pub const UNLOCKED: Self = Self(512);
    /// Whether this is an older record, from the black box.
    pub const REPLAY: Self = Self(1024);

    /// Lowest bit of the design's number. The number, 1 to 31, is the place of the design in the device record. It is 0
    /// without a design.
    pub const DESIGN: u32 = 11;

    /// Returns these flags with the number of the design in force.
    #[must_use]
    pub const fn with_design(self, number: u8) -> Self {
        Self(self.0 & ((1 << Self::DESIGN) - 1) | (number as u16) << Self::DESIGN)
    }

    /// Number of the design in force, or 0 if there is none.
    pub const fn design(self) -> u8 {
        (self.0 >> Self::DESIGN) as u8
    }

    /// All flags as bits.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Makes flags from these bits. Bits without a meaning are kept.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// Whether all of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Returns these flags. If `set` is true, `other` is added.
    #[must_use]
    #[inline]
    pub const fn with_if(self, other: Self, set: bool) -> Self {
        if set { Self(self.0 | other.0) } else { self }
    }
}

/// The record of one output. Its values are the integers with which the control loop computes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Record {
    /// Index of the output's sample.
    pub sample: u64,
    /// Position of the handle, in counts.
    pub position: Position,
    /// Velocity as the estimator finds it, in 2^-16 counts per sample.
    pub velocity: Velocity,
    /// Force that the output gives, after all ramps and fades. It is 0 while the output is off.
    pub force: Force,
    /// DAC or PWM code that was written to the hardware.
    pub command: OutputCode,
    /// Facts about this output, as bits.
    pub flags: Flags,
    /// Number of the settings in force, modulo 2^16. It counts up with every change.
    pub settings: u16,
    /// Code of the latched fault, or 0 if there is none.
    pub fault: u8,
}

/// A record with its sequence number in the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Number of frames that were made so far, sent or not. It wraps. A gap in these numbers shows that frames were
    /// dropped.
    pub sequence: u32,
    /// Record of the newest output.
    pub record: Record,
}

impl Frame {
    /// First two bytes of every frame.
    pub const MAGIC: [u8; 2] = *b"ZW";
    /// Version of the layout with one output. It is the third byte of a frame.
    pub const VERSION: u8 = 1;
    /// Length of a frame of layout 1, in bytes.
    pub const LEN: usize = 40;
    /// Version of the layout with several outputs.
    pub const VERSION_2: u8 = 2;
    /// Length of the longest frame, in bytes.
    pub const LEN_MAX: usize = 1024;
    /// The largest number of outputs in a frame.
    pub const OUTPUTS: usize = 10;
    /// The largest number of samples whose counts are in a frame.
    pub const SAMPLES: usize = 20;
    /// Number of bytes before the length field. They hold the newest output. `EARLIER` is the number of bytes of each
    /// earlier output.
    const HEAD: usize = 36;
    const EARLIER: usize = 18;
}

impl Record {
    /// A record of a handle at rest at zero, without flags.
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
    /// Writes the frame as bytes of layout 1.
    #[inline]
    pub fn encode(&self) -> [u8; Self::LEN] {
        let mut bytes = [0; Self::LEN];
        let mut rest: &mut [u8] = &mut bytes;
        self.put_head(&mut rest, Self::VERSION);
        let check = bytes.split_last_chunk::<4>().map_or(0, |(body, _)| crc::of_bytes(body));
        if let Some((_, place)) = bytes.split_last_chunk_mut::<4>() {
            *place = check.to_le_bytes();
        }
        bytes
    }

    /// Writes the head, which is the same in both layouts.
    #[inline]
    fn put_head(&self, rest: &mut &mut [u8], version: u8) {
        let record = &self.record;
        put(rest, &Self::MAGIC);
        put(rest, &[version, record.fault]);
        put(rest, &self.sequence.to_le_bytes());
        put(rest, &record.sample.to_le_bytes());
        put(rest, &record.position.counts().to_le_bytes());
        put(rest, &record.velocity.bits().to_le_bytes());
        put(rest, &record.force.bits().to_le_bytes());
        put(rest, &record.command.code().to_le_bytes());
        put(rest, &record.flags.bits().to_le_bytes());
        put(rest, &record.settings.to_le_bytes());
    }

    /// Begins a frame of layout 2. `earlier` are the outputs before this one, oldest first, at most
    /// [`OUTPUTS`](Self::OUTPUTS) - 1. `period` is the number of samples from output to output. All these outputs must
    /// have the settings and the fault of this output.
    pub fn encode_after<'a>(
        &self,
        earlier: &[Record],
        period: u8,
        bytes: &'a mut [u8; Self::LEN_MAX],
    ) -> FrameWriter<'a> {
        let earlier = earlier.get(..Self::OUTPUTS - 1).unwrap_or(earlier);
        let mut rest: &mut [u8] = bytes;
        self.put_head(&mut rest, Self::VERSION_2);
        put(&mut rest, &[0, 0, period, 0]);
        let mut writer = FrameWriter::new(bytes, Self::HEAD + 4);
        if !earlier.is_empty() {
            writer.earlier(earlier);
        }
        writer
    }

    /// Reads a frame from these bytes. Returns `None` if they are no frame of layout 1.
    pub fn decode(bytes: &[u8; Self::LEN]) -> Option<Self> {
        Self::read(bytes).filter(|_| bytes.get(2) == Some(&Self::VERSION))
    }

    /// Reads the newest output of a frame. `bytes` must be the whole frame, because its CRC is checked.
    fn read(bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes;
        if take(&mut rest)? != Self::MAGIC {
            return None;
        }
        let [_, fault] = take(&mut rest)?;
        let (body, check) = bytes.split_last_chunk::<4>()?;
        if crc::of_bytes(body) != u32::from_le_bytes(*check) {
            return None;
        }
        let sequence = u32::from_le_bytes(take(&mut rest)?);
        let sample = u64::from_le_bytes(take(&mut rest)?);
        let record = Record { sample, fault, ..Record::of(&mut rest)? };
        let settings = u16::from_le_bytes(take(&mut rest)?);
        Some(Self { sequence, record: Record { settings, ..record } })
    }
}

impl Record {
    /// Reads the fields that every output of a frame has.
    fn of(rest: &mut &[u8]) -> Option<Self> {
        Some(Self {
            position: Position::from_counts(i32::from_le_bytes(take(rest)?)),
            velocity: Velocity::saturating_from_bits(i32::from_le_bytes(take(rest)?)),
            force: Force::saturating_from_bits(i32::from_le_bytes(take(rest)?)),
            command: OutputCode(i32::from_le_bytes(take(rest)?)),
            flags: Flags::from_bits(u16::from_le_bytes(take(rest)?)),
            ..Self::EMPTY
        })
    }
}

/// Writes `bytes` at the start of `rest`, and moves `rest` behind them.
fn put<const N: usize>(rest: &mut &mut [u8], bytes: &[u8; N]) {
    if let Some((place, behind)) = core::mem::take(rest).split_first_chunk_mut::<N>() {
        *place = *bytes;
        *rest = behind;
    }
}

/// Takes the first bytes of `rest`, and moves `rest` behind them.
fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (bytes, behind) = rest.split_first_chunk::<N>()?;
    *rest = behind;
    Some(*bytes)
}
