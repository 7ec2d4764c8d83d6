//! The results as CSV tables, and the cutoffs at which each format is good enough.

use std::fmt::Write as _;

use super::{
    Bench, Criterion, Variant, cost,
    filters::{FilterRow, Filters},
    plant::Plants,
};

/// Whether each point is on the Pareto front. A point is on the front if no other point is better. A point is better if
/// one of its values is smaller and the other is not larger.
pub fn pareto(points: &[Option<[f64; 2]>]) -> Vec<bool> {
    let beaten = |[x, y]: [f64; 2]| {
        points.iter().flatten().any(|&[u, v]| u <= x && v <= y && (u < x || v < y))
    };
    points.iter().map(|point| point.is_some_and(|point| !beaten(point))).collect()
}

/// Cost and error of each filter at one cutoff. The cost is in cycles. The error is the RMS error of the velocity in
/// motion, in m/s. `None` for a refused filter.
pub fn filter_points(filters: &Filters, cutoff: usize, bench: &Bench) -> Vec<Option<[f64; 2]>> {
    let rows = filters.rows.iter().filter(|row| row.cutoff == cutoff);
    let point = |row: &FilterRow| {
        let measured = row.measured.as_ref().ok()?;
        Some([cost::of(row.variant)?.cycles, measured.noise.in_motion * bench.m_per_s()])
    };
    rows.map(point).collect()
}

/// Cost and error of each method. The cost is in operations per simulated second. The error is that of the trajectory,
/// in m.
pub fn plant_points(plants: &Plants) -> Vec<Option<[f64; 2]>> {
    let point = |row: &super::plant::PlantRow| {
        row.measured.as_ref().ok().map(|m| [m.operations_per_s, m.trajectory_m])
    };
    plants.rows.iter().map(point).collect()
}

fn cell(value: Option<f64>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

/// Text as one CSV cell.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

pub fn filters_csv(filters: &Filters, bench: &Bench) -> String {
    let mut text = String::from(
        "format,form,cutoff_hz,response_error,response_error_db,cutoff_error,drift_counts,bias_m_per_s,\
         noise_at_rest_m_per_s,noise_in_motion_m_per_s,limit_cycle_m_per_s,headroom_m_per_s,area_n2_s_per_m2,\
         area_change,cycles,ram_bytes,pareto,would_do,missed,refused,host_ns\n",
    );
    let fronts: Vec<Vec<bool>> = (0..filters.exact.len())
        .map(|cutoff| pareto(&filter_points(filters, cutoff, bench)))
        .collect();
    let speed = bench.m_per_s();
    for (n, row) in filters.rows.iter().enumerate() {
        let number = n / filters.exact.len();
        let (format, form) = (row.variant.format.name(), row.variant.form.name());
        let cutoff_hz = filters.exact[row.cutoff].cutoff_hz;
        let _ = write!(text, "{format},{form},{cutoff_hz},");
        let cost = cost::of(row.variant);
        let cost = [cost.map(|cost| cost.cycles), cost.map(|cost| cost.ram_bytes)].map(cell);
        let [cycles, ram_bytes] = cost;
        let ns = filters.host_ns[number];
        match &row.measured {
            Ok(m) => {
                let missed: Vec<&str> = row.missed.iter().map(|c| c.name()).collect();
                let _ = writeln!(
                    text,
                    "{},{},{},{},{},{},{},{},{},{},{},{cycles},{ram_bytes},{},{},{},,{ns}",
                    m.response.error,
                    20.0 * m.response.error.log10(),
                    cell(m.response.cutoff_error),
                    m.drift_counts,
                    m.bias_counts() * speed,
                    m.noise.at_rest * speed,
                    m.noise.in_motion * speed,
                    m.rest_counts * speed,
                    cell(m.headroom_counts.map(|counts| counts * speed)),
                    cell(m.area),
                    cell(m.area_change),
                    fronts[row.cutoff][number],
                    row.would_do(),
                    missed.join(" + "),
                );
            }
            Err(refused) => {
                let reason = quoted(&refused.to_string());
                let _ =
                    writeln!(text, ",,,,,,,,,,,{cycles},{ram_bytes},false,false,,{reason},{ns}");
            }
        }
    }
    text
}

pub fn plant_csv(plants: &Plants) -> String {
    let mut text = String::from(
        "method,setting,steps_per_sample,operations_per_s,trajectory_error_m,verdicts_wrong,verdicts,\
         area_n2_s_per_m2,area_change,pareto,refused,host_ns\n",
    );
    let front = pareto(&plant_points(plants));
    for (row, front) in plants.rows.iter().zip(front) {
        let _ = write!(text, "{},{},", row.method.name(), cell(row.method.setting()));
        let _ = match &row.measured {
            Ok(m) => writeln!(
                text,
                "{},{},{},{},{},{},{},{front},,{}",
                m.steps_per_sample,
                m.operations_per_s,
                m.trajectory_m,
                m.verdicts_wrong,
                plants.verdicts,
                m.area,
                m.area_change,
                m.host_ns
            ),
            Err(refused) => writeln!(text, ",,,,,,,false,{},", quoted(refused)),
        };
    }
    text
}

/// The cutoffs at which a variant is good enough.
#[derive(Clone, Debug, PartialEq)]
pub struct GoodFor {
    pub variant: Variant,
    /// The longest run of neighbouring cutoffs at which the variant is good enough: its first and last cutoff, in Hz.
    pub cutoffs_hz: Option<[f64; 2]>,
    /// Criteria that the variant exceeds at the next lower and the next higher cutoff. Empty if there is no such
    /// cutoff, or if the variant is refused there.
    pub below: Vec<Criterion>,
    pub above: Vec<Criterion>,
    /// Whether the variant is refused at the next lower cutoff.
    pub refused_below: bool,
}

/// Results of all variants, in the order of [`Variant::ALL`].
pub fn good_for(filters: &Filters) -> Vec<GoodFor> {
    let cutoffs = filters.exact.len().max(1);
    filters
        .rows
        .chunks(cutoffs)
        .zip(Variant::ALL)
        .map(|(rows, variant)| {
            let (mut best, mut start) = (0..0, None);
            for n in 0..=rows.len() {
                let does = rows.get(n).is_some_and(FilterRow::would_do);
                match (does, start) {
                    (true, None) => start = Some(n),
                    (false, Some(first)) => {
                        // Of runs with the same length, the run at the higher cutoffs is taken.
                        if n - first >= best.len() {
                            best = first..n;
                        }
                        start = None;
                    }
                    _ => {}
                }
            }
            let hz = |n: usize| filters.exact[rows[n].cutoff].cutoff_hz;
            let cutoffs_hz = (!best.is_empty()).then(|| [hz(best.start), hz(best.end - 1)]);
            let below = match best.is_empty() {
                true => rows.last(),
                false => best.start.checked_sub(1).and_then(|n| rows.get(n)),
            };
            let above = rows.get(best.end).filter(|_| !best.is_empty());
            GoodFor {
                variant,
                cutoffs_hz,
                below: below.map(|row| row.missed.clone()).unwrap_or_default(),
                above: above.map(|row| row.missed.clone()).unwrap_or_default(),
                refused_below: below.is_some_and(|row| row.measured.is_err()),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats() {
        let points = [
            Some([1.0, 9.0]),
            Some([2.0, 3.0]),
            Some([2.0, 4.0]),
            Some([3.0, 3.0]),
            None,
            Some([4.0, 1.0]),
            Some([4.0, 1.0]),
        ];
        assert_eq!(pareto(&points), [true, true, false, false, false, true, true]);
    }
}
