//! Properties of devices with random elements.

use super::*;

fn any_tables() -> impl Strategy<Value = Vec<String>> {
    let log = |low: f64, high: f64| (low.log10()..high.log10()).prop_map(|x| 10f64.powf(x));
    let linear = (
        prop::option::of(log(1.0, 1e7)),
        prop::option::of((log(1e-3, 1e2), log(1e-3, 1e9), log(1e-3, 1e6))),
        prop::option::of((
            log(1e-3, 1e2),
            log(1e-3, 1e6),
            log(1e-3, 1e9),
            log(1e-3, 1e6),
            log(1e-3, 1e9),
        )),
    );
    let dry = (
        prop::option::of((log(1e-3, 10.0), 1.0..2.0, log(1e-4, 1.0))),
        prop::option::of((log(1e-3, 10.0), log(1e-3, 0.1))),
        prop::option::of((log(1.0, 1e7), log(1e-2, 1e4))),
        prop::option::of(0.0..0.99),
        0..3u8,
    );
    let sensing = (prop::option::of(log(1e-9, 1e-3)), prop::option::of(0.0..1e-4), any::<u32>());
    (linear, dry, sensing).prop_map(|((amplifier, mode, arm), dry, (noise, jitter, seed))| {
        let mut tables = vec![];
        tables.extend(amplifier.map(|hz| format!("[amplifier]\nbandwidth_hz = {hz:e}\n")));
        tables.extend(mode.map(|(m, k, b)| {
            format!("[mode]\nmass_kg = {m:e}\nstiffness_n_per_m = {k:e}\ndamping_n_s_per_m = {b:e}\n")
        }));
        tables.extend(arm.map(|(m, b, k, gb, gk)| {
            format!(
                "[arm]\nmass_kg = {m:e}\ndamping_n_s_per_m = {b:e}\nstiffness_n_per_m = {k:e}\nrest_position_m = 0.05\n\
                 grip_damping_n_s_per_m = {gb:e}\ngrip_stiffness_n_per_m = {gk:e}\n"
            )
        }));
        let (friction, cogging, spring, rigid, method) = dry;
        // The gap follows from the seed, without a further random number. So the other elements have the same values as
        // without a gap.
        let gap = (mode.is_some() && seed.is_multiple_of(2)).then(|| 0.1f64.powf(2.0 + f64::from(seed / 2 % 7)));
        let cubic = seed.is_multiple_of(3).then(|| f64::from(seed % 61) / 100.0 - 0.3);
        tables.extend(gap.map(|gap| format!("[backlash]\ngap_m = {gap:e}\n")));
        tables.extend(cubic.map(|cubic| format!("[amplifier_error]\ncubic = {cubic:e}\n")));
        tables.extend(friction.map(|(coulomb, ratio, speed)| {
            format!(
                "[friction]\ncoulomb_n = {coulomb:e}\nstatic_n = {:e}\nstribeck_speed_m_per_s = {speed:e}\n",
                coulomb * ratio
            )
        }));
        tables.extend(cogging.map(|(amplitude, pitch)| {
            format!("[cogging]\namplitude_n = {amplitude:e}\npitch_m = {pitch:e}\nphase_rad = 1\n")
        }));
        let ends = "low_m = -0.02\nhigh_m = 0.072\n";
        match (spring, rigid) {
            (Some((k, b)), _) => tables.push(format!(
                "[travel]\nstop = \"spring\"\n{ends}stiffness_n_per_m = {k:e}\ndamping_n_s_per_m = {b:e}\n"
            )),
            (None, Some(e)) => {
                tables.push(format!("[travel]\nstop = \"rigid\"\n{ends}restitution = {e}\n"));
            }
            (None, None) => {}
        }
        let dry = friction.is_some() || cogging.is_some() || spring.is_some() || rigid.is_some();
        if dry || gap.is_some() {
            tables.push([RK4, EULER, ADAPTIVE][method as usize].to_owned());
        }
        tables.extend(noise.map(|rms| format!("[encoder_noise]\nrms_m = {rms:e}\nseed = {seed}\n")));
        tables.extend(jitter.map(|peak| format!("[jitter]\npeak_s = {peak:e}\nseed = {seed}\n")));
        tables
    })
}

#[test]
fn random_elements_never_panic_and_stay_finite() {
    stay_finite(20);
}

#[test]
#[ignore = "the whole campaign; CI runs it"]
fn random_elements_never_panic_and_stay_finite_at_length() {
    stay_finite(150);
}

fn stay_finite(cases: u32) {
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let strategy = (any_tables(), 0.0..2e5f64, 0.0..1e3f64);
    let (ran_cell, integrated_cell) = (std::cell::Cell::new(0), std::cell::Cell::new(0));
    TestRunner::new(config)
        .run(&strategy, |(tables, stiffness, damping)| {
            let tables: Vec<&str> = tables.iter().map(String::as_str).collect();
            let mut scene = match read(&tables) {
                Ok(scene) => scene,
                // A device is refused only if no integrator can follow it.
                Err(message) => {
                    prop_assert!(message.contains("time constant"), "{message}");
                    return Ok(());
                }
            };
            scene.wall_hit.settle_s = 0.3;
            scene.wall_hit.window_s = 0.1;
            let rigid =
                matches!(scene.travel, Some(host_sim::scene::element::Travel::Rigid { .. }));
            let (mut finite, mut inside) = (true, true);
            let result = PreparedScene::new(&scene).unwrap().hit(
                Numeric::F64,
                &hit(stiffness, damping),
                |s| {
                    finite &= s.position_m.is_finite() && s.output_n.is_finite();
                    inside &= !rigid || (-0.02 - 1e-15..=0.072 + 1e-15).contains(&s.position_m);
                },
            );
            prop_assert!(finite && inside);
            if let Err(error) = result {
                prop_assert!(matches!(error, HitError::OutOfRange(_)), "{error}");
            }
            ran_cell.set(ran_cell.get() + 1);
            integrated_cell.set(integrated_cell.get() + u32::from(scene.integrator.is_some()));
            Ok(())
        })
        .unwrap();
    let (ran, integrated): (u32, u32) = (ran_cell.get(), integrated_cell.get());
    println!("{ran} ran, {integrated} of them integrated");
    assert!(ran > cases / 3 && integrated > cases / 5, "{ran} {integrated}");
}

/// A random device is released at rest and left alone. No part may ever have more energy than the whole device had at
/// first. The test checks this by the handle's distance from its spring's rest position.
#[test]
fn a_handle_that_is_let_go_gets_no_energy_from_nowhere() {
    gets_no_energy(20);
}

#[test]
#[ignore = "the whole campaign; CI runs it"]
fn a_handle_that_is_let_go_gets_no_energy_from_nowhere_at_length() {
    gets_no_energy(150);
}

fn gets_no_energy(cases: u32) {
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let (ran_cell, worst_cell) = (std::cell::Cell::new(0), std::cell::Cell::new(0.0));
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
        .run(&(any_tables(), -0.015..0.07f64), |(tables, start_m)| {
            let tables: Vec<&str> = tables.iter().map(String::as_str).collect();
            let Ok(scene) = read(&tables) else { return Ok(()) };
            let device = &scene.device;
            let spring_j =
                |x: f64| 0.5 * device.stiffness_n_per_m * (x - device.rest_position_m).powi(2);
            let arm_j = scene.arm.map_or(0.0, |arm| {
                0.5 * arm.stiffness_n_per_m * (start_m - arm.rest_position_m).powi(2)
            });
            // The energy from the highest to the lowest potential of the cogging.
            let cogging_j = scene.cogging.map_or(0.0, |c| c.amplitude_n * c.pitch_m / PI);
            let all_j = spring_j(start_m) + arm_j + cogging_j;
            let plant = AnyPlant::unsensed(&scene, 1e-4, 0.0);
            let mut state = plant.at_rest(start_m);
            let mut worst = 0.0f64;
            for _ in 0..10_000 {
                state = plant.advance(&state, 0.0);
                worst = worst.max(spring_j(plant.position_m(&state)));
            }
            prop_assert!(
                worst <= all_j * (1.0 + GAIN_MAX) + 1e-12,
                "{worst} of {all_j}: {tables:?}"
            );
            ran_cell.set(ran_cell.get() + 1);
            worst_cell.set(f64::max(worst_cell.get(), worst / all_j - 1.0));
            Ok(())
        })
        .unwrap();
    println!("{} devices, at most {:e} more than at first", ran_cell.get(), worst_cell.get());
    assert!(ran_cell.get() > cases * 4 / 15);
}

/// Largest fraction by which an integrator may increase the energy, with the steps that random devices have.
const GAIN_MAX: f64 = 1e-3;

/// The integrator with the smallest number of steps that this scene allows. `of` makes an integrator from the number.
fn fewest(scene: &Scene, of: fn(u32) -> Integrator) -> Option<Integrator> {
    let demand = scene.chain().step_demand(&scene.nonlinear());
    let allowed = |steps: u32| of(steps).check(&demand, 1e-4).is_ok();
    let (mut too_few, mut enough) = (0, STEPS_MAX);
    if !allowed(enough) {
        return None;
    }
    while enough - too_few > 1 {
        let middle = (too_few + enough) / 2;
        if allowed(middle) { enough = middle } else { too_few = middle }
    }
    Some(of(enough))
}

/// The scenes have the smallest allowed number of steps. A command of 0 N takes effect within every tenth sample.
#[test]
fn no_device_blows_up_with_the_fewest_steps_that_are_allowed() {
    fewest_steps(100);
}

#[test]
#[ignore = "the whole campaign; CI runs it"]
fn no_device_blows_up_with_the_fewest_steps_that_are_allowed_at_length() {
    fewest_steps(300);
}

fn fewest_steps(cases: u32) {
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let (ran_cell, worst_cell) = (std::cell::Cell::new(0), std::cell::Cell::new(0.0));
    let methods: [fn(u32) -> Integrator; 2] = [
        |steps_per_sample| Integrator::SemiImplicitEuler { steps_per_sample },
        |steps_per_sample| Integrator::Rk4 { steps_per_sample },
    ];
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
        .run(
            &(any_tables(), -0.015..0.07f64, 0..2usize, 0.0..1.0f64),
            |(tables, start_m, method, fraction)| {
                let mut tables: Vec<&str> = tables.iter().map(String::as_str).collect();
                tables.retain(|table| !table.contains("[integrator]"));
                tables.push("[integrator]\nmethod = \"rk4\"\nsteps_per_sample = 10000\n");
                let Ok(mut scene) = read(&tables) else { return Ok(()) };
                scene.device.damping_n_s_per_m = 0.0;
                scene.integrator = fewest(&scene, methods[method]);
                let Some(
                    Integrator::SemiImplicitEuler { steps_per_sample }
                    | Integrator::Rk4 { steps_per_sample },
                ) = scene.integrator
                else {
                    return Ok(());
                };
                let plant = AnyPlant::unsensed(&scene, 1e-4, fraction);
                let mut state = plant.at_rest(start_m);
                let mut farthest_m = 0.0f64;
                // The same computing work for any number of steps.
                for n in 0..(200_000 / steps_per_sample).clamp(100, 20_000) {
                    state = if n % 10 == 0 {
                        plant.advance_split(&state, 0.0, 0.0)
                    } else {
                        plant.advance(&state, 0.0)
                    };
                    farthest_m = farthest_m.max(plant.position_m(&state).abs());
                    prop_assert!(
                        farthest_m < 1.0,
                        "{farthest_m} m after {n}: {:?} {fraction} {tables:?}",
                        scene.integrator
                    );
                }
                ran_cell.set(ran_cell.get() + 1);
                worst_cell.set(f64::max(worst_cell.get(), farthest_m));
                Ok(())
            },
        )
        .unwrap();
    println!("{} devices, at most {} m from 0", ran_cell.get(), worst_cell.get());
    assert!(ran_cell.get() > cases / 2);
}
