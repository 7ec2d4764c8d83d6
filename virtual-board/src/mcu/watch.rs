//! What is seen from outside, instruction by instruction, without touching the program: interrupt
//! masks, the sampling delay, cycles per task, the lowest stack pointer.

use std::collections::{BTreeMap, BTreeSet};

use rsemu::core::space::RamStore;

use super::{IT_BITS, RAM};

/// Exception number of the sampling task: TIM5 is interrupt 50.
pub const SAMPLE: u16 = 16 + 50;
/// Exception number of the output task: SPI3 is interrupt 51.
pub const RENDER: u16 = 16 + 51;
/// Exception number of the link task: SPI2 is interrupt 36.
pub const LINK: u16 = 16 + 36;

/// Hardware priority of the sampling task; a BASEPRI of 1 to this would mask it.
const SAMPLE_PRIORITY: u8 = 0x10;

/// Cycles of one kind of exception, from its entry to its return, without what preempted it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cycles {
    /// How often it ran.
    pub runs: u64,
    /// Cycles of the shortest run.
    pub least: u64,
    /// Cycles of the longest run.
    pub most: u64,
    /// Cycles of all runs together.
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

    /// Mean of all runs.
    #[expect(clippy::cast_precision_loss, reason = "for people to read")]
    pub fn mean(&self) -> f64 {
        self.total as f64 / self.runs.max(1) as f64
    }
}

/// What was seen since the watch was last cleared. Masks and delays count from the first sample.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    /// Instructions with PRIMASK set after the first sample.
    pub primask: u64,
    /// Instructions with a BASEPRI that masks the sampling task.
    pub forbidden_basepri: u64,
    /// Longest time with a BASEPRI that masks anything, cycles.
    pub longest_mask: u64,
    /// Sampling events by the BASEPRI that was up when they came (0: none).
    pub events_by_basepri: BTreeMap<u8, u64>,
    /// Cycles from the sampling event to the reading of the counter: how often each.
    pub delays: BTreeMap<u64, u64>,
    /// Cycles from the sampling event to each writing of a force to the output's registers by the
    /// output task.
    pub commands: Cycles,
    /// Cycles of each task, by exception number.
    pub tasks: BTreeMap<u16, Cycles>,
    /// Times that the emulator's loss of ITSTATE was mended.
    pub mended: u64,
    /// Longest time from one feeding of the watchdog to the next, cycles.
    pub longest_unfed: u64,
    fed_at: Option<u64>,
    /// Lowest main stack pointer.
    pub lowest_stack: u32,
    /// Cycles of the sampling task by the address of the instruction, if asked for.
    pub profile: Option<BTreeMap<u32, u64>>,
    /// The longest run of the sampling task, address and cycles of each instruction; with the profile.
    pub longest: Vec<(u32, u64)>,
    run: Vec<(u32, u64)>,
    /// Instructions of the sampling task whose cycles are to be told apart.
    pub marks: BTreeSet<u32>,
    /// The cycles of those, by run of the sampling task.
    pub marked: Cycles,
    /// The cycles of all others.
    pub unmarked: Cycles,
    in_marks: u64,
    /// Tasks as they began, if those are wanted, and the addresses of the words that are noted with each.
    entries: Option<([u32; 3], Vec<Entry>)>,
    masked: u64,
    running: bool,
    /// Running exceptions, innermost last: number, cycles spent in it.
    nested: Vec<(u16, u64)>,
}

/// A task begins, or none runs any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Exception number; 0: none runs.
    pub exception: u16,
    /// The words of RAM that are noted.
    pub words: [u32; 3],
}

/// One step of the core.
pub(super) struct Step {
    pub(super) cycles: u64,
    pub(super) exception: u16,
    pub(super) primask: bool,
    pub(super) basepri: u8,
    pub(super) stack: u32,
    /// Address of the instruction.
    pub(super) pc: u32,
}

impl Watch {
    pub(super) fn new() -> Self {
        Self { lowest_stack: u32::MAX, ..Self::default() }
    }

    /// Forgets what was seen; what is running goes on.
    pub fn clear(&mut self) {
        let running = self.running;
        let nested = std::mem::take(&mut self.nested);
        let marks = std::mem::take(&mut self.marks);
        let fed_at = self.fed_at;
        let entries = self.entries.take();
        *self = Self { running, nested, marks, fed_at, entries, ..Self::new() };
    }

    /// Notes the tasks as they begin, from now on, each with the words of RAM at `addresses`.
    pub fn note_entries(&mut self, addresses: [u32; 3]) {
        self.entries = Some((addresses, Vec::new()));
    }

    /// The tasks that began since this was asked, in order.
    pub fn take_entries(&mut self) -> Vec<Entry> {
        self.entries.as_mut().map_or_else(Vec::new, |(_, entries)| std::mem::take(entries))
    }

    /// The words that are to be noted, if they are.
    pub(super) fn noted(&self) -> Option<[u32; 3]> {
        self.entries.as_ref().map(|(addresses, _)| *addresses)
    }

    pub(super) fn enter(&mut self, exception: u16, words: [u32; 3]) {
        if let Some((_, entries)) = &mut self.entries {
            entries.push(Entry { exception, words });
        }
    }

    /// An exception runs, or was preempted.
    pub(super) fn is_active(&self, exception: u16) -> bool {
        self.nested.iter().any(|(number, _)| *number == exception)
    }

    /// The exception that runs; 0: none.
    pub fn innermost(&self) -> u16 {
        self.nested.last().map_or(0, |(number, _)| *number)
    }

    /// Longest minus shortest sampling delay, cycles.
    pub fn delay_spread(&self) -> u64 {
        match (self.delays.first_key_value(), self.delays.last_key_value()) {
            (Some((least, _)), Some((most, _))) => most - least,
            _ => 0,
        }
    }

    /// The program begins anew.
    pub(super) fn restart(&mut self) {
        self.running = false;
        self.nested.clear();
        self.take_entries();
        self.fed_at = None;
    }

    /// The watchdog is fed.
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

    /// Whether instructions of this exception can be told together, by [`steps`](Self::steps).
    pub(super) fn takes_steps(&self, exception: u16) -> bool {
        let inside = self.nested.last().map_or(0, |(number, _)| *number);
        inside == exception && self.profile.is_none() && self.marks.is_empty()
    }

    /// Several instructions of the running exception, in which PRIMASK and BASEPRI have not changed.
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

    /// `still_active` says whether an exception is still active, if the number changes.
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
            // The cycles of a return belong to the exception that ends, those of an entry to the
            // one that begins; tail-chaining is both in one step and counts as an entry.
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

/// The emulator drops ITSTATE from the xPSR that it stacks on exception entry, so that code
/// preempted inside an IT block resumes wrongly: put it back.
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
