//! Finds the times of the encoder's edges, from a timer that captures them.
//!
//! First the encoder's counter is read, then the capturing timer's count, then its captures. Counter and timer see the
//! same edges through the same filter, at the same time. This file makes an [`Edge`] from the three readings.
//!
//! **Which edge.** An edge may come between the readings. Then the count does not include this edge. An edge that is
//! newer than the timer's reading does not belong to this sample. An edge that is older by less than [`CLOSE`] may not
//! belong to it either. A and B alternate. So the channel of the last edge in the count follows from the direction, and
//! from whether the count is odd. The code learns from every edge without doubt which channel belongs to which case.
//! Before the first edge without doubt, the code assumes that a count that has moved includes the edge. An edge that is
//! not in the count waits for the next count.
//!
//! **No edge** since the last sample: the old edge is older by exactly one sample. The timer wraps after a few samples,
//! so its count alone cannot give this age.
//!
//! **Age.** Samples are taken at equal intervals, except for some cycles of the processor. One reading sets the phase
//! of all samples, and ages refer to this phase. So an estimator works with the nominal times of the samples, without
//! jitter. Only the age of an edge between the nominal and the true reading is wrong, by at most the distance of the
//! two readings. This age is cut to 0, or to one sample with the next count. A reading that differs from the phase by
//! more than [`CLOSE`] ticks sets the phase again. This is needed because the first readings come when the program is
//! ready. A delayed first reading must not set the phase for all later readings.
//!
//! **Error.** The age is wrong by less than a tick, and up to 2^-16 samples too short. A channel keeps only its last
//! edge, and the direction is read after the count. So two cases lose the last edge of a count. In the first case, the
//! handle turns in a sample and an edge comes between the readings. In the second case, two edges come between the
//! readings. In both cases no edge is reported, and the estimator assumes half a count's time as the edge's age. The
//! code mistakes one edge for another only if the handle turns twice in a sample, the second time between the readings.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use super::senses::Edge;

/// Up to this age, in ticks, an edge may have come between the two readings.
pub const CLOSE: u32 = 32;

/// Values of the capturing timer at a sample, in the order of their reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Captures {
    /// Count of the timer, read right after the encoder's count.
    pub now: u16,
    /// Whether the encoder's count went up with its last edge.
    pub up: bool,
    /// Count of the timer at the last edge of A and of B. It is `None` if there was no edge since the last sample.
    pub at: [Option<u16>; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Captured {
    /// Count of the timer at the edge.
    at: u16,
    is_a: bool,
}

/// Makes edges from captures. The timer has `TICKS` ticks per sample, and wraps at [`WRAP`](Self::WRAP).
#[derive(Clone, Copy, Debug)]
pub struct EdgeTimer<const TICKS: u32> {
    count: u32,
    /// Ticks from the beginning of a sample to the reading of the timer.
    phase: Option<u32>,
    /// An edge that came after the last count was read.
    waiting: Option<Captured>,
    /// One bit that combines three facts: the channel of a count's last edge, its direction, and whether the count is
    /// odd. All edges give the same bit. `None` until the bit is learnt.
    turns: Option<bool>,
    latest: Option<Edge>,
}

impl<const TICKS: u32> EdgeTimer<TICKS> {
    /// The count at which the timer wraps. It is the largest number of whole samples that fits into 16 bits, in ticks.
    pub const WRAP: u32 = (1 << 16) / TICKS * TICKS;
    const FITS: () = assert!(TICKS > 4 * CLOSE && Self::WRAP >= 3 * TICKS, "three samples");

    /// Begins before the first sample.
    pub const fn new() -> Self {
        let () = Self::FITS;
        Self { count: 0, phase: None, waiting: None, turns: None, latest: None }
    }

    /// Returns the last edge that `count` includes. Call it with every sample.
    #[inline]
    pub fn update(&mut self, count: u32, captures: &Captures) -> Option<Edge> {
        let counts = count.wrapping_sub(self.count).cast_signed();
        let moved = counts != 0;
        self.count = count;
        let begun = self.phase.is_some();
        let late = self.late(captures.now);
        if !begun {
            cold_path();
            return None;
        }
        let waiting = self.waiting.take();
        if captures.at == [None, None] && waiting.is_none() && !moved {
            self.latest = self.latest.map(older);
            return self.latest;
        }
        let up = captures.up;
        let turns = |edge: Captured| edge.is_a ^ (count & 1 == 1) ^ up;
        let [newest, before] = self.in_order(captures);
        let mut given_up = moved;
        let last = match newest {
            None => {
                self.turns = waiting.map(turns).or(self.turns);
                waiting
            }
            Some((newest, Some(age))) if age > CLOSE => {
                self.turns = Some(turns(newest));
                Some(newest)
            }
            Some((newest, Some(_))) if self.turns.map_or(moved, |known| known == turns(newest)) => {
                Some(newest)
            }
            Some((newest, _)) => {
                cold_path();
                self.waiting = Some(newest);
                let before = match before {
                    Some((edge, Some(_))) => Some(edge),
                    Some((_, None)) => None,
                    None => waiting,
                };
                given_up |= before.is_some();
                // If the count went the other way, the handle turned at the missing edge.
                let straight = moved && (counts > 0) == up;
                before
                    .filter(|&edge| straight && self.turns.is_none_or(|known| known == turns(edge)))
            }
        };
        self.latest = match last {
            Some(edge) => {
                Some(Edge { age: age::<TICKS>(since(Self::WRAP, edge.at, captures.now), late), up })
            }
            None if given_up => None,
            None => self.latest.map(older),
        };
        self.latest
    }

    /// Returns the captures, the newest first, each with its age at `now`. A capture after `now` has no age.
    #[inline]
    fn in_order(&self, captures: &Captures) -> [Option<(Captured, Option<u32>)>; 2] {
        let [a, b] = captures.at.map(|at| at.map(|at| (at, since(Self::WRAP, at, captures.now))));
        let seen = |since: u32| (since < Self::WRAP - TICKS).then_some(since);
        let a_side = a.map(|(at, since)| (Captured { at, is_a: true }, seen(since)));
        let b_side = b.map(|(at, since)| (Captured { at, is_a: false }, seen(since)));
        // Captures after `now` are almost a whole turn old. A shift puts all captures in order.
        let age = |side: Option<(u16, u32)>| {
            side.map_or(u32::MAX, |(_, since)| (since + TICKS) % Self::WRAP)
        };
        if age(a) <= age(b) { [a_side, b_side] } else { [b_side, a_side] }
    }

    /// Returns the number of ticks by which a reading at `now` is late. It is negative if the reading is early.
    #[inline]
    fn late(&mut self, now: u16) -> i32 {
        let now = u32::from(now) % TICKS;
        let phase = self.phase.unwrap_or(now);
        let after = (now + TICKS - phase) % TICKS; // 0 to TICKS
        let late = after.cast_signed();
        let late = if after > TICKS / 2 { late - TICKS.cast_signed() } else { late };
        let late = if late.unsigned_abs() > CLOSE { None } else { self.phase.map(|_| late) };
        if late.is_none() {
            cold_path();
            self.phase = Some(now);
        }
        late.unwrap_or(0)
    }
}

impl<const TICKS: u32> Default for EdgeTimer<TICKS> {
    fn default() -> Self {
        Self::new()
    }
}

/// Returns the number of ticks from `at` to `now`, for a timer that wraps at `wrap`.
#[inline]
fn since(wrap: u32, at: u16, now: u16) -> u32 {
    let (at, now) = (u32::from(at), u32::from(now));
    if now >= at { now - at } else { (now + wrap).saturating_sub(at) }
}

/// Converts an age to 2^-16 samples. The edge was `ticks` old at the reading, and the reading was late by `late` ticks.
#[inline]
fn age<const TICKS: u32>(ticks: u32, late: i32) -> u32 {
    let ticks = ticks.saturating_add_signed(-late).min(u16::MAX.into());
    (ticks << Edge::FRACTION_BITS) / TICKS
}

/// Returns the same edge as it is one sample later, so with a larger age.
#[inline]
fn older(edge: Edge) -> Edge {
    Edge { age: edge.age.saturating_add(Edge::SAMPLE), ..edge }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const TICKS: u32 = 9_000;
    type Timer = EdgeTimer<TICKS>;

    struct Bench {
        timer: Timer,
        /// Time and direction of every later edge.
        edges: Vec<(u64, bool)>,
        next: usize,
        count: i32,
        up: bool,
        /// Captures that were not read yet.
        at: [Option<u16>; 2],
        /// Time and direction of the last edge in the count that was read last.
        last: Option<(u64, bool)>,
    }

    impl Bench {
        fn new(edges: Vec<(u64, bool)>, count: i32) -> Self {
            Self { timer: Timer::new(), edges, next: 0, count, up: true, at: [None; 2], last: None }
        }

        /// All edges up to `tick`.
        fn run_to(&mut self, tick: u64) {
            while let Some(&(at, up)) = self.edges.get(self.next)
                && at <= tick
            {
                let channel = self.count.rem_euclid(2) == i32::from(!up);
                self.at[usize::from(channel)] = Some(clock(at));
                self.count += if up { 1 } else { -1 };
                (self.up, self.next) = (up, self.next + 1);
            }
        }

        /// Takes a sample at `tick`. The count is read first, the timer `gap` ticks later, and the captures another
        /// `gap` ticks later.
        fn sample(&mut self, tick: u64, gap: u64) -> Option<Edge> {
            self.run_to(tick);
            let count = self.count.cast_unsigned();
            self.last = self.next.checked_sub(1).map(|n| self.edges[n]);
            self.run_to(tick + gap);
            let up = self.up;
            self.run_to(tick + 2 * gap);
            let at = std::mem::take(&mut self.at);
            self.timer.update(count, &Captures { now: clock(tick + gap), up, at })
        }
    }

    fn clock(tick: u64) -> u16 {
        u16::try_from(tick % u64::from(Timer::WRAP)).unwrap()
    }

    fn age(ticks: u64) -> u32 {
        u32::try_from((ticks << 16) / u64::from(TICKS)).unwrap()
    }

    #[test]
    fn ages_are_told_from_equal_distances() {
        let edges = std::vec![
            (10_000, true),
            (20_000, true),
            (26_997, true),
            (27_005, true),
            (54_004, false),
        ];
        let mut bench = Bench::new(edges, 0);
        assert_eq!(bench.sample(9_000, 2), None, "the first sample says nothing");
        let edge = |age, up| Some(Edge { age, up });
        assert_eq!(bench.sample(18_001, 2), edge(age(8_002), true));
        // This reading is late by 3 ticks, which has no effect.
        assert_eq!(bench.sample(27_003, 2), edge(age(5), true));
        // the edge at 27_005 was read with the captures, but is not in this count
        assert_eq!(bench.sample(36_000, 2), edge(age(8_997), true));
        assert_eq!(bench.sample(44_998, 2), edge(age(8_997) + 65_536, true));
        assert_eq!(
            bench.sample(54_010, 2),
            edge(0, false),
            "after the nominal instant, in the count"
        );
        assert_eq!(bench.sample(63_000, 2), edge(65_536, false));
    }

    #[test]
    #[cfg_attr(miri, ignore = "70,000 samples on a path that the others take too")]
    fn no_edge_ages_by_samples_for_ever() {
        let mut bench = Bench::new(std::vec![(9_100, false)], 7);
        let ages: Vec<_> = (1..70_000).map(|n| bench.sample(n * 9_000, 3)).collect();
        assert_eq!(ages[1], Some(Edge { age: age(8_903), up: false }));
        assert_eq!(ages[9], Some(Edge { age: age(8_903) + 8 * 65_536, up: false }));
        assert_eq!(ages[69_998], Some(Edge { age: u32::MAX, up: false }));
    }

    #[test]
    fn a_program_that_was_held_up_finds_its_phase_again() {
        let mut bench = Bench::new(std::vec![(50_000, true), (69_000, true)], 0);
        for tick in [9_800, 18_000, 27_000, 36_000 + 700] {
            bench.sample(tick, 2);
        }
        bench.sample(45_000, 2);
        assert_eq!(bench.sample(54_000, 2).unwrap().age, age(4_002));
        bench.sample(63_000, 2);
        assert_eq!(bench.sample(72_001, 2).unwrap().age, age(3_002));
    }

    /// The handle turns at an edge between the readings. The last edge of the count is then lost, and no edge is
    /// reported.
    #[test]
    fn an_edge_that_was_overwritten_is_not_mistaken() {
        let edges = std::vec![(20_000, true), (30_000, true), (33_000, true), (36_004, false)];
        let mut bench = Bench::new(edges, 0);
        for n in 1..4 {
            bench.sample(n * 9_000, 2);
        }
        let lost = bench.sample(36_000, 3);
        assert_eq!(lost, None, "33_000 was on the same channel as 36_004");
        assert_eq!(bench.sample(45_000, 3), Some(Edge { age: age(8_998), up: false }));
    }

    /// The handle turns at an edge between the readings, and the direction is read after the turn. The new edge must
    /// not be mistaken for the edge before it.
    #[test]
    fn a_turn_between_the_readings_is_noticed() {
        let edges = [10_000, 20_000, 27_500, 30_000, 33_000].map(|tick| (tick, true));
        let mut bench = Bench::new([&edges[..], &[(36_001, false)]].concat(), 0);
        for n in 1..4 {
            bench.sample(n * 9_000, 2);
        }
        assert_eq!(bench.sample(36_000, 3), None);
        assert_eq!(bench.sample(45_000, 3), Some(Edge { age: age(9_001), up: false }));
    }

    /// The motion consists of legs in one direction. `SPACING_MAX` is the largest number of ticks between two edges,
    /// and `LENGTH_MAX` the largest number of edges in a leg. Miri gets less, because it takes seconds for a thousand
    /// samples.
    const SPACING_MAX: u64 = if cfg!(miri) { 12_000 } else { 60_000 };
    const LENGTH_MAX: usize = if cfg!(miri) { 8 } else { 200 };

    proptest! {
        /// For any motion that does not turn near a reading, the reported edge is the last edge of the count. Its time
        /// is exact to the tick.
        #[test]
        fn the_edge_is_the_last_one_in_the_count(
            legs in prop::collection::vec((8..SPACING_MAX, 1..LENGTH_MAX, any::<bool>()), 1..8),
            count in -3..3i32,
            jitter in prop::collection::vec(0..6u64, 64),
            gap in 1..7u64,
        ) {
            let mut tick = 27_000;
            let mut edges = std::vec![];
            for (spacing, length, up) in legs {
                // The handle does not turn again within a tenth of a sample.
                tick += 900;
                for _ in 0..length {
                    tick += spacing.max(2 * gap + 1);
                    edges.push((tick, up));
                }
            }
            let end = tick + 30_000;
            let mut bench = Bench::new(edges, count);
            let mut latest: Option<Edge> = None;
            let (mut known, mut before) = (None, 0);
            let mut learnt = false;
            for (n, jitter) in (1..end / 9_000).zip(jitter.iter().cycle()) {
                // the first sample sets the phase
                let at = n * 9_000 + if n == 1 { 3 } else { *jitter };
                let nominal = n * 9_000 + 3 + gap;
                let got = bench.sample(at, gap);
                let last = bench.last;
                if n > 1 {
                    latest = if last == known {
                        latest.map(older)
                    } else {
                        last.map(|(edge, up)| Edge { age: age(nominal.saturating_sub(edge)), up })
                    };
                    // Until one edge was certain, a reported edge may be wrong.
                    let clear = |&(edge, _): &(u64, bool)| edge + 64 < at || edge > at + 2 * gap;
                    let new = last.is_some_and(|(edge, _)| edge > before + 2 * gap);
                    learnt |= new && bench.edges.iter().all(clear);
                    // The handle turns within a sample, and an edge comes between the readings.
                    let mut seen = bench.edges.iter().filter(|&&(edge, _)| {
                        edge > before && edge <= at + 2 * gap
                    });
                    let between = seen.clone().any(|&(edge, _)| edge > at);
                    let up = seen.clone().any(|&(_, up)| up);
                    let turned = between && up && seen.any(|&(_, up)| !up);
                    if turned && got.is_none() {
                        latest = None;
                    } else if learnt {
                        prop_assert_eq!(got, latest, "sample {}, {:?}", n, last);
                    }
                }
                (known, before) = (last, at);
            }
        }

        #[test]
        fn nothing_is_too_strange(
            readings in prop::collection::vec(
                (any::<u32>(), any::<u16>(), any::<bool>(), any::<Option<u16>>(), any::<Option<u16>>()),
                1..50,
            ),
        ) {
            let mut timer = Timer::new();
            for (count, now, up, a, b) in readings {
                timer.update(count, &Captures { now, up, at: [a, b] });
            }
        }
    }
}
