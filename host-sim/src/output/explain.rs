//! What `explain` writes: a ranked table for programs, one for people, the boundaries as a picture.

use std::fmt::Write as _;

use serde::Serialize;
use zwidth::velocity::EstimatorName;

use super::{
    SCHEMA_VERSION,
    figure::{Curve, Figure, FigureError, ZwidthPlot, zwidth},
    limits::three_digits,
    report,
};
use crate::{
    analysis::explain::{CLOCK_HZ, Explained, Explanation, Kind},
    scene::Units,
};

/// Three digits, of what is below 1 too.
fn digits(value: f64) -> String {
    match format!("{value:.2e}").parse::<f64>() {
        Ok(rounded) if value.abs() < 0.995 => rounded.to_string(),
        _ => three_digits(value),
    }
}

/// A noise, which may be of any size.
fn noise(value: f64) -> String {
    if (0.01..1e4).contains(&value) { digits(value) } else { format!("{value:.2e}") }
}

/// Changes whose boundaries are drawn.
const DRAWN: usize = 4;

/// A row of the table: a change, or the scene as it is.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// 0 for the scene as it is.
    rank: usize,
    change: &'static str,
    what: String,
    kind: &'static str,
    times_the_area: Option<f64>,
    times_low: Option<f64>,
    times_high: Option<f64>,
    /// `yes`, `worse`, or `unsure`: against the scene as it is.
    better: &'static str,
    area_n2_s_per_m2: f64,
    area_low_n2_s_per_m2: f64,
    area_high_n2_s_per_m2: f64,
    stiffness_peak_n_per_m: f64,
    stiffness_peak_low_n_per_m: f64,
    stiffness_peak_high_n_per_m: f64,
    damping_n_s_per_m: f64,
    stiffness_n_per_m: f64,
    stiffness_low_n_per_m: f64,
    stiffness_high_n_per_m: f64,
    velocity_noise_m_per_s: f64,
    force_noise_n: f64,
    estimator: &'static str,
    tuning: Option<f64>,
    tuning_unit: Option<&'static str>,
    tuning_at_edge: bool,
    search_settled: bool,
    capped_walks: usize,
    walks: usize,
    hits: u64,
    cycles_per_s: Option<f64>,
    share_of_core: Option<f64>,
    cost: String,
}

const HEADER: &str = "rank,change,what,kind,times_the_area,times_low,times_high,better,area_n2_s_per_m2,\
                      area_low_n2_s_per_m2,area_high_n2_s_per_m2,stiffness_peak_n_per_m,stiffness_peak_low_n_per_m,\
                      stiffness_peak_high_n_per_m,damping_n_s_per_m,stiffness_n_per_m,stiffness_low_n_per_m,\
                      stiffness_high_n_per_m,velocity_noise_m_per_s,force_noise_n,estimator,tuning,tuning_unit,\
                      tuning_at_edge,search_settled,capped_walks,walks,hits,cycles_per_s,share_of_core,cost,schema_version";

impl Row {
    /// Times the area, with its range; `?` where the starts cannot tell it from 1.
    fn times(&self) -> String {
        match (self.times_the_area, self.times_low, self.times_high) {
            (Some(mean), Some(low), Some(high)) => {
                let [mean, low, high] = [mean, low, high].map(digits);
                let mark = if self.better == "unsure" { "?" } else { "" };
                format!("{mean}{mark} ({low} to {high})")
            }
            _ => String::new(),
        }
    }

    /// Times that; `>` where a cap cut it.
    fn area(&self, times: f64) -> String {
        let cut = if self.capped_walks > 0 { ">" } else { "" };
        format!("{cut}{}", digits(self.area_n2_s_per_m2 * times))
    }

    /// Percent of the core.
    fn share(&self) -> String {
        self.share_of_core.map_or("?".into(), |share| format!("{:.2}", 100.0 * share))
    }

    /// What people read of it: rank, change, times the area, area, peak K, K at B, noise, share of the core, cost.
    /// Areas, stiffnesses and velocities are multiplied by those factors.
    fn cells(&self, [area, k, v]: [f64; 3]) -> [String; 9] {
        [
            if self.rank == 0 { String::new() } else { self.rank.to_string() },
            self.what.clone(),
            self.times(),
            self.area(area),
            digits(k * self.stiffness_peak_n_per_m),
            digits(k * self.stiffness_n_per_m),
            noise(v * self.velocity_noise_m_per_s),
            self.share(),
            self.cost.clone(),
        ]
    }
}

/// An explanation of a scene of that name.
pub struct ExplainReport<'a> {
    /// The scene's name.
    pub scene: &'a str,
    /// What it speaks.
    pub units: Units,
    /// What was found.
    pub found: &'a Explanation,
}

/// Units that the tables for people speak, and what their numbers are multiplied by.
struct Spoken {
    k: (&'static str, f64),
    v: (&'static str, f64),
    area_unit: String,
    area: f64,
}

/// The power of ten below that number whose exponent is a multiple of three.
fn thousands(value: f64) -> f64 {
    3.0 * (value.log10() / 3.0).floor()
}

impl ExplainReport<'_> {
    fn spoken(&self) -> Spoken {
        let [k, v] = ["N/m", "m/s"].map(|unit| self.units.written(unit));
        let (unit, factor) = self.units.written("N² s/m²");
        let Explanation { base, changes, .. } = self.found;
        let areas = [base].into_iter().chain(changes).map(|one| one.area()[0] * factor);
        // by the scene's own area, or by the first that is one
        let power = areas.into_iter().find(|area| *area > 0.0).map_or(0.0, thousands);
        let area_unit = if power == 0.0 { unit.into() } else { format!("10^{power} {unit}") };
        Spoken { k, v, area_unit, area: factor / 10f64.powf(power) }
    }

    fn row(&self, rank: usize, one: &Explained) -> Row {
        let Explanation { base, damping_n_s_per_m, .. } = self.found;
        let damping = *damping_n_s_per_m;
        let [area, area_low, area_high] = one.area();
        let [peak, peak_low, peak_high] = one.stiffness_peak();
        let [stiffness, stiffness_low, stiffness_high] = one.stiffness_at(damping);
        let times = one.change.as_ref().and_then(|_| one.times(base));
        let change = one.change.as_ref();
        let (name, values) = EstimatorName::of(&one.settings);
        let parameter = name.parameters()[0];
        let cycles_per_s = change.map_or(Some(0.0), |change| change.cycles_per_s);
        Row {
            rank,
            change: change.map_or("none", |change| change.name),
            what: change.map_or("the scene as it is".into(), |change| change.text.clone()),
            kind: change.map_or("", |change| change.kind.name()),
            times_the_area: times.map(|times| times[0]),
            times_low: times.map(|times| times[1]),
            times_high: times.map(|times| times[2]),
            better: match change {
                None => "",
                Some(_) if self.found.is_better(one) => "yes",
                Some(_) if self.found.is_worse(one) => "worse",
                Some(_) => "unsure",
            },
            area_n2_s_per_m2: area,
            area_low_n2_s_per_m2: area_low,
            area_high_n2_s_per_m2: area_high,
            stiffness_peak_n_per_m: peak,
            stiffness_peak_low_n_per_m: peak_low,
            stiffness_peak_high_n_per_m: peak_high,
            damping_n_s_per_m: damping,
            stiffness_n_per_m: stiffness,
            stiffness_low_n_per_m: stiffness_low,
            stiffness_high_n_per_m: stiffness_high,
            velocity_noise_m_per_s: one.noise_m_per_s,
            force_noise_n: damping * one.noise_m_per_s,
            estimator: name.text(),
            tuning: parameter.map(|_| values[0]),
            tuning_unit: parameter.map(|parameter| parameter.unit),
            tuning_at_edge: one.at_edge,
            search_settled: one.settled,
            capped_walks: one.boundaries.capped(),
            walks: one.boundaries.len(),
            hits: one.hits,
            cycles_per_s,
            share_of_core: cycles_per_s.map(|cycles| cycles / CLOCK_HZ),
            cost: change.map_or(String::new(), |change| change.cost.clone()),
        }
    }

    /// All rows, the scene as it is first, then the changes by rank.
    pub fn rows(&self) -> Vec<Row> {
        let changes = self.found.changes.iter().enumerate();
        let changes = changes.map(|(place, one)| self.row(self.found.rank(place), one));
        [self.row(0, &self.found.base)].into_iter().chain(changes).collect()
    }

    /// `explain.csv`.
    pub fn csv(&self) -> String {
        let option = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        let plain = |text: &str| text.replace(',', ";");
        let mut text = format!("{HEADER}\n");
        for row in self.rows() {
            let cells = [
                row.rank.to_string(),
                row.change.into(),
                plain(&row.what),
                row.kind.into(),
                option(row.times_the_area),
                option(row.times_low),
                option(row.times_high),
                row.better.into(),
                row.area_n2_s_per_m2.to_string(),
                row.area_low_n2_s_per_m2.to_string(),
                row.area_high_n2_s_per_m2.to_string(),
                row.stiffness_peak_n_per_m.to_string(),
                row.stiffness_peak_low_n_per_m.to_string(),
                row.stiffness_peak_high_n_per_m.to_string(),
                row.damping_n_s_per_m.to_string(),
                row.stiffness_n_per_m.to_string(),
                row.stiffness_low_n_per_m.to_string(),
                row.stiffness_high_n_per_m.to_string(),
                row.velocity_noise_m_per_s.to_string(),
                row.force_noise_n.to_string(),
                row.estimator.into(),
                option(row.tuning),
                row.tuning_unit.unwrap_or_default().into(),
                row.tuning_at_edge.to_string(),
                row.search_settled.to_string(),
                row.capped_walks.to_string(),
                row.walks.to_string(),
                row.hits.to_string(),
                option(row.cycles_per_s),
                option(row.share_of_core),
                plain(&row.cost),
                SCHEMA_VERSION.to_string(),
            ];
            let _ = writeln!(text, "{}", cells.join(","));
        }
        text
    }

    /// `boundary.csv`: every point of every walk.
    pub fn boundary_csv(&self) -> String {
        let mut text = String::from("change,repeat,damping_n_s_per_m,stiffness_n_per_m\n");
        let Explanation { base, changes, .. } = self.found;
        for one in [base].into_iter().chain(changes) {
            let name = one.change.as_ref().map_or("none", |change| change.name);
            for (repeat, boundary) in one.boundaries.iter().enumerate() {
                for point in &boundary.points {
                    let (b, k) = (point.damping_n_s_per_m, point.stiffness_n_per_m);
                    let _ = writeln!(text, "{name},{repeat},{b},{k}");
                }
            }
        }
        text
    }

    /// The answers, one sentence each.
    pub fn answers(&self) -> Vec<String> {
        let named = |kind: Kind, question: &str| {
            let best = self.found.best_of(kind)?;
            let change = best.change.as_ref()?;
            let [times, low, high] = best.times(&self.found.base)?.map(digits);
            let sure = match (self.found.is_better(best), self.found.is_worse(best)) {
                (true, _) => format!("{times} times the area ({low} to {high} over the starts)"),
                (_, true) => {
                    format!("none: {} is the least loss, {times} times the area", change.text)
                }
                _ => format!(
                    "none that these starts can tell: {times} times the area ({low} to {high})"
                ),
            };
            Some(format!("{question} {}: {sure}; {}", change.text, change.cost))
        };
        let estimator = self
            .found
            .changes
            .iter()
            .find(|one| one.change.as_ref().is_some_and(|change| change.name == "estimator"));
        let own = self.found.base.settings.name().text();
        let leaving = estimator.and_then(|one| {
            let [times, low, high] = one.times(&self.found.base)?.map(digits);
            let change = one.change.as_ref()?;
            let verdict = if self.found.is_better(one) { "yes" } else { "no" };
            Some(format!(
                "Is it worth leaving {own}? {verdict}: {} has {times} times the area ({low} to {high}), {}",
                change.text.trim_start_matches("the best estimator, "),
                change.cost
            ))
        });
        [
            named(Kind::Part, "Which part to buy?"),
            named(Kind::Firmware, "What can be had without a part?"),
            leaving,
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// The ranked table for people, and the answers.
    pub fn text(&self) -> String {
        let Spoken { k: (k_unit, k), v: (v_unit, v), area_unit, area } = self.spoken();
        let mut text = format!(
            "what limits the walls of {}; areas in {area_unit}, K in {k_unit}, K at B = {}, noise in {v_unit}, \
             each with the best tuning\n{:>4} {:<60} {:>24} {:>9} {:>9} {:>9} {:>9} {:>9}  cost",
            self.scene,
            self.units.said(self.found.damping_n_s_per_m, "N s/m"),
            "rank",
            "change",
            "times the area",
            "area",
            "peak K",
            "K at B",
            "noise",
            "of core %",
        );
        for row in self.rows() {
            let [rank, what, times, area, peak, at_damping, noise, share, cost] =
                row.cells([area, k, v]);
            let _ = write!(
                text,
                "\n{rank:>4} {what:<60} {times:>24} {area:>9} {peak:>9} {at_damping:>9} {noise:>9} {share:>9}  {cost}",
            );
        }
        for answer in self.answers() {
            let _ = write!(text, "\n{answer}");
        }
        let hits: u64 = self.rows().iter().map(|row| row.hits).sum();
        let _ = write!(text, "\n{hits} wall hits");
        text
    }

    /// The table of the page.
    pub fn html(&self) -> String {
        let Spoken { k: (k_unit, k), v: (v_unit, v), area_unit, area } = self.spoken();
        let columns = [
            ("Rank", ""),
            ("Change", ""),
            ("Times the area", "mean (range)"),
            ("Area", area_unit.as_str()),
            ("Peak K", k_unit),
            ("K at that B", k_unit),
            ("Noise", v_unit),
            ("Of the core", "%"),
            ("Cost", ""),
        ];
        let rows = self.rows().into_iter().map(|row| {
            let class = if row.rank == 0 { " class=\"ideal\"" } else { "" };
            (class, row.cells([area, k, v]).to_vec())
        });
        report::table(&columns, rows)
    }

    /// The boundaries of the scene and of the best changes.
    ///
    /// # Errors
    /// The figure cannot be drawn.
    pub fn figure(&self) -> Result<Figure, FigureError> {
        let Explanation { base, changes, .. } = self.found;
        let curve = |one: &Explained| {
            let text = one.change.as_ref().map_or("as it is".into(), |change| change.text.clone());
            Curve {
                name: one.change.as_ref().map_or(Curve::AS_IT_IS, |change| change.name).into(),
                detail: format!("{text}, {}", one.settings.name().text()),
                ideal: one.change.is_none(),
                points: one
                    .boundaries
                    .first()
                    .map(|first| first.points.clone())
                    .unwrap_or_default(),
            }
        };
        zwidth(&ZwidthPlot {
            title: format!("What limits the walls, {}", self.scene),
            units: self.units,
            subtitle: "one element changed at a time, each at its best tuning; bold: as it is"
                .into(),
            legend: "Change".into(),
            curves: changes.iter().take(DRAWN).chain([base]).map(curve).collect(),
        })
    }
}
