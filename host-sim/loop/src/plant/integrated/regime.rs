//! The regimes of the plant: which equation is valid, when the regime ends, and which regime follows.

use super::{HybridState, IntegratedStep};
use crate::{
    numerics::integrator::Field,
    scene::element::{End, REST_SPEED_M_PER_S, Travel},
};

/// The states of motion, stop and gap. Together they select the equation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Regime {
    pub(super) motion: Motion,
    pub(super) stop: Stop,
    pub(super) play: Play,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Motion {
    /// Free to move. Friction acts against upward motion.
    #[default]
    Up,
    Down,
    /// Stuck, or at rest on a rigid stop.
    Held,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Stop {
    /// The device is inside its travel.
    #[default]
    Clear,
    /// The device is beyond the end, and the stop's spring and damper push the device.
    Pushing(End),
    /// The device is beyond the end, and moves back faster than the stop can follow. So the stop does not push.
    Parting(End),
}

/// State of the gap in the transmission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Play {
    /// No flank is touched. The transmission has left a flank, and its stretch relaxes. `stretch_m` is the stretch that
    /// is left.
    Apart { stretch_m: f64 },
    /// The transmission presses on this flank. On the flank `High`, the second mass is ahead and pulls the device up.
    Touching(End),
}

impl Default for Play {
    fn default() -> Self {
        Self::Apart { stretch_m: 0.0 }
    }
}

/// Event that ends a regime.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    Rest,
    Breakaway,
    Reaches(End),
    Parts(End),
    Leaves(End),
    MeetsAgain(End),
    Touches(End),
    LetsGo,
}

pub(super) const GUARDS: usize = 4;

impl<const N: usize> IntegratedStep<N> {
    /// Sum of all forces on the device, without friction and the forces of rigid stops, in N.
    fn pull_n(&self, state: &HybridState<N>, force_n: f64) -> f64 {
        let smooth = self.linear(force_n, state.regime.play).rate(&state.z)[1] * self.mass_kg;
        smooth + self.position_force_n(&state.z, state.regime.stop)
    }

    /// The rigid stop that the device touches, if there is one.
    fn rigid_stop(&self, z: &[f64; N]) -> Option<End> {
        let travel = self.travel.filter(|travel| matches!(travel, Travel::Rigid { .. }))?;
        let position_m = self.absolute_m(z);
        [End::Low, End::High].into_iter().find(|end| travel.depth_m(*end, position_m) >= 0.0)
    }

    /// Additional force that is needed to move a device at rest up, and to move it down, in N. The force is infinite
    /// towards a rigid stop.
    fn holds_n(&self, state: &HybridState<N>, force_n: f64) -> (f64, f64) {
        let pull_n = self.pull_n(state, force_n);
        let hold_n = self.friction.map_or(0.0, |friction| friction.static_n);
        let (mut up, mut down) = (hold_n - pull_n, hold_n + pull_n);
        match self.rigid_stop(&state.z) {
            Some(End::High) => up = f64::INFINITY,
            Some(End::Low) => down = f64::INFINITY,
            None => {}
        }
        (up, down)
    }

    /// Sets the motion of a device with speed 0.
    pub(super) fn settle(&self, state: &mut HybridState<N>, force_n: f64) {
        if let Some(end) = self.rigid_stop(&state.z) {
            // the rounded time of the event may put the device slightly beyond the end
            self.put_on(&mut state.z, end);
        }
        let can_hold = self.friction.is_some() || self.rigid_stop(&state.z).is_some();
        let (up, down) = self.holds_n(state, force_n);
        state.regime.motion = if up < 0.0 || !can_hold {
            Motion::Up
        } else if down < 0.0 {
            Motion::Down
        } else {
            Motion::Held
        };
    }

    /// The guards of a regime that has lasted `elapsed_s`. A negative guard ends the regime. An unused guard is
    /// infinite. Guards have different units, so two guards are never compared.
    pub(super) fn guards(
        &self,
        regime: Regime,
        z: &[f64; N],
        force_n: f64,
        elapsed_s: f64,
    ) -> [(f64, Event); GUARDS] {
        let mut guards = [(f64::INFINITY, Event::Rest); GUARDS];
        if let Some(gap) = &self.gap {
            guards[3] = gap.guard(regime.play, z, elapsed_s);
        }
        match regime.motion {
            Motion::Held => {
                let state = HybridState { z: *z, regime, step_s: 0.0, steps: 0 };
                let (up, down) = self.holds_n(&state, force_n);
                guards[0] = (up.min(down), Event::Breakaway);
                return guards;
            }
            Motion::Up if self.friction.is_some() => guards[0] = (z[1], Event::Rest),
            Motion::Down if self.friction.is_some() => guards[0] = (-z[1], Event::Rest),
            Motion::Up | Motion::Down => {}
        }
        if let Some(travel) = self.travel {
            let position_m = self.absolute_m(z);
            let inside = |end| (-travel.depth_m(end, position_m), Event::Reaches(end));
            [guards[1], guards[2]] = match regime.stop {
                Stop::Clear => [inside(End::Low), inside(End::High)],
                Stop::Pushing(end) => {
                    [(travel.push_n(end, position_m, z[1]), Event::Parts(end)), guards[2]]
                }
                Stop::Parting(end) => [
                    (travel.depth_m(end, position_m), Event::Leaves(end)),
                    (-travel.push_n(end, position_m, z[1]), Event::MeetsAgain(end)),
                ],
            };
        }
        guards
    }

    pub(super) fn transit(&self, state: &mut HybridState<N>, event: Event, force_n: f64) {
        match event {
            Event::Rest => {
                state.z[1] = 0.0;
                self.settle(state, force_n);
            }
            Event::Breakaway => self.settle(state, force_n),
            Event::Parts(end) => state.regime.stop = Stop::Parting(end),
            Event::MeetsAgain(end) => state.regime.stop = Stop::Pushing(end),
            Event::Touches(end) => state.regime.play = Play::Touching(end),
            Event::LetsGo => {
                if let (Some(gap), Play::Touching(end)) = (&self.gap, state.regime.play) {
                    state.regime.play = gap.let_go(end, &state.z);
                }
            }
            Event::Leaves(end) => {
                self.put_on(&mut state.z, end);
                state.regime.stop = Stop::Clear;
            }
            Event::Reaches(end) => {
                self.put_on(&mut state.z, end);
                match self.travel {
                    Some(Travel::Rigid { restitution, .. }) => {
                        self.bounce(state, end, restitution, force_n);
                    }
                    _ => state.regime.stop = Stop::Pushing(end),
                }
            }
        }
    }

    fn bounce(&self, state: &mut HybridState<N>, end: End, restitution: f64, force_n: f64) {
        let back = -restitution * state.z[1] * end.outward(); // negative: away from the stop
        if back < -REST_SPEED_M_PER_S {
            state.z[1] = back * end.outward();
            state.regime.motion = match end {
                End::High => Motion::Down,
                End::Low => Motion::Up,
            };
        } else {
            state.z[1] = 0.0;
            self.settle(state, force_n);
        }
    }

    /// Lets the transmission relax for `duration_s` if no flank is touched.
    #[inline]
    pub(super) fn relax(&self, state: &mut HybridState<N>, duration_s: f64) {
        if let (Some(gap), Play::Apart { stretch_m }) = (&self.gap, &mut state.regime.play) {
            *stretch_m = gap.relaxed_m(*stretch_m, duration_s);
        }
    }

    fn put_on(&self, z: &mut [f64; N], end: End) {
        if let Some(travel) = self.travel {
            let end_m = travel.end_m(end);
            z[0] = end_m - self.rest_m[0];
            // The difference is rounded, so the device is moved until it is not before the end.
            while travel.depth_m(end, self.absolute_m(z)) < 0.0 {
                z[0] = if end == End::High { z[0].next_up() } else { z[0].next_down() };
            }
        }
    }
}
