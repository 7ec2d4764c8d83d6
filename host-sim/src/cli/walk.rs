//! `walk`: follows one stability boundary.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use zwidth::experiment::Ended;

use super::{
    Common,
    conditions::Judged,
    shared::{AtCutoff, Subject},
};
use crate::{
    error::Error,
    interrupt,
    output::{estimated::print_of, table::Kind},
    scene::velocity::describe,
    study::{
        asked::{self, prepare},
        boundary::Boundary,
    },
};

/// Follows the boundary of stable walls at one cutoff, without repeats.
#[derive(Debug, Args)]
pub struct WalkArgs {
    #[command(flatten)]
    at: AtCutoff,
    #[command(flatten)]
    judged: Judged,
    /// Write the boundary as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

#[derive(Serialize)]
struct Json<'a> {
    #[serde(flatten)]
    subject: Subject<'a>,
    area_n2_s_per_m2: f64,
    stiffness_peak_n_per_m: f64,
    damping_max_n_s_per_m: f64,
    hits: u64,
    ended_by: &'static str,
    /// Protocol of the hits. It is left out if it is the paper's protocol.
    #[serde(skip_serializing_if = "Option::is_none")]
    protocol: Option<&'static str>,
}

pub fn run(args: &WalkArgs, common: &Common) -> Result<(), Error> {
    let (mut scene, first) = args.at.load(None)?;
    args.judged.apply(&mut scene)?;
    let mut outputs = common.outputs(&scene.files)?;
    let file = outputs.table(args.csv.as_ref(), Kind::Rows, Some(&scene))?;
    let units = scene.scene.units;
    let prepared = prepare(&scene)?;
    let boundary = asked::boundary(
        &scene,
        common.engine,
        &prepared,
        common.numeric,
        &first,
        interrupt::flag(),
    )?;
    outputs.tell(file, units, || csv(first.velocity.cutoff_hz().unwrap_or_default(), &boundary))?;
    outputs.commit()?;
    let json = Json {
        subject: Subject::new(&scene, &first.velocity, common),
        area_n2_s_per_m2: boundary.area,
        stiffness_peak_n_per_m: boundary.stiffness_peak_n_per_m(),
        damping_max_n_s_per_m: boundary.damping_max_n_s_per_m(),
        hits: boundary.hits,
        ended_by: boundary.ended.map_or("", Ended::name),
        protocol: scene.scene.wall_hit.protocol.named(),
    };
    let by = json.protocol.map_or_else(String::new, |protocol| format!(", by {protocol}"));
    print_of(common.json, &scene.scene, &json, || {
        let end = match boundary.ended {
            Some(Ended::Closed) => "the boundary came down to the first K of the walk".to_owned(),
            Some(cap) => format!("ended at the cap {}: more walls may be stable", cap.name()),
            None => "the first wall is unstable".to_owned(),
        };
        format!(
            "{}: area {} with {}{by}\npeak K {}, largest B {}, {} hits; {end}",
            scene.name,
            units.said(json.area_n2_s_per_m2, "N^2 s/m^2"),
            describe(&first.velocity, scene.scene.control.rate_hz),
            units.said(json.stiffness_peak_n_per_m, "N/m"),
            units.said(json.damping_max_n_s_per_m, "N s/m"),
            json.hits,
        )
    })
}

fn csv(cutoff_hz: f64, boundary: &Boundary) -> String {
    let mut text = String::from("cutoff_hz,damping_n_s_per_m,stiffness_n_per_m\n");
    for point in &boundary.points {
        let (b, k) = (point.damping_n_s_per_m, point.stiffness_n_per_m);
        text.push_str(&format!("{cutoff_hz},{b},{k}\n"));
    }
    text
}
