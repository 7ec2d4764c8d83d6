//! The response of a device with dry friction and a slow amplifier. The solution is exact between events. An event is
//! an instant at which the handle turns, stops or starts.
//!
//! ```text
//! x'' = a - w x - d x' + o - s f     a' = p (g u - a)     s = sign(x'); without a lag a = g u
//! at rest while |a - w x + o| <= f
//! ```
//! Two terms make the equation nonlinear: cogging, and friction that falls with the speed, `f + rise exp(-(x' /
//! fall)^2)`. With these terms, the motion is computed in short stretches. Over a stretch, position and speed change
//! little compared with the pitch and the Stribeck speed. The acceleration by each term is constant over a stretch,
//! with its value in the middle of the stretch. The error is of second order in the length of the stretch.
//!
//! u is constant between its changes, so a stretch in one direction is one exact step. If the speed changes its sign
//! within a step, bisection and Newton's method on the exact solution find the instant. If a handle at rest breaks
//! away, the closed form of `a` gives the instant. So, between these events, the response is a smooth function of the
//! parameters. Small differences give the derivatives of the response ([`super::fit`]).

use nalgebra::{SMatrix, SVector};

use super::{model::Held, record::Record};
use crate::numerics::exact::discretise;

/// Largest number of events that are found within one step of the voltage. After this number, the rest of the step is
/// computed without events.
const EVENTS_MAX: usize = 8;
/// Largest number of iterations to find the instant of an event.
const SEARCH: usize = 60;

/// Number of possible lengths of a stretch: a step, half a step, a quarter and so on.
const LEVELS: usize = 7;
/// Largest change of the speed over a stretch, as a share of the Stribeck speed. It is also the largest motion over a
/// stretch, as an angle of the cogging in rad.
const STRETCH: f64 = 0.25;
/// Speed above which friction equals Coulomb friction, as a multiple of the Stribeck speed.
const SLOW: f64 = 3.5;
/// Largest share of a step that is a rounding error.
const SAME: f64 = 1e-9;

/// The parameters of one record's motion. Forces are divided by the mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    /// Stiffness per mass, in 1/s^2.
    pub w: f64,
    /// Damping per mass, in 1/s.
    pub d: f64,
    /// Acceleration per volt, in m/s^2/V.
    pub gain: f64,
    /// Constant part of the acceleration, in m/s^2.
    pub offset: f64,
    /// Coulomb friction per mass, in m/s^2.
    pub friction: f64,
    /// Two values: static friction minus `friction`, per mass and in m/s^2, and the speed over which this difference
    /// falls, in m/s.
    pub stribeck: Option<[f64; 2]>,
    /// Cogging per mass: its sine part and cosine part at the reference in m/s^2, and its radians per metre.
    pub cogging: Option<[f64; 3]>,
    /// Time constant of the amplifier in s; 0 for an ideal amplifier.
    pub lag_s: f64,
    /// Position at the first fitted row in m, measured from the reference.
    pub x: f64,
    /// Speed at the first fitted row, in m/s.
    pub v: f64,
    /// Time until the voltage of a row acts, in rows.
    pub latency: f64,
}

/// Position in m, speed in m/s, and the acceleration that the amplifier gives, in m/s^2.
type State = SVector<f64, 3>;

/// An exact step of the motion. It takes `seconds`.
struct Step {
    seconds: f64,
    phi: SMatrix<f64, 3, 3>,
    drive: State,
    constant: State,
}

impl Step {
    fn apply(&self, state: &State, drive: f64, constant: f64) -> State {
        self.phi * state + self.drive * drive + self.constant * constant
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Rest,
    /// The handle slides. The value is the sign of its speed, 1 or -1.
    Slides(f64),
}

impl Motion {
    fn pole(&self) -> f64 {
        if self.lag_s > 0.0 { 1.0 / self.lag_s } else { 0.0 }
    }

    fn step(&self, seconds: f64) -> Step {
        let pole = self.pole();
        #[rustfmt::skip]
        let a = SMatrix::<f64, 3, 3>::new(
            0.0, 1.0, 0.0,
            -self.w, -self.d, 1.0,
            0.0, 0.0, -pole,
        );
        let (phi, drive) = discretise(&a, &State::new(0.0, 0.0, pole), seconds);
        let (_, constant) = discretise(&a, &State::new(0.0, 1.0, 0.0), seconds);
        Step { seconds, phi, drive, constant }
    }

    /// The exact step over `seconds`. If there are nonlinear forces, the list goes on with the steps over a half, a
    /// quarter and so on.
    fn steps(&self, seconds: f64) -> Vec<Step> {
        let is_curved = self.stribeck.is_some() || self.cogging.is_some();
        let levels = if is_curved { LEVELS } else { 1 };
        (0..levels).map(|level| self.step(seconds / f64::from(1 << level))).collect()
    }

    /// Trace and determinant of the step over a time, without input.
    pub(super) fn invariants(&self, seconds: f64) -> [f64; 2] {
        let phi = self.step(seconds).phi;
        [phi[(0, 0)] + phi[(1, 1)], phi[(0, 0)] * phi[(1, 1)] - phi[(0, 1)] * phi[(1, 0)]]
    }

    /// Acceleration that all forces except friction give to a handle at rest.
    fn net(&self, state: &State) -> f64 {
        state[2] - self.w * state[0] + self.offset + self.cogging_at(state[0])
    }

    fn cogging_at(&self, x: f64) -> f64 {
        self.cogging.map_or(0.0, |[sine, cosine, per_m]| {
            let (s, c) = (per_m * x).sin_cos();
            sine * s + cosine * c
        })
    }

    /// Mean acceleration by cogging over the positions at most `half` away from `middle`.
    fn cogging_over(&self, middle: f64, half: f64) -> f64 {
        let angle = self.cogging.map_or(0.0, |[.., per_m]| per_m * half);
        let mean = if angle == 0.0 { 1.0 } else { angle.sin() / angle };
        mean * self.cogging_at(middle)
    }

    /// Friction at a speed minus Coulomb friction, divided by the mass.
    fn beyond(&self, v: f64) -> f64 {
        self.stribeck.map_or(0.0, |[rise, fall]| rise * (-(v / fall).powi(2)).exp())
    }

    /// Largest friction at rest, divided by the mass.
    fn holding(&self) -> f64 {
        self.friction + self.beyond(0.0)
    }

    /// Sum of the accelerations that are taken as constant over a stretch in one direction.
    fn constant(&self, state: &State, sign: f64, seconds: f64) -> f64 {
        let linear = self.offset - sign * self.friction;
        if self.stribeck.is_none() && self.cogging.is_none() {
            return linear;
        }
        let (half, v) = (0.5 * seconds, state[1]);
        let rate = self.net(state) - self.d * v - sign * (self.friction + self.beyond(v));
        let middle_v = v + half * rate;
        let middle_x = state[0] + 0.5 * half * (v + middle_v);
        linear + self.cogging_over(middle_x, half * middle_v) - sign * self.beyond(middle_v)
    }

    /// Halves the step until the nonlinear forces are nearly constant over it. Returns the number of halvings.
    fn halvings(&self, state: &State, sign: f64, seconds: f64) -> usize {
        let rate = (self.net(state) - self.d * state[1] - sign * self.friction).abs();
        let v = state[1].abs();
        let mut parts: f64 = 1.0;
        if let Some([_, fall]) = self.stribeck
            && v - rate * seconds < SLOW * fall
        {
            parts = rate * seconds / (STRETCH * fall);
        }
        if let Some([.., per_m]) = self.cogging {
            parts = parts.max((v + rate * seconds) * seconds * per_m / STRETCH);
        }
        (0..LEVELS - 1).find(|level| f64::from(1 << level) >= parts).unwrap_or(LEVELS - 1)
    }

    /// The mode of a handle with speed 0.
    fn mode_at_rest(&self, state: &State) -> Mode {
        let net = self.net(state);
        if net.abs() <= self.holding() { Mode::Rest } else { Mode::Slides(net.signum()) }
    }

    /// Computes the state and the mode after one step with `volts`. `steps` has the exact steps over the whole time, a
    /// half, a quarter and so on.
    fn advance(&self, steps: &[Step], state: State, mode: Mode, volts: f64) -> (State, Mode) {
        let drive = self.gain * volts;
        let step = &steps[0];
        let mut state = state;
        if self.lag_s <= 0.0 {
            state[2] = drive;
        }
        if self.friction <= 0.0 && self.cogging.is_none() {
            return (step.apply(&state, drive, self.offset), mode);
        }
        let (mut mode, mut left_s, mut events) = (mode, step.seconds, 0);
        while events < EVENTS_MAX {
            match mode {
                Mode::Rest => {
                    events += 1;
                    let Some(after_s) = self.breaks_away(&state, drive, left_s) else {
                        state[2] = drive + (state[2] - drive) * (-self.pole() * left_s).exp();
                        return (state, Mode::Rest);
                    };
                    state[2] = drive + (state[2] - drive) * (-self.pole() * after_s).exp();
                    // At the instant itself the net force is exactly f. So the acceleration at the end of the step
                    // gives the direction.
                    let towards = if self.pole() > 0.0 { drive } else { state[2] };
                    let net = self.net(&state) - state[2] + towards;
                    mode = Mode::Slides(net.signum());
                    left_s -= after_s;
                }
                Mode::Slides(sign) => {
                    let level = self.halvings(&state, sign, step.seconds);
                    let is_whole = (steps[level].seconds - left_s).abs() <= SAME * step.seconds;
                    let own;
                    let part = if is_whole || steps[level].seconds < left_s {
                        &steps[level]
                    } else {
                        own = self.step(left_s);
                        &own
                    };
                    let constant = self.constant(&state, sign, part.seconds);
                    let end = part.apply(&state, drive, constant);
                    if end[1] * sign >= 0.0 {
                        if level == 0 || is_whole {
                            return (end, mode);
                        }
                        state = end;
                        left_s -= part.seconds;
                    } else {
                        events += 1;
                        let (after_s, turned) =
                            self.turn(&state, (drive, constant), sign, part.seconds);
                        state = turned;
                        mode = self.mode_at_rest(&state);
                        left_s -= after_s;
                    }
                }
            }
            if left_s <= SAME * step.seconds {
                return (state, mode);
            }
        }
        let Mode::Slides(sign) = mode else { return (state, mode) };
        let constant = self.constant(&state, sign, left_s);
        (self.step(left_s).apply(&state, drive, constant), mode)
    }

    /// Time until a handle at rest breaks away. `None` if it does not within `left_s`.
    fn breaks_away(&self, state: &State, drive: f64, left_s: f64) -> Option<f64> {
        let (spring, friction) = (self.net(state) - state[2], self.holding());
        if (state[2] + spring).abs() > friction {
            return Some(0.0);
        }
        let pole = self.pole();
        let end = drive + (state[2] - drive) * (-pole * left_s).exp();
        if pole == 0.0 || (end + spring).abs() <= friction {
            return None;
        }
        let limit = friction.copysign(end + spring) - spring;
        let share = (limit - drive) / (state[2] - drive);
        // With a stiff spring, rounding may make the share negative.
        Some((-share.max(0.0).ln() / pole).clamp(0.0, left_s))
    }

    /// The instant at which the speed is 0 again, and the state at this instant. The instant is within `left_s`.
    fn turn(
        &self,
        state: &State,
        (drive, constant): (f64, f64),
        sign: f64,
        left_s: f64,
    ) -> (f64, State) {
        let (mut low, mut high) = (0.0, left_s);
        let rate = |at: &State| at[2] - self.w * at[0] - self.d * at[1] + constant;
        let mut at_s = {
            let slope = rate(state);
            let guess = -state[1] / slope;
            if guess > low && guess < high { guess } else { 0.5 * (low + high) }
        };
        let mut at = *state;
        for _ in 0..SEARCH {
            at = self.step(at_s).apply(state, drive, constant);
            if at[1] * sign > 0.0 {
                low = at_s
            } else {
                high = at_s
            }
            let newton = at_s - at[1] / rate(&at);
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            if (next - at_s).abs() <= 1e-15 * left_s || at[1] == 0.0 {
                break;
            }
            at_s = next;
        }
        at[1] = 0.0;
        (at_s, at)
    }

    /// Whether friction holds the handle at the record's first fitted row.
    pub(super) fn begins_at_rest(&self, record: &Record, first: usize) -> bool {
        let (before, after) = Held::new(record, self.latency).at(first);
        let held = |volts: f64| {
            let state = State::new(self.x, 0.0, self.gain * volts);
            self.mode_at_rest(&state) == Mode::Rest
        };
        held(before) && held(after)
    }
}

/// Positions of the model at each row from row `first` on, in m and measured from the reference.
pub(super) fn positions(record: &Record, first: usize, motion: &Motion) -> Vec<f64> {
    let voltages = Held::new(record, motion.latency);
    let early = motion.steps(voltages.fraction * record.step_s);
    let late = motion.steps((1.0 - voltages.fraction) * record.step_s);
    let start_v = if voltages.fraction > 0.0 { voltages.at(first).0 } else { voltages.at(first).1 };
    let mut state = State::new(motion.x, motion.v, motion.gain * start_v);
    let mut mode =
        if motion.v == 0.0 { motion.mode_at_rest(&state) } else { Mode::Slides(motion.v.signum()) };
    let mut positions_m = Vec::with_capacity(record.len() - first);
    for row in first..record.len() {
        positions_m.push(state[0]);
        let (before, after) = voltages.at(row);
        if voltages.fraction > 0.0 {
            (state, mode) = motion.advance(&early, state, mode, before);
        }
        (state, mode) = motion.advance(&late, state, mode, after);
    }
    positions_m
}
