//! Designs an excitation for an identification. The excitation is a train of pulses that a board makes. The pulses show
//! mass, damping and spring. They stay within the limits of travel, speed and duty.
//!
//! The board's pulse train ([`pulse_train`]) moves the handle to the start, pushes the handle and releases it, four
//! times. The force is as large as four limits allow:
//!
//! - The simulated excursion of each pulse is at most [`OF_TRAVEL`] of the distance to the nearer end.
//! - The speed of each pulse is at most [`OF_SPEED`] of the speed limit.
//! - The force of each pulse is at most [`OF_FULL`] of full scale.
//! - The mean square of all forces is within the motor's limit.

use serde::Serialize;
use zwidth::experiment::pulse_train::{LENGTHS_S, PARTS, PULSES, REST_S};

use crate::{
    plant::{AnyPlant, Plant as _},
    scene::Scene,
};

/// Largest excursion of a pulse, as a share of the distance to the nearer end.
const OF_TRAVEL: f64 = 0.6;
/// Largest speed of a pulse, as a share of the speed limit.
const OF_SPEED: f64 = 0.5;
/// Largest force of a pulse, as a share of full scale.
const OF_FULL: f64 = 0.5;
/// Longest time to wait until the handle is back at the start, in s.
const BACK_S: f64 = 2.0;
/// Smallest useful excursion, in counts.
const FEWEST_COUNTS: f64 = 200.0;
/// Largest number of times that the force is halved.
const HALVINGS: u32 = 12;

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pulse {
    pub push_n: f64,
    pub seconds: f64,
    /// Largest distance of the handle from the start, in m.
    pub excursion_m: f64,
    /// Largest speed during the pulse, in m/s.
    pub speed_m_per_s: f64,
}

impl Pulse {
    /// Whether the excursion is large enough to be useful.
    pub fn moves(&self, scene: &Scene) -> bool {
        self.excursion_m >= FEWEST_COUNTS * scene.encoder.resolution_m
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Position at which each pulse starts, in m.
    pub start_m: f64,
    /// Force of all pulses, in N.
    pub push_n: f64,
    pub pulses: [Pulse; PULSES],
    /// Duration of the train in s, including the return moves.
    pub seconds: f64,
    /// RMS of the force over the train, in N.
    pub rms_n: f64,
    /// Force that the motor can give continuously, in N.
    pub continuous_n: f64,
}

/// Simulates a pulse that begins at rest at the start. Returns its excursion and its speed.
fn pulse(scene: &Scene, start_m: f64, push_n: f64, seconds: f64) -> Pulse {
    let sample_s = 1.0 / scene.control.rate_hz;
    let plant = AnyPlant::unsensed(scene, sample_s, 0.0);
    let mut state = plant.at_rest(start_m);
    let mut moved = Pulse { push_n, seconds, excursion_m: 0.0, speed_m_per_s: 0.0 };
    let mut now_s = 0.0;
    while now_s < seconds + REST_S {
        let force_n = if now_s < seconds { push_n } else { 0.0 };
        state = plant.advance(&state, force_n);
        moved.excursion_m = moved.excursion_m.max((plant.position_m(&state) - start_m).abs());
        moved.speed_m_per_s = moved.speed_m_per_s.max(plant.speed_m_per_s(&state).abs());
        now_s += sample_s;
    }
    moved
}

/// Plans the pulses for the scene's device on its board.
///
/// # Errors
/// The travel has no room for a train with a sufficient excursion. The message has one line.
pub fn plan(scene: &Scene) -> Result<Plan, String> {
    let board = scene.on_board();
    let [low_m, high_m] = [board.safety.travel_low_m, board.safety.travel_high_m];
    // Only the pulse acts on the handle. There is no wall and no hand.
    let mut free = scene.clone();
    free.arm = None;
    free.wall_hit.push_by = crate::scene::PushBy::Motor;
    // A pulse starts at the rest position of a spring if it has travel on both sides there. Otherwise it starts in the
    // middle of the travel.
    let middle_m = f64::midpoint(low_m, high_m);
    let rest_m = scene.device.rest_position_m;
    let inside = (rest_m - middle_m).abs() < 0.25 * (high_m - low_m);
    let springs = scene.device.stiffness_n_per_m > 0.0;
    let start_m = if springs && inside { rest_m } else { middle_m };
    let room_m = OF_TRAVEL * (start_m - low_m).min(high_m - start_m);
    let speed_most = OF_SPEED * board.safety.speed_max_m_per_s;
    let continuous_n = board.duty.continuous_force_n;
    let fits = |found: &Pulse| found.excursion_m <= room_m && found.speed_m_per_s <= speed_most;
    let time_s: f64 = LENGTHS_S.iter().map(|length| length + REST_S).sum();
    let parts = PARTS.into_iter().zip(LENGTHS_S);
    let share = parts.map(|(part, length)| part * part * length).sum::<f64>() / time_s;
    let mut push_n = (OF_FULL * scene.full_scale_n()).min(continuous_n / share.sqrt());
    for _ in 0..HALVINGS {
        let pulses: [Pulse; PULSES] =
            std::array::from_fn(|n| pulse(&free, start_m, PARTS[n] * push_n, LENGTHS_S[n]));
        if pulses.iter().all(fits) {
            if !pulses.iter().any(|one| one.moves(scene)) {
                break;
            }
            let rms_n = push_n * share.sqrt();
            let seconds = time_s + PULSES as f64 * BACK_S;
            return Ok(Plan { start_m, push_n, pulses, seconds, rms_n, continuous_n });
        }
        push_n *= 0.5;
    }
    Err(format!(
        "no pulse moves the handle by {FEWEST_COUNTS} counts within {room_m:.4} m and {speed_most} m/s: give the \
         scene's [safety] more travel or speed"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{NamedScene, SafetyTable};

    #[test]
    fn pulses_keep_to_travel_speed_and_duty() {
        for (name, half_m, speed) in
            [("nucleo-f446re", 0.04, 1.0), ("discovery-f407", 0.01, 0.3), ("paper-1um", 0.004, 0.1)]
        {
            let mut scene = NamedScene::load(name).unwrap().scene;
            let rest_m = scene.device.rest_position_m;
            scene.safety = Some(SafetyTable {
                travel_low_m: Some(rest_m - half_m),
                travel_high_m: Some(rest_m + half_m),
                speed_max_m_per_s: Some(speed),
                ..SafetyTable::default()
            });
            let found = plan(&scene).unwrap();
            println!("{name}: {found:?}");
            assert_eq!(found.start_m, rest_m);
            assert!(found.rms_n <= found.continuous_n);
            let keeps = |one: &Pulse, part: f64| {
                one.excursion_m <= part * OF_TRAVEL * half_m
                    && one.speed_m_per_s <= part * OF_SPEED * speed
                    && one.push_n.abs() <= OF_FULL * scene.full_scale_n()
            };
            assert!(found.pulses.iter().all(|one| keeps(one, 1.0)), "{found:?}");
            // With twice the force, at least one pulse would exceed a limit.
            let twice =
                found.pulses.map(|one| pulse(&scene, found.start_m, 2.0 * one.push_n, one.seconds));
            assert!(!twice.iter().all(|one| keeps(one, 0.99)), "{found:?}");
        }
        let mut tight = NamedScene::load("paper-1um").unwrap().scene;
        tight.safety = Some(SafetyTable {
            travel_low_m: Some(-1e-4),
            travel_high_m: Some(1e-4),
            ..SafetyTable::default()
        });
        assert!(plan(&tight).unwrap_err().contains("no pulse moves the handle by 200 counts"));
    }
}
