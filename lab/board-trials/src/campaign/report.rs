//! `cargo board campaign`: its options and its output.

use std::{path::PathBuf, time::Instant};

use clap::Args;
use host_sim::{
    error::Error,
    output::terminal::{note, print_json, print_text},
};
use serde::Serialize;
use virtual_board::{
    board::{BOARDS, Board},
    session::Session,
};

use super::{
    image_flips::{ENDS, End, ImageFlip, PARTS, Part},
    place::{REGIONS, Region},
    random::Flip,
    row::{Row, slug},
    rows::rows,
    run::Ground,
    sample_bits::{SampleBits, sample_bits},
    situation::{Situation, scene},
    tally::Tally,
    verdict::{CLASSES, Class, Verdict},
};
use crate::threads::cores;

/// Options of the fault campaign.
#[derive(Args)]
pub struct Campaign {
    #[arg(long, help = format!("One board, {}; both if not given", Board::names(" or ")))]
    board: Option<String>,
    /// The firmware's ELF. It is built if this option is missing.
    #[arg(long, requires = "board")]
    elf: Option<PathBuf>,
    /// Named faults, separated by commas, or `all` or `none`. A name has dashes between its words, such as
    /// `no-sample-is-due`.
    #[arg(long, value_name = "LIST", default_value = "all", value_delimiter = ',')]
    rows: Vec<String>,
    /// Number of random flips of single bits, per board.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=10_000_000))]
    random: u64,
    /// Number of random flips of single bits in the program in flash, per board. The handle is in contact.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=10_000_000))]
    image: u64,
    /// Flip every N-th bit of the data that `sample` keeps, at several cutoffs, estimators and output periods. 1 flips
    /// every bit, 0 flips none.
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "current_sense", value_parser = clap::value_parser!(u64).range(0..=10_000))]
    sample_bits: u64,
    /// Use only the setups whose console lines contain these words, such as "period 1, cutoff 50" or "kalman".
    #[arg(long, value_name = "WORDS", requires = "sample_bits", default_value = "")]
    setup: String,
    /// Seed of the random flips. The same number gives the same flips.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Number of the first random flip. With this option one flip can be run again.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=10_000_000))]
    first: u64,
    /// The board measures the amplifier's current. The current signal is half of the analogue supply at rest and 80 %
    /// of it at full command.
    #[arg(long)]
    current_sense: bool,
    /// Number of worker threads. The results do not depend on it. The default is the number of cores.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Print one JSON object on stdout, and nothing else there.
    #[arg(long)]
    pub json: bool,
}

/// Largest allowed share of flips after which a wrong force stays on. `LATE_MOST` is the largest allowed share of flips
/// after which the force is off too late.
const UNNOTICED_MOST: f64 = 1e-3;
const LATE_MOST: f64 = 5e-3;
/// Smallest number of flips with which the share itself must be below the limit. With fewer flips, the lower end of the
/// share's 95 % interval must be below the limit.
const MANY: u64 = 10_000;

#[derive(Serialize)]
struct Json {
    seed: u64,
    rows: Vec<RowJson>,
    classes: Vec<ClassJson>,
    random: Vec<RegionJson>,
    image: Vec<PartJson>,
    image_flips: Vec<ImageFlipJson>,
    sample_bits: Vec<SampleBits>,
    on_in_fault: u64,
    wall_s: f64,
}

#[derive(Serialize)]
struct RowJson {
    board: &'static str,
    name: String,
    situation: Situation,
    #[serde(flatten)]
    verdict: Verdict,
    /// The region in which the bit flipped. It is null for a named fault.
    region: Option<Region>,
    /// The reason why a named fault is never found in this situation. It is null if the fault must be found.
    reason: Option<&'static str>,
}

#[derive(Serialize)]
struct ClassJson {
    board: &'static str,
    random: bool,
    no_effect: u64,
    bounded: u64,
    off_in_time: u64,
    off_late: u64,
    unnoticed: u64,
    unheard: u64,
}

#[derive(Serialize)]
struct RegionJson {
    board: &'static str,
    /// The region that is counted. Null stands for all regions together.
    region: Option<Region>,
    flips: u64,
    counts: Tally<Class>,
    /// Share of these flips after which the force was off too late, and the ends of its 95 % interval. `unnoticed` is
    /// the same for a wrong force that stayed on.
    off_late: [f64; 3],
    unnoticed: [f64; 3],
}

/// Results of flips in one part of the program in flash.
#[derive(Serialize)]
struct PartJson {
    board: &'static str,
    /// The part that is counted. Null stands for all parts together.
    part: Option<Part>,
    flips: u64,
    ends: Tally<End>,
    /// Share of flips for which the force was wrong until the check found the flip, and the ends of its 95 % interval.
    wrong: [f64; 3],
    /// Longest time of a wrong force, in s.
    wrong_s: f64,
    /// Largest speed that a wrong force gives the handle, in m/s.
    speed_m_per_s: f64,
    /// Longest time from a flip until the force is off, in s.
    off_s: f64,
}

/// One flip in the program in flash.
#[derive(Serialize)]
struct ImageFlipJson {
    board: &'static str,
    name: String,
    end: End,
    code: Option<u8>,
    off_s: Option<f64>,
    wrong_s: f64,
    speed_m_per_s: f64,
}

/// Runs the campaign.
///
/// # Errors
/// The input is bad, the user pressed Ctrl-C, or a fault exceeds its limits. Such a fault is found late or never, or
/// lets the handle gain too much speed.
pub fn execute(options: &Campaign) -> Result<(), Error> {
    let begun = Instant::now();
    let boards = match &options.board {
        Some(name) => vec![Board::asked(name)?],
        None => BOARDS.to_vec(),
    };
    let threads = options.threads.map_or_else(cores, usize::from);
    let chosen =
        boards.iter().map(|&board| chosen(board, options)).collect::<Result<Vec<_>, _>>()?;
    let mut json = Json {
        seed: options.seed,
        rows: Vec::new(),
        classes: Vec::new(),
        random: Vec::new(),
        image: Vec::new(),
        image_flips: Vec::new(),
        sample_bits: Vec::new(),
        on_in_fault: 0,
        wall_s: 0.0,
    };
    let mut wrong = Vec::new();
    for (board, chosen) in boards.into_iter().zip(chosen) {
        if options.sample_bits > 0 {
            let found = sample_bits(
                (board, options.elf.as_deref()),
                &options.setup,
                (options.first, options.sample_bits),
                threads,
            )?;
            let named = found.iter().flat_map(|setup| {
                setup.wrong.iter().map(|why| format!("{} {}, {why}", board.name, setup.setup))
            });
            wrong.extend(named);
            json.sample_bits.extend(found);
        }
        if chosen.is_empty() && options.image == 0 && options.random == 0 {
            continue;
        }
        let named = scene(board, options.current_sense)?;
        let session = Session::open(board, options.elf.as_ref(), named)?;
        let ground = Ground::new(&session, &chosen)?;
        if !chosen.is_empty() {
            wrong.extend(json.add_rows(board, &chosen, ground.rows(&chosen, threads)?));
        }
        let numbered = (options.seed, options.first);
        if options.image > 0 {
            let flips = ground.image_flips(numbered, options.image, threads)?;
            wrong.extend(json.add_image(board, options.first, flips));
        }
        if options.random > 0 {
            let flips = ground.flips(numbered, options.random, threads)?;
            wrong.extend(json.add_random(board, options.first, flips));
        }
    }
    json.wall_s = begun.elapsed().as_secs_f64();
    if options.json {
        print_json(&json)?;
    } else {
        say(&json)?;
    }
    if wrong.is_empty() { Ok(()) } else { Err(Error::Internal(wrong.join("; "))) }
}

/// Each `add` function returns texts about the results that break a limit.
impl Json {
    fn add_rows(
        &mut self,
        Board { name: board, .. }: Board,
        rows: &[Row],
        verdicts: Vec<(usize, Situation, Verdict)>,
    ) -> Vec<String> {
        let classes = Tally::of(verdicts.iter().map(|(.., verdict)| verdict.class));
        self.classes.push(ClassJson::new(board, false, &classes));
        let mut wrong = Vec::new();
        for (row, situation, verdict) in verdicts {
            let (name, reason) = (rows[row].name.clone(), rows[row].reason(situation));
            self.on_in_fault += u64::from(verdict.on_in_fault);
            let why = verdict.wrong(reason);
            wrong.extend(why.map(|why| format!("{board} {name}, {}: {why}", situation.text())));
            self.rows.push(RowJson { board, name, situation, verdict, region: None, reason });
        }
        wrong
    }

    fn add_random(
        &mut self,
        Board { name: board, .. }: Board,
        first: u64,
        flips: Vec<(Situation, Flip)>,
    ) -> Vec<String> {
        let mut wrong = Vec::new();
        for region in [None].into_iter().chain(REGIONS.map(Some)) {
            let of_it =
                flips.iter().filter(|(_, flip)| region.is_none_or(|region| flip.region == region));
            let counts = Tally::of(of_it.map(|(_, flip)| flip.verdict.class));
            let (off_late, unnoticed) =
                (counts.share(Class::OffLate), counts.share(Class::Unnoticed));
            let flips = counts.all();
            let told = RegionJson { board, region, flips, counts, off_late, unnoticed };
            if region.is_none() {
                wrong.extend(told.wrong());
                self.classes.push(ClassJson::new(board, true, &told.counts));
            }
            self.random.push(told);
        }
        for (n, (situation, Flip { region, what, verdict })) in (first..).zip(flips) {
            let name = format!("flip {n}, {what}");
            self.on_in_fault += u64::from(verdict.on_in_fault);
            if verdict.on_in_fault {
                wrong.push(format!("{board} {name}: on in a fault"));
            }
            if verdict.class == Class::Unheard {
                wrong.push(format!("{board} {name}: {}", Class::Unheard.text()));
            }
            let (region, reason) = (Some(region), None);
            self.rows.push(RowJson { board, name, situation, verdict, region, reason });
        }
        wrong
    }

    fn add_image(
        &mut self,
        Board { name: board, .. }: Board,
        first: u64,
        flips: Vec<ImageFlip>,
    ) -> Vec<String> {
        for part in [None].into_iter().chain(PARTS.map(Some)) {
            let of_it = || flips.iter().filter(|flip| part.is_none_or(|part| flip.part == part));
            let most =
                |of: fn(&Verdict) -> f64| of_it().map(|flip| of(&flip.verdict)).fold(0.0, f64::max);
            let ends = Tally::of(of_it().map(|flip| flip.end));
            self.image.push(PartJson {
                board,
                part,
                flips: ends.all(),
                wrong: ends.share(End::Wrong),
                ends,
                wrong_s: most(|verdict| verdict.wrong_s),
                speed_m_per_s: most(|verdict| verdict.speed_m_per_s),
                off_s: most(|verdict| verdict.off_s.unwrap_or_default()),
            });
        }
        let mut bad = Vec::new();
        for (n, ImageFlip { what, end, verdict, .. }) in (first..).zip(flips) {
            let name = format!("flip {n}, {what}");
            self.on_in_fault += u64::from(verdict.on_in_fault);
            let fault = verdict.on_in_fault.then_some("on in a fault");
            if let Some(why) = fault.or(end.is_bad().then(|| end.text())) {
                bad.push(format!("{board} {name}: {why}"));
            }
            let Verdict { code, off_s, wrong_s, speed_m_per_s, .. } = verdict;
            let told = ImageFlipJson { board, name, end, code, off_s, wrong_s, speed_m_per_s };
            self.image_flips.push(told);
        }
        bad
    }
}

/// The rows that the option `--rows` selects.
fn chosen(board: Board, options: &Campaign) -> Result<Vec<Row>, Error> {
    let all = rows(board, options.current_sense);
    let asked: Vec<String> = options.rows.iter().map(|name| slug(name)).collect();
    match asked.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["all"] => return Ok(all),
        ["none"] => return Ok(Vec::new()),
        _ => {}
    }
    let of_any_board = BOARDS
        .iter()
        .flat_map(|&board| rows(board, false))
        .map(|row| row.slug())
        .collect::<Vec<_>>();
    if let Some(name) = asked.iter().find(|name| !of_any_board.contains(name)) {
        let mut known = of_any_board;
        known.dedup();
        return Err(Error::Input(format!(
            "--rows: {name} is none, allowed all, none, {}",
            known.join(", ")
        )));
    }
    Ok(all.into_iter().filter(|row| asked.contains(&row.slug())).collect())
}

impl ClassJson {
    fn new(board: &'static str, random: bool, classes: &Tally<Class>) -> Self {
        let [no_effect, bounded, off_in_time, off_late, unnoticed, unheard] =
            CLASSES.map(|class| classes.count(class));
        Self { board, random, no_effect, bounded, off_in_time, off_late, unnoticed, unheard }
    }
}

impl RegionJson {
    /// A text that names each share above its limit. `None` if no share is above its limit.
    fn wrong(&self) -> Option<String> {
        let much =
            |[share, low, _]: [f64; 3], most| (if self.flips < MANY { low } else { share }) > most;
        let bad = much(self.off_late, LATE_MOST) || much(self.unnoticed, UNNOTICED_MOST);
        bad.then(|| {
            let [late, unnoticed] = [self.off_late, self.unnoticed].map(|share| percent(share[0]));
            format!(
                "{}: of {} flips {late} off late, {unnoticed} unnoticed",
                self.board, self.flips
            )
        })
    }
}

fn percent(share: f64) -> String {
    format!("{:.3} %", share * 100.0)
}

fn interval(of: [f64; 3]) -> String {
    let [share, low, high] = of.map(percent);
    format!("{share} ({low} to {high})")
}

fn code_text(code: Option<u8>) -> String {
    code.map_or_else(|| "-".to_owned(), |code| code.to_string())
}

fn ms(off_s: Option<f64>, digits: usize) -> String {
    off_s.map_or_else(|| "never".to_owned(), |s| format!("{:.digits$} ms", s * 1e3))
}

fn say(json: &Json) -> Result<(), Error> {
    for RowJson { board, name, situation, verdict, region, reason } in &json.rows {
        let &Verdict { class, off_s, speed_m_per_s, travel_m, code, .. } = verdict;
        if region.is_some() && class < Class::OffLate {
            continue;
        }
        print_text(&format!(
            "{board:14} {name:44} {:8} {:12} off {:>12}, speed {speed_m_per_s:.4} m/s, travel {:.3} mm, code {}{}",
            situation.text(),
            class.text(),
            ms(off_s, 3),
            travel_m * 1e3,
            code_text(code),
            reason.map_or_else(String::new, |why| format!(" ({why})")),
        ))?;
    }
    for RegionJson { board, region, flips, counts, off_late, unnoticed } in &json.random {
        let counts = CLASSES.map(|class| format!("{} {}", class.text(), counts.count(class)));
        print_text(&format!(
            "{board:14} {:24} {flips} flips: {}; unnoticed {}, late {}",
            region.map_or("all regions", Region::text),
            counts.join(", "),
            interval(*unnoticed),
            interval(*off_late),
        ))?;
    }
    for flip in
        json.image_flips.iter().filter(|flip| !matches!(flip.end, End::Harmless | End::Other))
    {
        let &ImageFlipJson { board, ref name, end, code, off_s, wrong_s, speed_m_per_s } = flip;
        print_text(&format!(
            "{board:14} {name}: {}; off {}, force wrong {:.1} ms, speed {speed_m_per_s:.4} m/s, code {}",
            end.text(),
            ms(off_s, 1),
            wrong_s * 1e3,
            code_text(code),
        ))?;
    }
    for PartJson { board, part, flips, ends, wrong, wrong_s, off_s, .. } in &json.image {
        let ends = ENDS.map(|end| format!("{} {}", end.text(), ends.count(end)));
        print_text(&format!(
            "{board:14} {:16} {flips} flips: {}; wrong {}, for {:.1} ms at most; off after {:.1} ms at most",
            part.map_or("image", Part::text),
            ends.join("; "),
            interval(*wrong),
            wrong_s * 1e3,
            off_s * 1e3,
        ))?;
    }
    for SampleBits { board, setup, flips, counts, wrong } in &json.sample_bits {
        let counts = CLASSES.map(|class| format!("{} {}", class.text(), counts.count(class)));
        print_text(&format!("{board:14} {setup:28} {flips} flips: {}", counts.join(", ")))?;
        wrong.iter().try_for_each(|why| print_text(&format!("    {why}")))?;
    }
    let sample: u64 = json.sample_bits.iter().map(|setup| setup.flips).sum();
    let image: u64 = json.image.iter().filter(|told| told.part.is_none()).map(|it| it.flips).sum();
    note(&format!(
        "{} faults, {:.0} s; on in a fault: {}",
        json.rows.len() as u64 + image + sample,
        json.wall_s,
        json.on_in_fault
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_rows_are_unique_and_can_be_typed() {
        for board in BOARDS {
            let mut slugs: Vec<_> = rows(board, false).iter().map(Row::slug).collect();
            let count = slugs.len();
            slugs.sort();
            slugs.dedup();
            assert_eq!(slugs.len(), count, "{}", board.name);
            assert!(
                !slugs.contains(&"all".to_owned()) && slugs.iter().all(|slug| !slug.is_empty())
            );
        }
    }
}
