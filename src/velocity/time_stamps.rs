//! Time stamping. The velocity is the number of counts between two edges, divided by the time between them.
//!
//! ```text
//! v = (X[k] - X[j]) / (t[k] - t[j])       k: the latest edge, j: the latest edge that is older by
//!                                         a span less half a sample, or the oldest there is
//! |v| <= 1 / (t - t[k])                   no edge since: less than one count since
//! ```
//!
//! This is the M/T method of period measurement (Ohmae et al., IEEE TIE 29(3), 1982). The times of the edges are used
//! as in Merry, van de Molengraft, Steinbuch, "Velocity and acceleration estimation for optical incremental encoders",
//! Mechatronics 20(1), 2010. The encoder rounds down. So X is the count itself after an edge up, and the count plus one
//! after an edge down. A reversal at a border then gives 0, not 1. With ideal edges the positions are exact, and the
//! only error is the time's LSB of 2^-16 samples. Phase and duty errors of a real encoder repeat every four counts. The
//! span averages over them.
//!
//! **Input.** The estimator needs the age of the latest edge at each sample ([`Edge`]). If the age is not known, half a
//! count's time is assumed as the age. Then the result is only the number of counts in the span.
//!
//! **Error and delay.** At constant speed v the error is at most `v / (65536 (span - 1/2)) + 2^-17` counts per sample.
//! A speed below one count in 2^15 samples is standstill. The velocity is the mean velocity between the two edges.
//!
//! If edges come with every sample, the velocity is late by `span / 2` samples and half the time of a count. One edge
//! per sample is stored. The span is shortened by half a sample. This prevents the measured time from switching between
//! two lengths. If edges come less often than the span, the velocity is late by half the time between two edges and the
//! age of the last edge. When the handle slows down, the bound reduces this delay. After standstill the first edge
//! gives no velocity yet. The second edge gives a velocity.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::num::NonZeroU64;

use super::{
    Edge, Form, Senses,
    kept::{Bytes, Kept, kept},
};
use crate::{
    range::{SettingsError, within},
    units::Velocity,
};

/// Longest span, in samples.
pub const SPAN_MAX: u32 = 62;
/// Number of stored edges: one per sample of the longest span, one older and one newer.
const LENGTH: u8 = 64;
/// Time without an edge, in 2^-16 samples, after which the handle counts as standing still.
const STANDSTILL: u32 = 1 << 31;
/// A count per sample is 2^16 LSB of velocity, and a sample is 2^16 LSB of time. The velocity in LSB is counts *
/// 2^`SCALE_BITS` / time in LSB.
const SCALE_BITS: u32 = Velocity::FRACTION_BITS + Edge::FRACTION_BITS;

/// The estimator in integer form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeStamps {
    /// Shortest time of a measurement, in 2^-16 samples. It is half a sample less than the setting, which is 1 to
    /// [`SPAN_MAX`] samples.
    pub(super) span: u32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Stamp {
    /// Time of the edge, in 2^-16 samples. It wraps.
    time: u32,
    /// Exact position at the edge, in counts. It wraps.
    place: i32,
}

kept!(Stamp { time, place });

#[derive(Clone, Copy, Debug)]
pub(super) struct TimeStampsState {
    stamps: [Stamp; LENGTH as usize],
    sum: u32,
    /// Index of the latest stamp. `back` is the number of stamps from the first stamp of the measurement to the latest.
    /// Both are 0 if there was only one edge.
    latest: u8,
    back: u8,
    /// Whether there was an edge at all.
    begun: bool,
    /// Time of this sample, in 2^-16 samples. It wraps.
    now: u32,
    /// Count of this sample. It wraps, and does not change when the position is made zero.
    count: i32,
    /// Mean velocity between the two edges.
    measured: Velocity,
}

impl TimeStamps {
    /// Makes the estimator. A measurement takes at least this number of samples, 1 to [`SPAN_MAX`].
    ///
    /// # Errors
    /// Names the parameter and its range.
    pub fn new(span_samples: u32) -> Result<Self, SettingsError> {
        within("span_samples", span_samples.into(), 1.0..=f64::from(SPAN_MAX))?;
        Ok(Self { span: (span_samples << Edge::FRACTION_BITS) - Edge::SAMPLE / 2 })
    }

    /// Returns the mean velocity up to the latest edge. It first searches the edge at which this measurement begins,
    /// starting from the first edge of the last measurement.
    fn measure(&self, state: &mut TimeStampsState) -> Velocity {
        let latest = state.at(0);
        while state.back > 1 && latest.time.wrapping_sub(state.at(state.back - 1).time) >= self.span
        {
            state.back -= 1;
        }
        let from = state.at(state.back);
        let moved = latest.place.wrapping_sub(from.place);
        let time = latest.time.wrapping_sub(from.time).max(self.span);
        let bits = quotient(u64::from(moved.unsigned_abs()) << SCALE_BITS, time);
        let limit = u64::from(Velocity::LIMIT.unsigned_abs()) << Velocity::FRACTION_BITS;
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 31 bits")]
        let bits = bits.min(limit) as i32;
        Velocity::saturating_from_bits(if moved < 0 { -bits } else { bits })
    }
}

/// This state cannot be restored from bytes, because telemetry does not have the times of the edges.
impl Kept for TimeStampsState {
    fn put(&self, _: &mut Bytes<'_>) {}

    fn take(_: &mut &[u8]) -> Option<Self> {
        None
    }

    fn sum(&self) -> u32 {
        let Self { stamps: _, sum, latest, back, begun, now, count, measured } = *self;
        let small = u32::from_le_bytes([latest, back, begun.into(), 0]);
        [sum, small, now, count.cast_unsigned(), measured.sum()].sum()
    }

    #[inline(never)]
    fn is_whole(&self) -> bool {
        self.stamps.sum() == self.sum
    }
}

impl Form for TimeStamps {
    type State = TimeStampsState;
    const REST: TimeStampsState = TimeStampsState::REST;

    fn at(&self, velocity: Velocity) -> TimeStampsState {
        TimeStampsState::at_velocity(velocity, self)
    }

    #[inline]
    fn step(&self, state: &mut TimeStampsState, difference: i32, senses: &Senses) -> Velocity {
        state.now = state.now.wrapping_add(Edge::SAMPLE);
        state.count = state.count.wrapping_add(difference);
        if let Some(Edge { age, up }) = fresh(difference, senses.edge) {
            let place = state.count.wrapping_add(i32::from(!up));
            state.push(Stamp { time: state.now.wrapping_sub(age), place });
            state.measured = self.measure(state);
        }
        if !state.begun {
            return Velocity::ZERO;
        }
        let age = state.now.wrapping_sub(state.at(0).time);
        if age >= STANDSTILL {
            *state =
                TimeStampsState { now: state.now, count: state.count, ..TimeStampsState::REST };
            return Velocity::ZERO;
        }
        let speed = state.measured.bits().unsigned_abs();
        if u64::from(speed) * u64::from(age) <= 1 << SCALE_BITS {
            return state.measured;
        }
        // The quotient is at most the speed, which has 31 bits.
        #[expect(clippy::cast_possible_truncation, reason = "see above")]
        let bound = quotient(1 << SCALE_BITS, age) as i32;
        let velocity = if state.measured < Velocity::ZERO { -bound } else { bound };
        Velocity::saturating_from_bits(velocity)
    }
}

/// Returns `dividend / divisor`, rounded to the nearest. For a divisor of 0 it returns the dividend.
#[inline]
fn quotient(dividend: u64, divisor: u32) -> u64 {
    NonZeroU64::new(divisor.into())
        .map_or(dividend, |divisor| dividend.saturating_add(divisor.get() / 2) / divisor)
}

/// Returns the edge that came since the last sample, if there was one. If the count has moved, there was an edge. If
/// its age is not known, an age is assumed.
#[inline]
fn fresh(difference: i32, edge: Option<Edge>) -> Option<Edge> {
    match edge {
        Some(Edge { age, up }) if difference != 0 || age < Edge::SAMPLE => {
            Some(Edge { age: age.min(Edge::SAMPLE - 1), up })
        }
        None if difference != 0 => Some(Edge { age: likely_age(difference), up: difference > 0 }),
        _ => None,
    }
}

/// Returns half the time of one count at a speed of `counts` counts per sample, in 2^-16 samples. For a lower speed
/// than one count per sample it returns half a sample.
#[inline]
fn likely_age(counts: i32) -> u32 {
    Edge::SAMPLE / 2 / counts.unsigned_abs().max(1)
}

impl TimeStampsState {
    const REST: Self = Self {
        stamps: [Stamp { time: 0, place: 0 }; LENGTH as usize],
        sum: 0,
        latest: 0,
        back: 0,
        begun: false,
        now: 0,
        count: 0,
        measured: Velocity::ZERO,
    };

    /// Returns the stamp that is `back` stamps before the latest.
    #[inline]
    fn at(&self, back: u8) -> Stamp {
        let place = usize::from(self.latest.wrapping_sub(back) % LENGTH);
        self.stamps.get(place).copied().unwrap_or_default()
    }

    #[inline]
    fn push(&mut self, stamp: Stamp) {
        self.latest = self.latest.wrapping_add(1);
        if let Some(place) = self.stamps.get_mut(usize::from(self.latest % LENGTH)) {
            self.sum = self.sum.wrapping_sub(place.sum()).wrapping_add(stamp.sum());
            *place = stamp;
        }
        if self.begun {
            self.back = (self.back + 1).min(LENGTH - 1);
        }
        self.begun = true;
    }

    /// Makes the state after many samples at this velocity. It has two edges, which are a span or one count apart.
    fn at_velocity(velocity: Velocity, of: &TimeStamps) -> Self {
        let speed = velocity.bits().unsigned_abs();
        if speed == 0 {
            return Self::REST;
        }
        let counts = (u64::from(speed) * u64::from(of.span)).div_ceil(1 << SCALE_BITS);
        let time = quotient(counts << SCALE_BITS, speed);
        let (Ok(time), Ok(counts)) = (u32::try_from(time), i32::try_from(counts)) else {
            return Self::REST;
        };
        if time >= STANDSTILL {
            return Self::REST;
        }
        let up = velocity > Velocity::ZERO;
        let age = likely_age((velocity.bits() + (1 << 15)) >> Velocity::FRACTION_BITS);
        let place = i32::from(!up);
        let mut state = Self { measured: velocity, ..Self::REST };
        let latest = state.now.wrapping_sub(age);
        state.push(Stamp {
            time: latest.wrapping_sub(time),
            place: if up { place - counts } else { place + counts },
        });
        state.push(Stamp { time: latest, place });
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs the estimator over samples, and returns the velocities in LSB. Each sample has its difference, and the age
    /// and direction of its edge if there was one.
    fn run(span: u32, samples: &[(i32, Option<(u32, bool)>)]) -> std::vec::Vec<i32> {
        let estimator = TimeStamps::new(span).unwrap();
        let mut state = TimeStampsState::REST;
        samples
            .iter()
            .map(|&(difference, edge)| {
                let edge = edge.map(|(age, up)| Edge { age, up });
                estimator.step(&mut state, difference, &Senses { edge, ..Senses::NONE }).bits()
            })
            .collect()
    }

    #[test]
    fn two_edges_give_the_exact_mean_and_time_without_edges_bounds_it() {
        let half = 1 << 15;
        // Edges up come at 0.5 and at 2.25, which is 1.75 samples later. Then no edge comes.
        let got = run(
            1,
            &[
                (1, Some((half, true))),
                (0, Some((half + 65_536, true))),
                (1, Some((49_152, true))),
                (0, Some((49_152 + 65_536, true))),
                (0, Some((49_152 + 131_072, true))),
            ],
        );
        let measured = 37_449; // 2^16 / 1.75
        assert_eq!(got[..4], [0, 0, measured, measured]); // bound after 1.75 samples: the same
        assert_eq!(got[4], 23_831); // 2^16 / 2.75
    }

    #[test]
    fn a_reversal_at_one_border_measures_no_move() {
        // The handle goes up over the edge of a count, and back down over the same edge.
        assert_eq!(run(2, &[(1, Some((100, true))), (-1, Some((50, false)))])[1], 0);
        // The handle goes over the next edge and back within a sample. This is one count more, over at least the span.
        assert_eq!(run(2, &[(1, Some((100, true))), (0, Some((50, false)))])[1], 43_691); // 2^16 / 1.5
    }

    #[test]
    fn an_age_of_zero_and_the_largest_counts_do_no_harm() {
        for moved in [i32::MIN, i32::MAX, 1, -1] {
            for age in [0, u32::MAX] {
                let edge = Some((age, moved > 0));
                for bits in run(1, &[(moved, edge), (moved, edge), (0, Some((age, false)))]) {
                    assert!(bits.abs() <= 32_767 << 16);
                }
            }
        }
    }
}
