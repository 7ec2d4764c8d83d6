//! The comparison as a table: one list of criteria for CSV, JSON, the page and the winners.

use serde::Serialize;

use super::{Compared, Place, contact};

/// Which end of a criterion is good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// The larger.
    More,
    /// The smaller.
    Less,
}

/// One column.
pub struct Criterion {
    /// Name, as a CSV column, with its unit.
    pub key: &'static str,
    /// Name for people.
    pub name: &'static str,
    /// Unit of the value for people.
    pub unit: &'static str,
    /// Factor from the CSV's unit to that.
    pub scale: f64,
    /// Digits after the point for people.
    pub digits: usize,
    /// Which end is good; `None` for what is neither.
    pub better: Option<Better>,
    /// Its value; `None` where it does not apply.
    pub value: fn(&Compared, &Place) -> Option<f64>,
}

/// All columns.
pub const CRITERIA: [Criterion; 16] = [
    column(
        "area_n2_s_per_m2",
        "Z-width area",
        "10^6 N² s/m²",
        1e-6,
        3,
        Some(Better::More),
        |c, _| Some(c.tuned.area()),
    ),
    column("area_low_n2_s_per_m2", "lowest", "10^6 N² s/m²", 1e-6, 3, None, |c, _| {
        Some(c.tuned.area_range()[0])
    }),
    column("area_high_n2_s_per_m2", "highest", "10^6 N² s/m²", 1e-6, 3, None, |c, _| {
        Some(c.tuned.area_range()[1])
    }),
    column("stiffness_peak_n_per_m", "peak K", "kN/m", 1e-3, 1, Some(Better::More), |c, _| {
        Some(c.tuned.stiffness_peak_n_per_m())
    }),
    column(
        "stiffness_at_damping_n_per_m",
        "K at given B",
        "kN/m",
        1e-3,
        1,
        Some(Better::More),
        |c, place| Some(c.tuned.stiffness_at(place.damping_n_s_per_m).unwrap_or(0.0)),
    ),
    column("damping_max_n_s_per_m", "largest B", "N s/m", 1.0, 0, Some(Better::More), |c, _| {
        Some(c.tuned.damping_max_n_s_per_m())
    }),
    column("delay_s", "delay", "ms", 1e3, 3, Some(Better::Less), |c, _| Some(c.signal.delay_s)),
    column("phase_100_hz_deg", "phase at 100 Hz", "deg", 1.0, 1, None, |c, _| {
        Some(c.signal.phase_100_hz_deg)
    }),
    column("noise_at_rest_m_per_s", "noise at rest", "mm/s", 1e3, 3, Some(Better::Less), |c, _| {
        Some(c.signal.noise_at_rest_m_per_s)
    }),
    column(
        "noise_in_motion_m_per_s",
        "noise in motion",
        "mm/s",
        1e3,
        3,
        Some(Better::Less),
        |c, _| Some(c.signal.noise_in_motion_m_per_s),
    ),
    column("roughness_n", "force above 100 Hz", "N", 1.0, 4, Some(Better::Less), |c, _| {
        c.contact.stable.then_some(c.contact.roughness_n)
    }),
    column("impedance_error", "impedance error", "%", 1e2, 2, Some(Better::Less), |c, _| {
        c.contact.stable.then_some(c.contact.impedance_error)
    }),
    column("left_when_too_low", "left if tuned /1.5", "%", 1e2, 0, None, |c, _| {
        c.tuned.left_when_mistuned[0]
    }),
    column("left_when_too_high", "left if tuned x1.5", "%", 1e2, 0, None, |c, _| {
        c.tuned.left_when_mistuned[1]
    }),
    column("cycles", "cycles, Cortex-M4", "", 1.0, 0, Some(Better::Less), |c, _| {
        c.cost.map(|cost| cost.cycles)
    }),
    column("ram_bytes", "RAM, Cortex-M4", "bytes", 1.0, 0, Some(Better::Less), |c, _| {
        c.cost.map(|cost| cost.ram_bytes)
    }),
];

const fn column(
    key: &'static str,
    name: &'static str,
    unit: &'static str,
    scale: f64,
    digits: usize,
    better: Option<Better>,
    value: fn(&Compared, &Place) -> Option<f64>,
) -> Criterion {
    Criterion { key, name, unit, scale, digits, better, value }
}

/// Who wins a criterion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Winner {
    /// The criterion.
    pub criterion: &'static str,
    /// Name of the estimator, and those that are as good to the last digit.
    pub estimators: Vec<String>,
    /// Its value.
    pub value: f64,
    /// Rank of finite difference and Butterworth, from 1; `null` if it is not compared or has no
    /// value.
    pub butterworth_rank: Option<usize>,
}

/// The winner of every criterion that has a good end.
pub fn winners(compared: &[Compared], place: &Place) -> Vec<Winner> {
    CRITERIA.iter().filter_map(|criterion| winner(criterion, compared, place)).collect()
}

fn winner(criterion: &Criterion, compared: &[Compared], place: &Place) -> Option<Winner> {
    let sign = match criterion.better? {
        Better::More => -1.0,
        Better::Less => 1.0,
    };
    let mut ranked: Vec<(f64, String)> = compared
        .iter()
        .filter_map(|c| {
            let value = (criterion.value)(c, place)?;
            // a delay is good when it is near 0, from either side
            let goodness = if criterion.key == "delay_s" { value.abs() } else { sign * value };
            Some((goodness, c.entry.name()))
        })
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = ranked.first()?.0;
    let rank = ranked.iter().position(|(_, name)| name == "butterworth");
    let better_than = |goodness: f64| ranked.iter().filter(|(other, _)| *other < goodness).count();
    Some(Winner {
        criterion: criterion.key,
        estimators: ranked.iter().filter(|(g, _)| *g == best).map(|(_, n)| n.clone()).collect(),
        value: if criterion.key == "delay_s" { best } else { sign * best },
        butterworth_rank: rank.and_then(|index| Some(better_than(ranked.get(index)?.0) + 1)),
    })
}

/// The table as CSV.
pub fn csv(compared: &[Compared], place: &Place) -> String {
    let keys: Vec<&str> = CRITERIA.iter().map(|criterion| criterion.key).collect();
    let mut text =
        format!("estimator,tuning,tuning_unit,tuning_at_edge,stable_at_wall,{}\n", keys.join(","));
    for c in compared {
        let (value, unit) = match c.settings.tuning() {
            Some((parameter, value)) => (value.to_string(), parameter.unit),
            None => (String::new(), ""),
        };
        let cells = CRITERIA.iter().map(|criterion| {
            (criterion.value)(c, place).map(|value| value.to_string()).unwrap_or_default()
        });
        let cells: Vec<String> = cells.collect();
        text.push_str(&format!(
            "{},{value},{unit},{},{},{}\n",
            c.entry.name(),
            c.tuned.at_edge,
            c.contact.stable,
            cells.join(",")
        ));
    }
    text
}

/// What roughness means, for captions.
pub fn roughness_note(place: &Place) -> String {
    format!(
        "Force above {} Hz is its RMS in a wall hit at K = {} N/m, B = {} N s/m; it is empty, as is the impedance error, where that wall is not stable.",
        contact::ROUGH_ABOVE_HZ,
        place.stiffness_n_per_m,
        place.damping_n_s_per_m
    )
}
