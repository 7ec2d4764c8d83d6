use super::{record::tests::stored, *};
use embedded_storage::nor_flash::{
    ErrorType, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use std::{vec, vec::Vec};

/// How far the word that was being programmed or erased has come when power is cut.
#[derive(Clone, Copy, Debug)]
enum Cut {
    Before,
    Half,
    After,
}

/// A mock of flash with two sectors. It programs and erases `UNIT` bytes at once, and loses power after a given number
/// of operations.
#[derive(Clone)]
struct Mock<const UNIT: usize = 4, const SECTOR: usize = WORDS> {
    words: Vec<u32>,
    left: Option<usize>,
    cut: Cut,
    used: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Failed {
    PowerLost,
    Refused(NorFlashErrorKind),
}

impl NorFlashError for Failed {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl From<NorFlashErrorKind> for Failed {
    fn from(kind: NorFlashErrorKind) -> Self {
        Self::Refused(kind)
    }
}

/// Words of a sector. It has room for three records, and a rest that is too small for another one.
const WORDS: usize = 3 * RECORD_WORDS + 8;

impl<const UNIT: usize, const SECTOR: usize> Mock<UNIT, SECTOR> {
    fn new() -> Self {
        Self { words: vec![BLANK; 2 * SECTOR], left: None, cut: Cut::After, used: 0 }
    }

    /// Counts an operation. Says whether it is done completely, by half or not at all.
    fn spend(&mut self) -> Result<(), Option<Cut>> {
        self.used += 1;
        match &mut self.left {
            None => Ok(()),
            Some(0) => Err(None),
            Some(1) => {
                self.left = Some(0);
                Err(Some(self.cut))
            }
            Some(left) => {
                *left -= 1;
                Ok(())
            }
        }
    }

    /// Changes the words of one unit from `first` on. `to` gives each word at half of the operation, and at its end.
    fn change(&mut self, first: usize, to: impl Fn(usize, u32) -> [u32; 2]) -> Result<(), Failed> {
        let outcome = self.spend();
        for (n, word) in self.words[first..][..UNIT / 4].iter_mut().enumerate() {
            let [half, full] = to(n, *word);
            match outcome {
                Ok(()) | Err(Some(Cut::After)) => *word = full,
                Err(Some(Cut::Half)) => *word = half,
                Err(Some(Cut::Before) | None) => {}
            }
        }
        outcome.map_err(|_| Failed::PowerLost)
    }
}

impl<const UNIT: usize, const SECTOR: usize> ErrorType for Mock<UNIT, SECTOR> {
    type Error = Failed;
}

impl<const UNIT: usize, const SECTOR: usize> ReadNorFlash for Mock<UNIT, SECTOR> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Failed> {
        check_read(self, offset, bytes.len())?;
        let first = offset as usize / 4;
        for (n, byte) in bytes.iter_mut().enumerate() {
            *byte = self.words[first + n / 4].to_le_bytes()[n % 4];
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        4 * self.words.len()
    }
}

impl<const UNIT: usize, const SECTOR: usize> NorFlash for Mock<UNIT, SECTOR> {
    const WRITE_SIZE: usize = UNIT;
    const ERASE_SIZE: usize = 4 * SECTOR;

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Failed> {
        check_write(self, offset, bytes.len())?;
        let values: Vec<u32> =
            bytes.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        for (n, values) in values.chunks(UNIT / 4).enumerate() {
            // Bits only fall. At a power cut half of them have fallen.
            self.change((offset as usize + n * UNIT) / 4, |n, old| {
                assert_eq!(old, BLANK, "byte {offset} is not erased");
                [old & (values[n] | 0x5A5A_A5A5), old & values[n]]
            })?;
        }
        Ok(())
    }

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Failed> {
        check_erase(self, from, to)?;
        assert_eq!((to - from) as usize, Self::ERASE_SIZE, "one sector at a time");
        // The hardware's order is not known. A stride visits every unit, in a scattered order.
        let units = Self::ERASE_SIZE / UNIT;
        for n in 0..units {
            let first = (from as usize + n * 31 % units * UNIT) / 4;
            self.change(first, |_, old| [old | 0x5A5A_A5A5, BLANK])?;
        }
        Ok(())
    }
}

fn stiffness(loaded: &Loaded) -> f64 {
    loaded.stored.settings.wall.stiffness_n_per_m
}

fn defaults() -> Stored {
    stored(0.0)
}

#[test]
fn the_newest_of_many_saves_comes_back() {
    let mut flash = Mock::<4>::new();
    let empty = load(&mut flash, defaults());
    assert_eq!((stiffness(&empty), empty.source), (0.0, Source::Empty));
    // A sector has three records, so the fifth record is the second one of the second sector.
    for n in 1..if cfg!(miri) { 6 } else { 20 } {
        let record = stored(f64::from(n));
        assert_eq!(save(&mut flash, &record), Ok(Saved::Written));
        assert_eq!(save(&mut flash, &record), Ok(Saved::Unchanged));
        let loaded = load(&mut flash, defaults());
        assert_eq!(loaded.stored, record);
        assert_eq!((loaded.source, loaded.damaged), (Source::Newest, 0));
    }
}

#[test]
#[cfg_attr(miri, ignore = "some ten thousand saves")]
fn a_power_cut_at_any_word_of_a_save_or_erase_loses_nothing() {
    cut_everywhere::<4>();
}

/// Tests power cuts on chips that program two or four words at once.
#[test]
#[cfg_attr(miri, ignore = "some ten thousand saves")]
fn nor_does_one_where_flash_is_programmed_in_wider_units() {
    cut_everywhere::<8>();
    cut_everywhere::<16>();
}

fn cut_everywhere<const UNIT: usize>() {
    let (record, sector) = (4 * RECORD_WORDS / UNIT, 4 * WORDS / UNIT);
    let mut cases = 0;
    // Save 1 is the first one ever. Saves 2 and 3 are within a sector. Saves 4, 7 and 10 first erase the other sector.
    for saves in 1..=10 {
        let mut before = Mock::<UNIT>::new();
        for n in 1..saves {
            save(&mut before, &stored(f64::from(n))).unwrap();
        }
        let (old, new) = (f64::from(saves - 1), f64::from(saves));
        let mut whole = before.clone();
        whole.used = 0;
        save(&mut whole, &stored(new)).unwrap();
        assert_eq!(whole.used, record + if saves % 3 == 1 && saves > 1 { sector } else { 0 });
        for cut in [Cut::Before, Cut::Half, Cut::After] {
            for operations in 1..=whole.used {
                let mut flash = before.clone();
                (flash.left, flash.cut) = (Some(operations), cut);
                assert_eq!(
                    save(&mut flash, &stored(new)),
                    Err(SaveError::Flash(Failed::PowerLost))
                );
                let loaded = load(&mut flash, defaults());
                let complete = operations == whole.used && matches!(cut, Cut::After);
                let expected = if complete { new } else { old };
                // If only half of the last word is written, it may already equal the whole word.
                assert!(
                    stiffness(&loaded) == expected
                        || stiffness(&loaded) == new && operations == whole.used,
                    "save {saves}, cut {cut:?} after {operations}: {loaded:?}"
                );
                // The next two saves work as usual.
                flash.left = None;
                for n in [100.0, 101.0] {
                    assert_eq!(save(&mut flash, &stored(n)), Ok(Saved::Written));
                    let loaded = load(&mut flash, defaults());
                    assert_eq!((stiffness(&loaded), loaded.source), (n, Source::Newest));
                }
                cases += 1;
            }
        }
    }
    assert_eq!(cases, 3 * (10 * record + 3 * sector));
}

/// An estimator with one parameter, four or eight.
#[cfg(feature = "estimators")]
fn of_many_parameters(n: f64) -> Stored {
    use crate::velocity::{EstimatorName, VelocitySettings};
    let mut stored = stored(n);
    let of = |name: EstimatorName| {
        (0..8).fold(name.defaults(), |all, place| all.with_parameter(place, n + place as f64))
    };
    stored.settings.velocity = match n % 3.0 {
        0.0 => VelocitySettings::Butterworth { cutoff_hz: n },
        1.0 => of(EstimatorName::Biquad),
        _ => of(EstimatorName::Biquad2),
    };
    stored
}

/// A further record is written before its main record, and is valid only together with the main record.
#[test]
#[cfg(feature = "estimators")]
#[cfg_attr(miri, ignore = "thousands of saves")]
fn an_estimator_of_many_parameters_comes_back_whole_or_not_at_all() {
    let with = of_many_parameters;
    for saves in 1..12 {
        let mut before = Mock::<4>::new();
        for n in 1..saves {
            assert_eq!(save(&mut before, &with(n.into())), Ok(Saved::Written));
            assert_eq!(save(&mut before, &with(n.into())), Ok(Saved::Unchanged));
            let loaded = load(&mut before, defaults());
            assert_eq!((loaded.stored, loaded.source), (with(n.into()), Source::Newest));
            assert_eq!(loaded.damaged, 0, "after save {n}");
        }
        let old = if saves == 1 { defaults() } else { with(f64::from(saves - 1)) };
        let mut whole = before.clone();
        whole.used = 0;
        save(&mut whole, &with(saves.into())).unwrap();
        for cut in [Cut::Before, Cut::Half, Cut::After] {
            for operations in 1..=whole.used {
                let mut flash = before.clone();
                (flash.left, flash.cut) = (Some(operations), cut);
                save(&mut flash, &with(saves.into())).unwrap_err();
                let loaded = load(&mut flash, defaults()).stored;
                let last = operations == whole.used;
                assert!(
                    loaded == old || last && loaded == with(saves.into()),
                    "save {saves}, cut {cut:?} after {operations}: {loaded:?}"
                );
                flash.left = None;
                for n in [100.0, 101.0, 102.0] {
                    assert_eq!(save(&mut flash, &with(n)), Ok(Saved::Written));
                    let loaded = load(&mut flash, defaults());
                    assert_eq!((loaded.stored, loaded.source), (with(n), Source::Newest));
                }
            }
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "a thousand saves")]
fn two_cuts_one_after_the_other_lose_nothing_either() {
    let mut before = Mock::<4>::new();
    for n in 1..=3 {
        save(&mut before, &stored(f64::from(n))).unwrap();
    }
    let all = WORDS + RECORD_WORDS;
    for first in (1..all).step_by(5) {
        for second in (1..all).step_by(7) {
            let mut flash = before.clone();
            flash.cut = Cut::Half;
            for operations in [first, second] {
                flash.left = Some(operations);
                let _ = save(&mut flash, &stored(4.0));
            }
            assert!([3.0, 4.0].contains(&stiffness(&load(&mut flash, defaults()))));
        }
    }
}

#[test]
fn every_flipped_byte_of_every_record_is_found() {
    const STRIDE: usize = if cfg!(miri) { 200 } else { 1 };
    for saves in 1..=4u8 {
        let mut good = Mock::<4>::new();
        for n in 1..=saves {
            save(&mut good, &stored(f64::from(n))).unwrap();
        }
        // The newest record is the last one of sector A, or the first one of sector B.
        let first = if saves == 4 { WORDS } else { (usize::from(saves) - 1) * RECORD_WORDS };
        for byte in (0..4 * RECORD_WORDS).step_by(STRIDE) {
            for flip in (1..=u8::MAX).step_by(STRIDE) {
                let mut flash = good.clone();
                flash.words[first + byte / 4] ^= u32::from(flip) << (8 * (byte % 4));
                let loaded = load(&mut flash, defaults());
                let expected = if saves == 1 { Source::Defaults } else { Source::Older };
                assert_eq!(loaded.source, expected, "byte {byte} flip {flip:02x}");
                assert_eq!((stiffness(&loaded), loaded.damaged), (f64::from(saves - 1), 1));
            }
        }
    }
}

#[test]
fn damage_in_older_records_is_counted_and_changes_nothing() {
    let mut flash = Mock::<4>::new();
    for n in 1..=2 {
        save(&mut flash, &stored(f64::from(n))).unwrap();
    }
    flash.words[3] ^= 1;
    let loaded = load(&mut flash, defaults());
    assert_eq!((stiffness(&loaded), loaded.source, loaded.damaged), (2.0, Source::Newest, 1));
}

/// The settings are written anew, although they are unchanged. Otherwise every boot would report damaged records.
#[test]
fn the_same_settings_are_written_anew_after_an_erase_that_was_cut_short() {
    let mut flash = Mock::<4>::new();
    for n in 1..=6 {
        save(&mut flash, &stored(f64::from(n))).unwrap();
    }
    (flash.left, flash.cut) = (Some(7), Cut::Half);
    assert!(save(&mut flash, &stored(7.0)).is_err());
    flash.left = None;
    assert_eq!(load(&mut flash, defaults()).source, Source::Older);
    assert_eq!(save(&mut flash, &stored(6.0)), Ok(Saved::Written));
    assert_eq!(load(&mut flash, defaults()).source, Source::Newest);
    assert_eq!(save(&mut flash, &stored(6.0)), Ok(Saved::Unchanged));
}

#[test]
fn what_another_program_has_left_is_nothing_saved_and_does_not_stay() {
    // The words are in both sectors, in the first, in the second, or at the end of the second.
    for (from, to) in [(0, 2 * WORDS), (0, WORDS), (WORDS, 2 * WORDS), (2 * WORDS - 10, 2 * WORDS)]
    {
        for word in [0x1234_5678, 0] {
            let mut flash = Mock::<4>::new();
            flash.words[from..to].fill(word);
            let loaded = load(&mut flash, defaults());
            assert_eq!((loaded.stored, loaded.source), (defaults(), Source::Empty));
            assert_eq!(save(&mut flash, &stored(5.0)), Ok(Saved::Written));
            let loaded = load(&mut flash, defaults());
            assert_eq!((stiffness(&loaded), loaded.source), (5.0, Source::Newest));
            assert_eq!(loaded.damaged, 0, "{from}..{to}");
        }
    }
}

/// One sector has words of another program. The other sector has our own records, and the newest of these records is
/// used.
#[test]
fn nor_is_it_damage_beside_what_was_saved() {
    let mut flash = Mock::<4>::new();
    save(&mut flash, &stored(5.0)).unwrap();
    flash.words[WORDS..].fill(0x1234_5678);
    let loaded = load(&mut flash, defaults());
    assert_eq!((stiffness(&loaded), loaded.source), (5.0, Source::Newest));
    for n in 6..=9 {
        assert_eq!(save(&mut flash, &stored(f64::from(n))), Ok(Saved::Written));
        let loaded = load(&mut flash, defaults());
        assert_eq!((stiffness(&loaded), loaded.source), (f64::from(n), Source::Newest));
    }
    assert_eq!(load(&mut flash, defaults()).damaged, 0);
}

/// A valid record of another layout, or with an estimator that this image lacks, is no damage. Another image has
/// written it.
#[test]
fn a_whole_record_of_another_image_is_nothing_saved() {
    for (place, word) in [(0, u32::from_le_bytes(*b"ZWS\x06")), (7, 0xEE00), (7, 28 << 8)] {
        let mut flash = Mock::<4>::new();
        save(&mut flash, &stored(5.0)).unwrap();
        flash.words[place] = word;
        flash.words[RECORD_WORDS - 1] = crate::crc::of_words(&flash.words[..RECORD_WORDS - 1]);
        let loaded = load(&mut flash, defaults());
        assert_eq!((loaded.stored, loaded.source), (defaults(), Source::Empty), "{place}");
    }
}

/// A record with any wrong byte counts as damage.
#[test]
fn a_record_that_cannot_be_read_is_damage() {
    for head in [*b"ZWS\x06", *b"ZWS\x04", *b"ZWS\x01", *b"XWS\x05", *b"ZWP\x03"] {
        let mut flash = Mock::<4>::new();
        save(&mut flash, &stored(5.0)).unwrap();
        flash.words[0] = u32::from_le_bytes(head);
        let loaded = load(&mut flash, defaults());
        assert_eq!((loaded.stored, loaded.source), (defaults(), Source::Defaults), "{head:?}");
    }
    for head in [*b"XWT\x05", *b"XWS\x06"] {
        let mut flash = Mock::<4>::new();
        save(&mut flash, &stored(5.0)).unwrap();
        flash.words[0] = u32::from_le_bytes(head);
        assert_eq!(load(&mut flash, defaults()).source, Source::Empty, "{head:?}");
    }
}

/// Reads the words that are written now, and the words that version 0.1.0 wrote. A device with a device record does not
/// use the settings of 0.1.0.
#[test]
fn a_record_in_flash_is_its_words_least_significant_byte_first() {
    let mut flash = Mock::<4>::new();
    save(&mut flash, &stored(8000.0)).unwrap();
    let bytes: Vec<u8> = flash.words[..RECORD_WORDS].iter().flat_map(|w| w.to_le_bytes()).collect();
    assert_eq!(&bytes[..20], b"ZWS\x05\x01\0\0\0paper-1um\0\0\0");
    assert_eq!(flash.words[12..14], [0, 0x40BF_4000]); // K as a double
    assert_eq!(flash.words[RECORD_WORDS - 2], 10);
    let (estimator, flags) = (flash.words[7] >> 8, flash.words[7] & 0xFF);
    flash.words[0] = u32::from_le_bytes(*b"ZWS\x02");
    flash.words[6..8].copy_from_slice(&[estimator, flags]);
    flash.words[RECORD_WORDS - 2..RECORD_WORDS].copy_from_slice(&[0, 0xC69D_7E96]);
    let of_none = |k| Stored { device: DeviceKey::of("paper-1um"), ..stored(k) };
    let loaded = load(&mut flash, of_none(0.0));
    assert_eq!((loaded.stored, loaded.source), (of_none(8000.0), Source::Newest));
    let loaded = load(&mut flash, stored(0.0));
    assert_eq!((loaded.stored, loaded.source), (stored(0.0), Source::OtherDevice));
}

/// A slot that cannot be read counts as damaged. Nothing else is lost.
#[test]
fn flash_that_cannot_be_read_gives_the_defaults() {
    let mut small = Mock::<4>::new();
    small.words.truncate(WORDS);
    let loaded = load(&mut small, defaults());
    assert_eq!((loaded.stored, loaded.source, loaded.damaged), (defaults(), Source::Defaults, 3));
    assert_eq!(save(&mut small, &stored(1.0)), Err(SaveError::TooSmall));
}

#[test]
fn two_sectors_of_one_record_each_are_enough_and_a_word_less_is_too_little() {
    let mut enough = Mock::<4, RECORD_WORDS>::new();
    for n in 1..=3 {
        assert_eq!(save(&mut enough, &stored(f64::from(n))), Ok(Saved::Written));
        assert_eq!(stiffness(&load(&mut enough, defaults())), f64::from(n));
    }
    let mut smaller = Mock::<4, { RECORD_WORDS - 1 }>::new();
    assert_eq!(save(&mut smaller, &stored(1.0)), Err(SaveError::TooSmall));
    let mut shorter = Mock::<4>::new();
    shorter.words.pop();
    assert_eq!(save(&mut shorter, &stored(1.0)), Err(SaveError::TooSmall));
}

/// Without room for a main record and its further record, such settings cannot be saved.
#[test]
#[cfg(feature = "estimators")]
fn an_estimator_of_many_parameters_needs_room_for_two_records() {
    let stored = of_many_parameters(1.0);
    let mut smaller = Mock::<4, RECORD_WORDS>::new();
    assert_eq!(save(&mut smaller, &stored), Err(SaveError::TooSmall));
    let mut enough = Mock::<4, { 2 * RECORD_WORDS }>::new();
    for n in 1..=3 {
        let stored = of_many_parameters(f64::from(n));
        assert_eq!(save(&mut enough, &stored), Ok(Saved::Written));
        assert_eq!(load(&mut enough, defaults()).stored, stored);
    }
}

#[test]
#[cfg(feature = "estimators")]
fn further_parameters_of_another_save_are_none() {
    let stored = of_many_parameters(1.0);
    for (number, source) in [(7, Source::Newest), (6, Source::Defaults), (8, Source::Defaults)] {
        let mut flash = Mock::<4>::new();
        let further = stored.further_to_words(number).unwrap();
        flash.words[..RECORD_WORDS].copy_from_slice(&further);
        flash.words[RECORD_WORDS..2 * RECORD_WORDS].copy_from_slice(&stored.to_words(7));
        assert_eq!(load(&mut flash, defaults()).source, source, "{number}");
    }
}

/// Two records normally never have the same sequence number, because it takes 2^32 saves until it comes again.
#[test]
fn of_two_sectors_with_the_same_number_the_first_counts() {
    let mut flash = Mock::<4>::new();
    for (first, k) in [(0, 1.0), (WORDS, 2.0)] {
        flash.words[first..][..RECORD_WORDS].copy_from_slice(&stored(k).to_words(7));
    }
    assert_eq!(stiffness(&load(&mut flash, defaults())), 1.0);
}

/// A NaN would never equal its copy.
#[test]
fn a_number_that_is_none_is_not_taken() {
    let mut flash = Mock::<4>::new();
    save(&mut flash, &Stored { push_n: f64::NAN, ..stored(5.0) }).unwrap();
    let loaded = load(&mut flash, defaults());
    assert_eq!((loaded.stored, loaded.source), (defaults(), Source::Unusable));
}
