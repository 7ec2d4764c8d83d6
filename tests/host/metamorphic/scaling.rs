//! Runs scenes whose forces, lengths and times are larger by a power of two. The counts must stay the same. All other
//! values must be larger by exactly this factor, bit for bit.

use host_sim::{
    scene::{Scene, element::Travel},
    simulation::prepared::{Numeric, WallHit},
};
use zwidth::VelocitySettings;

use crate::dice::{Dice, cases, trace};

/// The factors by which forces, lengths and times become larger.
#[derive(Clone, Copy, Debug)]
struct Larger {
    force: f64,
    length: f64,
    time: f64,
}

impl Larger {
    fn scene(self, scene: &Scene) -> Scene {
        let Self { force, length, time } = self;
        let (stiffness, damping, mass) =
            (force / length, force * time / length, force * time * time / length);
        let mut scene = scene.clone();
        let device = &mut scene.device;
        device.mass_kg *= mass;
        device.damping_n_s_per_m *= damping;
        device.stiffness_n_per_m *= stiffness;
        device.rest_position_m *= length;
        device.start_position_m *= length;
        scene.encoder.resolution_m *= length;
        scene.actuator.gain_n_per_v *= force;
        scene.control.rate_hz /= time;
        scene.wall.position_m *= length;
        scene.wall_hit.push_n *= force;
        scene.wall_hit.settle_s *= time;
        scene.wall_hit.window_s *= time;
        scene.wall_hit.rms_limit_m *= length;
        scene.sweep.cutoffs_hz.iter_mut().for_each(|hz| *hz /= time);
        if let Some(amplifier) = &mut scene.amplifier {
            amplifier.bandwidth_hz /= time;
        }
        if let Some(mode) = &mut scene.mode {
            mode.mass_kg *= mass;
            mode.damping_n_s_per_m *= damping;
            mode.stiffness_n_per_m *= stiffness;
        }
        if let Some(arm) = &mut scene.arm {
            arm.mass_kg *= mass;
            arm.damping_n_s_per_m *= damping;
            arm.grip_damping_n_s_per_m *= damping;
            arm.stiffness_n_per_m *= stiffness;
            arm.grip_stiffness_n_per_m *= stiffness;
            arm.rest_position_m *= length;
        }
        if let Some(friction) = &mut scene.friction {
            friction.coulomb_n *= force;
            friction.static_n *= force;
            friction.stribeck_speed_m_per_s *= length / time;
        }
        if let Some(cogging) = &mut scene.cogging {
            cogging.amplitude_n *= force;
            cogging.pitch_m *= length;
        }
        if let Some(backlash) = &mut scene.backlash {
            backlash.gap_m *= length;
        }
        if let Some(Travel::Spring { low_m, high_m, stiffness_n_per_m, damping_n_s_per_m }) =
            &mut scene.travel
        {
            *low_m *= length;
            *high_m *= length;
            *stiffness_n_per_m *= stiffness;
            *damping_n_s_per_m *= damping;
        }
        if let Some(error) = &mut scene.encoder_error {
            error.cycle_m *= length;
            error.first_m *= length;
            error.second_m *= length;
        }
        if let Some(jitter) = &mut scene.jitter {
            jitter.peak_s *= time;
        }
        scene
    }

    fn hit(self, hit: &WallHit) -> WallHit {
        WallHit {
            velocity: match hit.velocity.cutoff_hz() {
                Some(cutoff_hz) => hit.velocity.with_tuning(cutoff_hz / self.time),
                None => hit.velocity,
            },
            stiffness_n_per_m: hit.stiffness_n_per_m * self.force / self.length,
            damping_n_s_per_m: hit.damping_n_s_per_m * self.force * self.time / self.length,
            start_offset_counts: hit.start_offset_counts,
        }
    }

    #[track_caller]
    fn holds(self, name: &str, scene: &Scene, hit: &WallHit, numeric: Numeric) {
        let plain = trace(scene, hit, numeric);
        let larger = trace(&self.scene(scene), &self.hit(hit), numeric);
        assert_eq!(plain.len(), larger.len());
        for (one, other) in plain.iter().zip(&larger) {
            let mut expected = *one;
            expected.position_m *= self.length;
            expected.output_n *= self.force;
            if expected.output_n.abs() < 1e-300 {
                expected.output_n = other.output_n; // an amplifier's decaying output reaches subnormal numbers
            }
            assert_eq!(*other, expected, "{name}: {self:?} {hit:?} {scene:?}");
        }
        let moved = plain.iter().map(|sample| sample.count).max();
        assert!(moved > Some(10), "{name}: nothing happens in {scene:?}");
    }
}

const POWERS: [f64; 4] = [0.25, 0.5, 2.0, 4.0];

fn numeric(dice: &mut Dice) -> Numeric {
    dice.one_of(&[Numeric::Fixed, Numeric::F64, Numeric::F64Rounded])
}

fn any(dice: &mut Dice) -> Scene {
    let mut scene = dice.scene();
    dice.linear_elements(&mut scene);
    dice.encoder_elements(&mut scene);
    if dice.below(4) == 0 {
        dice.nonlinear_elements(&mut scene);
        while scene.check().is_err() {
            dice.linear_elements(&mut scene);
        }
    }
    scene
}

#[test]
fn larger_forces_change_nothing_else() {
    cases(25, |dice| {
        let scene = any(dice);
        let (hit, force) = (dice.wall(&scene), dice.one_of(&POWERS));
        let numeric = numeric(dice);
        Larger { force, length: 1.0, time: 1.0 }.holds(&dice.name, &scene, &hit, numeric);
    });
}

#[test]
fn larger_lengths_change_nothing_else() {
    cases(25, |dice| {
        let scene = any(dice);
        let (hit, length) = (dice.wall(&scene), dice.one_of(&POWERS));
        let numeric = numeric(dice);
        // Force and length have the same factor, so masses, dampers and springs stay the same.
        Larger { force: length, length, time: 1.0 }.holds(&dice.name, &scene, &hit, numeric);
    });
}

#[test]
fn longer_times_change_nothing_else() {
    cases(25, |dice| {
        let mut scene = dice.scene();
        dice.encoder_elements(&mut scene);
        let (hit, time) = (dice.wall(&scene), dice.one_of(&[0.5, 2.0]));
        let numeric = numeric(dice);
        Larger { force: 1.0, length: 1.0, time }.holds(&dice.name, &scene, &hit, numeric);
    });
}

#[test]
fn an_observers_mass_is_one_of_the_masses() {
    cases(6, |dice| {
        let mut scene = dice.scene();
        let mass_kg = scene.device.mass_kg;
        let bandwidth_hz = 0.02 * scene.control.rate_hz;
        let observer = |mass_kg| VelocitySettings::Observer { bandwidth_hz, mass_kg };
        scene.velocity = observer(mass_kg).into();
        scene.actuator.latency_known = dice.coin();
        let hit = dice.wall(&scene);
        let force = dice.one_of(&POWERS);
        let larger = Larger { force, length: 1.0, time: 1.0 };
        let plain = trace(&scene, &hit, Numeric::Fixed);
        let mut other = larger.scene(&scene);
        let velocity = observer(mass_kg * force);
        other.velocity = velocity.into();
        let hit = WallHit { velocity, ..larger.hit(&hit) };
        let other = trace(&other, &hit, Numeric::Fixed);
        for (one, other) in plain.iter().zip(&other) {
            assert_eq!((one.position_m, one.velocity), (other.position_m, other.velocity));
        }
    });
}
