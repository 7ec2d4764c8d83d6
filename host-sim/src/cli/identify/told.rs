//! Output of an identification for people: rows, table, CSV, figure.

use std::{fmt::Write as _, path::Path};

use super::of_records;
use crate::{
    analysis::identify::{CONFIDENCE, Drive, Estimate, Identification, Options, Record, Tested},
    error::Error,
    output::figure::{self, ResponsePlot},
    scene::Units,
};

/// A smaller p of a test is not printed.
const SMALL_P: f64 = 1e-6;

/// A parameter as people read it.
pub(super) struct Row {
    name: &'static str,
    unit: &'static str,
    estimate: Estimate,
}

impl Row {
    /// The row as text with name, value and interval. Half the width of the interval has two digits.
    pub(super) fn text(&self) -> String {
        let Self { name, unit, estimate: Estimate { value, half_width, .. } } = self;
        if *half_width == 0.0 {
            return format!("{name:<14} {value} {unit} (given)");
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let decimals = (1.0 - half_width.log10().floor()).clamp(0.0, 12.0) as usize;
        format!("{name:<14} {value:.decimals$} +- {half_width:.decimals$} {unit}")
    }
}

pub(super) fn rows(found: &Identification, options: &Options, units: Units) -> Vec<Row> {
    let row = |name, unit, Estimate { value, half_width, white_half_width }| {
        let (unit, times) = if unit == "rad" { (unit, 1.0) } else { units.written(unit) };
        let told = |number| Units::told(number, times);
        let estimate = Estimate {
            value: told(value),
            half_width: told(half_width),
            white_half_width: told(white_half_width),
        };
        Row { name, unit, estimate }
    };
    let [mass, rest] = match units.is_rotary() {
        true => ["inertia", "rest angle"],
        false => ["mass", "rest position"],
    };
    let mut rows =
        vec![row(mass, "kg", found.mass_kg), row("damping", "N s/m", found.damping_n_s_per_m)];
    if let Some(spring) = &found.spring {
        rows.push(row("stiffness", "N/m", spring.stiffness_n_per_m));
        rows.push(row(rest, "m", spring.rest_position_m));
    }
    match found.drive {
        Drive::Voltage => rows.push(row("gain", "N/V", found.gain_n_per_v)),
        Drive::Current => rows.push(row("gain", "N/A", found.gain_n_per_v)),
        Drive::Force => {}
    }
    if options.fit_latency || options.latency_s > 0.0 {
        rows.push(row("latency", "s", found.latency_s));
    }
    let terms = &found.terms;
    rows.extend(terms.friction_n.map(|friction| row("friction", "N", friction)));
    if let Some(stribeck) = &terms.stribeck {
        rows.push(row("  at rest", "N", stribeck.static_n));
        rows.push(row("  falls over", "m/s", stribeck.speed_m_per_s));
    }
    rows.extend(terms.lag_s.map(|lag| row("amplifier lag", "s", lag)));
    rows.extend(terms.offset_n.map(|offset| row("offset", "N", offset)));
    // This row is the same model, written with one friction level for each direction.
    if let (Some(friction), Some(offset)) = (terms.friction_n, terms.offset_n) {
        let level = |sign: f64| Estimate {
            value: friction.value + sign * offset.value,
            half_width: friction.half_width + offset.half_width,
            white_half_width: friction.white_half_width + offset.white_half_width,
        };
        rows.push(row("  friction in +", "N", level(-1.0)));
        rows.push(row("  friction in -", "N", level(1.0)));
    }
    if let Some(cogging) = &terms.cogging {
        rows.push(row("cogging", "N", cogging.amplitude_n));
        rows.push(row("  pitch", "m", cogging.pitch_m));
        rows.push(row("  phase at 0", "rad", cogging.phase_rad));
    }
    if let Some(phase) = &terms.phase {
        rows.push(row("encoder error", "m", phase.first_m));
        rows.push(row("  per cycle of", "m", phase.cycle_m));
        rows.push(row("  phase at 0", "rad", phase.phase_rad));
        rows.extend((phase.second_m.half_width > 0.0).then(|| row("  twice", "m", phase.second_m)));
    }
    rows
}

/// Voltage, measured position and modelled position of a record, as CSV.
pub(super) fn csv(record: &Record, found: &Identification) -> String {
    let column = record.command_column();
    let mut text = format!("time_s,{column},position_m,model_m,residual_m\n");
    for [time_s, command, position_m, model_m, residual_m] in found.fits[0].rows(record) {
        let _ = writeln!(text, "{time_s:.7},{command},{position_m},{model_m:.9},{residual_m:.3e}");
    }
    text
}

pub(super) fn draw(
    record: &Record,
    found: &Identification,
    units: Units,
) -> Result<figure::Figure, Error> {
    let fit = &found.fits[0];
    let spring = found.spring.as_ref().map_or("no spring".to_owned(), |spring| {
        let (k, x0) = (spring.stiffness_n_per_m.value, 1e3 * spring.rest_position_m.value);
        format!("k = {}, x0 = {}", units.said(k, "N/m"), units.said(x0, "mm"))
    });
    let stem = Path::new(&record.name).file_stem().unwrap_or_default().to_string_lossy();
    let (command_title, told) = match (record.drive, units) {
        (Drive::Voltage, _) => ("u [V]", 1.0),
        (Drive::Current, _) => ("i [A]", 1.0),
        (Drive::Force, Units::Linear) => ("F [N]", 1.0),
        (Drive::Force, Units::Rotary { .. }) => ("Torque [N m]", units.written("N").1),
    };
    Ok(figure::pulse_response(&ResponsePlot {
        title: format!("Measured response and identified model, {stem}"),
        subtitle: format!(
            "{} = {}, b = {}, {spring}; residual {} RMS",
            if units.is_rotary() { "J" } else { "m" },
            units.said(found.mass_kg.value, "kg"),
            units.said(found.damping_n_s_per_m.value, "N s/m"),
            units.said(found.residual.rms_m * 1e6, "µm")
        ),
        start_s: record.start_s,
        step_s: record.step_s,
        command: record.command.iter().map(|command| command * told).collect(),
        command_title,
        measured_m: record.position_m.clone(),
        first: fit.first,
        model_m: fit.model_m.clone(),
        residual_m: fit.residual_m.clone(),
        units,
    })?)
}

pub(super) fn table(
    records: &[Record],
    found: &Identification,
    options: &Options,
    units: Units,
) -> String {
    let count: usize = found.fits.iter().map(|fit| fit.model_m.len()).sum();
    let percent = CONFIDENCE * 100.0;
    let mut text = format!("{}: {count} rows, {percent} % intervals", of_records(records));
    for row in rows(found, options, units) {
        let _ = write!(text, "\n  {}", row.text());
    }
    for Tested { term, p, .. } in &found.terms.tests {
        let p = if *p < SMALL_P { format!("p < {SMALL_P:e}") } else { format!("p = {p:.1e}") };
        let _ = write!(text, "\n  test of {} against 0: {p}", term.name());
    }
    let residual = &found.residual;
    let _ = write!(text, "\nresidual {} RMS", units.said(residual.rms_m * 1e6, "um"));
    let white = if residual.is_white() { "white" } else { "not white" };
    if let (Some(rms), Some(noise)) = (residual.rms_counts, residual.noise_counts) {
        let _ = write!(text, " = {rms:.3} counts");
        if residual.is_white() || residual.is_bound_by_quantisation() {
            let _ = write!(text, ": quantisation and noise of {noise:.3} counts");
        }
    }
    let _ = write!(text, "; {white} (Ljung-Box p = {:.2e})", residual.whiteness_p);
    for warning in &found.warnings {
        let _ = write!(text, "\nwarning: {warning}");
    }
    text
}
