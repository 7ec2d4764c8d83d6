//! What a record must show before and after the fit. Each refusal names its reason.

use super::{
    Options,
    confidence::{Estimate, Estimates},
    record::Record,
    terms::{FAMILY_P, Tested, said},
};
use crate::{range::refused, scene::ranges};

/// Fewest counts of motion.
const FEWEST_COUNTS: f64 = 20.0;
const TRAVEL_MAX_M: f64 = 5.0;
/// The usual cause of positions a thousand times too large.
const IN_MM: &str = "; position_m is in m: are these mm?";
/// Largest distance of a position from a whole count, counts: what printing may cost.
const OFF_GRID_MAX: f64 = 0.01;
/// A voltage whose changes are smaller than this part of the limit excites nothing.
const EXCITATION_MIN: f64 = 1e-4;
/// Least part of the motion's variance that the model must explain: beyond it the parameters of what is left out
/// are as large as those that are sought.
const EXPLAINED_MIN: f64 = 0.99;
/// A parameter that could change the response over the whole record by less than this part counts as 0.
const NEGLIGIBLE: f64 = 0.1;

/// Refuses a record that cannot be fitted.
pub(super) fn before(record: &Record, first: usize, options: &Options) -> Result<(), String> {
    record.check()?;
    let limit_v = options.limit_v;
    let voltages = &record.voltage_v;
    if record.may_clip
        && let Some(row) = voltages.iter().position(|v| v.abs() >= limit_v * (1.0 - 1e-9))
    {
        return Err(format!(
            "the voltage is {} V at {:.4} s, at or beyond actuator.limit_v of {limit_v} V: what acted there is not \
             known; use a smaller pulse, or a scene with the true limit",
            voltages[row],
            record.time_s(row)
        ));
    }
    let (low, high) = range(&voltages[..voltages.len() - first]);
    if high - low < EXCITATION_MIN * limit_v {
        return Err(format!(
            "no excitation: the voltage stays at {low} V; mass, damping and stiffness show only where it changes"
        ));
    }
    let (low, high) = range(&record.position_m);
    if high - low > TRAVEL_MAX_M {
        let travel_m = high - low;
        return Err(format!(
            "the position moves by {travel_m:.3} m, allowed {TRAVEL_MAX_M} m{IN_MM}"
        ));
    }
    let resolution_m = options.resolution_m;
    if high - low <= FEWEST_COUNTS * resolution_m {
        let counts = if resolution_m > 0.0 { ((high - low) / resolution_m).round() } else { 0.0 };
        return Err(format!(
            "no motion: the position moves by {counts} counts in all, more than {FEWEST_COUNTS} are needed"
        ));
    }
    if resolution_m > 0.0 { on_grid(record, resolution_m) } else { Ok(()) }
}

/// Refuses positions that are not the counts of an encoder of that resolution.
fn on_grid(record: &Record, resolution_m: f64) -> Result<(), String> {
    let counts = record.position_m.iter().map(|x| x / resolution_m);
    if let Some((row, count)) =
        counts.clone().enumerate().find(|(_, count)| (count - count.round()).abs() > OFF_GRID_MAX)
    {
        return Err(format!(
            "the position at {:.4} s is {count:.3} counts of {resolution_m} m; give the encoder's --resolution in m, or \
             0 for a sensor without counts",
            record.time_s(row)
        ));
    }
    let first = record.position_m[0] / resolution_m;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let moved = counts.map(|count| (count - first).round().abs() as u64);
    let step = moved.fold(0, gcd);
    if step > 1 {
        let cause = if step % 1000 == 0 { IN_MM } else { "" };
        return Err(format!(
            "the position moves in steps of {step} counts of {resolution_m} m; give the encoder's --resolution{cause}"
        ));
    }
    Ok(())
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(*value), high.max(*value))
    })
}

/// Refuses a model that does not follow the motion.
pub(super) fn explains(rms_m: f64, motion_rms_m: f64) -> Result<(), String> {
    let explained = 1.0 - (rms_m / motion_rms_m).powi(2);
    if explained >= EXPLAINED_MIN {
        return Ok(());
    }
    Err(format!(
        "the model explains {:.2} % of the motion, at least {:.0} % are needed: something else moved the handle, or \
         held it (a hand, a stop, friction)",
        100.0 * explained.max(0.0),
        100.0 * EXPLAINED_MIN
    ))
}

/// Why no mass can be found that the voltage accelerates; `explained` is what a device without a mass explains.
pub(super) fn not_driven(explained: Option<f64>) -> String {
    match explained {
        Some(explained) if explained >= EXPLAINED_MIN => format!(
            "the record does not show the mass: a device without one explains {:.2} % of the motion; damping hides it, \
             so sample faster or change the voltage faster",
            100.0 * explained
        ),
        _ => "the handle does not accelerate with the voltage: no force acts, its sign is reversed, or something else \
              moves the handle"
            .into(),
    }
}

/// A handle that a person holds is neither lighter nor heavier, kg; a force that it feels not larger, N.
const USUAL_KG: std::ops::RangeInclusive<f64> = 0.005..=20.0;
const USUAL_FORCE_N: f64 = 500.0;
const USUAL_SPEED_M_PER_S: f64 = 20.0;

/// What cannot be of a device that a person holds, each with the likely cause.
pub(super) fn questions(mass_kg: f64, force_n: f64, speed_m_per_s: f64) -> Vec<String> {
    let mut questions = vec![];
    if !USUAL_KG.contains(&mass_kg) {
        questions.push(format!(
            "a handle of {:.1} g: is --gain in N/V and position_m in m, time_s in s?",
            1e3 * mass_kg
        ));
    }
    if force_n > USUAL_FORCE_N {
        questions.push(format!("a force of {force_n:.0} N: is --gain in N/V and voltage_v in V?"));
    }
    if speed_m_per_s > USUAL_SPEED_M_PER_S {
        questions.push(format!(
            "a speed of {speed_m_per_s:.0} m/s: is position_m in m and time_s in s?"
        ));
    }
    questions
}

/// Warnings of terms that were asked for and that the record does not tell from none.
pub(super) fn untold(tests: &[Tested]) -> Vec<String> {
    let untold = tests.iter().filter(|tested| tested.p >= FAMILY_P);
    untold
        .map(|tested| {
            format!(
                "the {} cannot be told from 0 ({:.1} standard errors)",
                said(tested.term),
                tested.z
            )
        })
        .collect()
}

/// Refuses estimates that the record does not hold; answers with warnings. `seconds` is the longest record's length.
pub(super) fn after(found: &Estimates, seconds: f64) -> Result<Vec<String>, String> {
    let mut warnings = vec![];
    let Estimates { mass, damping, spring, gain, .. } = found;
    if !seen(mass) {
        return Err(format!(
            "the record does not show the mass: {}; damping hides it, so sample faster or change the voltage faster",
            with(mass, "kg")
        ));
    }
    if !ranges::MASS_KG.contains(&mass.value) {
        let cause = if mass.value < *ranges::MASS_KG.start() { IN_MM } else { "" };
        return Err(refused("the identified mass_kg", mass.value, &ranges::MASS_KG) + cause);
    }
    if damping.high() < 0.0 {
        return Err(format!(
            "the damping comes out negative, {}: something drives the handle, or the latency is wrong",
            with(damping, "N s/m")
        ));
    }
    if damping.low() <= 0.0 {
        // A damping b changes the response over the record by about b seconds / m.
        if damping.half_width * seconds > NEGLIGIBLE * mass.value {
            return Err(format!(
                "the record does not show the damping: {}; make it longer",
                with(damping, "N s/m")
            ));
        }
        warnings.push(format!("the damping cannot be told from 0: {}", with(damping, "N s/m")));
    }
    if let Some([stiffness, rest]) = spring {
        if stiffness.high() < 0.0 {
            return Err(format!(
                "the stiffness comes out negative, {}: something pushes the handle away from rest",
                with(stiffness, "N/m")
            ));
        }
        if !seen(stiffness) {
            return Err(format!(
                "the record does not show the stiffness, {}, nor the rest position: make it longer, or give \
                 --no-spring if the device has none",
                with(stiffness, "N/m")
            ));
        }
        if stiffness.half_width > 0.2 * stiffness.value {
            warnings.push(format!(
                "the stiffness is known to {:.0} % only; the interval of the rest position, {}, is then rough",
                100.0 * stiffness.half_width / stiffness.value,
                with(rest, "m")
            ));
        }
    }
    match gain {
        Some(gain) if !seen(gain) => {
            Err(format!("the records do not show the gain: {}; add more mass", with(gain, "N/V")))
        }
        _ => Ok(warnings),
    }
}

/// Refuses a latency that is below 0 by more than a row of `step_s`; answers with the warning of a smaller one, which is
/// how a row is written, or noise.
pub(super) fn early(latency: &Estimate, step_s: f64) -> Result<String, String> {
    let found = with(latency, "s");
    if latency.high() < -step_s {
        return Err(format!(
            "the latency comes out negative, {found}, and no handle moves before its voltage: voltage and position are of \
             different times, or something acts that is not in the model; without --fit-latency the residual says more"
        ));
    }
    Ok(format!(
        "the latency comes out negative, {found}: it is held at 0, and all else is found with that"
    ))
}

fn seen(estimate: &Estimate) -> bool {
    estimate.low() > 0.0
}

fn with(estimate: &Estimate, unit: &str) -> String {
    format!("{:.3e} +- {:.1e} {unit}", estimate.value, estimate.half_width)
}
