//! `linear`: the uncoupled stability boundary, without quantisation, saturation and one-sided wall.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use rayon::prelude::*;
use serde::Serialize;

use super::{
    Common, SCHEMA_VERSION, check_wall, cutoff,
    list::{self, List},
    no_cutoff, print_json, print_text,
};
use crate::{
    error::Error,
    figure::{self, Curve, ZwidthPlot},
    linear::{Boundary, Device, Loop, StiffnessLimit},
    output,
    rig::WallHit,
    scene::{self, NamedScene},
    velocity::transfer_function,
    walk::BoundaryPoint,
};

/// Linear stability boundary K(B) per cutoff (paper, section 2.1), from the closed loop's
/// characteristic equation.
#[derive(Debug, Args)]
pub struct LinearArgs {
    /// Built-in scene or scene file.
    scene: String,
    /// Nominal cutoffs, Hz: A,B,C or FROM:STEP:TO; estimators without a cutoff take none.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    cutoffs: Option<List>,
    /// Dampings B of the wall, N s/m: A,B,C or FROM:STEP:TO.
    #[arg(long, value_name = "LIST", value_parser = list::parse, allow_hyphen_values = true)]
    dampings: List,
    /// The loop as it runs, with the scene's output period and latency. Without it a force with
    /// every sample and at once, as in the paper's equations (3) to (5).
    #[arg(long)]
    multirate: bool,
    /// Write the boundary as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw the boundary; .svg or .png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    schema_version: u32,
    command: &'static str,
    scene: &'a str,
    multirate: bool,
    rows: &'a [Row],
}

/// One point of the boundary.
#[derive(Serialize)]
struct Row {
    cutoff_hz: f64,
    true_cutoff_hz: f64,
    damping_n_s_per_m: f64,
    /// Stable for every K between 0 and this; `null` in JSON if no K is unstable.
    stiffness_max_n_per_m: f64,
    /// The loop is unstable already at K = 0.
    unstable_at_zero: bool,
    /// The paper's gain-margin method gives the same.
    gain_margin_holds: bool,
    /// Stretches of K, from and to, that are stable beyond the first one.
    further_stable_n_per_m: Vec<(f64, f64)>,
}

pub fn run(args: &LinearArgs, common: &Common) -> Result<(), Error> {
    let scene = NamedScene::load(&args.scene)?;
    for path in [&args.csv, &args.plot].into_iter().flatten() {
        output::refuse_existing(path, common.force)?;
    }
    if let Some(path) = &args.plot {
        output::refuse_ending(path)?;
    }
    let cutoffs_hz = match &args.cutoffs {
        Some(_) if !scene.scene.velocity.has_cutoff() => return Err(no_cutoff(&scene)),
        Some(list) => list.0.clone(),
        None => vec![cutoff(&scene, None)?],
    };
    for &cutoff_hz in &cutoffs_hz {
        for &damping_n_s_per_m in &args.dampings.0 {
            let (stiffness_n_per_m, start_offset_counts) = (0.0, 0.0);
            let wall =
                WallHit { cutoff_hz, stiffness_n_per_m, damping_n_s_per_m, start_offset_counts };
            check_wall(&scene, &wall, "--cutoffs")?;
        }
    }
    let boundaries: Result<Vec<Vec<Row>>, Error> = cutoffs_hz
        .par_iter()
        .map(|&cutoff_hz| boundary(&scene, cutoff_hz, &args.dampings.0, args.multirate))
        .collect();
    let boundaries = boundaries?;
    let rows: Vec<Row> = boundaries.into_iter().flatten().collect();
    if let Some(path) = &args.csv {
        output::write_file(path, csv(&rows).as_bytes(), common.force)?;
    }
    if let Some(path) = &args.plot {
        let figure = draw(&scene, &cutoffs_hz, &rows, args.multirate)?;
        output::write_file(path, &output::figure_bytes(path, &figure)?, common.force)?;
    }
    if common.json {
        let (schema_version, scene) = (SCHEMA_VERSION, scene.name.as_str());
        let multirate = args.multirate;
        return print_json(&Json {
            schema_version,
            command: "linear",
            scene,
            multirate,
            rows: &rows,
        });
    }
    print_text(&table(&rows))
}

fn boundary(
    scene: &NamedScene,
    cutoff_hz: f64,
    dampings: &[f64],
    multirate: bool,
) -> Result<Vec<Row>, Error> {
    let scene = &scene.scene;
    let scene::Device { mass_kg, damping_n_s_per_m, stiffness_n_per_m, .. } = scene.device;
    let rate_hz = scene.control.rate_hz;
    let device = Device { mass_kg, damping_n_s_per_m, stiffness_n_per_m };
    let estimator = transfer_function(&scene.velocity.settings(cutoff_hz), &scene.design())
        .map_err(Error::input)?
        .ok_or_else(|| {
            Error::Input(format!(
                "the estimator {} is no linear function of the position alone",
                scene.velocity.name()
            ))
        })?;
    let mut of = Loop::single_rate(device, rate_hz, estimator);
    if multirate {
        of.period = scene.actuator.period;
        of.latency_samples = scene.actuator.latency;
    }
    let boundary = Boundary::new(&of).map_err(Error::input)?;
    let rows = dampings.iter().map(|&damping_n_s_per_m| {
        let limit: StiffnessLimit = boundary.at(damping_n_s_per_m).map_err(Error::input)?;
        Ok(Row {
            cutoff_hz,
            true_cutoff_hz: scene.true_cutoff_hz(cutoff_hz),
            damping_n_s_per_m,
            stiffness_max_n_per_m: limit.stiffness_max,
            unstable_at_zero: limit.unstable_at_zero,
            gain_margin_holds: limit.gain_margin_holds(),
            further_stable_n_per_m: limit.further_stable,
        })
    });
    rows.collect()
}

fn csv(rows: &[Row]) -> String {
    let mut text = String::from("cutoff_hz,damping_n_s_per_m,stiffness_max_n_per_m\n");
    for row in rows {
        let (f, b, k) = (row.cutoff_hz, row.damping_n_s_per_m, row.stiffness_max_n_per_m);
        let _ = writeln!(text, "{f},{b},{k}");
    }
    text
}

fn draw(
    scene: &NamedScene,
    cutoffs_hz: &[f64],
    rows: &[Row],
    multirate: bool,
) -> Result<figure::Figure, Error> {
    let curves = cutoffs_hz.iter().map(|&cutoff_hz| Curve {
        cutoff_hz,
        true_cutoff_hz: scene.scene.true_cutoff_hz(cutoff_hz),
        points: rows
            .iter()
            .filter(|row| row.cutoff_hz == cutoff_hz && row.stiffness_max_n_per_m.is_finite())
            .map(|row| BoundaryPoint {
                damping_n_s_per_m: row.damping_n_s_per_m,
                stiffness_n_per_m: row.stiffness_max_n_per_m,
            })
            .collect(),
    });
    let actuator = &scene.scene.actuator;
    let subtitle = if multirate {
        format!("an output every {} samples, latency {} samples", actuator.period, actuator.latency)
    } else {
        "a force with every sample and at once (paper, section 2.1)".into()
    };
    figure::zwidth(&ZwidthPlot {
        title: format!("Uncoupled stability, linear, {}", scene.name),
        subtitle,
        curves: curves.collect(),
        ideal_cutoff_hz: None,
    })
    .map_err(|error| Error::Internal(format!("cannot draw: {error}")))
}

fn table(rows: &[Row]) -> String {
    let mut text = format!(
        "{:>10} {:>10} {:>14}  {}\n{:>10} {:>10} {:>14}",
        "cutoff Hz", "B N s/m", "K max N/m", "remark", "", "", ""
    );
    for row in rows {
        let remark = if row.unstable_at_zero {
            "unstable at K = 0"
        } else if row.gain_margin_holds {
            ""
        } else {
            "the gain margin is not defined here"
        };
        let _ = write!(
            text,
            "\n{:>10} {:>10} {:>14.1}  {remark}",
            row.cutoff_hz, row.damping_n_s_per_m, row.stiffness_max_n_per_m
        );
        for (from, to) in &row.further_stable_n_per_m {
            let _ = write!(text, "; stable again from {from:.1} to {to:.1}");
        }
    }
    text
}
