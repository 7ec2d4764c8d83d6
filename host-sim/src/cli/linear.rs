//! `linear`: the stability boundary of a free handle, without quantisation, without saturation and with a two-sided
//! wall.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use zwidth::VelocitySettings;

use super::{Common, shared::AtCutoffs};
use crate::{
    analysis::{
        linear::{Boundary, StiffnessLimit, passivity::Passivity},
        overview::{Explained, explain, passive_region},
    },
    error::Error,
    interrupt,
    output::{
        estimated::print_of,
        figure::{self, Curve, ZwidthPlot},
        table::Kind,
    },
    scene::{self, NamedScene, Units},
    simulation::prepared::PreparedScene,
    study::{
        asked::{Walls, linear_loop, prepare},
        boundary::BoundaryPoint,
    },
};

/// Linear stability boundary K(B) per cutoff (paper, section 2.1), from the closed loop's
/// characteristic equation.
#[derive(Debug, Args)]
pub struct LinearArgs {
    #[command(flatten)]
    at: AtCutoffs,
    /// Use the scene's output period and latency. Without this option, the loop has an output at every sample and no
    /// latency, as in the paper's equations (3) to (5). Both loops have the scene's linear elements.
    #[arg(long)]
    multirate: bool,
    /// Add the largest K of passive walls in the same loop: no motion of the handle takes energy out of wall and device
    /// damping. This K is valid for any load on the handle, also for a load that changes with time.
    #[arg(long)]
    passivity: bool,
    /// Add the simulated boundary, and explain its points above the linear envelope.
    #[arg(long, requires = "multirate")]
    simulated: bool,
    /// Write the boundary as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw the boundary; .svg or .png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    multirate: bool,
    /// Tables of the scene that linear analysis leaves out.
    left_out: &'a [&'static str],
    /// Parts of the scene that the passivity condition leaves out. Only with `--passivity`.
    #[serde(skip_serializing_if = "Option::is_none")]
    passivity_left_out: Option<&'a [&'static str]>,
    rows: Vec<&'a Row>,
    /// The simulated boundary. Empty if the user has not asked for it.
    simulated: Vec<SimulatedRow>,
}

#[derive(Serialize)]
struct SimulatedRow {
    cutoff_hz: f64,
    damping_n_s_per_m: f64,
    stiffness_n_per_m: f64,
    /// Largest K of the linear envelope at this B. `null` in JSON if every K is stable.
    linear_n_per_m: f64,
    /// Intervals of K above the envelope in which the linear loop is stable.
    further_stable_n_per_m: Vec<(f64, f64)>,
    /// Whether the linear loop is unstable at this wall. If the loop is unstable, the motion is a limit cycle.
    linearly_unstable: bool,
    rms_m: f64,
    saturated_fraction: f64,
}

#[derive(Serialize)]
struct Row {
    cutoff_hz: f64,
    true_cutoff_hz: f64,
    damping_n_s_per_m: f64,
    /// The loop is stable for every K from 0 to this value. `null` in JSON if every K is stable.
    stiffness_max_n_per_m: f64,
    /// Whether the loop is unstable even at K = 0.
    unstable_at_zero: bool,
    /// Whether the paper's gain-margin method gives the same result.
    gain_margin_holds: bool,
    /// Further intervals of K, above the first, in which the loop is stable: lower and upper end of each interval.
    further_stable_n_per_m: Vec<(f64, f64)>,
    /// Number of K > 0 at which roots cross the unit circle. With more than one, the paper's method must select one of
    /// them.
    phase_crossings: usize,
    /// Largest K for which all walls from 0 on are passive for a damped mass. 0 if no wall is passive. Only with
    /// `--passivity`.
    #[serde(skip_serializing_if = "Option::is_none")]
    stiffness_passive_n_per_m: Option<f64>,
}

/// Largest number of points of a boundary. All points are kept in memory until the end.
const POINTS_MAX: usize = 1_000_000;

struct Analysis {
    cutoff_hz: f64,
    rows: Vec<Row>,
    /// Empty if the user has not asked for passive walls.
    passive_region: Vec<BoundaryPoint>,
    simulated: Vec<Explained>,
}

pub fn run(args: &LinearArgs, common: &Common) -> Result<(), Error> {
    let (scene, Walls { filters, dampings, .. }) = args.at.load(&[0.0], None)?;
    let points = filters.len() * dampings.len();
    if points > POINTS_MAX {
        return Err(Error::Input(format!(
            "--cutoffs and --dampings make {points} points, allowed {POINTS_MAX}"
        )));
    }
    let units = scene.scene.units;
    let mut outputs = common.outputs(&scene.files)?;
    let file = outputs.table(args.csv.as_ref(), Kind::Rows, Some(&scene))?;
    let plot = outputs.figure(args.plot.as_ref())?;
    let prepared = args.simulated.then(|| prepare(&scene)).transpose()?;
    let analyses: Result<Vec<Analysis>, Error> = filters
        .par_iter()
        .map(|&filter| analyse(&scene, filter, &dampings, args, prepared.as_ref(), common))
        .collect();
    let analyses = analyses?;
    outputs.tell(file, units, || csv(&analyses))?;
    outputs.draw(plot, || draw(&scene, &analyses, args.multirate))?;
    outputs.commit()?;
    let left_out = scene.scene.nonlinear_elements();
    let passivity_left_out =
        args.passivity.then(|| passivity_left_out(&scene.scene, args.multirate));
    let json = Json {
        scene: &scene.name,
        multirate: args.multirate,
        left_out: &left_out,
        passivity_left_out: passivity_left_out.as_deref(),
        rows: all_rows(&analyses).collect(),
        simulated: analyses.iter().flat_map(simulated_rows).collect(),
    };
    print_of(common.json, &scene.scene, json, || {
        let explained = units.text(&explanation(&analyses, &scene.scene));
        let mut text = table(&analyses, units) + &explained;
        for (what, left_out) in [
            ("not linear, left out", Some(&left_out)),
            ("not part of the passivity condition", passivity_left_out.as_ref()),
        ] {
            if let Some(left_out) = left_out.filter(|left_out| !left_out.is_empty()) {
                let _ = write!(text, "\n{what}: {}", left_out.join(", "));
            }
        }
        text
    })
}

/// The parts of a scene that the passivity condition leaves out. The condition is only valid for a damped mass.
fn passivity_left_out(scene: &scene::Scene, multirate: bool) -> Vec<&'static str> {
    let linear = [
        ("actuator.period", !multirate && scene.actuator.period > 1),
        ("actuator.latency", !multirate && scene.actuator.latency > 0.0),
        ("amplifier", scene.amplifier.is_some()),
        ("mode", scene.mode.is_some()),
        ("arm", scene.arm.is_some()),
    ];
    let present = linear.into_iter().filter_map(|(name, present)| present.then_some(name));
    present.chain(scene.nonlinear_elements()).collect()
}

fn simulated_rows(analysis: &Analysis) -> impl Iterator<Item = SimulatedRow> {
    analysis.simulated.iter().map(|explained| SimulatedRow {
        cutoff_hz: analysis.cutoff_hz,
        damping_n_s_per_m: explained.point.damping_n_s_per_m,
        stiffness_n_per_m: explained.point.stiffness_n_per_m,
        linear_n_per_m: explained.linear_n_per_m,
        further_stable_n_per_m: explained.further_stable_n_per_m.clone(),
        linearly_unstable: explained.is_unstable(),
        rms_m: explained.report.rms_m,
        saturated_fraction: explained.report.saturated_fraction,
    })
}

/// Explains the points of the simulated boundary, with a sentence for each cutoff.
fn explanation(analyses: &[Analysis], scene: &scene::Scene) -> String {
    let rms_limit_m = scene.wall_hit.rms_limit_m;
    let mut text = String::new();
    for Analysis { cutoff_hz, simulated, .. } in analyses {
        if simulated.is_empty() {
            continue;
        }
        let (above, below): (Vec<&Explained>, _) = simulated.iter().partition(|e| e.is_unstable());
        let largest_um = |points: &[&Explained]| {
            points.iter().map(|point| point.report.rms_m).fold(0.0, f64::max) * 1e6
        };
        let smallest_um =
            above.iter().map(|point| point.report.rms_m).fold(f64::INFINITY, f64::min) * 1e6;
        let _ = write!(
            text,
            "\n{cutoff_hz} Hz, simulated: {} of {} points are linearly stable, RMS up to {:.2} um",
            below.len(),
            simulated.len(),
            largest_um(&below)
        );
        if !above.is_empty() {
            // If the handle is at rest between two counts, the RMS is below half a count.
            let at_rest = smallest_um < 0.5e6 * scene.encoder.resolution_m;
            let what = match (at_rest, scene.nonlinear_elements().is_empty()) {
                (false, true) => "limit cycles, since the handle cannot come to rest there",
                (_, false) => "limit cycles, or at rest by what the linear analysis leaves out",
                (true, true) => "limit cycles, some of them smaller than half a count",
            };
            let _ = write!(
                text,
                "; {} are not, {}: {smallest_um:.2} to {:.2} um RMS, stable by the limit of {} um",
                above.len(),
                what,
                largest_um(&above),
                rms_limit_m * 1e6
            );
        }
    }
    text
}

fn analyse(
    scene: &NamedScene,
    filter: VelocitySettings,
    dampings: &[f64],
    args: &LinearArgs,
    prepared: Option<&PreparedScene>,
    common: &Common,
) -> Result<Analysis, Error> {
    let scene = &scene.scene;
    let of = linear_loop(scene, &filter, args.multirate)?;
    let cutoff_hz = filter.cutoff_hz().unwrap_or_default();
    let own = scene.device.damping_n_s_per_m;
    let passivity = args.passivity.then(|| Passivity::new(&of)).transpose();
    let passivity = passivity.map_err(Error::input)?;
    let passive_at = |damping| match &passivity {
        None => Ok(None),
        Some(passivity) => passivity
            .stiffness_max(own, damping)
            .map(|stiffness| Some(stiffness.unwrap_or(0.0)))
            .map_err(Error::input),
    };
    let region = match &passivity {
        None => vec![],
        Some(passivity) => passive_region(own, passivity).map_err(Error::input)?,
    };
    let boundary = Boundary::new(&of).map_err(Error::input)?;
    let rows = dampings.iter().map(|&damping_n_s_per_m| {
        interrupt::check()?;
        let limit: StiffnessLimit = boundary.at(damping_n_s_per_m).map_err(Error::input)?;
        Ok(Row {
            cutoff_hz,
            true_cutoff_hz: scene.true_cutoff_hz(cutoff_hz),
            damping_n_s_per_m,
            stiffness_max_n_per_m: limit.stiffness_max,
            unstable_at_zero: limit.unstable_at_zero,
            gain_margin_holds: limit.gain_margin_holds(),
            phase_crossings: limit.phase_crossings.len(),
            further_stable_n_per_m: limit.further_stable,
            stiffness_passive_n_per_m: passive_at(damping_n_s_per_m)?,
        })
    });
    let rows: Vec<Row> = rows.collect::<Result<_, Error>>()?;
    let simulated = match prepared {
        None => vec![],
        Some(prepared) => {
            explain(common.engine, prepared, common.numeric, filter, &boundary, interrupt::flag())?
        }
    };
    Ok(Analysis { cutoff_hz, rows, passive_region: region, simulated })
}

fn csv(analyses: &[Analysis]) -> String {
    let mut text = String::from("cutoff_hz,damping_n_s_per_m,stiffness_max_n_per_m");
    let passivity = all_rows(analyses).any(|row| row.stiffness_passive_n_per_m.is_some());
    text.push_str(if passivity { ",stiffness_passive_n_per_m\n" } else { "\n" });
    for row in all_rows(analyses) {
        let (f, b, k) = (row.cutoff_hz, row.damping_n_s_per_m, row.stiffness_max_n_per_m);
        let _ = write!(text, "{f},{b},{k}");
        if let Some(passive) = row.stiffness_passive_n_per_m {
            let _ = write!(text, ",{passive}");
        }
        text.push('\n');
    }
    text
}

fn all_rows(analyses: &[Analysis]) -> impl Iterator<Item = &Row> {
    analyses.iter().flat_map(|analysis| &analysis.rows)
}

/// The curves of one cutoff: the linear, the passive and the simulated boundary.
fn curves(scene: &NamedScene, analysis: &Analysis) -> Vec<Curve> {
    let Analysis { cutoff_hz, rows, passive_region, simulated } = analysis;
    let finite = rows.iter().filter(|row| row.stiffness_max_n_per_m.is_finite());
    let points = finite.map(|row| BoundaryPoint {
        damping_n_s_per_m: row.damping_n_s_per_m,
        stiffness_n_per_m: row.stiffness_max_n_per_m,
    });
    let true_hz = scene.scene.true_cutoff_hz(*cutoff_hz);
    let linear = Curve::of_cutoff(*cutoff_hz, true_hz, false, points.collect());
    if passive_region.is_empty() && simulated.is_empty() {
        return vec![linear];
    }
    let named = |kind: &str, points: Vec<BoundaryPoint>| Curve {
        name: format!("{} {kind}", linear.name),
        detail: format!("{}: {kind}", linear.detail),
        ideal: false,
        points,
    };
    let mut curves = vec![named("linear", linear.points.clone())];
    if !passive_region.is_empty() {
        curves.push(named("passive", passive_region.clone()));
    }
    if !simulated.is_empty() {
        curves.push(named("simulated", simulated.iter().map(|e| e.point).collect()));
    }
    curves
}

fn draw(
    scene: &NamedScene,
    analyses: &[Analysis],
    multirate: bool,
) -> Result<figure::Figure, Error> {
    let curves = analyses.iter().flat_map(|analysis| curves(scene, analysis));
    let actuator = &scene.scene.actuator;
    let subtitle = if multirate {
        format!("an output every {} samples, latency {} samples", actuator.period, actuator.latency)
    } else {
        "a force with every sample and at once (paper, section 2.1)".into()
    };
    Ok(figure::zwidth(&ZwidthPlot {
        title: format!("Uncoupled stability, linear, {}", scene.name),
        subtitle,
        units: scene.scene.units,
        marked: "ideal",
        legend: Curve::CUTOFF_LEGEND.into(),
        curves: curves.collect(),
    })?)
}

/// A note for a point at which the paper's gain-margin method fails or is ambiguous. Otherwise `None`.
fn gain_margin(row: &Row) -> Option<String> {
    let several = match row.phase_crossings {
        0 | 1 => String::new(),
        crossings => format!(", {crossings} phase crossings"),
    };
    if row.unstable_at_zero {
        Some(format!("gain margin fails: unstable at K = 0{several}"))
    } else if !row.gain_margin_holds && row.phase_crossings == 0 {
        Some("gain margin fails: no phase crossing".into())
    } else if !row.gain_margin_holds {
        Some(format!("gain margin fails{several}"))
    } else {
        (row.phase_crossings > 1)
            .then(|| format!("{} phase crossings, the smallest is the limit", row.phase_crossings))
    }
}

fn table(analyses: &[Analysis], units: Units) -> String {
    let ((k_unit, k_times), (b_unit, b_times)) = (units.written("N/m"), units.written("N s/m"));
    let told = |k: f64| match units {
        Units::Linear => format!("{k:.1}"),
        Units::Rotary { .. } => format!("{:.4}", k * k_times),
    };
    let mut text = format!(
        "{:>10} {:>10} {:>14}  {}",
        "cutoff Hz",
        format!("B {b_unit}"),
        format!("K max {k_unit}"),
        "remark"
    );
    for row in all_rows(analyses) {
        let mut remarks: Vec<String> = vec![];
        remarks.extend(gain_margin(row));
        if let Some(passive) = row.stiffness_passive_n_per_m {
            remarks.push(match passive {
                none if none <= 0.0 => "passive at no K".into(),
                _ => format!("passive up to {}", told(passive)),
            });
        }
        for (from, to) in &row.further_stable_n_per_m {
            remarks.push(format!("stable again from {} to {}", told(*from), told(*to)));
        }
        let _ = write!(
            text,
            "\n{:>10} {:>10} {:>14}  {}",
            row.cutoff_hz,
            Units::told(row.damping_n_s_per_m, b_times),
            told(row.stiffness_max_n_per_m),
            remarks.join("; ")
        );
    }
    text
}
