//! A session: actions done to a board, and everything that the board says held against the model.

use std::collections::VecDeque;

use host_sim::interrupt;

use crate::{
    session::Session,
    world::{Ended, Snapshot, World},
};

use super::{
    action::Action,
    answer::View,
    check::twin,
    frames::{Frame, Twin},
    model::Model,
    push::Push,
};

/// Why a session ended early.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The board did something else than the model.
    Difference(String),
    /// Ctrl-C.
    Interrupted,
}

impl From<Ended> for End {
    fn from(ended: Ended) -> Self {
        Self::Difference(format!("the program ended: {ended:?}"))
    }
}

pub(super) fn differs<T>(what: impl Into<String>) -> Result<T, End> {
    Err(End::Difference(what.into()))
}

/// Samples in which a command must be answered; with flash to be erased in between.
const ANSWER: u64 = 3_000;
const SAVED: u64 = 25_000;
/// A jump that is more than any handle moves in one sample, wherever in a sample its edges begin.
const JUMP_M: f64 = 1.05e-3;

/// What a session has shown so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Lines that were typed.
    pub commands: u64,
    /// Of those, answered by `ok` as they should be.
    pub obeyed: u64,
    /// Of those, refused as they should be.
    pub refused: u64,
    /// Frames whose position and velocity were worked out.
    pub frames: u64,
    /// Of those, with their force.
    pub forces: u64,
    /// Frames with the full force on.
    pub armed: u64,
    /// Floods of lines that were answered.
    pub floods: u64,
    /// Faults.
    pub faults: u64,
    /// Resets and power cycles.
    pub resets: u64,
    /// Cycles of the core.
    pub cycles: u64,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.commands += other.commands;
        self.obeyed += other.obeyed;
        self.refused += other.refused;
        self.frames += other.frames;
        self.forces += other.forces;
        self.armed += other.armed;
        self.floods += other.floods;
        self.faults += other.faults;
        self.resets += other.resets;
        self.cycles += other.cycles;
    }
}

/// What the session knows beside the board.
#[derive(Clone)]
pub struct Mind {
    pub model: Model,
    pub twin: Twin,
    pub counts: Counts,
    /// The board with its last two outputs; what was answered since is in the newer one.
    pub view: View,
    pub(super) before: View,
    /// Lines that wait for an answer, and lines that come by themselves after a reset.
    pub(super) asked: VecDeque<String>,
    pub(super) greeting: VecDeque<String>,
    /// Samples since the board last had to say something.
    pub(super) waited: u64,
    pub(super) saving: bool,
    /// Bytes of a frame that is not whole yet; the number of the next one.
    pub(super) begun: Vec<u8>,
    /// The last sample whose count was told, and where it was.
    pub(super) told: Option<(u64, i32)>,
    pub(super) sequence: Option<u32>,
    /// Frames of the black box that came since it was asked for.
    pub(super) replayed: Option<u64>,
    /// Samples run, and at which the stop and the supply last changed.
    pub now: u64,
    pub stop_open: bool,
    pub supply_mv: u32,
    pub(super) stop_at: u64,
    pub(super) supply_at: u64,
    pub(super) jumped_at: Option<u64>,
    /// A fault that has to come, and until when.
    pub(super) due: Option<(u8, u64)>,
    /// What may be latched after a reset, until the first frame says it.
    pub(super) boots: Option<Vec<u8>>,
    pub(super) calm_at: u64,
    pub(super) zero_lost_until: u64,
    /// The next frame has to say that the zero is lost.
    pub(super) loses_zero: bool,
    pub(super) allowed: Allowed,
    /// For fault 13 and 11: what a push has moved; the fastest of late.
    pub(super) push: Push,
    pub(super) fastest: u32,
    pub(super) arming: u64,
    pub(super) armed_after: u64,
    /// Sample of the last answer of the output task.
    pub(super) answered_at: u64,
    /// Nothing was seen for a while.
    pub(super) blind: bool,
    pub(super) causes_unsure: bool,
    pub held: bool,
}

/// What an answer has allowed to change, and a frame has not shown yet.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Allowed {
    pub arm: bool,
    pub disarm: bool,
    pub zero: bool,
    pub unlock: bool,
    pub turn: bool,
}

/// A board, and what is known of it.
pub struct Run<'a> {
    pub(super) world: World<'a>,
    pub(super) mind: Mind,
}

impl<'a> Run<'a> {
    /// A board that has just been switched on, with the handle at rest.
    ///
    /// # Errors
    /// It says something else than it should.
    pub fn boot(session: &'a Session) -> Result<Self, End> {
        let scene = &session.scene.scene;
        let rest_m = scene.device.rest_position_m;
        let world = World::new(session.board, &session.elf, &session.table, scene, rest_m);
        let world = world.map_err(End::Difference)?;
        let model = Model::new(session.board);
        let twin = twin(&model)?;
        let supply_mv = session.board.supply_mv;
        let mind = Mind {
            greeting: model.greeting().into(),
            model,
            twin,
            counts: Counts::default(),
            view: View::default(),
            before: View::default(),
            asked: VecDeque::new(),
            waited: 0,
            saving: false,
            begun: Vec::new(),
            told: None,
            sequence: None,
            replayed: None,
            now: 0,
            stop_open: false,
            supply_mv,
            stop_at: 0,
            supply_at: 0,
            jumped_at: None,
            due: None,
            boots: Some(vec![0]),
            calm_at: 0,
            zero_lost_until: 0,
            loses_zero: false,
            allowed: Allowed::default(),
            push: Push::default(),
            fastest: 0,
            arming: 0,
            armed_after: 0,
            answered_at: 0,
            blind: false,
            causes_unsure: false,
            held: true,
        };
        let mut run = Self { world, mind };
        run.greeted()?;
        run.act(&Action::Free)?;
        Ok(run)
    }

    /// Everything now.
    pub(super) fn snapshot(&mut self) -> (Snapshot, Mind) {
        (self.world.snapshot(), self.mind.clone())
    }

    /// Everything as it was then.
    pub(super) fn restore(&mut self, (world, mind): &(Snapshot, Mind)) {
        self.world.restore(world);
        self.mind = mind.clone();
    }

    /// Does one thing.
    ///
    /// # Errors
    /// The board answers it otherwise than the model, or Ctrl-C.
    pub fn act(&mut self, action: &Action) -> Result<(), End> {
        let begun = self.world.powered.mcu.now();
        match action {
            Action::Say(text) => {
                self.send(text)?;
                self.answered()?;
            }
            Action::Type(text) => self.send(text)?,
            Action::Flood(period, text) => self.flood(*period, text)?,
            Action::Wait(samples) => self.pass(*samples)?,
            Action::Cycles(cycles) => {
                let to = self.world.powered.mcu.now() + cycles;
                self.world.run_to(to)?;
                self.probe()?;
            }
            Action::Lead(speed, samples) => {
                self.world.lead(*speed);
                self.mind.held = true;
                self.pass(*samples)?;
                self.world.lead(0.0);
            }
            Action::Hold => self.hold(0.0, true),
            Action::Free => self.hold(0.0, false),
            Action::Jump(metres) => {
                self.hold(*metres, true);
                self.mind.jumped_at = Some(self.mind.now);
                if metres.abs() > JUMP_M {
                    self.mind.must(10);
                }
                self.mind.fastest = u32::MAX;
            }
            Action::Stop(open) => self.stop(*open)?,
            Action::Supply(mv) => self.supply(*mv)?,
            Action::Reset => self.reset(false)?,
            Action::Power => self.reset(true)?,
        }
        self.mind.counts.cycles += self.world.powered.mcu.now() - begun;
        Ok(())
    }

    /// The end of a session: every answer is in, and every frame looked at.
    ///
    /// # Errors
    /// As [`act`](Self::act).
    pub fn finish(&mut self) -> Result<(), End> {
        self.answered()?;
        self.pass(100)
    }

    fn hold(&mut self, farther_m: f64, held: bool) {
        let place_m = self.world.position_m() + farther_m;
        self.world.hold(place_m, held);
        self.mind.held = held;
    }

    fn send(&mut self, text: &str) -> Result<(), End> {
        self.probe()?;
        self.world.send(&format!("{text}\n"))?;
        if self.mind.asked.is_empty() {
            self.mind.waited = 0;
        }
        for line in text.split(['\n', '\r']).filter(|line| !line.trim_ascii().is_empty()) {
            self.mind.counts.commands += 1;
            self.mind.saving |= line.trim_ascii().eq_ignore_ascii_case("save");
            self.mind.asked.push_back(line.to_owned());
        }
        Ok(())
    }

    pub(super) fn answered(&mut self) -> Result<(), End> {
        while !self.mind.asked.is_empty() {
            self.pass(1)?;
        }
        Ok(())
    }

    pub(super) fn greeted(&mut self) -> Result<(), End> {
        while !self.mind.greeting.is_empty() || self.mind.boots.is_some() {
            self.pass(1)?;
        }
        Ok(())
    }

    fn pass(&mut self, samples: u64) -> Result<(), End> {
        for _ in 0..samples {
            self.world.sample()?;
            self.mind.now += 1;
            self.mind.waited += 1;
            let before = self.mind.view.sample;
            self.probe()?;
            if self.mind.view.sample != before {
                self.outputs()?;
            }
            if self.mind.now.is_multiple_of(16) && interrupt::is_requested() {
                return Err(End::Interrupted);
            }
        }
        Ok(())
    }

    pub(super) fn probe(&mut self) -> Result<(), End> {
        self.world.probe()?;
        self.world.lines.clear();
        let readings = self.world.powered.mcu.take_counter_readings();
        self.mind.twin.read(readings);
        let bytes = std::mem::take(&mut self.world.telemetry);
        self.mind.begun.extend(bytes);
        while let Some(frame) = Frame::take(&mut self.mind.begun).map_err(End::Difference)? {
            if let Some((samples, moved)) = frame.moved {
                let before = frame.sample.checked_sub(samples);
                if let Some((sample, position)) = self.mind.told
                    && before == Some(sample)
                    && frame.position.wrapping_sub(position) != moved
                {
                    let text = format!(
                        "sample {}: counts add up to {moved}, the position was {position}",
                        frame.sample
                    );
                    return differs(text);
                }
                self.mind.told = Some((frame.sample, frame.position));
            }
            self.frame(frame)?;
        }
        let replies = std::mem::take(&mut self.world.replies);
        let (whole, rest) = replies.rsplit_once('\n').unwrap_or(("", &replies));
        for line in whole.lines() {
            self.line(line)?;
        }
        self.world.replies = rest.to_owned();
        let framed = self.mind.sees().then_some(self.mind.view.sample);
        self.mind.twin.follow(framed).map_err(End::Difference)?;
        let [compared, forces] = self.mind.twin.compared;
        (self.mind.counts.frames, self.mind.counts.forces) = (compared, forces);
        let patience = if self.mind.saving { SAVED } else { ANSWER };
        let waiting = self.mind.asked.front().or(self.mind.greeting.front());
        match waiting {
            Some(line) if self.mind.waited > patience => differs(format!("no answer to {line:?}")),
            _ => Ok(()),
        }
    }
}
