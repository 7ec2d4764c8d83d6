//! Experiments as a person runs them: the same commands, typed into a virtual board.

use std::path::PathBuf;

use defmt_decoder::Table;
use host_sim::{
    error::Error,
    scene::{Criterion, NamedScene, Scene, Units},
};
use serde::{Serialize, Serializer};
use zwidth::{
    experiment::Verdict,
    velocity::{EstimatorName, PARAMETERS, Sense},
};

use crate::{
    board::{BOARDS, Board},
    device,
    elf::Elf,
    image, log,
    world::{Ended, World},
};

/// A board, its program and the device on it.
pub struct Session {
    pub board: Board,
    /// The device, and its name.
    pub scene: NamedScene,
    pub elf: Elf,
    /// Strings of the firmware's log.
    pub table: Table,
}

/// Why a session ended.
#[derive(Debug)]
pub enum Failed {
    /// The firmware refused this, with these words.
    Refused(String),
    /// The program ended, or did not answer.
    Program(Ended),
}

impl From<Ended> for Failed {
    fn from(ended: Ended) -> Self {
        Self::Program(ended)
    }
}

impl From<String> for Failed {
    fn from(text: String) -> Self {
        Self::Refused(text)
    }
}

/// A hit as the firmware reports it.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardHit {
    /// Line that the firmware said.
    pub line: String,
    /// Verdict on the hit.
    pub verdict: Verdict,
    /// RMS of the position about its mean, m.
    pub rms_m: f64,
    /// Mean of the position, m.
    pub mean_m: f64,
    /// What the wall has taken in the last contact, and the most that it has given in one, J.
    pub port_j: [f64; 2],
    /// What a quiet hit showed at each push, in order; the one that decides stands above. Else none.
    pub pushes: Vec<BoardPush>,
}

impl BoardHit {
    /// Of the lines that say its pushes, if it has several, and the one that ends it.
    ///
    /// # Errors
    /// The line is an error, or no result of a hit.
    fn read(pushes: &[String], line: String, units: Units) -> Result<Self, Failed> {
        let Some(rest) = line.strip_prefix("ok hit ") else { return Err(Failed::Refused(line)) };
        let Some(verdict) = verdict(rest) else { return Err(Failed::Refused(line)) };
        let metres = |name| Ok::<_, Failed>(units.from_reply("rms_m", number(&line, name)?));
        let (rms_m, mean_m) = (metres("rms ")?, metres("mean ")?);
        let port_j = [number(&line, "taken ")?, number(&line, "given ")?];
        let pushes = pushes.iter().map(|push| BoardPush::read(push, units));
        let pushes = pushes.collect::<Result<_, _>>()?;
        Ok(Self { verdict, rms_m, mean_m, port_j, pushes, line })
    }

    /// The push that decides: the one that was not held, or the one whose force moved most.
    pub fn deciding(&self) -> Option<&BoardPush> {
        let force_n = |push: &&BoardPush| push.force_rms_n;
        let loudest = || self.pushes.iter().max_by(|a, b| force_n(a).total_cmp(&force_n(b)));
        self.pushes.iter().find(|push| push.verdict != Verdict::Stable).or_else(loudest)
    }
}

/// One push of a quiet hit, as the firmware reports it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoardPush {
    /// Line that the firmware said.
    #[serde(skip)]
    pub line: String,
    pub push_n: f64,
    /// Verdict on the wall at this push.
    #[serde(serialize_with = "name_of")]
    pub verdict: Verdict,
    /// RMS of the position about its mean, m.
    pub rms_m: f64,
    /// RMS of the force about its mean, N.
    pub force_rms_n: f64,
    /// `None` if the wall had no force.
    pub penetration_ratio: Option<f64>,
}

impl BoardPush {
    /// Start of the line of a push.
    const HEAD: &'static str = "hit push ";

    fn read(line: &str, units: Units) -> Result<Self, Failed> {
        let refused = || Failed::Refused(line.to_owned());
        let (_, rest) = line.split_once(", ").ok_or_else(refused)?;
        let at_handle = |key, name| Ok::<_, Failed>(units.from_reply(key, number(line, name)?));
        Ok(Self {
            line: line.to_owned(),
            push_n: at_handle("push_n", ": ")?,
            verdict: verdict(rest).ok_or_else(refused)?,
            rms_m: at_handle("rms_m", ", rms ")?,
            force_rms_n: at_handle("push_n", "force rms ")?,
            penetration_ratio: number(line, "ratio ").ok(),
        })
    }
}

fn name_of<S: Serializer>(verdict: &Verdict, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(verdict.name())
}

/// The verdict that begins a text.
fn verdict(text: &str) -> Option<Verdict> {
    let text = text.split(',').next().unwrap_or_default();
    Verdict::ALL.into_iter().find(|verdict| verdict.text() == text)
}

/// A walk as the firmware reports it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WalkReport {
    /// Sum of K dB over the points, N^2 s/m^2.
    #[serde(rename = "area_n2_s_per_m2")]
    pub area: f64,
    /// Largest K of the boundary, N/m.
    pub stiffness_peak_n_per_m: f64,
    /// Largest B of the boundary, N s/m.
    pub damping_max_n_s_per_m: f64,
    pub hits: u32,
    /// B, K of each point of the boundary.
    #[serde(skip)]
    pub points: Vec<[f64; 2]>,
    pub ended_by: String,
    /// Time that it took on the board, s.
    pub virtual_s: f64,
}

/// Samples until the handle has come to rest after it was let go.
const REST_SAMPLES: u64 = 15_000;
/// Samples that `arm` takes.
const ARM_SAMPLES: u64 = 4_000;
/// Longest wait for a line of an experiment, samples: cooling down, way back and hit.
const LINE_SAMPLES: u64 = 3_000_000;

impl Session {
    /// A board with that image, or the one that is built for it, and the record of a scene, on the device of that scene.
    ///
    /// # Errors
    /// The image cannot be read or built, or is none of ours.
    pub fn open(board: Board, elf: Option<&PathBuf>, scene: NamedScene) -> Result<Self, Error> {
        let record = device::record(&scene, board)?;
        Self::open_with(board, elf, scene, record)
    }

    /// The same with that record in its flash, or with the image's own.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with(
        board: Board,
        elf: Option<&PathBuf>,
        scene: NamedScene,
        record: Option<Vec<u8>>,
    ) -> Result<Self, Error> {
        let path = match elf {
            Some(path) => path.clone(),
            None => image::build(board.name).map_err(Error::Internal)?,
        };
        Self::of(board, Elf::load(&path)?, &path.display().to_string(), scene, record)
    }

    /// A board with that image, which errors call `origin`, and that record in its flash, or with the image's own.
    ///
    /// # Errors
    /// The image is another board's, or none of ours.
    pub fn of(
        board: Board,
        elf: Elf,
        origin: &str,
        scene: NamedScene,
        record: Option<Vec<u8>>,
    ) -> Result<Self, Error> {
        let is_for = |board: &Board| elf.contains(board.name);
        if let Some(other) = BOARDS.iter().find(|other| is_for(other) && !is_for(&board)) {
            let (name, board) = (other.name, board.name);
            return Err(Error::Input(format!(
                "{origin} is an image of {name}, --board is {board}"
            )));
        }
        let table = log::table(&elf.bytes)
            .map_err(|error| Error::Input(format!("{origin} is no firmware of ours: {error}")))?;
        let elf = record.map_or_else(|| Ok(elf.clone()), |record| elf.with_record(&record))?;
        Ok(Self { board, scene, elf, table })
    }

    /// Switched on and booted, with the handle at rest where the device rests.
    ///
    /// # Errors
    /// The ELF is not this firmware, or its program ended.
    pub fn boot(&self) -> Result<World<'_>, Failed> {
        let rest_m = self.scene.scene.device.rest_position_m;
        let mut world = World::new(self.board, &self.elf, &self.table, &self.scene.scene, rest_m)?;
        world.run(500)?;
        world.hold(rest_m, false);
        Ok(world)
    }

    /// Booted while a hand holds the handle at the scene's 0, zeroed there, so that positions are the scene's, and let
    /// go until it rests.
    ///
    /// # Errors
    /// As [`boot`](Self::boot), or `zero` was refused.
    pub fn boot_at_zero(&self) -> Result<World<'_>, Failed> {
        self.zeroed(false)
    }

    /// The same at the moment in which it is let go.
    ///
    /// # Errors
    /// As [`boot_at_zero`](Self::boot_at_zero).
    pub fn boot_and_let_go(&self) -> Result<World<'_>, Failed> {
        self.let_go(false)
    }

    fn zeroed(&self, edge_times: bool) -> Result<World<'_>, Failed> {
        let mut world = self.let_go(edge_times)?;
        world.run(REST_SAMPLES)?;
        Ok(world)
    }

    fn let_go(&self, edge_times: bool) -> Result<World<'_>, Failed> {
        let new = if edge_times { World::with_edge_times } else { World::new };
        let mut world = new(self.board, &self.elf, &self.table, &self.scene.scene, 0.0)?;
        world.run(500)?;
        ask(&mut world, "zero")?;
        world.hold(0.0, false);
        Ok(world)
    }

    /// Zeroed at the scene's 0, with its wall, push and start, armed and free.
    fn ready(&self, cutoff_hz: f64) -> Result<World<'_>, Failed> {
        let scene = &self.scene.scene;
        let (tunings, estimator) = tuning(self.board, scene, cutoff_hz)?;
        let of_edges = estimator.missing(&[Sense::Force]) == Some(Sense::Edge);
        let mut world = self.zeroed(of_edges)?;
        let said = |key: &str, value: f64| scene.units.command(key, value);
        let mut lines = vec![
            "unlock envelope".to_owned(),
            format!("period {}", scene.actuator.period),
            format!("estimator {}", estimator.text()),
        ];
        lines.extend(tunings);
        lines.extend([
            format!("wall {}", said("position_m", scene.wall.position_m)),
            format!("start {}", said("start_m", scene.device.start_position_m)),
            format!("push {}", said("push_n", scene.wall_hit.push_n)),
            format!("settle {}", scene.wall_hit.settle_s),
            format!("window {}", scene.wall_hit.window_s),
            format!("rms {}", said("rms_limit_m", scene.wall_hit.rms_limit_m)),
        ]);
        if scene.wall_hit.criterion == Criterion::Quiet {
            lines.push("criterion quiet".to_owned());
        }
        let limit_n = scene.wall_hit.force_rms_limit_n;
        lines.extend(limit_n.map(|n| format!("force_rms {}", said("force_rms_limit_n", n))));
        ask_each(&mut world, &lines)?;
        Ok(world)
    }

    /// One hit; what the firmware says about it, and the board after it.
    ///
    /// # Errors
    /// The firmware refused a value, its hit ended without a verdict, or its program ended.
    pub fn hit(&self, [cutoff_hz, k, b]: [f64; 3]) -> Result<(BoardHit, World<'_>), Failed> {
        let mut world = self.ready(cutoff_hz)?;
        let units = self.scene.scene.units;
        let (k, b) = (units.command(K, k), units.command(B, b));
        ask_each(&mut world, &[format!("k {k}"), format!("b {b}"), "arm".to_owned()])?;
        world.run(ARM_SAMPLES)?;
        ask(&mut world, "hit")?;
        let mut pushes = vec![];
        let line = loop {
            let line = world.reply(LINE_SAMPLES)?;
            if !line.starts_with(BoardPush::HEAD) {
                break line;
            }
            world.lines.clear();
            pushes.push(line);
        };
        Ok((BoardHit::read(&pushes, line, units)?, world))
    }

    /// The boundary walk over the scene's grid; `each` sees every line of it.
    ///
    /// # Errors
    /// The firmware refused a value, its walk ended with an error, or its program ended.
    pub fn walk(&self, cutoff_hz: f64, mut each: impl FnMut(&str)) -> Result<WalkReport, Failed> {
        let mut world = self.ready(cutoff_hz)?;
        ask_each(&mut world, &grid(&self.scene.scene))?;
        ask_each(&mut world, &["stream off", "arm"])?;
        world.run(ARM_SAMPLES)?;
        ask(&mut world, "walk")?;
        let begun = world.powered.mcu.now();
        let units = self.scene.scene.units;
        let at_handle = |key: &str, line: &str, name: &str| {
            Ok::<_, Failed>(units.from_reply(key, number(line, name)?))
        };
        let mut points = vec![];
        loop {
            let line = world.reply(LINE_SAMPLES)?;
            world.lines.clear();
            each(&line);
            if line.starts_with("walk boundary") {
                points.push([at_handle(B, &line, ", b ")?, at_handle(K, &line, ": k ")?]);
            } else if line.starts_with("ok walk over") {
                #[expect(clippy::cast_precision_loss, reason = "for people")]
                let virtual_s =
                    (world.powered.mcu.now() - begun) as f64 / world.powered.mcu.core_hz() as f64;
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a count of hits"
                )]
                return Ok(WalkReport {
                    area: at_handle("area_n2_s_per_m2", &line, "area ")?,
                    stiffness_peak_n_per_m: at_handle(K, &line, "peak k ")?,
                    damping_max_n_s_per_m: at_handle(B, &line, "largest b ")?,
                    hits: number(&line, "hits ")? as u32,
                    points,
                    ended_by: line.rsplit(' ').next().unwrap_or_default().to_owned(),
                    virtual_s,
                });
            } else if line.starts_with("error") {
                return Err(Failed::Refused(line));
            }
        }
    }
}

/// What K and B are, as keys.
const K: &str = "stiffness_n_per_m";
const B: &str = "damping_n_s_per_m";

/// The commands that set a scene's grid: caps first, so that each step lies below its cap.
fn grid(scene: &Scene) -> [String; 6] {
    let walk = &scene.walk;
    let said = |key: &str, value: f64| scene.units.command(key, value);
    [
        format!("kmax {}", said(K, walk.stiffness_max_n_per_m)),
        format!("kstart {}", said(K, walk.stiffness_start_n_per_m)),
        format!("kstep {}", said(K, walk.stiffness_step_n_per_m)),
        format!("bstart {}", said(B, walk.damping_start_n_s_per_m)),
        format!("bstep {}", said(B, walk.damping_step_n_s_per_m)),
        format!("bmax {}", said(B, walk.damping_max_n_s_per_m)),
    ]
}

/// The number behind `name` in a line of the firmware.
fn number(line: &str, name: &str) -> Result<f64, Failed> {
    let rest = line.split_once(name).map_or("", |(_, rest)| rest);
    let word = rest.split([' ', ',']).next().unwrap_or_default();
    word.parse().map_err(|_| Failed::Refused(format!("no number behind {name:?} in: {line}")))
}

/// Asks, and takes an error of the firmware for a refusal.
///
/// # Errors
/// The firmware said no, or its program ended.
pub fn ask(world: &mut World<'_>, line: &str) -> Result<String, Failed> {
    let reply = world.ask(line)?;
    if reply.starts_with("ok") {
        Ok(reply)
    } else {
        Err(Failed::Refused(format!("{line}: {reply}")))
    }
}

/// The same of several lines.
///
/// # Errors
/// As [`ask`].
pub fn ask_each(world: &mut World<'_>, lines: &[impl AsRef<str>]) -> Result<(), Failed> {
    lines.iter().try_for_each(|line| ask(world, line.as_ref()).map(drop))
}

/// What the firmware is told of the scene's estimator: the commands that tune it, and its name. Whether
/// it has that estimator is for the firmware to say.
fn tuning(
    board: Board,
    scene: &Scene,
    cutoff_hz: f64,
) -> Result<(Vec<String>, EstimatorName), Failed> {
    let settings = scene.velocity.at(cutoff_hz);
    let estimator = settings.name();
    let edges = usize::from(board.wiring.captured.is_some());
    if let Some(sense) = estimator.missing(&[Sense::Force, Sense::Edge][..1 + edges]) {
        let (name, sense) = (estimator.text(), sense.text());
        let text = format!("velocity.estimator {name} needs {sense}, which {} has not", board.name);
        return Err(Failed::Refused(text));
    }
    let line = |place: usize| {
        let name = if place == 0 { "tuning".into() } else { format!("tuning{}", place + 1) };
        settings.parameter(place).map(|(_, value)| format!("{name} {value}"))
    };
    Ok(((0..PARAMETERS).filter_map(line).collect(), estimator))
}

impl From<Ended> for Error {
    fn from(ended: Ended) -> Self {
        Failed::Program(ended).into()
    }
}

impl From<Failed> for Error {
    fn from(failed: Failed) -> Self {
        match failed {
            Failed::Refused(text) => Self::input(text.trim_start_matches("error: ")),
            Failed::Program(ended) => Self::Internal(format!("the firmware: {ended:?}")),
        }
    }
}
