//! The firmware's library without a chip. Console, renderer, supervisor and sampler are connected like the firmware's
//! three tasks. The caller decides when each task runs, what the encoder's counter reads, and how the switches are set.

use std::collections::VecDeque;

use zwidth::{
    CounterWidth, LoopParameters, SettingsError,
    console::{Console, Port},
    device::{Device, HISTORY, Start},
    experiment::{Order, Report},
    renderer::{Renderer, Sampling},
    safety::{
        BlackBox, FaultRecord, FaultSet, Guard, GuardCommand, GuardView, GuardedSampler,
        MemoryUpdate, OutputCommand, ResetCause, SampleReport, Sensed, Supervisor, boot_fault,
    },
    self_test::{Found, Part},
    store::{Loaded, Source, Stored},
    units::{OutputCode, Position},
    velocity::Senses,
};

/// Number of samples whose positions are stored. It is the same as on a board.
const POSITIONS: usize = 256;
/// Largest number of outputs whose reports can wait for the console. It is the same as on a board.
const REPORTS: usize = 15;
/// Largest number of bytes that wait for the host.
const UNREAD: usize = 4096;

/// The memories that a reset keeps. They are the settings in flash and the words of the backup RAM.
#[derive(Clone, Copy, Debug, Default)]
pub struct Memories {
    flash: Option<Stored>,
    backup: [u32; FaultRecord::WORDS],
}

impl Memories {
    /// Simulates a loss of supply, after which only flash is kept.
    pub fn lose_power(&mut self) {
        self.backup = Default::default();
    }
}

#[derive(Clone)]
pub struct Channels {
    /// Bytes that the console has not read yet. The caller appends bytes.
    pub typed: VecDeque<u8>,
    /// Lines of replies that the host has not taken yet.
    pub replies: Vec<u8>,
    /// Frames of telemetry that the host has not taken yet.
    pub telemetry: Vec<u8>,
    positions: VecDeque<Position>,
    sampler: GuardedSampler,
    /// An order of the console that no output has carried out yet.
    pub order: Option<Order>,
    flash: Option<Stored>,
    in_force: LoopParameters,
}

/// Appends bytes to the host's buffer if all bytes fit. Returns whether all bytes fit.
fn put(up: &mut Vec<u8>, said: &[u8]) -> bool {
    let room = up.len() + said.len() <= UNREAD;
    if room {
        up.extend(said);
    }
    room
}

impl Port for Channels {
    const COMMIT: &'static str = "core without a chip";

    fn read(&mut self) -> Option<u8> {
        self.typed.pop_front()
    }

    fn write_line(&mut self, line: &str) -> bool {
        put(&mut self.replies, line.as_bytes())
    }

    fn write_frame(&mut self, frame: &[u8]) -> bool {
        put(&mut self.telemetry, frame)
    }

    fn samples(&mut self, newest: u64, places: &mut [Position]) -> Option<GuardedSampler> {
        // The newest stored position belongs to the sample before the sampler's next sample.
        let behind =
            usize::try_from(self.sampler.sampler().next().checked_sub(newest + 1)?).ok()?;
        let from = self.positions.len().checked_sub(behind + places.len())?;
        for (place, position) in places.iter_mut().zip(self.positions.range(from..)) {
            *place = *position;
        }
        Some(self.sampler)
    }

    fn order(&mut self, order: Order) -> bool {
        self.order.replace(order).is_none()
    }

    fn is_in_force(&mut self, asked: &LoopParameters) -> bool {
        asked.does_as(&self.in_force)
    }

    fn load(&mut self, defaults: Stored) -> Loaded {
        loaded(self.flash, defaults)
    }

    fn test(&mut self, _: Part) -> Found {
        Found::Clock(0) // not used: without a board a self-test is refused
    }

    fn save(&mut self, stored: &Stored) -> bool {
        self.flash = Some(*stored);
        true
    }
}

fn loaded(flash: Option<Stored>, defaults: Stored) -> Loaded {
    let source = if flash.is_some() { Source::Newest } else { Source::Empty };
    Loaded { stored: flash.unwrap_or(defaults), source, damaged: 0 }
}

/// Values that the output task has written for the sampling task.
#[derive(Clone)]
struct Down {
    parameters: LoopParameters,
    command: GuardCommand,
    encoder_reversed: bool,
}

impl Sampling for Down {
    fn set_parameters(&mut self, parameters: LoopParameters) {
        self.parameters = parameters;
    }

    fn command(&mut self, command: GuardCommand) {
        self.command = command;
    }

    fn turn_encoder(&mut self, reversed: bool) {
        self.encoder_reversed = reversed;
    }
}

/// The amplifier's enable, and the hardware that disables the amplifier without the program.
#[derive(Clone, Debug, Default)]
struct Enable {
    active: bool,
    stop_open: bool,
    /// Whether the emergency stop was open at some time since the amplifier was last enabled.
    stop_noted: bool,
    supply_low: bool,
    /// Whether the supply was low at some time since the last output checked it.
    supply_noted: bool,
}

#[derive(Clone)]
pub struct CoreProgram {
    console: Console<Channels>,
    renderer: Renderer<HISTORY>,
    guard: Guard,
    view: GuardView,
    down: Down,
    /// A sample for which an output is due and has not run.
    pub due: Option<SampleReport>,
    reports: VecDeque<Report>,
    /// The newest report that the console has read.
    pub newest: Option<Report>,
    /// Number of the sample of the last output.
    rendered: u64,
    /// The code of the last output. `None` if the output was off.
    written: Option<OutputCode>,
    enable: Enable,
    backup: [u32; FaultRecord::WORDS],
}

impl CoreProgram {
    /// Starts the program, with the encoder's counter at `counter`.
    ///
    /// # Errors
    /// A value of the device is out of range.
    pub fn start(
        device: &'static Device<'static>,
        memories: &Memories,
        cause: ResetCause,
        counter: u32,
    ) -> Result<Self, SettingsError> {
        let Memories { flash, mut backup } = *memories;
        let loaded = loaded(flash, device.defaults());
        let boot = boot_fault(&backup, cause);
        let Start { stored, source, control, safety, period, fault, .. } =
            device.start(&loaded, boot)?;
        if let Some(record) = fault {
            backup = record.to_words();
        }
        let channels = Channels {
            typed: VecDeque::new(),
            replies: Vec::new(),
            telemetry: Vec::new(),
            positions: VecDeque::new(),
            sampler: GuardedSampler::new(counter, CounterWidth::Bits32),
            order: None,
            flash,
            in_force: control,
        };
        let supervisor = Supervisor::new(safety, fault);
        let history = BlackBox::new(period.keep);
        Ok(Self {
            console: Console::new(channels, device, stored, source),
            renderer: Renderer::new(supervisor, control, stored.signs, period.duty, history),
            guard: Guard::NOTHING,
            view: GuardView::NOTHING,
            down: Down {
                parameters: control,
                command: GuardCommand::start(&safety),
                encoder_reversed: stored.signs.encoder_reversed,
            },
            due: None,
            reports: VecDeque::new(),
            newest: None,
            rendered: 0,
            written: None,
            enable: Enable::default(),
            backup,
        })
    }

    /// Runs the task `sample` with this reading of the counter. Returns whether an output is due.
    pub fn sample(&mut self, counter: u32) -> bool {
        let port = self.console.port();
        let Down { parameters, command, .. } = &self.down;
        let step = port.sampler.step(parameters, counter, &Senses::NONE, command, &mut self.guard);
        let motion = step.report.motion;
        if port.positions.len() == POSITIONS {
            port.positions.pop_front();
        }
        port.positions.push_back(motion.position);
        if step.told {
            self.view.take(self.guard, motion.number());
        }
        if step.cut {
            self.enable.active = false;
        }
        if step.due {
            self.due = Some(step.report);
        }
        step.due
    }

    /// Runs the task `render` for the newest due sample, if there is one. With `meets`, the task then carries out a
    /// waiting order.
    pub fn render(&mut self, meets: bool) {
        let Some(up) = self.due.take() else { return };
        let Enable { active, stop_open, stop_noted, supply_low, supply_noted } = &mut self.enable;
        let sensed = Sensed {
            switched_on: self.written.is_some(),
            halted: false,
            was_stopped: *stop_noted,
            stop_closed: !*stop_open,
            supply_good: !(std::mem::take(supply_noted) || *supply_low),
            enabled: *active,
            found: FaultSet::EMPTY,
        };
        let guard = self.view.at(up.motion.number());
        let proposal = self.renderer.propose();
        let asked = (proposal, self.renderer.answer(up.motion, proposal));
        let rendered = self.renderer.grant(&up, &guard, asked, sensed);
        self.put_out(rendered.grant);
        self.down.command = self.renderer.command();
        match self.renderer.take_memory_update() {
            Some(MemoryUpdate::Write(record)) => self.backup = record.to_words(),
            Some(MemoryUpdate::Erase) => self.backup = Default::default(),
            None => {}
        }
        let since = up.motion.sample.saturating_sub(self.rendered);
        self.rendered = up.motion.sample;
        let port = self.console.port();
        // Samples after this output's sample belong to the next output.
        let after = port.sampler.sampler().next() - 1 - up.motion.sample;
        let [since, after] = [since, after].map(|n| usize::try_from(n).unwrap_or(POSITIONS));
        let end = port.positions.len().saturating_sub(after);
        let positions = port.positions.range(end.saturating_sub(since)..end).copied();
        let record = self.renderer.follow(&rendered, up.motion.position, positions);
        if meets
            && self.renderer.is_ready()
            && let Some(order) = port.order.take()
        {
            self.renderer.meet(order, &mut self.down);
            port.in_force = self.down.parameters;
            if self.written.is_some() && self.renderer.is_off() {
                self.put_out(OutputCommand::Off);
            }
        }
        if self.reports.len() < REPORTS {
            self.reports.push_back(self.renderer.report(record));
        }
    }

    fn put_out(&mut self, grant: OutputCommand) {
        let OutputCommand::On(granted) = grant else {
            self.enable.active = false;
            self.written = None;
            return;
        };
        if self.written.is_none() {
            self.enable.stop_noted = self.enable.stop_open;
            self.enable.active = !self.enable.stop_open;
        }
        self.written = Some(granted.command());
    }

    /// Passes the next report of `render` to the console. Returns false if there is none.
    pub fn report(&mut self) -> bool {
        let Some(report) = self.reports.pop_front() else { return false };
        self.console.report(&report);
        self.newest = Some(report);
        true
    }

    /// Runs the last part of the task `link`, which is the console.
    pub fn pass(&mut self, listens: bool) {
        self.console.pass(listens);
    }

    /// The program's side of the link.
    pub fn channels(&mut self) -> &mut Channels {
        self.console.port()
    }

    /// Whether the console waits for the output task's answer to an order.
    pub fn is_waiting(&self) -> bool {
        self.console.is_waiting()
    }

    /// The console's copy of the settings.
    pub fn stored(&self) -> &Stored {
        self.console.stored()
    }

    /// The memories as a reset at this time would leave them.
    pub fn memories(&mut self) -> Memories {
        Memories { flash: self.console.port().flash, backup: self.backup }
    }

    pub fn emergency_stop(&mut self, open: bool) {
        self.enable.stop_open = open;
        self.enable.stop_noted |= open;
        self.enable.active &= !open;
    }

    /// Lets the supply fall below the detector's level or rise above it.
    pub fn supply(&mut self, low: bool) {
        self.enable.supply_noted |= low && !self.enable.supply_low;
        self.enable.supply_low = low;
        self.enable.active &= !low;
    }

    pub fn is_enabled(&self) -> bool {
        self.enable.active
    }

    /// The output code, counted from zero force. It includes the sign that corrects the motor's mounting direction.
    /// `None` while the output is off.
    pub fn output(&self) -> Option<i32> {
        let code = self.written?.code() - self.down.parameters.actuator.zero().code();
        Some(if self.renderer.motor_reversed() { -code } else { code })
    }

    /// The output as a fraction of full scale. `None` while the output is off.
    pub fn output_part(&self) -> Option<f64> {
        let full = f64::from(self.down.parameters.actuator.codes_per_full_scale());
        self.output().map(|code| f64::from(code) / full)
    }

    /// Number of samples per output.
    pub fn period(&self) -> u32 {
        self.down.parameters.period.get()
    }

    pub fn is_encoder_reversed(&self) -> bool {
        self.down.encoder_reversed
    }
}
