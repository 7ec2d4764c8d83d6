//! The result of `explain`, as rows of a table and as sentences.

use serde::{Serialize, Serializer};

use super::{CLOCK_HZ, Explained, Explanation, Kind as ChangeKind};
use crate::{
    notation::{rounded, three_digits},
    study::boundary::Boundaries,
    table::{Cell, Kind, Table, Told},
};

/// Smallest missed area that is reported, as a share.
const MISSED: f64 = 0.01;

/// The value with three significant digits. Values below 1 have them too.
pub fn digits(value: f64) -> String {
    if value.abs() < 0.995 { rounded(value, 3).to_string() } else { three_digits(value) }
}

/// A row of the table: a change, or the unchanged scene.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Rank; 0 for the unchanged scene.
    pub rank: usize,
    pub one: &'a Explained,
    pub of: &'a Explanation,
}

/// The columns. A value with a range has three columns: the mean over the starts, the smallest and the largest value.
impl Row<'_> {
    const COLUMNS: [Told<Self>; 32] = [
        ("rank", Kind::Whole, |row| Cell::count(row.rank)),
        ("change", Kind::Text, |row| row.one.change.name.into()),
        ("what", Kind::Text, |row| row.one.change.text.clone().into()),
        ("kind", Kind::Text, |row| row.one.change.kind.name().into()),
        ("times_the_area", Kind::Number, |row| Cell::number(row.times().map(|times| times[0]))),
        ("times_low", Kind::Number, |row| Cell::number(row.times().map(|times| times[1]))),
        ("times_high", Kind::Number, |row| Cell::number(row.times().map(|times| times[2]))),
        ("better", Kind::Text, |row| row.better().into()),
        ("area_n2_s_per_m2", Kind::Number, |row| row.one.area()[0].into()),
        ("area_low_n2_s_per_m2", Kind::Number, |row| row.one.area()[1].into()),
        ("area_high_n2_s_per_m2", Kind::Number, |row| row.one.area()[2].into()),
        ("scene_area_n2_s_per_m2", Kind::Number, |row| Cell::number(row.scene_area())),
        ("stiffness_peak_n_per_m", Kind::Number, |row| row.one.stiffness_peak()[0].into()),
        ("stiffness_peak_low_n_per_m", Kind::Number, |row| row.one.stiffness_peak()[1].into()),
        ("stiffness_peak_high_n_per_m", Kind::Number, |row| row.one.stiffness_peak()[2].into()),
        ("damping_n_s_per_m", Kind::Number, |row| row.of.damping_n_s_per_m.into()),
        ("stiffness_n_per_m", Kind::Number, |row| row.stiffness()[0].into()),
        ("stiffness_low_n_per_m", Kind::Number, |row| row.stiffness()[1].into()),
        ("stiffness_high_n_per_m", Kind::Number, |row| row.stiffness()[2].into()),
        ("velocity_noise_m_per_s", Kind::Number, |row| row.one.noise_m_per_s.into()),
        ("force_noise_n", Kind::Number, |row| {
            (row.of.damping_n_s_per_m * row.one.noise_m_per_s).into()
        }),
        ("estimator", Kind::Text, |row| row.one.settings.name().text().into()),
        ("tuning", Kind::Number, |row| {
            Cell::number(row.one.settings.tuning().map(|(_, value)| value))
        }),
        ("tuning_unit", Kind::Text, |row| {
            Cell::text(row.one.settings.tuning().map(|(parameter, _)| parameter.unit))
        }),
        ("tuning_at_edge", Kind::Flag, |row| row.one.at_edge.into()),
        ("search_settled", Kind::Flag, |row| row.one.settled.into()),
        ("capped_walks", Kind::Whole, |row| Cell::count(row.one.boundaries.capped())),
        ("walks", Kind::Whole, |row| Cell::count(row.one.boundaries.len())),
        ("hits", Kind::Whole, |row| Cell::Whole(row.one.hits)),
        ("cycles_per_s", Kind::Number, |row| Cell::number(row.one.change.cycles_per_s)),
        ("share_of_core", Kind::Number, |row| Cell::number(row.share_of_core())),
        ("cost", Kind::Text, |row| row.one.change.cost.clone().into()),
    ];

    /// The area divided by the area of the unchanged scene. The first value is the ratio of the means. The others are
    /// the smallest and the largest ratio that the starts allow. `None` for the unchanged scene itself.
    pub fn times(&self) -> Option<[f64; 3]> {
        self.one.times(&self.of.base).filter(|_| self.one.change.kind != ChangeKind::Nothing)
    }

    /// Whether the change is better than the unchanged scene: `yes`, `worse` or `unsure`.
    pub fn better(&self) -> &'static str {
        match self.one.change.kind {
            ChangeKind::Nothing => "",
            _ if self.of.is_better(self.one) => "yes",
            _ if self.of.is_worse(self.one) => "worse",
            _ => "unsure",
        }
    }

    /// Mean area by the scene's own criterion at the same tuning; `None` if the search used this criterion.
    pub fn scene_area(&self) -> Option<f64> {
        self.one.beside.as_ref().map(Boundaries::area)
    }

    /// Mean, smallest and largest K at the B of the comparison.
    pub fn stiffness(&self) -> [f64; 3] {
        self.one.stiffness_at(self.of.damping_n_s_per_m)
    }

    /// The cycles that the change adds, as a share of the cycles of a Cortex-M4.
    pub fn share_of_core(&self) -> Option<f64> {
        self.one.change.cycles_per_s.map(|cycles| cycles / CLOCK_HZ)
    }
}

impl Serialize for Row<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(Self::COLUMNS.iter().map(|(name, _, cell)| (name, cell(self))))
    }
}

impl Explanation {
    /// All rows: the unchanged scene, then the changes by rank.
    pub fn rows(&self) -> Vec<Row<'_>> {
        let changes = self.changes.iter().enumerate();
        let changes = changes.map(|(place, one)| Row { rank: self.rank(place), one, of: self });
        [Row { rank: 0, one: &self.base, of: self }].into_iter().chain(changes).collect()
    }

    pub fn table(&self) -> Table {
        Table::of(&Row::COLUMNS, &self.rows())
    }

    /// A table of all boundaries. It has every point of every walk.
    pub fn boundaries(&self) -> Table {
        let all = [&self.base].into_iter().chain(&self.changes);
        Boundaries::table("change", all.map(|one| (one.change.name.into(), &one.boundaries)))
    }

    /// The result as sentences.
    pub fn answers(&self) -> Vec<String> {
        let named = |kind: ChangeKind, question: &str| {
            let best = self.best_of(kind)?;
            let change = &best.change;
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
        let estimator = self.changes.iter().find(|one| one.change.name == "estimator");
        let own = self.base.settings.name().text();
        let leaving = estimator.and_then(|one| {
            let [times, low, high] = one.times(&self.base)?.map(digits);
            let change = &one.change;
            let verdict = if self.is_better(one) { "yes" } else { "no" };
            Some(format!(
                "Is another estimator better than {own}? {verdict}: {} has {times} times the area ({low} to {high}); {}",
                change.text.trim_start_matches("the best estimator, "),
                change.cost
            ))
        });
        let of = |one: &Explained| {
            let what = match one.change.kind {
                ChangeKind::Nothing => "the scene as it is",
                _ => one.change.text.as_str(),
            };
            format!("{what}, {} %", digits(100.0 * one.missed))
        };
        let missed =
            [&self.base].into_iter().chain(&self.changes).filter(|one| one.missed > MISSED);
        let missed: Vec<String> = missed.map(of).collect();
        let missed = (!missed.is_empty()).then(|| {
            format!(
                "The search missed the best tuning of these rows; the tuning of another row has more area by: {}",
                missed.join("; ")
            )
        });
        [
            named(ChangeKind::Part, "Which part to buy?"),
            named(ChangeKind::Firmware, "What helps without a new part?"),
            leaving,
            missed,
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}
