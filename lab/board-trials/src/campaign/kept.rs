//! Damages data that survives a reset or a loss of supply: the backup RAM, and the settings in flash. Power cuts during
//! a save are included. The force is off at the start and must stay off. The board must then use the default settings,
//! or settings that were saved.

use virtual_board::{
    board::{Board, Powered},
    device::built_in,
    mcu::Mcu,
    session::{Failed, ask},
    world::World,
};
use zwidth::{
    Settings, VelocitySettings, WallSettings,
    store::{RECORD_WORDS, Stored},
};

use super::row::Row;
use crate::random::Random;

/// Start of the flash sectors 1 and 2, which store the settings. Each sector has 16 KiB.
const SECTOR_A: u32 = 0x0800_4000;
const SECTOR_B: u32 = 0x0800_8000;
const SECTOR_WORDS: usize = 4096;
/// Start of the backup RAM, which has 4 KiB.
pub(super) const BACKUP: u32 = 0x4002_4000;
const BACKUP_WORDS: u32 = 1024;
/// Number of random contents that are tried for each memory.
const RANDOM: usize = 16;
/// Number of samples after which the board has booted. With any contents of flash, the boot takes 12 ms at most.
const BOOT: u64 = 150;

const NO_FAULT: &str = "ok status off, fault none";
const NOT_VALID: &str = "ok status fault, fault 40 (settings)";

pub(super) fn kept_rows() -> Vec<Row> {
    vec![
        Row::keeping("settings: each byte flipped", |world| flip_every_byte(world, 1)),
        Row::keeping("settings: power cut at each word of a save", |world| {
            cut_every_word(world, 1)
        }),
        Row::keeping("settings: power cut in an erase", cut_an_erase),
        Row::keeping("settings: numbers that are not allowed", take_what_is_not_allowed),
        Row::keeping("settings: flash at random", fill_the_flash),
        Row::keeping("backup RAM at random", fill_the_backup),
    ]
}

fn stored(board: Board, stiffness_n_per_m: f64) -> Stored {
    Stored {
        settings: Settings {
            velocity: VelocitySettings::Butterworth { cutoff_hz: 1200.0 },
            wall: WallSettings {
                position_m: 0.003,
                stiffness_n_per_m,
                damping_n_s_per_m: 5.0,
                push_only: true,
            },
        },
        ..built_in(board).defaults()
    }
}

/// A settings record of this board's device, with this stiffness.
fn record(world: &World<'_>, sequence: u32, stiffness_n_per_m: f64) -> [u32; RECORD_WORDS] {
    stored(world.powered.board, stiffness_n_per_m).to_words(sequence)
}

/// The board's replies after a boot.
struct Booted {
    /// The reply that says where the settings come from.
    loaded: String,
    stiffness: String,
    status: String,
}

impl Booted {
    fn expect(self, case: &str, right: impl FnOnce(&Self) -> bool) -> Result<(), Failed> {
        if right(&self) {
            return Ok(());
        }
        let Self { loaded, stiffness, status } = self;
        Err(Failed::Refused(format!("{case}: {loaded}; {stiffness}; {status}")))
    }
}

/// Writes the words of `pieces` into the erased sectors of the settings, and switches the supply off and on.
fn boot(world: &mut World<'_>, pieces: &[(u32, &[u32])]) -> Result<Booted, Failed> {
    for sector in [SECTOR_A, SECTOR_B] {
        world.powered.mcu.program(sector, &[0xFF; 4 * SECTOR_WORDS]);
    }
    for (address, words) in pieces {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        world.powered.mcu.program(*address, &bytes);
    }
    world.power_cycle();
    booted(world)
}

/// Waits for the boot and asks the board for its settings. Fails if the force was on.
fn booted(world: &mut World<'_>) -> Result<Booted, Failed> {
    world.replies.clear();
    world.seen = Some(Vec::new());
    world.run(BOOT)?;
    let loaded = world.replies.lines().find(|line| line.contains("load")).unwrap_or_default();
    let loaded = loaded.to_owned();
    let get = ask(world, "get")?;
    let stiffness = get.strip_prefix("ok get ").and_then(|rest| rest.split(',').next());
    let stiffness = stiffness.unwrap_or_default().to_owned();
    let status = ask(world, "status")?;
    let seen = world.seen.take().unwrap_or_default();
    let was_on = world.powered.amplifier.changes().disabled_at.is_some();
    if was_on || seen.iter().any(|seen| seen.enabled || seen.force != 0.0) {
        return Err(Failed::Refused(format!("{loaded}; {status}: the force was on")));
    }
    Ok(Booted { loaded, stiffness, status })
}

/// Flips all bits of each byte of the newest record. Each flip is tried twice: with an older record in flash, and
/// without one.
///
/// # Errors
/// The board uses settings that are neither the older ones nor the defaults, or the board does not report the damage.
pub fn flip_every_byte(world: &mut World<'_>, step: usize) -> Result<usize, Failed> {
    let (older, newest) = (record(world, 1, 1000.0), record(world, 2, 2000.0));
    let both = |newest: &[u32]| older.iter().chain(newest).copied().collect::<Vec<_>>();
    boot(world, &[(SECTOR_A, &both(&newest))])?.expect("whole", |it| {
        it.loaded == "ok load: newest settings" && it.stiffness == "k 2000 N/m"
    })?;
    let bytes: Vec<usize> = (0..4 * RECORD_WORDS).step_by(step).collect();
    for byte in &bytes {
        let mut bad = newest;
        bad[byte / 4] ^= 0xFF << (8 * (byte % 4));
        let case = format!("byte {byte}");
        boot(world, &[(SECTOR_A, &both(&bad))])?.expect(&case, |it| {
            let says = it.loaded.starts_with("ok load: older settings");
            says && it.stiffness == "k 1000 N/m" && it.status.contains(NO_FAULT)
        })?;
        if byte % 8 == 0 {
            boot(world, &[(SECTOR_A, &bad)])?.expect(&case, Booted::has_defaults)?;
        }
    }
    Ok(bytes.len())
}

impl Booted {
    fn has_defaults(&self) -> bool {
        let says = self.loaded.starts_with("ok load: defaults");
        says && self.stiffness == "k 0 N/m" && self.status.contains(NO_FAULT)
    }
}

/// Cuts the power during a save: before, during and after each word that the board writes.
///
/// # Errors
/// After the cut, the board uses settings that are neither the older ones nor the newer ones.
pub fn cut_every_word(world: &mut World<'_>, step: usize) -> Result<usize, Failed> {
    let older = record(world, 1, 1000.0);
    let states = save(world, &older)?;
    if states.len() != RECORD_WORDS + 1 {
        let text = format!("{} states of a save, words {RECORD_WORDS}", states.len());
        return Err(Failed::Refused(text));
    }
    let newest = states[RECORD_WORDS];
    let mut cuts: Vec<(usize, [u32; RECORD_WORDS])> = Vec::new();
    for (n, state) in states.iter().enumerate().step_by(step) {
        cuts.push((n, *state));
        if n < RECORD_WORDS {
            // Some bits of the word that is being programmed are already 0.
            for bits in [0xFFFF_0000, 0x0F0F_5A5A] {
                let mut half = *state;
                half[n] &= newest[n] | bits;
                cuts.push((n, half));
            }
        }
    }
    for (n, state) in &cuts {
        let words: Vec<u32> = older.iter().chain(state).copied().collect();
        boot(world, &[(SECTOR_A, &words)])?.expect(&format!("cut at word {n}"), |it| {
            let right = if *state == newest {
                it.loaded == "ok load: newest settings" && it.stiffness == "k 2500 N/m"
            } else {
                it.stiffness == "k 1000 N/m"
            };
            right && it.status.contains(NO_FAULT)
        })?;
    }
    Ok(cuts.len())
}

/// Lets the board save its settings. Returns the words at the address of the new record, as they are before the first
/// store and after each store.
fn save(
    world: &mut World<'_>,
    older: &[u32; RECORD_WORDS],
) -> Result<Vec<[u32; RECORD_WORDS]>, Failed> {
    boot(world, &[(SECTOR_A, older)])?;
    let before = world.snapshot();
    ask(world, "unlock envelope")?;
    ask(world, "k 2500")?;
    world.send("save\n")?;
    let Powered { mcu, .. } = &mut world.powered;
    let place = (SECTOR_A - 0x0800_0000) as usize + 4 * RECORD_WORDS;
    let look = |mcu: &Mcu| {
        let flash = mcu.flash();
        let words = flash[place..place + 4 * RECORD_WORDS].as_chunks::<4>().0;
        std::array::from_fn(|n| u32::from_le_bytes(words[n]))
    };
    let mut states: Vec<[u32; RECORD_WORDS]> = vec![look(mcu)];
    let limit = mcu.now() + mcu.core_hz() / 20;
    while states.len() <= RECORD_WORDS && mcu.now() < limit {
        mcu.run_until(mcu.now() + 1000).map_err(virtual_board::world::Ended::from)?;
        let state = look(mcu);
        if states.last() != Some(&state) {
            states.push(state);
        }
    }
    world.restore(&before); // the chip is ahead of the plant
    Ok(states)
}

/// Cuts the power while the board erases a sector. Before a save, the board erases the sector that does not hold the
/// newest record. So a cut damages only this sector.
///
/// # Errors
/// After the cut the board does not use the newest settings.
pub fn cut_an_erase(world: &mut World<'_>) -> Result<usize, Failed> {
    let records = u32::try_from(SECTOR_WORDS / RECORD_WORDS).unwrap_or_default();
    let full: Vec<u32> = (0..records)
        .flat_map(|n| record(world, 200 + n, if n + 1 < records { 700.0 } else { 1000.0 }))
        .collect();
    let old: Vec<u32> = (0..records).flat_map(|n| record(world, 1 + n, 500.0)).collect();
    let cuts: [fn(u32, u32) -> u32; 4] = [
        |_, word| word,
        |n, word| if n < 2000 { u32::MAX } else { word },
        |n, word| word | (0x9E37_79B9u32.wrapping_mul(n)),
        |_, _| u32::MAX,
    ];
    for cut in &cuts {
        let rest: Vec<u32> = (0..).zip(&old).map(|(n, &word)| cut(n, word)).collect();
        boot(world, &[(SECTOR_A, &full), (SECTOR_B, &rest)])?.expect("cut in an erase", |it| {
            it.stiffness == "k 1000 N/m" && it.status.contains(NO_FAULT)
        })?;
    }
    Ok(cuts.len())
}

/// Stores a whole record with one invalid value. If the value belongs to the control loop, the board must use the
/// defaults and report this. If the value belongs to an experiment, the board may use the other settings of the record,
/// but must refuse the experiment.
///
/// # Errors
/// The board uses settings that this rule does not allow.
pub fn take_what_is_not_allowed(world: &mut World<'_>) -> Result<usize, Failed> {
    const NUMBERS: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    type Put = fn(&mut Stored, f64);
    const OF_THE_LOOP: [Put; 3] = [
        |stored, value| stored.settings.wall.stiffness_n_per_m = value,
        |stored, value| stored.settings.wall.damping_n_s_per_m = value,
        |stored, value| {
            stored.settings.velocity = VelocitySettings::Butterworth { cutoff_hz: value };
        },
    ];
    const OF_EXPERIMENTS: [Put; 3] = [
        |stored, value| stored.push_n = value,
        |stored, value| stored.settle_s = value,
        |stored, value| stored.rms_limit_m = value,
    ];
    let all = [(OF_THE_LOOP, true), (OF_EXPERIMENTS, false)];
    let all = all.into_iter().flat_map(|(puts, of_loop)| puts.map(|put| (put, of_loop)));
    let each = all.flat_map(|(put, of_loop)| NUMBERS.map(|number| (put, of_loop, number)));
    let cases: Vec<_> = [(OF_THE_LOOP[0], true, -1.0)].into_iter().chain(each).collect();
    for (n, (put, of_loop, number)) in cases.iter().enumerate() {
        let mut bad = stored(world.powered.board, 1000.0);
        put(&mut bad, *number);
        let case = format!("case {n}, {number}");
        boot(world, &[(SECTOR_A, &bad.to_words(1))])?.expect(&case, |it| {
            let says = "ok load: defaults: this firmware cannot take what was saved";
            let defaults = it.loaded == says && it.stiffness == "k 0 N/m";
            let others = !of_loop && it.stiffness == "k 1000 N/m";
            defaults && it.status.contains(NOT_VALID) || others
        })?;
    }
    Ok(cases.len())
}

fn any_word(random: &mut Random) -> u32 {
    u32::try_from(random.below(1 << 32)).unwrap_or_default()
}

/// Fills both sectors with random data.
fn fill_the_flash(world: &mut World<'_>) -> Result<usize, Failed> {
    for seed in (0..).take(RANDOM) {
        let mut random = Random(seed);
        let [a, b] = [(); 2].map(|()| {
            let words = (0..SECTOR_WORDS).map(|_| any_word(&mut random));
            words.collect::<Vec<_>>()
        });
        boot(world, &[(SECTOR_A, &a), (SECTOR_B, &b)])?
            .expect(&format!("flash by seed {seed}"), Booted::has_defaults)?;
    }
    Ok(RANDOM)
}

/// Fills the backup RAM with random data and resets the board. No fault may appear. The settings must not change.
fn fill_the_backup(world: &mut World<'_>) -> Result<usize, Failed> {
    let older = record(world, 1, 1000.0);
    boot(world, &[(SECTOR_A, &older)])?;
    for seed in (0..).take(RANDOM) {
        let mut random = Random(seed);
        for word in 0..BACKUP_WORDS {
            world.powered.mcu.poke(BACKUP + 4 * word, any_word(&mut random));
        }
        world.reset();
        booted(world)?.expect(&format!("backup RAM by seed {seed}"), |it| {
            it.stiffness == "k 1000 N/m" && it.status.contains(NO_FAULT)
        })?;
    }
    Ok(RANDOM)
}
