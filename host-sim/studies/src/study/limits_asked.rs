//! Checks the options for limits, and makes a fine enough grid for their walks. Command line and Python share this
//! code.

use std::fmt;

use super::limits::Limit;
use crate::{
    error::Error,
    scene::{Scene, Walk},
};

/// Divisor of the scene's step of K for the default grid. The step of B is divided by half of it.
const FINER: f64 = 4.0;

/// A limit as the user gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LimitAsked {
    /// A limit of the RMS, in m.
    Rms(f64),
    /// The sensation level, with the limits of the scene.
    Felt,
    /// A limit of the sensation level, in dB. The threshold curve is shifted by this value.
    FeltAt(f64),
    /// A quiet wall, with the limit of the force that the scene has.
    Quiet,
}

impl LimitAsked {
    /// Reads one limit. An error says what is allowed.
    pub fn parse(text: &str) -> Result<Self, String> {
        let one = text.trim();
        let (level, number) =
            one.strip_prefix("felt=").map_or((false, one), |number| (true, number));
        match number.parse::<f64>() {
            _ if one == "felt" => Ok(Self::Felt),
            _ if one == "quiet" => Ok(Self::Quiet),
            Ok(level_db) if level && level_db.is_finite() => Ok(Self::FeltAt(level_db)),
            Ok(limit_m) if !level && limit_m.is_finite() && limit_m > 0.0 => Ok(Self::Rms(limit_m)),
            _ => Err(format!(
                "`{one}` is no limit, allowed an RMS in m (above 0), quiet, felt, or felt=DB (DB over the threshold)"
            )),
        }
    }

    /// The limit with the values of a scene.
    pub fn of(self, scene: &Scene) -> Limit {
        match self {
            Self::Rms(limit_m) => Limit::Rms(limit_m),
            Self::Felt => Limit::Felt(scene.wall_hit.felt_limit_db),
            Self::FeltAt(level_db) => Limit::Felt(level_db),
            Self::Quiet => Limit::Quiet(scene.wall_hit.force_rms_limit_n()),
        }
    }
}

impl fmt::Display for LimitAsked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rms(limit_m) => write!(f, "{limit_m:e}"),
            Self::Felt => f.write_str("felt"),
            Self::FeltAt(level_db) => write!(f, "felt={level_db}"),
            Self::Quiet => f.write_str("quiet"),
        }
    }
}

/// The scene's walk, with these steps of K and B and these first values. `None` for the steps gives the default grid.
pub fn finer(scene: &Scene, steps: Option<[f64; 2]>, starts: Option<[f64; 2]>) -> Walk {
    let own = &scene.walk;
    let default = [own.stiffness_step_n_per_m / FINER, own.damping_step_n_s_per_m / FINER * 2.0];
    let steps = steps.unwrap_or(default);
    on_grid(own, starts.unwrap_or(steps), steps)
}

/// A walk that begins at this K and B and has these steps. The caps do not change.
pub(super) fn on_grid(own: &Walk, [k, b]: [f64; 2], [k_step, b_step]: [f64; 2]) -> Walk {
    Walk {
        stiffness_start_n_per_m: k,
        stiffness_step_n_per_m: k_step,
        damping_start_n_s_per_m: b,
        damping_step_n_s_per_m: b_step,
        ..*own
    }
}

/// Names that error messages use for limits and steps.
#[derive(Clone, Copy, Debug)]
pub struct Names {
    pub limits: &'static str,
    /// Name of the steps and first values of K and B.
    pub steps: &'static str,
}

/// Checks every limit and the grid before the first walk is made.
///
/// # Errors
/// The scene does not allow a limit or the grid.
pub fn check(scene: &Scene, limits: &[Limit], walk: Walk, names: Names) -> Result<(), Error> {
    let refused = |name: &str, error: String| Error::Input(format!("{name}: {error}"));
    let mut changed = Scene { walk, ..scene.clone() };
    changed.check().map_err(|error| refused(names.steps, error))?;
    for limit in limits {
        changed.wall_hit = scene.wall_hit.clone();
        limit.set(&mut changed.wall_hit);
        changed.check().map_err(|error| refused(names.limits, error))?;
    }
    Ok(())
}

/// Names of the columns that describe the grid of the walks.
pub const GRID: [&str; 6] = [
    "stiffness_start_n_per_m",
    "stiffness_step_n_per_m",
    "stiffness_max_n_per_m",
    "damping_start_n_s_per_m",
    "damping_step_n_s_per_m",
    "damping_max_tried_n_s_per_m",
];

/// Values of the columns [`GRID`] for a walk.
pub fn grid(walk: &Walk) -> [f64; 6] {
    [
        walk.stiffness_start_n_per_m,
        walk.stiffness_step_n_per_m,
        walk.stiffness_max_n_per_m,
        walk.damping_start_n_s_per_m,
        walk.damping_step_n_s_per_m,
        walk.damping_max_n_s_per_m,
    ]
}
