//! An observer of position, velocity and disturbance. A part of the acceleration is known. It comes from the commanded
//! force (extended-state observer), or from an accelerometer (fusion).
//!
//! ```text
//! a  = u + d^                              u: the part that is known, counts per sample^2
//! e  = x[n] - (x^ + v^ + a/2)
//! x^ = x^ + v^ + a/2 + l1 e
//! v^ = v^ + a        + l2 e                the output
//! d^ = d^            + l3 e                what u leaves out
//! ```
//!
//! This is a Luenberger observer of a mass (Luenberger, IEEE Trans. Military Electronics 8, 1964). It is extended by
//! the disturbance (Han; Gao, "Scaling and bandwidth-parameterization based controller tuning", ACC 2003). The
//! disturbance d^ contains the force of the hand, friction and spring of the device, and an error of the mass or of the
//! accelerometer's zero. So v^ has no steady error while these forces and errors are constant. As in Gao's paper, all
//! poles are at one bandwidth w, here exactly in discrete time. `(z - p)^3` with `p = exp(-w T)` gives
//!
//! ```text
//! l1 = 1 - p^3,   l2 = 3/2 (1 - p)^2 (1 + p),   l3 = (1 - p)^3
//! ```
//!
//! **Response to a motion.** In continuous time, for w T << 1, with U the transform of u:
//!
//! ```text
//! V^ = (3 w^2 s + w^3) / P  s X  +  (s^3 + 3 w s^2) / P  U / s,      P = (s + w)^3
//! ```
//!
//! The output is low-passed differentiated position plus high-passed integrated acceleration. The weights of both parts
//! add up to one, so the two filters are complementary. If u is right, there is no delay at any frequency. If u is 0,
//! the delay at DC is 0 as well. But for motions at about 0.6 of the bandwidth the output is then too large by 2.3 dB.
//!
//! **Fixed point.** The state has the difference `x - x^`, so a wrap of the count does not matter. This difference has
//! 32 fractional bits, the velocity 44, the disturbance 48. Products have 96 bits. Each state saturates. With the gains
//! of the lowest bandwidth an error of 2^-26 counts still changes the disturbance. So no error that is visible in the
//! output can persist.

#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

use super::{Form, Senses, Word, factor::Factor, kept::kept};
use crate::{
    Gain,
    units::{Acceleration, Velocity},
};

/// Number of fractional bits of `x - x^`, of e and of a known acceleration.
pub(super) const POSITION_BITS: u32 = 32;
const VELOCITY_BITS: u32 = 44;
const DISTURBANCE_BITS: u32 = 48;
/// Largest magnitude of `x - x^`. It is 2^22 counts.
const ERROR_LIMIT: i64 = 1 << (POSITION_BITS + 22);
const VELOCITY_LIMIT: i64 = (Velocity::LIMIT as i64) << VELOCITY_BITS;
/// Largest magnitude of the disturbance. It is 2^14 counts per sample^2.
const DISTURBANCE_LIMIT: i64 = 1 << (DISTURBANCE_BITS + 14);

/// An observer in integer form that knows the force. Made by [`ObserverDesign`](super::ObserverDesign).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observer<F = Factor> {
    /// Gain l1 of the position.
    pub position: F,
    /// Gain l2 of the velocity. Its product has [`VELOCITY_MORE`](Self::VELOCITY_MORE) further fractional bits.
    pub velocity: F,
    /// Gain l3 of the disturbance. Its product has [`DISTURBANCE_MORE`](Self::DISTURBANCE_MORE) further fractional
    /// bits.
    pub disturbance: F,
    /// Acceleration per LSB of [`Force`](crate::units::Force), in counts per sample^2 with 32 fractional bits. It is 0
    /// for fusion.
    pub per_force: Gain,
}

/// The observer with an accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fusion(pub Observer);

/// State after the last sample.
#[derive(Clone, Copy, Debug)]
pub struct ObserverState<W: Word = i64> {
    /// The count minus the estimated position, x - x^, with 32 fractional bits.
    pub error: W,
    /// The estimated velocity v^, with 44 fractional bits.
    pub velocity: W,
    /// The estimated disturbance d^, with 48 fractional bits.
    pub disturbance: W,
}

kept!(ObserverState { error, velocity, disturbance });

impl Form for Observer {
    type State = ObserverState;
    const REST: ObserverState = ObserverState { error: 0, velocity: 0, disturbance: 0 };

    fn at(&self, velocity: Velocity) -> ObserverState {
        let velocity = i64::from(velocity.bits()) << (VELOCITY_BITS - Velocity::FRACTION_BITS);
        ObserverState { velocity, ..Self::REST }
    }

    #[inline]
    fn step(&self, state: &mut ObserverState, difference: i32, senses: &Senses) -> Velocity {
        self.sample(state, difference, self.per_force.apply(senses.force.bits()))
    }
}

impl Form for Fusion {
    type State = ObserverState;
    const REST: ObserverState = Observer::REST;

    fn at(&self, velocity: Velocity) -> ObserverState {
        self.0.at(velocity)
    }

    #[inline]
    fn step(&self, state: &mut ObserverState, difference: i32, senses: &Senses) -> Velocity {
        self.0.sample(state, difference, i64::from(senses.acceleration.bits()) << Self::KNOWN_MORE)
    }
}

impl Fusion {
    /// Number of fractional bits of a known acceleration beyond those of an [`Acceleration`].
    pub const KNOWN_MORE: u32 = POSITION_BITS - Acceleration::FRACTION_BITS;
}

impl Observer {
    /// Returns the velocity after a motion of `difference` counts in one sample.
    #[inline]
    fn sample(&self, state: &mut ObserverState, difference: i32, known: i64) -> Velocity {
        let difference = difference.clamp(-Velocity::LIMIT, Velocity::LIMIT);
        let velocity = self.update(state, i64::from(difference), known);
        #[expect(clippy::cast_possible_truncation, reason = "31 bits, as the velocity is limited")]
        Velocity::saturating_from_bits(velocity as i32)
    }
}

impl<F: Copy> Observer<F> {
    /// Further fractional bits of the product with l2.
    pub const VELOCITY_MORE: u8 = 12;
    /// Further fractional bits of the product with l3.
    pub const DISTURBANCE_MORE: u8 = 16;

    /// Takes a motion of `moved` counts. `known` is the known acceleration, with 32 fractional bits. The design keeps
    /// it below 2^47. Returns the velocity in LSB of [`Velocity`].
    #[inline(always)] // into what is compiled for a machine's vectors
    pub fn update<W: Word<Factor = F>>(
        &self,
        state: &mut ObserverState<W>,
        moved: W,
        known: W,
    ) -> W {
        const FROM_VELOCITY: u32 = VELOCITY_BITS - POSITION_BITS;
        const FROM_DISTURBANCE: u32 = DISTURBANCE_BITS - POSITION_BITS;
        let acceleration = known + (state.disturbance >> FROM_DISTURBANCE);
        let predicted = (state.velocity >> FROM_VELOCITY) + (acceleration >> 1);
        let e = (state.error + (moved << POSITION_BITS) - predicted).clamped(ERROR_LIMIT);
        state.error = e - e.part(self.position, 0);
        // The sum is below 2^59 + 2^59 + 2^58 + 2^62, which is below 2^63.
        let velocity = state.velocity
            + (known << FROM_VELOCITY)
            + (state.disturbance >> (DISTURBANCE_BITS - VELOCITY_BITS))
            + e.part(self.velocity, Self::VELOCITY_MORE);
        state.velocity = velocity.clamped(VELOCITY_LIMIT);
        state.disturbance = state
            .disturbance
            .saturating(e.part(self.disturbance, Self::DISTURBANCE_MORE))
            .clamped(DISTURBANCE_LIMIT);
        state.velocity.rounded(VELOCITY_BITS - Velocity::FRACTION_BITS)
    }
}

const _: () = assert!(Observer::<Factor>::VELOCITY_MORE as u32 == VELOCITY_BITS - POSITION_BITS);
const _: () =
    assert!(Observer::<Factor>::DISTURBANCE_MORE as u32 == DISTURBANCE_BITS - POSITION_BITS);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Design, Output, units::Force, velocity::ObserverDesign};

    /// Every intermediate is monotone in each argument (see [`crate::bounds`]).
    #[test]
    fn no_step_overflows_at_any_corner_of_state_and_input() {
        let design = Design {
            rate_hz: 1e4,
            resolution_m: 1e-6,
            full_scale_n: 3276.0, // with 1 g the largest acceleration that is accepted,
            period: 10,
            output: Output::Continuous,
        };
        for bandwidth_hz in [10.0, 100.0, 1000.0, 2000.0] {
            for mass_kg in [1e-3, 0.416, 100.0] {
                let observer =
                    ObserverDesign::of_mass(bandwidth_hz, mass_kg, &design).unwrap().quantise();
                let ends = [ERROR_LIMIT, VELOCITY_LIMIT, DISTURBANCE_LIMIT].map(|max| [-max, max]);
                for [error, velocity, disturbance] in crate::bounds::corners(ends) {
                    let state = ObserverState { error, velocity, disturbance };
                    for [moved, known] in crate::bounds::corners([[i32::MIN, i32::MAX]; 2]) {
                        let senses = Senses {
                            force: Force::saturating_from_bits(known),
                            acceleration: Acceleration::saturating_from_bits(known),
                            edge: None,
                        };
                        let speeds = [
                            observer.step(&mut { state }, moved, &senses),
                            Fusion(observer).step(&mut { state }, moved, &senses),
                        ];
                        assert!(speeds.iter().all(|v| v.bits().abs() <= Velocity::LIMIT_BITS));
                    }
                }
            }
        }
    }
}
