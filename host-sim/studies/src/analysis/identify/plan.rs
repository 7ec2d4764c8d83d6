//! A designed excitation: pulses of a board's hits that show mass, damping and spring, within travel, speed and duty.
//!
//! A hit without a wall is a pulse: the board moves the handle to the start, pushes, and lets go. Pulses of both signs and
//! of two lengths are planned: short ones change the force often, which shows the mass and the amplifier's lag; long ones
//! move far, which shows damping, spring and friction. Each is as strong as the plan allows: its excursion in the scene's
//! own device, simulated, stays within [`OF_TRAVEL`] of the way to either end, its speed within [`OF_SPEED`] of the limit,
//! its force within [`OF_FULL`] of full scale, and the mean square of all forces within that of the motor.

use crate::{
    plant::{AnyPlant, Plant as _},
    scene::Scene,
};

/// Lengths of the pulses, s.
const LENGTHS_S: [f64; 2] = [0.05, 0.2];
/// Part of the way to the nearer end that a pulse may use.
const OF_TRAVEL: f64 = 0.6;
/// Part of the speed limit.
const OF_SPEED: f64 = 0.5;
/// Part of full scale.
const OF_FULL: f64 = 0.5;
/// Time after a pulse in which the handle comes back, s.
const AFTER_S: f64 = 3.0;
/// Fewest counts of excursion that are worth a pulse.
const FEWEST_COUNTS: f64 = 200.0;
/// Halvings of the force until it is given up.
const HALVINGS: u32 = 12;

/// One pulse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pulse {
    /// Force, N.
    pub push_n: f64,
    /// How long, s.
    pub seconds: f64,
    /// Farthest from the start, m.
    pub excursion_m: f64,
    /// Fastest, m/s.
    pub speed_m_per_s: f64,
}

/// A planned record.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Where each pulse starts, m.
    pub start_m: f64,
    /// The pulses, in their order.
    pub pulses: Vec<Pulse>,
    /// Wait after each, s.
    pub after_s: f64,
    /// Root mean square of the force over the whole, N.
    pub rms_n: f64,
    /// What the motor stands for ever, N.
    pub continuous_n: f64,
}

/// Excursion and speed of a pulse from rest at the start.
fn pulse(scene: &Scene, start_m: f64, push_n: f64, seconds: f64) -> Pulse {
    let sample_s = 1.0 / scene.control.rate_hz;
    let plant = AnyPlant::unsensed(scene, sample_s, 0.0);
    let mut state = plant.at_rest(start_m);
    let mut moved = Pulse { push_n, seconds, excursion_m: 0.0, speed_m_per_s: 0.0 };
    let mut now_s = 0.0;
    while now_s < seconds + AFTER_S {
        let force_n = if now_s < seconds { push_n } else { 0.0 };
        state = plant.advance(&state, force_n);
        moved.excursion_m = moved.excursion_m.max((plant.position_m(&state) - start_m).abs());
        moved.speed_m_per_s = moved.speed_m_per_s.max(plant.speed_m_per_s(&state).abs());
        now_s += sample_s;
    }
    moved
}

/// A plan for the scene's device on its board.
///
/// # Errors
/// One line: its travel leaves no room for a pulse that moves far enough.
pub fn plan(scene: &Scene) -> Result<Plan, String> {
    let board = scene.on_board();
    let [low_m, high_m] = [board.safety.travel_low_m, board.safety.travel_high_m];
    // Nothing but the pulse is to act: no wall, no hand.
    let mut free = scene.clone();
    free.arm = None;
    free.wall_hit.push_by = crate::scene::PushBy::Motor;
    // Where a spring rests the pulse has the room of both sides; without one in the middle.
    let middle_m = f64::midpoint(low_m, high_m);
    let rest_m = scene.device.rest_position_m;
    let inside = (rest_m - middle_m).abs() < 0.25 * (high_m - low_m);
    let springs = scene.device.stiffness_n_per_m > 0.0;
    let start_m = if springs && inside { rest_m } else { middle_m };
    let room_m = OF_TRAVEL * (start_m - low_m).min(high_m - start_m);
    let speed_most = OF_SPEED * board.safety.speed_max_m_per_s;
    let continuous_n = board.duty.continuous_force_n;
    let fits = |found: &Pulse| found.excursion_m <= room_m && found.speed_m_per_s <= speed_most;
    let mut pulses = vec![];
    for seconds in LENGTHS_S {
        let share = (seconds + AFTER_S) / seconds;
        let mut push_n = (OF_FULL * scene.full_scale_n()).min(continuous_n * share.sqrt());
        for _ in 0..HALVINGS {
            let both = [1.0, -1.0].map(|sign| pulse(&free, start_m, sign * push_n, seconds));
            let moves = both
                .iter()
                .all(|one| one.excursion_m >= FEWEST_COUNTS * scene.encoder.resolution_m);
            if both.iter().all(fits) {
                pulses.extend(both.into_iter().filter(|_| moves));
                break;
            }
            push_n *= 0.5;
        }
    }
    if pulses.is_empty() {
        return Err(format!(
            "no pulse moves the handle by {FEWEST_COUNTS} counts within {room_m:.4} m and {speed_most} m/s: give the \
             scene's [safety] more travel or speed"
        ));
    }
    let squares: f64 = pulses.iter().map(|one| one.push_n * one.push_n * one.seconds).sum();
    let time_s: f64 = pulses.iter().map(|one| one.seconds + AFTER_S).sum();
    Ok(Plan { start_m, pulses, after_s: AFTER_S, rms_n: (squares / time_s).sqrt(), continuous_n })
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
            assert_eq!((found.pulses.len(), found.start_m), (4, rest_m));
            assert!(found.rms_n <= found.continuous_n);
            for one in &found.pulses {
                assert!(
                    one.excursion_m <= OF_TRAVEL * half_m && one.speed_m_per_s <= OF_SPEED * speed
                );
                // and one of twice the force would not keep to them
                let twice = pulse(&scene, found.start_m, 2.0 * one.push_n, one.seconds);
                let far = twice.excursion_m > 0.99 * OF_TRAVEL * half_m;
                let fast = twice.speed_m_per_s > 0.99 * OF_SPEED * speed;
                let strong = 2.0 * one.push_n.abs() > OF_FULL * scene.full_scale_n();
                assert!(far || fast || strong, "{one:?}");
            }
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
