//! Estimates the [`Velocity`] from the positions. This is the second stage of the loop, and it runs for every sample.
//!
//! An [`Estimator`] has integer coefficients, from the settings of a person. A [`State`] has the values that follow
//! from the past samples, and the number of the estimator. An estimator never continues from the state of another
//! estimator or tuning. Instead it starts from the velocity of the last sample, as if the handle had always moved at
//! this velocity. Otherwise one flicker of the counts could leave a slope in the state of a fast filter. With this
//! slope a slow filter would drift far away. [`Tuned`] is an estimator with the number of its tuning, so that both come
//! into force together, with one sample.

mod biquad;
#[cfg(feature = "estimators")]
mod biquad_design;
mod butterworth;
#[cfg(feature = "estimators")]
mod cascade;
mod difference;
mod edge_timer;
mod factor;
mod fir;
mod foaw;
mod history;
mod kalman;
mod kept;
mod levant;
mod name;
mod observer;
mod observer_design;
mod parameter;
mod polynomial;
mod rows;
mod senses;
mod table;
mod time_stamps;
mod tracking;
mod window_difference;
mod word;

pub use biquad::{Biquad, BiquadState, Shaping};
#[cfg(feature = "estimators")]
pub use biquad_design::{BiquadDesign, CascadeDesign};
pub use butterworth::{
    ButterworthDesign, CUTOFF_MAX, CUTOFF_MIN, FirstOrder, PREWARPED_MAX, QUALITY,
    damped_cutoff_hz, true_cutoff_hz,
};
#[cfg(feature = "estimators")]
pub use cascade::Cascade;
pub use difference::Difference;
pub use edge_timer::{Captures, EdgeTimer};
pub use factor::Factor;
pub use fir::Fir;
pub use foaw::Foaw;
pub use history::WINDOW_MAX;
pub use kalman::{Kalman, KalmanDesign, KalmanState};
pub use levant::{Levant, LevantDesign};
pub use name::UnknownEstimator;
pub use observer::{Fusion, Observer, ObserverState};
pub use observer_design::{MASS_KG, OBSERVER_MAX, OBSERVER_MIN, ObserverDesign};
pub use parameter::{Numbers, PARAMETERS, Parameter};
pub use polynomial::FirDesign;
pub use senses::{Edge, Sense, Senses};
pub use table::{Estimator, EstimatorName, VelocitySettings};
pub use time_stamps::{SPAN_MAX, TimeStamps};
pub use tracking::{BANDWIDTH_MAX, BANDWIDTH_MIN, RATIO, TrackingLoop};
pub use window_difference::{DIFFERENCE_WINDOW_MAX, WindowDifference};
pub use word::Word;

use crate::units::{Position, Velocity};
use kept::{Bytes, Kept};
use table::{Kind, Memory};

/// The integer form of an estimator. It runs for every sample.
trait Form {
    /// Values that follow from the past samples.
    type State: Copy + core::fmt::Debug + Kept;

    const REST: Self::State;

    /// Returns the state after many samples at this velocity. A form that replaces another form starts with this state.
    fn at(&self, velocity: Velocity) -> Self::State;

    /// Returns the velocity after a motion of `difference` counts in one sample.
    fn step(&self, state: &mut Self::State, difference: i32, senses: &Senses) -> Velocity;

    /// Does a [`step`](Self::step), and keeps a seal, which is the expected sum of the state's words. The form adds
    /// each new value to the seal, and subtracts each old value. If a bit of the state flips between two steps, the
    /// seal differs from the state's sum from then on.
    #[inline(always)]
    fn sealed(
        &self,
        (state, seal): (&mut Self::State, &mut u32),
        difference: i32,
        senses: &Senses,
    ) -> Velocity {
        let before = state.sum();
        let velocity = self.step(state, difference, senses);
        *seal = seal.wrapping_add(state.sum()).wrapping_sub(before);
        velocity
    }

    /// Writes the parts of the state on which a later velocity depends, as bytes.
    fn put(&self, state: &Self::State, bytes: &mut Bytes<'_>) {
        state.put(bytes);
    }

    /// Reads the state from the first bytes of `rest`, and moves `rest` behind them. Returns `None` if there are too
    /// few bytes.
    fn take(&self, rest: &mut &[u8]) -> Option<Self::State> {
        Self::State::take(rest)
    }
}

/// Calls [`Form::sealed`], but is not inlined, so that the state of the usual estimator stays in registers.
#[cfg(feature = "time-stamps")]
#[inline(never)]
fn called<F: Form>(
    form: &F,
    sealed_state: (&mut F::State, &mut u32),
    difference: i32,
    senses: &Senses,
) -> Velocity {
    form.sealed(sealed_state, difference, senses)
}

/// Runs [`Form::sealed`] for several samples. `senses` is empty if the board has none.
#[inline]
fn steps<F: Form>(
    form: &F,
    (state, seal): (&mut F::State, &mut u32),
    (counters, mut moved): (&[i32], impl FnMut(i32) -> i32),
    senses: &[Senses],
    velocities: &mut [Velocity],
) {
    /// Largest size of a state that is copied, in bytes. Its copy can stay in registers.
    const FEW: usize = 64;
    let mut each = |state: &mut F::State| {
        let step = |state: &mut F::State, place: usize, moved: i32| {
            form.step(state, moved, senses.get(place).unwrap_or(&Senses::NONE))
        };
        let (pairs, rest) = velocities.as_chunks_mut::<2>();
        let (counter_pairs, _) = counters.as_chunks::<2>();
        // Two samples are computed at a time. The first then leaves its values in the registers where the second needs
        // them.
        for (pair, ([one, two], counters)) in pairs.iter_mut().zip(counter_pairs).enumerate() {
            *one = step(state, 2 * pair, moved(counters[0]));
            *two = step(state, 2 * pair + 1, moved(counters[1]));
        }
        let place = 2 * pairs.len();
        if let ([last], Some(counter)) = (rest, counters.get(place)) {
            *last = step(state, place, moved(*counter));
        }
    };
    let before = state.sum();
    if size_of::<F::State>() > FEW {
        each(state);
    } else {
        let mut copy = *state;
        each(&mut copy);
        *state = copy;
    }
    *seal = seal.wrapping_add(state.sum()).wrapping_sub(before);
}

impl Estimator {
    /// Returns the velocity at this sample, in counts per sample.
    ///
    /// The usual estimators are inlined, all other estimators are called. So the state of a usual estimator stays in
    /// registers.
    #[inline(always)] // a call would put senses that nobody reads into memory
    pub fn update(&self, state: &mut State, position: Position, senses: &Senses) -> Velocity {
        self.update_as(Tuning::first(self), state, position, senses)
    }

    #[inline(always)] // as `update`
    fn update_as(
        &self,
        tuning: Tuning,
        state: &mut State,
        position: Position,
        senses: &Senses,
    ) -> Velocity {
        let difference = position.wrapping_since(state.previous);
        state.previous = position;
        self.follow_as(tuning, &mut state.running, difference, senses)
    }

    #[inline(always)] // as `update`
    fn follow_as(
        &self,
        tuning: Tuning,
        running: &mut Running,
        difference: i32,
        senses: &Senses,
    ) -> Velocity {
        if tuning != running.tuning {
            self.take_over(tuning, running);
        }
        let velocity = self.step((&mut running.memory, &mut running.seal), difference, senses);
        running.velocity = velocity;
        velocity
    }

    /// Replaces another estimator or tuning. Starts as if the handle had always moved at the velocity of the last
    /// sample.
    #[cold]
    #[inline(never)]
    fn take_over(&self, tuning: Tuning, running: &mut Running) {
        // If the seal is right for this tuning, the estimator has not changed. The numbers differ because a bit of the
        // stored number has flipped.
        let same = running.memory.sum(self).wrapping_add(tuning.0.into()) == running.seal;
        running.tuning = tuning;
        if !same {
            running.memory.restart(self, running.velocity);
            running.seal = running.sum(self);
        }
    }
}

/// A number that changes whenever the tuning or the form of the estimator changes. So a single comparison shows such a
/// change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Tuning(u16);

impl Tuning {
    #[inline(always)]
    const fn first(estimator: &Estimator) -> Self {
        Self(estimator.kind() as u16)
    }

    const fn next(self, estimator: &Estimator) -> Self {
        Self((self.0 & 0xFF00).wrapping_add(0x100) | estimator.kind() as u16)
    }
}

/// An [`Estimator`] with the number of its tuning. If estimator or tuning has changed, it starts anew with its first
/// sample. See [`after`](Self::after).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuned {
    tuning: Tuning,
    estimator: Estimator,
}

impl Tuned {
    /// Makes the first estimator after a reset.
    pub const fn first(estimator: Estimator) -> Self {
        Self { tuning: Tuning::first(&estimator), estimator }
    }

    /// Makes this estimator the successor of `running`. With the same tuning it continues, otherwise it starts anew.
    #[must_use]
    pub fn after(self, running: &Self) -> Self {
        let tuning = if self.estimator == running.estimator {
            running.tuning
        } else {
            running.tuning.next(&self.estimator)
        };
        Self { tuning, ..self }
    }

    /// Number of this tuning. It differs from the number of the tuning before.
    pub const fn number(&self) -> u16 {
        self.tuning.0
    }

    /// Like [`Estimator::update`], for this tuning.
    #[inline(always)] // as that
    pub fn update(&self, state: &mut State, position: Position, senses: &Senses) -> Velocity {
        self.estimator.update_as(self.tuning, state, position, senses)
    }

    /// Returns the velocity at this sample, for a caller that knows the counts by which the handle has moved.
    #[inline(always)] // as that
    pub(crate) fn follow(
        &self,
        running: &mut Running,
        difference: i32,
        senses: &Senses,
    ) -> Velocity {
        self.estimator.follow_as(self.tuning, running, difference, senses)
    }

    /// Does [`follow`](Self::follow) for several samples, and writes a velocity for each. `moved` returns the counts of
    /// a reading. Returns the last velocity.
    #[inline]
    pub(crate) fn follow_all(
        &self,
        running: &mut Running,
        readings: (&[i32], impl FnMut(i32) -> i32),
        senses: &[Senses],
        velocities: &mut [Velocity],
    ) -> Option<Velocity> {
        if self.tuning != running.tuning && !velocities.is_empty() {
            self.estimator.take_over(self.tuning, running);
        }
        let memory = (&mut running.memory, &mut running.seal);
        self.estimator.step_all(memory, readings, senses, velocities);
        running.velocity = *velocities.last()?;
        Some(running.velocity)
    }
}

impl core::ops::Deref for Tuned {
    type Target = Estimator;

    fn deref(&self) -> &Estimator {
        &self.estimator
    }
}

/// The estimator's state after the last sample, without the position.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Running {
    tuning: Tuning,
    velocity: Velocity,
    memory: Memory,
    /// The sum that the number of the tuning and the words of the memory must have.
    seal: u32,
}

impl Running {
    pub(crate) const REST: Self = Self {
        tuning: Tuning(Kind::Difference as u16),
        velocity: Velocity::ZERO,
        memory: Memory::REST,
        seal: Kind::Difference as u32, // which remembers nothing
    };

    #[inline(always)]
    pub(crate) const fn number(&self) -> u16 {
        self.tuning.0
    }

    #[inline(always)]
    fn sum(&self, estimator: &Estimator) -> u32 {
        self.memory.sum(estimator).wrapping_add(self.tuning.0.into())
    }

    /// Whether the state is unchanged since the last sample of `estimator`.
    #[inline(always)]
    pub(crate) fn is_whole(&self, estimator: &Estimator) -> bool {
        self.sum(estimator) == self.seal && self.memory.is_whole(estimator)
    }
}

/// State of an estimator after the last sample.
#[derive(Clone, Copy, Debug)]
pub struct State {
    previous: Position,
    running: Running,
}

impl State {
    /// Begins with a handle at rest at `position`. This counts as the position of the sample before the first one.
    pub fn at_rest(position: Position) -> Self {
        Self::behind(position, Running::REST)
    }

    /// The state after a sample at the position `previous`.
    pub(crate) const fn behind(previous: Position, running: Running) -> Self {
        Self { previous, running }
    }

    /// [`Tuned::number`] of this state's estimator.
    pub const fn number(&self) -> u16 {
        self.running.tuning.0
    }

    /// Position and velocity of the last sample.
    pub const fn last(&self) -> (Position, Velocity) {
        (self.previous, self.running.velocity)
    }

    /// Writes the memory of `estimator` as bytes. Returns their number, or `None` if there is no room.
    pub fn put(&self, estimator: &Estimator, place: &mut [u8]) -> Option<usize> {
        let mut bytes = Bytes::new(place);
        self.running.memory.put(estimator, &mut bytes);
        bytes.used()
    }

    /// Restores the state of `estimator` after a sample with this position and velocity, from the bytes of
    /// [`put`](Self::put). Returns `None` if the bytes are too few or belong to another estimator.
    pub fn of(
        estimator: &Tuned,
        (previous, velocity): (Position, Velocity),
        bytes: &[u8],
    ) -> Option<Self> {
        let mut rest = bytes;
        let memory = Memory::take(estimator, &mut rest)?;
        let mut running = Running { tuning: estimator.tuning, velocity, memory, seal: 0 };
        running.seal = running.sum(estimator);
        rest.is_empty().then_some(Self { previous, running })
    }

    /// Makes the estimator start anew at the next sample, from the last velocity.
    pub fn restart(&mut self) {
        self.running.tuning = Tuning(u16::MAX); // no form has this number
        self.running.seal = self.running.seal.wrapping_add(1 << 31); // nor does it fit what is remembered
    }

    /// The state after many samples at this velocity. The next estimator starts from it.
    #[cfg(test)]
    pub(crate) fn restart_at(&mut self, velocity: Velocity) {
        self.running.velocity = velocity;
        self.restart();
    }

    /// Gives the handle's place at the last sample the new position `position`. The velocity stays.
    pub fn rebase(&mut self, position: Position) {
        self.previous = position;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::tests::DESIGN;

    /// Returns the largest error of an estimator at a constant speed of whole counts, in LSB.
    fn chattering(name: EstimatorName) -> i32 {
        // The error is twice the largest acceleration, which is 0.2 counts per sample^2 at C = 20 m/s^2.
        if name.text() == "levant-explicit" { 2 * (65_536 / 5) } else { 0 }
    }

    /// Every estimator measures a constant speed. An estimator that replaces another one continues at this speed.
    #[test]
    #[cfg_attr(miri, ignore = "every pair, 2200 samples each")]
    fn an_estimator_that_takes_over_goes_on_at_the_velocity_of_the_old_one() {
        for before in EstimatorName::ALL {
            for after in EstimatorName::ALL {
                let [old, new] =
                    [before, after].map(|name| name.defaults().build(&DESIGN).unwrap());
                let mut state = State::at_rest(Position::default());
                let mut count = 0;
                let mut step = |estimator: &Estimator, state: &mut State| {
                    count += 7;
                    estimator.update(state, Position::from_counts(count), &Senses::default())
                };
                let was = (0..2000).map(|_| step(&old, &mut state)).last().unwrap();
                for n in 0..200 {
                    let is = step(&new, &mut state);
                    let off = (is.bits() - was.bits()).abs();
                    let allowed = 2 + chattering(*before) + chattering(*after);
                    assert!(off <= allowed, "{before:?} to {after:?}: {off} LSB after {n} samples");
                }
            }
        }
    }

    /// After any samples, an estimator that is restored from its bytes gives the same velocities as the original.
    #[test]
    #[cfg_attr(miri, ignore = "every estimator, 900 samples each")]
    fn an_estimator_goes_on_from_its_bytes_as_it_went_on() {
        for name in EstimatorName::ALL {
            let tuned = Tuned::first(name.defaults().build(&DESIGN).unwrap());
            let mut state = State::at_rest(Position::default());
            let senses = Senses {
                force: crate::units::Force::saturating_from_bits(1 << 28),
                ..Senses::NONE
            };
            let step = |state: &mut State, n: i32| {
                let count = 40 * n + n % 7 - 2 + n * n % 5;
                tuned.update(state, Position::from_counts(count), &senses)
            };
            for n in 0..700 {
                step(&mut state, n);
            }
            let mut bytes = [0; crate::telemetry::STATE_MAX];
            let length = state.put(&tuned, &mut bytes).unwrap();
            let again = State::of(&tuned, state.last(), &bytes[..length]);
            if name.text() == "time-stamps" {
                assert!(again.is_none() && length == 0);
                continue;
            }
            let mut again = again.unwrap();
            assert!(State::of(&tuned, state.last(), &bytes[..length + 1]).is_none(), "{name:?}");
            assert!(length == 0 || State::of(&tuned, state.last(), &bytes[..length - 1]).is_none());
            assert!(
                state.put(&tuned, &mut bytes[..length.saturating_sub(1)]).is_none() || length == 0
            );
            let mut twin = state;
            for n in 700..900 {
                let expected = step(&mut twin, n);
                assert_eq!(step(&mut again, n), expected, "{name:?}, sample {n}");
            }
        }
    }

    /// A flipped bit in the memory of an estimator is found, now and as long as the estimator runs.
    #[test]
    #[cfg_attr(miri, ignore = "every bit of every estimator")]
    fn a_flipped_bit_of_what_it_remembers_is_found_until_another_takes_over() {
        for name in EstimatorName::ALL {
            let tuned = Tuned::first(name.defaults().build(&DESIGN).unwrap());
            let mut running = Running::REST;
            let follow = |running: &mut Running, n: i32| {
                tuned.follow(running, 3 + n % 7 + n * n % 5, &Senses::NONE);
            };
            for n in 0..300 {
                follow(&mut running, n);
                assert!(running.is_whole(&tuned), "{name:?}");
            }
            let mut bytes = [0; crate::telemetry::STATE_MAX];
            let mut place = Bytes::new(&mut bytes);
            running.memory.put(&tuned, &mut place);
            let length = place.used().unwrap();
            // A ring that is made from bytes has the sum of these bytes: see the ring's own test.
            let ring = name.text().starts_with("taylor") || name.keys().contains(&"window_samples");
            for bit in (0..8 * length).filter(|_| !ring) {
                bytes[bit / 8] ^= 1 << (bit % 8);
                let memory = Memory::take(&tuned, &mut &bytes[..length]).unwrap();
                bytes[bit / 8] ^= 1 << (bit % 8);
                let mut broken = Running { memory, ..running };
                // Only some bits run for ten samples. With the other bits the overflow checks of the test would fail. A
                // board has no such checks.
                let samples = if bit % 64 < 24 { 10 } else { 1 };
                for n in 300..300 + samples {
                    assert!(!broken.is_whole(&tuned), "{name:?}, bit {bit}, sample {n}");
                    if samples > 1 {
                        follow(&mut broken, n);
                    }
                }
            }
            // With a flipped bit in the number of the tuning, it looks as if another tuning had run. The estimator must
            // continue all the same.
            for bit in 0..16 {
                let tuning = Tuning(running.tuning.0 ^ 1 << bit);
                let mut broken = Running { tuning, ..running };
                let mut whole = running;
                follow(&mut broken, 300);
                follow(&mut whole, 300);
                assert_eq!(
                    (broken.velocity, broken.seal),
                    (whole.velocity, whole.seal),
                    "{name:?}"
                );
            }
        }
    }

    /// docs/estimators.md states these sizes.
    #[test]
    fn states_and_coefficients_are_as_small_as_documented() {
        assert_eq!([size_of::<history::History>(), size_of::<Foaw>()], [136, 8]);
        assert_eq!([size_of::<levant::LevantState>(), size_of::<Levant>()], [16, 40]);
        assert_eq!([size_of::<kalman::KalmanState>(), size_of::<Kalman>()], [32, 24]);
    }

    #[test]
    fn the_first_sample_and_a_wrap_of_the_position_make_no_spike() {
        let settings = VelocitySettings::Butterworth { cutoff_hz: 4000.0 };
        let estimator = settings.build(&DESIGN).unwrap();
        let start = Position::from_counts(i32::MAX);
        let mut state = State::at_rest(start);
        assert_eq!(estimator.update(&mut state, start, &Senses::default()), Velocity::ZERO);
        let across =
            estimator.update(&mut state, Position::from_counts(i32::MIN), &Senses::default());
        assert!(across > Velocity::ZERO && across.bits() < 1 << Velocity::FRACTION_BITS);
    }
}
