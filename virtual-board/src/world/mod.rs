//! A board in the world: the plant of a scene on its encoder, its amplifier on the plant.
//!
//! The plant moves in [`STEPS`] exact steps per sample, each with the mean force of its span. The
//! steps end [`LEAD_S`] before the samples, and the encoder's edges come out within that time, so
//! that a count that is read belongs to the plant [`LEAD_S`] earlier. That is part of the latency.
//!
//! Where a program looks at the times of the edges ([`World::with_edge_times`]), the steps are as long as
//! that lead: each edge comes out a lead after the plant was there, to the cycle.

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

/// Steps of the plant per sample.
pub const STEPS: u64 = 10;
/// From the plant to the counter, s.
pub const LEAD_S: f64 = 2e-6;
/// Steps of the plant per sample that are as long as [`LEAD_S`], at 10 kHz.
const FINE_STEPS: u64 = 50;
/// Cycles from one encoder edge to the next: more than the timer's input filter takes.
const EDGE_CYCLES: u64 = 20;

/// A running board with a device on it.
pub struct World<'a> {
    pub powered: Powered,
    plant: AnyPlant,
    state: AnyState,
    encoder: Quantiser,
    sensing: Sensing,
    /// Steps per sample, and their length.
    steps: u64,
    step_s: f64,
    /// What A and B stand for between two counts, if their edges come at their own times.
    shown: Option<f64>,
    /// Samples since it was switched on, and steps of the present one.
    samples: u64,
    stepped: u64,
    full_scale_n: f64,
    /// How the amplifier says its current.
    current: CurrentSettings,
    /// The motor's current behind a filter, part of full scale.
    filtered: f64,
    /// The handle is held where it is, or led at [`led_m_per_s`](Self::led_m_per_s).
    held: Option<f64>,
    led_m_per_s: f64,
    /// What pulls at the handle while it is not held.
    pub finger: Option<Finger>,
    /// The hand swings the handle.
    swing: Option<Swing>,
    /// The motor's wires are swapped.
    pub motor_reversed: bool,
    /// A and B are swapped since the encoder stood at this count.
    swapped_at: Option<i32>,
    /// What else is wrong outside of the chip.
    pub defects: Defects,
    /// What the motor did with each sample, if that is wanted.
    pub seen: Option<Vec<Seen>>,
    log: log::Decoder<'a>,
    /// Cycle up to which the plant has moved.
    moved_to: u64,
    /// Lines of defmt since they were last taken.
    pub lines: Vec<String>,
    /// Replies since they were last taken.
    pub replies: String,
    /// Telemetry since it was last taken.
    pub telemetry: Vec<u8>,
}

/// A board in the world at one moment: chip, amplifier, handle, what is on its way to the host.
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

/// Why a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The core locked up.
    Stopped(Stopped),
    /// The log cannot be decoded.
    Log,
    /// What was waited for did not come in time.
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
    /// A board that has just been switched on, with the handle held at `start_m`, which is where
    /// its count starts from 0.
    ///
    /// # Errors
    /// The ELF is not this firmware, or the scene has `[jitter]`, a hand that pushes, another protocol or another
    /// criterion.
    pub fn new(
        board: Board,
        elf: &Elf,
        table: &'a defmt_decoder::Table,
        scene: &Scene,
        start_m: f64,
    ) -> Result<Self, String> {
        Self::of(board, elf, table, scene, (start_m, STEPS))
    }

    /// The same with every edge of the encoder at its own time.
    ///
    /// # Errors
    /// As [`new`](Self::new).
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
        // Counts stand for the motion that nobody sees.
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

    /// Everything as it is now.
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

    /// Everything as it was then, in this world or in another one of the same board, program and scene.
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

    /// Holds the handle at `position_m`, or lets it go from there at rest.
    pub fn hold(&mut self, position_m: f64, held: bool) {
        self.held = held.then_some(position_m);
        self.led_m_per_s = 0.0;
        self.swing = None;
        self.state = self.plant.at_rest(position_m);
    }

    /// Leads the handle on from where it is, at this speed.
    pub fn lead(&mut self, speed_m_per_s: f64) {
        self.held = Some(self.position_m());
        self.led_m_per_s = speed_m_per_s;
        self.swing = None;
    }

    /// Leads the handle to `to_m` at 0.5 m/s, and holds it there.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
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

    /// The switch of the emergency stop opens, or closes again.
    pub fn emergency_stop(&mut self, open: bool) {
        self.powered.mcu.set_break(open);
    }

    /// The reset pin is pulled.
    pub fn reset(&mut self) {
        self.powered.mcu.settle();
        self.powered.mcu.reset();
    }

    /// The supply goes and comes back; the switches and the handle stay as they are.
    pub fn power_cycle(&mut self) {
        self.powered.mcu.settle();
        self.powered.mcu.power_cycle();
        self.log.begun.clear();
    }

    /// Position of the handle, m.
    pub fn position_m(&self) -> f64 {
        self.plant.position_m(&self.state)
    }

    /// All of the motor's force, N.
    pub fn full_scale_n(&self) -> f64 {
        self.full_scale_n
    }

    /// Force of the finger on the handle, N.
    pub fn finger_n(&self) -> f64 {
        let Some(finger) = self.finger.filter(|_| self.held.is_none()) else { return 0.0 };
        finger.force_n(self.position_m(), self.plant.speed_m_per_s(&self.state))
    }

    /// One sample, from [`LEAD_S`] before one sampling event to the same before the next; or the rest of it.
    ///
    /// # Errors
    /// The program ended, or its log makes no sense.
    pub fn sample(&mut self) -> Result<(), Ended> {
        while !self.step()? {}
        Ok(())
    }

    /// Everything up to that cycle, or a few beyond it: instructions are whole.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
    pub fn run_to(&mut self, cycle: u64) -> Result<(), Ended> {
        while self.step_end() <= cycle {
            self.step()?;
        }
        Ok(self.powered.mcu.run_until(cycle)?)
    }

    /// One step of the plant; whether it was the last one of a sample.
    fn step(&mut self) -> Result<bool, Ended> {
        let to = self.step_end();
        self.powered.mcu.run_until(to)?;
        Ok(self.follow(to))
    }

    /// Where the present step of the plant ends.
    fn step_end(&self) -> u64 {
        self.moved_to + self.powered.board.cycles_per_sample() / self.steps
    }

    /// The plant moves to where the core has come; whether that was the last step of a sample.
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

    /// Swaps the encoder's channels, so that from here on it counts the other way round, or puts
    /// them right.
    pub fn swap_channels(&mut self, swapped: bool) {
        self.swapped_at = swapped.then(|| self.encoder.count(self.position_m()));
    }

    /// What A and B stand for.
    fn shown_count(&self) -> i32 {
        let count = self.encoder.count(self.shown_m());
        let count = self.defects.count(count, self.samples);
        self.swapped_at.map_or(count, |at| at.wrapping_mul(2).wrapping_sub(count))
    }

    /// The same between the counts.
    fn shown_place(&self) -> f64 {
        let place = self.encoder.place(self.shown_m());
        self.swapped_at.map_or(place, |at| 2.0 * f64::from(at) + 1.0 - place)
    }

    /// Where the encoder takes the handle to be, m.
    fn shown_m(&self) -> f64 {
        self.sensing.shown_m(self.position_m(), 0, self.samples)
    }

    /// Lets the edges of the step that ended at cycle `at` come out over the `cycles` after it. Within
    /// a step the handle moves evenly: at 100 m/s^2 to 5e-11 m.
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

    /// Puts the plant's steps in phase with the samples, once those have begun.
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
            // Once, right after the first sample: the handle is held still then.
            self.moved_to += (next + per_sample - self.moved_to % per_sample) % per_sample;
        }
    }

    /// `samples` samples, with the probe's channels read every 5 ms.
    ///
    /// # Errors
    /// As [`sample`](Self::sample).
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
