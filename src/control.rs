//! The control loop. It has the computations that run once per sample, and those that run once per output.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use core::{hint::cold_path, num::NonZeroU32};

use crate::{
    CounterWidth,
    actuator::Actuator,
    encoder::{Encoder, Width},
    units::{Demand, Force, Position, Velocity},
    velocity::{self, Running, Senses, Tuned},
    wall::Wall,
};

/// All values that the loop needs, as integers. [`Settings::build`](crate::Settings::build) makes them. They do not
/// change. A new `LoopParameters` replaces the old one as a whole, between two samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopParameters {
    /// Velocity estimator with its coefficients.
    pub estimator: Tuned,
    /// Virtual wall in integer form.
    pub wall: Wall,
    /// Turns a force into the output's code.
    pub actuator: Actuator,
    /// Samples from output to output.
    pub period: NonZeroU32,
}

/// One sample: position and velocity of the handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Number of this sample, from 0.
    pub sample: u64,
    /// Position of the handle, in counts.
    pub position: Position,
    /// Velocity of the handle as the estimator finds it, in 2^-16 counts per sample.
    pub velocity: Velocity,
}

/// Result of a [`Sampler`] for one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampled {
    /// Position and velocity of the handle.
    pub motion: Motion,
    /// Whether an output is due with this sample.
    pub due: bool,
}

impl Motion {
    /// Low 32 bits of the sample's number. They are enough to compare two samples that are less than 2^31 apart.
    #[inline(always)]
    pub const fn number(&self) -> u32 {
        low(self.sample)
    }
}

/// The result of one output: its force, and the values from which it follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Force that the wall gives back.
    pub wall: Demand,
    /// The force for the actuator. It is the push minus the wall's force, limited to full scale. [`Actuator::command`]
    /// turns it into a code.
    pub force: Force,
    /// Whether the handle is inside the wall.
    pub contact: bool,
    /// Whether the actuator could not give the whole force.
    pub saturated: bool,
}

/// The largest number of samples in one call of [`Sampler::sense_all`].
pub const RUN: usize = 16;

/// The part of the control loop that runs for every sample, with its state.
#[derive(Clone, Copy, Debug)]
pub struct Sampler<W = CounterWidth> {
    encoder: Encoder<W>,
    velocity: Running,
    /// Number of the next sample, low 32 bits.
    sample: u32,
    /// Number of the sample with which the next output is due, low 32 bits.
    due: u32,
    /// High 32 bits of `due`. No sample is far from `due`, so these bits also give the high bits of every sample's
    /// number.
    high: u32,
}

impl<W: Width> Sampler<W> {
    /// Begins with a handle at rest, whose encoder counter reads `counter`.
    pub fn new(counter: u32, width: W) -> Self {
        let encoder = Encoder::new(counter, width);
        Self { encoder, velocity: Running::REST, sample: 0, due: 0, high: 0 }
    }

    pub(crate) fn of_any_width(self) -> Sampler {
        let Self { encoder, velocity, sample, due, high } = self;
        Sampler { encoder: encoder.of_any_width(), velocity, sample, due, high }
    }

    /// Position of the last sample.
    pub fn position(&self) -> Position {
        self.encoder.position()
    }

    /// Whether the count at position 0 is unchanged.
    #[inline(always)]
    pub fn is_whole(&self) -> bool {
        self.encoder.is_whole()
    }

    /// Whether the estimator's memory is unchanged since the last sample. If the last sample had another tuning, the
    /// estimator will start anew, so the result is `true`.
    #[inline(always)]
    pub fn remembers(&self, control: &LoopParameters) -> bool {
        self.velocity.number() != control.estimator.number()
            || self.velocity.is_whole(&control.estimator)
    }

    /// Number of the next sample.
    pub const fn next(&self) -> u64 {
        self.near(self.sample)
    }

    /// Full number of a sample. `number` is the low half of the full number, 32 bits. Of all numbers with this low
    /// half, the result is the number nearest to the next due sample.
    #[inline(always)]
    const fn near(&self, number: u32) -> u64 {
        let since = number.wrapping_sub(self.due);
        let near = if since.cast_signed() < 0 {
            (self.high.wrapping_sub((number > self.due) as u32) as u64) << 32
        } else {
            ((self.high as u64) << 32 | self.due as u64).wrapping_add(since as u64)
        };
        // The low half of the result is `number` itself. Written like this, a caller that needs only the low half
        // computes no sum.
        near & !(u32::MAX as u64) | number as u64
    }

    /// The state of encoder and estimator after the last sample.
    pub fn state(&self) -> velocity::State {
        velocity::State::behind(self.encoder.position(), self.velocity)
    }

    /// Makes the position of the last sample the new position 0. The velocity does not change.
    pub fn zero(&mut self) {
        self.encoder.zero();
    }

    /// Takes a reading of the encoder counter. Call it once per sample, at a constant rate.
    #[inline]
    pub fn sample(&mut self, control: &LoopParameters, counter: u32) -> Sampled {
        self.sense(control, counter, &Senses::NONE)
    }

    /// Like [`sample`](Self::sample), but also for estimators that use more than the count.
    #[inline(always)] // as Estimator::update
    pub fn sense(&mut self, control: &LoopParameters, counter: u32, senses: &Senses) -> Sampled {
        let before = self.encoder.position();
        let position = self.encoder.track(counter);
        let moved = position.wrapping_since(before);
        let velocity = control.estimator.follow(&mut self.velocity, moved, senses);
        self.say(control, self.sample, position, velocity)
    }

    /// Like [`sense`](Self::sense), but for several readings, which are given as signed numbers. It takes at most
    /// [`RUN`] of them. Only the last reading may have an output. This function is for simulators, which have several
    /// readings at once: it looks up the estimator only once. `senses` is empty if the estimator needs none. Returns
    /// the velocities, and the result of `sense` for the last reading. Returns `None` if there is no reading.
    #[inline]
    pub fn sense_all(
        &mut self,
        control: &LoopParameters,
        counters: &[i32],
        senses: &[Senses],
        velocities: &mut [Velocity; RUN],
    ) -> Option<Sampled> {
        let counters = counters.get(..RUN).unwrap_or(counters);
        let velocities = velocities.get_mut(..counters.len())?;
        let mut moves = self.encoder.moves();
        let moved = |counter: i32| moves.to(counter);
        let readings = (counters, moved);
        let velocity =
            control.estimator.follow_all(&mut self.velocity, readings, senses, velocities)?;
        self.encoder.moved(&moves);
        #[expect(clippy::cast_possible_truncation, reason = "at most RUN")]
        let before = counters.len() as u32 - 1;
        Some(self.say(control, self.sample.wrapping_add(before), self.encoder.position(), velocity))
    }

    /// Makes the result for the sample `number`, and sets the number of the next sample.
    #[inline(always)]
    fn say(
        &mut self,
        control: &LoopParameters,
        number: u32,
        position: Position,
        velocity: Velocity,
    ) -> Sampled {
        self.sample = number.wrapping_add(1);
        let due = number.wrapping_sub(self.due).cast_signed() >= 0;
        let sample = self.near(number);
        if due {
            cold_path();
            let next = sample.wrapping_add(u64::from(control.period.get()));
            (self.due, self.high) = (low(next), low(next >> 32));
        }
        Sampled { motion: Motion { sample, position, velocity }, due }
    }
}

#[inline(always)]
const fn low(sample: u64) -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "the low half is meant")]
    let low = sample as u32;
    low
}

#[cfg(test)]
impl<W> Sampler<W> {
    pub(crate) fn spoil_origin(&mut self) {
        self.encoder.spoil_origin();
    }
}

impl LoopParameters {
    /// Makes these parameters ready to replace `running`. If they have another estimator or tuning than `running`, the
    /// estimator starts anew with the next sample. See [`Tuned`].
    #[must_use]
    pub fn after(self, running: &Self) -> Self {
        Self { estimator: self.estimator.after(&running.estimator), ..self }
    }

    /// Whether these parameters have the same effect as `other`. The time when the parameters were put in force is not
    /// compared.
    pub fn does_as(&self, other: &Self) -> bool {
        let Self { estimator, wall, actuator, period } = self;
        **estimator == *other.estimator
            && (wall, actuator, period) == (&other.wall, &other.actuator, &other.period)
    }

    /// Computes the output for `motion`. The output's force is `push` minus the wall's force, limited to the range of
    /// the actuator. A positive `push` points into the wall.
    #[inline]
    pub fn render(&self, motion: Motion, push: Force) -> Drive {
        let wall = self.wall.demand(motion.position, motion.velocity);
        let (force, saturated) = wall.against(push).saturate();
        Drive { wall, force, contact: self.wall.penetration(motion.position) > 0, saturated }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Settings, VelocitySettings, WallSettings, design::tests::DESIGN, encoder::Bits32,
        units::Acceleration, velocity::EstimatorName,
    };
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Parameters with a wall that the handle reaches.
    fn control(velocity: VelocitySettings) -> LoopParameters {
        let wall = WallSettings {
            position_m: 1e-3,
            stiffness_n_per_m: 2000.0,
            damping_n_s_per_m: 0.0,
            push_only: true,
        };
        Settings { velocity, wall }.build(&DESIGN).unwrap()
    }

    /// Groups of samples, each with the readings of the senses. Each group ends with an output.
    fn runs() -> impl Strategy<Value = Vec<(usize, [i32; RUN], i32)>> {
        prop::collection::vec((1..=RUN, prop::array::uniform16(-40..60), any::<i32>()), 1..40)
    }

    proptest! {
        /// The readings come in runs of any length. Any estimator may take over between two runs.
        #[test]
        fn readings_taken_together_say_what_they_say_one_by_one(
            runs in runs(), first in 0..EstimatorName::ALL.len(), wide: bool,
        ) {
            let width = if wide { CounterWidth::Bits32 } else { CounterWidth::Bits16 };
            let start = 0x8000 - 100; // both wrap soon
            let mut singly = Sampler::new(start, width);
            let mut together = singly;
            let mut counter = start.cast_signed();
            let names = &EstimatorName::ALL[first..];
            let mut in_force = control(names[0].defaults());
            for (n, (length, moves, sensed)) in runs.into_iter().enumerate() {
                if n % 8 == 7 {
                    in_force = control(names[n / 8 % names.len()].defaults()).after(&in_force);
                }
                let until = usize::try_from(singly.due.saturating_sub(singly.sample)).unwrap();
                let length = length.min(until + 1);
                let counters = moves.map(|moved| { counter = counter.wrapping_add(moved); counter });
                counter = counters[length - 1];
                let each = core::array::from_fn::<_, RUN, _>(|place| Senses {
                    force: Force::saturating_from_bits(sensed >> (place % 4)),
                    acceleration: Acceleration::saturating_from_bits(sensed >> (place % 7)),
                    ..Senses::NONE
                });
                let senses: &[Senses] = if n % 3 == 0 { &[] } else { &each };
                let mut velocities = [Velocity::ZERO; RUN];
                let said = together.sense_all(&in_force, &counters[..length], senses, &mut velocities);
                let mut last = None;
                for place in 0..length {
                    let senses = senses.get(place).unwrap_or(&Senses::NONE);
                    let sampled = singly.sense(&in_force, counters[place].cast_unsigned(), senses);
                    prop_assert_eq!(velocities[place], sampled.motion.velocity);
                    last = Some(sampled);
                }
                prop_assert_eq!(said, last);
                prop_assert_eq!(together.next(), singly.next());
                prop_assert!(together.is_whole() && singly.is_whole());
                prop_assert!(together.remembers(&in_force) && singly.remembers(&in_force));
            }
            let nothing = together.sense_all(&in_force, &[], &[], &mut [Velocity::ZERO; RUN]);
            prop_assert_eq!(nothing, None);
            let again = control(names[0].defaults()).after(&in_force);
            let (one, other) = (singly.sample(&again, 0), together.sample(&again, 0));
            prop_assert_eq!(one, other);
        }
    }

    /// The number of a sample (64 bits) follows from two numbers of 32 bits. This is tested where only the sample's
    /// number has passed 2^32, and where `due` has passed it too.
    #[test]
    fn samples_are_numbered_on_beyond_32_bits() {
        let control = control(VelocitySettings::Difference {});
        for ahead in 0..30 {
            let first = (1 << 32) - ahead;
            let mut sampler = Sampler::new(0, Bits32);
            (sampler.sample, sampler.due, sampler.high) =
                (low(first), low(first), low(first >> 32));
            for n in 0..40 {
                assert_eq!(sampler.next(), first + n);
                let Sampled { motion, due } = sampler.sample(&control, 7);
                assert_eq!((motion.sample, due), (first + n, n % 10 == 0), "{ahead}");
            }
            assert_eq!(sampler.of_any_width().next(), first + 40);
        }
    }

    /// There is no contact at the surface itself. The code of the wall has the same definition.
    #[test]
    fn contact_begins_one_count_behind_the_surface() {
        let control = control(VelocitySettings::Difference {});
        for (counts, contact) in [(999, false), (1000, false), (1001, true)] {
            let position = Position::from_counts(counts);
            let motion = Motion { sample: 0, position, velocity: Velocity::ZERO };
            assert_eq!(control.render(motion, Force::ZERO).contact, contact, "{counts}");
        }
    }
}
