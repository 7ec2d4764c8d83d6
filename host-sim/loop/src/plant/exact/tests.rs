//! The exact step with linear elements, compared with 50-digit values in the energy norm.

use nalgebra::{DMatrix, DVector};

use super::*;
use crate::{
    figure::figure,
    scene::element::{Amplifier, Arm, Mode},
};

const STEPS: &str = include_str!("../../../../../tests/golden/augmented_step.csv");
const TRAJECTORIES: &str = include_str!("../../../../../tests/golden/augmented_trajectory.csv");
/// Largest error of a step in the energy norm, relative to max(1, |A| T).
const STEP_ERROR_MAX: f64 = 1e-12;
/// Largest relative error of a trajectory after 6 s.
const TRAJECTORY_ERROR_MAX: f64 = 1e-9;
const START_M: f64 = 0.06;

fn parse(line: &str) -> (Chain, f64, Vec<Vec<f64>>) {
    let cells: Vec<&str> = line.split(',').collect();
    let value = |i: usize| cells[i].parse::<f64>().unwrap();
    let given = |i: usize| !cells[i].is_empty();
    let device = Device {
        mass_kg: value(0),
        damping_n_s_per_m: value(1),
        stiffness_n_per_m: value(2),
        rest_position_m: 0.0517,
        start_position_m: START_M,
    };
    let chain = Chain {
        device,
        mode: given(3).then(|| Mode {
            mass_kg: value(3),
            damping_n_s_per_m: value(4),
            stiffness_n_per_m: value(5),
        }),
        arm: given(6).then(|| Arm {
            mass_kg: value(6),
            damping_n_s_per_m: value(7),
            stiffness_n_per_m: value(8),
            rest_position_m: 0.0517,
            grip_damping_n_s_per_m: value(9),
            grip_stiffness_n_per_m: value(10),
        }),
        amplifier: given(11).then(|| Amplifier { bandwidth_hz: value(11) }),
        hand_n: 0.0,
        offset_n: 0.0,
    };
    let lists =
        cells[13..].iter().map(|cell| cell.split(' ').map(|v| v.parse().unwrap()).collect());
    (chain, value(12), lists.collect())
}

/// The matrix R for which |R z|^2 is twice the energy of z. A position has at least the weight of the speed `position /
/// dt`, so that a chain without springs has a norm. The amplifier's force has the weight of the speed that the force
/// causes within `dt`.
fn energy_root(chain: &Chain, dt: f64) -> DMatrix<f64> {
    let a = chain.matrix();
    let states = a.nrows();
    let masses: Vec<f64> = [
        Some(chain.device.mass_kg),
        chain.mode.map(|mode| mode.mass_kg),
        chain.arm.map(|arm| arm.mass_kg),
    ]
    .into_iter()
    .flatten()
    .collect();
    let mut energy = DMatrix::zeros(states, states);
    for (i, mass) in masses.iter().enumerate() {
        energy[(2 * i + 1, 2 * i + 1)] = *mass;
        energy[(2 * i, 2 * i)] = mass / (dt * dt);
        for j in 0..masses.len() {
            energy[(2 * i, 2 * j)] -= mass * a[(2 * i + 1, 2 * j)];
        }
    }
    if states % 2 == 1 {
        energy[(states - 1, states - 1)] = dt * dt / masses[0];
    }
    energy.cholesky().expect("positive definite").l().transpose()
}

/// Largest error of a step in the energy norm, and the norm of A times T.
fn error<const N: usize>(chain: &Chain, dt: f64, golden: &[Vec<f64>]) -> (f64, f64) {
    let step = ExactStep::<N>::of_chain(chain, dt, 0.0);
    let root = energy_root(chain, dt);
    let back = root.clone().try_inverse().unwrap();
    let phi = DMatrix::from_fn(N, N, |r, c| step.phi[r][c] - golden[0][r * N + c]);
    let gamma = DVector::from_fn(N, |r, _| step.gamma[r] - golden[1][r]);
    let norm = |matrix: DMatrix<f64>| matrix.singular_values().max();
    // the error is relative to the speed that a force of 1 N causes within dt
    let newton = dt / chain.device.mass_kg.sqrt();
    let size = norm(&root * chain.matrix() * &back) * dt;
    (norm(&root * phi * &back).max((root * gamma).norm() / newton), size)
}

#[test]
fn one_step_matches_fifty_digits() {
    let (mut worst, mut worst_of_size, mut chains) = (0f64, 0f64, 0);
    for line in STEPS.lines().skip(1) {
        let (chain, dt, golden) = parse(line);
        let (error, size) = match chain.states() {
            3 => error::<3>(&chain, dt, &golden),
            4 => error::<4>(&chain, dt, &golden),
            5 => error::<5>(&chain, dt, &golden),
            6 => error::<6>(&chain, dt, &golden),
            _ => error::<7>(&chain, dt, &golden),
        };
        println!("{error:.1e}, |A| T {size:.1e}: {line:.90}");
        assert!(error <= STEP_ERROR_MAX * size.max(1.0), "{line}");
        worst = worst.max(error);
        worst_of_size = worst_of_size.max(error / size.max(1.0));
        chains += 1;
    }
    println!("worst {worst:.1e}, of max(1, |A| T) {worst_of_size:.1e}");
    figure("sim_loop/augmented/chains", chains);
    figure("sim_loop/augmented/step", format!("{worst:.1e}"));
    figure("sim_loop/augmented/step_of_size", format!("{worst_of_size:.1e}"));
}

/// Largest error of a state after 6 s, relative to the largest value of this state during the run.
fn trajectory<P: Plant>(plant: &P, golden: &[f64]) -> f64 {
    let mut state = plant.at_rest(START_M);
    let mut largest = vec![0f64; golden.len()];
    for n in 0..60_000_u32 {
        let force_n = (f64::from((7919 * n) % 1001) - 500.0) / 256.0;
        state = plant.advance(&state, force_n);
        for (largest, z) in largest.iter_mut().zip(P::pack(&state).z) {
            *largest = largest.max(z.abs());
        }
    }
    let z = P::pack(&state).z;
    let errors =
        golden.iter().zip(z).zip(largest).map(|((exact, z), most)| (z - exact).abs() / most);
    errors.fold(0.0, f64::max)
}

#[test]
fn six_seconds_match_sixty_digits() {
    let mut worst = 0f64;
    for line in TRAJECTORIES.lines().skip(1) {
        let (chain, dt, golden) = parse(line);
        let golden = &golden[0];
        let error = match chain.states() {
            2 => trajectory(&PlantStep::new(&chain.device, dt, 0.0), golden),
            3 => trajectory(&ExactStep::<3>::of_chain(&chain, dt, 0.0), golden),
            4 => trajectory(&ExactStep::<4>::of_chain(&chain, dt, 0.0), golden),
            5 => trajectory(&ExactStep::<5>::of_chain(&chain, dt, 0.0), golden),
            6 => trajectory(&ExactStep::<6>::of_chain(&chain, dt, 0.0), golden),
            _ => trajectory(&ExactStep::<7>::of_chain(&chain, dt, 0.0), golden),
        };
        println!("{error:.1e}: {line:.90}");
        assert!(error <= TRAJECTORY_ERROR_MAX, "{line}: {error:e}");
        worst = worst.max(error);
    }
    figure("sim_loop/augmented/trajectory", format!("{worst:.1e}"));
}

#[test]
fn a_split_step_is_two_steps() {
    let (chain, dt, _) = parse(STEPS.lines().nth(6).unwrap());
    assert_eq!(chain.states(), 7);
    for fraction in [0.1, 0.3, 0.999] {
        let split = ExactStep::<7>::of_chain(&chain, dt, fraction);
        let early = ExactStep::<7>::of_chain(&chain, fraction * dt, 0.0);
        let late = ExactStep::<7>::of_chain(&chain, (1.0 - fraction) * dt, 0.0);
        let (mut once, mut twice) = (split.at_rest(0.03), early.at_rest(0.03));
        let root = energy_root(&chain, dt);
        for n in 0..1000 {
            let (before, after) = (f64::from(n % 7) - 3.0, f64::from(n % 5) - 2.0);
            once = split.advance_split(&once, before, after);
            twice = late.advance(&early.advance(&twice, before), after);
            let error = DVector::from_fn(7, |i, _| once[i] - twice[i]);
            // the limit allows about a thousand roundings of a state whose norm is about 10
            assert!((&root * error).norm() < 1e-11);
        }
    }
}
