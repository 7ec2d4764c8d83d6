//! Runs experiments on a virtual board. It sends the commands that a person would type.

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

pub struct Session {
    pub board: Board,
    pub scene: NamedScene,
    pub elf: Elf,
    /// Messages of the firmware's log.
    pub table: Table,
}

#[derive(Debug)]
pub enum Failed {
    /// The firmware refused a command. The text is its reply.
    Refused(String),
    /// The program ended or did not answer.
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
    pub line: String,
    pub verdict: Verdict,
    /// RMS of the position about its mean, in m.
    pub rms_m: f64,
    pub mean_m: f64,
    /// Two energies in J. The first is what the wall has absorbed in the last contact. The second is the most that the
    /// wall has supplied in one contact.
    pub port_j: [f64; 2],
    /// The result of each push of a quiet hit, in order. Empty for other hits. The fields above have the results of the
    /// push that decided the verdict.
    pub pushes: Vec<BoardPush>,
}

impl BoardHit {
    /// Reads a hit from its last line, and from the lines of its pushes if the hit has several pushes.
    ///
    /// # Errors
    /// The line is an error or not the result of a hit.
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

    /// The push that decided the verdict. It is the first unstable push. If all are stable, it is the push with the
    /// largest force variation.
    pub fn deciding(&self) -> Option<&BoardPush> {
        let force_n = |push: &&BoardPush| push.force_rms_n;
        let loudest = || self.pushes.iter().max_by(|a, b| force_n(a).total_cmp(&force_n(b)));
        self.pushes.iter().find(|push| push.verdict != Verdict::Stable).or_else(loudest)
    }
}

/// Result of one push of a quiet hit, as the firmware reports it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BoardPush {
    #[serde(skip)]
    pub line: String,
    pub push_n: f64,
    #[serde(serialize_with = "name_of")]
    pub verdict: Verdict,
    /// RMS of the position about its mean, in m.
    pub rms_m: f64,
    /// RMS of the force about its mean, in N.
    pub force_rms_n: f64,
    /// K times the mean penetration, divided by the mean force of the wall. `None` if the wall had no force.
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

/// The verdict at the start of `text`.
fn verdict(text: &str) -> Option<Verdict> {
    let text = text.split(',').next().unwrap_or_default();
    Verdict::ALL.into_iter().find(|verdict| verdict.text() == text)
}

/// Result of a walk, as the firmware reports it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WalkReport {
    /// Area under the boundary, in N^2 s/m^2. It is the sum of K dB over the points.
    #[serde(rename = "area_n2_s_per_m2")]
    pub area: f64,
    /// Largest K of the boundary, in N/m.
    pub stiffness_peak_n_per_m: f64,
    /// Largest B of the boundary, in N s/m.
    pub damping_max_n_s_per_m: f64,
    pub hits: u32,
    /// B and K of each point of the boundary.
    #[serde(skip)]
    pub points: Vec<[f64; 2]>,
    pub ended_by: String,
    /// Duration on the board, in s.
    pub virtual_s: f64,
}

/// Number of samples after which a released handle is at rest.
const REST_SAMPLES: u64 = 15_000;
const ARM_SAMPLES: u64 = 4_000;
/// Longest wait for a line of an experiment, in samples. This time includes cooling down, the return move and the hit.
const LINE_SAMPLES: u64 = 3_000_000;

impl Session {
    /// A session with this image and the device record of the scene. Without `elf` the board's image is built.
    ///
    /// # Errors
    /// The image cannot be read or built, or is not of this firmware.
    pub fn open(board: Board, elf: Option<&PathBuf>, scene: NamedScene) -> Result<Self, Error> {
        let record = device::record(&scene, board)?;
        Self::open_with(board, elf, scene, record)
    }

    /// Opens a session as [`open`](Self::open) does, but with this record in the image's flash. Without a record, the
    /// image's own record is used.
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

    /// A session with this image and this record in its flash. Without a record, the image's own record is used.
    /// `origin` is the image's name in errors.
    ///
    /// # Errors
    /// The image is for another board, or is not of this firmware.
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

    /// Switches the board on. Returns after the firmware has booted. The handle rests at the device's rest position.
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

    /// Boots the board while a hand holds the handle at the scene's position 0, and sets the zero there. So the board's
    /// positions are the scene's. Then releases the handle and waits until the handle rests.
    ///
    /// # Errors
    /// The same errors as in [`boot`](Self::boot), or the board refused `zero`.
    pub fn boot_at_zero(&self) -> Result<World<'_>, Failed> {
        self.zeroed(false)
    }

    /// Boots the board as [`boot_at_zero`](Self::boot_at_zero) does, but returns when the hand has just released the
    /// handle.
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

    /// Arms a board with its zero at the scene's position 0, and with the scene's wall, push and start. No hand holds
    /// the handle.
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

    /// Runs one hit. Returns the firmware's result, and the board after the hit.
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

    /// Runs the boundary walk over the scene's grid. `each` gets every line of the walk.
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

/// Names of the settings K and B.
const K: &str = "stiffness_n_per_m";
const B: &str = "damping_n_s_per_m";

/// The commands that set a scene's grid. The largest values of K and B come first, because a step must be below its
/// largest value.
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

/// The number after `name` in a line of the firmware.
fn number(line: &str, name: &str) -> Result<f64, Failed> {
    let rest = line.split_once(name).map_or("", |(_, rest)| rest);
    let word = rest.split([' ', ',']).next().unwrap_or_default();
    word.parse().map_err(|_| Failed::Refused(format!("no number behind {name:?} in: {line}")))
}

/// Sends a line and returns the reply.
///
/// # Errors
/// The firmware refused the line, or its program ended.
pub fn ask(world: &mut World<'_>, line: &str) -> Result<String, Failed> {
    let reply = world.ask(line)?;
    if reply.starts_with("ok") {
        Ok(reply)
    } else {
        Err(Failed::Refused(format!("{line}: {reply}")))
    }
}

/// Sends several lines as [`ask`] does.
pub fn ask_each(world: &mut World<'_>, lines: &[impl AsRef<str>]) -> Result<(), Failed> {
    lines.iter().try_for_each(|line| ask(world, line.as_ref()).map(drop))
}

/// The commands that tune the scene's estimator and then select it. The firmware refuses an estimator that is not in
/// the image.
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
