//! The firmware's library on a simulated device, without a chip: the same console, supervisor, experiments and core as in
//! the release image, moved sample by sample around the simulator's plant. It says nothing about instructions, registers
//! or flash, and needs a hundredth of the time.

use std::{cell::RefCell, collections::VecDeque, rc::Rc, sync::Arc};

use host_sim::{
    error::Error,
    plant::{AnyPlant, AnyState, Moment, Plant as _},
    scene::{
        NamedScene,
        record::{board_facts, words},
    },
    simulation::{Parts, prepared::PreparedScene},
};
use zwidth::{
    CounterWidth, LoopParameters,
    console::{Console, Port},
    device::{Device, HISTORY, Start},
    experiment::Order,
    renderer::{Renderer, Sampling},
    safety::{
        BlackBox, FaultSet, Guard, GuardCommand, GuardView, GuardedSampler, OutputCommand,
        SampleReport, Sensed, Supervisor,
    },
    self_test::{Found, Part},
    store::{Loaded, Source, Stored},
    units::Position,
    velocity::Senses,
};

#[cfg(test)]
mod tests;

use super::{
    REPLIES, TELEMETRY,
    wires::{SLICE, Seen, WiredLink, Wires},
};
use crate::{board::Board, device, world::Finger};

/// Samples whose positions are kept, as on a board.
const KEPT: u64 = 256;
/// Bytes of the channel of commands, as on a board.
const TYPED: usize = 255;
/// While a hand holds the handle at the scene's 0: until the program has begun, then until the zero is met.
const HELD_SAMPLES: u64 = 600;

/// What console and tasks share.
struct Shared {
    typed: VecDeque<u8>,
    wires: Arc<Wires>,
    positions: VecDeque<Position>,
    sampler: GuardedSampler,
    order: Option<Order>,
    flash: Option<Stored>,
    in_force: LoopParameters,
}

/// The console's end.
struct Channels(Rc<RefCell<Shared>>);

impl Port for Channels {
    const COMMIT: &'static str = "core without a chip";

    fn read(&mut self) -> Option<u8> {
        self.0.borrow_mut().typed.pop_front()
    }

    fn write_line(&mut self, line: &str) -> bool {
        self.0.borrow().wires.put(REPLIES, line.as_bytes())
    }

    fn write_frame(&mut self, frame: &[u8]) -> bool {
        self.0.borrow().wires.put(TELEMETRY, frame)
    }

    fn samples(&mut self, newest: u64, places: &mut [Position]) -> Option<GuardedSampler> {
        let Shared { positions, sampler, .. } = &*self.0.borrow();
        // The last one that is kept is that before the sampler's next.
        let behind = usize::try_from(sampler.sampler().next().checked_sub(newest + 1)?).ok()?;
        let from = positions.len().checked_sub(behind + places.len())?;
        for (place, position) in places.iter_mut().zip(positions.range(from..)) {
            *place = *position;
        }
        Some(*sampler)
    }

    fn order(&mut self, order: Order) -> bool {
        self.0.borrow_mut().order.replace(order).is_none()
    }

    fn is_in_force(&mut self, asked: &LoopParameters) -> bool {
        asked.does_as(&self.0.borrow().in_force)
    }

    fn load(&mut self, defaults: Stored) -> Loaded {
        let flash = self.0.borrow().flash;
        let source = if flash.is_some() { Source::Newest } else { Source::Empty };
        Loaded { stored: flash.unwrap_or(defaults), source, damaged: 0 }
    }

    fn test(&mut self, _: Part) -> Found {
        Found::Clock(0) // never asked: there is no board to test
    }

    fn save(&mut self, stored: &Stored) -> bool {
        self.0.borrow_mut().flash = Some(*stored);
        true
    }
}

/// The sampling task's side of what goes down to it.
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

/// The device of a scene on a board, kept for good as an image's record is; of the board's own scene the image's.
fn device_of(scene: &NamedScene, board: Board) -> Result<&'static Device<'static>, Error> {
    let Some(record) = device::record(scene, board)? else { return Ok(device::built_in(board)) };
    let words = words(&record).leak();
    let device = Device::from_record(words, &board_facts(board.name)?).map_err(Error::input)?;
    Ok(Box::leak(Box::new(device)))
}

/// The library in a loop with a device.
pub struct CoreBoard {
    console: Console<Channels>,
    shared: Rc<RefCell<Shared>>,
    renderer: Renderer<HISTORY>,
    sampler: GuardedSampler,
    guard: Guard,
    view: GuardView,
    down: Down,
    parts: Parts<AnyPlant>,
    state: AnyState,
    rate_hz: f64,
    samples: u64,
    /// The sample of the last output.
    followed: u64,
    /// The output task has the force on.
    written: bool,
    /// The amplifier's enable, and whether it has dropped by the stop since it was switched on.
    enabled: bool,
    was_stopped: bool,
    disabled_at: Option<u64>,
    stop_open: bool,
    /// Forces on their way, N, each with the sample within which it takes effect; the one that acts.
    on_the_way: VecDeque<(u64, f64)>,
    acting_n: f64,
    finger: Option<Finger>,
    line: Vec<u8>,
    wires: Arc<Wires>,
}

impl CoreBoard {
    /// Switches it on: a hand has zeroed it at the scene's 0 and has just let it go. `board` says what the device record
    /// has to go with.
    ///
    /// # Errors
    /// The scene goes with no record of that board.
    pub fn start(scene: &NamedScene, board: Board) -> Result<Self, Error> {
        let device = device_of(scene, board)?;
        let prepared = PreparedScene::new(&scene.scene)?;
        let parts = prepared.parts().clone();
        let defaults = device.defaults();
        let loaded = Loaded { stored: defaults, source: Source::Empty, damaged: 0 };
        let Start { stored, source, control, safety, period, .. } =
            device.start(&loaded, None).map_err(Error::input)?;
        let state = parts.plant.at_rest(0.0);
        let count = parts.encoder.count(0.0);
        let sampler = GuardedSampler::new(count.cast_unsigned(), CounterWidth::Bits32);
        let wires = Arc::new(Wires::default());
        let shared = Rc::new(RefCell::new(Shared {
            typed: VecDeque::new(),
            wires: Arc::clone(&wires),
            positions: VecDeque::new(),
            sampler,
            order: None,
            flash: None,
            in_force: control,
        }));
        let supervisor = Supervisor::new(safety, None);
        let history = BlackBox::new(period.keep);
        let mut board = Self {
            console: Console::new(Channels(Rc::clone(&shared)), device, stored, source),
            shared,
            renderer: Renderer::new(supervisor, control, stored.signs, period.duty, history),
            sampler,
            guard: Guard::NOTHING,
            view: GuardView::NOTHING,
            down: Down {
                parameters: control,
                command: GuardCommand::start(&safety),
                encoder_reversed: stored.signs.encoder_reversed,
            },
            parts,
            state,
            rate_hz: scene.scene.control.rate_hz,
            samples: 0,
            followed: 0,
            written: false,
            enabled: false,
            was_stopped: false,
            disabled_at: None,
            stop_open: false,
            on_the_way: VecDeque::new(),
            acting_n: 0.0,
            finger: None,
            line: vec![],
            wires,
        };
        board.zero();
        Ok(board)
    }

    /// Held at the scene's 0, zeroed there and let go; what it says meanwhile nobody hears.
    fn zero(&mut self) {
        for n in 0..HELD_SAMPLES {
            self.sample();
            self.state = self.parts.plant.at_rest(0.0);
            if n == HELD_SAMPLES / 2 {
                self.shared.borrow_mut().typed.extend(b"zero\n");
            }
        }
        for channel in [REPLIES, TELEMETRY] {
            self.wires.attend(channel, false);
        }
    }

    /// A millisecond on the board; `speed` for those who look: seconds there for each second here.
    pub fn millisecond(&mut self, speed: f64) {
        self.finger = self.wires.finger();
        self.stop_open = self.wires.is_stop_open();
        self.hear();
        for _ in 0..SLICE {
            self.sample();
        }
        self.look(speed);
    }

    /// What is typed; a board that is none has nothing to test.
    fn hear(&mut self) {
        let mut shared = self.shared.borrow_mut();
        let room = TYPED.saturating_sub(shared.typed.len());
        for byte in self.wires.typed(room) {
            if byte != b'\n' {
                self.line.push(byte);
                continue;
            }
            if self.line.trim_ascii() == b"selftest" {
                shared.wires.put(REPLIES, b"error: selftest: the core runs here without a board\n");
            } else {
                shared.typed.extend(&self.line);
                shared.typed.push_back(b'\n');
            }
            self.line.clear();
        }
        self.line.truncate(TYPED); // a line without an end is none
    }

    /// One sample: the count first, then the output if one is due, then the plant.
    fn sample(&mut self) {
        let force_n = |given: f64, enabled: bool| if enabled { given } else { 0.0 };
        if self.stop_open && self.enabled {
            self.was_stopped = true;
            self.drop_enable();
        }
        let index = self.samples;
        let next_n = self.on_the_way.front().filter(|(at, _)| *at == index);
        let next_n = next_n.map_or(self.acting_n, |(_, force_n)| *force_n);
        let moment = Moment { index, before_n: self.acting_n, after_n: next_n };
        let count = self.parts.encoder.count(self.parts.plant.reading_m(&self.state, &moment));
        let count = if self.down.encoder_reversed { count.wrapping_neg() } else { count };
        let step = self.sampler.step(
            &self.down.parameters,
            count.cast_unsigned(),
            &Senses::NONE,
            &self.down.command,
            &mut self.guard,
        );
        let motion = step.report.motion;
        if step.told {
            self.view.take(self.guard, motion.number());
        }
        if step.cut {
            self.drop_enable();
        }
        {
            let mut shared = self.shared.borrow_mut();
            shared.sampler = self.sampler;
            shared.positions.push_back(motion.position);
            if shared.positions.len() as u64 > KEPT {
                shared.positions.pop_front();
            }
        }
        if step.due {
            self.output(&step.report);
        }
        let finger_n = self.finger_n();
        let before_n = force_n(self.acting_n, self.enabled) + finger_n;
        let arriving = self.on_the_way.front().copied().filter(|(at, _)| *at <= index);
        self.state = match arriving {
            None => self.parts.plant.advance(&self.state, before_n),
            Some((_, arriving_n)) => {
                self.on_the_way.pop_front();
                self.acting_n = arriving_n;
                let after_n = force_n(arriving_n, self.enabled) + finger_n;
                self.parts.plant.advance_split(&self.state, before_n, after_n)
            }
        };
        self.samples += 1;
    }

    /// As the firmware's output task and its link do it.
    fn output(&mut self, report: &SampleReport) {
        let motion = report.motion;
        let sensed = Sensed {
            switched_on: self.written,
            halted: false,
            was_stopped: std::mem::take(&mut self.was_stopped),
            stop_closed: !self.stop_open,
            supply_good: true,
            enabled: self.enabled,
            found: FaultSet::EMPTY,
        };
        let guard = self.view.at(motion.number());
        let proposal = self.renderer.propose();
        let asked = (proposal, self.renderer.answer(motion, proposal));
        let rendered = self.renderer.grant(report, &guard, asked, sensed);
        self.put_out(rendered.grant);
        self.down.command = self.renderer.command();
        self.renderer.take_memory_update(); // there is no reset to outlive
        let new: Vec<Position> = {
            let shared = self.shared.borrow();
            let count = motion.sample.saturating_sub(self.followed);
            let kept = shared.positions.len();
            let from = kept.saturating_sub(usize::try_from(count).unwrap_or(kept));
            shared.positions.range(from..).copied().collect()
        };
        self.followed = motion.sample;
        let record = self.renderer.follow(&rendered, motion.position, new.into_iter());
        let order = match self.renderer.is_ready() {
            true => self.shared.borrow_mut().order.take(),
            false => None,
        };
        if let Some(order) = order {
            self.renderer.meet(order, &mut self.down);
            if self.written && self.renderer.is_off() {
                self.put_out(OutputCommand::Off);
            }
        }
        self.shared.borrow_mut().in_force = self.down.parameters;
        self.console.report(&self.renderer.report(record));
        self.console.pass(true);
    }

    fn put_out(&mut self, grant: OutputCommand) {
        let OutputCommand::On(granted) = grant else {
            self.drop_enable();
            self.written = false;
            return;
        };
        if !self.written {
            self.enabled = !self.stop_open;
            self.was_stopped = self.stop_open;
            self.written = true;
        }
        let actuator = &self.down.parameters.actuator;
        let code = granted.command().code() - actuator.zero().code();
        let part = f64::from(code) / f64::from(actuator.codes_per_full_scale());
        let part = if self.renderer.motor_reversed() { -part } else { part };
        let at = self.samples + u64::from(self.parts.latency);
        self.on_the_way.push_back((at, part * self.parts.full_scale_n));
    }

    fn drop_enable(&mut self) {
        if self.enabled {
            self.disabled_at = Some(self.samples);
        }
        self.enabled = false;
        self.acting_n = 0.0;
        self.on_the_way.clear();
    }

    fn finger_n(&self) -> f64 {
        let plant = &self.parts.plant;
        self.finger.map_or(0.0, |finger| {
            finger.force_n(plant.position_m(&self.state), plant.speed_m_per_s(&self.state))
        })
    }

    fn look(&self, speed: f64) {
        #[expect(clippy::cast_precision_loss, reason = "for people; exact for ages")]
        let seconds = |samples: u64| samples as f64 / self.rate_hz;
        self.wires.show(Seen {
            time_s: seconds(self.samples),
            position_m: self.parts.plant.position_m(&self.state),
            finger_n: self.finger_n(),
            enabled: self.enabled,
            disabled_s: self.disabled_at.map(seconds),
            speed,
        });
    }

    /// Its wires.
    pub fn wires(&self) -> Arc<Wires> {
        Arc::clone(&self.wires)
    }

    /// An end of its link.
    pub fn link(&self) -> WiredLink {
        WiredLink(self.wires())
    }
}
