//! A plant whose encoder reads late, with an error or with noise.

use std::sync::Arc;

use super::{AnyState, Moment, Plant};
use crate::{
    numerics::random,
    scene::{
        Scene,
        element::{Chain, EncoderError, EncoderNoise, Glimpse, Jitter},
    },
};

/// Errors of the encoder's readings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sensing {
    pub error: Option<EncoderError>,
    pub noise: Option<EncoderNoise>,
    pub jitter: Option<Jitter>,
}

impl Sensing {
    pub fn of(scene: &Scene) -> Self {
        Self { error: scene.encoder_error, noise: scene.encoder_noise, jitter: scene.jitter }
    }

    pub fn is_perfect(&self) -> bool {
        *self == Self::default()
    }

    /// The position that the encoder reads, in m. It has error and noise, and is not quantised yet. `hit` and `sample`
    /// select the noise.
    #[inline]
    pub fn shown_m(&self, position_m: f64, hit: u64, sample: u64) -> f64 {
        let mut shown_m = position_m;
        if let Some(error) = &self.error {
            shown_m += error.error_m(position_m);
        }
        if let Some(noise) = &self.noise {
            shown_m += noise.error_m(hit, sample);
        }
        shown_m
    }
}

#[derive(Clone, Debug)]
pub struct Sensed<P> {
    plant: P,
    sensing: Sensing,
    rest_m: f64,
    /// Weights of the position for each delay, for plants with an exact step.
    glimpses: Option<Arc<[Glimpse]>>,
}

/// The plant's state, and the number that identifies the hit.
#[derive(Clone, Copy, Debug)]
pub struct SensedState<S> {
    plant: S,
    hit: u64,
}

impl<P: Plant> Sensed<P> {
    /// Adds the errors to a plant. `chain` and `split_s` must be those of the plant.
    pub fn new(plant: P, sensing: Sensing, chain: &Chain, split_s: f64) -> Self {
        let by_itself = plant.later_m(&plant.at_rest(0.0), 0.0, [0.0; 2]).is_some();
        let glimpses = sensing
            .jitter
            .filter(|_| !by_itself)
            .map(|jitter| jitter.glimpses(chain, split_s).into());
        Self { plant, sensing, rest_m: chain.rest_m()[0], glimpses }
    }

    #[inline]
    fn late_m(&self, state: &SensedState<P::State>, moment: &Moment, jitter: &Jitter) -> f64 {
        let level = jitter.level(state.hit, moment.index);
        let (before_n, after_n) = (moment.before_n, moment.after_n);
        match self.glimpses.as_ref().and_then(|glimpses| glimpses.get(level)) {
            Some(glimpse) => {
                glimpse.offset_m(&P::pack(&state.plant).z, before_n, after_n) + self.rest_m
            }
            None => self
                .plant
                .later_m(&state.plant, jitter.delay_s(level), [before_n, after_n])
                .unwrap_or_else(|| self.plant.position_m(&state.plant)),
        }
    }
}

impl<P: Plant> Plant for Sensed<P> {
    type State = SensedState<P::State>;

    fn at_rest(&self, position_m: f64) -> Self::State {
        // Repeats have different start positions, and each start position has its own noise. All walls hit from one
        // start position have the same noise.
        let hit = random::bits(position_m.to_bits(), 0);
        SensedState { plant: self.plant.at_rest(position_m), hit }
    }

    #[inline]
    fn position_m(&self, state: &Self::State) -> f64 {
        self.plant.position_m(&state.plant)
    }

    #[inline]
    fn speed_m_per_s(&self, state: &Self::State) -> f64 {
        self.plant.speed_m_per_s(&state.plant)
    }

    #[inline]
    fn force_n(&self, state: &Self::State, output_n: f64) -> f64 {
        self.plant.force_n(&state.plant, output_n)
    }

    #[inline]
    fn reading_m(&self, state: &Self::State, moment: &Moment) -> f64 {
        let position_m = match &self.sensing.jitter {
            None => self.plant.position_m(&state.plant),
            Some(jitter) => self.late_m(state, moment, jitter),
        };
        self.sensing.shown_m(position_m, state.hit, moment.index)
    }

    #[inline]
    fn advance(&self, state: &Self::State, force_n: f64) -> Self::State {
        SensedState { plant: self.plant.advance(&state.plant, force_n), hit: state.hit }
    }

    #[inline]
    fn advance_split(&self, state: &Self::State, before_n: f64, after_n: f64) -> Self::State {
        let plant = self.plant.advance_split(&state.plant, before_n, after_n);
        SensedState { plant, hit: state.hit }
    }

    fn steps(&self, state: &Self::State) -> u64 {
        self.plant.steps(&state.plant)
    }

    fn pack(state: &Self::State) -> AnyState {
        AnyState { hit: state.hit, ..P::pack(&state.plant) }
    }

    fn unpack(any: &AnyState) -> Self::State {
        SensedState { plant: P::unpack(any), hit: any.hit }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        plant::AnyPlant,
        scene::{
            NamedScene,
            element::{Amplifier, Arm, Mode},
        },
    };

    const SAMPLE_S: f64 = 1e-4;
    const JITTER: Jitter = Jitter { peak_s: 7e-5, seed: 3 };

    fn scene() -> Scene {
        NamedScene::load("paper-1um").unwrap().scene
    }

    fn augmented() -> Scene {
        let mut scene = scene();
        scene.amplifier = Some(Amplifier { bandwidth_hz: 3000.0 });
        scene.mode = Some(Mode { mass_kg: 0.15, stiffness_n_per_m: 6e4, damping_n_s_per_m: 4.0 });
        scene.arm = Some(Arm {
            mass_kg: 1.2,
            damping_n_s_per_m: 12.0,
            stiffness_n_per_m: 250.0,
            rest_position_m: 0.05,
            grip_damping_n_s_per_m: 25.0,
            grip_stiffness_n_per_m: 1200.0,
        });
        scene
    }

    /// Compares late readings with exact steps whose length is the delay.
    fn late_readings(scene: &Scene, fraction: f64, tolerance_m: f64) {
        let mut with = scene.clone();
        with.jitter = Some(JITTER);
        let sensed = AnyPlant::of(&with, SAMPLE_S, fraction);
        let exact = AnyPlant::unsensed(scene, SAMPLE_S, fraction);
        let reference = Scene { integrator: None, ..scene.clone() };
        let split_s = fraction * SAMPLE_S;
        let (mut state, mut plain) = (sensed.at_rest(0.02), exact.at_rest(0.02));
        let mut levels = std::collections::BTreeSet::new();
        for index in 0..3000 {
            let forces = |n: u64| f64::from(u32::try_from(n * 7919 % 101).unwrap()) / 25.0 - 2.0;
            let (before_n, after_n) = (forces(index), forces(index + 1));
            let reading_m = sensed.reading_m(&state, &Moment { index, before_n, after_n });
            let level = JITTER.level(state.hit, index);
            levels.insert(level);
            let delay_s = JITTER.delay_s(level);
            // The delay has a part before the split and a part after the split. Each part is computed as one whole step
            // of its own length.
            let early_s = delay_s.min(split_s);
            let part = |dt: f64, state: &AnyState, force_n: f64| {
                if dt == 0.0 {
                    *state
                } else {
                    AnyPlant::unsensed(&reference, dt, 0.0).advance(state, force_n)
                }
            };
            let later = part(delay_s - early_s, &part(early_s, &plain, before_n), after_n);
            let error_m = reading_m - exact.position_m(&later);
            assert!(error_m.abs() < tolerance_m, "{index}: {error_m:e}");
            state = sensed.advance_split(&state, before_n, after_n);
            plain = exact.advance_split(&plain, before_n, after_n);
            assert_eq!(sensed.position_m(&state).to_bits(), exact.position_m(&plain).to_bits());
        }
        assert!(levels.len() > 250 && levels.contains(&0) && levels.contains(&256), "{levels:?}");
    }

    #[test]
    fn late_readings_are_positions_of_their_time() {
        for fraction in [0.0, 0.3] {
            late_readings(&scene(), fraction, 1e-16);
            late_readings(&augmented(), fraction, 1e-15);
            let integrator = crate::numerics::integrator::Integrator::Rk4 { steps_per_sample: 4 };
            let integrated = Scene { integrator: Some(integrator), ..augmented() };
            late_readings(&integrated, fraction, 1e-11);
        }
    }
}
