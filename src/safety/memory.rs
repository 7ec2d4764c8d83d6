//! The record of the first fault. It is kept in backup RAM, which a reset does not erase.
//!
//! `arm` writes a record with [`Fault::ResetWhileArmed`], because the program could not write one during a reset.
//! `disarm` erases this record, and a fault replaces it. So after any reset the record shows what has happened.

use super::{Fault, FaultSet};
use crate::{
    crc,
    telemetry::Flags,
    units::{Force, Position, Velocity},
};

/// A fault and its circumstances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultRecord {
    /// The first fault.
    pub fault: Fault,
    /// All faults since the first fault, including the first fault.
    pub causes: FaultSet,
    /// Sample of the first fault, counted from the reset before it.
    pub sample: u64,
    /// Position, in counts, at the output that latched the fault.
    pub position: Position,
    /// Velocity at that output, in counts per sample.
    pub velocity: Velocity,
    /// Force that acted until that output.
    pub force: Force,
    /// Flags of the last output before the fault.
    pub flags: Flags,
}

/// A change of the backup RAM that `render` requests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MemoryUpdate {
    /// Write this record.
    Write(FaultRecord),
    /// Write zeros to all words.
    Erase,
}

/// Why the processor starts, from its reset flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power came on, or was too low for the processor.
    Power,
    /// The reset pin, or a debugger.
    Pin,
    /// The watchdog was not fed.
    Watchdog,
    /// The program requested the reset.
    Software,
}

impl FaultRecord {
    /// Number of words of a record. It would also fit into the 20 backup registers of the real-time clock.
    pub const WORDS: usize = 10;
    /// First word of a record: "ZWF" and the version of the layout.
    const HEAD: u32 = u32::from_le_bytes(*b"ZWF\x01");

    /// Makes a record of a fault, without position, force and other circumstances.
    pub fn bare(fault: Fault) -> Self {
        Self {
            fault,
            causes: FaultSet::EMPTY.with(fault),
            sample: 0,
            position: Position::default(),
            velocity: Velocity::ZERO,
            force: Force::ZERO,
            flags: Flags::default(),
        }
    }

    /// Returns a record with the same circumstances and another fault. The handlers of panic and HardFault use it,
    /// because they have only the last record.
    #[must_use]
    pub fn renamed(self, fault: Fault) -> Self {
        Self { fault, causes: self.causes.with(fault), ..self }
    }

    /// The record as words. The last word is a CRC over all other words.
    #[expect(clippy::cast_possible_truncation, reason = "halves of 64-bit words")]
    pub fn to_words(self) -> [u32; Self::WORDS] {
        let [low, high] = [self.sample as u32, (self.sample >> 32) as u32];
        let body = [
            Self::HEAD,
            u32::from(self.fault.code()),
            self.causes.bits(),
            low,
            high,
            self.position.counts().cast_unsigned(),
            self.velocity.bits().cast_unsigned(),
            self.force.bits().cast_unsigned(),
            u32::from(self.flags.bits()),
        ];
        let [a, b, c, d, e, f, g, h, i] = body;
        [a, b, c, d, e, f, g, h, i, crc::of_words(&body)]
    }

    /// Reads a record from these words. Returns `None` if they are no record. After power-up the RAM may hold anything.
    pub fn from_words(words: &[u32; Self::WORDS]) -> Option<Self> {
        let [body @ .., check] = words;
        if crc::of_words(body) != *check {
            return None;
        }
        let [head, code, causes, low, high, position, velocity, force, flags] = *body;
        if head != Self::HEAD {
            return None;
        }
        Some(Self {
            fault: Fault::from_code(u8::try_from(code).ok()?)?,
            causes: FaultSet::from_bits(causes),
            sample: u64::from(low) | u64::from(high) << 32,
            position: Position::from_counts(position.cast_signed()),
            velocity: Velocity::saturating_from_bits(velocity.cast_signed()),
            force: Force::saturating_from_bits(force.cast_signed()),
            flags: Flags::from_bits(u16::try_from(flags).ok()?),
        })
    }
}

/// Returns the fault with which the board starts after a reset. `memory` is the content of the backup RAM.
///
/// A recorded fault stays until `clear`. A watchdog reset is a fault in any case.
pub fn boot_fault(memory: &[u32; FaultRecord::WORDS], reset: ResetCause) -> Option<FaultRecord> {
    match (FaultRecord::from_words(memory), reset) {
        (Some(record), ResetCause::Watchdog) if record.fault == Fault::ResetWhileArmed => {
            Some(FaultRecord {
                fault: Fault::WatchdogReset,
                causes: FaultSet::EMPTY.with(Fault::WatchdogReset),
                ..record
            })
        }
        (Some(record), _) => Some(record),
        (None, ResetCause::Watchdog) => Some(FaultRecord::bare(Fault::WatchdogReset)),
        (None, _) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn record() -> FaultRecord {
        FaultRecord {
            fault: Fault::OverSpeed,
            causes: FaultSet::EMPTY.with(Fault::OverSpeed).with(Fault::HardFault),
            sample: 0x0123_4567_89AB_CDEF,
            position: Position::from_counts(-70_000),
            velocity: Velocity::saturating_from_bits(-123_456),
            force: Force::saturating_from_bits(-(1 << 29)),
            flags: Flags::from_bits(0x1A5),
        }
    }

    #[test]
    fn it_comes_back_whole_and_no_flipped_bit_passes() {
        let words = record().to_words();
        assert_eq!(FaultRecord::from_words(&words), Some(record()));
        for word in 0..words.len() {
            for bit in 0..32 {
                let mut bad = words;
                bad[word] ^= 1 << bit;
                assert_eq!(FaultRecord::from_words(&bad), None, "word {word} bit {bit}");
            }
        }
    }

    /// The handlers of panic and HardFault rename the last record with `renamed`.
    #[test]
    fn under_another_name_it_keeps_its_circumstances_and_causes() {
        let renamed = record().renamed(Fault::Panic);
        let causes = record().causes.with(Fault::Panic);
        assert_eq!(renamed, FaultRecord { fault: Fault::Panic, causes, ..record() });
    }

    #[test]
    fn empty_memory_is_no_record() {
        for fill in [0, u32::MAX, 0xAAAA_AAAA] {
            assert_eq!(FaultRecord::from_words(&[fill; FaultRecord::WORDS]), None);
        }
    }

    #[test]
    fn what_a_reset_leaves_depends_on_its_cause() {
        let none = [0; FaultRecord::WORDS];
        let armed = FaultRecord::bare(Fault::ResetWhileArmed).to_words();
        let fault = record().to_words();
        let code = |memory, reset| boot_fault(memory, reset).map(|record| record.fault);
        assert_eq!(code(&none, ResetCause::Power), None);
        assert_eq!(code(&none, ResetCause::Pin), None);
        assert_eq!(code(&none, ResetCause::Watchdog), Some(Fault::WatchdogReset));
        assert_eq!(code(&armed, ResetCause::Pin), Some(Fault::ResetWhileArmed));
        assert_eq!(code(&armed, ResetCause::Watchdog), Some(Fault::WatchdogReset));
        // If the watchdog reset the board while it was armed, only the watchdog is reported, not the reset.
        let watchdog = FaultRecord::bare(Fault::WatchdogReset);
        assert_eq!(boot_fault(&armed, ResetCause::Watchdog), Some(watchdog));
        for reset in
            [ResetCause::Power, ResetCause::Pin, ResetCause::Watchdog, ResetCause::Software]
        {
            assert_eq!(code(&fault, reset), Some(Fault::OverSpeed));
        }
    }

    proptest! {
        #[test]
        fn arbitrary_words_never_panic(words in any::<[u32; FaultRecord::WORDS]>()) {
            let _ = FaultRecord::from_words(&words);
        }
    }
}
