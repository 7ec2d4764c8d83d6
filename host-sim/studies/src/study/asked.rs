//! Checks the options for a scene before the first hit. Command line and Python share this code.

use std::sync::atomic::AtomicBool;

use zwidth::VelocitySettings;

use super::{
    boundary::Boundary,
    walk::{settles_in_s, walk},
};
use crate::{
    analysis::linear::{Device, Elements, Loop, transfer_function},
    engine::Engine,
    error::Error,
    range::{refused, within},
    scene::{self, NamedScene, velocity::describe},
    simulation::prepared::{Numeric, PreparedScene, WallHit},
};

/// Names that error messages use: those of a command's options, or of a function's arguments.
#[derive(Clone, Copy, Debug)]
pub struct Names {
    /// Name of the nominal cutoff of the filter, in Hz.
    pub cutoff: &'static str,
    /// Name of the stiffness of the wall, in N/m.
    pub stiffness: &'static str,
    /// Name of the damping of the wall, in N s/m.
    pub damping: &'static str,
    /// Name of the distance from the scene's start, in counts.
    pub start_offset: &'static str,
}

/// Prepares a user's scene. No hit may reach the wall with a speed above the range of the core's velocity.
///
/// # Errors
/// A hit is too fast, or the scene cannot be prepared.
pub fn prepare(scene: &NamedScene) -> Result<PreparedScene, Error> {
    let prepared = PreparedScene::new(&scene.scene)?;
    prepared.check_approach()?;
    Ok(prepared)
}

/// The scene's filter at the requested cutoff. If no cutoff is requested, the cutoff of `[velocity]` is used. If
/// `[velocity]` has no cutoff, the only cutoff of `[sweep]` is used.
///
/// # Errors
/// None of these cutoffs exists, or the estimator has no cutoff.
pub fn filter(scene: &NamedScene, asked_hz: Option<f64>) -> Result<VelocitySettings, Error> {
    let velocity = &scene.scene.velocity;
    if asked_hz.is_some() && !velocity.has_cutoff() {
        return Err(no_cutoff(scene));
    }
    let asked = asked_hz.map(|cutoff_hz| velocity.at(cutoff_hz));
    asked.or(velocity.settings()).or(only_of_sweep(&scene.scene)).ok_or_else(|| {
        let (scene, estimator) = (&scene.name, velocity.name());
        Error::Input(format!("{scene}: a cutoff is missing, the estimator {estimator} needs it"))
    })
}

/// The filter of a scene that has its only cutoff in `[sweep]`; `None` for other scenes.
pub fn only_of_sweep(scene: &scene::Scene) -> Option<VelocitySettings> {
    match (scene.velocity.settings(), scene.sweep.cutoffs_hz.as_slice()) {
        (None, [only]) => Some(scene.velocity.at(*only)),
        _ => None,
    }
}

/// The scene's filters at these cutoffs. The list is empty if there are no cutoffs.
///
/// # Errors
/// Cutoffs are given, but the estimator has no cutoff.
pub fn filters(scene: &NamedScene, cutoffs_hz: &[f64]) -> Result<Vec<VelocitySettings>, Error> {
    cutoffs_hz.iter().map(|&cutoff_hz| filter(scene, Some(cutoff_hz))).collect()
}

/// The error for a cutoff that is given although the estimator has no cutoff.
pub fn no_cutoff(scene: &NamedScene) -> Error {
    Error::Input(format!(
        "{}: the estimator {} has no cutoff; its parameters are keys of [velocity]",
        scene.name,
        scene.scene.velocity.name()
    ))
}

/// Checks the start of the hits.
///
/// # Errors
/// The start is inside the wall, or too far away to be realistic.
pub fn check_start(scene: &NamedScene, offset_counts: f64, names: Names) -> Result<(), Error> {
    within(names.start_offset, offset_counts, -1e6..=1e6).map_err(Error::Input)?;
    let (device, wall) = (&scene.scene.device, &scene.scene.wall);
    let counts = (wall.position_m - device.start_position_m) / scene.scene.encoder.resolution_m;
    if offset_counts <= counts {
        return Ok(());
    }
    Err(Error::Input(refused(names.start_offset, offset_counts, &(-1e6..=counts.min(1e6)))))
}

/// Checks whether the core accepts cutoff, K and B.
pub fn check_wall(scene: &NamedScene, wall: &WallHit, names: Names) -> Result<(), Error> {
    scene
        .scene
        .settings(wall.velocity, wall.stiffness_n_per_m, wall.damping_n_s_per_m)
        .build(&scene.scene.design())
        .map(|_| ())
        .map_err(|error| {
            let name = match error.parameter {
                "cutoff_hz" => names.cutoff,
                "stiffness_n_per_m" => names.stiffness,
                "damping_n_s_per_m" => names.damping,
                other => other,
            };
            let refused = refused(name, error.value, &error.range);
            Error::Input(scene.scene.units.text(&refused))
        })
}

/// Refuses a B that the scene's walk does not reach, because K is read at this B. Error messages name the B with
/// `option`.
pub fn check_read_off(
    scene: &NamedScene,
    damping_n_s_per_m: f64,
    option: &str,
) -> Result<(), Error> {
    let plan = scene.scene.walk_plan();
    let range = plan.damping_start_n_s_per_m..=plan.damping_max_n_s_per_m;
    within(option, damping_n_s_per_m, range)
        .map_err(|error| Error::Input(scene.scene.units.text(&error)))
}

/// Checks the requested hit and returns it. The wall is `[K, B]` if it is given. Otherwise it is the first wall of the
/// scene's walk.
///
/// # Errors
/// A value is out of range.
pub fn hit(
    scene: &NamedScene,
    asked_cutoff: Option<f64>,
    wall: Option<[f64; 2]>,
    start_offset_counts: f64,
    names: Names,
) -> Result<WallHit, Error> {
    let walk = &scene.scene.walk;
    let [stiffness_n_per_m, damping_n_s_per_m] =
        wall.unwrap_or([walk.stiffness_start_n_per_m, walk.damping_start_n_s_per_m]);
    let velocity = filter(scene, asked_cutoff)?;
    let hit = WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts };
    check_wall(scene, &hit, names)?;
    check_start(scene, start_offset_counts, names)?;
    Ok(hit)
}

/// Walks from the hit `first`, and returns the boundary.
///
/// # Errors
/// The first wall is unstable, the handle does not reach it, or `stop` was set. If the wall is unstable, the error says
/// what to change.
pub fn boundary(
    scene: &NamedScene,
    engine: Engine,
    prepared: &PreparedScene,
    numeric: Numeric,
    first: &WallHit,
    stop: &AtomicBool,
) -> Result<Boundary, Error> {
    let boundary = walk(engine, prepared, numeric, first.velocity, first.start_offset_counts, stop)
        .map_err(|error| error.of(&scene.name))?;
    if boundary.ended.is_some() {
        return Ok(boundary);
    }
    let estimator = describe(&first.velocity, scene.scene.control.rate_hz);
    let reason = match settles_in_s(prepared, numeric, first) {
        Some(settle_s) => format!(
            "still settles in the window with {estimator}; raise wall_hit.settle_s, {settle_s} is enough here"
        ),
        None => format!(
            "is unstable with {estimator}; lower walk.stiffness_start_n_per_m or change the estimator's tuning"
        ),
    };
    let units = scene.scene.units;
    Err(Error::Input(units.text(&format!(
        "{}: the first point of the walk, K = {} N/m and B = {} N s/m, {reason}",
        scene.name, first.stiffness_n_per_m, first.damping_n_s_per_m
    ))))
}

/// The linear loop of a scene with its linear elements. If `multirate` is true, the loop has its real period and
/// latency. Otherwise every sample gives a force without latency, as in the paper's equations (3) to (5).
///
/// # Errors
/// The estimator is not linear, has inputs in addition to the position, or has a tuning out of range.
pub fn linear_loop(
    scene: &scene::Scene,
    filter: &VelocitySettings,
    multirate: bool,
) -> Result<Loop, Error> {
    let scene::Device { mass_kg, damping_n_s_per_m, stiffness_n_per_m, .. } = scene.device;
    let device = Device { mass_kg, damping_n_s_per_m, stiffness_n_per_m };
    let estimator =
        transfer_function(filter, &scene.design()).map_err(Error::input)?.ok_or_else(|| {
            let name = filter.name().text();
            Error::Input(format!(
                "the estimator {name} is no linear function of the position alone"
            ))
        })?;
    let mut of = Loop::single_rate(device, scene.control.rate_hz, estimator);
    of.elements = Elements { amplifier: scene.amplifier, mode: scene.mode, arm: scene.arm };
    if multirate {
        of.period = scene.actuator.period;
        of.latency_samples = scene.actuator.latency;
    }
    Ok(of)
}

/// The walls of a grid. Each wall has a number. K changes fastest, then B, then the filter.
#[derive(Clone, Debug, PartialEq)]
pub struct Walls {
    pub filters: Vec<VelocitySettings>,
    /// Dampings B of the walls, in N s/m.
    pub dampings: Vec<f64>,
    /// Stiffnesses K of the walls, in N/m.
    pub stiffnesses: Vec<f64>,
    /// Distance from the scene's start, in counts.
    pub start_offset_counts: f64,
}

impl Walls {
    pub fn count(&self) -> u64 {
        let lengths = [self.filters.len(), self.dampings.len(), self.stiffnesses.len()];
        lengths.map(|length| length as u64).iter().product()
    }

    /// The wall with this number. The number must be below [`count`](Self::count).
    #[expect(clippy::cast_possible_truncation, reason = "remainders by lengths")]
    pub fn wall(&self, number: u64) -> WallHit {
        let (per_filter, per_damping) =
            ((self.dampings.len() * self.stiffnesses.len()) as u64, self.stiffnesses.len() as u64);
        WallHit {
            velocity: self.filters[(number / per_filter) as usize],
            damping_n_s_per_m: self.dampings[(number % per_filter / per_damping) as usize],
            stiffness_n_per_m: self.stiffnesses[(number % per_damping) as usize],
            start_offset_counts: self.start_offset_counts,
        }
    }

    /// Checks every value of every list, and the start, before the first hit.
    pub fn check(&self, scene: &NamedScene, names: Names) -> Result<(), Error> {
        let first = self.wall(0);
        let walls = (self.filters.iter().map(|&velocity| WallHit { velocity, ..first }))
            .chain(self.dampings.iter().map(|&b| WallHit { damping_n_s_per_m: b, ..first }))
            .chain(self.stiffnesses.iter().map(|&k| WallHit { stiffness_n_per_m: k, ..first }));
        for wall in walls {
            check_wall(scene, &wall, names)?;
        }
        check_start(scene, self.start_offset_counts, names)
    }
}
