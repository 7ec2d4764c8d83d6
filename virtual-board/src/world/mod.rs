//! A board in closed loop: the plant of a scene moves the board's encoder, and the board's amplifier drives the plant.
//!
//! The plant moves in [`STEPS`] exact steps per sample, each with the mean force during the step. The steps end
//! [`LEAD_S`] before the samples. Within this time the encoder's edges are shown. So a count that the program reads is
//! the plant's position [`LEAD_S`] earlier. This delay is part of the latency.
//!
//! A program may use the times of the edges ([`World::with_edge_times`]). Then each step is as long as [`LEAD_S`], and
//! each edge is shown exactly [`LEAD_S`] after the plant has passed it.

mod debugger;
mod defects;
mod finger;
mod host;

pub use debugger::Halted;
pub use defects::{CountDefect, Defects, Seen, Swing};
pub use finger::Finger;
use host_sim::{
    plant::{AnyPlant, AnyState, Plant as _, Sensing},
    scene::{Criterion, Protocol, PushBy, RmsOf, Scene},
    simulation::quantiser::{self, Quantiser},
};

use zwidth::safety::CurrentSettings;

use crate::{
    amplifier,
    board::{Board, Powered},
    elf::Elf,
    log,
    mcu::{self, Stopped},
};

/// Number of the plant's steps per sample.
pub const STEPS: u64 = 10;
/// Delay from the plant to the counter, in s.
pub const LEAD_S: f64 = 2e-6;
/// Number of the plant's steps per sample if a step is as long as [`LEAD_S`]. The sample rate is 10 kHz.
const FINE_STEPS: u64 = 50;
/// Number of cycles from one encoder edge to the next. The timer's input filter needs fewer.
const EDGE_CYCLES: u64 = 20;

pub struct World<'a> {
    pub powered: Powered,
    plant: AnyPlant,
    state: AnyState,
    encoder: Quantiser,
    sensing: Sensing,
    /// Number of the plant's steps per sample. `step_s` is the length of a step.
    steps: u64,
    step_s: f64,
    /// Position that A and B show, in counts with fractions. `None` if the edges do not have exact times.
    shown: Option<f64>,
    /// Number of samples since the board was switched on. `stepped` is the number of steps of the present sample so
    /// far.
    samples: u64,
    stepped: u64,
    full_scale_n: f64,
    current: CurrentSettings,
    /// The current signal after its filter, as a fraction of full scale.
    filtered: f64,
    /// Position at which a hand holds the handle. The hand moves this position at [`led_m_per_s`](Self::led_m_per_s).
    held: Option<f64>,
    led_m_per_s: f64,
    /// A finger that pulls at the handle. It acts while no hand holds the handle.
    pub finger: Option<Finger>,
    /// Motion of a hand that swings the handle.
    swing: Option<Swing>,
    /// Whether the motor's wires are swapped.
    pub motor_reversed: bool,
    /// The count at which A and B were swapped. `None` if they are not swapped.
    swapped_at: Option<i32>,
    /// Other defects outside the chip.
    pub defects: Defects,
    /// What was observed in each sample. `None` if nobody needs it.
    pub seen: Option<Vec<Seen>>,
    log: log::Decoder<'a>,
    /// Cycle to which the plant has moved.
    moved_to: u64,
    /// Lines of the log that nobody has taken yet.
    pub lines: Vec<String>,
    /// Replies that nobody has taken yet.
    pub replies: String,
    /// Telemetry that nobody has taken yet.
    pub telemetry: Vec<u8>,
}

/// The state of a board and its plant at one time. It has chip, amplifier, handle, and the bytes that the host has not
/// taken yet.
#[derive(Clone)]
pub struct Snapshot {
    pub mcu: mcu::Snapshot,
    amplifier: amplifier::State,
    state: AnyState,
    shown: Option<f64>,
    samples: [u64; 2],
    held: Option<f64>,
    led_m_per_s: f64,
    finger: Option<Finger>,
    swing: Option<Swing>,
    motor_reversed: bool,
    swapped_at: Option<i32>,
    defects: Defects,
    filtered: f64,
    seen: Option<Vec<Seen>>,
    log: Vec<u8>,
    moved_to: u64,
    lines: Vec<String>,
    replies: String,
    telemetry: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The core locked up.
    Stopped(Stopped),
    /// The log cannot be decoded.
    Log,
    /// An expected line did not come in time.
    Timeout,
}

impl From<Stopped> for Ended {
    fn from(stopped: Stopped) -> Self {
        Self::Stopped(stopped)
    }
}

impl From<log::Malformed> for Ended {
    fn from(_: log::Malformed) -> Self {
        Self::Log
    }
}

impl<'a> World<'a> {
    /// Switches a board on, with the handle held at `start_m`. The board's count starts from 0 there.
    ///
    /// # Errors
    /// The ELF is not this firmware, or the scene has `[jitter]`, a push by a hand, a protocol other than the paper's,
    /// or a criterion that a board cannot judge.
    pub fn new(
        board: Board,
        elf: &Elf,
        table: &'a defmt_decoder::Table,
        scene: &Scene,
        start_m: f64,
    ) -> Result<Self, String> {
        Self::of(board, elf, table, scene, (start_m, STEPS))
    }

    /// Switches a board on as [`new`](Self::new) does, but every edge of the encoder comes at its exact time.
    pub fn with_edge_times(
        board: Board,
        elf: &Elf,
        table: &'a defmt_decoder::Table,
        scene: &Scene,
        start_m: f64,
    ) -> Result<Self, String> {
        let mut world = Self::of(board, elf, table, scene, (start_m, FINE_STEPS))?;
        world.shown = Some(world.shown_place());
        Ok(world)
    }

    fn of(
        board: Board,
        elf: &Elf,
        table: &'a defmt_decoder::Table,
        scene: &Scene,
        (start_m, steps): (f64, u64),
    ) -> Result<Self, String> {
        if scene.jitter.is_some() {
            return Err("[jitter]: a board samples when it samples; leave it out".to_owned());
        }
        let hit = &scene.wall_hit;
        // A board measures the motion only in counts. So the criterion can use only counts of the motion.
        let judged = match hit.criterion {
            Criterion::Rms => hit.rms_of() == RmsOf::Counts,
            Criterion::Quiet => true,
            Criterion::Unsaturated | Criterion::Felt => false,
        };
        if hit.push_by == PushBy::Hand || !judged || hit.protocol != Protocol::Paper {
            return Err("wall_hit: on a board the motor pushes all the time, and by rms its counts decide or by quiet its \
                        counts and its force; leave out push_by, protocol and rms_of, and say criterion = \"quiet\" or \
                        none"
                .to_owned());
        }
        let mut powered = Powered::on(board, elf)?;
        let sample_s = 1.0 / scene.control.rate_hz;
        #[expect(clippy::cast_precision_loss, reason = "50 at most")]
        let step_s = sample_s / steps as f64;
        let plant = AnyPlant::unsensed(scene, step_s, 0.0);
        let encoder = Quantiser::of(&scene.encoder);
        powered.mcu.encoder_at(encoder.count(start_m));
        Ok(Self {
            powered,
            state: plant.at_rest(start_m),
            plant,
            encoder,
            sensing: Sensing::of(scene),
            steps,
            step_s,
            shown: None,
            samples: 0,
            stepped: 0,
            full_scale_n: scene.full_scale_n(),
            current: scene.on_board().current,
            filtered: 0.0,
            held: Some(start_m),
            led_m_per_s: 0.0,
            finger: None,
            swing: None,
            motor_reversed: false,
            swapped_at: None,
            defects: Defects::default(),
            seen: None,
            log: log::Decoder::new(table),
            moved_to: 0,
            lines: Vec::new(),
            replies: String::new(),
            telemetry: Vec::new(),
        })
    }

    pub fn snapshot(&mut self) -> Snapshot {
        Snapshot {
            mcu: self.powered.mcu.snapshot(),
            amplifier: self.powered.amplifier.saved(),
            state: self.state,
            shown: self.shown,
            samples: [self.samples, self.stepped],
            held: self.held,
            led_m_per_s: self.led_m_per_s,
            finger: self.finger,
            swing: self.swing,
            motor_reversed: self.motor_reversed,
            swapped_at: self.swapped_at,
            defects: self.defects,
            filtered: self.filtered,
            seen: self.seen.clone(),
            log: self.log.begun.clone(),
            moved_to: self.moved_to,
            lines: self.lines.clone(),
            replies: self.replies.clone(),
            telemetry: self.telemetry.clone(),
        }
    }

    /// Restores a state of this world, or of another world with the same board, program and scene.
    pub fn restore(&mut self, from: &Snapshot) {
        self.powered.mcu.restore(&from.mcu);
        self.powered.amplifier.restore(from.amplifier);
        self.state = from.state;
        self.shown = from.shown;
        [self.samples, self.stepped] = from.samples;
        self.held = from.held;
        self.led_m_per_s = from.led_m_per_s;
        self.finger = from.finger;
        self.swing = from.swing;
        self.motor_reversed = from.motor_reversed;
        self.swapped_at = from.swapped_at;
        self.defects = from.defects;
        self.filtered = from.filtered;
        self.seen.clone_from(&from.seen);
        self.log.begun.clone_from(&from.log);
        self.moved_to = from.moved_to;
        self.lines.clone_from(&from.lines);
        self.replies.clone_from(&from.replies);
        self.telemetry.clone_from(&from.telemetry);
    }

    /// Holds the handle at `position_m`, or releases it there from rest.
    pub fn hold(&mut self, position_m: f64, held: bool) {
        self.held = held.then_some(position_m);
        self.led_m_per_s = 0.0;
        self.swing = None;
        self.state = self.plant.at_rest(position_m);
    }

    /// A hand moves the handle from its present position at this speed, until the hand holds or releases the handle.
    pub fn lead(&mut self, speed_m_per_s: f64) {
        self.held = Some(self.position_m());
        self.led_m_per_s = speed_m_per_s;
        self.swing = None;
    }

    /// A hand moves the handle to `to_m` at 0.5 m/s and holds it there.
    ///
    /// # Errors
    /// The same errors as in [`sample`](Self::sample).
    pub fn lead_to(&mut self, to_m: f64) -> Result<(), Ended> {
        let from_m = self.position_m();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a few thousand"
        )]
        let steps = ((to_m - from_m).abs() / 50e-6).ceil().max(1.0) as u32;
        for n in 1..=steps {
            self.hold(from_m + (to_m - from_m) * f64::from(n) / f64::from(steps), true);
            self.sample()?;
        }
        Ok(())
    }

    pub fn emergency_stop(&mut self, open: bool) {
        self.powered.mcu.set_break(open);
    }

    /// Resets the board by its reset pin.
    pub fn reset(&mut self) {
        self.powered.mcu.settle();
        self.powered.mcu.reset();
    }

    /// Switches the supply off and on. The switches and the handle stay as they are.
    pub fn power_cycle(&mut self) {
        self.powered.mcu.settle();
        self.powered.mcu.power_cycle();
        self.log.begun.clear();
    }

    pub fn position_m(&self) -> f64 {
        self.plant.position_m(&self.state)
    }

    /// Largest force of the motor, in N.
    pub fn full_scale_n(&self) -> f64 {
        self.full_scale_n
    }

    pub fn finger_n(&self) -> f64 {
        let Some(finger) = self.finger.filter(|_| self.held.is_none()) else { return 0.0 };
        finger.force_n(self.position_m(), self.plant.speed_m_per_s(&self.state))
    }

    /// Runs one sample, from [`LEAD_S`] before a sampling event to [`LEAD_S`] before the next. If a sample has begun,
    /// only its rest is run.
    ///
    /// # Errors
    /// The program ended, or its log cannot be decoded.
    pub fn sample(&mut self) -> Result<(), Ended> {
        while !self.step()? {}
        Ok(())
    }

    /// Runs everything up to `cycle`. It may end a few cycles later, because instructions are not split.
    ///
    /// # Errors
    /// The same errors as in [`sample`](Self::sample).
    pub fn run_to(&mut self, cycle: u64) -> Result<(), Ended> {
        while self.step_end() <= cycle {
            self.step()?;
        }
        Ok(self.powered.mcu.run_until(cycle)?)
    }

    /// Runs one step of the plant. Returns whether it was the last step of a sample.
    fn step(&mut self) -> Result<bool, Ended> {
        let to = self.step_end();
        self.powered.mcu.run_until(to)?;
        Ok(self.follow(to))
    }

    /// Cycle at which the present step of the plant ends.
    fn step_end(&self) -> u64 {
        self.moved_to + self.powered.board.cycles_per_sample() / self.steps
    }

    /// Moves the plant to cycle `to`. Returns whether a sample's last step has ended.
    fn follow(&mut self, to: u64) -> bool {
        let from = self.moved_to;
        self.powered.mcu.settle_to(to);
        let given = self.powered.amplifier.mean_until(to, from);
        let given = self.defects.given(given, self.powered.amplifier.is_enabled());
        self.show(given);
        let given = if self.motor_reversed { -given } else { given };
        let force_n = given * self.full_scale_n;
        if self.seen.is_some() {
            self.note(given, to);
        }
        if let Some(swing) = self.swing {
            self.held = Some(swing.place_m(self.steps * self.samples + self.stepped, self.step_s));
            self.state = self.plant.at_rest(self.held.unwrap_or_default());
        }
        match &mut self.held {
            None => {
                let force_n = force_n + self.finger_n();
                self.state = self.plant.advance(&self.state, force_n);
            }
            Some(place_m) if self.led_m_per_s != 0.0 => {
                *place_m += self.led_m_per_s * self.step_s;
                self.state = self.plant.at_rest(*place_m);
            }
            Some(_) => {}
        }
        if let Some(before) = self.shown {
            self.show_edges(before, to, to - from);
        } else {
            let count = self.shown_count();
            self.powered.mcu.encoder_to(count, to, EDGE_CYCLES);
        }
        self.moved_to = to;
        self.stepped += 1;
        if self.stepped < self.steps {
            return false;
        }
        self.stepped = 0;
        self.samples += 1;
        self.align();
        true
    }

    /// Swaps the encoder's channels, so that the encoder counts in the opposite direction from here on. If `swapped` is
    /// false, the channels are restored.
    pub fn swap_channels(&mut self, swapped: bool) {
        self.swapped_at = swapped.then(|| self.encoder.count(self.position_m()));
    }

    fn shown_count(&self) -> i32 {
        let count = self.encoder.count(self.shown_m());
        let count = self.defects.count(count, self.samples);
        self.swapped_at.map_or(count, |at| at.wrapping_mul(2).wrapping_sub(count))
    }

    /// Returns the value of [`shown_count`](Self::shown_count) with the fraction between two counts.
    fn shown_place(&self) -> f64 {
        let place = self.encoder.place(self.shown_m());
        self.swapped_at.map_or(place, |at| 2.0 * f64::from(at) + 1.0 - place)
    }

    /// Position that the encoder measures, in m.
    fn shown_m(&self) -> f64 {
        self.sensing.shown_m(self.position_m(), 0, self.samples)
    }

    /// Shows the edges of the step that ended at cycle `at`, during the `cycles` after it. The speed within a step is
    /// treated as constant. At 100 m/s^2 this causes an error of 5e-11 m.
    fn show_edges(&mut self, before: f64, at: u64, cycles: u64) {
        let after = self.shown_place();
        self.shown = Some(after);
        let [first, last] = [before, after].map(quantiser::floor);
        if u64::from(first.abs_diff(last)) * EDGE_CYCLES > cycles {
            return self.powered.mcu.encoder_to(last, at, EDGE_CYCLES); // a jump
        }
        let mut count = first;
        while count != last {
            let up = count < last;
            let border = f64::from(if up { count + 1 } else { count });
            count = if up { count + 1 } else { count - 1 };
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                clippy::cast_precision_loss,
                reason = "a few hundred"
            )]
            let within = ((border - before) / (after - before) * cycles as f64) as u64;
            self.powered.mcu.encoder_to(count, at + within, 1);
        }
    }

    /// After the first sample, aligns the plant's steps with the samples.
    fn align(&mut self) {
        let Some(event) = self.powered.mcu.last_event() else { return };
        let board = self.powered.board;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a few hundred"
        )]
        let lead = (LEAD_S * board.chip.core_hz as f64) as u64;
        let per_sample = board.cycles_per_sample();
        let next = event + per_sample - lead;
        if self.moved_to % per_sample != next % per_sample {
            // The alignment happens once, directly after the first sample, while the handle is held.
            self.moved_to += (next + per_sample - self.moved_to % per_sample) % per_sample;
        }
    }

    /// Runs `samples` samples, and reads the probe's channels every 5 ms.
    ///
    /// # Errors
    /// The same errors as in [`sample`](Self::sample).
    pub fn run(&mut self, samples: u64) -> Result<(), Ended> {
        for n in 0..samples {
            self.sample()?;
            if n % 50 == 49 {
                self.probe()?;
            }
        }
        self.probe()
    }
}
