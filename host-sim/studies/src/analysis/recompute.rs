//! Every sample of a capture once more, by the core: from the keys and the counts that the board has told.
//!
//! Between two keys every velocity follows from the counts, and every force from the settings. What the board says of
//! its outputs, and the state in its next key, must be the same to the last bit. Where they are not, the first sample
//! that differs is named, and nothing is said of those behind it up to the next key.

use std::{
    collections::HashMap,
    fmt::{self, Write as _},
    ops::Range,
    sync::atomic::{AtomicBool, Ordering::Relaxed},
};

use zwidth::{
    LoopParameters, Motion,
    telemetry::{Flags, Key, Record},
    units::{Force, Position, Velocity},
    velocity::{self, Senses, Tuned},
};

use super::{
    port::Account,
    telemetry::{Capture, Chunk},
};

/// Largest move of the sample with which the count was zeroed, which nobody tells: counts.
const ZEROED_MOVE: i32 = 500;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub sample: u64,
    pub position: Position,
    /// Velocity, where it could be computed.
    pub velocity: Option<Velocity>,
    /// Force that acts from the last output on; none before the first one.
    pub force: Option<Force>,
    /// Velocity that the board reports with an output.
    pub told: Option<Velocity>,
}

#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Difference {
    /// First sample that differs.
    pub sample: u64,
    /// Name of the quantity that differs.
    pub what: &'static str,
    /// Value of the board, then of the core, as bits.
    pub board: i64,
    pub core: i64,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { sample, what, board, core } = self;
        write!(f, "sample {sample}: {what} is {board} on the board, {core} by the core")
    }
}

/// A capture, computed again.
#[derive(Clone, Debug, Default)]
pub struct Recomputed {
    /// Every sample whose count is in the capture, in order.
    pub rows: Vec<Row>,
    /// Stretches in which no sample is missing, as places in `rows`.
    pub stretches: Vec<Range<usize>>,
    /// Samples whose velocity was computed.
    pub computed: u64,
    /// Outputs whose velocity was compared.
    pub velocities: u64,
    /// Outputs whose force was compared.
    pub forces: u64,
    /// Number of keys whose state was compared with the computed state.
    pub states: u64,
    /// Keys whose energy at the port was compared with the one that was computed up to there.
    pub energies: u64,
    /// Changes of the estimator or its tuning that were followed, and how often the count was zeroed.
    pub changes: u64,
    /// What differs, in order.
    pub differences: Vec<Difference>,
    /// Stretches between two keys of which nothing can be said, and why: first and last sample.
    pub unknown: Vec<(u64, u64, &'static str)>,
}

/// A sample of a stretch, with its output.
#[derive(Clone, Copy)]
struct Told {
    sample: u64,
    position: Position,
    output: Option<(Record, Force)>,
}

/// Data of a capture between two resets of the board.
#[derive(Default)]
struct Run {
    told: Vec<Told>,
    keys: Vec<Key>,
    settings: HashMap<u16, Option<LoopParameters>>,
}

impl Recomputed {
    pub fn of(capture: &Capture) -> Self {
        Self::until(capture, &AtomicBool::new(false))
    }

    /// The same, of a part of it once `stop` is set.
    pub fn until(capture: &Capture, stop: &AtomicBool) -> Self {
        let mut all = Self::default();
        let mut run = Run::default();
        let mut account = Account::default();
        for chunk in capture.chunks.iter().take_while(|_| !stop.load(Relaxed)) {
            let Some(newest) = chunk.outputs.last() else { continue };
            if newest.flags.contains(Flags::REPLAY) {
                continue;
            }
            if run.told.last().is_some_and(|last| newest.sample < last.sample) {
                all.take(&std::mem::take(&mut run), stop);
            }
            let (energies, other) = account.take(chunk);
            all.energies += energies;
            if let Some((sample, board, core)) = other {
                all.differ(sample, "energy at the port", board, core);
            }
            if !all.add(&mut run, chunk) {
                all.take(&std::mem::take(&mut run), stop);
            }
        }
        all.take(&run, stop);
        all
    }

    /// Samples that are missing between those that were told: first and last of each gap.
    pub fn gaps(&self) -> Vec<(u64, u64)> {
        let ends = self.stretches.windows(2).filter_map(|pair| {
            let [before, after] = [self.rows.get(pair[0].end - 1)?, self.rows.get(pair[1].start)?];
            (after.sample > before.sample).then(|| (before.sample + 1, after.sample - 1))
        });
        ends.collect()
    }

    /// One row per sample, in the integers of the control: velocity in 2^-16 counts per sample, empty where it could not
    /// be computed; the force that acts from the last output on, in 2^-30 of full scale.
    pub fn csv(&self) -> String {
        let mut text = String::from("sample,position_counts,velocity_q16,force_q30,output\n");
        for Row { sample, position, velocity, force, told } in &self.rows {
            let velocity =
                velocity.map_or_else(String::new, |velocity| velocity.bits().to_string());
            let force = force.map_or_else(String::new, |force| force.bits().to_string());
            let (counts, output) = (position.counts(), u8::from(told.is_some()));
            let _ = writeln!(text, "{sample},{counts},{velocity},{force},{output}");
        }
        text
    }

    /// The first sample that differs.
    pub fn first_difference(&self) -> Option<&Difference> {
        self.differences.first()
    }

    /// The samples of a chunk; false if a count is another one than it was.
    fn add(&mut self, run: &mut Run, chunk: &Chunk) -> bool {
        for settings in &chunk.settings {
            run.settings.insert(settings.number, settings.settings.build(&settings.design).ok());
        }
        run.keys.extend(chunk.key);
        let Some(newest) = chunk.outputs.last().map(|record| record.sample) else { return true };
        let told = |sample, position| Told { sample, position, output: None };
        let mut samples: Vec<Told> = match chunk.positions.len() as u64 {
            0 => chunk.outputs.iter().map(|record| told(record.sample, record.position)).collect(),
            n => (newest + 1 - n..).zip(&chunk.positions).map(|(at, p)| told(at, *p)).collect(),
        };
        let mut same = true;
        for (record, push) in chunk.outputs.iter().zip(&chunk.pushes) {
            let Some(told) = samples.iter_mut().find(|told| told.sample == record.sample) else {
                continue;
            };
            same &= self.count(record.sample, record.position, told.position);
            told.output = Some((*record, *push));
        }
        let known = run.told.last().copied();
        for told in samples {
            match known {
                Some(last) if told.sample == last.sample => {
                    same &= self.count(told.sample, told.position, last.position);
                }
                Some(last) if told.sample < last.sample => {}
                _ => run.told.push(told),
            }
        }
        same
    }

    fn differ(
        &mut self,
        sample: u64,
        what: &'static str,
        board: impl Into<i64>,
        core: impl Into<i64>,
    ) {
        self.differences.push(Difference { sample, what, board: board.into(), core: core.into() });
    }

    /// Whether a count is what it was told to be.
    fn count(&mut self, sample: u64, told: Position, before: Position) -> bool {
        if told != before {
            self.differ(sample, "count", told.counts(), before.counts());
        }
        told == before
    }

    /// Everything up to a reset, or to the end.
    fn take(&mut self, run: &Run, stop: &AtomicBool) {
        for stretch in run.told.chunk_by(|a, b| b.sample == a.sample + 1) {
            let begin = self.rows.len();
            let mut force = None;
            for told in stretch {
                if let Some((record, _)) = told.output {
                    force = Some(record.force);
                }
                let (sample, position) = (told.sample, told.position);
                let told = told.output.map(|(record, _)| record.velocity);
                self.rows.push(Row { sample, position, velocity: None, force, told });
            }
            self.stretches.push(begin..self.rows.len());
            self.stretch(run, stretch, begin, stop);
        }
    }

    /// From key to key.
    fn stretch(&mut self, run: &Run, stretch: &[Told], begin: usize, stop: &AtomicBool) {
        let (Some(first), Some(last)) = (stretch.first(), stretch.last()) else { return };
        let place = |key: &Key| usize::try_from(key.sample - first.sample).unwrap_or(usize::MAX);
        let keys: Vec<&Key> = run
            .keys
            .iter()
            .filter(|key| (first.sample..=last.sample).contains(&key.sample))
            .collect();
        let mut changes = 0;
        for (n, key) in keys.iter().enumerate().take_while(|_| !stop.load(Relaxed)) {
            let at = place(key);
            let next = keys.get(n + 1);
            let until = next.map_or(stretch.len() - 1, |next| place(next));
            let tuned = |key: &Key| {
                let parameters = run.settings.get(&key.settings)?.as_ref();
                parameters.map(|parameters| parameters.estimator)
            };
            let mut unknown = |why| self.unknown.push((key.sample, stretch[until].sample, why));
            let Some(estimator) = tuned(key) else {
                unknown("settings that were not told");
                continue;
            };
            let last = (key.position, key.velocity);
            let Some(state) = velocity::State::of(&estimator, last, key.memory()) else {
                unknown("an estimator of more than counts");
                continue;
            };
            let samples = &stretch[at..=until];
            let path = match next {
                Some(next) if (next.tuning, next.zeros) != (key.tuning, key.zeros) => {
                    changes += 1;
                    let Some(after) = tuned(next) else { continue };
                    let change = (next.tuning != key.tuning).then(|| after.after(&estimator));
                    let Some(path) = followed(samples, state, (&estimator, change), key, next)
                    else {
                        unknown("a change between two keys that nothing explains");
                        continue;
                    };
                    path
                }
                _ => follow(samples, state, (&estimator, None), None),
            };
            self.compare(run, samples, &path.velocities, begin + at);
            if let Some(next) = next {
                self.states += 1;
                let (_, velocity) = path.state.last();
                if velocity != next.velocity {
                    self.differ(next.sample, "velocity", next.velocity.bits(), velocity.bits());
                } else if !is(&path, next) {
                    self.differ(next.sample, "state of the estimator", 1, 0);
                }
            }
        }
        self.changes += changes;
    }

    /// Keeps what was computed, up to the first output that says something else.
    fn compare(&mut self, run: &Run, samples: &[Told], velocities: &[Velocity], begin: usize) {
        for (n, (told, &velocity)) in samples.iter().zip(velocities).enumerate() {
            if let Some((record, push)) = told.output {
                if record.velocity != velocity {
                    self.differ(told.sample, "velocity", record.velocity.bits(), velocity.bits());
                    return;
                }
                self.velocities += u64::from(n > 0);
                let motion = Motion { sample: told.sample, position: told.position, velocity };
                if n > 0 && !self.force(run, &record, motion, push) {
                    return;
                }
            }
            if let Some(row) = self.rows.get_mut(begin + n) {
                self.computed += u64::from(row.velocity.is_none());
                row.velocity = Some(velocity);
            }
        }
    }

    /// Whether the force of an output is the core's, where nothing but wall and push decides it.
    fn force(&mut self, run: &Run, record: &Record, motion: Motion, push: Force) -> bool {
        let Some(Some(parameters)) = run.settings.get(&record.settings) else { return true };
        let (flags, drive) = (record.flags, parameters.render(motion, push));
        let (told, core) = (record.force.bits(), drive.force.bits());
        let (what, board, core): (_, i64, i64) = if flags.contains(Flags::CONTACT) != drive.contact
        {
            ("contact", (!drive.contact).into(), drive.contact.into())
        } else if !flags.contains(Flags::ON) {
            ("force while off", told.into(), 0)
        } else if !flags.contains(Flags::ARMED) || flags.contains(Flags::CHANGING) {
            return true; // the supervisor's fade and ramp
        } else if told != core {
            ("force", told.into(), core.into())
        } else {
            let core = parameters.actuator.command(drive.force).code();
            ("command", record.command.code().into(), core.into())
        };
        if board != core {
            self.differ(motion.sample, what, board, core);
            return false;
        }
        self.forces += 1;
        true
    }
}

/// Result of the core for some samples: velocities, last state, estimator.
struct Path {
    velocities: Vec<Velocity>,
    state: velocity::State,
    estimator: Tuned,
}

/// Whether the state at its end is that of the key.
fn is(path: &Path, key: &Key) -> bool {
    let mut memory = [0; zwidth::telemetry::STATE_MAX];
    let length = path.state.put(&path.estimator, &mut memory);
    path.state.last() == (key.position, key.velocity)
        && length.is_some_and(|length| memory.get(..length) == Some(key.memory()))
}

/// The path from the state after the first of those samples. The estimator changes with the sample at `change`'s place,
/// the count is zeroed with that at `zero`'s, which moved by so much.
fn follow(
    samples: &[Told],
    mut state: velocity::State,
    (before, change): (&Tuned, Option<(usize, Tuned)>),
    zero: Option<(usize, i32)>,
) -> Path {
    let mut velocities = vec![state.last().1];
    let mut estimator = *before;
    let first = samples.first().and_then(|told| told.output);
    let mut force = first.map_or(Force::ZERO, |(record, _)| record.force);
    for (n, told) in samples.iter().enumerate().skip(1) {
        if let Some((_, after)) = change.filter(|(at, _)| *at == n) {
            estimator = after;
        }
        let zeroed = zero.filter(|(at, _)| *at == n);
        let before = state.last().0.counts();
        let position = zeroed
            .map_or(told.position, |(_, moved)| Position::from_counts(before.wrapping_add(moved)));
        velocities.push(estimator.update(&mut state, position, &Senses { force, ..Senses::NONE }));
        if zeroed.is_some() {
            state.rebase(told.position);
        }
        if let Some((record, _)) = told.output {
            force = record.force;
        }
    }
    Path { velocities, state, estimator }
}

/// The path to a key with another tuning, or before which the count was zeroed: a change is in force with the sample
/// after an output, unless only a later one ends in the key's state; which move a zero has swallowed that state tells
/// too. None if nothing ends in it, or several later ones that differ.
fn followed(
    samples: &[Told],
    state: velocity::State,
    (before, change): (&Tuned, Option<Tuned>),
    key: &Key,
    next: &Key,
) -> Option<Path> {
    let places = 1..samples.len();
    let fits = |path: &Path| {
        let outputs = samples.iter().zip(&path.velocities);
        is(path, next)
            && outputs.clone().all(|(told, velocity)| {
                told.output.is_none_or(|(record, _)| record.velocity == *velocity)
            })
    };
    let changes: Vec<Option<(usize, Tuned)>> = match change {
        None => vec![None],
        // In force from the sample after an output on; the next output has the new number of the settings.
        Some(after) => {
            let new = samples.iter().position(|told| {
                told.output.is_some_and(|(record, _)| record.settings == next.settings)
            });
            let most = new.unwrap_or(samples.len() - 1);
            let old = samples[..most].iter().rposition(|told| told.output.is_some()).unwrap_or(0);
            (old + 1..=most).map(|at| Some((at, after))).collect()
        }
    };
    let zeros: Vec<Option<(usize, i32)>> = if next.zeros == key.zeros {
        vec![None]
    } else {
        let zeroed = places.filter(|&n| samples[n].position == Position::default());
        let moves: Vec<i32> = (0..=ZEROED_MOVE).flat_map(|d| [d, -d]).collect();
        // The first sample at zero that was not there before, else any.
        let first: Vec<usize> = zeroed.take(20).collect();
        moves.iter().flat_map(|&moved| first.iter().map(move |&at| Some((at, moved)))).collect()
    };
    let mut found: Option<Path> = None;
    for change in &changes {
        for zero in &zeros {
            let path = follow(samples, state, (before, *change), *zero);
            if !fits(&path) {
                continue;
            }
            // By the board's timing it is the sample after the output; what forgets at once cannot tell.
            if zero.is_some() || change == &changes[0] {
                return Some(path);
            }
            match &found {
                Some(other) if other.velocities != path.velocities => return None,
                Some(_) => {}
                None => found = Some(path),
            }
        }
    }
    found
}
