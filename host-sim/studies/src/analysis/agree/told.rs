//! The result of [`agree`](super::agree) as rows and sentences.

use serde::Serialize;

use super::{Agreement, Measured, Row, Tried};
use crate::{
    scene::{NamedScene, Units},
    table::{self, Cell, Kind, Table},
};

/// The whole result; docs/files.md has the keys.
#[derive(Clone, Debug, Serialize)]
pub struct Told<'a> {
    scene: &'a str,
    measured: &'a str,
    cutoff_hz: Option<f64>,
    agrees: bool,
    stiffness_step_n_per_m: f64,
    distance_n_per_m: f64,
    scatter_n_per_m: f64,
    walls: Vec<WallRow>,
    suspects: Vec<SuspectRow>,
    answers: Vec<String>,
}

impl<'a> Told<'a> {
    /// The result of comparing a scene with a measured walk. `name` is the name of the measured walk.
    pub fn new(
        scene: &'a NamedScene,
        name: &'a str,
        measured: &Measured,
        found: &Agreement,
    ) -> Self {
        let units = scene.scene.units;
        Self {
            scene: &scene.name,
            measured: name,
            cutoff_hz: scene.scene.velocity.has_cutoff().then_some(measured.cutoff_hz),
            agrees: found.agrees(),
            stiffness_step_n_per_m: found.step,
            distance_n_per_m: found.distance,
            scatter_n_per_m: found.scatter,
            walls: found.walls(),
            suspects: found.suspects(units),
            answers: found.answers(units),
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct WallRow {
    pub damping_n_s_per_m: f64,
    /// Mean predicted K.
    pub predicted_n_per_m: f64,
    pub predicted_low_n_per_m: f64,
    pub predicted_high_n_per_m: f64,
    /// K of the measured walk. It is 0 if the measured walk does not reach this B.
    pub measured_n_per_m: f64,
    /// K that the best suspect predicts; `None` if the walks agree.
    pub explained_n_per_m: Option<f64>,
}

#[derive(Clone, Debug, Serialize)]
pub struct SuspectRow {
    /// Name in reports.
    pub name: &'static str,
    pub key: String,
    pub unit: String,
    /// The value in the scene; `None` if the scene does not have the element.
    pub scene: Option<f64>,
    /// The value in the middle of the range from `low` to `high`. It is one of the tried values.
    pub value: f64,
    /// Smallest tried value that explains the difference as well as the best value.
    pub low: f64,
    /// Largest tried value that explains the difference as well as the best value.
    pub high: f64,
    /// Whether `low` is the first tried value or `high` is the last one.
    pub at_edge: bool,
    /// Distance that remains between the walks with this value.
    pub left_n_per_m: f64,
    /// Whether the suspect explains the whole difference.
    pub explains: bool,
}

/// The suspect's key in the scene file.
fn key_of(units: Units, tried: &Tried) -> String {
    let key = tried.suspect.key;
    if !units.is_rotary() {
        return key.into();
    }
    // A rotary scene computes each of the following numbers from several keys.
    match key {
        "device.mass_kg" => "rotary.handle_inertia_kg_m2".into(),
        "actuator.gain_n_per_v" => "rotary.torque_constant_n_m_per_a".into(),
        "device.damping_n_s_per_m" => "rotary.damping_n_m_s_per_rad".into(),
        "device.stiffness_n_per_m" => "rotary.stiffness_n_m_per_rad".into(),
        other => Units::rotary_key(other).unwrap_or_else(|| other.into()),
    }
}

impl Agreement {
    pub fn walls(&self) -> Vec<WallRow> {
        let best = self.best().first().copied();
        let row = |(place, row): (usize, &Row)| WallRow {
            damping_n_s_per_m: row.damping_n_s_per_m,
            predicted_n_per_m: row.predicted,
            predicted_low_n_per_m: row.predicted_low,
            predicted_high_n_per_m: row.predicted_high,
            measured_n_per_m: row.measured,
            explained_n_per_m: best.map(|best| best.predicted.get(place).copied().unwrap_or(0.0)),
        };
        self.rows.iter().enumerate().map(row).collect()
    }

    pub fn table(&self) -> Table {
        let columns: [table::Told<WallRow>; 6] = [
            ("damping_n_s_per_m", Kind::Number, |row| row.damping_n_s_per_m.into()),
            ("predicted_n_per_m", Kind::Number, |row| row.predicted_n_per_m.into()),
            ("predicted_low_n_per_m", Kind::Number, |row| row.predicted_low_n_per_m.into()),
            ("predicted_high_n_per_m", Kind::Number, |row| row.predicted_high_n_per_m.into()),
            ("measured_n_per_m", Kind::Number, |row| row.measured_n_per_m.into()),
            ("explained_n_per_m", Kind::Number, |row| Cell::number(row.explained_n_per_m)),
        ];
        Table::of(&columns, &self.walls())
    }

    /// The suspects in ascending order of the remaining distance, with values in `units`.
    pub fn suspects(&self, units: Units) -> Vec<SuspectRow> {
        let row = |tried: &Tried| {
            // An angle is in rad, as in the scene.
            let key = tried.suspect.key;
            let whole = key.ends_with("gain_n_per_v");
            let factor = match units.key(key) {
                Some((_, factor)) if !whole => factor,
                _ => 1.0,
            };
            let unit = match tried.suspect.unit {
                "m" if units.is_rotary() => "rad".into(),
                unit => units.written(unit).0.to_owned(),
            };
            let told = |value: f64| Units::told(value, factor);
            SuspectRow {
                name: tried.suspect.name,
                key: key_of(units, tried),
                unit,
                scene: tried.suspect.own.map(told),
                value: told(tried.value),
                low: told(tried.range[0]),
                high: told(tried.range[1]),
                at_edge: tried.at_edge,
                left_n_per_m: tried.left,
                explains: self.explains(tried),
            }
        };
        self.tried.iter().map(row).collect()
    }

    pub fn answers(&self, units: Units) -> Vec<String> {
        if self.agrees() {
            return vec![
                "they agree: the walk is no farther from the prediction than the scene's own walks"
                    .into(),
            ];
        }
        let suspects = self.suspects(units);
        let named: Vec<String> = suspects
            .iter()
            .filter(|row| row.explains)
            .map(|row| format!("{} ({})", row.name, row.key))
            .collect();
        let mut answers = vec!["they differ".to_owned()];
        match (named.as_slice(), self.best().first(), suspects.first()) {
            ([], Some(_), Some(first)) => answers.push(format!(
                "no number of the scene explains it alone; {} ({}) explains most",
                first.name, first.key
            )),
            ([], ..) => {
                answers.push("no number of the scene that was tried explains any of it".into())
            }
            ([only], ..) => answers.push(format!("explained by {only} alone")),
            ([first, rest @ ..], ..) => answers.push(format!(
                "explained by {first}, and as well by {}: measure which",
                rest.join(", ")
            )),
        }
        answers
    }
}
