//! Possible changes of a device, and the cost of each change. Each change concerns one element.

use zwidth::velocity::EstimatorName;

use crate::{
    analysis::compare::{Cost, cost},
    numerics::integrator::Integrator,
    scene::{
        Accelerometer, Quantisation, Scene, Units,
        element::{Amplifier, AmplifierError, Backlash, Cogging, Friction},
    },
};

/// Kind of effort that a change needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Another part must be bought.
    Part,
    /// The firmware or one of its settings must be changed.
    Firmware,
    /// Nothing must be bought. The change adds an element that the scene leaves out but the device may have.
    LeftOut,
    /// There is no change. This is the scene itself.
    Nothing,
}

impl Kind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Part => "part",
            Self::Firmware => "firmware",
            Self::LeftOut => "left-out",
            Self::Nothing => "",
        }
    }
}

#[derive(Clone, Debug)]
pub struct Change {
    /// Name in files.
    pub name: &'static str,
    /// Description in a report. Its values are in the units of the scene.
    pub text: String,
    pub kind: Kind,
    pub cost: String,
    /// Processor cycles that the change adds per second, on a Cortex-M4. `None` if they were not measured.
    pub cycles_per_s: Option<f64>,
    pub scene: Scene,
    /// Estimators to choose from. The best of them is used. If the list is empty, the scene's own estimator is used.
    pub estimators: Vec<EstimatorName>,
}

impl Change {
    /// No change: the scene as it is.
    pub fn none(scene: &Scene) -> Self {
        Self {
            name: "none",
            text: "the scene as it is".into(),
            kind: Kind::Nothing,
            cost: String::new(),
            cycles_per_s: Some(0.0),
            scene: scene.clone(),
            estimators: vec![],
        }
    }
}

/// Name of the figure with the worst-case cycles of `render`, measured on the faster board.
const RENDER: &str = "elf/control/nucleo-f446re/render_most";
/// Clock of the faster board, in Hz.
pub const CLOCK_HZ: f64 = 180e6;
/// Amplifier bandwidth that is added to a scene without an amplifier, in Hz.
const AMPLIFIER_HZ: f64 = 1000.0;
/// Amplifier error that is added to a scene without one: the cubic error of the force at full command, as a fraction.
const CUBIC: f64 = -0.03;
/// Gap of the backlash that is added to a scene with a second mass, in m.
const GAP_M: f64 = 1e-4;
/// Friction or cogging that is added to a scene without it, as a share of full force.
const DRY_SHARE: f64 = 0.01;
/// Bits of the DAC that is added to a scene without `[output]`.
const DAC_BITS: u32 = 12;
/// Travel from cog to cog of the cogging that is added to a scene without `[cogging]`, in m.
const PITCH_M: f64 = 0.005;
/// A typical MEMS accelerometer.
const ACCELEROMETER: Accelerometer = Accelerometer {
    full_scale_m_per_s2: 40.0,
    resolution_m_per_s2: 0.01,
    noise_m_per_s2_per_sqrt_hz: 0.001,
    bias_m_per_s2: 0.0,
    bandwidth_hz: Some(1000.0),
};

/// Worst-case cycles of one output on the faster board; `None` if they were not measured.
fn render_cycles() -> Option<f64> {
    let table = include_str!("../../../../../docs/data/measured.csv");
    let row = table.lines().find(|line| line.split(',').next() == Some(RENDER))?;
    row.split(',').nth(1)?.parse().ok()
}

/// Cycles per second that an estimator needs in addition to those of the scene's own estimator.
fn estimator_cycles(scene: &Scene, name: EstimatorName) -> Option<f64> {
    let cycles = |cost: Option<Cost>| cost.map(|cost| cost.cycles);
    let own = cycles(cost::of(scene.velocity.estimator()))?;
    Some((cycles(cost::of(name))? - own) * scene.control.rate_hz)
}

/// Cost of an estimator as a text, and the cycles per second that it needs in addition to the scene's own estimator.
pub fn cost_of_estimator(scene: &Scene, name: EstimatorName) -> (String, Option<f64>) {
    let cycles_per_s = estimator_cycles(scene, name);
    let text = match cost::of(name) {
        Some(Cost { cycles, ram_bytes }) => {
            format!("{cycles} cycles a sample, {ram_bytes} bytes; no part")
        }
        None => "not measured; no part".into(),
    };
    (text, cycles_per_s)
}

/// Number of counts per mm or per turn of the handle as a text. The encoder has this resolution.
fn counts(units: Units, resolution_m: f64) -> String {
    match units {
        Units::Linear => format!("{:.0} counts per mm of handle", 1e-3 / resolution_m),
        Units::Rotary { radius_m } => {
            let turn = std::f64::consts::TAU * radius_m;
            format!("{:.0} counts per turn of the handle", turn / resolution_m)
        }
    }
}

/// Adds an integrator to a scene if a new element needs an integrator.
fn integrated(mut scene: Scene) -> Scene {
    scene.integrator = scene.integrator.or(Some(Integrator::Rk4 { steps_per_sample: 1 }));
    scene
}

/// All changes for which the core accepts the changed scene. They are in the order in which the loop passes the
/// elements: encoder, velocity, time, output, amplifier, motor, mechanics.
pub fn changes(scene: &Scene, estimators: &[EstimatorName]) -> Vec<Change> {
    let mut all = vec![];
    let mut add = |name, kind, text: String, cost: String, edit: &dyn Fn(&mut Scene)| {
        let mut changed = scene.clone();
        edit(&mut changed);
        if changed != *scene && changed.check().is_ok() {
            all.push(Change { name, text, kind, cost, ..Change::none(&changed) });
        }
    };
    let (part, firmware) = (Kind::Part, Kind::Firmware);
    let units = scene.units;
    for (name, times) in [("encoder-2", 2.0), ("encoder-4", 4.0)] {
        let resolution_m = scene.encoder.resolution_m / times;
        add(
            name,
            part,
            format!("encoder {times} times as fine, {}", units.said(1e6 * resolution_m, "um")),
            format!("an encoder of {}, and a counter for them", counts(units, resolution_m)),
            &|scene| scene.encoder.resolution_m = resolution_m,
        );
    }
    let latency = 0.5 * scene.actuator.latency;
    add(
        "latency-half",
        firmware,
        format!("half the latency, {latency} samples"),
        "an output that acts sooner after the reading; no part".into(),
        &|scene| scene.actuator.latency = latency,
    );
    for (name, times) in [("output-2", 2), ("output-10", 10)] {
        let period = scene.actuator.period / times;
        if period * times != scene.actuator.period || period == 0 {
            continue;
        }
        add(
            name,
            firmware,
            format!("output {times} times as often, every {period} samples"),
            "an output stage that takes that many commands a second".into(),
            &|scene| scene.actuator.period = period,
        );
    }
    let full_n = scene.actuator.gain_n_per_v * scene.actuator.limit_v;
    match scene.amplifier {
        Some(amplifier) => {
            let bandwidth_hz = 2.0 * amplifier.bandwidth_hz;
            add(
                "amplifier-2",
                part,
                format!("amplifier twice as fast, {bandwidth_hz:.0} Hz"),
                "another current loop, or a higher supply".into(),
                &|scene| scene.amplifier = Some(Amplifier { bandwidth_hz }),
            );
        }
        None => add(
            "amplifier-1khz",
            Kind::LeftOut,
            format!("an amplifier of {AMPLIFIER_HZ} Hz (not in the scene)"),
            "what a real amplifier may take".into(),
            &|scene| scene.amplifier = Some(Amplifier { bandwidth_hz: AMPLIFIER_HZ }),
        ),
    }
    match scene.amplifier_error {
        Some(_) => add(
            "amplifier-linear",
            part,
            "a force in proportion to the command".into(),
            "another amplifier or motor, or a calibration table".into(),
            &|scene| scene.amplifier_error = None,
        ),
        None => add(
            "amplifier-cubic",
            Kind::LeftOut,
            format!("{} % less force at full command (not in the scene)", -100.0 * CUBIC),
            "what a motor that saturates may take".into(),
            &|scene| scene.amplifier_error = Some(AmplifierError { cubic: CUBIC }),
        ),
    }
    add(
        "motor-2",
        part,
        format!("twice the force, {}", units.said(2.0 * full_n, "N")),
        "a motor of twice the torque constant, or twice the current".into(),
        &|scene| scene.actuator.gain_n_per_v *= 2.0,
    );
    match scene.output {
        Some(_) => add(
            "output-ideal",
            part,
            "an output without steps".into(),
            "a finer DAC or timer".into(),
            &|scene| scene.output = None,
        ),
        None => add(
            "dac-12",
            Kind::LeftOut,
            format!("an output of {DAC_BITS} bits (not in the scene)"),
            "what a DAC may take".into(),
            &|scene| scene.output = Some(Quantisation::Dac { bits: DAC_BITS }),
        ),
    }
    let dry_n = DRY_SHARE * full_n;
    match scene.friction {
        Some(friction) => add(
            "friction-half",
            part,
            format!("half the dry friction, {}", units.said(0.5 * friction.coulomb_n, "N")),
            "other bearings or another transmission".into(),
            &|scene| {
                let (coulomb_n, static_n) = (0.5 * friction.coulomb_n, 0.5 * friction.static_n);
                scene.friction = Some(Friction { coulomb_n, static_n, ..friction });
            },
        ),
        None => add(
            "friction-1",
            Kind::LeftOut,
            format!("dry friction of {} (not in the scene)", units.said(dry_n, "N")),
            "what bearings may add".into(),
            &|scene| {
                scene.friction = Some(Friction {
                    coulomb_n: dry_n,
                    static_n: dry_n,
                    stribeck_speed_m_per_s: 1e-3,
                });
                *scene = integrated(scene.clone());
            },
        ),
    }
    match scene.cogging {
        Some(_) => add(
            "cogging-none",
            part,
            "no cogging".into(),
            "a motor without iron, or without slots".into(),
            &|scene| scene.cogging = None,
        ),
        None => add(
            "cogging-1",
            Kind::LeftOut,
            format!(
                "cogging of {} every {} (not in the scene)",
                units.said(dry_n, "N"),
                units.said(1e3 * PITCH_M, "mm")
            ),
            "what a motor with slots may add".into(),
            &|scene| {
                scene.cogging =
                    Some(Cogging { amplitude_n: dry_n, pitch_m: PITCH_M, phase_rad: 0.0 });
                *scene = integrated(scene.clone());
            },
        ),
    }
    match scene.backlash {
        Some(_) => add(
            "backlash-none",
            part,
            "no backlash".into(),
            "a transmission without a gap: cable, belt, preload".into(),
            &|scene| scene.backlash = None,
        ),
        None => add(
            "backlash-100um",
            Kind::LeftOut,
            format!("backlash of {} (not in the scene)", units.said(1e6 * GAP_M, "um")),
            "what gears may add before the second mass".into(),
            &|scene| {
                scene.backlash = Some(Backlash { gap_m: GAP_M });
                *scene = integrated(scene.clone());
            },
        ),
    }
    if scene.accelerometer.is_none() {
        add(
            "accelerometer",
            part,
            "an accelerometer, with fusion".into(),
            "an accelerometer of silicon on the handle, its wires".into(),
            &|scene| scene.accelerometer = Some(ACCELEROMETER),
        );
    }
    for change in &mut all {
        let outputs = |scene: &Scene| scene.control.rate_hz / f64::from(scene.actuator.period);
        match change.name {
            "output-2" | "output-10" => {
                let more = outputs(&change.scene) - outputs(scene);
                change.cycles_per_s = render_cycles().map(|cycles| cycles * more);
            }
            "accelerometer" => {
                change.estimators = vec![EstimatorName::Fusion];
                change.cycles_per_s = estimator_cycles(scene, EstimatorName::Fusion);
            }
            _ => {}
        }
    }
    let of_estimators = |name, text: &str, cost: String, estimators: &[EstimatorName]| Change {
        name,
        text: text.into(),
        kind: firmware,
        cost,
        cycles_per_s: None,
        estimators: estimators.to_vec(),
        ..Change::none(scene)
    };
    if !estimators.is_empty() {
        all.push(of_estimators("estimator", "the best estimator", String::new(), estimators));
    }
    let observer = EstimatorName::Observer;
    if scene.velocity.estimator() != observer {
        let (cost, cycles_per_s) = cost_of_estimator(scene, observer);
        let cost =
            format!("{cost}; needs the mass, and a hand feels another wall than was asked for");
        let text = "an observer that is told the force";
        all.push(Change { cycles_per_s, ..of_estimators("observer", text, cost, &[observer]) });
    }
    all
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::scene::{NamedScene, element::Mode};

    const MODE: Mode = Mode { mass_kg: 0.1, stiffness_n_per_m: 4e4, damping_n_s_per_m: 3.0 };

    fn of(name: &str, edit: impl Fn(&mut Scene)) -> (Scene, Vec<Change>) {
        let mut scene = NamedScene::load(name).unwrap().scene;
        edit(&mut scene);
        let all = changes(&scene, &[EstimatorName::Kalman3]);
        (scene, all)
    }

    /// Names of the tables of the scene file that differ between two scenes. The tables are compared as text.
    fn differing(one: &Scene, other: &Scene) -> Vec<String> {
        let tables = |scene: &Scene| -> BTreeMap<String, String> {
            let (mut tables, mut name) = (BTreeMap::new(), String::new());
            for line in format!("{scene:#?}").lines() {
                if let Some((key, _)) = line.split_once(": ").filter(|_| !line.starts_with("     "))
                {
                    name = key.trim().into();
                }
                *tables.entry(name.clone()).or_default() += line;
            }
            tables
        };
        let (one, other) = (tables(one), tables(other));
        one.keys().filter(|key| one.get(*key) != other.get(*key)).cloned().collect()
    }

    #[test]
    fn each_change_is_of_one_element_and_the_core_takes_it() {
        for name in ["paper-1um", "paper-2um", "nucleo-f446re", "discovery-f407"] {
            let (scene, all) = of(name, |_| ());
            assert!(all.len() >= 12, "{name}: {}", all.len());
            for change in &all {
                change.scene.check().unwrap();
                let mut keys = differing(&scene, &change.scene);
                keys.retain(|key| key != "integrator");
                let most = usize::from(!["estimator", "observer"].contains(&change.name));
                assert_eq!(keys.len(), most, "{name} {}: {keys:?}", change.name);
            }
        }
    }

    #[test]
    fn what_a_scene_has_is_made_better_and_what_it_lacks_is_added() {
        let (_, plain) = of("paper-1um", |_| ());
        let (_, rich) = of("paper-1um", |scene| {
            scene.amplifier = Some(Amplifier { bandwidth_hz: 500.0 });
            scene.friction =
                Some(Friction { coulomb_n: 0.1, static_n: 0.2, stribeck_speed_m_per_s: 0.01 });
            scene.cogging = Some(Cogging { amplitude_n: 0.1, pitch_m: 0.01, phase_rad: 0.0 });
            scene.integrator = Some(Integrator::Rk4 { steps_per_sample: 2 });
            scene.amplifier_error = Some(AmplifierError { cubic: 0.1 });
            scene.mode = Some(MODE);
            scene.backlash = Some(Backlash { gap_m: 1e-5 });
            scene.output = Some(Quantisation::Dac { bits: 10 });
            scene.accelerometer = Some(ACCELEROMETER);
        });
        let has = |all: &[Change], name: &str| all.iter().any(|change| change.name == name);
        for (there, absent) in [
            ("amplifier-2", "amplifier-1khz"),
            ("amplifier-linear", "amplifier-cubic"),
            ("friction-half", "friction-1"),
            ("cogging-none", "cogging-1"),
            ("output-ideal", "dac-12"),
        ] {
            assert!(has(&rich, there) && !has(&rich, absent), "{there}");
            assert!(has(&plain, absent) && !has(&plain, there), "{absent}");
        }
        assert!(has(&plain, "accelerometer") && !has(&rich, "accelerometer"));
        // The backlash gap needs a second mass.
        let (_, geared) = of("paper-1um", |scene| scene.mode = Some(MODE));
        let gaps = [&plain, &geared, &rich]
            .map(|all| ["backlash-100um", "backlash-none"].map(|name| has(all, name)));
        assert_eq!(gaps, [[false, false], [true, false], [false, true]]);
        let fast = rich.iter().find(|change| change.name == "amplifier-2").unwrap();
        assert_eq!(fast.scene.amplifier.unwrap().bandwidth_hz, 1000.0);
    }

    #[test]
    fn an_output_ten_times_as_often_costs_nine_more_renders() {
        let (_, all) = of("paper-1um", |_| ());
        let often = all.iter().find(|change| change.name == "output-10").unwrap();
        let cycles = often.cycles_per_s.unwrap();
        assert_eq!(cycles, 9000.0 * render_cycles().unwrap());
        assert!((1000.0..6000.0).contains(&render_cycles().unwrap()));
        let (text, cycles_per_s) = cost_of_estimator(&often.scene, EstimatorName::Kalman3);
        let of = |name| cost::of(name).unwrap().cycles;
        let (own, other) = (of(often.scene.velocity.estimator()), of(EstimatorName::Kalman3));
        assert!(own < other && text.starts_with(&format!("{other} cycles a sample")), "{text}");
        assert_eq!(cycles_per_s, Some((other - own) * 10_000.0));
    }
}
