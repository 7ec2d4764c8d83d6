//! Observes each instruction without a change of the program. The observations are interrupt masks, the sampling delay,
//! cycles per task, and the lowest stack pointer.

use std::collections::{BTreeMap, BTreeSet};

use rsemu::core::space::RamStore;

use super::{IT_BITS, RAM};

/// Exception number of the sampling task. Its interrupt is that of TIM5, number 50.
pub const SAMPLE: u16 = 16 + 50;
/// Exception number of the output task. Its interrupt is that of SPI3, number 51.
pub const RENDER: u16 = 16 + 51;
/// Exception number of the link task. Its interrupt is that of SPI2, number 36.
pub const LINK: u16 = 16 + 36;

/// Hardware priority of the sampling task. A BASEPRI from 1 to this value would mask the task.
const SAMPLE_PRIORITY: u8 = 0x10;

/// Cycles that the runs of one exception take, from entry to return. The cycles of tasks that preempt it are left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cycles {
    pub runs: u64,
    /// Number of cycles of the shortest run.
    pub least: u64,
    /// Number of cycles of the longest run.
    pub most: u64,
    pub total: u64,
}

impl Default for Cycles {
    fn default() -> Self {
        Self { runs: 0, least: u64::MAX, most: 0, total: 0 }
    }
}

impl Cycles {
    fn add(&mut self, cycles: u64) {
        self.runs += 1;
        self.least = self.least.min(cycles);
        self.most = self.most.max(cycles);
        self.total += cycles;
    }

    #[expect(clippy::cast_precision_loss, reason = "for people to read")]
    pub fn mean(&self) -> f64 {
        self.total as f64 / self.runs.max(1) as f64
    }
}

/// Observations since the last [`clear`](Self::clear). Masks and delays are counted from the first sample on.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    /// Number of instructions that ran while PRIMASK was set.
    pub primask: u64,
    /// Number of instructions that ran while BASEPRI masked the sampling task.
    pub forbidden_basepri: u64,
    /// Longest time for which BASEPRI was not zero, in cycles.
    pub longest_mask: u64,
    /// Number of sampling events for each value that BASEPRI had at the event. The value 0 masks nothing.
    pub events_by_basepri: BTreeMap<u8, u64>,
    /// Number of events for each delay, in cycles, from a sampling event to the reading of the counter.
    pub delays: BTreeMap<u64, u64>,
    /// Number of cycles from a sampling event to a write of the output task into the output's registers.
    pub commands: Cycles,
    /// Cycles of each task. The key of the map is the task's exception number.
    pub tasks: BTreeMap<u16, Cycles>,
    /// How often the emulator has lost ITSTATE and the loss was corrected.
    pub mended: u64,
    /// Longest time from one feeding of the watchdog to the next, in cycles.
    pub longest_unfed: u64,
    fed_at: Option<u64>,
    /// Lowest value that the main stack pointer has had.
    pub lowest_stack: u32,
    /// Cycles that the sampling task spent at each instruction address. `None` if nobody needs them.
    pub profile: Option<BTreeMap<u32, u64>>,
    /// Address and cycles of each instruction in the longest run of the sampling task. Filled only with the profile.
    pub longest: Vec<(u32, u64)>,
    run: Vec<(u32, u64)>,
    /// Addresses of instructions of the sampling task whose cycles are counted separately.
    pub marks: BTreeSet<u32>,
    /// Cycles that the marked instructions take in a run of the sampling task.
    pub marked: Cycles,
    /// Cycles that all other instructions take in a run.
    pub unmarked: Cycles,
    in_marks: u64,
    /// The starts of tasks, and the addresses of three words whose values are noted at each start. `None` if nobody
    /// needs them.
    entries: Option<([u32; 3], Vec<Entry>)>,
    masked: u64,
    running: bool,
    /// The running exceptions, with the innermost one last. Each has its number, and the cycles that it has taken so
    /// far.
    nested: Vec<(u16, u64)>,
}

/// The start of a task, or the end of the last running task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Number of the exception. 0 means that none runs any more.
    pub exception: u16,
    /// Values of the noted words of RAM.
    pub words: [u32; 3],
}

pub(super) struct Step {
    pub(super) cycles: u64,
    pub(super) exception: u16,
    pub(super) primask: bool,
    pub(super) basepri: u8,
    pub(super) stack: u32,
    pub(super) pc: u32,
}

impl Watch {
    pub(super) fn new() -> Self {
        Self { lowest_stack: u32::MAX, ..Self::default() }
    }

    /// Clears the observations, except for the running exceptions.
    pub fn clear(&mut self) {
        let running = self.running;
        let nested = std::mem::take(&mut self.nested);
        let marks = std::mem::take(&mut self.marks);
        let fed_at = self.fed_at;
        let entries = self.entries.take();
        *self = Self { running, nested, marks, fed_at, entries, ..Self::new() };
    }

    /// From now on notes each start of a task with the words of RAM at `addresses`.
    pub fn note_entries(&mut self, addresses: [u32; 3]) {
        self.entries = Some((addresses, Vec::new()));
    }

    /// The tasks that began since the last call, in order.
    pub fn take_entries(&mut self) -> Vec<Entry> {
        self.entries.as_mut().map_or_else(Vec::new, |(_, entries)| std::mem::take(entries))
    }

    pub(super) fn noted(&self) -> Option<[u32; 3]> {
        self.entries.as_ref().map(|(addresses, _)| *addresses)
    }

    pub(super) fn enter(&mut self, exception: u16, words: [u32; 3]) {
        if let Some((_, entries)) = &mut self.entries {
            entries.push(Entry { exception, words });
        }
    }

    /// Whether an exception runs, or has been preempted.
    pub(super) fn is_active(&self, exception: u16) -> bool {
        self.nested.iter().any(|(number, _)| *number == exception)
    }

    /// Number of the running exception. 0 means that none runs.
    pub fn innermost(&self) -> u16 {
        self.nested.last().map_or(0, |(number, _)| *number)
    }

    /// Difference between the longest and the shortest sampling delay, in cycles.
    pub fn delay_spread(&self) -> u64 {
        match (self.delays.first_key_value(), self.delays.last_key_value()) {
            (Some((least, _)), Some((most, _))) => most - least,
            _ => 0,
        }
    }

    /// Prepares for a restart of the program.
    pub(super) fn restart(&mut self) {
        self.running = false;
        self.nested.clear();
        self.take_entries();
        self.fed_at = None;
    }

    pub(super) fn feed(&mut self, cycle: u64) {
        let since = self.fed_at.replace(cycle).map_or(0, |last| cycle - last);
        self.longest_unfed = self.longest_unfed.max(since);
    }

    pub(super) fn event(&mut self, basepri: u8) {
        if self.running {
            *self.events_by_basepri.entry(basepri).or_default() += 1;
        }
    }

    pub(super) fn delay(&mut self, cycles: u64) {
        *self.delays.entry(cycles).or_default() += 1;
    }

    pub(super) fn command(&mut self, cycles: u64) {
        self.commands.add(cycles);
    }

    /// Whether [`steps`](Self::steps) can note several instructions of this exception together.
    pub(super) fn takes_steps(&self, exception: u16) -> bool {
        let inside = self.nested.last().map_or(0, |(number, _)| *number);
        inside == exception && self.profile.is_none() && self.marks.is_empty()
    }

    /// Notes several instructions of the running exception, all with the same PRIMASK and BASEPRI.
    pub(super) fn steps(
        &mut self,
        instructions: u64,
        cycles: u64,
        (primask, basepri): (bool, u8),
        lowest_stack: u32,
    ) {
        self.lowest_stack = self.lowest_stack.min(lowest_stack);
        if let Some((_, spent)) = self.nested.last_mut() {
            *spent += cycles;
        }
        if self.running {
            self.masked = if basepri == 0 { 0 } else { self.masked + cycles };
            self.longest_mask = self.longest_mask.max(self.masked);
            let forbidden = (1..=SAMPLE_PRIORITY).contains(&basepri);
            self.primask += if primask { instructions } else { 0 };
            self.forbidden_basepri += if forbidden { instructions } else { 0 };
        }
    }

    /// Notes a step. `still_active` tells whether the exception with a given number is still active.
    pub(super) fn step(&mut self, step: &Step, still_active: impl Fn(u16) -> bool) {
        self.lowest_stack = self.lowest_stack.min(step.stack);
        if step.exception == SAMPLE
            && let Some(profile) = &mut self.profile
        {
            *profile.entry(step.pc).or_default() += step.cycles;
            self.run.push((step.pc, step.cycles));
        }
        if step.exception == SAMPLE && self.marks.contains(&step.pc) {
            self.in_marks += step.cycles;
        }
        let inside = self.nested.last().map_or(0, |(number, _)| *number);
        if step.exception == inside {
            if let Some((_, spent)) = self.nested.last_mut() {
                *spent += step.cycles;
            }
        } else {
            // Cycles of a return belong to the exception that ends. Cycles of an entry belong to the exception that
            // begins. Tail-chaining is a return and an entry in one step, and is treated as an entry.
            let returns = self.nested.iter().any(|(number, _)| *number == step.exception)
                || step.exception == 0;
            if returns && let Some((_, spent)) = self.nested.last_mut() {
                *spent += step.cycles;
            }
            while let Some(&(number, spent)) = self.nested.last() {
                if number == step.exception || still_active(number) {
                    break;
                }
                if number == SAMPLE && self.profile.is_some() {
                    let run = std::mem::take(&mut self.run);
                    if self.tasks.get(&SAMPLE).is_none_or(|task| task.most < spent) {
                        self.longest = run;
                    }
                }
                self.tasks.entry(number).or_default().add(spent);
                if number == SAMPLE && !self.marks.is_empty() {
                    let marked = std::mem::take(&mut self.in_marks);
                    self.marked.add(marked);
                    self.unmarked.add(spent.saturating_sub(marked));
                }
                self.nested.pop();
            }
            if !returns {
                self.nested.push((step.exception, step.cycles));
            }
        }
        self.running |= step.exception == SAMPLE;
        if self.running {
            self.masked = if step.basepri == 0 { 0 } else { self.masked + step.cycles };
            self.longest_mask = self.longest_mask.max(self.masked);
            self.primask += u64::from(step.primask);
            self.forbidden_basepri += u64::from((1..=SAMPLE_PRIORITY).contains(&step.basepri));
        }
    }
}

/// Restores ITSTATE in a stacked xPSR, which the emulator loses on exception entry. Code that was preempted inside an
/// IT block would otherwise resume wrongly.
pub(super) fn mend_itstate(
    ram: &RamStore,
    msp: u32,
    old_pc: u32,
    old_xpsr: u32,
    watch: &mut Watch,
) {
    let at = u64::from(msp.wrapping_sub(RAM));
    let word = |offset: u64| {
        let mut bytes = [0; 4];
        ram.read_at(at + offset, &mut bytes).map(|()| u32::from_le_bytes(bytes)).unwrap_or_default()
    };
    if word(24) == old_pc {
        let mended = word(28) | old_xpsr & IT_BITS;
        if ram.write_at(at + 28, &mended.to_le_bytes()).is_ok() {
            watch.mended += 1;
        }
    }
}
