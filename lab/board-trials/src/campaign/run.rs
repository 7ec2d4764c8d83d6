//! Runs faults on several threads. The results do not depend on the number of threads.

use host_sim::{error::Error, output::terminal::note};
use virtual_board::{
    session::{Failed, Session, ask_each},
    world::World,
};

use super::{
    image_flips::{self, Image, ImageFlip},
    place::Places,
    random::{self, Flip, STARTS, WATCHED},
    row::Row,
    situation::{FULL_SAMPLES, SITUATIONS, Situation, Stage, boot},
    verdict::{Class, Measure, Verdict},
};
use crate::threads::on_threads;

/// Shortest and longest time for which the board is watched after a named fault, in samples.
const LEAST: u64 = 1_200;
const LONGEST: u64 = 13_500;
/// All named faults begin at the start time with this index.
const ROW_START: usize = 3;

/// Runs of all situations without a fault. The runs with faults are compared with them.
pub struct Ground<'a> {
    session: &'a Session,
    stages: [Stage; SITUATIONS.len()],
    places: Places,
    full_m_per_s2: f64,
}

impl<'a> Ground<'a> {
    /// Runs the situations without a fault.
    ///
    /// # Errors
    /// The board cannot be armed.
    pub fn new(session: &'a Session, rows: &[Row]) -> Result<Self, Error> {
        let longest = rows.iter().map(samples).max().unwrap_or_default();
        let samples = longest.max(WATCHED).max(image_flips::WATCHED) + LEAST;
        let stages = on_threads(
            SITUATIONS.len(),
            2,
            || Ok(()),
            |(), n| {
                let situation = SITUATIONS[n];
                let (starts, samples) = match situation {
                    Situation::Full => (ROW_START + 1, FULL_SAMPLES),
                    Situation::Return => (STARTS, WATCHED),
                    _ => (STARTS, samples),
                };
                Ok(Stage::new(session, (situation, &[]), starts, samples)?)
            },
        )?;
        let stages: [Stage; SITUATIONS.len()] =
            stages.try_into().map_err(|_| Error::Internal("a stage of each situation".into()))?;
        let [free, contact, _, back] = &stages;
        let mut read = [free, contact, back].map(|stage| stage.read.clone()).concat();
        read.sort_unstable();
        read.dedup();
        let mut world = boot(session)?;
        world.restore(&contact.starts[ROW_START].snapshot);
        let places = Places::new(&session.elf, &mut world, &read);
        let scene = &session.scene.scene;
        let full_m_per_s2 = scene.full_scale_n() / scene.device.mass_kg;
        Ok(Self { session, stages, places, full_m_per_s2 })
    }

    /// Runs each row in each situation in which it is allowed, and returns the results.
    ///
    /// # Errors
    /// A fault cannot be caused, or the user pressed Ctrl-C.
    pub fn rows(
        &self,
        rows: &[Row],
        threads: usize,
    ) -> Result<Vec<(usize, Situation, Verdict)>, Error> {
        let jobs: Vec<_> = (0..rows.len())
            .flat_map(|row| SITUATIONS.map(|situation| (row, situation)))
            .filter(|&(row, situation)| rows[row].is_in(situation))
            .collect();
        let verdicts = on_threads(
            jobs.len(),
            threads,
            || Ok(boot(self.session)?),
            |world, n| {
                let (row, situation) = jobs[n];
                let failed = |failed: Failed| {
                    Error::Internal(format!("{}: {}", rows[row].name, Error::from(failed)))
                };
                self.row(world, &rows[row], situation).map_err(failed)
            },
        )?;
        let told = jobs.into_iter().zip(verdicts);
        Ok(told.map(|((row, situation), verdict)| (row, situation, verdict)).collect())
    }

    fn row(
        &self,
        world: &mut World<'a>,
        row: &Row,
        situation: Situation,
    ) -> Result<Verdict, Failed> {
        let stage = &self.stages[situation as usize];
        let start = &stage.starts[ROW_START];
        if let Some(keeps) = row.keeps {
            *world = self.session.boot()?;
            return match keeps(world) {
                Ok(_) => Ok(Verdict::of(Class::NoEffect)),
                Err(Failed::Refused(what)) => {
                    note(&format!("{}: {what}", row.name));
                    Ok(Verdict::of(Class::Unnoticed))
                }
                Err(failed) => Err(failed),
            };
        }
        if row.from_off {
            *world = boot(self.session)?;
            ask_each(world, &["zero", "unlock envelope", "wall 0.005", "k 8000", "b 30"])?;
            world.probe()?;
            world.telemetry.clear();
            world.seen = Some(Vec::new());
        } else {
            world.restore(&start.snapshot);
        }
        let begun = (row.begin)(&self.session.elf, world)?;
        let samples = match situation {
            Situation::Full => FULL_SAMPLES,
            _ => samples(row),
        };
        let measure = Measure {
            begun,
            samples,
            half_if_right: false,
            reference: if row.from_off { &[] } else { &stage.seen[start.index..] },
            period: 10,
            from_memory: false,
            allowed_s: row.limit_s,
            from_fault: true,
            free: situation.is_free(),
            full_m_per_s2: self.full_m_per_s2,
        };
        Ok(measure.verdict(world))
    }

    /// Flips bits of the program in flash while the handle is in contact, and returns the results. `numbered` has the
    /// seed and the number of the first flip.
    ///
    /// # Errors
    /// The image has no checksum, or the user pressed Ctrl-C.
    pub fn image_flips(
        &self,
        numbered: (u64, u64),
        count: u64,
        threads: usize,
    ) -> Result<Vec<ImageFlip>, Error> {
        let image = Image::of(&self.session.elf)?;
        let ground = (&self.stages[Situation::Contact as usize], &image);
        self.numbered(numbered, count, threads, |world, number| {
            image_flips::flip(world, ground, number, self.full_m_per_s2)
        })
    }

    /// Runs `count` random flips and returns their results. `numbered` has the seed and the number of the first flip.
    ///
    /// # Errors
    /// The user pressed Ctrl-C.
    pub fn flips(
        &self,
        numbered: (u64, u64),
        count: u64,
        threads: usize,
    ) -> Result<Vec<(Situation, Flip)>, Error> {
        let ground = (&self.stages[..], &self.places);
        self.numbered(numbered, count, threads, |world, number| {
            random::flip(world, ground, number, self.full_m_per_s2)
        })
    }

    fn numbered<T: Send>(
        &self,
        (seed, first): (u64, u64),
        count: u64,
        threads: usize,
        flip: impl Fn(&mut World<'a>, (u64, u64)) -> Result<T, Error> + Sync,
    ) -> Result<Vec<T>, Error> {
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let begin = || Ok(boot(self.session)?);
        on_threads(count, threads, begin, |world, n| flip(world, (seed, first + n as u64)))
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some thousand")]
fn samples(row: &Row) -> u64 {
    ((row.limit_s * 1e4) as u64 + 200).clamp(LEAST, LONGEST)
}
