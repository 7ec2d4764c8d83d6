//! `compare --peers`: the defaults of other systems.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    limits::{Limits, Pair, pair, parse},
    progress,
};
use crate::{
    analysis::compare::peers::{LIMITS, PeerArea, PeerQuestion, compare_peers},
    engine::Engine,
    error::Error,
    output::{
        estimated::print_of,
        files::{MANIFEST, json as json_bytes},
        in_units,
        manifest::Manifest,
        peers::Peers,
    },
    scene::NamedScene,
    study::{asked::prepare, limits_asked::Names},
};

/// Every file of a result.
const FILES: [&str; 2] = ["peers.csv", MANIFEST];
const NAMES: Names = Names { limits: "--limits", steps: "--steps" };

/// Options of `--peers`.
#[derive(Debug, Args)]
pub struct PeerArgs {
    /// The defaults of other systems, untuned, beside the scene's own estimator (at 500 and 1500 Hz) and the true velocity:
    /// areas by limit, in the scene's own loop and with the latency of both boards.
    #[arg(long, conflicts_with_all = ["estimators", "damping", "budget", "limit", "rms_of", "criterion", "push", "arm", "latency", "period"])]
    pub peers: bool,
    /// With --peers: `quiet`, limits of the RMS of the motion in m, and `felt` for wall_hit.felt_limit_db.
    #[arg(long, value_name = "LIST", value_parser = parse, default_value = LIMITS, requires = "peers")]
    limits: Limits,
    /// With --peers: steps of K and B, which are also the first ones, in the scene's units [default: a quarter of the scene's K,
    /// half of its B].
    #[arg(long, value_name = "K,B", value_parser = pair, requires = "peers")]
    steps: Option<Pair>,
}

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    areas: Vec<PeerArea<'a>>,
    notes: &'a [String],
}

pub fn run(
    args: &PeerArgs,
    repeats: u32,
    scene: &NamedScene,
    common: &Common,
) -> Result<(), Error> {
    prepare(scene)?;
    let units = scene.scene.units;
    let steps = args.steps.map(|pair| pair.at_handle(&scene.scene));
    let question = PeerQuestion::of(scene, &args.limits.0, steps, repeats, NAMES)?;
    let default = || PathBuf::from("zwidth-out").join(&scene.name).join("peers");
    let folder = common.out.clone().unwrap_or_else(default);
    let mut outputs = common.outputs(&scene.files)?;
    let to = outputs.folder(&folder, &FILES)?;
    let engine = Engine::from(common.engine);
    let steps = match args.steps {
        Some(Pair([k, b])) => format!(" --steps {k},{b}"),
        None => String::new(),
    };
    let command = format!(
        "compare {} --peers --limits {}{steps} --repeat {repeats} --engine {}",
        scene.name,
        args.limits.as_typed(),
        engine.name()
    );
    let bar = progress::bar(question.walks());
    let study = compare_peers(common.how(), question, || bar.inc(1))
        .map_err(|error| error.of(&scene.name))?;
    let study = Peers(study);
    bar.finish_and_clear();
    outputs.add(to, "peers.csv", in_units::csv(units, study.csv()).as_bytes())?;
    outputs.add(to, MANIFEST, &json_bytes(&Manifest::new(command, scene))?)?;
    outputs.commit()?;
    let json = Json { scene: &scene.name, areas: study.0.areas(), notes: &study.0.notes };
    print_of(common.json, &scene.scene, json, || {
        format!("{}: {}\n  results in {}", scene.name, study.text(), folder.display())
    })
}
