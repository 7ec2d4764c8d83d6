//! Replays the commands of one hit on another plant.

use std::time::Instant;

use crate::{
    sim_plant::{AnyPlant, Plant, each_plant},
    simulation::prepared::{HitError, PreparedScene, WallHit},
};

/// A hit that was run with the reference method. It has the positions of the handle, and the commands.
#[derive(Clone, Debug)]
pub struct Recorded {
    start_m: f64,
    positions_m: Vec<f64>,
    /// One entry per sample: the commanded force that takes effect within the sample, in N. `None` if no command takes
    /// effect in it.
    commands_n: Vec<Option<f64>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replayed {
    /// Largest distance from the recorded position, in m.
    pub error_m: f64,
    /// Number of steps that the integrator tried.
    pub steps: u64,
    pub samples: u32,
}

impl Recorded {
    /// Runs a whole hit with the core and records this hit.
    pub fn new(prepared: &PreparedScene, hit: &WallHit) -> Result<Self, HitError> {
        let samples = (prepared.plan().settle + prepared.plan().window) as usize;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 to 1000 by the scene's check"
        )]
        let latency = prepared.scene().actuator.latency.floor() as usize;
        let full_scale_n = prepared.design().full_scale_n;
        let mut positions_m = Vec::with_capacity(samples);
        let mut commands_n = vec![None; samples + latency];
        let mut simulation = prepared.fixed(hit)?;
        for n in 0..samples {
            let sample = simulation.step();
            positions_m.push(sample.position_m);
            if let Some(rendered) = sample.rendered {
                commands_n[n + latency] = Some(rendered.output * full_scale_n);
            }
        }
        commands_n.truncate(samples);
        let start_m = prepared.scene().device.start_position_m;
        Ok(Self { start_m, positions_m, commands_n })
    }

    pub fn replay(&self, plant: &AnyPlant) -> Replayed {
        let mut state = plant.at_rest(self.start_m);
        let (mut acting_n, mut error_m) = (0.0, 0f64);
        for (position_m, command_n) in self.positions_m.iter().zip(&self.commands_n) {
            let error = (plant.position_m(&state) - position_m).abs();
            error_m = if error.is_nan() { f64::INFINITY } else { error_m.max(error) };
            // As in the simulation, a step is split only where a command takes effect.
            state = advance(plant, &state, &mut acting_n, *command_n);
        }
        let samples = u32::try_from(self.positions_m.len()).unwrap_or(u32::MAX);
        Replayed { error_m, steps: plant.steps(&state), samples }
    }

    /// Time of the plant alone on this machine, in ns per sample. This time differs from call to call.
    pub fn host_ns(&self, plant: &AnyPlant) -> f64 {
        const RUNS: u32 = 3; // the smallest time counts
        let timed = |_| each_plant!(plant, plant => self.timed(plant));
        (0..RUNS).map(timed).fold(f64::INFINITY, f64::min)
    }

    fn timed<P: Plant>(&self, plant: &P) -> f64 {
        let start = Instant::now();
        let mut state = plant.at_rest(self.start_m);
        let mut acting_n = 0.0;
        for command_n in &self.commands_n {
            state = advance(plant, &state, &mut acting_n, *command_n);
        }
        std::hint::black_box(plant.position_m(&state));
        #[expect(clippy::cast_precision_loss, reason = "some 10^5 samples")]
        let samples = self.commands_n.len() as f64;
        start.elapsed().as_secs_f64() / samples * 1e9
    }
}

/// Advances the plant by one sample. `command_n`, if any, takes effect within the sample.
#[inline]
fn advance<P: Plant>(
    plant: &P,
    state: &P::State,
    acting_n: &mut f64,
    command_n: Option<f64>,
) -> P::State {
    match command_n {
        Some(next_n) => {
            let before_n = std::mem::replace(acting_n, next_n);
            plant.advance_split(state, before_n, next_n)
        }
        None => plant.advance(state, *acting_n),
    }
}
