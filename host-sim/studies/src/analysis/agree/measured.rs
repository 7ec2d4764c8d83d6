//! The file of a walk: what `cargo board walk --csv` and `cargo sim walk --csv` write.

use crate::{
    error::Error,
    scene::{NamedScene, Units},
    study::boundary::BoundaryPoint,
};

/// A walk that was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Nominal cutoff, Hz; 0 for an estimator without one.
    pub cutoff_hz: f64,
    /// Largest stable K of each B.
    pub points: Vec<BoundaryPoint>,
}

/// Its columns, of a linear scene.
const COLUMNS: [&str; 3] = ["cutoff_hz", "damping_n_s_per_m", "stiffness_n_per_m"];
/// How far a B may lie from a step of the scene's walk, in steps.
const NEAR: f64 = 1e-3;

impl Measured {
    /// Reads the text of a file in the scene's units.
    ///
    /// # Errors
    /// [`Error::Input`] names the line and what is wrong, and what is allowed.
    pub fn parse(name: &str, text: &str, scene: &NamedScene) -> Result<Self, Error> {
        let units = scene.scene.units;
        let told = COLUMNS.map(|column| match units.key(column) {
            Some((renamed, factor)) => (renamed, factor),
            None => (column.to_owned(), 1.0),
        });
        let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
        let refuse = |why: String| Error::Input(format!("{name}: {why}"));
        let header: Vec<&str> =
            lines.next().map_or("", |(_, line)| line).split(',').map(str::trim).collect();
        let mut places = [0; 3];
        for (place, (column, _)) in places.iter_mut().zip(&told) {
            *place = header.iter().position(|has| has == column).ok_or_else(|| {
                let needed = told.iter().map(|(column, _)| column.as_str()).collect::<Vec<_>>();
                refuse(format!("the column {column} is missing, needed {}", needed.join(",")))
            })?;
        }
        let mut measured = Self { cutoff_hz: 0.0, points: vec![] };
        for (line, row) in lines {
            let cells: Vec<&str> = row.split(',').map(str::trim).collect();
            let mut values = [0.0; 3];
            for ((value, place), (column, factor)) in values.iter_mut().zip(places).zip(&told) {
                let cell = cells.get(place).copied().unwrap_or_default();
                let number = cell.parse::<f64>().ok().filter(|n| (0.0..=f64::MAX).contains(n));
                *value = number.ok_or_else(|| {
                    refuse(format!("line {line}: {column} is `{cell}`, allowed a number from 0 on"))
                })? / factor;
            }
            let [cutoff_hz, damping_n_s_per_m, stiffness_n_per_m] = values;
            if measured.points.is_empty() {
                measured.cutoff_hz = cutoff_hz;
            } else if cutoff_hz != measured.cutoff_hz {
                let first = measured.cutoff_hz;
                return Err(refuse(format!(
                    "line {line}: cutoff_hz is {cutoff_hz}, allowed {first}: one walk a file"
                )));
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
                return Err(refuse(format!(
                    "line {line}: {column} is {typed}, allowed {start} to {most} in steps of {step}, as [walk] of {} has it",
                    scene.name
                )));
            }
            if measured.points.iter().any(|point| seen(point) == place) {
                return Err(refuse(format!("line {line}: {column} is {typed} a second time")));
            }
            measured.points.push(BoundaryPoint { damping_n_s_per_m, stiffness_n_per_m });
        }
        if measured.points.is_empty() {
            return Err(refuse("no wall in it, needed one row for each B".into()));
        }
        Ok(measured)
    }
}

/// Which step of the scene's walk a B is; `None` if it is none.
pub(super) fn row_of(scene: &crate::scene::Scene, damping_n_s_per_m: f64) -> Option<usize> {
    let plan = scene.walk_plan();
    let steps = (damping_n_s_per_m - plan.damping_start_n_s_per_m) / plan.damping_step_n_s_per_m;
    let whole = steps.round();
    let most = plan.damping_max_n_s_per_m + NEAR * plan.damping_step_n_s_per_m;
    let fits = (steps - whole).abs() < NEAR && whole >= 0.0 && damping_n_s_per_m <= most;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a step of a walk, which has far fewer than 2^32"
    )]
    fits.then_some(whole as usize)
}
