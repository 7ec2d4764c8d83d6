//! Edge times from a timer that captures the encoder's edges.
//!
//! The encoder's counter is read first, then the capturing timer's count, then what it captured. Both
//! see the same edges through the same filter, at the same time. What makes an [`Edge`] of it:
//!
//! **Which edge.** An edge may come between the readings, and the count does not have it then. One that
//! is newer than the timer's reading is none of this sample's. One that is hardly older ([`CLOSE`]) may
//! be: A and B take turns, so the channel of the last edge in a count follows from whether the count is
//! odd and from the direction. Which is which is learnt from edges that leave no doubt, and again with
//! each of them. An edge that is not in the count waits for the next one.
//!
//! **No edge** in the count since the last sample: the old one has aged by exactly one sample. The timer
//! wraps after a few samples, its count alone could not tell.
//!
//! **Age of what.** Samples are taken at equal distances, but for some cycles of the processor: one
//! reading sets the phase of all, and ages are told from there. So what an estimator takes for a sample is
//! one, and no jitter comes in; only an edge between the nominal and the true reading is off, by at most
//! their distance (its age is cut to 0, or to one sample with the next count). A reading that is more than
//! [`CLOSE`] ticks off sets the phase anew: the first ones come when the program is ready, and one that
//! was held up is no measure for the others.
//!
//! **Error.** The age is less than a tick too long or too short, and 2^-16 samples too short. A channel
//! holds its last edge only. So the last edge in a count is lost where one on the same channel comes
//! between the readings: the handle has turned at a border just then, or it moves by more than two counts
//! between the readings. Then there is no edge, and the estimator takes it to be half a count's time
//! old. It is mistaken for another, by one count, where the handle has turned within the last [`CLOSE`]
//! ticks and the direction was read after the turn.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::hint::cold_path;

use super::senses::Edge;

/// An edge that is not older, in ticks, may have come between the two readings.
pub const CLOSE: u32 = 32;

/// What the capturing timer says at a sample, in the order in which it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Captures {
    /// Its count, right after that of the encoder.
    pub now: u16,
    /// The encoder's count went up with its last edge.
    pub up: bool,
    /// Its count at the last edge of A and of B, if one came since the last sample.
    pub at: [Option<u16>; 2],
}

/// A captured edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Captured {
    /// The timer's count.
    at: u16,
    /// Channel A.
    is_a: bool,
}

/// Makes edges of captures, of a timer with `TICKS` per sample that wraps at [`WRAP`](Self::WRAP).
#[derive(Clone, Copy, Debug)]
pub struct EdgeTimer<const TICKS: u32> {
    /// Encoder's count at the last sample.
    count: u32,
    /// Ticks into a sample at which it is taken.
    phase: Option<u32>,
    /// Came after the last count was read.
    waiting: Option<Captured>,
    /// Channel, oddness and direction of a count's last edge, combined: the same for all edges.
    turns: Option<bool>,
    latest: Option<Edge>,
}

impl<const TICKS: u32> EdgeTimer<TICKS> {
    /// Whole samples, as many as fit into 16 bits.
    pub const WRAP: u32 = (1 << 16) / TICKS * TICKS;
    const FITS: () = assert!(TICKS > 4 * CLOSE && Self::WRAP >= 3 * TICKS, "three samples");

    /// Before the first sample.
    pub const fn new() -> Self {
        let () = Self::FITS;
        Self { count: 0, phase: None, waiting: None, turns: None, latest: None }
    }

    /// The latest edge in `count`. Call it with every sample.
    #[inline]
    pub fn update(&mut self, count: u32, captures: &Captures) -> Option<Edge> {
        let moved = count != self.count;
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
        let last = match newest {
            None => waiting,
            Some((newest, Some(age))) if age > CLOSE => {
                self.turns = Some(turns(newest));
                Some(newest)
            }
            Some((newest, Some(_))) if self.turns.is_none_or(|known| known == turns(newest)) => {
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
                before.filter(|&edge| self.turns.is_none_or(|known| known == turns(edge)))
            }
        };
        self.latest = match last {
            Some(edge) => {
                Some(Edge { age: age::<TICKS>(since(Self::WRAP, edge.at, captures.now), late), up })
            }
            None if moved => None,
            None => self.latest.map(older),
        };
        self.latest
    }

    /// What was captured, the newest first, each with its age at `now`, which those have not that came
    /// after it.
    #[inline]
    fn in_order(&self, captures: &Captures) -> [Option<(Captured, Option<u32>)>; 2] {
        let [a, b] = captures.at.map(|at| at.map(|at| (at, since(Self::WRAP, at, captures.now))));
        let seen = |since: u32| (since < Self::WRAP - TICKS).then_some(since);
        let a_side = a.map(|(at, since)| (Captured { at, is_a: true }, seen(since)));
        let b_side = b.map(|(at, since)| (Captured { at, is_a: false }, seen(since)));
        // Those that came after `now` are almost a whole turn old: shifted, all are in order.
        let age = |side: Option<(u16, u32)>| {
            side.map_or(u32::MAX, |(_, since)| (since + TICKS) % Self::WRAP)
        };
        if age(a) <= age(b) { [a_side, b_side] } else { [b_side, a_side] }
    }

    /// By how many ticks a reading at `now` is late; early if negative.
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

/// From `at` to `now`, in ticks, of a timer that wraps.
#[inline]
fn since(wrap: u32, at: u16, now: u16) -> u32 {
    let (at, now) = (u32::from(at), u32::from(now));
    if now >= at { now - at } else { (now + wrap).saturating_sub(at) }
}

/// In 2^-16 samples, of an edge that was `ticks` old at a reading that was `late`.
#[inline]
fn age<const TICKS: u32>(ticks: u32, late: i32) -> u32 {
    let ticks = ticks.saturating_add_signed(-late).min(u16::MAX.into());
    (ticks << Edge::FRACTION_BITS) / TICKS
}

/// The same edge, a sample later.
#[inline]
fn older(edge: Edge) -> Edge {
    Edge { age: edge.age.saturating_add(Edge::SAMPLE), ..edge }
}
