//! `compare --peers`: compares the default estimators of other systems.

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    limits::{Limits, Pair, pair, parse},
    progress,
    shared::Typed,
};
use crate::{
    analysis::compare::peers::{LIMITS, PeerArea, PeerQuestion, compare_peers},
    error::Error,
    output::{estimated::print_of, manifest::Manifest, peers},
    scene::NamedScene,
    study::{asked::prepare, limits_asked::Names},
};

const NAMES: Names = Names { limits: "--limits", steps: "--steps" };

/// Options of `--peers`.
#[derive(Debug, Args)]
pub struct PeerArgs {
    /// Compare the default estimators of other systems, without tuning, with the scene's own estimator (at 500 and 1500
    /// Hz) and the true velocity. Gives areas by limit, in the scene's own loop and with the latency of both boards.
    #[arg(long, conflicts_with_all = ["estimators", "damping", "budget", "limit", "rms_of", "criterion", "push", "arm", "latency", "period"])]
    pub peers: bool,
    /// With --peers: `quiet`, limits of the RMS of the motion in m, and `felt` for wall_hit.felt_limit_db.
    #[arg(long, value_name = "LIST", value_parser = parse, default_value = LIMITS, requires = "peers")]
    limits: Limits,
    /// With --peers: steps of K and B, in the scene's units. Walks start at one step [default: a quarter of the scene's
    /// K, half of its B].
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
    let steps = args.steps.map(|pair| pair.at_handle(&scene.scene));
    let question = PeerQuestion::of(scene, &args.limits.0, steps, repeats, NAMES)?;
    let mut to = common.fill(scene, "peers", &["peers.csv"])?;
    let command = Typed::new("compare", &scene.name)
        .flag("peers", true)
        .with("limits", &args.limits)
        .maybe("steps", args.steps)
        .with("repeat", repeats)
        .by(common);
    let bar = progress::bar(question.walks());
    let study = compare_peers(common.how(), question, || bar.inc(1))
        .map_err(|error| error.of(&scene.name))?;
    bar.finish_and_clear();
    to.add("peers.csv", peers::csv(&study))?;
    let results = to.finish(&Manifest::new(command, scene))?;
    let json = Json { scene: &scene.name, areas: study.areas(), notes: &study.notes };
    print_of(common.json, &scene.scene, json, || {
        format!("{}: {}\n  {results}", scene.name, peers::text(&study, scene.scene.units))
    })
}
