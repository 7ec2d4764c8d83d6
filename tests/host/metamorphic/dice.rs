//! Random scenes and walls. Each scene or wall follows from one number.

use host_sim::{
    numerics::integrator::Integrator,
    scene::{
        NamedScene, Quantisation, Rounding, Scene, VelocityTable,
        element::{
            Amplifier, AmplifierError, Arm, Backlash, Cogging, EncoderError, Friction, Jitter,
            Mode, Travel,
        },
    },
    simulation::{
        Sample,
        prepared::{Numeric, PreparedScene, WallHit},
    },
};
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use zwidth::{VelocitySettings, velocity::EstimatorName};

fn environment(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is {text}, allowed a whole number")))
}

/// Runs a relation `usual` times. The environment can set a factor for this number.
pub fn cases(usual: u64, mut relation: impl FnMut(&mut Dice)) {
    let times = environment("METAMORPHIC_CASES").unwrap_or(1);
    let seed = environment("METAMORPHIC_SEED").unwrap_or(0);
    for case in 0..usual * times {
        relation(&mut Dice::new(seed, case));
    }
}

/// The random numbers of one test case.
pub struct Dice {
    /// The seed and the number of the case, for the message of a failure.
    pub name: String,
    random: Xoshiro256PlusPlus,
}

impl Dice {
    pub fn new(seed: u64, case: u64) -> Self {
        let random = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_mul(1 << 32) + case);
        Self { name: format!("seed {seed}, case {case}"), random }
    }

    /// A random number that is uniform from 0 to below 1.
    pub fn part(&mut self) -> f64 {
        self.random.random::<f64>()
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.part()
    }

    /// A random number that is uniform on a logarithmic scale.
    pub fn decades(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.part())
    }

    pub fn below(&mut self, n: u32) -> u32 {
        self.random.random_range(0..n)
    }

    pub fn coin(&mut self) -> bool {
        self.below(2) == 0
    }

    pub fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len() as u32) as usize]
    }

    pub fn normal(&mut self) -> f64 {
        let (u, v) = (self.part(), self.part());
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    /// A device without elements, 10 mm in front of its wall.
    pub fn scene(&mut self) -> Scene {
        let mut scene = NamedScene::load("paper-1um").unwrap().scene;
        let rate_hz = self.one_of(&[2e3, 5e3, 1e4, 2e4]);
        scene.control.rate_hz = rate_hz;
        scene.sweep.cutoffs_hz = vec![0.1 * rate_hz];
        scene.device.mass_kg = self.decades(0.05, 3.0);
        scene.device.damping_n_s_per_m = self.one_of(&[0.0, 0.5, 5.0]) * self.between(0.5, 1.5);
        scene.device.stiffness_n_per_m = self.one_of(&[0.0, 50.0]) * self.between(0.5, 1.5);
        scene.device.rest_position_m = 0.004;
        scene.encoder.resolution_m = self.decades(3e-7, 2e-5);
        scene.encoder.rounding = self.one_of(&[Rounding::Floor, Rounding::Round]);
        scene.actuator.period = self.one_of(&[1, 2, 3, 10]);
        scene.actuator.latency = match self.below(3) {
            0 => 0.0,
            1 => f64::from(self.below(25)),
            _ => self.between(0.0, 25.0),
        };
        scene.wall.position_m = 0.01;
        scene.wall.push_only = self.coin();
        scene.wall_hit.push_n = self.between(0.2, 0.9) * scene.full_scale_n();
        scene.wall_hit.settle_s = 0.35;
        scene.wall_hit.window_s = 0.1;
        let filter = match self.below(4) {
            0 => VelocitySettings::Difference {},
            1 => EstimatorName::FirstOrder.defaults(),
            2 => VelocitySettings::LeastSquares1 { window_samples: 1 + self.below(20) },
            _ => EstimatorName::Butterworth.defaults(),
        };
        scene.velocity = VelocityTable::from(filter).with_cutoff(None);
        if self.coin() {
            scene.output = Some(match self.coin() {
                true => Quantisation::Dac { bits: 4 + self.below(12) },
                false => Quantisation::Pwm { steps: 10 + self.below(4000) },
            });
        }
        scene
    }

    /// Adds linear elements to the scene, each with some probability.
    pub fn linear_elements(&mut self, scene: &mut Scene) {
        let spring = |dice: &mut Self, k: f64| dice.one_of(&[0.0, k]) * dice.between(0.5, 1.5);
        scene.amplifier = self.coin().then(|| Amplifier { bandwidth_hz: self.decades(50.0, 5e3) });
        scene.mode = self.coin().then(|| Mode {
            mass_kg: self.decades(0.02, 1.0),
            stiffness_n_per_m: 2e4 * self.between(0.5, 1.5),
            damping_n_s_per_m: spring(self, 4.0),
        });
        scene.arm = self.coin().then(|| Arm {
            mass_kg: self.decades(0.1, 2.0),
            damping_n_s_per_m: spring(self, 10.0),
            stiffness_n_per_m: spring(self, 30.0),
            rest_position_m: 0.005,
            grip_damping_n_s_per_m: spring(self, 25.0),
            grip_stiffness_n_per_m: spring(self, 1200.0),
        });
    }

    /// Adds those elements of the encoder that have a length.
    pub fn encoder_elements(&mut self, scene: &mut Scene) {
        scene.encoder_error = self.coin().then(|| EncoderError {
            cycle_m: self.decades(1e-5, 1e-3),
            first_m: self.decades(1e-8, 1e-6),
            second_m: self.decades(1e-8, 1e-6),
            phase_rad: self.between(-3.0, 3.0),
        });
        let most = scene.actuator.latency.min(1.0) / scene.control.rate_hz;
        if self.coin() && most > 0.0 {
            scene.jitter = Some(Jitter { peak_s: 0.9 * most, seed: self.below(1000) });
        }
    }

    /// Adds nonlinear elements, and an integrator for these elements.
    pub fn nonlinear_elements(&mut self, scene: &mut Scene) {
        scene.integrator = Some(Integrator::Rk4 { steps_per_sample: 16 });
        scene.friction = self.coin().then_some(Friction {
            coulomb_n: 0.1,
            static_n: 0.15,
            stribeck_speed_m_per_s: 0.01,
        });
        scene.cogging = self.coin().then(|| Cogging {
            amplitude_n: 0.05,
            pitch_m: self.decades(1e-3, 1e-2),
            phase_rad: self.between(-3.0, 3.0),
        });
        let gap_m = 1e-4 * self.between(0.5, 1.5);
        scene.backlash = (self.coin() && scene.mode.is_some()).then_some(Backlash { gap_m });
        let cubic = self.between(-0.3, 0.3);
        scene.amplifier_error = self.coin().then_some(AmplifierError { cubic });
        scene.travel = self.coin().then(|| Travel::Spring {
            low_m: -0.001,
            high_m: self.between(0.0101, 0.012),
            stiffness_n_per_m: 2e4,
            damping_n_s_per_m: 5.0,
        });
    }

    /// A wall for this scene, stable or unstable.
    pub fn wall(&mut self, scene: &Scene) -> WallHit {
        WallHit {
            velocity: match scene.velocity.settings() {
                Some(filter) => filter,
                None => scene.velocity.at(scene.control.rate_hz * self.decades(0.005, 0.3)),
            },
            stiffness_n_per_m: self.decades(300.0, 5e4),
            damping_n_s_per_m: self.one_of(&[0.0, 1.0]) * self.decades(1.0, 100.0),
            start_offset_counts: 0.0,
        }
    }
}

pub fn trace(scene: &Scene, hit: &WallHit, numeric: Numeric) -> Vec<Sample> {
    let prepared = PreparedScene::new(scene).unwrap_or_else(|error| panic!("{error}: {scene:?}"));
    let mut samples = vec![];
    prepared.hit(numeric, hit, |sample| samples.push(*sample)).unwrap();
    samples
}
