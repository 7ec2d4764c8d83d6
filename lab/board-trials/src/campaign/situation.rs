//! The situations in which a fault is caused. Also records the force in each situation without a fault.

use host_sim::{
    error::Error,
    scene::{MotorTable, NamedScene},
};
use virtual_board::{
    board::Board,
    session::{Failed, Session, ask, ask_each},
    world::{Seen, Snapshot, World},
};

#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Situation {
    /// The motor pushes the handle to a distant wall with 48 % of full scale. No hand holds the handle.
    Free,
    /// A hand swings the handle inside a wall, 0.1 to 0.5 mm deep, at 20 Hz. The swing does not depend on the force, so
    /// the right force is known. A force that stays constant soon becomes wrong.
    Contact,
    /// The same as `Free`, but with the full force of the motor. The handle reaches the wall after 0.14 s with a high
    /// speed. So only faults with a short time limit are injected, and each fault is watched for a short time.
    Full,
    /// The return move before a hit brings the handle to the start. No hand holds the handle. Only random flips are
    /// tried here.
    Return,
}

/// All situations, in the order of their numbers.
pub const SITUATIONS: [Situation; 4] =
    [Situation::Free, Situation::Contact, Situation::Full, Situation::Return];

impl Situation {
    pub const fn text(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Contact => "contact",
            Self::Full => "full",
            Self::Return => "return",
        }
    }

    /// Whether no hand holds the handle.
    pub const fn is_free(self) -> bool {
        !matches!(self, Self::Contact)
    }

    /// The push of the hit in N. It is rounded to the number of digits that a console line can have.
    pub fn push_n(self, full_scale_n: f64) -> f64 {
        if self == Self::Full { (full_scale_n * 1e6).round() / 1e6 } else { PUSH_N }
    }
}

/// Mean depth of the swing and its amplitude, both in m, and its frequency in Hz.
const DEPTH_M: f64 = 0.3e-3;
const SWING_M: f64 = 0.2e-3;
const SWING_HZ: f64 = 20.0;
/// Push of the hit in free motion, in N.
const PUSH_N: f64 = 2.835;
/// Number of samples for which the board is watched after a fault at the full force.
pub const FULL_SAMPLES: u64 = 250;
const ARM_SAMPLES: u64 = 4_000;
/// Distance of the return move, in m. It takes 0.23 s.
const RETURN_M: f64 = 35e-3;

/// The scene of the board's own device. With `current_sense`, the amplifier of this scene has a current signal.
pub fn scene(board: Board, current_sense: bool) -> Result<NamedScene, Error> {
    let mut named = NamedScene::load(board.name)?;
    if current_sense {
        let motor = named.scene.motor.unwrap_or_default();
        let (rest, full) = (Some(0.5), Some(0.8));
        named.scene.motor =
            Some(MotorTable { current_sense_rest: rest, current_sense_full: full, ..motor });
        named.name = "current-sense".into();
    }
    Ok(named)
}

/// Switches on a board. Its simulation continues even if the core locks up.
pub(super) fn boot(session: &Session) -> Result<World<'_>, Failed> {
    let mut world = session.boot()?;
    world.powered.mcu.outlive_lock_up();
    Ok(world)
}

/// Types these console lines, then brings the board into this situation with the force on.
pub fn ready<'a>(
    session: &'a Session,
    situation: Situation,
    typed: &[&str],
) -> Result<World<'a>, Failed> {
    let mut world = boot(session)?;
    let zero_m = world.position_m();
    let wall = match situation {
        Situation::Free | Situation::Full | Situation::Return => "wall 0.1",
        Situation::Contact => "wall 0.005",
    };
    let push = format!("push {}", situation.push_n(world.full_scale_n()));
    ask_each(&mut world, &["zero", "unlock envelope"])?;
    ask_each(&mut world, typed)?;
    ask_each(&mut world, &[wall, "k 10000", "b 30", &push, "arm"])?;
    world.run(ARM_SAMPLES)?;
    match situation {
        Situation::Free | Situation::Full | Situation::Return => {
            let returns = situation == Situation::Return;
            if returns {
                world.lead_to(zero_m - RETURN_M)?;
            }
            ask(&mut world, "hit")?;
            let start_m = world.position_m();
            if returns {
                world.hold(start_m, false);
            }
            while world.position_m() < start_m + 1e-3 {
                world.sample()?;
            }
        }
        Situation::Contact => {
            world.lead_to(zero_m + 5e-3 + DEPTH_M)?;
            world.swing(SWING_M, SWING_HZ);
            world.run(500)?;
        }
    }
    world.probe()?;
    forget(&mut world);
    if world.powered.amplifier.is_enabled() {
        Ok(world)
    } else {
        Err(Failed::Refused("the board cannot be armed".into()))
    }
}

/// Discards what the host has read so far.
fn forget(world: &mut World<'_>) {
    world.telemetry.clear();
    world.lines.clear();
    world.replies.clear();
}

/// A time for a fault.
pub struct Start {
    pub snapshot: Snapshot,
    /// Index of this time in [`Stage::seen`].
    pub index: usize,
    /// The cycles of the next output period at which an instruction begins.
    pub code: Vec<u64>,
}

/// A run of a situation without a fault.
pub struct Stage {
    /// Times for faults, spread over some output periods.
    pub starts: Vec<Start>,
    /// The motor's force from the first start on.
    pub seen: Vec<Seen>,
    /// Words of RAM that the program reads during the run.
    pub read: Vec<u32>,
}

/// Number of samples from one start to the next. The starts are spread over 64 outputs, because the board compares its
/// clock with a second clock once in 64 outputs.
const BETWEEN: u64 = 41;

impl Stage {
    /// Types the lines, then runs the situation until `starts` start times have passed, and `samples` samples more.
    ///
    /// # Errors
    /// The board does not reach this situation.
    pub fn new(
        session: &Session,
        (situation, typed): (Situation, &[&str]),
        starts: usize,
        samples: u64,
    ) -> Result<Self, Failed> {
        let mut world = ready(session, situation, typed)?;
        let begin = world.snapshot();
        world.powered.mcu.note_reads();
        world.restore(&begin);
        let mut stage = Self { starts: Vec::new(), seen: Vec::new(), read: Vec::new() };
        for _ in 0..starts {
            world.seen = Some(Vec::new());
            forget(&mut world);
            let snapshot = world.snapshot();
            let code = code(&mut world)?;
            world.restore(&snapshot);
            stage.starts.push(Start { snapshot, index: stage.seen.len(), code });
            world.run(BETWEEN)?;
            stage.seen.extend(world.seen.take().unwrap_or_default());
        }
        world.seen = Some(Vec::new());
        world.run(samples)?;
        stage.seen.extend(world.seen.take().unwrap_or_default());
        if !stage.seen.iter().all(|seen| seen.enabled) {
            return Err(Failed::Refused(format!("{}: off without a fault", situation.text())));
        }
        stage.read = world.powered.mcu.words_read();
        Ok(stage)
    }
}

fn code(world: &mut World<'_>) -> Result<Vec<u64>, Failed> {
    let mut cycles = Vec::new();
    let end = world.powered.mcu.now() + 10 * world.powered.board.cycles_per_sample();
    while world.powered.mcu.now() < end {
        let (now, before) = (world.powered.mcu.now(), world.powered.mcu.instructions());
        world.run_to(now + 1)?;
        if world.powered.mcu.instructions() != before {
            cycles.push(now);
        }
    }
    Ok(cycles)
}
