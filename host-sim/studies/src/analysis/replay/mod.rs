//! Runs estimators of the core over recorded counts.

mod asked;
mod rank;

use std::{
    fmt::Write as _,
    sync::atomic::{AtomicBool, Ordering::Relaxed},
};

use zwidth::{
    CounterWidth, LoopParameters, Sampler,
    units::{Position, Velocity},
};

use super::recompute::{Recomputed, Row};

pub use asked::{Told, lsb_m_per_s, replay, velocity};
pub use rank::{Ranked, Ranking, rank, read_log};

/// Longest delay that can be found between two estimators, in samples.
const LAG: usize = 500;
/// Number of samples at the beginning that are not compared, but at most a tenth of all samples. The estimator begins
/// at rest, but the board's estimator was already moving.
const SETTLE: usize = 1_000;
/// Smallest number of samples that a comparison needs.
const LEAST: usize = 100;

/// The velocities of an estimator and of the board at the same samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Replayed {
    /// Number of the first sample. The samples are consecutive.
    pub first: u64,
    pub positions: Vec<Position>,
    /// Velocity of the board at each sample. It is taken from an output, or computed from key frames and counts.
    pub board: Vec<Velocity>,
    /// Velocity of the estimator at each sample.
    pub velocities: Vec<Velocity>,
}

impl Replayed {
    /// Runs the estimator from rest over the longest range without a missing sample.
    ///
    /// # Errors
    /// In the whole capture, no sample follows directly on another. The error is the distance from one sample of the
    /// capture to the next, in samples.
    pub fn of(capture: &Recomputed, control: &LoopParameters) -> Result<Self, u64> {
        Self::of_rows(&capture.rows, control)
    }

    fn of_rows(rows: &[Row], control: &LoopParameters) -> Result<Self, u64> {
        let known: Vec<(u64, Position, Velocity)> = rows
            .iter()
            .filter_map(|row| Some((row.sample, row.position, row.told.or(row.velocity)?)))
            .collect();
        let longest =
            known.chunk_by(|a, b| b.0 == a.0.wrapping_add(1)).max_by_key(|stretch| stretch.len());
        let Some((longest, &[first, ..])) =
            longest.filter(|longest| longest.len() >= LEAST).map(|longest| (longest, longest))
        else {
            let steps = known.windows(2).map(|pair| pair[1].0.saturating_sub(pair[0].0));
            return Err(steps.min().unwrap_or(0));
        };
        let counter = |position: Position| position.counts().cast_unsigned();
        let mut sampler = Sampler::new(counter(first.1), CounterWidth::Bits32);
        let says = |&(_, position, _): &(u64, Position, Velocity)| {
            sampler.sample(control, counter(position)).motion.velocity
        };
        Ok(Self {
            first: first.0,
            positions: longest.iter().map(|known| known.1).collect(),
            board: longest.iter().map(|known| known.2).collect(),
            velocities: longest.iter().map(says).collect(),
        })
    }

    pub fn len(&self) -> usize {
        self.velocities.len()
    }

    pub fn is_empty(&self) -> bool {
        self.velocities.is_empty()
    }

    /// First sample from which on both velocities are equal, bit for bit, up to the end.
    pub fn same_from(&self) -> Option<u64> {
        let both = self.board.iter().zip(&self.velocities).rev();
        let same = both.take_while(|(board, here)| board == here).count() as u64;
        (same > 0).then(|| self.first + self.len() as u64 - same)
    }

    /// RMS of the difference between both velocities, in LSB.
    pub fn difference(&self) -> f64 {
        rms(self.pairs().map(|[board, here]| here - board))
    }

    /// RMS of how much a velocity changes from sample to sample, in LSB. The first value is for the board, the second
    /// is for the estimator.
    pub fn roughness(&self) -> [f64; 2] {
        let pairs: Vec<[f64; 2]> = self.pairs().collect();
        [0, 1].map(|n| rms(pairs.windows(2).map(|two| two[1][n] - two[0][n])))
    }

    /// Delay of the estimator relative to the board, in samples. The delay is the shift with the smallest difference,
    /// interpolated by a parabola. `None` if nothing moved. If `stop` is set, the value has no meaning.
    pub fn later(&self, stop: &AtomicBool) -> Option<f64> {
        let pairs: Vec<[f64; 2]> = self.pairs().collect();
        let moved = pairs.iter().any(|[board, here]| *board != 0.0 && *here != 0.0);
        let most = LAG.min(pairs.len() / 4);
        let inner = most..pairs.len() - most;
        let lag = |n: usize| n.cast_signed() - most.cast_signed();
        let differ = |n: usize| {
            rms(inner.clone().map(|k| pairs[k.wrapping_add_signed(lag(n))][1] - pairs[k][0]))
                .powi(2)
        };
        let lags = (0..=2 * most).take_while(|_| !stop.load(Relaxed));
        let all: Vec<f64> = lags.map(differ).collect();
        let best = (0..all.len()).min_by(|a, b| all[*a].total_cmp(&all[*b])).filter(|_| moved)?;
        let bend = match (best.checked_sub(1).map(|n| all[n]), all.get(best + 1)) {
            (Some(before), Some(after)) if before + after > 2.0 * all[best] => {
                0.5 * (before - after) / (before - 2.0 * all[best] + after)
            }
            _ => 0.0,
        };
        Some(lag(best) as f64 + bend)
    }

    /// Velocities of the board and of the estimator in LSB. They begin when the estimator has settled.
    fn pairs(&self) -> impl Iterator<Item = [f64; 2]> {
        let both = self.board.iter().zip(&self.velocities).skip(SETTLE.min(self.len() / 10));
        both.map(|(board, here)| [board, here].map(|v| f64::from(v.bits())))
    }

    /// The velocities as CSV. The numbers are the integers of the control loop.
    pub fn csv(&self) -> String {
        let mut text = String::from("sample,position_counts,board_velocity_lsb,velocity_lsb\n");
        let both = self.board.iter().zip(&self.velocities);
        for ((sample, position), (board, here)) in (self.first..).zip(&self.positions).zip(both) {
            let _ =
                writeln!(text, "{sample},{},{},{}", position.counts(), board.bits(), here.bits());
        }
        text
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0u32), |(sum, n), value| (sum + value * value, n + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use zwidth::{Settings, VelocitySettings, WallSettings};

    static NEVER: AtomicBool = AtomicBool::new(false);

    fn control(cutoff_hz: f64) -> LoopParameters {
        let scene = crate::scene::NamedScene::load("paper-1um").unwrap().scene;
        let wall = WallSettings {
            position_m: 1.0,
            stiffness_n_per_m: 0.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        };
        let velocity = VelocitySettings::Butterworth { cutoff_hz };
        Settings { velocity, wall }.build(&scene.design()).unwrap()
    }

    fn row(sample: u64, counts: i32, velocity: Velocity) -> Row {
        let position = Position::from_counts(counts);
        Row { sample, position, velocity: None, force: None, told: Some(velocity) }
    }

    /// The rows that a board with this cutoff would record. The handle oscillates at 5 Hz from the 1000th sample on.
    fn recorded(cutoff_hz: f64, samples: u32) -> Vec<Row> {
        let control = control(cutoff_hz);
        let mut sampler = Sampler::new(0, CounterWidth::Bits32);
        let record = |n: u32| {
            let place = 20_000.0 * (f64::from(n) * 5.0 / 10_000.0 * std::f64::consts::TAU).sin();
            #[expect(clippy::cast_possible_truncation, reason = "20,000")]
            let counts = place.floor() as i32;
            let motion = sampler.sample(&control, counts.cast_unsigned()).motion;
            let (sample, velocity) = (motion.sample, motion.velocity);
            row(sample, counts, velocity)
        };
        (0..samples).map(record).skip(1_000).collect()
    }

    #[test]
    fn the_same_estimator_says_the_same_and_a_slower_one_later() {
        let run = recorded(500.0, 20_000);
        let same = Replayed::of_rows(&run, &control(500.0)).unwrap();
        assert!(same.difference() < 3e3, "{}", same.difference());
        assert!(same.later(&NEVER).unwrap().abs() < 0.05);
        // The delay of a second-order Butterworth filter is sqrt(2) / w.
        let slow = Replayed::of_rows(&run, &control(100.0)).unwrap();
        let wanted = 2f64.sqrt() / std::f64::consts::TAU * (1.0 / 100.0 - 1.0 / 500.0) * 1e4;
        let later = slow.later(&NEVER).unwrap();
        assert!((later - wanted).abs() < 0.2, "{later}, {wanted}");
        let [board, here] = slow.roughness();
        assert!(here < board);
        assert_eq!(slow.csv().lines().count(), run.len() + 1);
    }

    #[test]
    fn from_rest_it_is_the_same_from_the_first_sample_and_one_bit_ends_that() {
        let control = control(500.0);
        let mut sampler = Sampler::new(7, CounterWidth::Bits32);
        let mut run: Vec<Row> = (0..500u32)
            .map(|n| {
                let count = 7 + n * n / 40;
                let motion = sampler.sample(&control, count).motion;
                let (sample, velocity) = (motion.sample, motion.velocity);
                row(sample, count.cast_signed(), velocity)
            })
            .collect();
        assert_eq!(Replayed::of_rows(&run, &control).unwrap().same_from(), Some(0));
        run[300].told = run[300].told.map(|v| Velocity::saturating_from_bits(v.bits() ^ 1));
        assert_eq!(Replayed::of_rows(&run, &control).unwrap().same_from(), Some(301));
    }

    #[test]
    fn a_capture_without_every_sample_says_how_many_are_missing() {
        let tenth: Vec<Row> = recorded(500.0, 9_000).into_iter().step_by(10).collect();
        assert_eq!(Replayed::of_rows(&tenth, &control(500.0)), Err(10));
        // If the capture has two stretches, the longer one is used.
        let mut run = recorded(500.0, 9_000);
        run.remove(3_000);
        let replayed = Replayed::of_rows(&run, &control(500.0)).unwrap();
        assert_eq!((replayed.len(), replayed.first), (4_999, 4_001));
    }
}
