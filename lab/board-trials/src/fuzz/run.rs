//! A session: actions on a board. The library and the rules check everything that the board sends and outputs.

use host_sim::interrupt;
use virtual_board::{
    device,
    mcu::{LINK, RENDER, SAMPLE},
    session::Session,
    world::{Ended, Snapshot, World},
};
use zwidth::safety::ResetCause;

use super::{
    action::Action,
    counts::Counts,
    oracle::{Observed, Oracle},
    properties::{Properties, output_code},
};

/// Why a session ended early.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The board differed from the library, or broke a rule.
    Difference(String),
    /// The user pressed Ctrl-C.
    Interrupted,
}

impl From<Ended> for End {
    fn from(ended: Ended) -> Self {
        Self::Difference(format!("the program ended: {ended:?}"))
    }
}

/// Number of samples after the last answer within which the library must have sent the same as the image.
const LATE: u64 = 400;
/// Number of cycles within which a low supply must disable the amplifier. It is 60 us (docs/faults.md).
const DETECTED: u64 = 10_000;
/// Part of the symbol name of the data that the tasks share. The compiler decides the layout of this data. The queue of
/// orders is at the end and has a known size. The queue of reports is before the queue of orders. Each queue ends with
/// its read and write offsets.
const QUEUES: &str = "init_queues";
const ORDERS: u32 = 312;
/// Number of samples within which a board must start.
const BEGIN: u64 = 1_000;

/// State of the checks of a board, and of the hand at its handle.
#[derive(Clone)]
pub struct Checks {
    pub oracle: Oracle,
    pub properties: Properties,
    pub counts: Counts,
    /// What the library and the rules have counted during the present action. These numbers are added to the counts
    /// when the action has ended.
    seen: Counts,
    pub held: bool,
    samples: u64,
}

pub struct Run<'a> {
    world: World<'a>,
    pub checks: Checks,
}

impl<'a> Run<'a> {
    /// Switches on a board with its handle at rest, and waits for its first lines.
    ///
    /// # Errors
    /// The board sends something unexpected.
    pub fn boot(session: &'a Session) -> Result<Self, End> {
        let scene = &session.scene.scene;
        let rest_m = scene.device.rest_position_m;
        let world = World::new(session.board, &session.elf, &session.table, scene, rest_m);
        let mut world = world.map_err(End::Difference)?;
        let (queues, size) = session.elf.place_of(QUEUES).map_err(End::Difference)?;
        let orders = queues + size - ORDERS;
        let words = [world.powered.rtt.commands_read(), orders - 8, queues + size - 4];
        world.powered.mcu.watch_mut().note_entries(words);
        let checks = Checks {
            oracle: Oracle::new(device::built_in(session.board)),
            properties: Properties::new(session.board.supply_mv),
            counts: Counts::default(),
            seen: Counts::default(),
            held: true,
            samples: 0,
        };
        let mut run = Self { world, checks };
        run.begun()?;
        run.act(&Action::Free)?;
        Ok(run)
    }

    pub fn snapshot(&mut self) -> (Snapshot, Checks) {
        (self.world.snapshot(), self.checks.clone())
    }

    pub fn restore(&mut self, (world, checks): &(Snapshot, Checks)) {
        self.world.restore(world);
        self.checks = checks.clone();
    }

    /// Runs one action.
    ///
    /// # Errors
    /// The board does something unexpected, or the user pressed Ctrl-C.
    pub fn act(&mut self, action: &Action) -> Result<(), End> {
        let begun = self.world.powered.mcu.now();
        match action {
            Action::Say(text) => {
                self.send(text)?;
                self.answered()?;
            }
            Action::Type(text) => self.send(text)?,
            Action::Wait(samples) => self.pass(*samples)?,
            Action::Cycles(cycles) => {
                self.world.run_to(begun + cycles)?;
                self.probe()?;
            }
            Action::Lead(speed, samples) => {
                self.world.lead(*speed);
                self.checks.held = true;
                self.pass(*samples)?;
                self.world.lead(0.0);
            }
            Action::Hold => self.hold(0.0, true),
            Action::Free => self.hold(0.0, false),
            Action::Jump(metres) => self.hold(*metres, true),
            Action::Stop(open) => {
                self.between_outputs()?;
                self.world.emergency_stop(*open);
                self.checks.properties.stop_open = *open;
                self.checks.oracle.emergency_stop(*open);
                self.probe()?;
            }
            Action::Supply(mv) => {
                self.between_outputs()?;
                self.world.powered.mcu.set_supply_mv(*mv);
                self.checks.properties.supply_mv = *mv;
                let low = self.checks.properties.is_supply_low();
                self.checks.oracle.supply(low);
                // The detector starts a task, which runs within a few cycles.
                let until = self.world.powered.mcu.now() + DETECTED;
                while low && self.world.powered.amplifier.is_enabled() {
                    let now = self.world.powered.mcu.now();
                    if now > until {
                        return Err(End::Difference(
                            "enable stays active with a low supply".into(),
                        ));
                    }
                    self.world.run_to(now + 1)?;
                }
                self.probe()?;
            }
            Action::Reset => self.reset(ResetCause::Pin)?,
            Action::Power => self.reset(ResetCause::Power)?,
        }
        let Checks { counts, seen, .. } = &mut self.checks;
        let Counts { commands, outputs, resets, mut cycles, .. } = *counts;
        cycles += self.world.powered.mcu.now() - begun;
        *counts = Counts { commands, outputs, resets, cycles, ..*seen };
        Ok(())
    }

    /// Ends a session: waits for all replies and compares everything.
    ///
    /// # Errors
    /// The same errors as in [`act`](Self::act).
    pub fn finish(&mut self) -> Result<(), End> {
        self.answered()?;
        self.pass(100)?;
        let mut late = 0;
        while let Err(what) = self.checks.oracle.is_complete() {
            if late == LATE {
                return Err(End::Difference(what));
            }
            late += 1;
            self.pass(1)?;
        }
        Ok(())
    }

    fn hold(&mut self, farther_m: f64, held: bool) {
        let place_m = self.world.position_m() + farther_m;
        self.world.hold(place_m, held);
        self.checks.held = held;
    }

    /// Types lines. If the channel is full, the remaining bytes wait.
    fn send(&mut self, text: &str) -> Result<(), End> {
        self.probe()?;
        for line in text.split(['\n', '\r']).filter(|line| !line.trim_ascii().is_empty()) {
            self.checks.counts.commands += 1;
            self.checks.properties.ask(line);
        }
        let bytes = format!("{text}\n").into_bytes();
        let mut rest = &bytes[..];
        loop {
            let powered = &mut self.world.powered;
            let (sent, after) = rest.split_at(powered.rtt.write(&mut powered.mcu, 0, rest));
            self.checks.oracle.send(sent);
            rest = after;
            if rest.is_empty() {
                return Ok(());
            }
            self.pass(1)?;
        }
    }

    fn answered(&mut self) -> Result<(), End> {
        while !(self.checks.properties.is_answered() && self.checks.oracle.is_idle()) {
            self.pass(1)?;
        }
        Ok(())
    }

    /// Runs until the program has started, and has sent the same first lines as the library.
    fn begun(&mut self) -> Result<(), End> {
        for _ in 0..BEGIN {
            self.pass(1)?;
            if self.checks.oracle.is_idle() && self.checks.oracle.is_complete().is_ok() {
                return Ok(());
            }
        }
        Err(End::Difference("the program does not begin".into()))
    }

    /// Runs until no output is being computed, because an event then has only one possible effect. `--instants` tries
    /// the other times.
    fn between_outputs(&mut self) -> Result<(), End> {
        self.probe()?;
        loop {
            let innermost = self.world.powered.mcu.watch().innermost();
            let quiet =
                !matches!(innermost, SAMPLE | RENDER) && (innermost == 0 || innermost == LINK);
            if quiet && self.checks.oracle.is_between_outputs() {
                return Ok(());
            }
            let now = self.world.powered.mcu.now();
            self.world.run_to(now + 1)?;
            self.probe()?;
        }
    }

    /// Restarts the board by its reset pin or by its supply.
    fn reset(&mut self, cause: ResetCause) -> Result<(), End> {
        self.between_outputs()?;
        match cause {
            ResetCause::Power => self.world.power_cycle(),
            _ => self.world.reset(),
        }
        self.checks.properties.reset();
        self.checks.oracle.reset(cause);
        self.checks.counts.resets += 1;
        self.world.replies.clear();
        self.world.telemetry.clear();
        self.begun()
    }

    fn pass(&mut self, samples: u64) -> Result<(), End> {
        for _ in 0..samples {
            self.world.sample()?;
            self.checks.samples += 1;
            self.checks.properties.sample();
            self.probe()?;
            if self.checks.samples.is_multiple_of(16) && interrupt::is_requested() {
                return Err(End::Interrupted);
            }
        }
        Ok(())
    }

    /// Reads what the board has sent, and checks it.
    fn probe(&mut self) -> Result<(), End> {
        self.world.probe()?;
        self.world.lines.clear();
        let powered = &mut self.world.powered;
        let Ok(block) = powered.rtt.look(&mut powered.mcu);
        let [.., [_, size]] = block.map_or([[0, 1]; 4], |block| block.buffers());
        let observed = Observed {
            counts: powered.mcu.take_counter_readings(),
            entries: powered.mcu.watch_mut().take_entries(),
            replies: std::mem::take(&mut self.world.replies).into_bytes(),
            telemetry: std::mem::take(&mut self.world.telemetry),
            saves: self.checks.properties.saves(),
        };
        let saved = observed.saves;
        let Checks { oracle, properties, counts, seen, .. } = &mut self.checks;
        let held = properties.check(&self.world, &observed, seen);
        if saved && !properties.saves() {
            self.world.powered.mcu.watch_mut().clear();
        }
        let code = output_code(&self.world);
        let enabled = self.world.powered.amplifier.is_enabled();
        let within = self.world.powered.mcu.watch().innermost();
        held.and_then(|()| oracle.follow(observed, size.max(1), seen))
            .and_then(|()| {
                if matches!(within, 0 | LINK) {
                    counts.outputs += 1;
                    return oracle.outputs(code, enabled);
                }
                Ok(())
            })
            .map_err(End::Difference)
    }
}
