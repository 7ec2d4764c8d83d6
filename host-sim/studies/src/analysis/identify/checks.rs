//! Checks a record before and after the fit. Each refusal says its reason.

use std::ops::RangeInclusive;

use super::{
    Drive, Options,
    confidence::{Estimate, Estimates},
    layout::Included,
    record::{IN_MM, Record, range},
    terms::{FAMILY_P, Term, Tested, said},
};
use crate::{range::refused, scene::ranges};

/// Smallest travel of a record, in counts.
const FEWEST_COUNTS: f64 = 20.0;
/// Largest distance of a position from a whole count, in counts. The tolerance allows for the rounding of printed
/// numbers.
const OFF_GRID_MAX: f64 = 0.01;
/// Smallest change of the voltage, as a share of its limit. A smaller change does not excite the device.
const EXCITATION_MIN: f64 = 1e-4;
/// Smallest share of the motion's variance that the model must explain. If it explains less, effects outside the model
/// are as large as the parameters themselves.
pub(super) const EXPLAINED_MIN: f64 = 0.99;
/// Smallest effect on the response with which a parameter does not count as 0, as a share. The largest effect over the
/// whole record counts.
const NEGLIGIBLE: f64 = 0.1;

/// Refuses a record that cannot be fitted.
pub(super) fn before(record: &Record, first: usize, options: &Options) -> Result<(), String> {
    record.check()?;
    let limit_v = options.limit_v;
    let commands = &record.command;
    if record.may_clip
        && let Some(row) = commands.iter().position(|v| v.abs() >= limit_v * (1.0 - 1e-9))
    {
        return Err(format!(
            "the voltage is {} V at {:.4} s, at or beyond actuator.limit_v of {limit_v} V: what acted there is not \
             known; use a smaller pulse, or a scene with the true limit",
            commands[row],
            record.time_s(row)
        ));
    }
    let (low, high) = range(&commands[..commands.len() - first]);
    let (drive, unit) = (record.drive, record.drive.unit());
    let least = if drive == Drive::Voltage { EXCITATION_MIN * limit_v } else { 0.0 };
    if high - low <= least {
        return Err(format!(
            "no excitation: the {drive} stays at {low} {unit}; mass, damping and stiffness show only where it changes"
        ));
    }
    let (low, high) = range(&record.position_m);
    let resolution_m = options.resolution_m;
    if high - low <= FEWEST_COUNTS * resolution_m {
        let counts = if resolution_m > 0.0 { ((high - low) / resolution_m).round() } else { 0.0 };
        return Err(format!(
            "no motion: the position moves by {counts} counts in all, more than {FEWEST_COUNTS} are needed"
        ));
    }
    if resolution_m > 0.0 { on_grid(record, resolution_m) } else { Ok(()) }
}

/// Size of a count in m, by the smallest difference of two positions. `None` if the positions are no multiples of it.
pub(super) fn grid(records: &[Record]) -> Option<f64> {
    let step = |record: &Record| {
        let mut levels = record.position_m.clone();
        levels.sort_by(f64::total_cmp);
        let steps = levels.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > SAME_M);
        steps.fold(f64::INFINITY, f64::min)
    };
    let step_m = records.iter().map(step).fold(f64::INFINITY, f64::min);
    let count_m =
        format!("{step_m:.6e}").parse().ok().filter(|step| RESOLUTION_M.contains(step))?;
    records.iter().all(|record| on_grid(record, count_m).is_ok()).then_some(count_m)
}

/// Values in m that `--resolution` may have. A scene allows the same range. The option may also be 0.
pub(super) const RESOLUTION_M: RangeInclusive<f64> = 1e-8..=1e-3;
/// Positions that differ by less, in m, are the same.
const SAME_M: f64 = 1e-11;

/// Refuses positions that cannot be counts of an encoder with this resolution.
fn on_grid(record: &Record, resolution_m: f64) -> Result<(), String> {
    // Software may have set the zero of the positions, so the zero need not be at a count.
    let first = record.position_m[0] / resolution_m;
    let counts = record.position_m.iter().map(|x| x / resolution_m);
    let off = |count: &f64| (count - first - (count - first).round()).abs();
    if let Some((row, count)) =
        counts.clone().enumerate().find(|(_, count)| off(count) > OFF_GRID_MAX)
    {
        let from_first = count - first;
        return Err(format!(
            "the position at {:.4} s is {from_first:.3} counts of {resolution_m} m from the first; give the encoder's \
             --resolution in m, or 0 for a sensor without counts",
            record.time_s(row)
        ));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let moved = counts.map(|count| (count - first).round().abs() as u64);
    let step = moved.fold(0, gcd);
    if step > 1 {
        let cause = if step % 1000 == 0 { IN_MM } else { "" };
        return Err(format!(
            "the position moves in steps of {step} counts of {resolution_m} m; give the encoder's --resolution, \
             here {:.6e} in m{cause}",
            step as f64 * resolution_m
        ));
    }
    Ok(())
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Refuses the fit if the model does not follow the motion.
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

/// Error message for a record that does not show the mass. `explained` is the share of the variance that a device
/// without a mass explains.
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

/// Usual mass, force and speed of a hand-held handle.
const USUAL_KG: RangeInclusive<f64> = 0.005..=20.0;
const USUAL_FORCE_N: f64 = 500.0;
const USUAL_SPEED_M_PER_S: f64 = 20.0;

/// Warnings about values that a hand-held device cannot have. Each names the likely cause.
pub(super) fn questions(mass_kg: f64, force_n: f64, speed_m_per_s: f64) -> Vec<String> {
    let mut questions = vec![];
    if !USUAL_KG.contains(&mass_kg) {
        let mass = match mass_kg < 1.0 {
            true => format!("{:.1} g", 1e3 * mass_kg),
            false => format!("{mass_kg:.1} kg"),
        };
        questions.push(format!(
            "a handle of {mass}: is --gain in N/V and position_m in m, time_s in s?"
        ));
    }
    if force_n > USUAL_FORCE_N {
        questions.push(format!("a force of {force_n:.0} N: is the gain in N/V, the voltage in V?"));
    }
    if speed_m_per_s > USUAL_SPEED_M_PER_S {
        questions.push(format!(
            "a speed of {speed_m_per_s:.0} m/s: is position_m in m and time_s in s?"
        ));
    }
    questions
}

/// A step is reported if it has at least `STEP_COUNTS` counts, and is more than `STEP_PER_RMS` times the RMS of the
/// steps around it.
const STEP_COUNTS: f64 = 3.0;
const STEP_PER_RMS: f64 = 6.0;
/// A step is compared with `AROUND` rows on each side. The new level must last for `STAYS` rows.
const AROUND: usize = 50;
const STAYS: usize = 5;

/// Finds a lasting step of the residual. Returns the row in which it comes, counted from the first row, and its size in
/// counts. A force cannot cause such a step of the position.
pub(super) fn step(residual_counts: &[f64]) -> Option<(usize, f64)> {
    let steps: Vec<f64> = residual_counts.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let middle = |rows: &[f64]| {
        let mut rows = rows.to_vec();
        rows.sort_by(f64::total_cmp);
        rows[rows.len() / 2]
    };
    (STAYS..steps.len().saturating_sub(STAYS)).find_map(|row| {
        let step = steps[row];
        if step.abs() < STEP_COUNTS {
            return None;
        }
        let around = row.saturating_sub(AROUND)..(row + AROUND).min(steps.len());
        let rows = around.len() as f64;
        let squares: f64 = steps[around].iter().map(|step| step * step).sum();
        let rms = ((squares - step * step) / rows).max(0.0).sqrt();
        let before = middle(&residual_counts[row + 1 - STAYS..=row]);
        let stays = middle(&residual_counts[row + 1..=row + STAYS]) - before;
        let is_step = step.abs() > STEP_PER_RMS * rms && stays / step > 0.5;
        is_step.then_some((row + 1, step))
    })
}

/// Warnings about requested terms that the record does not distinguish from 0.
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

/// Refuses estimates that the record does not support. Returns warnings. `seconds` is the length of the longest record.
pub(super) fn after(
    found: &Estimates,
    tests: &[Tested],
    seconds: f64,
) -> Result<Vec<String>, String> {
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
        // A damping b changes the response over the record by about `b seconds / m`. Friction can hide this change.
        let is_friction = |one: &Tested| one.term == Term::Friction && one.p < FAMILY_P;
        let has_loss = found.hidden != Included::default() || tests.iter().any(is_friction);
        if !has_loss && damping.half_width * seconds > NEGLIGIBLE * mass.value {
            return Err(format!(
                "the record does not show the damping: {}; move faster, or go on until the handle has come to rest",
                with(damping, "N s/m")
            ));
        }
        warnings.push(format!("the damping cannot be told from 0: {}", with(damping, "N s/m")));
    }
    if let Some([stiffness, rest]) = spring {
        if stiffness.high() < 0.0 {
            return Err(format!(
                "the stiffness comes out negative, {}: give --no-spring if the device has none; else something pushes the \
                 handle away from rest",
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

/// Refuses a latency below `-step_s`, where `step_s` is the time between rows. A negative latency above this limit
/// gives a warning, because noise or the log's time stamps can cause a small negative value.
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
    format!("{:.3e} +- {:.3e} {unit}", estimate.value, estimate.half_width)
}
