//! A plant that is integrated step by step: the chain with friction, cogging, travel limits and backlash.
//!
//! The plant is smooth between the instants at which its equation changes. The [`Regime`] of the plant selects the
//! equation. A guard is a function that becomes negative when the regime ends. If a guard is negative at the end of a
//! step, the step is shortened until the guard is zero to the last digits. The state is put exactly on the boundary,
//! and the next step starts in the new regime.
//!
//! So each integration method keeps its order of accuracy. A sticking device has speed 0 and does not creep. No device
//! passes a rigid stop. If a guard changes its sign twice within one step, nothing is detected. So a step must be short
//! compared with the motion. A method with error control selects steps that are short enough.
//!
//! Source: Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 2nd ed., II.6 (discontinuities).

mod gap;
mod regime;

use gap::Gap;
pub use regime::Regime;
use regime::{Event, Motion, Play, Stop};

use std::sync::Arc;

use super::{AnyState, Plant, exact::still};
use crate::{
    numerics::integrator::{Field, Integrator, dormand_prince},
    scene::element::{Chain, Cogging, Friction, Nonlinear, Travel},
};

/// Largest number of regime changes that are located in one piece of a sample. After this number, a regime change takes
/// effect at the end of its step, and the speed is set to 0 when the device reaches an end. So a piece with infinitely
/// many bounces is computed in finite time.
const EVENTS_MAX: u32 = 200;
/// Shortest adaptive step, as a fraction of the sample.
const SHORTEST: f64 = 1e-6;
/// Largest time that is treated as 0, as a fraction of the sample.
const NO_TIME: f64 = 1e-13;

/// A plant of N linear states, with its non-linear elements and its integrator.
#[derive(Clone, Debug, PartialEq)]
pub struct IntegratedStep<const N: usize> {
    a: [[f64; N]; N],
    b: [f64; N],
    /// Acceleration that the hand's constant force causes.
    hand: [f64; N],
    mass_kg: f64,
    rest_m: [f64; 3],
    friction: Option<Friction>,
    cogging: Option<Cogging>,
    travel: Option<Travel>,
    gap: Option<Gap<N>>,
    integrator: Integrator,
    sample_s: f64,
    /// Time within the sample at which a command takes effect, in s.
    split_s: f64,
    /// Lengths of the steps of a whole sample without regime changes. The list is empty for a method with error
    /// control.
    even: Arc<[f64]>,
    /// Absolute tolerance of each state.
    tolerances: [f64; N],
}

/// The states of the chain, the regime, the length of the next adaptive step, and the number of steps that were tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HybridState<const N: usize> {
    z: [f64; N],
    regime: Regime,
    step_s: f64,
    steps: u64,
}

/// The linear plant while one force acts.
struct Linear<'a, const N: usize> {
    a: &'a [[f64; N]; N],
    /// The part of the rates that does not depend on the state.
    constant: [f64; N],
}

impl<const N: usize> Field<N> for Linear<'_, N> {
    #[inline(always)]
    fn rate(&self, z: &[f64; N]) -> [f64; N] {
        let mut rate = self.constant;
        for (rate, row) in rate.iter_mut().zip(self.a) {
            for (entry, value) in row.iter().zip(z) {
                *rate += entry * value;
            }
        }
        rate
    }
}

/// The plant in one regime, while one force acts. The rates are smooth functions of the state.
struct Smooth<'a, const N: usize> {
    plant: &'a IntegratedStep<N>,
    regime: Regime,
    force_n: f64,
}

impl<const N: usize> Field<N> for Smooth<'_, N> {
    #[inline]
    fn rate(&self, z: &[f64; N]) -> [f64; N] {
        let mut rate = self.plant.linear(self.force_n, self.regime.play).rate(z);
        let direction = match self.regime.motion {
            Motion::Held => {
                (rate[0], rate[1]) = (0.0, 0.0);
                return rate;
            }
            Motion::Up => 1.0,
            Motion::Down => -1.0,
        };
        let mut force_n = self.plant.position_force_n(z, self.regime.stop);
        if let Some(friction) = self.plant.friction {
            force_n -= direction * friction.sliding_n(z[1]);
        }
        rate[1] += force_n / self.plant.mass_kg;
        rate
    }
}

impl<const N: usize> IntegratedStep<N> {
    /// The plant, sampled every `sample_s`. A command takes effect at `fraction` (0 to below 1) of the sample.
    ///
    /// # Panics
    /// N is not the chain's number of states.
    pub fn new(
        chain: &Chain,
        nonlinear: &Nonlinear,
        integrator: Integrator,
        sample_s: f64,
        fraction: f64,
    ) -> Self {
        let (a, b) = chain.system::<N>();
        let Nonlinear { friction, cogging, travel, backlash } = *nonlinear;
        let mass_kg = chain.device.mass_kg;
        let absolute_m = match integrator {
            Integrator::DormandPrince { absolute_tolerance_m, .. } => absolute_tolerance_m,
            _ => 0.0,
        };
        Self {
            a: core::array::from_fn(|row| core::array::from_fn(|column| a[(row, column)])),
            b: b.into(),
            hand: core::array::from_fn(|row| chain.hand()[row]),
            mass_kg,
            rest_m: chain.rest_m(),
            friction,
            cogging,
            travel,
            gap: backlash.and_then(|backlash| Gap::new(chain, backlash)),
            integrator,
            sample_s,
            split_s: fraction * sample_s,
            even: even_steps(&integrator, sample_s),
            tolerances: core::array::from_fn(|i| {
                if N % 2 == 1 && i == N - 1 {
                    absolute_m * mass_kg / (sample_s * sample_s)
                } else if i % 2 == 1 {
                    absolute_m / sample_s
                } else {
                    absolute_m
                }
            }),
        }
    }

    /// The linear part of the plant under this force.
    #[inline]
    fn linear(&self, force_n: f64, play: Play) -> Linear<'_, N> {
        let constant = core::array::from_fn(|row| self.b[row] * force_n + self.hand[row]);
        match &self.gap {
            None => Linear { a: &self.a, constant },
            Some(gap) => gap.linear(&self.a, constant, play),
        }
    }

    fn is_linear(&self) -> bool {
        self.friction.is_none()
            && self.cogging.is_none()
            && self.travel.is_none()
            && self.gap.is_none()
    }

    #[inline]
    fn absolute_m(&self, z: &[f64; N]) -> f64 {
        z[0] + self.rest_m[0]
    }

    /// Force of cogging and stops in N.
    #[inline]
    fn position_force_n(&self, z: &[f64; N], stop: Stop) -> f64 {
        let position_m = self.absolute_m(z);
        let mut force_n = self.cogging.map_or(0.0, |cogging| cogging.force_n(position_m));
        if let (Some(travel), Stop::Pushing(end)) = (self.travel, stop) {
            force_n -= end.outward() * travel.push_n(end, position_m, z[1]);
        }
        force_n
    }

    /// Tries one step. The step has the length `length_s`; without `length_s`, the method selects a length of at most
    /// `left_s`. Returns the length and the state at the end of the step.
    #[inline(always)]
    fn trial(
        &self,
        field: &impl Field<N>,
        state: &mut HybridState<N>,
        left_s: f64,
        length_s: Option<f64>,
    ) -> (f64, [f64; N]) {
        let steps = match self.integrator {
            Integrator::SemiImplicitEuler { steps_per_sample }
            | Integrator::Rk4 { steps_per_sample } => steps_per_sample,
            Integrator::DormandPrince { relative_tolerance, .. } => {
                return self.adaptive(field, state, left_s, relative_tolerance);
            }
        };
        state.steps += 1;
        let h = length_s.unwrap_or_else(|| even_step(steps, self.sample_s, left_s));
        (h, self.integrator.step(field, &state.z, h))
    }

    fn adaptive(
        &self,
        field: &impl Field<N>,
        state: &mut HybridState<N>,
        left_s: f64,
        relative: f64,
    ) -> (f64, [f64; N]) {
        let shortest = SHORTEST * self.sample_s;
        loop {
            state.steps += 1;
            let h = state.step_s.min(left_s);
            let (next, error) = dormand_prince::step(field, &state.z, h);
            let mut worst = 0f64;
            for i in 0..N {
                let size = state.z[i].abs().max(next[i].abs());
                worst = worst.max(error[i].abs() / (self.tolerances[i] + relative * size));
            }
            let wanted = h * dormand_prince::change(worst);
            if worst <= 1.0 || h <= shortest {
                // if the end of a piece has shortened this step, the next step can be longer again
                state.step_s = wanted.max(if h < state.step_s { state.step_s } else { 0.0 });
                state.step_s = state.step_s.clamp(shortest, self.sample_s);
                return (h, next);
            }
            state.step_s = wanted.max(shortest);
        }
    }

    /// Shortens a step to the first instant at which a guard is zero. Returns length, end state and event. Returns
    /// `None` if no guard becomes zero.
    fn first_event(
        &self,
        field: &Smooth<'_, N>,
        state: &mut HybridState<N>,
        (step_s, end): (f64, [f64; N]),
    ) -> Option<(f64, [f64; N], Event)> {
        if self.friction.is_none() && self.travel.is_none() && self.gap.is_none() {
            return None;
        }
        let mut first = None::<(f64, [f64; N], Event)>;
        for (which, (value, event)) in
            self.guards(field.regime, &end, field.force_n, step_s).into_iter().enumerate()
        {
            if value >= 0.0 {
                continue;
            }
            let (h, end) = self.locate(field, state, (step_s, end, value), which);
            if first.is_none_or(|(earliest, ..)| h < earliest) {
                first = Some((h, end, event));
            }
        }
        first
    }

    /// Shortens a step until the given guard is zero. Returns length and end state.
    fn locate(
        &self,
        field: &Smooth<'_, N>,
        state: &mut HybridState<N>,
        (step_s, end, value): (f64, [f64; N], f64),
        which: usize,
    ) -> (f64, [f64; N]) {
        let HybridState { z, steps, .. } = state;
        let value_of =
            |z: &[f64; N], h: f64| self.guards(field.regime, z, field.force_n, h)[which].0;
        let mut guard = |h: f64| {
            *steps += 1;
            let end = self.integrator.step(field, z, h);
            (value_of(&end, h), end)
        };
        let (mut high, mut at_high) = (step_s, (value, end));
        // In a new regime the guard may start at zero. So the search begins with a point inside the step at which the
        // guard is positive.
        let (mut low, mut value_low) = (0.0, value_of(z, 0.0));
        let mut inside = step_s;
        while value_low <= 0.0 && inside > step_s * 1e-6 {
            inside *= 0.5;
            let here = guard(inside);
            if here.0 > 0.0 {
                (low, value_low) = (inside, here.0);
            } else {
                (high, at_high) = (inside, here);
            }
        }
        let mut value_high = at_high.0;
        for iteration in 0..100 {
            if value_low <= 0.0 || high - low <= 4.0 * f64::EPSILON * step_s {
                break;
            }
            let secant = low + (high - low) * value_low / (value_low - value_high);
            let middle = if iteration % 3 == 2 || !(secant > low && secant < high) {
                0.5 * (low + high)
            } else {
                secant
            };
            let here = guard(middle);
            if here.0 < 0.0 {
                (high, at_high, value_high) = (middle, here, here.0);
                value_low *= 0.5; // Illinois method: halves the value at the end that is kept
            } else {
                (low, value_low) = (middle, here.0);
                value_high *= 0.5;
                if here.0 == 0.0 {
                    (high, at_high) = (middle, here);
                    break;
                }
            }
        }
        (high, at_high.1)
    }

    /// Lengths of the steps of a piece. The list is empty if the lengths are not known in advance.
    #[inline]
    fn lengths_s(&self, duration_s: f64) -> impl Iterator<Item = f64> {
        let whole = if duration_s == self.sample_s { &self.even[..] } else { &[] };
        whole.iter().copied()
    }

    /// The same as [`piece`](Self::piece), for a linear plant, which has no regimes.
    #[inline]
    fn linear_piece(&self, state: &mut HybridState<N>, force_n: f64, duration_s: f64) {
        let field = self.linear(force_n, Play::default());
        let mut left_s = duration_s;
        let mut lengths_s = self.lengths_s(duration_s);
        while left_s > NO_TIME * self.sample_s {
            let (step_s, end) = self.trial(&field, state, left_s, lengths_s.next());
            state.z = end;
            left_s -= step_s;
        }
    }

    /// Moves the plant for `duration_s`, while one force acts.
    fn piece(&self, state: &mut HybridState<N>, force_n: f64, duration_s: f64) {
        if state.z[1] == 0.0 {
            self.settle(state, force_n);
        }
        let mut left_s = duration_s;
        let mut events = 0;
        let mut lengths_s = Some(self.lengths_s(duration_s));
        while left_s > NO_TIME * self.sample_s {
            let regime = state.regime;
            let field = Smooth { plant: self, regime, force_n };
            let (step_s, end) =
                self.trial(&field, state, left_s, lengths_s.as_mut().and_then(Iterator::next));
            if events == EVENTS_MAX {
                state.z = end;
                left_s -= step_s;
                self.relax(state, step_s);
                let guards = self.guards(state.regime, &end, force_n, 0.0);
                if let Some((_, event)) = guards.into_iter().find(|(value, _)| *value < 0.0) {
                    state.z[1] = if matches!(event, Event::Reaches(_)) { 0.0 } else { state.z[1] };
                    self.transit(state, event, force_n);
                }
            } else if let Some((step_s, end, event)) =
                self.first_event(&field, state, (step_s, end))
            {
                state.z = end;
                left_s -= step_s;
                events += 1;
                lengths_s = None;
                self.relax(state, step_s);
                self.transit(state, event, force_n);
            } else {
                state.z = end;
                left_s -= step_s;
                self.relax(state, step_s);
            }
        }
    }

    #[inline(never)]
    fn moved(&self, state: &HybridState<N>, pieces: &[(f64, f64)]) -> HybridState<N> {
        let mut state = *state;
        for &(force_n, duration_s) in pieces {
            if self.is_linear() {
                self.linear_piece(&mut state, force_n, duration_s);
            } else {
                self.piece(&mut state, force_n, duration_s);
            }
        }
        state
    }

    /// Cuts a sample in which a command takes effect into pieces. Returns force and duration of each piece.
    ///
    /// Semi-implicit Euler can be unstable with alternating step lengths, even if it is stable with each length alone.
    /// So all steps of this method have the same length. The step that contains the split gets the mean of both forces.
    fn split(&self, before_n: f64, after_n: f64) -> [(f64, f64); 3] {
        let (split_s, late_s) = (self.split_s, self.sample_s - self.split_s);
        let Integrator::SemiImplicitEuler { steps_per_sample } = self.integrator else {
            return [(before_n, split_s), (after_n, late_s), (after_n, 0.0)];
        };
        let h = self.sample_s / f64::from(steps_per_sample);
        let early_s = libm::floor(split_s / h) * h;
        let share = (split_s - early_s) / h;
        if share < 1e-9 {
            return [(before_n, split_s), (after_n, late_s), (after_n, 0.0)];
        }
        let mean_n = before_n * share + after_n * (1.0 - share);
        [(before_n, early_s), (mean_n, h), (after_n, self.sample_s - early_s - h)]
    }
}

/// Length of the next step, if a sample has `steps_per_sample` equal steps. `left_s` is the rest of the piece.
fn even_step(steps_per_sample: u32, sample_s: f64, left_s: f64) -> f64 {
    let steps = left_s * f64::from(steps_per_sample) / sample_s;
    left_s / libm::ceil(steps - 1e-9).max(1.0)
}

/// Lengths of all steps of a sample. The lengths are computed once, because a division takes longer than a step.
fn even_steps(integrator: &Integrator, sample_s: f64) -> Arc<[f64]> {
    let (Integrator::SemiImplicitEuler { steps_per_sample } | Integrator::Rk4 { steps_per_sample }) =
        *integrator
    else {
        return [].into();
    };
    let mut left_s = sample_s;
    let mut lengths_s = vec![];
    while left_s > NO_TIME * sample_s {
        let h = even_step(steps_per_sample, sample_s, left_s);
        lengths_s.push(h);
        left_s -= h;
    }
    lengths_s.into()
}

impl<const N: usize> Plant for IntegratedStep<N> {
    type State = HybridState<N>;

    fn at_rest(&self, position_m: f64) -> Self::State {
        let z = still(&self.rest_m, position_m);
        HybridState { z, regime: Regime::default(), step_s: self.sample_s, steps: 0 }
    }

    fn position_m(&self, state: &Self::State) -> f64 {
        self.absolute_m(&state.z)
    }

    fn speed_m_per_s(&self, state: &Self::State) -> f64 {
        state.z[1]
    }

    fn force_n(&self, state: &Self::State, output_n: f64) -> f64 {
        if N % 2 == 1 { state.z[N - 1] } else { output_n }
    }

    fn advance(&self, state: &Self::State, force_n: f64) -> Self::State {
        self.moved(state, &[(force_n, self.sample_s), (force_n, 0.0)])
    }

    fn advance_split(&self, state: &Self::State, before_n: f64, after_n: f64) -> Self::State {
        self.moved(state, &self.split(before_n, after_n))
    }

    fn later_m(&self, state: &Self::State, delay_s: f64, forces_n: [f64; 2]) -> Option<f64> {
        let early_s = delay_s.min(self.split_s);
        let [before_n, after_n] = forces_n;
        let later = self.moved(state, &[(before_n, early_s), (after_n, delay_s - early_s)]);
        Some(self.position_m(&later))
    }

    fn steps(&self, state: &Self::State) -> u64 {
        state.steps
    }

    fn pack(state: &Self::State) -> AnyState {
        let HybridState { regime, step_s, steps, .. } = *state;
        let mut any = AnyState { regime, step_s, steps, ..AnyState::default() };
        any.z[..N].copy_from_slice(&state.z);
        any
    }

    fn unpack(any: &AnyState) -> Self::State {
        HybridState {
            z: core::array::from_fn(|i| any.z[i]),
            regime: any.regime,
            step_s: any.step_s,
            steps: any.steps,
        }
    }
}

#[cfg(test)]
mod tests;
