//! What `explain` finds, as rows for programs and sentences for people.

use serde::Serialize;
use zwidth::velocity::EstimatorName;

use super::{CLOCK_HZ, Explained, Explanation, Kind as ChangeKind};
use crate::{
    notation::{rounded, three_digits},
    study::boundary::Boundaries,
    table::{Cell, Kind, Table},
};

/// Smallest missed share of the area that is reported.
const TOLD: f64 = 0.01;

/// Three digits, of what is below 1 too.
pub fn digits(value: f64) -> String {
    if value.abs() < 0.995 { rounded(value, 3).to_string() } else { three_digits(value) }
}

/// A row of the table: a change, or the scene as it is.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// 0 for the scene as it is.
    pub rank: usize,
    pub change: &'static str,
    /// What it becomes, for people.
    pub what: String,
    /// What it asks for; empty for the scene as it is.
    pub kind: &'static str,
    /// Area over that of the scene as it is, of the means.
    pub times_the_area: Option<f64>,
    /// The least that the starts allow.
    pub times_low: Option<f64>,
    /// The most that the starts allow.
    pub times_high: Option<f64>,
    /// `yes`, `worse`, or `unsure`: against the scene as it is.
    pub better: &'static str,
    /// Mean area over the starts.
    pub area_n2_s_per_m2: f64,
    pub area_low_n2_s_per_m2: f64,
    pub area_high_n2_s_per_m2: f64,
    /// Mean by the scene's own criterion at the same tuning, where that is not the one of the search.
    pub scene_area_n2_s_per_m2: Option<f64>,
    /// Largest K of a boundary, mean.
    pub stiffness_peak_n_per_m: f64,
    pub stiffness_peak_low_n_per_m: f64,
    pub stiffness_peak_high_n_per_m: f64,
    /// B at which K is read off.
    pub damping_n_s_per_m: f64,
    /// Mean of K at that B.
    pub stiffness_n_per_m: f64,
    pub stiffness_low_n_per_m: f64,
    pub stiffness_high_n_per_m: f64,
    /// RMS noise of the velocity in motion.
    pub velocity_noise_m_per_s: f64,
    /// Velocity noise times B, N.
    pub force_noise_n: f64,
    pub estimator: &'static str,
    /// Its tuning, if it has one.
    pub tuning: Option<f64>,
    pub tuning_unit: Option<&'static str>,
    /// At an end of the range.
    pub tuning_at_edge: bool,
    /// Nothing near is better.
    pub search_settled: bool,
    /// Walks that a cap cut.
    pub capped_walks: usize,
    pub walks: usize,
    /// Hits that search and result took.
    pub hits: u64,
    /// Cycles in a second that it adds on a Cortex-M4.
    pub cycles_per_s: Option<f64>,
    /// Share of the core.
    pub share_of_core: Option<f64>,
    /// What it takes, in words.
    pub cost: String,
}

/// A column: its name, what it holds, and its cell of a row.
type Column = (&'static str, Kind, fn(&Row) -> Cell);

/// All of them, as a [`Row`] has them.
const COLUMNS: [Column; 32] = [
    ("rank", Kind::Whole, |row| Cell::count(row.rank)),
    ("change", Kind::Text, |row| row.change.into()),
    ("what", Kind::Text, |row| row.what.clone().into()),
    ("kind", Kind::Text, |row| row.kind.into()),
    ("times_the_area", Kind::Number, |row| Cell::number(row.times_the_area)),
    ("times_low", Kind::Number, |row| Cell::number(row.times_low)),
    ("times_high", Kind::Number, |row| Cell::number(row.times_high)),
    ("better", Kind::Text, |row| row.better.into()),
    ("area_n2_s_per_m2", Kind::Number, |row| row.area_n2_s_per_m2.into()),
    ("area_low_n2_s_per_m2", Kind::Number, |row| row.area_low_n2_s_per_m2.into()),
    ("area_high_n2_s_per_m2", Kind::Number, |row| row.area_high_n2_s_per_m2.into()),
    ("scene_area_n2_s_per_m2", Kind::Number, |row| Cell::number(row.scene_area_n2_s_per_m2)),
    ("stiffness_peak_n_per_m", Kind::Number, |row| row.stiffness_peak_n_per_m.into()),
    ("stiffness_peak_low_n_per_m", Kind::Number, |row| row.stiffness_peak_low_n_per_m.into()),
    ("stiffness_peak_high_n_per_m", Kind::Number, |row| row.stiffness_peak_high_n_per_m.into()),
    ("damping_n_s_per_m", Kind::Number, |row| row.damping_n_s_per_m.into()),
    ("stiffness_n_per_m", Kind::Number, |row| row.stiffness_n_per_m.into()),
    ("stiffness_low_n_per_m", Kind::Number, |row| row.stiffness_low_n_per_m.into()),
    ("stiffness_high_n_per_m", Kind::Number, |row| row.stiffness_high_n_per_m.into()),
    ("velocity_noise_m_per_s", Kind::Number, |row| row.velocity_noise_m_per_s.into()),
    ("force_noise_n", Kind::Number, |row| row.force_noise_n.into()),
    ("estimator", Kind::Text, |row| row.estimator.into()),
    ("tuning", Kind::Number, |row| Cell::number(row.tuning)),
    ("tuning_unit", Kind::Text, |row| row.tuning_unit.map_or(Cell::Empty, Cell::from)),
    ("tuning_at_edge", Kind::Flag, |row| row.tuning_at_edge.into()),
    ("search_settled", Kind::Flag, |row| row.search_settled.into()),
    ("capped_walks", Kind::Whole, |row| Cell::count(row.capped_walks)),
    ("walks", Kind::Whole, |row| Cell::count(row.walks)),
    ("hits", Kind::Whole, |row| Cell::Whole(row.hits)),
    ("cycles_per_s", Kind::Number, |row| Cell::number(row.cycles_per_s)),
    ("share_of_core", Kind::Number, |row| Cell::number(row.share_of_core)),
    ("cost", Kind::Text, |row| row.cost.clone().into()),
];

impl Explanation {
    fn row(&self, rank: usize, one: &Explained) -> Row {
        let Self { base, damping_n_s_per_m, .. } = self;
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
                Some(_) if self.is_better(one) => "yes",
                Some(_) if self.is_worse(one) => "worse",
                Some(_) => "unsure",
            },
            area_n2_s_per_m2: area,
            area_low_n2_s_per_m2: area_low,
            area_high_n2_s_per_m2: area_high,
            scene_area_n2_s_per_m2: one.beside.as_ref().map(Boundaries::area),
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
        let changes = self.changes.iter().enumerate();
        let changes = changes.map(|(place, one)| self.row(self.rank(place), one));
        [self.row(0, &self.base)].into_iter().chain(changes).collect()
    }

    /// The rows as a table.
    pub fn table(&self) -> Table {
        let mut table = Table::new(COLUMNS.map(|(name, kind, _)| (name, kind)));
        let cells = |row: &Row| COLUMNS.map(|(_, _, cell)| cell(row)).to_vec();
        table.rows = self.rows().iter().map(cells).collect();
        table
    }

    /// Every point of every walk.
    pub fn boundaries(&self) -> Table {
        let named = |one: &'_ Explained| one.change.as_ref().map_or("none", |change| change.name);
        let all = [&self.base].into_iter().chain(&self.changes);
        Boundaries::table("change", all.map(|one| (named(one).into(), &one.boundaries)))
    }

    /// The answers, one sentence each.
    pub fn answers(&self) -> Vec<String> {
        let named = |kind: ChangeKind, question: &str| {
            let best = self.best_of(kind)?;
            let change = best.change.as_ref()?;
            let [times, low, high] = best.times(&self.base)?.map(digits);
            let sure = match (self.is_better(best), self.is_worse(best)) {
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
            .changes
            .iter()
            .find(|one| one.change.as_ref().is_some_and(|change| change.name == "estimator"));
        let own = self.base.settings.name().text();
        let leaving = estimator.and_then(|one| {
            let [times, low, high] = one.times(&self.base)?.map(digits);
            let change = one.change.as_ref()?;
            let verdict = if self.is_better(one) { "yes" } else { "no" };
            Some(format!(
                "Is it worth leaving {own}? {verdict}: {} has {times} times the area ({low} to {high}), {}",
                change.text.trim_start_matches("the best estimator, "),
                change.cost
            ))
        });
        let of = |one: &Explained| one.change.as_ref().map_or("the scene", |c| &c.text).to_owned();
        let missed = [&self.base].into_iter().chain(&self.changes).filter(|one| one.missed > TOLD);
        let missed: Vec<String> =
            missed.map(|one| format!("{} ({})", of(one), digits(one.missed))).collect();
        let missed = (!missed.is_empty()).then(|| {
            format!(
                "Shares of the area that a search missed, found at another row's tuning: {}",
                missed.join("; ")
            )
        });
        [
            named(ChangeKind::Part, "Which part to buy?"),
            named(ChangeKind::Firmware, "What can be had without a part?"),
            leaving,
            missed,
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}
