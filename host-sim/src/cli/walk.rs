//! `walk`: one boundary.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{Common, shared::AtCutoff};
use crate::{
    error::Error,
    interrupt,
    output::{
        SCHEMA_VERSION,
        files::Outputs,
        terminal::{print_json, print_text},
    },
    simulation::prepared::PreparedScene,
    study::walk::{Boundary, settles_in_s, walk},
};

/// Follows the boundary of the stable walls at one cutoff, without repeats.
#[derive(Debug, Args)]
pub struct WalkArgs {
    #[command(flatten)]
    at: AtCutoff,
    /// Write the boundary as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    schema_version: u32,
    command: &'static str,
    scene: &'a str,
    numeric: &'static str,
    estimator: &'static str,
    /// `null` if the estimator has none.
    cutoff_hz: Option<f64>,
    true_cutoff_hz: Option<f64>,
    area_n2_s_per_m2: f64,
    stiffness_peak_n_per_m: f64,
    damping_max_n_s_per_m: f64,
    hits: u64,
    ended_by: &'static str,
}

pub fn run(args: &WalkArgs, common: &Common) -> Result<(), Error> {
    let (scene, first) = args.at.load(None)?;
    let mut outputs = Outputs::new(common.force, &scene.files);
    let file = outputs.option(args.csv.as_ref())?;
    let velocity = scene.scene.velocity;
    let prepared = PreparedScene::new(&scene.scene)?;
    let boundary = walk(
        common.engine.into(),
        &prepared,
        common.numeric.into(),
        first.cutoff_hz,
        first.start_offset_counts,
        interrupt::flag(),
    )
    .map_err(|error| error.of(&scene.name))?;
    let Some(ended) = boundary.ended else {
        let reason = match settles_in_s(&prepared, common.numeric.into(), &first) {
            Some(settle_s) => format!(
                "still settles in the window with {}; raise wall_hit.settle_s, {settle_s} is enough here",
                velocity.describe(first.cutoff_hz, scene.scene.control.rate_hz)
            ),
            None => format!(
                "is unstable with {}; lower walk.stiffness_start_n_per_m or change the estimator's tuning",
                velocity.describe(first.cutoff_hz, scene.scene.control.rate_hz)
            ),
        };
        return Err(Error::Input(format!(
            "{}: the first point of the walk, K = {} N/m and B = {} N s/m, {reason}",
            scene.name, first.stiffness_n_per_m, first.damping_n_s_per_m
        )));
    };
    if let Some(file) = file {
        outputs.write(file, csv(first.cutoff_hz, &boundary).as_bytes())?;
    }
    outputs.commit()?;
    let json = Json {
        schema_version: SCHEMA_VERSION,
        command: "walk",
        scene: &scene.name,
        numeric: common.numeric.name(),
        estimator: velocity.name(),
        cutoff_hz: velocity.has_cutoff().then_some(first.cutoff_hz),
        true_cutoff_hz: velocity.has_cutoff().then(|| scene.scene.true_cutoff_hz(first.cutoff_hz)),
        area_n2_s_per_m2: boundary.area,
        stiffness_peak_n_per_m: boundary.stiffness_peak_n_per_m(),
        damping_max_n_s_per_m: boundary.damping_max_n_s_per_m(),
        hits: boundary.hits,
        ended_by: ended.name(),
    };
    if common.json {
        return print_json(&json);
    }
    print_text(&format!(
        "{}: area {:.4e} N^2 s/m^2 with {}\n\
         peak K {} N/m, largest B {} N s/m, {} hits, ended by: {}",
        scene.name,
        json.area_n2_s_per_m2,
        velocity.describe(first.cutoff_hz, scene.scene.control.rate_hz),
        json.stiffness_peak_n_per_m,
        json.damping_max_n_s_per_m,
        json.hits,
        json.ended_by
    ))
}

fn csv(cutoff_hz: f64, boundary: &Boundary) -> String {
    let mut text = String::from("cutoff_hz,damping_n_s_per_m,stiffness_n_per_m\n");
    for point in &boundary.points {
        let (b, k) = (point.damping_n_s_per_m, point.stiffness_n_per_m);
        text.push_str(&format!("{cutoff_hz},{b},{k}\n"));
    }
    text
}
