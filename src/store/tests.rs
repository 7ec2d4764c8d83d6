use super::{record::tests::stored, *};
use std::{vec, vec::Vec};

/// How a cut leaves the word that was being programmed or erased.
#[derive(Clone, Copy, Debug)]
enum Cut {
    Before,
    Half,
    After,
}

/// Flash that loses power after a number of word operations.
#[derive(Clone)]
struct Mock {
    sectors: [Vec<u32>; 2],
    left: Option<usize>,
    cut: Cut,
    used: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct PowerLost;

/// Three records and a rest that no record fits into.
const WORDS: usize = 3 * RECORD_WORDS + 5;

impl Mock {
    fn new() -> Self {
        Self {
            sectors: [vec![BLANK; WORDS], vec![BLANK; WORDS]],
            left: None,
            cut: Cut::After,
            used: 0,
        }
    }

    /// Whether the next operation is complete, half done or not done at all.
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

    fn change(
        &mut self,
        sector: Sector,
        word: usize,
        half: u32,
        full: u32,
    ) -> Result<(), PowerLost> {
        let outcome = self.spend();
        let place = &mut self.sectors[sector as usize][word];
        match outcome {
            Ok(()) | Err(Some(Cut::After)) => *place = full,
            Err(Some(Cut::Half)) => *place = half,
            Err(Some(Cut::Before) | None) => {}
        }
        outcome.map_err(|_| PowerLost)
    }
}

impl Flash for Mock {
    type Error = PowerLost;

    fn sector_words(&self) -> usize {
        WORDS
    }

    fn read(&self, sector: Sector, word: usize) -> u32 {
        self.sectors[sector as usize].get(word).copied().unwrap_or(BLANK)
    }

    fn program(&mut self, sector: Sector, word: usize, value: u32) -> Result<(), PowerLost> {
        let old = self.read(sector, word);
        assert_eq!(old, BLANK, "{sector:?} {word} is not erased");
        // Bits only fall; half of them have when the power goes.
        self.change(sector, word, old & (value | 0x5A5A_A5A5), old & value)
    }

    fn erase(&mut self, sector: Sector) -> Result<(), PowerLost> {
        // The order is the hardware's; a stride visits every word in a scattered one.
        for n in 0..WORDS {
            let word = n * 31 % WORDS;
            let old = self.read(sector, word);
            self.change(sector, word, old | 0x5A5A_A5A5, BLANK)?;
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
    let mut flash = Mock::new();
    let empty = load(&flash, defaults());
    assert_eq!((stiffness(&empty), empty.source), (0.0, Source::Empty));
    // The fifth is the second of the second sector.
    for n in 1..if cfg!(miri) { 6 } else { 20 } {
        let record = stored(f64::from(n));
        assert_eq!(save(&mut flash, &record), Ok(Saved::Written));
        assert_eq!(save(&mut flash, &record), Ok(Saved::Unchanged));
        let loaded = load(&flash, defaults());
        assert_eq!(loaded.stored, record);
        assert_eq!((loaded.source, loaded.damaged), (Source::Newest, 0));
    }
}

#[test]
#[cfg_attr(miri, ignore = "some ten thousand saves")]
fn a_power_cut_at_any_word_of_a_save_or_erase_loses_nothing() {
    let mut cases = 0;
    // 1: first save ever; 2, 3: within a sector; 4, 7, 10: with an erase of the other one
    for saves in 1..=10 {
        let mut before = Mock::new();
        for n in 1..saves {
            save(&mut before, &stored(f64::from(n))).unwrap();
        }
        let (old, new) = (f64::from(saves - 1), f64::from(saves));
        let mut whole = before.clone();
        whole.used = 0;
        save(&mut whole, &stored(new)).unwrap();
        assert_eq!(whole.used, RECORD_WORDS + if saves % 3 == 1 && saves > 1 { WORDS } else { 0 });
        for cut in [Cut::Before, Cut::Half, Cut::After] {
            for operations in 1..=whole.used {
                let mut flash = before.clone();
                (flash.left, flash.cut) = (Some(operations), cut);
                assert_eq!(save(&mut flash, &stored(new)), Err(SaveError::Flash(PowerLost)));
                let loaded = load(&flash, defaults());
                let complete = operations == whole.used && matches!(cut, Cut::After);
                let expected = if complete { new } else { old };
                // half of the last word may happen to be all of it
                assert!(
                    stiffness(&loaded) == expected
                        || stiffness(&loaded) == new && operations == whole.used,
                    "save {saves}, cut {cut:?} after {operations}: {loaded:?}"
                );
                // and the next save works as if nothing had happened, twice
                flash.left = None;
                for n in [100.0, 101.0] {
                    assert_eq!(save(&mut flash, &stored(n)), Ok(Saved::Written));
                    let loaded = load(&flash, defaults());
                    assert_eq!((stiffness(&loaded), loaded.source), (n, Source::Newest));
                }
                cases += 1;
            }
        }
    }
    assert_eq!(cases, 3 * (10 * RECORD_WORDS + 3 * WORDS));
}

#[test]
#[cfg_attr(miri, ignore = "a thousand saves")]
fn two_cuts_one_after_the_other_lose_nothing_either() {
    let mut before = Mock::new();
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
            assert!([3.0, 4.0].contains(&stiffness(&load(&flash, defaults()))));
        }
    }
}

#[test]
fn every_flipped_byte_of_every_record_is_found() {
    const STRIDE: usize = if cfg!(miri) { 200 } else { 1 };
    for saves in 1..=4u8 {
        let mut good = Mock::new();
        for n in 1..=saves {
            save(&mut good, &stored(f64::from(n))).unwrap();
        }
        // the newest record: the last of A, or the first of B
        let (sector, slot) =
            if saves == 4 { (Sector::B, 0) } else { (Sector::A, usize::from(saves) - 1) };
        for byte in (0..4 * RECORD_WORDS).step_by(STRIDE) {
            for flip in (1..=u8::MAX).step_by(STRIDE) {
                let mut flash = good.clone();
                let word = &mut flash.sectors[sector as usize][slot * RECORD_WORDS + byte / 4];
                *word ^= u32::from(flip) << (8 * (byte % 4));
                let loaded = load(&flash, defaults());
                let expected = if saves == 1 { Source::Defaults } else { Source::Older };
                assert_eq!(loaded.source, expected, "byte {byte} flip {flip:02x}");
                assert_eq!((stiffness(&loaded), loaded.damaged), (f64::from(saves - 1), 1));
            }
        }
    }
}

#[test]
fn damage_in_older_records_is_counted_and_changes_nothing() {
    let mut flash = Mock::new();
    for n in 1..=2 {
        save(&mut flash, &stored(f64::from(n))).unwrap();
    }
    flash.sectors[0][3] ^= 1;
    let loaded = load(&flash, defaults());
    assert_eq!((stiffness(&loaded), loaded.source, loaded.damaged), (2.0, Source::Newest, 1));
}

#[test]
fn a_store_full_of_garbage_gives_the_defaults_and_can_be_used_again() {
    let mut flash = Mock::new();
    for word in flash.sectors.iter_mut().flatten() {
        *word = 0x1234_5678;
    }
    let loaded = load(&flash, defaults());
    assert_eq!((loaded.stored, loaded.source), (defaults(), Source::Defaults));
    assert_eq!(save(&mut flash, &stored(5.0)), Ok(Saved::Written));
    assert_eq!(stiffness(&load(&flash, defaults())), 5.0);
}
