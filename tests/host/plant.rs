//! Tests the plant alone. Other tests depend on these tests.

use host_sim::{
    plant::{Plant as _, PlantStep},
    scene::Device,
};

const PAPER: Device = Device {
    mass_kg: 0.4160,
    damping_n_s_per_m: 5.5195,
    stiffness_n_per_m: 11.0626,
    rest_position_m: 0.0517,
    start_position_m: 0.0,
};
const SAMPLE_S: f64 = 1e-4;

#[test]
fn a_constant_force_against_the_damper_ends_at_the_terminal_speed() {
    let device = Device { stiffness_n_per_m: 0.0, ..PAPER };
    let step = PlantStep::new(&device, SAMPLE_S, 0.0);
    let mut state = step.at_rest(0.0);
    for _ in 0..50_000 {
        state = step.advance(&state, 2.835);
    }
    let terminal = 2.835 / 5.5195;
    assert!((state[1] / terminal - 1.0).abs() < 1e-12, "{state:?}");
}

#[test]
fn a_constant_force_against_the_spring_ends_at_its_deflection() {
    let step = PlantStep::new(&PAPER, SAMPLE_S, 0.0);
    let mut state = step.at_rest(0.0);
    for _ in 0..200_000 {
        state = step.advance(&state, 0.3);
    }
    assert!((step.position_m(&state) - (0.0517 + 0.3 / 11.0626)).abs() < 1e-12);
}

#[test]
fn a_free_oscillation_decays_as_theory_says() {
    let device = Device { damping_n_s_per_m: 0.2, stiffness_n_per_m: 500.0, ..PAPER };
    let step = PlantStep::new(&device, SAMPLE_S, 0.0);
    let start_m = 0.01;
    let mut state = step.at_rest(device.rest_position_m + start_m);
    let sigma = 0.2 / (2.0 * 0.4160);
    let omega = (500.0f64 / 0.4160 - sigma * sigma).sqrt();
    for n in 1..=60_000 {
        state = step.advance(&state, 0.0);
        let t = f64::from(n) * SAMPLE_S;
        let exact =
            start_m * (-sigma * t).exp() * ((omega * t).cos() + sigma / omega * (omega * t).sin());
        assert!((state[0] - exact).abs() < 1e-12, "t = {t}");
    }
}

#[test]
fn energy_never_grows_unforced() {
    for (mass_kg, damping_n_s_per_m, stiffness_n_per_m) in [
        (0.4160, 5.5195, 11.0626),
        (1e-3, 0.0, 1e9),
        (1e-3, 1e6, 1e9),
        (100.0, 0.0, 1.0),
        (0.4160, 2.0 * (0.4160f64 * 1e4).sqrt(), 1e4),
        (1.0, 1e-9, 1e5),
    ] {
        let device = Device { mass_kg, damping_n_s_per_m, stiffness_n_per_m, ..PAPER };
        let step = PlantStep::new(&device, SAMPLE_S, 0.0);
        let mut state = step.at_rest(0.06);
        let energy = |offset: f64, speed: f64| {
            0.5 * stiffness_n_per_m * offset * offset + 0.5 * mass_kg * speed * speed
        };
        let start = energy(state[0], 0.0);
        let mut last = start;
        for _ in 0..100_000 {
            state = step.advance(&state, 0.0);
            let now = energy(state[0], state[1]);
            // Each step rounds the state once. The sum of these roundings must not make the motion grow.
            assert!(now <= last * (1.0 + 8.0 * f64::EPSILON), "{device:?}");
            assert!(now <= start * (1.0 + 1e-11), "{device:?}");
            last = now;
        }
    }
}

#[test]
fn a_split_step_is_two_steps() {
    /// Largest error of the position after a thousand roundings, in m. The states are some 0.03 m and 0.1 m/s.
    const OFFSET_ERROR_MAX_M: f64 = 1e-14;
    const SPEED_ERROR_MAX_M_PER_S: f64 = 1e-12;
    for fraction in [0.1, 0.3, 0.5, 0.999] {
        let split = PlantStep::new(&PAPER, SAMPLE_S, fraction);
        let early = PlantStep::new(&PAPER, fraction * SAMPLE_S, 0.0);
        let late = PlantStep::new(&PAPER, (1.0 - fraction) * SAMPLE_S, 0.0);
        let mut once = split.at_rest(0.03);
        let mut twice = early.at_rest(0.03);
        for n in 0..1000 {
            let (before, after) = (f64::from(n % 7) - 3.0, f64::from(n % 5) - 2.0);
            once = split.advance_split(&once, before, after);
            twice = late.advance(&early.advance(&twice, before), after);
            assert!((once[0] - twice[0]).abs() < OFFSET_ERROR_MAX_M);
            let difference = once[1] - twice[1];
            assert!(difference.abs() < SPEED_ERROR_MAX_M_PER_S);
        }
    }
}
