//! Tests `identify` on devices with dry friction, a slow amplifier, an offset force and a periodic encoder error. The
//! values must be inside their intervals, and no term may be invented. The records are from the simulator's own plants.
//! The integrator of these plants has no code of the fitted model.

use std::f64::consts::TAU;

use crate::{
    figure::figure,
    identify_accuracy::{
        GAIN_N_PER_V, PULSE_V, Pulses, RATE_HZ, RESOLUTION_M, SECONDS, normal, voltage,
    },
};
use host_sim::{
    analysis::identify::{
        Drive, Estimate, Gain, Identification, Options, Record, Term, Terms, identify,
    },
    numerics::integrator::Integrator,
    plant::{AnyPlant, Plant as _},
    scene::{
        Device, NamedScene, Scene,
        element::{Amplifier, EncoderError, Friction, Offset},
    },
};
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use rayon::prelude::*;

const NOISE_COUNTS: f64 = 0.5;
const LATENCY: usize = 3;

/// A device and its terms that a plain model lacks.
#[derive(Clone, Copy, Debug)]
struct Truth {
    device: Device,
    friction_n: f64,
    lag_samples: f64,
    offset_n: f64,
    error: Option<EncoderError>,
}

impl Truth {
    fn scene(&self) -> Scene {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        scene.device = self.device;
        if self.friction_n > 0.0 {
            scene.friction = Some(Friction {
                coulomb_n: self.friction_n,
                static_n: self.friction_n,
                stribeck_speed_m_per_s: 1e-3,
            });
            scene.integrator = Some(Integrator::DormandPrince {
                relative_tolerance: 1e-10,
                absolute_tolerance_m: 1e-14,
            });
        }
        if self.lag_samples > 0.0 {
            let bandwidth_hz = RATE_HZ / (TAU * self.lag_samples);
            scene.amplifier = Some(Amplifier { bandwidth_hz });
        }
        scene.offset = (self.offset_n != 0.0).then_some(Offset { force_n: self.offset_n });
        scene.encoder_error = self.error;
        scene
    }

    /// The record of two pulses on this device.
    fn record(&self, seed: u64) -> Record {
        self.noisy_record(seed, NOISE_COUNTS)
    }

    fn noisy_record(&self, seed: u64, noise_counts: f64) -> Record {
        let scene = self.scene();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let plant = AnyPlant::unsensed(&scene, 1.0 / RATE_HZ, 0.0);
        let start_m = self.device.start_position_m + random.random::<f64>() * RESOLUTION_M;
        let mut state = plant.at_rest(start_m);
        let rows = (SECONDS * RATE_HZ) as usize;
        let (mut command, mut position_m) = (vec![], vec![]);
        for row in 0..rows {
            let x = plant.position_m(&state);
            let read_m = x + self.error.map_or(0.0, |error| error.error_m(x));
            let counts = read_m / RESOLUTION_M + noise_counts * normal(&mut random);
            position_m.push(counts.floor() * RESOLUTION_M);
            command.push(voltage(Pulses::Two, row));
            let force_n = row
                .checked_sub(LATENCY)
                .map_or(0.0, |row| GAIN_N_PER_V * voltage(Pulses::Two, row));
            state = plant.advance(&state, force_n);
        }
        let (name, start_s, step_s) = ("made".into(), 0.0, 1.0 / RATE_HZ);
        Record {
            name,
            start_s,
            step_s,
            command,
            position_m,
            drive: Drive::default(),
            may_clip: true,
        }
    }

    fn options(&self) -> Options {
        let scene = NamedScene::load("paper-1um").unwrap().scene;
        let spring = self.device.stiffness_n_per_m > 0.0;
        Options {
            latency_s: LATENCY as f64 / RATE_HZ,
            spring,
            // The rest position is given only if an offset must be distinguished from a rest position.
            rest_position_m: spring.then_some(self.device.rest_position_m),
            ..Options::of_scene(&scene, Gain::Given(GAIN_N_PER_V))
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Has {
    friction: bool,
    lag: bool,
    offset: bool,
}

/// Random devices that a hand could hold. One in four has no spring.
fn truths(count: usize, has: Has) -> Vec<Truth> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(2027);
    let mut unit = move || random.random::<f64>();
    let pulse_n = GAIN_N_PER_V * PULSE_V;
    (0..count)
        .map(|index| {
            let mut between = |low: f64, high: f64| low * (high / low).powf(unit());
            let device = Device {
                mass_kg: between(0.05, 2.0),
                damping_n_s_per_m: between(0.5, 20.0),
                stiffness_n_per_m: if index % 4 == 3 { 0.0 } else { between(5.0, 500.0) },
                rest_position_m: between(0.01, 0.1),
                start_position_m: between(0.01, 0.1),
            };
            let share = |has: bool, most: f64, draw: f64| if has { most * draw } else { 0.0 };
            let (friction, lag, offset) = (unit(), unit(), unit());
            Truth {
                device,
                friction_n: share(has.friction, 0.2 * pulse_n, friction),
                lag_samples: share(has.lag, 2.0, lag),
                offset_n: share(has.offset, 0.05 * pulse_n, 2.0 * offset - 1.0),
                error: None,
            }
        })
        .collect()
}

/// Counts for one parameter. They tell how often its interval contains the true value. For a term, they also tell how
/// many models have this term.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    held: usize,
    of: usize,
}

impl Tally {
    fn add(&mut self, held: bool) {
        *self = Self { held: self.held + usize::from(held), of: self.of + 1 };
    }

    fn share(self) -> f64 {
        self.held as f64 / self.of.max(1) as f64
    }
}

const NAMES: [&str; 7] = ["m", "b", "k", "x0", "friction", "lag", "offset"];

/// The estimates beside their true values. A term that the model lacks is 0 with zero width.
fn pairs(found: &Identification, truth: &Truth) -> [Option<(Estimate, f64)>; 7] {
    let device = &truth.device;
    let none = Estimate::given(0.0);
    let spring = found.spring;
    let of = |estimate: Option<Estimate>| estimate.unwrap_or(none);
    [
        Some((found.mass_kg, device.mass_kg)),
        Some((found.damping_n_s_per_m, device.damping_n_s_per_m)),
        spring.map(|spring| (spring.stiffness_n_per_m, device.stiffness_n_per_m)),
        None,
        (truth.friction_n > 0.0).then_some((of(found.terms.friction_n), truth.friction_n)),
        (truth.lag_samples > 0.0).then_some((of(found.terms.lag_s), truth.lag_samples / RATE_HZ)),
        (truth.offset_n != 0.0).then_some((of(found.terms.offset_n), truth.offset_n)),
    ]
}

/// Identifies every device with every seed. Counts how often each interval contains the true value, and how often each
/// term is invented.
fn campaign(name: &str, has: Has, count: usize, seeds: u64) -> (Tally, [Tally; 6]) {
    let cases: Vec<(usize, Truth, u64)> = truths(count, has)
        .into_iter()
        .enumerate()
        .flat_map(|(index, truth)| (0..seeds).map(move |seed| (index, truth, seed)))
        .collect();
    let runs: Vec<(usize, Truth, u64, Result<Identification, String>)> = cases
        .par_iter()
        .map(|&(index, truth, seed)| {
            (index, truth, seed, identify(&[truth.record(seed + 100)], &truth.options()))
        })
        .collect();
    let (mut tallies, mut invented) = ([Tally::default(); 7], [Tally::default(); 6]);
    let mut refused = 0;
    for (index, truth, seed, found) in &runs {
        let found = match found {
            Ok(found) => found,
            Err(error) => {
                refused += 1;
                println!("{name}: device {index} seed {seed} refused: {error}");
                continue;
            }
        };
        for (place, pair) in pairs(found, truth).into_iter().enumerate() {
            let Some((estimate, value)) = pair else { continue };
            let held = estimate.holds(value);
            tallies[place].add(held);
            if !held {
                println!(
                    "{name}: device {index} seed {seed}: {} is {value:.5e}, said {:.5e} +- {:.1e} ({:.1})",
                    NAMES[place],
                    estimate.value,
                    estimate.half_width,
                    (estimate.value - value).abs() / estimate.half_width
                );
            }
        }
        let terms = &found.terms;
        for (term, is_in, is_there) in [
            (Term::Friction, terms.friction_n.is_some(), truth.friction_n > 0.0),
            (Term::Amplifier, terms.lag_s.is_some(), truth.lag_samples > 0.0),
            (Term::Offset, terms.offset_n.is_some(), truth.offset_n != 0.0),
            (Term::Phase, terms.phase.is_some(), truth.error.is_some()),
            (Term::Stribeck, terms.stribeck.is_some(), false),
            (Term::Cogging, terms.cogging.is_some(), false),
        ] {
            if !is_there {
                invented[Term::ALL.iter().position(|one| *one == term).unwrap()].add(is_in);
            }
        }
    }
    let mut pooled = Tally::default();
    for (tally, parameter) in tallies.iter().zip(NAMES) {
        pooled = Tally { held: pooled.held + tally.held, of: pooled.of + tally.of };
        if tally.of > 0 {
            println!("{name}: {parameter:>8} inside {} of {}", tally.held, tally.of);
        }
    }
    for (tally, term) in invented.iter().zip(Term::ALL) {
        if tally.of > 0 {
            println!("{name}: {term:?} invented {} of {}", tally.held, tally.of);
        }
    }
    println!("{name}: pooled {:.1} %, refused {refused}", 100.0 * pooled.share());
    if seeds == 10 {
        let key = format!("host/identify_terms/{name}");
        for (tally, parameter) in tallies.iter().zip(NAMES).filter(|(tally, _)| tally.of > 0) {
            figure(&format!("{key}/{parameter}_held"), tally.held);
            figure(&format!("{key}/{parameter}_of"), tally.of);
        }
        figure(&format!("{key}/pooled"), pooled.share());
        let most = invented.iter().map(|tally| tally.share()).fold(0.0, f64::max);
        figure(&format!("{key}/invented"), most);
    }
    assert!(refused * 50 <= runs.len(), "{name}: {refused} refused");
    (pooled, invented)
}

fn kinds() -> [(&'static str, Has); 5] {
    let has = |friction, lag, offset| Has { friction, lag, offset };
    [
        ("plain", has(false, false, false)),
        ("friction", has(true, false, false)),
        ("lag", has(false, true, false)),
        ("offset", has(false, false, true)),
        ("all", has(true, true, true)),
    ]
}

fn all_of(
    kinds: &[(&'static str, Has)],
    (count, seeds): (usize, u64),
    coverage: f64,
    invented_most: f64,
) {
    for &(name, has) in kinds {
        let (pooled, invented) = campaign(name, has, count, seeds);
        assert!(pooled.share() >= coverage, "{name}: {}", pooled.share());
        for tally in invented {
            assert!(tally.share() <= invented_most, "{name}: invented {}", tally.share());
        }
    }
}

#[test]
fn terms_are_found_inside_their_intervals_and_none_is_invented() {
    let [plain, friction, .., all] = kinds();
    all_of(&[plain, friction, all], (3, 1), 0.8, 0.0);
}

#[test]
#[ignore = "a thousand records take minutes; .ci/long runs it"]
fn terms_of_many_devices_are_found_and_none_is_invented() {
    all_of(&kinds(), (20, 10), 0.9, 0.05);
}

const PAPER: Device = Device {
    mass_kg: 0.4160,
    damping_n_s_per_m: 5.5195,
    stiffness_n_per_m: 11.0626,
    rest_position_m: 0.0517,
    start_position_m: 0.0,
};

fn paper() -> Truth {
    Truth { device: PAPER, friction_n: 0.0, lag_samples: 0.0, offset_n: 0.0, error: None }
}

/// The paper's device with an encoder whose signals are not exact sines. The period of the error is found. Without the
/// term, the residual shows the error.
#[test]
fn an_encoder_error_is_found_with_its_cycle() {
    let error = EncoderError { cycle_m: 4e-3, first_m: 1.5e-6, second_m: 0.6e-6, phase_rad: 0.7 };
    let truth = Truth { error: Some(error), ..paper() };
    let record = truth.record(3);
    let found = identify(std::slice::from_ref(&record), &truth.options()).unwrap();
    let phase = found.terms.phase.unwrap();
    println!("{phase:?}");
    for (estimate, value) in [
        (phase.first_m, error.first_m),
        (phase.second_m, error.second_m),
        (phase.phase_rad, error.phase_rad),
        (phase.cycle_m, error.cycle_m),
        (found.mass_kg, PAPER.mass_kg),
    ] {
        let off = (estimate.value - value).abs();
        assert!(off < 2.0 * estimate.half_width && off < 0.1 * value, "{estimate:?} {value}");
    }
    let known = Options { cycle_m: Some(4e-3), ..truth.options() };
    let known = identify(std::slice::from_ref(&record), &known).unwrap().terms.phase.unwrap();
    assert_eq!(known.cycle_m, Estimate::given(4e-3));
    // Without the term, the message names the cause of the residual.
    let blind = Options { terms: Terms::NONE, ..truth.options() };
    let blind = identify(std::slice::from_ref(&record), &blind).unwrap();
    let warning = blind.warnings.iter().find(|warning| warning.contains("likely missing")).unwrap();
    assert!(warning.contains("periodic error of the encoder"), "{warning}");
}

/// A quiet record whose residual looks like quantisation, but is larger. The message names the cause.
#[test]
fn a_residual_beyond_quantisation_is_said_with_its_cause() {
    let error = EncoderError { cycle_m: 4e-3, first_m: 1.5e-6, second_m: 0.0, phase_rad: 0.7 };
    let alone = "not quantisation and noise alone";
    for (truth, said, cause) in [
        (Truth { error: Some(error), ..paper() }, alone, "periodic error of the encoder"),
        (Truth { lag_samples: 1.5, ..paper() }, alone, "lag of the amplifier"),
    ] {
        let record = truth.noisy_record(3, 0.0);
        let blind = Options { terms: Terms::NONE, ..truth.options() };
        let blind = identify(std::slice::from_ref(&record), &blind).unwrap();
        let warning = blind.warnings.iter().find(|warning| warning.contains("likely missing"));
        let warning = warning.unwrap_or_else(|| panic!("{cause}: {:?}", blind.warnings));
        println!("{warning}");
        assert!(warning.contains(said) && warning.contains(cause), "{warning}");
        let found = identify(&[record], &truth.options()).unwrap();
        assert!(!found.warnings.iter().any(|warning| warning.contains("likely missing")));
    }
    let record = paper().noisy_record(3, 0.0);
    let right = identify(&[record], &paper().options()).unwrap();
    // A warning may name a further term that is too small to be determined.
    let others = right.warnings.iter().filter(|one| !one.contains("cannot tell from noise"));
    assert!(right.residual.is_bound_by_quantisation() && others.count() == 1);
}

#[test]
fn a_term_that_is_asked_for_is_fitted_and_an_offset_needs_a_known_rest() {
    let truth = Truth { offset_n: 0.05, ..paper() };
    let record = truth.record(5);
    let ask = |offset, friction| {
        Terms::these(|term| {
            (term == Term::Offset && offset) || (term == Term::Friction && friction)
        })
    };
    let asked = Options { terms: ask(true, true), ..truth.options() };
    let found = identify(std::slice::from_ref(&record), &asked).unwrap();
    let friction = found.terms.friction_n.unwrap();
    assert!(friction.value.abs() < 2.0 * friction.half_width && friction.value < 1e-3);
    assert!((found.terms.offset_n.unwrap().value - 0.05).abs() < 1e-4);
    assert!(
        found.warnings.iter().any(|warning| warning.contains("friction cannot be told from 0"))
    );
    // An unknown rest position absorbs the offset.
    let unknown = Options { rest_position_m: None, ..truth.options() };
    let found = identify(std::slice::from_ref(&record), &unknown).unwrap();
    let rest = found.spring.unwrap().rest_position_m.value;
    assert!((rest - (0.0517 + 0.05 / 11.0626)).abs() < 1e-5 && found.terms.offset_n.is_none());
    let asked = Options { rest_position_m: None, ..asked };
    let error = identify(&[record], &asked).unwrap_err();
    assert!(error.contains("moves the place where a spring rests"), "{error}");
}

#[test]
fn units_that_cannot_be_are_questioned() {
    let truth = paper();
    let record = truth.record(1);
    let small = Options { gain: Gain::Given(3e-3), ..truth.options() };
    let found = identify(&[record], &small).unwrap();
    let warning = found.warnings.iter().find(|warning| warning.contains("2.1 g")).unwrap();
    assert!(warning.contains("--gain"), "{warning}");
}
