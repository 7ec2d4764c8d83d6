//! A push outside contact, and what it has moved: whether fault 13 has a cause.

use std::collections::VecDeque;

use super::{answer::View, settings::FULL_SCALE_N};

/// Outputs with force but without motion: nearly 50 ms.
const STILL: u64 = 45;
/// Outputs of a span in which the count has to go as far as the heaviest handle.
const SPAN: usize = 50;
/// 10 % of full scale.
const PUSH: i32 = (1 << 30) / 10;
/// Both boards' scenes: the heaviest handle, kg and N s/m; counts are of 1 um.
const HEAVIEST: [f64; 2] = [8.0, 110.0];
const COUNT_M: f64 = 1e-6;
const OUTPUT_S: f64 = 1e-3;

/// The push that goes on, if any.
#[derive(Clone, Debug, Default)]
pub(super) struct Push {
    inward: bool,
    /// Outputs with less than 3 counts of motion, and where.
    still: (u64, i32),
    /// The last outputs: the count, and the heaviest handle's speed, counts per output.
    track: VecDeque<(i32, f64)>,
}

impl Push {
    /// An output more; `gap`: some before it are not known, `acts`: the wall has a force, so that a handle may lean on it.
    pub fn step(&mut self, new: &View, gap: bool, acts: bool) {
        if !new.on || new.contact && acts || new.force.abs() <= PUSH {
            *self = Self { still: (0, new.position), ..Self::default() };
            return;
        }
        if gap || self.inward != (new.force > 0) {
            self.track.clear();
        }
        self.inward = new.force > 0;
        let (outputs, place) = self.still;
        let stays = new.position.abs_diff(place) < 3;
        self.still = if stays { (outputs + 1, place) } else { (0, new.position) };
        let speed = self.track.back().map_or(0.0, |(_, speed)| *speed);
        let force_n = f64::from(new.force.abs() - PUSH) / f64::from(1 << 30) * FULL_SCALE_N;
        let [mass_kg, damping] = HEAVIEST;
        let force_n = force_n - damping * speed * COUNT_M / OUTPUT_S;
        let speed = speed + force_n / mass_kg * OUTPUT_S * OUTPUT_S / COUNT_M;
        self.track.push_back((new.position, speed));
        if self.track.len() > SPAN + 4 {
            self.track.pop_front();
        }
    }

    /// Whether it may be called a push without motion: where a span begins is the board's.
    pub fn moves_too_little(&self) -> bool {
        let short = |(start, end): (usize, usize)| {
            let span = self.track.range(start..end);
            let places = span.clone().map(|(place, _)| *place);
            let way: f64 = span.map(|(_, speed)| speed).sum();
            let ends = places.clone().min().zip(places.max());
            ends.is_some_and(|(low, high)| f64::from(high.abs_diff(low)) < 1.02 * way + 3.0)
        };
        let ends = self.track.len().saturating_sub(2)..=self.track.len();
        let spans = ends.filter_map(|end| end.checked_sub(SPAN - 1).map(|start| (start, end)));
        self.still.0 >= STILL || spans.into_iter().any(short)
    }
}
