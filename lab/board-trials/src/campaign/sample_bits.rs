//! Flips each bit of the data that `sample` keeps, at several cutoffs, estimators and output periods.

use std::path::Path;

use host_sim::error::Error;
use serde::Serialize;
use virtual_board::{board::Board, image, session::Session, world::World};

use super::{
    place::{Region, flip_word},
    random::run_to_flip,
    situation::{Situation, Stage, boot, scene},
    tally::Tally,
    verdict::{Class, Measure, Verdict},
};
use crate::{random::Random, threads::on_threads};

/// Cutoffs of the Butterworth low-pass, in Hz.
const CUTOFFS_HZ: [u32; 7] = [1, 10, 50, 100, 300, 1500, 4000];
/// Estimators that need the firmware's feature `estimators`.
const ESTIMATORS: [&str; 2] = ["kalman-3", "levant-implicit"];
/// Output periods, in samples.
const PERIODS: [u32; 2] = [1, 10];
const SITUATIONS: [Situation; 2] = [Situation::Free, Situation::Contact];

/// Longest time for which the board is watched after a flip, in samples. If the force is right after half of this time,
/// the watch ends then.
const WATCHED: u64 = 300;
/// Number of start times from which flips are tried in each situation.
const STARTS: usize = 8;
/// Longest time for which a wrong force is allowed, in s.
const ALLOWED_S: f64 = 3e-3;

/// Results with one estimator at one output period.
#[derive(Serialize)]
pub struct SampleBits {
    pub board: &'static str,
    /// Console lines that set the estimator and the period.
    pub setup: String,
    pub flips: u64,
    pub counts: Tally<Class>,
    /// One text for each flip that broke a limit, with its place, time, situation and reason.
    pub wrong: Vec<String>,
}

/// Flips every `step`-th bit from bit `first` on, in free motion and in contact. A setup is left out if its console
/// lines do not contain `part`. With an `elf`, the setups of other images are left out.
///
/// # Errors
/// No setup contains `part`, an image cannot be built, the board refuses a setup, or the user pressed Ctrl-C.
pub fn sample_bits(
    (board, elf): (Board, Option<&Path>),
    part: &str,
    of_them: (u64, u64),
    threads: usize,
) -> Result<Vec<SampleBits>, Error> {
    let cutoffs = CUTOFFS_HZ.map(|cutoff_hz| format!("cutoff {cutoff_hz}"));
    let estimators = ESTIMATORS.map(|name| format!("estimator {name}"));
    let of_images = [(&[][..], &cutoffs[..]), (&["estimators"], &estimators)];
    let mut found = Vec::new();
    for (features, lines) in of_images {
        let setups = PERIODS.iter().flat_map(|&period| {
            lines.iter().map(move |line| (period, format!("period {period}, {line}")))
        });
        let setups: Vec<_> = setups.filter(|(_, setup)| setup.contains(part)).collect();
        if setups.is_empty() || elf.is_some() && !features.is_empty() {
            continue;
        }
        let elf = match elf {
            Some(elf) => elf.to_owned(),
            None => image::build_variant(board.name, features).map_err(Error::Internal)?,
        };
        let session = Session::open(board, Some(&elf), scene(board, false)?)?;
        for setup in setups {
            found.push(with(&session, setup, of_them, threads)?);
        }
    }
    if found.is_empty() {
        return Err(Error::Input(format!(
            "--setup: no setup has the words {part}, allowed parts of `period {}, {}`",
            PERIODS[0], cutoffs[0]
        )));
    }
    Ok(found)
}

fn with(
    session: &Session,
    (period, setup): (u32, String),
    (first, step): (u64, u64),
    threads: usize,
) -> Result<SampleBits, Error> {
    let typed: Vec<&str> = setup.split(", ").collect();
    let stages = SITUATIONS
        .map(|situation| Stage::new(session, (situation, &typed), STARTS, WATCHED))
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let mut words: Vec<u32> = stages.iter().flat_map(|stage| stage.read.iter().copied()).collect();
    words.sort_unstable();
    words.dedup();
    words.retain(|&address| Region::at(&session.elf, address) == Region::Sample);
    let bits = 32 * words.len() as u64;
    let chosen: Vec<u64> =
        (first % step..bits).step_by(usize::try_from(step).unwrap_or(usize::MAX)).collect();
    let full = &session.scene.scene;
    let full_m_per_s2 = full.full_scale_n() / full.device.mass_kg;
    let flip = |world: &mut World<'_>, n: usize| {
        let (number, situation) = (chosen[n / 2], n % 2);
        let stage = &stages[situation];
        let mut random = Random::of_case(number, n as u64);
        let start = random.one(&stage.starts);
        let working = random.below(2) == 0;
        let (begun, cycle) = run_to_flip(world, start, working, &mut random)?;
        let (word, bit) = (words[usize::try_from(number / 32).unwrap_or_default()], number % 32);
        flip_word(world, word, u8::try_from(bit).unwrap_or_default());
        let measure = Measure {
            begun,
            samples: WATCHED,
            half_if_right: true,
            reference: &stage.seen[start.index..],
            period: period.into(),
            from_memory: false,
            allowed_s: ALLOWED_S,
            from_fault: false,
            free: SITUATIONS[situation].is_free(),
            full_m_per_s2,
        };
        let verdict = measure.verdict(world);
        let why = verdict.wrong(None).map(|why| {
            let situation = SITUATIONS[situation].text();
            format!(
                "{word:#x} bit {bit} at cycle {cycle} of start {}, {situation}: {why}",
                start.index
            )
        });
        Ok((verdict, why))
    };
    let found = on_threads(2 * chosen.len(), threads, || Ok(boot(session)?), flip)?;
    let counts = Tally::of(found.iter().map(|(Verdict { class, .. }, _)| *class));
    let wrong = found.into_iter().filter_map(|(_, why)| why).collect();
    Ok(SampleBits { board: session.board.name, setup, flips: counts.all(), counts, wrong })
}
