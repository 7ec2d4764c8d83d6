//! The return move between two hits.

use std::fmt;

use proptest::prelude::*;
use zwidth::{
    Design,
    experiment::{Return, ReturnPlan, ReturnSettings, ReturnStep},
    units::{Force, Position},
};

use crate::any::{self, Random};

#[derive(Clone, Copy)]
struct Move {
    design: Design,
    settings: ReturnSettings,
    plan: ReturnPlan,
}

impl fmt::Debug for Move {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Move").field(&self.design).field(&self.settings).finish()
    }
}

impl Move {
    fn output_s(&self) -> f64 {
        f64::from(self.design.period) / self.design.rate_hz
    }

    fn start(&self) -> i64 {
        self.plan.start().counts().into()
    }

    fn tolerance(&self) -> f64 {
        self.settings.tolerance_m / self.design.resolution_m
    }

    /// Number of outputs from one measurement of the speed to the next. It is a millisecond, or one output if outputs
    /// are rarer.
    fn pace(&self) -> u32 {
        let samples = (self.design.rate_hz / 1000.0).ceil() as u32;
        (samples / self.design.period).max(1)
    }

    fn outputs_max(&self) -> u32 {
        (self.settings.timeout_s / self.output_s()).ceil() as u32
    }
}

fn accepted() -> impl Strategy<Value = Move> {
    let parts = prop::collection::vec(any::part(), 8);
    (any::design(), parts).prop_filter_map("no range is left", |(design, parts)| {
        // An error names the number and its range. Then this number is set.
        let mut settings = ReturnSettings {
            start_m: f64::NAN,
            speed_m_per_s: f64::NAN,
            force_n: f64::NAN,
            stiffness_n_per_m: f64::NAN,
            damping_n_s_per_m: f64::NAN,
            integral_n_per_m_s: f64::NAN,
            tolerance_m: f64::NAN,
            timeout_s: f64::NAN,
        };
        for _ in 0..20 {
            let error = match settings.build(&design) {
                Ok(plan) => return Some(Move { design, settings, plan }),
                Err(error) => error,
            };
            let (place, part) = match error.parameter {
                "start_m" => (&mut settings.start_m, parts[0]),
                "return_speed_m_per_s" => (&mut settings.speed_m_per_s, parts[1]),
                "return_force_n" => (&mut settings.force_n, parts[2]),
                "return_stiffness_n_per_m" => (&mut settings.stiffness_n_per_m, parts[3]),
                "return_damping_n_s_per_m" => (&mut settings.damping_n_s_per_m, parts[4]),
                "return_integral_n_per_m_s" => (&mut settings.integral_n_per_m_s, parts[5]),
                "return_tolerance_m" => (&mut settings.tolerance_m, parts[6]),
                "return_timeout_s" => (&mut settings.timeout_s, parts[7]),
                other => panic!("{other} is no number of a return"),
            };
            let (low, high) = (*error.range.start(), *error.range.end());
            if low > high {
                return None;
            }
            *place = any::between(low, high, part);
        }
        None
    })
}

fn at(counts: i64) -> Position {
    Position::from_counts(counts.clamp(-(1 << 30), 1 << 30) as i32)
}

crate::properties! {
    /// For any position and motion of the handle, a return ends in time, with a force within its limit. In contact the
    /// force of the return never points into the wall. The return has arrived only if the handle was at rest at the
    /// start.
    bounded(150, (back, seed, mode) in (accepted(), any::<u64>(), 0u8..4)) {
        let mut random = Random(seed);
        let mut run = Return::default();
        let limit = back.settings.force_n / back.design.full_scale_n;
        let mut place = back.start() + (random.bits() as i32 >> random.below(31)) as i64;
        let rest = (0.02 / back.output_s()).ceil() as usize;
        let mut past = Vec::new();
        for n in 0..(back.outputs_max() + 4).min(20_000) {
            match (mode, random.below(8)) {
                (0, _) => {}
                (1, 0) => place = back.start() + (random.bits() as i32 >> random.below(31)) as i64,
                (2, _) => place += (back.start() - place) / 50,
                (_, _) => place += random.below(7) as i64 - 3,
            }
            let contact = mode == 3 && random.below(2) == 0;
            past.push(at(place).counts());
            match run.output(&back.plan, at(place), contact) {
                ReturnStep::Push(force) => {
                    let part = f64::from(force.bits()) / f64::from(1 << 30);
                    assert!(part.abs() <= limit && limit <= 0.5, "{part} of {limit}");
                    assert!(!contact || part <= 0.0);
                    assert!(n <= back.outputs_max() + 1);
                }
                ReturnStep::Arrived => {
                    let recent = &past[past.len() - rest.min(past.len())..];
                    let near = |x: &i32| (f64::from(*x) - back.start() as f64).abs() <= 2.0 * back.tolerance();
                    assert!(recent.iter().all(near));
                    break;
                }
                ReturnStep::TooLong => {
                    assert!(n + 2 >= back.outputs_max());
                    break;
                }
            }
        }
    }

    /// Every accepted return move begins. A handle that rests away from the start is soon pushed towards the start, and
    /// in no other direction.
    begins(300, (back, away, side) in (accepted(), 0.0..1.0f64, any::<bool>())) {
        // Outside the tolerance, and inside the range of positions.
        let far = back.tolerance() * 2.0 + away * 1e6 + 10.0;
        let place = if side { back.start() + far as i64 } else { back.start() - far as i64 };
        if place.abs() > 1 << 30 {
            return Ok(());
        }
        let mut run = Return::default();
        let towards = if side { -1 } else { 1 };
        // Time in which the reference moves a thousand counts, or the whole distance.
        let speed = back.settings.speed_m_per_s * back.output_s() / back.design.resolution_m;
        let soon = (far.min(1000.0) / speed).ceil() as u32 + 10;
        let lsb = f64::from(1 << 30) / back.design.full_scale_n * back.design.resolution_m;
        if back.settings.stiffness_n_per_m * lsb < 1.0 {
            return Ok(()); // a thousand counts give hardly one LSB of force
        }
        let mut pushed = false;
        for _ in 0..soon.min(back.outputs_max()).min(100_000) {
            let ReturnStep::Push(force) = run.output(&back.plan, at(place), false) else { break };
            assert!(force.bits() * towards >= 0, "{force:?} away from the start");
            pushed |= force != Force::ZERO;
        }
        assert!(pushed || soon >= back.outputs_max() || soon >= 100_000);
    }

    /// A hand moves the handle towards the start, at any speed, and holds it there. The handle is never pushed away
    /// from the start.
    never_away(300, (back, way, goes) in (
        accepted(),
        (0.0..1.0f64, any::<bool>()),
        prop::collection::vec((any::part(), 0u16..200, 8u16..60), 1..5),
    )) {
        let far = way.0 * 0.2 / back.design.resolution_m + 10.0;
        if far + back.start().abs() as f64 > f64::from(1 << 30) {
            return Ok(());
        }
        let side = if way.1 { 1 } else { -1 };
        let mut run = Return::default();
        let mut distance = far as i64;
        // The speed is measured over eight intervals.
        let span = 9 * back.pace();
        let mut stood = span;
        for (speed, moving, holding) in goes {
            let step = any::between(1e-3, 1.0, speed) * back.output_s() / back.design.resolution_m;
            let moving = u32::from(moving);
            for n in 0..moving + u32::from(holding) * back.pace() {
                stood += 1;
                if n < moving {
                    distance = (distance - step.ceil() as i64).max(0);
                    stood = 0;
                }
                let place = back.start() + side * distance;
                let ReturnStep::Push(force) = run.output(&back.plan, at(place), false) else { return Ok(()) };
                if stood >= span {
                    assert!(i64::from(force.bits()) * side <= 0, "{force:?} at {distance} counts from the start");
                }
            }
        }
    }
}
