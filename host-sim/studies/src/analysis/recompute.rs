//! Computes every sample of a capture again with the core. It uses the board's counts and its key frames, here called
//! keys.
//!
//! A key has the state of the sampler. From one key to the next key, every velocity follows from the counts, and every
//! force follows from the velocity and the settings. The board's outputs, and the state in the board's next key, must
//! be equal to these results, bit for bit. If outputs or state differ, the first sample with a difference is reported.
//! Later samples, up to the next key, are not compared.

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

/// Largest motion that is tried in the sample in which the count was set to zero, in counts. The capture does not
/// contain this motion.
const ZEROED_MOVE: i32 = 500;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub sample: u64,
    pub position: Position,
    /// The computed velocity; `None` if it could not be computed.
    pub velocity: Option<Velocity>,
    /// Force of the last output; `None` before the first output.
    pub force: Option<Force>,
    /// The velocity that the board has sent; `None` if the sample has no output.
    pub told: Option<Velocity>,
}

#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Difference {
    /// The first sample in which board and core differ.
    pub sample: u64,
    /// Name of the quantity that differs.
    pub what: &'static str,
    /// The value of the board, as bits. `core` has the value of the core.
    pub board: i64,
    pub core: i64,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { sample, what, board, core } = self;
        write!(f, "sample {sample}: {what} is {board} on the board, {core} by the core")
    }
}

/// A capture that was computed again.
#[derive(Clone, Debug, Default)]
pub struct Recomputed {
    /// All samples whose count is in the capture, in their order.
    pub rows: Vec<Row>,
    /// Ranges of `rows` in which no sample is missing.
    pub stretches: Vec<Range<usize>>,
    /// Number of samples whose velocity was computed.
    pub computed: u64,
    /// Number of outputs whose velocity was compared.
    pub velocities: u64,
    /// Number of outputs whose force was compared.
    pub forces: u64,
    /// Number of keys whose state was compared with the computed state.
    pub states: u64,
    /// Number of keys whose energy at the port was compared with the computed energy.
    pub energies: u64,
    /// Number of changes that were computed again. A change is another estimator, another tuning or another zero of the
    /// count.
    pub changes: u64,
    pub differences: Vec<Difference>,
    /// Ranges between two keys that could not be computed. Each has its first sample, its last sample and the reason.
    pub unknown: Vec<(u64, u64, &'static str)>,
}

/// A sample that the capture has, with its output if there is one.
#[derive(Clone, Copy)]
struct Told {
    sample: u64,
    position: Position,
    output: Option<(Record, Force)>,
}

/// What the capture has between two resets of the board.
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

    /// Computes a capture again. If `stop` is set, it ends early and returns the part that was computed.
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

    /// Gaps between the samples of the capture. Each gap has its first and its last missing sample.
    pub fn gaps(&self) -> Vec<(u64, u64)> {
        let ends = self.stretches.windows(2).filter_map(|pair| {
            let [before, after] = [self.rows.get(pair[0].end - 1)?, self.rows.get(pair[1].start)?];
            (after.sample > before.sample).then(|| (before.sample + 1, after.sample - 1))
        });
        ends.collect()
    }

    /// The samples as CSV, one row per sample. The numbers are the integers of the control loop. The velocity is in
    /// 2^-16 counts per sample. The velocity is empty if it could not be computed. The force of the last output is in
    /// 2^-30 of full scale.
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

    pub fn first_difference(&self) -> Option<&Difference> {
        self.differences.first()
    }

    /// Adds the samples of a chunk. Returns false if a count differs from an earlier report of the same sample.
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

    /// Compares two reports of a sample's count. Returns whether they agree.
    fn count(&mut self, sample: u64, told: Position, before: Position) -> bool {
        if told != before {
            self.differ(sample, "count", told.counts(), before.counts());
        }
        told == before
    }

    /// Computes all samples of a run. A run lies between two resets of the board.
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

    /// Computes a range of samples without a gap, from each key to the next.
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

    /// Compares the outputs. Stores the computed velocities up to the first output that differs.
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

    /// Whether the force of an output agrees with the core. The result is also true if the force does not come from
    /// wall and push alone.
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
            return true; // the supervisor's fade or ramp
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

/// What the core computes for several samples: the velocities, the last state, and the estimator.
struct Path {
    velocities: Vec<Velocity>,
    state: velocity::State,
    estimator: Tuned,
}

/// Whether the path ends in the state that the key has.
fn is(path: &Path, key: &Key) -> bool {
    let mut memory = [0; zwidth::telemetry::STATE_MAX];
    let length = path.state.put(&path.estimator, &mut memory);
    path.state.last() == (key.position, key.velocity)
        && length.is_some_and(|length| memory.get(..length) == Some(key.memory()))
}

/// Computes the samples after the first sample. The estimator changes at the index of `change`. The count is set to
/// zero at the index of `zero`. The handle moves by the given number of counts in this sample.
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

/// Finds the path to a key after a change of the tuning or of the count's zero. A change normally acts from the sample
/// after an output on. A later sample is used only if no other path ends in the key's state. The motion in the sample
/// that sets the count to zero is unknown, but it follows from the key's state. The result is `None` if no path ends in
/// this state. It is also `None` if several paths from later samples end in this state with different velocities.
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
        // The change acts from the sample after an output on. The next output has the new number of the settings.
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
        // The first samples with a position of zero, at most twenty.
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
            // If the estimator has no memory, several samples fit. The board's timing decides: the change acts from the
            // sample after the output on.
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
