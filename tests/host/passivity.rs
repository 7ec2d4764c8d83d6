//! Runs the passivity observer and controller in whole hits of random scenes. Compares the energy that a contact
//! supplies with independent sums.

use host_sim::{
    scene::{NamedScene, Scene},
    simulation::{
        Sample,
        prepared::{HitReport, Numeric, PreparedScene, WallHit},
    },
};
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use zwidth::VelocitySettings;

use crate::figure::figure;

/// The report of a hit, and values that only a simulator knows.
struct Seen {
    report: HitReport,
    /// Largest change of the counts' motion, in counts. The controller's limit must allow this change.
    change: f64,
    /// Smallest energy that the acting force has exchanged with the true motion in a contact, in J.
    given_true_j: f64,
    /// The sum of all changes of the force, each times the length of one count, in J.
    unseen_j: f64,
    outputs: u32,
}

fn seen(scene: &Scene, hit: &WallHit) -> Seen {
    let prepared = PreparedScene::new(scene).unwrap();
    let mut samples: Vec<Sample> = vec![];
    let report = prepared.hit(Numeric::Fixed, hit, |sample| samples.push(*sample)).unwrap();
    let push = f64::from(prepared.plan().push.bits()) / f64::from(1u32 << 30);
    let (full_scale_n, latency) = (scene.full_scale_n(), scene.actuator.latency_samples() as usize);
    let period = scene.actuator.period as usize;
    let surface = (scene.wall.position_m / scene.encoder.resolution_m).round();
    // The sums go from output to output, in the order in which the forces act.
    let mut sums = Sums::default();
    for (n, sample) in samples.iter().enumerate() {
        let Some(of) = n.checked_sub(latency) else { continue };
        if let Some(rendered) = samples[of].rendered {
            let wall_n = (push - rendered.force) * full_scale_n;
            sums.acts(wall_n, f64::from(samples[of].count) > surface, scene.encoder.resolution_m);
        }
        if let Some(next) = samples.get(n + 1) {
            sums.moved(next.position_m - sample.position_m);
        }
    }
    let counts: Vec<f64> = samples.iter().map(|sample| f64::from(sample.count)).collect();
    let span = 2 * period + latency;
    let changes = counts.windows(span + 1).map(|w| {
        let (before, after) = (w[period] - w[0], w[span] - w[period + latency]);
        (after - before).abs()
    });
    Seen {
        report,
        change: changes.fold(0.0, f64::max),
        given_true_j: sums.given_j,
        unseen_j: sums.unseen_j,
        outputs: sums.outputs,
    }
}

/// The exchanged energy, summed in `f64`.
#[derive(Default)]
struct Sums {
    wall_n: f64,
    contact: bool,
    energy_j: f64,
    given_j: f64,
    unseen_j: f64,
    outputs: u32,
}

impl Sums {
    fn acts(&mut self, wall_n: f64, contact: bool, resolution_m: f64) {
        if contact && !self.contact {
            (self.energy_j, self.unseen_j) = (0.0, 0.0);
        }
        self.unseen_j += (wall_n - self.wall_n).abs() * resolution_m;
        (self.wall_n, self.contact) = (wall_n, contact);
        self.outputs += 1;
    }

    fn moved(&mut self, by_m: f64) {
        self.energy_j += self.wall_n * by_m;
        self.given_j = self.given_j.max(-self.energy_j);
    }
}

fn paper() -> Scene {
    NamedScene::load("paper-1um").unwrap().scene
}

fn hit(stiffness_n_per_m: f64, damping_n_s_per_m: f64) -> WallHit {
    let velocity = VelocitySettings::Butterworth { cutoff_hz: 1500.0 };
    WallHit { velocity, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts: 0.0 }
}

/// The observer is compared with sums of floats over the same forces and counts.
#[test]
fn the_account_is_that_of_the_same_forces_and_counts() {
    for (k, b, latency) in
        [(5e3, 20.0, 10.0), (60e3, 50.0, 10.0), (90e3, 700.0, 3.0), (2e3, 0.0, 25.0)]
    {
        let mut scene = paper();
        scene.actuator.latency = latency;
        let prepared = PreparedScene::new(&scene).unwrap();
        let (mut samples, push) = (vec![], f64::from(prepared.plan().push.bits()));
        let report = prepared.hit(Numeric::Fixed, &hit(k, b), |s| samples.push(*s)).unwrap();
        let (mut energy, mut given, mut exchanged) = (0.0, 0f64, 0.0);
        let (mut acting, mut touched) = (0.0, false);
        let latency = scene.actuator.latency_samples() as usize;
        for n in 0..samples.len() {
            if n > 0 {
                let moved = f64::from(samples[n].count - samples[n - 1].count);
                energy += acting * moved;
                exchanged += (acting * moved).abs();
                given = given.max(-energy);
            }
            let Some(of) = n.checked_sub(latency) else { continue };
            if let Some(rendered) = samples[of].rendered {
                let contact = samples[of].count > 70_000;
                if contact && !touched {
                    energy = 0.0;
                }
                (acting, touched) = (push - rendered.force * f64::from(1u32 << 30), contact);
            }
        }
        let unit_j = scene.full_scale_n() / f64::from(1u32 << 30) * scene.encoder.resolution_m;
        let close = |of_core: f64, of_sums: f64| {
            (of_core - of_sums * unit_j).abs() <= 1e-9 * exchanged * unit_j
        };
        assert!(exchanged > 0.0 && close(report.port.taken_j, energy), "{report:?} {energy}");
        assert!(close(report.port.given_j, given), "{report:?} {given}");
    }
}

/// A scene of the paper's device with a wall. The values that change the exchanged energy most are random.
fn drawn(rng: &mut SmallRng) -> (Scene, WallHit) {
    let mut scene = paper();
    let mut log = |low: f64, high: f64| low * (high / low).powf(rng.random::<f64>());
    scene.device.mass_kg = log(0.05, 1.0);
    scene.device.damping_n_s_per_m = log(0.05, 10.0);
    scene.encoder.resolution_m = log(2e-7, 2e-5);
    scene.actuator.gain_n_per_v = log(0.2, 3.0);
    scene.wall_hit.push_n = scene.full_scale_n() * log(0.05, 0.9);
    (scene.wall_hit.settle_s, scene.wall_hit.window_s) = (0.4, 0.2);
    scene.wall_hit.rms_limit_m = scene.wall_hit.rms_limit_m.max(4.0 * scene.encoder.resolution_m);
    scene.device.start_position_m = 0.06;
    let wall = WallHit {
        velocity: VelocitySettings::Butterworth { cutoff_hz: log(50.0, 3000.0) },
        stiffness_n_per_m: log(200.0, 2e5),
        damping_n_s_per_m: log(1.0, 3000.0),
        start_offset_counts: rng.random(),
    };
    scene.actuator.period = [1, 2, 5, 10][rng.random_range(0..4usize)];
    scene.actuator.latency = f64::from(scene.actuator.period) * rng.random::<f64>();
    scene.wall.push_only = rng.random();
    if rng.random() {
        let names = scene.arm_names();
        scene.arm = scene.named_arm(&names[rng.random_range(0..names.len())]).ok();
    }
    (scene, wall)
}

/// With the controller, no contact supplies more than the reserve, plus 2^-21 of the reserve for each output that uses
/// the reserve. This requires that the counts' motion changes by no more than the acceleration allows.
#[test]
fn no_contact_of_a_random_scene_gives_more_than_the_reserve() {
    campaign(1_000, true);
}

#[test]
#[ignore = "ten thousand scenes; .ci/long host"]
fn no_contact_of_ten_thousand_random_scenes_gives_more_than_the_reserve() {
    campaign(10_000, false);
}

/// Runs random scenes. With `told`, also writes the figures for the documentation.
fn campaign(scenes: u32, told: bool) {
    let mut rng = SmallRng::seed_from_u64(25);
    let (mut ran, mut faster, mut gave, mut beyond) = (0u32, 0u32, 0u32, 0u32);
    let (mut highest, mut plain_highest, mut saturated) = (0f64, 0f64, [0.0; 2]);
    for n in 0..scenes {
        let (mut scene, wall) = drawn(&mut rng);
        if scene.check().is_err() {
            continue;
        }
        let Ok(_) = PreparedScene::new(&scene).unwrap().report(Numeric::Fixed, &wall) else {
            continue;
        };
        let plain = seen(&scene, &wall);
        scene.passivity = Some(host_sim::scene::PassivityTable::default());
        if scene.check().is_err() {
            continue;
        }
        let reserve_j = scene.reserve_j().unwrap();
        let passive = seen(&scene, &wall);
        ran += 1;
        // The account's reserve is twice the allowed change, at full scale.
        let allowed = scene.passivity().unwrap().unwrap().change().into();
        let is_allowed = passive.change <= allowed;
        faster += u32::from(!is_allowed);
        let given_j = passive.report.port.given_j;
        let most_j = reserve_j * (1.0 + f64::from(passive.outputs) / 2f64.powi(21));
        assert!(!is_allowed || given_j <= most_j, "{n}: {given_j} of {most_j} J, {wall:?}");
        // At a change of force, the true motion may differ from the counts by one count. Within the sample of the
        // change, a part of the motion belongs to the old force.
        let unseen_j = passive.unseen_j * 2.0;
        assert!(!is_allowed || passive.given_true_j <= most_j + unseen_j, "{n}");
        gave += u32::from(plain.report.port.given_j > reserve_j);
        beyond += u32::from(given_j > reserve_j);
        highest = highest.max(given_j / reserve_j);
        plain_highest = plain_highest.max(plain.report.port.given_j / reserve_j);
        saturated[0] += plain.report.saturated_fraction;
        saturated[1] += passive.report.saturated_fraction;
        assert_eq!(plain.outputs, passive.outputs);
    }
    let [before, after] = saturated.map(|sum| 100.0 * sum / f64::from(ran));
    if told {
        let told = |key: &str, value: f64| figure(&format!("host/passivity/{key}"), value);
        for (key, value) in [("ran", ran), ("gave", gave), ("beyond", beyond), ("faster", faster)] {
            told(key, value.into());
        }
        told("highest", highest);
        told("plain_highest", plain_highest);
        told("saturated_without", before);
        told("saturated_with", after);
    }
    println!(
        "{ran} scenes; more than the reserve: {gave} without the controller (at most {plain_highest:.1} reserves), {beyond} with \
         it (at most {highest:.3}), {faster} of them moved faster than it allows for; outputs saturated {before:.1} % without, \
         {after:.1} % with"
    );
    assert!(ran > scenes / 2 && gave > ran / 50, "{ran} {gave}");
}
