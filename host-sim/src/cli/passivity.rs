//! `passivity`: what the wall's passivity controller gains, and what it costs.

use clap::Args;
use serde::Serialize;

use super::{
    Common,
    limits::{Limits, Pair, pair, parse},
    list::{self, List},
    progress,
    shared::{Typed, check_filters, listed},
};
use crate::{
    analysis::passive::{self as walls, Length, PassiveQuestion},
    error::Error,
    output::{
        estimated::print_of,
        manifest::Manifest,
        passive::{self, PassiveArea},
    },
    scene::{NamedScene, PassivityTable, Protocol},
    study::{
        asked::{no_cutoff, prepare},
        limits::Limit,
        limits_asked::{Names, check, finer},
        sweep::filters,
    },
};

/// Compares a wall with a time-domain passivity controller to the plain wall. Gives areas by limit and cutoff, and the
/// results of hits on the boundary's walls: energy given in a contact, withheld force, RMS, roughness.
#[derive(Debug, Args)]
#[command(after_long_help = COLUMNS)]
pub struct PassivityArgs {
    /// Built-in scene or scene file, with or without [passivity].
    scene: String,
    /// Nominal cutoffs in Hz, A,B,C or FROM:STEP:TO [default: 500 and 1500; not for an estimator without a cutoff].
    #[arg(long, value_name = "LIST", value_parser = list::parse)]
    cutoffs: Option<List>,
    /// Limits of the RMS of the motion in m, and `felt` for wall_hit.felt_limit_db.
    #[arg(long, value_name = "LIST", value_parser = parse, default_value = LIMITS)]
    limits: Limits,
    /// Largest acceleration of the handle in m/s^2 [default: the scene's, else twice full scale divided by the mass].
    #[arg(long, value_name = "M_PER_S2", allow_negative_numbers = true)]
    acceleration: Option<f64>,
    /// Steps of K and B of the walks, in the scene's units. Walks start at one step [default: the scene's walk].
    #[arg(long, value_name = "K,B", value_parser = pair)]
    steps: Option<Pair>,
    /// Times before the window in s, for hits on the boundary's walls. In a longer time, a hum gets more energy
    /// [default: the scene's and 30].
    #[arg(long, value_name = "LIST", value_parser = list::parse)]
    settle: Option<List>,
    /// Number of walks, with starts spread over one count.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
}

const NAMES: Names = Names { limits: "--limits", steps: "--steps" };
const LIMITS: &str = "15e-6,1e-6";
const CUTOFFS_HZ: [f64; 2] = [500.0, 1500.0];
/// Time before the window in a long hit, in s.
const LONG_S: f64 = 30.0;

const COLUMNS: &str = "\
Columns of passivity.csv. It has a row for each limit, cutoff, controller, and boundary whose walls were hit:
  controller             whether the hits had the controller
  area, stiffness_peak   area of the boundary: mean, smallest and largest over the walks; its largest K
  walls_of, walls        boundary whose walls were hit (found with or without the controller); number of walls, at most 24
  reserve_j              largest energy that a contact may give with the controller
  given_j                largest energy that a contact of these hits gave, computed from wall force and counts
  walls_beyond_reserve   number of walls that gave more than the reserve
  limited_fraction       share of the outputs in contact that the controller changed
  withheld_fraction      withheld force, divided by the wall's force; both summed over the outputs in contact
  saturated_fraction     share of the outputs whose demand was above full scale
  rms_motion_m           RMS of the motion in the window
  roughness_n            RMS of the force above 100 Hz in the window
Fractions, RMS and roughness are means over the walls.
Columns of lengths.csv. It has a row for each limit, cutoff, controller and length of the hits. The walls are those of
the boundary without the controller:
  settle_s                  time before the window
  given_j                   as above
  given_by_motion_j         the same, computed from the true motion. The controller only knows the counts
  fed_w                     power that the device's damping takes from the hum, b <v^2>. The wall gives it while it hums
  withheld_most_fraction    withheld_fraction of the wall with the largest one
  sag                       mean penetration divided by push / K. Above 1 the wall is softer than commanded";

const FILES: &[&str] = &["passivity.csv", "lengths.csv", "passivity"];

#[derive(Serialize)]
struct Json<'a> {
    scene: &'a str,
    acceleration_m_per_s2: f64,
    reserve_j: f64,
    rows: Vec<PassiveArea>,
    lengths: &'a [Length],
}

pub fn run(args: &PassivityArgs, common: &Common) -> Result<(), Error> {
    let scene = NamedScene::load(&args.scene)?;
    common.only_fixed("passivity")?;
    prepare(&scene)?;
    let protocol = scene.scene.wall_hit.protocol;
    if protocol != Protocol::Paper {
        return Err(Error::Input(format!(
            "{}: wall_hit.protocol is {}, allowed paper here: --settle says how long a hit takes",
            scene.name,
            protocol.name()
        )));
    }
    let acceleration_m_per_s2 = args.acceleration.unwrap_or_else(|| scene.scene.acceleration());
    let table = PassivityTable { acceleration_m_per_s2: Some(acceleration_m_per_s2) };
    let limits: Vec<Limit> = args.limits.0.iter().map(|limit| limit.of(&scene.scene)).collect();
    let walk = match args.steps {
        None => scene.scene.walk,
        Some(steps) => finer(&scene.scene, Some(steps.at_handle(&scene.scene)), None),
    };
    check(&scene.scene, &limits, walk, NAMES)?;
    if args.cutoffs.is_some() && !scene.scene.velocity.has_cutoff() {
        return Err(no_cutoff(&scene));
    }
    let cutoffs_hz = args.cutoffs.as_ref().map_or(&CUTOFFS_HZ[..], |list| &list.0);
    let filters = filters(&scene.scene.velocity, cutoffs_hz);
    check_filters(&scene, &filters)?;
    let cutoffs: Vec<f64> = filters.iter().filter_map(|filter| filter.cutoff_hz()).collect();
    let own_s = scene.scene.wall_hit.settle_s;
    let settles_s = args.settle.as_ref().map_or_else(|| vec![own_s, LONG_S], |list| list.0.clone());
    for settle_s in &settles_s {
        let mut long = scene.clone();
        long.scene.wall_hit.settle_s = *settle_s;
        long.scene.check().map_err(|why| Error::Input(format!("--settle: {why}")))?;
    }
    let question =
        PassiveQuestion { limits, filters, repeats: args.repeat, walk, table, settles_s };
    let mut to = common.fill(&scene, "passivity", FILES)?;
    let command = Typed::new("passivity", &scene.name)
        .maybe("cutoffs", listed(&cutoffs))
        .with("limits", &args.limits)
        .with("acceleration", acceleration_m_per_s2)
        .maybe("steps", args.steps)
        .maybe("settle", listed(&question.settles_s))
        .with("repeat", args.repeat)
        .by(common);
    let bar = progress::bar(question.walks());
    let study = walls::passive(common.how(), &scene.scene, question, || bar.inc(1))
        .map_err(|error| error.of(&scene.name))?;
    bar.finish_and_clear();
    to.add("passivity.csv", passive::csv(&study))?;
    to.add("lengths.csv", passive::lengths_csv(&study))?;
    to.figure("passivity", &passive::figure(&study, &scene)?)?;
    let results = to.finish(&Manifest::new(command, &scene))?;
    let json = Json {
        scene: &scene.name,
        acceleration_m_per_s2,
        reserve_j: study.reserve_j,
        rows: passive::areas(&study),
        lengths: &study.lengths,
    };
    print_of(common.json, &scene.scene, json, || {
        format!("{}: {}\n  {results}", scene.name, passive::text(&study, scene.scene.units))
    })
}
