//! The task `render`, with priority 14. `sample` requests it once per output period. It moves data between the renderer
//! and the board.

use core::{hint::cold_path, sync::atomic::Ordering::Relaxed};

use heapless::spsc::{Consumer, Producer};
use zwidth::{
    LoopParameters, Motion,
    contract::{
        self, DebugHalts as _, FaultMemory as _, OutputWatchdog as _, ReadBack as _, SetUp as _,
    },
    device::HISTORY,
    experiment::{PeriodPlan, Report},
    period,
    renderer::{Renderer, Sampling},
    safety::{
        BlackBox, CurrentWatch, Doubled, Fault, FaultSet, Guard, GuardCommand, GuardView,
        MemoryUpdate, OutputCommand, OutputWatch, Rendered, SampleReport, Sensed, Supervisor,
        Written,
    },
    store::Signs,
    telemetry::Record,
};

use super::{FLAGS, Numbered, ORDERS, REPORTS, sample::Sampling as Block};
use crate::board::{
    self, Drive, EmergencyStop, FaultMemory, Halts, OutputWatchdog, ReadBack, SetUp, Supply,
};
use crate::sync::{DoubleBufferWriter, SeqlockReader, Viewer, position_ring::Follower};

const LONGEST: u32 = period::PERIODS[period::PERIODS.len() - 1];

pub struct Outputs {
    pub drive: Drive,
    pub stop: EmergencyStop,
    pub supply: Supply,
    pub halts: Halts,
    pub output_watchdog: OutputWatchdog,
    pub set_up: SetUp,
    pub read_back: ReadBack,
    pub memory: FaultMemory,
}

/// The ends of queues and buffers that the task `render` holds.
pub struct Ends {
    /// Reports from `sample`, one per output.
    pub due: SeqlockReader<SampleReport>,
    /// The guard's findings from `sample`, when they have changed.
    pub guard: SeqlockReader<Guard>,
    pub sampling: ToSample,
    /// Access for reading to the sampler, which `sample` owns.
    pub sampler: Viewer<Block>,
    pub orders: Consumer<'static, Numbered, ORDERS>,
    pub reports: Producer<'static, Report, REPORTS>,
}

/// The ends that lead to `sample`.
pub struct ToSample {
    /// The loop's parameters. They are written when they change.
    pub control: DoubleBufferWriter<LoopParameters>,
    /// The command for the guard. It is written with every output.
    pub down: DoubleBufferWriter<GuardCommand>,
}

impl Sampling for ToSample {
    #[inline(always)]
    fn set_parameters(&mut self, parameters: LoopParameters) {
        self.control.publish(parameters);
    }

    #[inline(always)]
    fn command(&mut self, command: GuardCommand) {
        self.down.publish(command);
    }

    fn turn_encoder(&mut self, reversed: bool) {
        board::turn_encoder(reversed);
    }
}

/// The task `render`. Only this task writes the force output.
pub struct Render {
    outputs: Outputs,
    ends: Ends,
    guard: GuardView,
    positions: Follower,
    renderer: Renderer<HISTORY>,
    /// Number of the last order that was carried out.
    met: u32,
    /// Faults that were found after the last checked output. `checked` is the number of this output's sample.
    found: FaultSet,
    checked: u32,
    /// Whether the last check was that of the numbers of loop and supervisor. See [`check`](Self::check).
    numbers_next: bool,
    /// The code that the last output has written, or `None` if the output was off.
    written: Option<Written>,
    /// The checks of the output's voltage and of the motor's current. `misses` and `mean` are their state.
    acts: Doubled<(Option<OutputWatch>, Option<CurrentWatch>)>,
    misses: u8,
    mean: i32,
}

impl Render {
    pub(super) fn new(
        outputs: Outputs,
        ends: Ends,
        supervisor: Supervisor,
        control: LoopParameters,
        signs: Signs,
        PeriodPlan { duty, keep }: PeriodPlan,
        acts: (Option<OutputWatch>, Option<CurrentWatch>),
    ) -> Self {
        let history = BlackBox::new(keep);
        Self {
            outputs,
            ends,
            guard: GuardView::NOTHING,
            positions: Follower::new(),
            renderer: Renderer::new(supervisor, control, signs, duty, history),
            met: 0,
            found: FaultSet::EMPTY,
            checked: 0,
            numbers_next: false,
            written: None,
            acts: Doubled::new(acts),
            misses: 0,
            mean: 0,
        }
    }

    /// Computes and writes the output for the newest due sample. Then does everything that can wait until the force is
    /// written.
    ///
    /// If this output is late by a period, `sample` switches off, and the fault `late render` is latched.
    #[inline(always)]
    pub fn run(&mut self) {
        let Some(up) = self.ends.due.read() else { return };
        let number = up.motion.number();
        let read = self.begin_read_back();
        let (sensed, guard) = self.sense(&up);

        let proposal = self.renderer.propose();
        let drive = self.renderer.answer(up.motion, proposal);
        let rendered = self.renderer.grant(&up, &guard, (proposal, drive), sensed);
        self.put_out(rendered.grant);

        self.outputs.output_watchdog.renew(number, sensed.halted);
        self.ends.sampling.command(self.renderer.command());
        FLAGS.rendered.store(number, Relaxed);
        self.check(number, read);
        self.remember();
        let record = self.follow(&rendered, up.motion);
        self.meet_order();
        if self.ends.reports.ready() {
            // There is room in the queue, and no other task writes to it, so the call cannot fail.
            let _ = self.ends.reports.enqueue(self.renderer.report(record));
        }
        board::request_link();
    }

    /// Starts the read-back while the output is computed. Returns the code that the read-back should find.
    #[inline(always)]
    fn begin_read_back(&mut self) -> Option<Written> {
        self.outputs.read_back.begin();
        self.written.filter(|_| self.outputs.drive.is_on())
    }

    /// Reads the board's inputs, and then the guard's findings. So if `sample` has switched off, the reason is among
    /// the findings.
    #[inline(always)]
    fn sense(&mut self, up: &SampleReport) -> (Sensed, Guard) {
        let Outputs { drive, stop, supply, halts, .. } = &mut self.outputs;
        // At every output period the limit for a halt is that of the longest period. So the limit is a fixed time.
        let sensed = contract::sense(
            (self.written.is_some(), self.found),
            (up.motion.sample, LONGEST),
            drive,
            stop,
            supply,
            halts,
        );
        if let Some((guard, number)) = self.ends.guard.read_numbered() {
            self.guard.take(guard, number);
        }
        (sensed, self.guard.at(up.motion.number()))
    }

    #[inline(always)]
    fn remember(&mut self) {
        match self.renderer.take_memory_update() {
            Some(MemoryUpdate::Write(record)) => self.outputs.memory.write(&record.to_words()),
            Some(MemoryUpdate::Erase) => self.outputs.memory.erase(),
            None => {}
        }
    }

    #[inline(always)]
    fn follow(&mut self, rendered: &Rendered, motion: Motion) -> Record {
        self.positions.follow_to(motion.sample);
        let positions = core::iter::from_fn(|| self.positions.read());
        self.renderer.follow(rendered, motion.position, positions)
    }

    #[inline(always)]
    fn meet_order(&mut self) {
        if !self.renderer.is_ready() {
            return;
        }
        let Some(Numbered { number, order }) = self.ends.orders.dequeue() else { return };
        let is_next = number == self.met.wrapping_add(1);
        self.met = number;
        if !is_next {
            cold_path();
            self.lose_order();
            return;
        }
        self.renderer.meet(order, &mut self.ends.sampling);
        if self.written.is_some() && self.renderer.is_off() {
            self.put_out(OutputCommand::Off);
        }
    }

    /// Switches off at once if a number or register that decides about the force has changed. The next output reports
    /// the change. A late output leaves these checks to a later output. If a millisecond has passed since the last
    /// check, all numbers and registers are checked. Otherwise the checks alternate: numbers of loop and supervisor,
    /// then those of the experiment and the registers.
    #[inline(always)]
    fn check(&mut self, number: u32, was: Option<Written>) {
        let passed = number.wrapping_sub(self.checked);
        let all = passed >= period::SAMPLES_PER_MS;
        if !all && board::is_late() {
            return;
        }
        self.checked = number;
        self.numbers_next = !self.numbers_next;
        let whole = !(all || self.numbers_next)
            || self.renderer.is_whole(self.ends.sampling.control.newest())
                && self.ends.sampler.look(|sampler| {
                    sampler.sampler().remembers(self.ends.sampling.control.newest())
                })
                && self.acts.is_whole()
                && self.outputs.set_up.channels_hold();
        let (experiment, set_up) = match !all && self.numbers_next {
            true => (true, true),
            false => (self.renderer.experiment_is_whole(), self.outputs.set_up.holds()),
        };
        // If a task has switched off since then, the reading may belong to zero force.
        let was = was.filter(|_| self.outputs.drive.is_on());
        let read = self.outputs.read_back.finish();
        let (output, current) = &*self.acts;
        let output = output.is_some_and(|watch| watch.follow(&mut self.misses, was, read.output));
        let current =
            current.is_some_and(|watch| watch.follow(&mut self.mean, was, (read.current, passed)));
        // Both functions must be called each time, so `||` is not used.
        let rate =
            self.outputs.halts.rate_is_wrong() | self.outputs.output_watchdog.rate_is_wrong();
        self.found = FaultSet::EMPTY
            .with_if(Fault::Registers, !set_up)
            .with_if(Fault::Memory, !(whole && experiment))
            .with_if(Fault::SampleRate, rate)
            .with_if(Fault::ForceOutput, output)
            .with_if(Fault::MotorCurrent, current);
        if !self.found.is_empty() {
            cold_path();
            board::off();
            if self.found.contains(Fault::Registers) {
                self.outputs.set_up.hold_enable_low();
            }
        }
    }

    /// Switches off, because an order has changed on its way or was lost. The next output reports it.
    #[cold]
    fn lose_order(&mut self) {
        board::off();
        self.found = self.found.with(Fault::Memory);
        self.renderer.refuse();
    }

    #[inline(always)]
    fn put_out(&mut self, grant: OutputCommand) {
        match grant {
            OutputCommand::Off => {
                board::off();
                self.written = None;
            }
            OutputCommand::On(granted) => {
                if self.written.is_none() {
                    self.outputs.drive.on();
                }
                let (command, mirrored) = (granted.command(), self.renderer.motor_reversed());
                self.outputs.drive.write(command, mirrored);
                self.written = Some(Written { command, mirrored });
            }
        }
    }
}
