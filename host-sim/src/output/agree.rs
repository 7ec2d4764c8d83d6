//! What `agree` tells: both walks by B, whether they agree, and what would explain the difference.

use std::fmt::Write as _;

use serde::Serialize;

use super::{
    SCHEMA_VERSION,
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
};
use crate::{
    analysis::agree::{Agreement, STARTS, Tried},
    scene::Units,
    study::boundary::BoundaryPoint,
};

/// A comparison, to be told.
#[derive(Clone, Copy, Debug)]
pub struct AgreeReport<'a> {
    /// Name of the scene.
    pub scene: &'a str,
    /// Its units.
    pub units: Units,
    /// Name of the measured walk's file.
    pub measured: &'a str,
    /// What was found.
    pub found: &'a Agreement,
}

/// One B.
#[derive(Serialize)]
pub struct WallRow {
    damping_n_s_per_m: f64,
    predicted_n_per_m: f64,
    predicted_low_n_per_m: f64,
    predicted_high_n_per_m: f64,
    measured_n_per_m: f64,
    /// With the best suspect; `null` if the walks agree.
    explained_n_per_m: Option<f64>,
}

/// One suspect.
#[derive(Serialize)]
pub struct SuspectRow {
    name: &'static str,
    key: String,
    unit: String,
    scene: Option<f64>,
    value: f64,
    low: f64,
    high: f64,
    at_edge: bool,
    left_n_per_m: f64,
    explains: bool,
}

impl AgreeReport<'_> {
    /// The key of a suspect as the scene has it.
    fn key(&self, tried: &Tried) -> String {
        let key = tried.suspect.key;
        if !self.units.is_rotary() {
            return key.into();
        }
        // Of a rotary scene these are made of several keys.
        match key {
            "device.mass_kg" => "rotary.handle_inertia_kg_m2".into(),
            "actuator.gain_n_per_v" => "rotary.torque_constant_n_m_per_a".into(),
            "device.damping_n_s_per_m" => "rotary.damping_n_m_s_per_rad".into(),
            "device.stiffness_n_per_m" => "rotary.stiffness_n_m_per_rad".into(),
            other => Units::rotary_key(other).unwrap_or_else(|| other.into()),
        }
    }

    /// By B.
    pub fn walls(&self) -> Vec<WallRow> {
        let best = self.found.best().first().copied();
        let row = |(place, row): (usize, &crate::analysis::agree::Row)| WallRow {
            damping_n_s_per_m: row.damping_n_s_per_m,
            predicted_n_per_m: row.predicted,
            predicted_low_n_per_m: row.predicted_low,
            predicted_high_n_per_m: row.predicted_high,
            measured_n_per_m: row.measured,
            explained_n_per_m: best.map(|best| best.predicted.get(place).copied().unwrap_or(0.0)),
        };
        self.found.rows.iter().enumerate().map(row).collect()
    }

    /// The suspects, what leaves least first.
    pub fn suspects(&self) -> Vec<SuspectRow> {
        let row = |tried: &Tried| {
            // An angle is told in rad, as the scene's key has it.
            let key = tried.suspect.key;
            let whole = key.ends_with("gain_n_per_v");
            let factor = match self.units.key(key) {
                Some((_, factor)) if !whole => factor,
                _ => 1.0,
            };
            let unit = match tried.suspect.unit {
                "m" if self.units.is_rotary() => "rad".into(),
                unit => self.units.written(unit).0.to_owned(),
            };
            let told = |value: f64| Units::told(value, factor);
            SuspectRow {
                name: tried.suspect.name,
                key: self.key(tried),
                unit,
                scene: tried.suspect.own.map(told),
                value: told(tried.value),
                low: told(tried.range[0]),
                high: told(tried.range[1]),
                at_edge: tried.at_edge,
                left_n_per_m: tried.left,
                explains: self.found.explains(tried),
            }
        };
        self.found.tried.iter().map(row).collect()
    }

    /// For people.
    pub fn text(&self) -> String {
        let ((k_unit, k), (b_unit, b)) = (self.units.written("N/m"), self.units.written("N s/m"));
        let kt = |value: f64| three_digits(value * k);
        let mut text = format!(
            "{}, predicted from {STARTS} starts, beside {}\n{:>14} {:>34} {:>16} {:>12}",
            self.scene,
            self.measured,
            format!("B, {b_unit}"),
            format!("predicted K, {k_unit} (range)"),
            "measured K",
            "difference",
        );
        for row in &self.found.rows {
            let range = format!(
                "{} ({} to {})",
                kt(row.predicted),
                kt(row.predicted_low),
                kt(row.predicted_high)
            );
            let _ = write!(
                text,
                "\n{:>14} {range:>34} {:>16} {:>12}",
                Units::told(row.damping_n_s_per_m, b),
                kt(row.measured),
                kt(row.measured - row.predicted),
            );
        }
        let Agreement { step, distance, scatter, .. } = self.found;
        let _ = write!(
            text,
            "\ndistance beyond a step of K ({} {k_unit}): {} {k_unit}; walks of the scene among themselves: up to {} {k_unit}",
            kt(*step),
            kt(*distance),
            kt(*scatter)
        );
        for answer in self.answers() {
            let _ = write!(text, "\n{answer}");
        }
        for row in self.suspects() {
            let edge = if row.at_edge { "; the range ends with what was tried" } else { "" };
            let scene = row.scene.map_or("none".into(), |own| three_digits(own).to_string());
            let _ = write!(
                text,
                "\n  {:<18} {} {} ({} to {}), scene {scene}: leaves {} {k_unit}{edge}",
                row.name,
                three_digits(row.value),
                row.unit,
                three_digits(row.low),
                three_digits(row.high),
                kt(row.left_n_per_m),
            );
        }
        text
    }

    /// The answer, one sentence each.
    pub fn answers(&self) -> Vec<String> {
        if self.found.agrees() {
            return vec![
                "they agree: the walk is no farther from the prediction than the scene's own walks"
                    .into(),
            ];
        }
        let suspects = self.suspects();
        let named: Vec<String> = suspects
            .iter()
            .filter(|row| row.explains)
            .map(|row| format!("{} ({})", row.name, row.key))
            .collect();
        let mut answers = vec!["they differ".to_owned()];
        match (named.as_slice(), self.found.best().first(), suspects.first()) {
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

    /// The table of `--csv`.
    pub fn csv(&self) -> String {
        let mut text = String::from(
            "damping_n_s_per_m,predicted_n_per_m,predicted_low_n_per_m,predicted_high_n_per_m,measured_n_per_m,\
             explained_n_per_m,schema_version\n",
        );
        for row in self.walls() {
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{SCHEMA_VERSION}",
                row.damping_n_s_per_m,
                row.predicted_n_per_m,
                row.predicted_low_n_per_m,
                row.predicted_high_n_per_m,
                row.measured_n_per_m,
                row.explained_n_per_m.map(|k| k.to_string()).unwrap_or_default(),
            );
        }
        text
    }

    /// Both boundaries, and that with the best suspect.
    ///
    /// # Errors
    /// The figure cannot be drawn.
    pub fn figure(&self) -> Result<Figure, FigureError> {
        let curve = |name: &str, detail: String, of: &dyn Fn(usize) -> f64| {
            let point = |(place, row): (usize, &crate::analysis::agree::Row)| BoundaryPoint {
                damping_n_s_per_m: row.damping_n_s_per_m,
                stiffness_n_per_m: of(place),
            };
            let points = self.found.rows.iter().enumerate().map(point);
            let points = points.filter(|point| point.stiffness_n_per_m > 0.0).collect();
            Curve { name: name.into(), detail, ideal: false, points }
        };
        let rows = &self.found.rows;
        let starts = format!("mean of {STARTS} starts");
        let mut curves = vec![curve("predicted", starts, &|place| rows[place].predicted)];
        let mut subtitle = "they agree".to_owned();
        if let Some(best) = self.found.best().first() {
            let names: Vec<&str> =
                self.found.best().iter().map(|tried| tried.suspect.name).collect();
            let how = if self.found.explains(best) { "explained" } else { "explained in part" };
            subtitle = format!("they differ; {how} by {}", names.join(" or "));
            let detail = format!("what explains the difference best: {}", best.suspect.name);
            let name = format!("with another {}", best.suspect.name);
            let explained = |place: usize| best.predicted.get(place).copied().unwrap_or(0.0);
            curves.push(curve(&name, detail, &explained));
        } else if !self.found.agrees() {
            subtitle = "they differ; nothing that was tried explains it".into();
        }
        // On top of the one that explains it.
        curves.push(curve("measured", self.measured.into(), &|place| rows[place].measured));
        zwidth(&ZwidthPlot {
            title: format!("Predicted and measured walls, {}", self.scene),
            units: self.units,
            subtitle,
            legend: "Walk".into(),
            curves,
        })
    }
}

fn three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
