//! The gap of [`Backlash`] for the integrator: how the plant moves without the transmission, and which forces act at a
//! flank.

use super::{Event, Linear, Play};
use crate::scene::element::{Backlash, Chain, End, Mode};

/// A gap between the first body and the second.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Gap<const N: usize> {
    half_m: f64,
    mode: Mode,
    /// Distance between the two bodies when both are in their rest positions, in m.
    rest_m: f64,
    /// The matrix of the chain without its transmission, and the part of its rates that does not depend on the state.
    apart: [[f64; N]; N],
    apart_rate: [f64; N],
    /// The part of the rates that does not depend on the state while the flank `High` is touched.
    flank_rate: [f64; N],
}

impl<const N: usize> Gap<N> {
    /// The gap of a chain. `None` if the chain has no second mass.
    pub(super) fn new(chain: &Chain, backlash: Backlash) -> Option<Self> {
        let mode = chain.mode?;
        let loose = Mode { stiffness_n_per_m: 0.0, damping_n_s_per_m: 0.0, ..mode };
        let (apart, _) = Chain { mode: Some(loose), ..*chain }.system::<N>();
        let (half_m, [first_m, second_m, _]) = (0.5 * backlash.gap_m, chain.rest_m());
        let rest_m = second_m - first_m;
        // a force on the device, and the opposite force on the second mass
        let pair = |force_n: f64| {
            core::array::from_fn(|row| match row {
                1 => force_n / chain.device.mass_kg,
                3 => -force_n / mode.mass_kg,
                _ => 0.0,
            })
        };
        Some(Self {
            half_m,
            mode,
            rest_m,
            apart: core::array::from_fn(|row| core::array::from_fn(|column| apart[(row, column)])),
            apart_rate: pair(-mode.stiffness_n_per_m * rest_m),
            flank_rate: pair(-mode.stiffness_n_per_m * half_m),
        })
    }

    /// The linear plant in this state of the gap. `a` is the matrix of the chain with its transmission.
    #[inline]
    pub(super) fn linear<'a>(
        &'a self,
        a: &'a [[f64; N]; N],
        mut constant: [f64; N],
        play: Play,
    ) -> Linear<'a, N> {
        let (a, rate, sign) = match play {
            Play::Apart { .. } => (&self.apart, &self.apart_rate, 1.0),
            Play::Touching(end) => (a, &self.flank_rate, end.outward()),
        };
        for (constant, rate) in constant.iter_mut().zip(rate) {
            *constant += sign * rate;
        }
        Linear { a, constant }
    }

    /// Stretch of the transmission that is left after a time without force, in m.
    #[inline]
    pub(super) fn relaxed_m(&self, stretch_m: f64, duration_s: f64) -> f64 {
        if stretch_m == 0.0 {
            return 0.0; // without a damper the rate would be infinite
        }
        let Mode { stiffness_n_per_m, damping_n_s_per_m, .. } = self.mode;
        stretch_m * libm::exp(-stiffness_n_per_m / damping_n_s_per_m * duration_s)
    }

    /// The guard of this state of the gap. Returns the guard's value, and the event that occurs when the value becomes
    /// negative.
    #[inline]
    pub(super) fn guard(&self, play: Play, z: &[f64; N], elapsed_s: f64) -> (f64, Event) {
        match play {
            Play::Apart { stretch_m } => {
                let place_m = self.ahead_m(z) - self.relaxed_m(stretch_m, elapsed_s);
                let end = if place_m < 0.0 { End::Low } else { End::High };
                (self.half_m - place_m.abs(), Event::Touches(end))
            }
            Play::Touching(end) => {
                let Mode { stiffness_n_per_m, damping_n_s_per_m, .. } = self.mode;
                let force_n =
                    stiffness_n_per_m * self.stretch_m(end, z) + damping_n_s_per_m * (z[3] - z[1]);
                (force_n * end.outward(), Event::LetsGo)
            }
        }
    }

    /// The state after a flank is released. Without a damper the transmission relaxes at once.
    pub(super) fn let_go(&self, end: End, z: &[f64; N]) -> Play {
        let damped = self.mode.damping_n_s_per_m > 0.0;
        Play::Apart { stretch_m: if damped { self.stretch_m(end, z) } else { 0.0 } }
    }

    /// Position of the second mass minus position of the device, in m.
    #[inline]
    fn ahead_m(&self, z: &[f64; N]) -> f64 {
        z[2] - z[0] + self.rest_m
    }

    /// Stretch of the transmission while this flank is touched, in m.
    #[inline]
    fn stretch_m(&self, end: End, z: &[f64; N]) -> f64 {
        self.ahead_m(z) - self.half_m * end.outward()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::{
        numerics::integrator::Integrator,
        plant::{Plant, integrated::IntegratedStep},
        scene::{
            Device,
            element::{Arm, Nonlinear},
        },
    };

    const DEVICE: Device = Device {
        mass_kg: 0.3,
        damping_n_s_per_m: 0.0,
        stiffness_n_per_m: 0.0,
        rest_position_m: 0.01,
        start_position_m: 0.0,
    };
    const MODE: Mode = Mode { mass_kg: 0.2, stiffness_n_per_m: 4e4, damping_n_s_per_m: 30.0 };
    const ELASTIC: Mode = Mode { damping_n_s_per_m: 0.0, ..MODE };
    const GAP_M: f64 = 2e-4;
    const SAMPLE_S: f64 = 1e-4;
    const RK4: Integrator = Integrator::Rk4 { steps_per_sample: 4 };
    const ADAPTIVE: Integrator =
        Integrator::DormandPrince { relative_tolerance: 1e-10, absolute_tolerance_m: 1e-15 };

    fn plant(chain: &Chain, gap_m: f64, integrator: Integrator) -> IntegratedStep<4> {
        let backlash = (gap_m > 0.0).then_some(Backlash { gap_m });
        let nonlinear = Nonlinear { backlash, ..Nonlinear::default() };
        IntegratedStep::new(chain, &nonlinear, integrator, SAMPLE_S, 0.0)
    }

    fn with(mode: Mode, device: Device) -> Chain {
        Chain { mode: Some(mode), ..Chain::alone(device) }
    }

    /// Two free bodies between elastic flanks have the period `2 (gap / v + pi sqrt(m / k))`, where m is the reduced
    /// mass of both bodies.
    #[test]
    fn free_bodies_rattle_with_the_known_period() {
        let reduced = 1.0 / (1.0 / DEVICE.mass_kg + 1.0 / MODE.mass_kg);
        for speed in [0.02, 0.3] {
            let period_s = 2.0 * (GAP_M / speed + PI * (reduced / MODE.stiffness_n_per_m).sqrt());
            for (method, tolerance) in
                [(Integrator::Rk4 { steps_per_sample: 100 }, 1e-5), (ADAPTIVE, 1e-5)]
            {
                let chain = with(ELASTIC, DEVICE);
                let backlash = Some(Backlash { gap_m: GAP_M });
                let nonlinear = Nonlinear { backlash, ..Nonlinear::default() };
                // a hundred samples are ten periods
                let sample_s = 0.1 * period_s;
                let plant = IntegratedStep::<4>::new(&chain, &nonlinear, method, sample_s, 0.0);
                let mut state = plant.at_rest(0.0);
                state.z[3] = speed;
                let drift_m =
                    10.0 * period_s * speed * MODE.mass_kg / (DEVICE.mass_kg + MODE.mass_kg);
                let from = state.z;
                for _ in 0..100 {
                    state = plant.advance(&state, 0.0);
                }
                let off = |at: usize| (state.z[at] - from[at] - drift_m) / GAP_M;
                assert!(off(0).abs() < tolerance && off(2).abs() < tolerance, "{:?}", state.z);
                assert!(
                    (state.z[3] / speed - 1.0).abs() < tolerance
                        && state.z[1].abs() < tolerance * speed
                );
            }
        }
    }

    /// A slow push that changes its direction moves the second mass by the gap, and by the stretch on both flanks.
    #[test]
    fn a_slow_push_moves_it_by_the_gap() {
        let device = Device { stiffness_n_per_m: 300.0, damping_n_s_per_m: 5.0, ..DEVICE };
        let ahead = |hand_n: f64| {
            let chain = Chain { hand_n, ..with(MODE, device) };
            let plant = plant(&chain, GAP_M, RK4);
            let mut state = plant.at_rest(0.0);
            for _ in 0..60_000 {
                state = plant.advance(&state, 0.0);
            }
            state.z[2] - state.z[0]
        };
        let way_m = ahead(0.5) - ahead(-0.5);
        let expected_m = GAP_M + 2.0 * 0.5 / MODE.stiffness_n_per_m;
        assert!((way_m / expected_m - 1.0).abs() < 1e-6, "{way_m} {expected_m}");
    }

    /// Between the flanks each body moves by itself: the device moves alone, and the second mass moves with the arm.
    #[test]
    fn between_the_flanks_both_move_alone() {
        let device = Device { stiffness_n_per_m: 300.0, damping_n_s_per_m: 5.0, ..DEVICE };
        let arm = Some(Arm {
            mass_kg: 1.1,
            damping_n_s_per_m: 5.0,
            stiffness_n_per_m: 90.0,
            rest_position_m: 0.06,
            grip_damping_n_s_per_m: 15.0,
            grip_stiffness_n_per_m: 900.0,
        });
        let held = Device { mass_kg: MODE.mass_kg, ..DEVICE };
        let chains = [
            Chain { arm, ..with(MODE, device) },
            Chain::alone(device),
            Chain { arm, ..Chain::alone(held) },
        ];
        let wide = Nonlinear { backlash: Some(Backlash { gap_m: 1.0 }), ..Nonlinear::default() };
        let whole = IntegratedStep::<6>::new(&chains[0], &wide, RK4, SAMPLE_S, 0.0);
        let none = Nonlinear::default();
        let first = IntegratedStep::<2>::new(&chains[1], &none, RK4, SAMPLE_S, 0.0);
        let second = IntegratedStep::<4>::new(&chains[2], &none, RK4, SAMPLE_S, 0.0);
        let (mut all, mut one, mut other) =
            (whole.at_rest(0.0), first.at_rest(0.0), second.at_rest(0.0));
        for n in 0..5000 {
            let force_n = if n / 500 % 2 == 0 { 1.0 } else { -1.5 };
            all = whole.advance(&all, force_n);
            one = first.advance(&one, force_n);
            other = second.advance(&other, 0.0);
            let places_m = [whole.position_m(&all), all.z[2] + chains[0].rest_m()[1]];
            let known_m = [first.position_m(&one), second.position_m(&other)];
            let off = [0, 1].map(|at| (places_m[at] - known_m[at]).abs());
            assert!(off[0] < 1e-12 && off[1] < 1e-12, "{n}: {off:?}");
        }
    }

    #[test]
    fn the_smaller_the_gap_the_nearer_to_the_mode_alone() {
        let device = Device { stiffness_n_per_m: 300.0, damping_n_s_per_m: 5.0, ..DEVICE };
        for mode in [MODE, ELASTIC] {
            let way = |gap_m: f64| {
                let plant = plant(&with(mode, device), gap_m, ADAPTIVE);
                let mut state = plant.at_rest(0.0);
                let moved = |n: u32| {
                    state =
                        plant.advance(&state, if (n / 40).is_multiple_of(2) { 2.0 } else { -1.5 });
                    [state.z[0], state.z[2]]
                };
                (0..400).map(moved).collect::<Vec<_>>()
            };
            let alone = way(0.0);
            for gap_m in [1e-5, 1e-7, 1e-9] {
                let with = way(gap_m);
                let apart = |n: usize| [0, 1].map(|at| (with[n][at] - alone[n][at]).abs());
                let worst = (0..400).flat_map(apart).fold(0.0, f64::max);
                assert!(worst < 20.0 * gap_m && worst > 1e-3 * gap_m, "{gap_m}: {worst}");
            }
        }
    }

    /// Solves the equations of the model in steps of a thousandth of a sample. The tooth's position is a state.
    fn by_small_steps(chain: &Chain, forces_n: impl Fn(u32) -> f64, samples: u32) -> Vec<[f64; 2]> {
        let (device, mode) = (chain.device, chain.mode.unwrap());
        let (k, b) = (mode.stiffness_n_per_m, mode.damping_n_s_per_m);
        let (mut x, mut v, mut y, mut w, mut place) = (0.0f64, 0.0f64, 0.0f64, 0.0f64, 0.0f64);
        let h = 1e-3 * SAMPLE_S;
        let mut ways = vec![];
        for n in 0..samples {
            for _ in 0..1000 {
                let free = (w - v) + k / b * (y - x - place);
                let rate = match place {
                    _ if place >= 0.5 * GAP_M => free.min(0.0),
                    _ if place <= -0.5 * GAP_M => free.max(0.0),
                    _ => free,
                };
                let force_n = k * (y - x - place) + b * (w - v - rate);
                let spring_n = device.stiffness_n_per_m * (device.rest_position_m - x)
                    - device.damping_n_s_per_m * v;
                v += h / device.mass_kg * (forces_n(n) + spring_n + force_n);
                w -= h / mode.mass_kg * force_n;
                (x, y, place) = (x + h * v, y + h * w, place + h * rate);
            }
            ways.push([x, y]);
        }
        ways
    }

    #[test]
    fn it_moves_as_its_equations_say() {
        let device = Device { stiffness_n_per_m: 300.0, damping_n_s_per_m: 5.0, ..DEVICE };
        // The transmission relaxes within 13 samples. The time in the gap is about as long. So some stretch is left
        // when a flank is touched again.
        let chain = with(Mode { damping_n_s_per_m: 50.0, ..MODE }, device);
        let forces_n = |n: u32| if (n / 25).is_multiple_of(2) { 3.0 } else { -2.5 };
        let known = by_small_steps(&chain, forces_n, 300);
        for (method, tolerance) in [(RK4, 2e-3), (ADAPTIVE, 2e-3)] {
            let plant = plant(&chain, GAP_M, method);
            let mut state = plant.at_rest(0.0);
            let [mut worst, mut crossed] = [0.0f64; 2];
            for (n, [x, y]) in (0..).zip(&known) {
                state = plant.advance(&state, forces_n(n));
                let at = [state.z[0], state.z[2]].map(|z| z + device.rest_position_m);
                worst = worst.max((at[0] - x).abs()).max((at[1] - y).abs());
                crossed = crossed.max((at[1] - at[0]).abs());
            }
            assert!(worst < tolerance * GAP_M && crossed > 0.5 * GAP_M, "{worst:e} {crossed:e}");
        }
    }

    /// The energy of both bodies, of the device's spring and of the transmission never grows. It includes the energy of
    /// a stretch that still relaxes.
    #[test]
    fn energy_never_grows() {
        let device = Device { stiffness_n_per_m: 300.0, damping_n_s_per_m: 0.0, ..DEVICE };
        for mode in [MODE, ELASTIC, Mode { stiffness_n_per_m: 0.0, ..MODE }] {
            let plant = plant(&with(mode, device), GAP_M, ADAPTIVE);
            let mut state = plant.at_rest(0.02);
            state.z[3] = 0.4;
            let energy_j = |state: &crate::plant::HybridState<4>| {
                let stretch_m = match state.regime.play {
                    Play::Apart { stretch_m } => stretch_m,
                    Play::Touching(end) => plant.gap.as_ref().unwrap().stretch_m(end, &state.z),
                };
                let [x, v, _, w] = state.z;
                0.5 * (device.mass_kg * v * v + mode.mass_kg * w * w)
                    + 0.5 * (device.stiffness_n_per_m * x * x)
                    + 0.5 * mode.stiffness_n_per_m * stretch_m * stretch_m
            };
            let (first, mut touches) = (energy_j(&state), 0);
            let mut last = first;
            for n in 0..20_000 {
                let before = state.regime.play;
                state = plant.advance(&state, 0.0);
                touches += u32::from(before != state.regime.play);
                let now = energy_j(&state);
                assert!(now <= last + 1e-8 * first, "{mode:?} at {n}: {last} to {now}");
                last = now;
            }
            assert!(touches > 20, "{touches}");
            let left = last / first;
            let elastic = mode.damping_n_s_per_m == 0.0;
            assert!(if elastic { left > 1.0 - 1e-5 } else { left < 0.99 }, "{mode:?}: {left}");
        }
    }
}
