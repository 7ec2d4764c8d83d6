//! Reads the walk file that `cargo board walk --csv` or `cargo sim walk --csv` writes.

use std::path::Path;

use crate::{
    error::Error,
    input::{
        self,
        table::{FROM_0, Table},
    },
    numerics,
    scene::{NamedScene, Units},
    study::boundary::BoundaryPoint,
};

#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Nominal cutoff of the walk's estimator, in Hz; 0 for an estimator without a cutoff.
    pub cutoff_hz: f64,
    /// For each B of the walk, the largest stable K.
    pub points: Vec<BoundaryPoint>,
}

/// Columns of the walk file, if the scene is linear.
const COLUMNS: [&str; 3] = ["cutoff_hz", "damping_n_s_per_m", "stiffness_n_per_m"];
/// Largest distance of a measured B from the B of the scene's walk to which it belongs, in steps of B.
const NEAR: f64 = 1e-3;

impl Measured {
    /// Reads a file in the units of the scene.
    ///
    /// # Errors
    /// [`Error::Input`] names the file, the line, the error, and what is allowed.
    pub fn load(path: &Path, scene: &NamedScene) -> Result<Self, Error> {
        let text = input::read_text(path, input::RECORD)?;
        Self::parse(&text, scene)
            .map_err(|error| Error::Input(error).of(&path.display().to_string()))
    }

    pub(super) fn parse(text: &str, scene: &NamedScene) -> Result<Self, String> {
        let units = scene.scene.units;
        let told = COLUMNS.map(|column| match units.key(column) {
            Some((renamed, factor)) => (renamed, factor),
            None => (column.to_owned(), 1.0),
        });
        let columns = told.each_ref().map(|(column, _)| (column.as_str(), FROM_0));
        let mut measured = Self { cutoff_hz: 0.0, points: vec![] };
        for (line, values) in Table::new(text)?.numbers(&columns)? {
            let [cutoff_hz, damping_n_s_per_m, stiffness_n_per_m] =
                [0, 1, 2].map(|n| values[n] / told[n].1);
            if measured.points.is_empty() {
                measured.cutoff_hz = cutoff_hz;
            } else if cutoff_hz != measured.cutoff_hz {
                let first = measured.cutoff_hz;
                return Err(format!(
                    "line {line}: cutoff_hz is {cutoff_hz}, allowed {first}: one walk a file"
                ));
            }
            let place = row_of(&scene.scene, damping_n_s_per_m);
            let seen = |point: &BoundaryPoint| row_of(&scene.scene, point.damping_n_s_per_m);
            let (column, factor) = &told[1];
            let typed = Units::told(damping_n_s_per_m, *factor);
            if place.is_none() {
                let plan = scene.scene.walk_plan();
                let [start, step, most] = [
                    plan.damping_start_n_s_per_m,
                    plan.damping_step_n_s_per_m,
                    plan.damping_max_n_s_per_m,
                ]
                .map(|b| Units::told(b, *factor));
                return Err(format!(
                    "line {line}: {column} is {typed}, allowed {start} to {most} in steps of {step}, as [walk] of {} has it",
                    scene.name
                ));
            }
            if measured.points.iter().any(|point| seen(point) == place) {
                return Err(format!("line {line}: {column} is {typed} a second time"));
            }
            measured.points.push(BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m });
        }
        if measured.points.is_empty() {
            return Err("no wall in it, needed one row for each B".into());
        }
        Ok(measured)
    }
}

/// Index of a B in the scene's walk; `None` if the walk does not have this B.
pub(super) fn row_of(scene: &crate::scene::Scene, damping_n_s_per_m: f64) -> Option<usize> {
    let plan = scene.walk_plan();
    let steps = (damping_n_s_per_m - plan.damping_start_n_s_per_m) / plan.damping_step_n_s_per_m;
    let whole = steps.round();
    let most = plan.damping_max_n_s_per_m + NEAR * plan.damping_step_n_s_per_m;
    let fits = (steps - whole).abs() < NEAR && whole >= 0.0 && damping_n_s_per_m <= most;
    fits.then_some(numerics::whole(whole))
}
