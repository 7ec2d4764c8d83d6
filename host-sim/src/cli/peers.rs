//! `compare --peers`: the defaults of other systems.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    limits::{Asked, Limits, Pair, finer, pair, parse},
    progress,
};
use crate::{
    analysis::compare::peers::{PeerQuestion, compare_peers, loops},
    engine::Engine,
    error::Error,
    interrupt,
    output::{
        estimated::print_of,
        files::{MANIFEST, json as json_bytes},
        in_units,
        manifest::Manifest,
        peers::{PeerArea, Peers},
    },
    scene::NamedScene,
    study::limits::Limit,
};

/// Every file of a result.
const FILES: [&str; 2] = ["peers.csv", MANIFEST];
const LIMITS: &str = "15e-6,5e-6,2e-6,1e-6,felt";
/// Cutoffs of the scene's own estimator, Hz: for what is felt as a faint hum, and for the paper's limit.
const OWN_HZ: [f64; 2] = [500.0, 1500.0];

/// Options of `--peers`.
#[derive(Debug, Args)]
pub struct PeerArgs {
    /// The defaults of other systems, untuned, beside the scene's own estimator (at 500 and 1500 Hz) and the true velocity:
    /// areas by limit, in the scene's own loop and with the latency of both boards.
    #[arg(long, conflicts_with_all = ["estimators", "damping", "budget", "limit", "rms_of", "criterion", "push", "arm", "latency", "period"])]
    pub peers: bool,
    /// With --peers: limits of the RMS of the motion in m, and `felt` for wall_hit.felt_limit_db.
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
    areas: Vec<PeerArea>,
    notes: &'a [String],
}

pub fn run(
    args: &PeerArgs,
    repeats: u32,
    scene: &NamedScene,
    common: &Common,
) -> Result<(), Error> {
    crate::study::asked::prepare(scene)?;
    let units = scene.scene.units;
    let felt_db = scene.scene.wall_hit.felt_limit_db;
    let limits = args.limits.0.iter().map(|limit| match limit {
        Asked::Rms(limit_m) => Limit::Rms(*limit_m),
        Asked::Felt => Limit::Felt(felt_db),
        Asked::FeltAt(level_db) => Limit::Felt(*level_db),
    });
    let limits: Vec<Limit> = limits.collect();
    let walk = finer(&scene.scene, args.steps, None);
    super::limits::check(&scene.scene, &limits, walk)?;
    let velocity = scene.scene.velocity;
    let own_hz = match velocity.has_cutoff() {
        true => OWN_HZ.to_vec(),
        false => vec![0.0],
    };
    let design = scene.scene.design();
    let is_possible = |hz: &f64| velocity.settings(*hz).build(&design).is_ok();
    let own_hz = own_hz.into_iter().filter(is_possible).collect();
    let question = PeerQuestion { loops: loops(scene)?, limits, own_hz, walk, repeats };
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
    let study = compare_peers(engine, question, interrupt::flag(), || bar.inc(1))
        .map_err(|error| error.of(&scene.name))?;
    let study = Peers(study);
    bar.finish_and_clear();
    outputs.add(to, "peers.csv", in_units::csv(units, study.csv()).as_bytes())?;
    outputs.add(to, MANIFEST, &json_bytes(&Manifest::new(command, scene))?)?;
    outputs.commit()?;
    let json = Json { scene: &scene.name, areas: study.areas(), notes: &study.0.notes };
    print_of(common.json, &scene.scene, json, || {
        format!("{}: {}\n  results in {}", scene.name, study.text(), folder.display())
    })
}
