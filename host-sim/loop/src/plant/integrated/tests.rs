//! Friction, stops and cogging compared with known solutions.

use super::*;
use crate::{
    figure::figure,
    plant::{AnyPlant, PlantStep},
    scene::{
        Device,
        element::{Amplifier, Arm, Mode},
    },
};

const DEVICE: Device = Device {
    mass_kg: 0.4160,
    damping_n_s_per_m: 0.0,
    stiffness_n_per_m: 0.0,
    rest_position_m: 0.0517,
    start_position_m: 0.0,
};
const COULOMB: Friction = Friction { coulomb_n: 0.3, static_n: 0.3, stribeck_speed_m_per_s: 1e-3 };
const STRIBECK: Friction = Friction { coulomb_n: 0.3, static_n: 0.5, stribeck_speed_m_per_s: 5e-3 };
const SAMPLE_S: f64 = 1e-4;
const EULER: Integrator = Integrator::SemiImplicitEuler { steps_per_sample: 8 };
const RK4: Integrator = Integrator::Rk4 { steps_per_sample: 2 };
const DORMAND_PRINCE: Integrator =
    Integrator::DormandPrince { relative_tolerance: 1e-9, absolute_tolerance_m: 1e-13 };

fn with(friction: Friction) -> Nonlinear {
    Nonlinear { friction: Some(friction), ..Nonlinear::default() }
}

fn plant(device: Device, nonlinear: &Nonlinear, integrator: Integrator) -> IntegratedStep<2> {
    IntegratedStep::new(&Chain::alone(device), nonlinear, integrator, SAMPLE_S, 0.0)
}

fn thrown<const N: usize>(
    plant: &IntegratedStep<N>,
    position_m: f64,
    speed: f64,
) -> HybridState<N> {
    let mut state = plant.at_rest(position_m);
    state.z[1] = speed;
    state.regime.motion = if speed < 0.0 { Motion::Down } else { Motion::Up };
    state
}

#[test]
fn a_thrown_device_stops_in_the_known_distance_and_stays() {
    // The device stops after the distance m v^2 / 2 / coulomb. Semi-implicit Euler moves with the new speed, so its
    // error is of first order.
    for (method, tolerance) in [(EULER, 1e-4), (RK4, 1e-12), (DORMAND_PRINCE, 1e-12)] {
        for speed in [0.2, -0.37, 1e-5] {
            let plant = plant(DEVICE, &with(COULOMB), method);
            let mut state = thrown(&plant, 0.01, speed);
            let known = 0.5 * DEVICE.mass_kg * speed * speed / COULOMB.coulomb_n;
            let stops_s = speed.abs() * DEVICE.mass_kg / COULOMB.coulomb_n;
            let mut time_s = -2.0 * SAMPLE_S;
            while time_s < stops_s {
                state = plant.advance(&state, 0.0);
                time_s += SAMPLE_S;
            }
            let way = (plant.position_m(&state) - 0.01) * speed.signum();
            let floor_m = if method == EULER { speed.abs() * SAMPLE_S / 8.0 } else { 1e-16 };
            assert!(
                (way - known).abs() < tolerance * known + floor_m,
                "{method:?} {speed}: {way} {known}"
            );
            let at = state.z;
            for n in 0..1000 {
                let force_n = 0.2999 * if n % 3 == 0 { 1.0 } else { -1.0 };
                state = plant.advance(&state, force_n);
                assert!(state.z[0].to_bits() == at[0].to_bits() && state.z[1] == 0.0, "{method:?}");
            }
            let pushed = plant.advance(&state, 0.3001);
            assert!(pushed.z[1] > 0.0 && pushed.z[0] > at[0], "{method:?}");
        }
    }
}

#[test]
fn a_spring_pulls_the_device_into_rest_where_friction_says() {
    // x'' = -w^2 x -+ g, so each half oscillation loses 2 fc / k. From 9.5 fc/k on, the turning points are -7.5, 5.5,
    // -3.5 and 1.5 fc/k. Then the device sticks at 0.5 fc/k, on the side of its last turning point.
    let stiffness_n_per_m = 300.0;
    let device = Device { stiffness_n_per_m, ..DEVICE };
    let unit = COULOMB.coulomb_n / stiffness_n_per_m;
    for method in [RK4, DORMAND_PRINCE] {
        let plant = plant(device, &with(COULOMB), method);
        let mut state = plant.at_rest(device.rest_position_m + 9.5 * unit);
        for _ in 0..20_000 {
            state = plant.advance(&state, 0.0);
        }
        assert_eq!(state.z[1], 0.0);
        assert!((state.z[0] - 0.5 * unit).abs() < 1e-9 * unit, "{method:?}: {}", state.z[0] / unit);
    }
}

#[test]
fn stick_slip_breaks_away_at_the_static_force() {
    // The amplifier's force rises as 1 - exp(-p t). So breakaway and the motion after it have known formulas.
    let bandwidth_hz = 1.0;
    let chain = Chain { amplifier: Some(Amplifier { bandwidth_hz }), ..Chain::alone(DEVICE) };
    for method in [RK4, DORMAND_PRINCE] {
        let plant = IntegratedStep::<3>::new(&chain, &with(STRIBECK), method, SAMPLE_S, 0.0);
        let mut state = plant.at_rest(0.0);
        let pole = core::f64::consts::TAU * bandwidth_hz;
        let breaks_s = -(1.0 - STRIBECK.static_n / 2.0f64).ln() / pole;
        let mut n = 0;
        while state.z[1] == 0.0 {
            state = plant.advance(&state, 2.0);
            n += 1;
        }
        let end_s = f64::from(n) * SAMPLE_S;
        assert!((end_s - SAMPLE_S..end_s).contains(&breaks_s), "{method:?}: {breaks_s} {end_s}");
        // for such a short time the net force is rate t, so the speed is rate t^2 / 2 / m
        let rate = pole * (2.0 - STRIBECK.static_n);
        let expected = 0.5 * rate * (end_s - breaks_s).powi(2) / DEVICE.mass_kg;
        assert!(
            (state.z[1] / expected - 1.0).abs() < 1e-3,
            "{method:?}: {} {expected}",
            state.z[1]
        );
    }
}

/// Energy of two or three bodies with their springs, stops and cogging.
fn energy(chain: &Chain, nonlinear: &Nonlinear, z: &[f64], regime: Regime) -> f64 {
    let a = chain.matrix();
    let masses =
        [Some(chain.device.mass_kg), chain.mode.map(|m| m.mass_kg), chain.arm.map(|m| m.mass_kg)];
    let masses: Vec<f64> = masses.into_iter().flatten().collect();
    let mut twice = 0.0;
    for (i, mass) in masses.iter().enumerate() {
        twice += mass * z[2 * i + 1] * z[2 * i + 1];
        for j in 0..masses.len() {
            twice -= mass * a[(2 * i + 1, 2 * j)] * z[2 * i] * z[2 * j];
        }
    }
    let position_m = z[0] + chain.rest_m()[0];
    let cogging = nonlinear.cogging.map_or(0.0, |cogging| cogging.energy_j(position_m));
    let stop = match (nonlinear.travel, regime.stop) {
        (Some(Travel::Spring { stiffness_n_per_m, .. }), Stop::Pushing(end)) => {
            let depth = nonlinear.travel.unwrap().depth_m(end, position_m);
            0.5 * stiffness_n_per_m * depth * depth
        }
        _ => 0.0,
    };
    0.5 * twice + cogging + stop
}

fn energy_falls<const N: usize>(chain: &Chain, nonlinear: &Nonlinear, speed: f64) {
    let plant = IntegratedStep::<N>::new(chain, nonlinear, DORMAND_PRINCE, SAMPLE_S, 0.0);
    let mut state = thrown(&plant, 0.05, speed);
    let start = energy(chain, nonlinear, &state.z, state.regime);
    let floor = energy_floor(nonlinear);
    let mut last = start;
    for n in 0..30_000 {
        state = plant.advance(&state, 0.0);
        let now = energy(chain, nonlinear, &state.z, state.regime);
        // The tolerance is the error per sample that the error control allows.
        assert!(now <= last + 1e-8 * (start - floor), "{nonlinear:?} at {n}: {last} to {now}");
        last = now;
    }
    assert!(last < start);
}

/// The smallest energy that cogging can have, in J.
fn energy_floor(nonlinear: &Nonlinear) -> f64 {
    nonlinear.cogging.map_or(0.0, |c| -c.amplitude_n * c.pitch_m / core::f64::consts::TAU)
}

const SPRING_STOPS: Travel =
    Travel::Spring { low_m: -0.02, high_m: 0.08, stiffness_n_per_m: 2e4, damping_n_s_per_m: 40.0 };
const RIGID_STOPS: Travel = Travel::Rigid { low_m: -0.02, high_m: 0.08, restitution: 0.6 };
const COGGING: Cogging = Cogging { amplitude_n: 0.2, pitch_m: 0.004, phase_rad: 0.7 };
const MODE: Mode = Mode { mass_kg: 0.2, stiffness_n_per_m: 4e4, damping_n_s_per_m: 3.0 };
const ARM: Arm = Arm {
    mass_kg: 1.3,
    damping_n_s_per_m: 9.0,
    stiffness_n_per_m: 300.0,
    rest_position_m: 0.04,
    grip_damping_n_s_per_m: 20.0,
    grip_stiffness_n_per_m: 1500.0,
};

#[test]
fn energy_of_the_free_plant_never_grows() {
    let device = Device { damping_n_s_per_m: 0.5, stiffness_n_per_m: 11.0, ..DEVICE };
    let chain = Chain::alone(device);
    for friction in [None, Some(COULOMB), Some(STRIBECK)] {
        for travel in [None, Some(SPRING_STOPS), Some(RIGID_STOPS)] {
            for cogging in [None, Some(COGGING)] {
                let nonlinear = Nonlinear { friction, cogging, travel, ..Nonlinear::default() };
                energy_falls::<2>(&chain, &nonlinear, 1.0);
                energy_falls::<4>(&Chain { mode: Some(MODE), ..chain }, &nonlinear, -1.0);
                let full = Chain { mode: Some(MODE), arm: Some(ARM), ..chain };
                energy_falls::<6>(&full, &nonlinear, 0.5);
            }
        }
    }
}

#[test]
fn a_spring_stop_is_no_deeper_than_its_energy_bound() {
    let (high_m, stiffness_n_per_m) = (0.08, 2e4);
    let (mut least, mut most) = (f64::INFINITY, 0f64);
    for speed in [0.0, 0.01, 0.3, 2.0] {
        for force_n in [0.0, 2.0, 40.0] {
            for (method, damping_n_s_per_m) in [(RK4, 0.0), (RK4, 40.0), (DORMAND_PRINCE, 0.0)] {
                let low_m = -0.02;
                let stops = Travel::Spring { low_m, high_m, stiffness_n_per_m, damping_n_s_per_m };
                let nonlinear = Nonlinear { travel: Some(stops), ..Nonlinear::default() };
                let plant = plant(DEVICE, &nonlinear, method);
                let mut state = thrown(&plant, high_m, speed);
                let sink = force_n / stiffness_n_per_m;
                let bound = sink
                    + (sink * sink + DEVICE.mass_kg * speed * speed / stiffness_n_per_m).sqrt();
                let mut deepest = 0f64;
                for _ in 0..3000 {
                    state = plant.advance(&state, force_n);
                    deepest = deepest.max(plant.position_m(&state) - high_m);
                }
                assert!(deepest <= bound * (1.0 + 1e-6) + 1e-15, "{speed} {force_n} {method:?}");
                if bound > 0.0 && damping_n_s_per_m == 0.0 {
                    least = least.min(deepest / bound);
                    most = most.max(deepest / bound);
                }
            }
        }
    }
    // The value is not 1 because the deepest point lies between two samples.
    assert!(least > 0.9999, "{least}");
    figure("sim_loop/stop/least", format!("{least:.6}"));
    figure("sim_loop/stop/most", format!("{most:.6}"));
}

#[test]
fn a_rigid_stop_is_not_passed_and_gives_back_its_share() {
    let nonlinear = Nonlinear { travel: Some(RIGID_STOPS), ..Nonlinear::default() };
    for method in [EULER, RK4, DORMAND_PRINCE] {
        let plant = plant(DEVICE, &nonlinear, method);
        let mut state = thrown(&plant, 0.03, 1.0);
        for _ in 0..600 {
            state = plant.advance(&state, 0.0);
            assert!(plant.position_m(&state) <= 0.08f64.next_up());
        }
        assert!((state.z[1] + 0.6).abs() < 1e-12, "{method:?}: {}", state.z[1]);
        // A force presses the device on the stop. Each bounce is lower than the last. The device is at rest after the
        // time v (1 + e) / (1 - e) m / F.
        let mut state = thrown(&plant, 0.08, -0.3);
        let rests_s = 0.3 * 2.0 / (1.0 - 0.6) * DEVICE.mass_kg / 2.0;
        let mut rested = 0;
        for n in 0..5000 {
            state = plant.advance(&state, 2.0);
            assert!(plant.position_m(&state) <= 0.08f64.next_up());
            if state.regime.motion == Motion::Held && rested == 0 {
                rested = n;
            }
        }
        assert_eq!(state.z[1], 0.0);
        assert!(
            (f64::from(rested) * SAMPLE_S - rests_s).abs() < 2e-3,
            "{method:?}: {rested} {rests_s}"
        );
        let away = plant.advance(&state, -0.01);
        assert!(away.z[1] < 0.0, "{method:?}: it must let go");
    }
}

#[test]
fn each_method_keeps_its_order_through_rest_and_stops() {
    // The same run with half the step length. The run includes sticking, breakaway and damped stops.
    let device = Device { damping_n_s_per_m: 0.5, stiffness_n_per_m: 400.0, ..DEVICE };
    let friction = Some(Friction { stribeck_speed_m_per_s: 0.05, ..STRIBECK });
    let nonlinear = Nonlinear { friction, travel: Some(SPRING_STOPS), ..Nonlinear::default() };
    let end = |integrator: Integrator| {
        let chain = Chain::alone(device);
        let plant = IntegratedStep::<2>::new(&chain, &nonlinear, integrator, 1e-3, 0.0);
        let mut state = thrown(&plant, 0.07, 0.9);
        for n in 0..400 {
            state = plant.advance(&state, if n % 100 < 50 { 4.0 } else { -6.0 });
        }
        state.z[0]
    };
    let exact =
        end(Integrator::DormandPrince { relative_tolerance: 1e-13, absolute_tolerance_m: 1e-17 });
    type Make = fn(u32) -> Integrator;
    let methods: [(Make, u32, f64, f64); 2] = [
        (|steps_per_sample| Integrator::SemiImplicitEuler { steps_per_sample }, 100, 1.0, 0.15),
        (|steps_per_sample| Integrator::Rk4 { steps_per_sample }, 4, 4.0, 0.7),
    ];
    for (make, steps, order, tolerance) in methods {
        let errors = [1, 2, 4].map(|factor| (end(make(steps * factor)) - exact).abs());
        let found = (errors[0] / errors[2]).log2() / 2.0;
        println!("order {order}: {errors:?}, {found}");
        assert!((found - order).abs() < tolerance, "{errors:?}");
        figure(&format!("sim_loop/order/run_{order}"), format!("{found:.4}"));
    }
}

#[test]
fn without_non_linear_elements_it_follows_the_exact_step() {
    let device = Device { damping_n_s_per_m: 5.5195, stiffness_n_per_m: 11.0626, ..DEVICE };
    let exact = PlantStep::new(&device, SAMPLE_S, 0.3);
    let chain = Chain::alone(device);
    for (method, tolerance_m) in [(EULER, 1e-5), (RK4, 1e-14), (DORMAND_PRINCE, 1e-9)] {
        let plant = AnyPlant::integrated(&chain, &Nonlinear::default(), method, SAMPLE_S, 0.3);
        let (mut here, mut there) = (plant.at_rest(0.0), exact.at_rest(0.0));
        for n in 0..20_000_u32 {
            let force = |n: u32| f64::from(n * 7919 % 101) / 25.0 - 2.0;
            here = plant.advance_split(&here, force(n), force(n + 1));
            there = exact.advance_split(&there, force(n), force(n + 1));
            let error = plant.position_m(&here) - exact.position_m(&there);
            assert!(error.abs() < tolerance_m, "{method:?} at {n}: {error:e}");
        }
    }
}
