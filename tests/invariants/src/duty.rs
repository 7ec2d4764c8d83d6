//! Properties of the duty limit, which is a model of the motor's winding.

use std::fmt;

use proptest::prelude::*;
use zwidth::{
    Design,
    experiment::{Duty, DutyPlan, DutySettings},
    units::Force,
};

use crate::any;

/// The settings of a duty limit that are accepted, the number of outputs of a hit, and the plan.
#[derive(Clone, Copy)]
struct Motor {
    design: Design,
    settings: DutySettings,
    outputs: u32,
    plan: DutyPlan,
}

impl fmt::Debug for Motor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Motor").field(&self.design).field(&self.settings).field(&self.outputs).finish()
    }
}

impl Motor {
    fn limit(&self) -> f64 {
        (self.settings.continuous_force_n / self.design.full_scale_n).powi(2)
    }

    /// Fraction of the heat that the winding loses during an output.
    fn exchange(&self) -> f64 {
        -(-f64::from(self.design.period) / self.design.rate_hz / self.settings.time_constant_s).exp_m1()
    }
}

fn motor(longest: u32) -> impl Strategy<Value = Motor> {
    (any::design(), any::part(), any::part(), 1..longest).prop_filter_map(
        "a motor that one hit makes too warm",
        |(design, tau, force, outputs)| {
            let mut settings = DutySettings {
                continuous_force_n: f64::NAN,
                time_constant_s: any::between(1.0, 3600.0, tau),
            };
            let samples = outputs.checked_mul(design.period)?;
            let range = settings.build(&design, samples).err()?.range;
            let (low, high) = (*range.start(), *range.end());
            settings.continuous_force_n = any::between(low, high, force);
            let plan = settings.build(&design, samples).ok()?;
            Some(Motor { design, settings, outputs, plan })
        },
    )
}

/// A winding. Its heat is computed twice: by the differential equation, and by the board's model.
struct Winding {
    heat: f64,
    duty: Duty,
}

impl Winding {
    fn cold() -> Self {
        Self { heat: 0.0, duty: Duty::default() }
    }

    fn output(&mut self, motor: &Motor, part: f64) {
        let force = Force::saturating_from_bits((part * f64::from(1 << 30)) as i32);
        let part = f64::from(force.bits()) / f64::from(1 << 30);
        self.duty.add(&motor.plan, force);
        self.heat += (part * part - self.heat) * motor.exchange();
    }
}

/// Largest error of the heat. It comes from two roundings: the exchange is rounded to 2^-32, and the heat of an output
/// to 2^-40. The exchange itself reduces this error.
fn error_max(motor: &Motor) -> f64 {
    let lsb = 2f64.powi(-33);
    lsb / motor.exchange() + 2f64.powi(-41) / motor.exchange() + 1e-9
}

crate::properties! {
    /// For each accepted design, the heat is that of the differential equation, except for the rounding of its
    /// coefficient.
    heat(400, (motor, pieces) in (
        motor(2000),
        prop::collection::vec((-1.0..=1.0f64, 1u32..400), 1..8),
    )) {
        let mut winding = Winding::cold();
        for (part, outputs) in pieces {
            // Full force from time to time, as at the start of a hit.
            let part = if outputs % 5 == 0 { part.signum() } else { part };
            for _ in 0..outputs {
                winding.output(&motor, part);
                let error = error_max(&motor);
                let shown = f64::from(winding.duty.per_mille()) / 1000.0;
                assert!(shown <= winding.heat + error, "{shown} for {}", winding.heat);
                assert!(shown >= winding.heat - error - 1e-3, "{shown} for {}", winding.heat);
                let warm = winding.duty.is_too_warm(&motor.plan);
                let margin = winding.heat - motor.limit();
                assert!(margin.abs() <= error || warm == (margin > 0.0), "limit {}", motor.limit());
            }
        }
    }

    /// Hits never make the winding warmer than its limit. Each hit begins when the board reports that the motor is
    /// ready. No hit is longer than planned.
    never_too_warm(400, (motor, hits) in (
        motor(300),
        prop::collection::vec((0.0..=1.0f64, any::part(), 0u32..2000), 1..20),
    )) {
        let mut winding = Winding::cold();
        for (part, length, pause) in hits {
            let mut waited = 0;
            while !winding.duty.is_ready(&motor.plan) && waited < pause {
                winding.output(&motor, 0.0);
                waited += 1;
            }
            if !winding.duty.is_ready(&motor.plan) {
                continue;
            }
            for n in 0..any::between(1.0, f64::from(motor.outputs), length) as u32 {
                winding.output(&motor, if n % 2 == 0 { 1.0 } else { part });
                let limit = motor.limit() + error_max(&motor) * motor.limit();
                assert!(winding.heat <= limit, "{} of {limit}", winding.heat);
                assert!(!winding.duty.is_too_warm(&motor.plan));
            }
        }
    }

    /// A motor without force is ready again within the stated number of outputs, from any temperature. A cold motor is
    /// always ready.
    ready_again(60, motor in motor(2000).prop_filter("long", |motor| motor.plan.patience() < 60_000)) {
        let mut winding = Winding::cold();
        assert!(winding.duty.is_ready(&motor.plan));
        for _ in 0..motor.plan.patience() {
            winding.output(&motor, 1.0);
        }
        assert!(winding.duty.per_mille() >= 999);
        let outputs = (0..=motor.plan.patience()).find(|_| {
            winding.output(&motor, 0.0);
            winding.duty.is_ready(&motor.plan)
        });
        assert!(outputs.is_some(), "{}", winding.heat);
    }

    /// The longest hit that an error message names is accepted. A hit that is one output longer is refused.
    longest_hit(500, (design, tau, force) in (any::design(), any::part(), any::part())) {
        let settings = DutySettings {
            continuous_force_n: any::between(1e-3 * design.full_scale_n, design.full_scale_n, force),
            time_constant_s: any::between(1.0, 3600.0, tau),
        };
        let longest = settings.longest_hit_s(&design);
        assert!(longest >= 0.0);
        let samples = longest * design.rate_hz;
        if samples < f64::from(1 << 24) {
            let samples = samples.round() as u32;
            if samples > 0 {
                assert!(settings.build(&design, samples).is_ok(), "{longest}");
            }
            // One output for rounding up to a whole output, and one for the rounding of numbers.
            assert!(settings.build(&design, samples + 2 * design.period).is_err(), "{longest}");
        }
    }
}
