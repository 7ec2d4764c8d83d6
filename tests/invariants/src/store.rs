//! Properties of the settings in flash, if the power may be cut at any time.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use proptest::prelude::*;
use zwidth::{
    Settings, WallSettings,
    experiment::{Criterion, WalkSettings},
    store::{DeviceKey, RECORD_WORDS, Saved, Signs, Source, Stored, load, save},
    velocity::EstimatorName,
};

use crate::any::{Random, noticed};

const RECORD_BYTES: usize = 4 * RECORD_WORDS;
/// Size of a sector. It has room for three records, and a remainder that is too small for a record.
const SECTOR_BYTES: usize = 3 * RECORD_BYTES + 32;

/// Flash that programs `UNIT` bytes at once. After a power cut, each bit of the unit that was being programmed or
/// erased has its old or its new value.
#[derive(Clone)]
struct Flash<const UNIT: usize> {
    bytes: Vec<u8>,
    /// Number of units that can be written or erased before the power is cut.
    left: Option<u32>,
    torn: Random,
}

#[derive(Debug)]
struct PowerLost;

impl NorFlashError for PowerLost {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl From<NorFlashErrorKind> for PowerLost {
    fn from(kind: NorFlashErrorKind) -> Self {
        panic!("{kind:?}: the store asks for what flash cannot do")
    }
}

impl<const UNIT: usize> Flash<UNIT> {
    /// Flash that is erased. A part of each sector may have foreign data.
    fn left_by_others(remains: [Option<(usize, usize)>; 2], seed: u64) -> Self {
        let mut torn = Random(seed);
        let mut bytes = vec![0xFF; 2 * SECTOR_BYTES];
        for (sector, part) in bytes.chunks_mut(SECTOR_BYTES).zip(remains) {
            let (first, length) = part.unwrap_or_default();
            sector.iter_mut().skip(first).take(length).for_each(|byte| *byte = torn.bits() as u8);
        }
        Self { bytes, left: None, torn }
    }

    fn change(&mut self, first: usize, to: &[u8]) -> Result<(), PowerLost> {
        let whole = match &mut self.left {
            Some(0) => return Err(PowerLost),
            Some(left) => {
                *left -= 1;
                *left > 0
            }
            None => true,
        };
        for (place, to) in self.bytes[first..].iter_mut().zip(to) {
            let done = if whole { 0xFF } else { self.torn.bits() as u8 };
            *place = *place & !done | to & done;
        }
        if whole { Ok(()) } else { Err(PowerLost) }
    }
}

impl<const UNIT: usize> ErrorType for Flash<UNIT> {
    type Error = PowerLost;
}

impl<const UNIT: usize> ReadNorFlash for Flash<UNIT> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerLost> {
        check_read(self, offset, bytes.len())?;
        bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const UNIT: usize> NorFlash for Flash<UNIT> {
    const WRITE_SIZE: usize = UNIT;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerLost> {
        check_write(self, offset, bytes.len())?;
        for (n, unit) in bytes.chunks(UNIT).enumerate() {
            let first = offset as usize + n * UNIT;
            let blank = self.bytes[first..][..UNIT].iter().all(|byte| *byte == 0xFF);
            assert!(blank, "byte {first} is written twice without an erase");
            self.change(first, unit)?;
        }
        Ok(())
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerLost> {
        check_erase(self, from, to)?;
        let mut units: Vec<usize> = (from as usize..to as usize).step_by(UNIT).collect();
        // The units come in random order.
        for n in (1..units.len()).rev() {
            let other = self.torn.below(n as u64 + 1) as usize;
            units.swap(n, other);
        }
        units.into_iter().try_for_each(|first| self.change(first, &[0xFF; UNIT]))
    }
}

fn stored(number: f64, name: EstimatorName, flags: [bool; 3]) -> Stored {
    Stored {
        device: DeviceKey::of("bench"),
        settings: Settings {
            // Only records of these two estimators have the last parameter.
            velocity: match name {
                EstimatorName::Biquad => name.defaults().with_parameter(3, number),
                EstimatorName::Biquad2 => name.defaults().with_parameter(7, number),
                _ => name.defaults(),
            },
            wall: WallSettings {
                position_m: number,
                stiffness_n_per_m: -number,
                damping_n_s_per_m: 2.0 * number,
                push_only: flags[0],
            },
        },
        period: 1 + number.to_bits() as u32 % 10,
        push_n: number,
        signs: Signs { motor_reversed: flags[1], encoder_reversed: flags[2] },
        start_m: number,
        settle_s: number,
        window_s: number,
        rms_limit_m: number,
        criterion: if flags[1] { Criterion::Quiet } else { Criterion::Rms },
        force_rms_limit_n: flags[2].then_some(number),
        full_scale_n: number,
        grid: WalkSettings {
            stiffness_start_n_per_m: number,
            stiffness_step_n_per_m: number,
            stiffness_max_n_per_m: number,
            damping_start_n_s_per_m: number,
            damping_step_n_s_per_m: number,
            damping_max_n_s_per_m: number,
        },
    }
}

/// A save. The first value is its number. The second is the number of units before a power cut, if there is one.
type Step = (u16, Option<u32>);

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let cut = prop::option::of(1u32..(2 * RECORD_BYTES + SECTOR_BYTES) as u32 / 4);
    // Early cuts are more frequent, since a record has few wide units.
    let cut = prop_oneof![2 => cut, 1 => prop::option::of(1u32..50)];
    prop::collection::vec((0u16..50, cut), 1..25)
}

/// Draws the contents of the sectors before the first save. A sector is empty, or has bytes that are no record.
fn remains() -> impl Strategy<Value = [Option<(usize, usize)>; 2]> {
    let part = (0..SECTOR_BYTES, 1..SECTOR_BYTES);
    let sector = prop_oneof![2 => Just(None), 1 => part.prop_map(Some)];
    [sector.clone(), sector]
}

fn survives<const UNIT: usize>(remains: [Option<(usize, usize)>; 2], steps: &[Step], seed: u64) {
    let mut flash = Flash::<UNIT>::left_by_others(remains, seed);
    let defaults = stored(-1.0, EstimatorName::Difference, [false; 3]);
    // The allowed contents. After a cut, there are two.
    let mut may = vec![defaults];
    let (mut saved, names) = (false, EstimatorName::ALL);
    for (number, cut) in steps {
        let name = names[usize::from(*number) % names.len()];
        let record = stored(f64::from(*number), name, [number % 2 == 0, number % 3 == 0, number % 5 == 0]);
        flash.left = *cut;
        match save(&mut flash, &record) {
            Ok(done) => {
                let same = may.len() == 1 && may[0] == record && saved;
                assert!(done == Saved::Written || may.contains(&record) && saved, "nothing was written");
                assert!(!same || done == Saved::Unchanged || flash.left.is_some() || cut.is_none());
                (may, saved) = (vec![record], true);
            }
            Err(_) => may.push(record),
        }
        flash.left = None;
        let loaded = load(&mut flash, defaults);
        assert!(may.contains(&loaded.stored), "{:?} is none of {may:?}", loaded);
        if may.len() == 1 && saved {
            assert_eq!(loaded.source, Source::Newest);
        }
        if loaded.stored != defaults {
            assert!(matches!(loaded.source, Source::Newest | Source::Older));
            // The contents do not change any more: the interrupted record is complete, or it is lost for ever.
            may = vec![loaded.stored];
            saved = true;
        } else if !saved {
            may = vec![defaults];
        }
    }
}

crate::properties! {
    /// The power is cut at any unit of a write or an erase, with torn bits. Then the settings are those of the last
    /// save or of the interrupted save. The next save works and is the newest. This holds for any contents of the
    /// sectors, and for flash that programs 4, 8 or 16 bytes at once.
    power_cuts(60, (remains, steps, seed, unit) in (remains(), steps(), any::<u64>(), 0u8..3)) {
        match unit {
            0 => survives::<4>(remains, &steps, seed),
            1 => survives::<8>(remains, &steps, seed),
            _ => survives::<16>(remains, &steps, seed),
        }
    }

    /// A record with any numbers is read back bit for bit. After a change of one word, or of up to three bits, the
    /// record is not read, because a CRC-32 always detects these changes.
    records(500, (number, place, flags, sequence, flips) in (
        any::<f64>(),
        any::<prop::sample::Index>(),
        any::<[bool; 3]>(),
        any::<u32>(),
        noticed(RECORD_WORDS),
    )) {
        let names = EstimatorName::ALL;
        let name = names[place.index(names.len())];
        let record = stored(number, name, flags);
        let words = record.to_words(sequence);
        let (back, of) = Stored::from_words(&words).unwrap();
        assert_eq!((back, of.to_words(back)), (sequence, words));
        if name.parameters()[2].is_none() {
            assert_eq!(of.settings.velocity, record.settings.velocity);
        }
        assert_eq!((of.signs, of.settings.wall.push_only), (record.signs, flags[0]));
        assert_eq!(of.settings.wall.stiffness_n_per_m.to_bits(), (-number).to_bits());
        let mut other = words;
        for (word, flip) in flips {
            other[word] ^= flip;
        }
        assert_eq!(Stored::from_words(&other).is_some(), other == words);
    }
}
