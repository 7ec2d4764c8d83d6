//! Any record with any options has an answer or a refusal, whatever is in it.

use super::{Gain, Options, Record, identify};
use crate::scene::NamedScene;

/// A knob whose friction varies with its angle, under a loop of its speed. The fit of the encoder's error found that
/// friction holds it at the first row, and went on with the values of a layout that had a speed there.
#[test]
fn a_start_that_friction_holds_is_no_panic_beside_the_error_of_the_encoder() {
    const RADIUS_M: f64 = 0.02;
    const COUNT_RAD: f64 = std::f64::consts::TAU / 16_000.0;
    const GAIN_N_M_PER_V: f64 = 0.387;
    let (mut x, mut v, mut before, mut speed, mut sum) = (0.0_f64, 0.0_f64, 0.0, 0.0, 0.0);
    let (mut voltage_v, mut position_m) = (vec![], vec![]);
    for row in 0..401 {
        let count = (x / COUNT_RAD).floor() * COUNT_RAD;
        speed += 0.3 * ((count - before) * 100.0 - speed);
        before = count;
        let error = if row >= 50 { 6.0 } else { 0.0 } - speed;
        sum += 0.01 * error;
        let volts = 0.4 * error + sum;
        voltage_v.push(volts);
        position_m.push(count * RADIUS_M);
        for _ in 0..100 {
            let friction = 0.05 * (1.0 + 0.1 * x.sin());
            if v <= 0.0 && GAIN_N_M_PER_V * volts <= friction {
                continue;
            }
            let next = v + 1e-4 * (GAIN_N_M_PER_V * volts - 5e-4 * v - friction) / 0.0128;
            x += 5e-5 * (v + next);
            v = next.max(0.0);
        }
    }
    let (name, start_s, step_s) = ("made".into(), 0.0, 0.01);
    let record = Record { name, start_s, step_s, voltage_v, position_m, may_clip: true };
    let scene = NamedScene::load("paper-1um").unwrap().scene;
    let options = Options {
        latency_s: 0.0,
        spring: false,
        resolution_m: COUNT_RAD * RADIUS_M,
        ..Options::of_scene(&scene, Gain::Given(GAIN_N_M_PER_V / RADIUS_M))
    };
    let found = identify(&[record], &options);
    assert!(found.as_ref().is_ok_and(|found| found.terms.phase.is_some()), "{found:?}");
}
