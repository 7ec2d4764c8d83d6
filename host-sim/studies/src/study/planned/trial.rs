//! Estimates the cost of a study. Some of its points are run. The runs are spread evenly over all points. A run
//! computes points of one scene in parallel, as a unit does.

use std::time::{Duration, Instant};

use super::{Point, Study, unit::Made};
use crate::{
    error::Error,
    numerics::statistics::Repeats,
    study::How,
    table::{Cell, csv_line},
};

/// Number of parts of a trial. The time of each part is measured. The spread of these times gives the uncertainty of
/// the whole time.
const BATCHES: usize = 4;
/// Largest number of points in a run.
const RUN_MAX: u64 = 64;
/// Time after which a trial ends.
const LONG: Duration = Duration::from_secs(2);

/// An estimated value of the whole study. Its uncertainty comes from the spread of the trial's points or parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    pub value: f64,
    /// Half-width of the 95 % interval. It is 0 if every point was made, or if all values are equal.
    pub uncertainty: f64,
}

/// What the study costs on this machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    pub points: u64,
    pub hits: Estimate,
    /// Time that the study takes on all threads, in s.
    pub time_s: Estimate,
    /// Size of the result as CSV, in bytes.
    pub bytes: Estimate,
}

impl Study {
    /// Runs points of the study for some seconds, and estimates its cost.
    ///
    /// # Errors
    /// An error of [`run`](Self::run).
    pub fn trial(&self, how: How<'_>) -> Result<Trial, Error> {
        let of_variant = self.blocks.iter().map(|block| block.points / self.file.variants());
        let length = of_variant.max().unwrap_or(1).clamp(1, RUN_MAX);
        let all = self.points.div_ceil(length);
        let mut runs = 2 * BATCHES as u64;
        loop {
            let begun = Instant::now();
            let trial = self.tried(runs.min(all), length, how)?;
            if begun.elapsed() >= LONG || runs >= all {
                return Ok(trial);
            }
            runs *= 2;
        }
    }
    fn tried(&self, runs: u64, length: u64, how: How<'_>) -> Result<Trial, Error> {
        let all = u128::from(self.points.div_ceil(length));
        // All points are divided into equal parts. Each run begins in the middle of a part.
        let first = |run: u64| {
            let at = (2 * u128::from(run) + 1) * all / (2 * u128::from(runs));
            u64::try_from(at).unwrap_or(0) * length
        };
        let (mut tried, mut hits, mut bytes, mut times) = (0, vec![], vec![], vec![]);
        for batch in 0..runs.min(BATCHES as u64) {
            let (begun, mut points_of_batch) = (Instant::now(), 0);
            for block in &self.blocks {
                let runs =
                    (batch..runs).step_by(BATCHES).map(|run| first(run)..first(run) + length);
                let of_block = block.first_point..block.first_point + block.points;
                let runs: Vec<Vec<Point>> = runs
                    .map(|run| run.start.max(of_block.start)..run.end.min(of_block.end))
                    .filter(|run| !run.is_empty())
                    .map(|run| run.map(|n| self.point(block, n - block.first_point)).collect())
                    .collect();
                let Made { table, .. } = self.make(block, &runs.concat(), how)?;
                let hits_at = table.columns.iter().position(|column| column.name == "hits");
                let hits_of = |row: &Vec<Cell>| match hits_at.and_then(|at| row.get(at)) {
                    Some(Cell::Whole(hits)) => *hits as f64,
                    _ => 1.0,
                };
                for run in &runs {
                    let numbers = run[0].number..=run[run.len() - 1].number;
                    let of_run =
                        |row: &&Vec<Cell>| matches!(row[0], Cell::Whole(n) if numbers.contains(&n));
                    let rows = table.rows.iter().filter(of_run);
                    let points = run.len() as f64;
                    hits.push(rows.clone().map(hits_of).sum::<f64>() / points);
                    bytes.push(rows.map(|row| csv_line(row).len() as f64).sum::<f64>() / points);
                    points_of_batch += run.len();
                }
            }
            times.push(begun.elapsed().as_secs_f64() / points_of_batch.max(1) as f64);
            tried += points_of_batch as u64;
        }
        let estimate = |values: &[f64], is_exact: bool| {
            let repeats = Repeats::of(values.iter().copied());
            let half = if is_exact { 0.0 } else { repeats.half_width() };
            let points = self.points as f64;
            Estimate { value: repeats.mean * points, uncertainty: half * points }
        };
        let is_exact = tried == self.points;
        let [hits, bytes] = [hits, bytes].map(|values| estimate(&values, is_exact));
        Ok(Trial { points: tried, hits, time_s: estimate(&times, false), bytes })
    }
}
