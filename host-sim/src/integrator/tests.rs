//! Each method shows its order on the linear plant, against the exact step.

use super::*;
use crate::{
    element::{Amplifier, Arm, Chain, Mode},
    exact::discretise,
    scene::NamedScene,
};
use nalgebra::{SMatrix, SVector};

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

/// Exponent of the step length in the error after `time_s`.
fn order<const N: usize>(chain: &Chain, method: Integrator, time_s: f64, steps: u32) -> f64 {
    let (a, b) = chain.system::<N>();
    let field = Linear(a, b * 3.0);
    let start: [f64; N] = core::array::from_fn(|i| [0.02, -0.1, 0.015, 0.2, 0.03, 0.05, 1.0][i]);
    let (phi, gamma) = discretise(&a, &(b * 3.0), time_s);
    let exact = phi * SVector::from(start) + gamma;
    // Speeds over time count as positions.
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
    let plain = Chain::of(&NamedScene::load("paper-1um").unwrap().scene);
    let stiffer = |mut chain: Chain| {
        chain.device.stiffness_n_per_m = 4e3;
        chain
    };
    let full = Chain {
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
    for (method, steps, tolerance) in
        [(EULER, 20_000, 0.02), (RK4, 500, 0.1), (DORMAND_PRINCE, 200, 0.15)]
    {
        let orders = [
            order::<2>(&stiffer(plain), method, 0.1, steps),
            order::<3>(&Chain { amplifier: full.amplifier, ..stiffer(plain) }, method, 0.1, steps),
            order::<7>(&full, method, 0.1, steps),
        ];
        println!("{method:?}: {orders:?}");
        for order in orders {
            assert!((order - f64::from(method.order())).abs() < tolerance, "{method:?}: {order}");
        }
    }
}

#[test]
fn the_estimated_error_is_that_of_the_fourth_order() {
    let (a, b) = Chain::of(&NamedScene::load("paper-1um").unwrap().scene).system::<2>();
    let field = Linear(a * 40.0, b * 3.0);
    let error = |h: f64| dormand_prince::step(&field, &[0.02, 0.3], h).1[1].abs();
    let order = (error(2e-4) / error(1e-4)).log2();
    assert!((order - 5.0).abs() < 0.1, "{order}"); // of one step: one more than of a run
}

#[test]
fn the_stable_half_disks_lie_inside_the_methods_regions() {
    // Eigenvalues r exp(j angle) in the left half plane as x'' = -r^2 x + 2 r cos(angle) x', and single ones.
    for (method, limit) in [(EULER, EULER_STABLE), (RK4, RK4_STABLE)] {
        for step in 0..=200 {
            let angle = core::f64::consts::FRAC_PI_2 * (1.0 + f64::from(step) / 200.0);
            let r = limit;
            let a = SMatrix::<f64, 2, 2>::new(0.0, 1.0, -r * r, 2.0 * r * angle.cos());
            let field = Linear(a, SVector::zeros());
            let mut z = [1.0, 0.3];
            for _ in 0..2000 {
                z = method.step(&field, &z, 1.0);
            }
            assert!(z[0].abs() + z[1].abs() < 10.0, "{method:?} at {angle}: {z:?}");
        }
    }
}

#[test]
fn refuses_what_would_blow_up() {
    let check = |method: Integrator, fastest| method.check(fastest, 1e-4);
    assert_eq!(check(RK4, 1e4), Ok(()));
    let message = check(RK4, 1e5).unwrap_err();
    assert!(
        message.contains("is 1, allowed 4 to 10000") && message.contains("1.0e-5 s"),
        "{message}"
    );
    assert!(check(Integrator::Rk4 { steps_per_sample: 4 }, 1e5).is_ok());
    assert!(check(EULER, 1e12).unwrap_err().contains("exact"));
    assert!(check(DORMAND_PRINCE, 1e5).is_ok());
    assert!(check(DORMAND_PRINCE, 1e9).unwrap_err().contains("exact"));
    for steps_per_sample in [0, 10_001] {
        assert!(check(Integrator::Rk4 { steps_per_sample }, 1.0).is_err());
    }
}
