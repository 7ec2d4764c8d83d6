//! Tests that each method has its order on the linear plant. The reference is the exact step.

use super::*;
use crate::{
    figure::figure,
    numerics::exact::discretise,
    scene::{
        Device, NamedScene,
        element::{Amplifier, Arm, Chain, Mode, Nonlinear, Travel},
    },
};
use nalgebra::{SMatrix, SVector};
use proptest::prelude::*;

struct Linear<const N: usize>(SMatrix<f64, N, N>, SVector<f64, N>);

impl<const N: usize> Field<N> for Linear<N> {
    fn rate(&self, z: &[f64; N]) -> [f64; N] {
        (self.0 * SVector::from(*z) + self.1).into()
    }
}

const EULER: Integrator = Integrator::SemiImplicitEuler { steps_per_sample: 1 };
const RK4: Integrator = Integrator::Rk4 { steps_per_sample: 1 };
const DORMAND_PRINCE: Integrator =
    Integrator::DormandPrince { relative_tolerance: 1e-9, absolute_tolerance_m: 1e-12 };

/// Order of the method: how the error after `time_s` falls with the step length.
fn order<const N: usize>(chain: &Chain, method: Integrator, time_s: f64, steps: u32) -> f64 {
    let (a, b) = chain.system::<N>();
    let field = Linear(a, b * 3.0);
    let start: [f64; N] = core::array::from_fn(|i| [0.02, -0.1, 0.015, 0.2, 0.03, 0.05, 1.0][i]);
    let (phi, gamma) = discretise(&a, &(b * 3.0), time_s);
    let exact = phi * SVector::from(start) + gamma;
    // the error of a speed is multiplied by the run's time, so that it is a length like the other errors
    let error = |steps: u32| {
        let h = time_s / f64::from(steps);
        let mut z = start;
        for _ in 0..steps {
            z = method.step(&field, &z, h);
        }
        (0..2).map(|i| (z[i] - exact[i]).abs() * [1.0, time_s][i]).fold(0.0, f64::max)
    };
    (error(steps) / error(2 * steps)).log2()
}

#[test]
fn each_method_shows_its_order() {
    let plain = NamedScene::load("paper-1um").unwrap().scene.chain();
    let stiffer = |mut chain: Chain| {
        chain.device.stiffness_n_per_m = 4e3;
        chain
    };
    let full = Chain {
        hand_n: 0.0,
        offset_n: 0.0,
        amplifier: Some(Amplifier { bandwidth_hz: 60.0 }),
        mode: Some(Mode { mass_kg: 0.15, damping_n_s_per_m: 4.0, stiffness_n_per_m: 6e3 }),
        arm: Some(Arm {
            mass_kg: 1.2,
            damping_n_s_per_m: 12.0,
            stiffness_n_per_m: 250.0,
            rest_position_m: 0.05,
            grip_damping_n_s_per_m: 25.0,
            grip_stiffness_n_per_m: 1200.0,
        }),
        ..plain
    };
    for (name, method, steps, tolerance) in [
        ("euler", EULER, 20_000, 0.02),
        ("rk4", RK4, 500, 0.1),
        ("dormand_prince", DORMAND_PRINCE, 200, 0.15),
    ] {
        let orders = [
            order::<2>(&stiffer(plain), method, 0.1, steps),
            order::<3>(&Chain { amplifier: full.amplifier, ..stiffer(plain) }, method, 0.1, steps),
            order::<7>(&full, method, 0.1, steps),
        ];
        println!("{method:?}: {orders:?}");
        for order in orders {
            assert!((order - f64::from(method.order())).abs() < tolerance, "{method:?}: {order}");
        }
        let [least, most] = [f64::min, f64::max].map(|of| orders.into_iter().reduce(of).unwrap());
        figure(&format!("sim_loop/order/{name}_least"), format!("{least:.4}"));
        figure(&format!("sim_loop/order/{name}_most"), format!("{most:.4}"));
    }
}

#[test]
fn the_estimated_error_is_that_of_the_fourth_order() {
    let (a, b) = NamedScene::load("paper-1um").unwrap().scene.chain().system::<2>();
    let field = Linear(a * 40.0, b * 3.0);
    let error = |h: f64| dormand_prince::step(&field, &[0.02, 0.3], h).1[1].abs();
    let order = (error(2e-4) / error(1e-4)).log2();
    assert!((order - 5.0).abs() < 0.1, "{order}"); // order of a single step: the order of a run plus one
}

#[test]
fn the_stable_half_disk_lies_inside_the_region_of_rk4() {
    for step in 0..=200 {
        let angle = core::f64::consts::FRAC_PI_2 * (1.0 + f64::from(step) / 200.0);
        let r = RK4_STABLE;
        let a = SMatrix::<f64, 2, 2>::new(0.0, 1.0, -r * r, 2.0 * r * angle.cos());
        let field = Linear(a, SVector::zeros());
        let mut z = [1.0, 0.3];
        for _ in 0..2000 {
            z = RK4.step(&field, &z, 1.0);
        }
        assert!(z[0].abs() + z[1].abs() < 10.0, "{angle}: {z:?}");
    }
}

/// A slow device with a fast amplifier. Only the amplifier's pole limits the step.
fn demand(pole_per_s: f64) -> StepDemand {
    let amplifier = Some(Amplifier { bandwidth_hz: pole_per_s / core::f64::consts::TAU });
    let plain = NamedScene::load("paper-1um").unwrap().scene.chain();
    Chain { amplifier, ..plain }.step_demand(&Nonlinear::default())
}

#[test]
fn refuses_what_would_blow_up() {
    let check = |method: Integrator, fastest| method.check(&demand(fastest), 1e-4);
    assert_eq!(check(RK4, 1e4), Ok(()));
    let message = check(RK4, 1e5).unwrap_err();
    assert!(
        message.contains("is 1, allowed 4 to 10000") && message.contains("1.0e-5 s"),
        "{message}"
    );
    assert!(check(Integrator::Rk4 { steps_per_sample: 4 }, 1e5).is_ok());
    assert_eq!(check(EULER, 1.99e4), Ok(()));
    assert!(check(EULER, 1e5).unwrap_err().contains("is 1, allowed 6 to 10000"));
    assert!(check(EULER, 1e12).unwrap_err().contains("exact"));
    assert!(check(DORMAND_PRINCE, 1e5).is_ok());
    assert!(check(DORMAND_PRINCE, 1e9).unwrap_err().contains("exact"));
    for steps_per_sample in [0, 10_001] {
        assert!(check(Integrator::Rk4 { steps_per_sample }, 1.0).is_err());
    }
}

const SAMPLE_S: f64 = 1e-4;

/// Three bodies and an amplifier. Masses are between 1 g and 100 kg, stiffnesses between 1 N/m and 1e9 N/m, dampings
/// between 1 N s/m and 1e6 N s/m. The pair of numbers is the spring and the damper of the stops.
fn any_chain() -> impl Strategy<Value = (Chain, (f64, f64))> {
    let log = |low: f64, high: f64| (low..high).prop_map(|x| 10f64.powf(x));
    let body = move || (log(-3.0, 2.0), log(0.0, 9.0), log(0.0, 6.0));
    (body(), body(), body(), body(), log(0.0, 5.0)).prop_map(
        |((m, k, b), mode, (arm_m, arm_k, arm_b), (_, grip_k, grip_b), bandwidth_hz)| {
            let device = Device {
                mass_kg: m,
                damping_n_s_per_m: b,
                stiffness_n_per_m: k,
                rest_position_m: 0.0,
                start_position_m: 0.0,
            };
            let arm = Arm {
                mass_kg: arm_m,
                damping_n_s_per_m: arm_b,
                stiffness_n_per_m: arm_k,
                rest_position_m: 0.0,
                grip_damping_n_s_per_m: grip_b,
                grip_stiffness_n_per_m: grip_k,
            };
            let (mass_kg, stiffness_n_per_m, damping_n_s_per_m) = mode;
            let chain = Chain {
                mode: Some(Mode { mass_kg, damping_n_s_per_m, stiffness_n_per_m }),
                arm: Some(arm),
                amplifier: Some(Amplifier { bandwidth_hz }),
                ..Chain::alone(device)
            };
            (chain, (grip_b * 100.0, b))
        },
    )
}

/// Matrices of the chain in three regimes: free, on a stop, and stuck.
fn regimes(chain: &Chain, stop: (f64, f64)) -> [SMatrix<f64, 7, 7>; 3] {
    let (free, _) = chain.system::<7>();
    let mut pushed = *chain;
    pushed.device.stiffness_n_per_m += stop.0;
    pushed.device.damping_n_s_per_m += stop.1;
    let (pushed, _) = pushed.system::<7>();
    let mut stuck = free;
    stuck.row_mut(0).fill(0.0);
    stuck.row_mut(1).fill(0.0);
    [free, pushed, stuck]
}

fn on_springs(stop: (f64, f64)) -> Nonlinear {
    Nonlinear {
        travel: Some(Travel::Spring {
            low_m: -1.0,
            high_m: 1.0,
            stiffness_n_per_m: stop.0,
            damping_n_s_per_m: stop.1,
        }),
        ..Nonlinear::default()
    }
}

/// The spectral radius, from the growth of the matrix's powers 2, 4, .. 2^50. An iteration for eigenvalues might not
/// converge.
fn radius(mut matrix: SMatrix<f64, 7, 7>) -> f64 {
    let (mut log, mut share) = (0.0, 1.0);
    for _ in 0..50 {
        let size = matrix.amax();
        if size == 0.0 {
            return 0.0;
        }
        log += share * size.ln();
        share *= 0.5;
        matrix /= size;
        matrix *= matrix;
    }
    log.exp()
}

proptest! {
    #[test]
    fn no_motion_is_faster_than_the_demand_says((chain, stop) in any_chain()) {
        let bound = chain.step_demand(&on_springs(stop)).fastest_per_s();
        let fastest = regimes(&chain, stop).map(radius).into_iter().fold(0.0, f64::max);
        prop_assert!(fastest <= bound * (1.0 + 1e-9), "{fastest:e} of {bound:e}");
        prop_assert!(fastest >= 0.25 * bound, "{fastest:e} of {bound:e}: the bound is loose");
    }

    #[test]
    fn semi_implicit_euler_is_stable_from_the_least_number_of_steps_on((chain, stop) in any_chain()) {
        let demand = chain.step_demand(&on_springs(stop));
        let least = demand.euler_steps(SAMPLE_S);
        // The matrix of one step. It is built column by column, with one step from each unit state.
        let step = |regime: &SMatrix<f64, 7, 7>, steps: f64| {
            let field = Linear(*regime, SVector::zeros());
            SMatrix::<f64, 7, 7>::from_fn(|row, column| {
                let unit = core::array::from_fn(|i| f64::from(u8::from(i == column)));
                EULER.step(&field, &unit, SAMPLE_S / steps)[row]
            })
        };
        for regime in regimes(&chain, stop) {
            for more in [1.0, 1.001, 1.5, 3.0] {
                let radius = radius(step(&regime, least * more));
                prop_assert!(radius <= 1.0 + 1e-6, "{radius} with {more} times {least} steps");
            }
        }
        if least > 1.0 {
            let radius = regimes(&chain, stop)
                .map(|regime| radius(step(&regime, least - 1.0)))
                .into_iter()
                .fold(0.0, f64::max);
            prop_assert!(radius >= 1.0 - 1e-6, "{radius} with {} steps", least - 1.0);
        }
    }
}
