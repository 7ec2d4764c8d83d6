//! The simulator's studies in a worker. Each answer has the data of the corresponding command. A worker has one thread,
//! so several workers share the cutoffs of a sweep.

use std::sync::atomic::AtomicBool;

use host_sim::{
    analysis::design::{self as designed, Condition},
    engine::{Depth, Engine, stream},
    error::Error,
    output::{
        design::{Designs, best_scene},
        grid::Grid,
        in_units,
        sweep::{Study, areas_csv, boundary_csv},
        trace,
    },
    range::within,
    scene::{Criterion, NamedScene, VelocityTable},
    simulation::{prepared::Numeric, trace::Trace},
    study::{
        How,
        asked::{self, Names, Walls},
        boundary::{Boundary, BoundaryPoint},
        recommended::ranked,
        sweep::{CutoffResult, Plan, SweepResult, ascending, filters, sweep as walks},
    },
};
use live::predicted::predict;
use serde::{Deserialize, Serialize};
use serde_json::{Map, json};
use virtual_board::device;
use zwidth::{experiment::Ended, velocity::EstimatorName};

use crate::question::{Answered, Question};

/// This flag is never set, because the page terminates a worker that it no longer needs.
static STOP: AtomicBool = AtomicBool::new(false);
/// Largest number of walls in a grid.
const WALLS_MAX: u64 = 1_000_000;
const NAMES: Names = Names {
    cutoff: "cutoff",
    stiffness: "stiffness",
    damping: "damping",
    start_offset: "start offset",
};

const ENDS: [Ended; 4] = [Ended::Closed, Ended::DampingMax, Ended::StiffnessMax, Ended::BothMax];

/// All boundaries at one cutoff. Workers exchange them in this form.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Walked {
    cutoff_hz: f64,
    true_cutoff_hz: f64,
    settles_in_s: Option<f64>,
    boundaries: Vec<Walk>,
}

#[derive(Clone, Debug, Deserialize, Serialize)]
struct Walk {
    /// B and K of each point.
    points: Vec<[f64; 2]>,
    area: f64,
    hits: u64,
    ended: Option<String>,
}

impl Walked {
    fn of(result: &CutoffResult) -> Self {
        let walk = |boundary: &Boundary| Walk {
            points: boundary
                .points
                .iter()
                .map(|point| [point.damping_n_s_per_m, point.stiffness_n_per_m])
                .collect(),
            area: boundary.area,
            hits: boundary.hits,
            ended: boundary.ended.map(|ended| ended.name().to_owned()),
        };
        let &CutoffResult { cutoff_hz, true_cutoff_hz, settles_in_s, .. } = result;
        let boundaries = result.boundaries.iter().map(walk).collect();
        Self { cutoff_hz, true_cutoff_hz, settles_in_s, boundaries }
    }

    fn result(&self, velocity: &VelocityTable) -> CutoffResult {
        let boundary = |walk: &Walk| Boundary {
            points: walk
                .points
                .iter()
                .map(|&[damping_n_s_per_m, stiffness_n_per_m]| BoundaryPoint {
                    damping_n_s_per_m,
                    stiffness_n_per_m,
                })
                .collect(),
            area: walk.area,
            hits: walk.hits,
            ended: ENDS.into_iter().find(|ended| walk.ended.as_deref() == Some(ended.name())),
        };
        CutoffResult {
            velocity: velocity.at(self.cutoff_hz),
            cutoff_hz: self.cutoff_hz,
            true_cutoff_hz: self.true_cutoff_hz,
            settles_in_s: self.settles_in_s,
            boundaries: self.boundaries.iter().map(boundary).collect(),
        }
    }
}

/// The console commands that give a board the settings of the scene. The scene's studies are only valid for a board
/// with these settings. Only the cutoff may differ.
pub fn scene(question: &Question) -> Answered {
    let NamedScene { name, scene, .. } = question.scene()?;
    let has_cutoff = scene.velocity.has_cutoff();
    let (estimator, numbers) = EstimatorName::of(&scene.velocity.at(0.0));
    let wall = scene.units.command("position_m", scene.wall.position_m);
    let mut wanted = Map::from_iter([("estimator".to_owned(), json!(estimator.text()))]);
    let numbers = estimator.parameters().into_iter().flatten().zip(numbers);
    for (place, (_, number)) in numbers.enumerate().skip(usize::from(has_cutoff)) {
        let place = if place == 0 { String::new() } else { (place + 1).to_string() };
        wanted.insert(format!("tuning{place}"), json!(number));
    }
    wanted.insert("wall".to_owned(), json!(wall.parse::<f64>().ok()));
    Ok((json!({ "name": name, "has_cutoff": has_cutoff, "wanted": wanted }), vec![]))
}

/// The boundary that is predicted for the present estimator and cutoff. It is for the page's plane.
pub fn predicted(question: &Question) -> Answered {
    let (scene, board) = (question.scene()?, question.board()?);
    let cutoff_hz = question.cutoff_hz.unwrap_or_default();
    // For another scene the record is made without an envelope.
    let device = device::is_built_in(&scene, board).then(|| device::built_in(board));
    let predicted = predict(&scene, device, &question.estimator, cutoff_hz, &STOP);
    Ok((json!({ "type": "predicted", "predicted": predicted }), vec![]))
}

/// Runs one hit, as `cargo sim hit --trace` does.
pub fn hit(question: &Question) -> Answered {
    let scene = question.scene()?;
    let units = scene.scene.units;
    let wall = [units.stiffness_n_per_m(question.k), units.damping_n_s_per_m(question.b)];
    let hit = asked::hit(&scene, question.cutoff_hz, Some(wall), 0.0, NAMES)?;
    let prepared = asked::prepare(&scene)?.with_felt();
    let mut samples = Trace::new(&prepared, &hit).map_err(|error| error.of(&scene.name))?;
    let report = prepared.hit(Numeric::default(), &hit, |sample| samples.push(sample))?;
    let answer =
        json!({ "verdict": report.verdict.name(), "rms_m": report.rms_m, "mean_m": report.mean_m });
    Ok((answer, vec![in_units::csv(units, trace::csv(&samples)).into_bytes()]))
}

pub fn cutoffs(question: &Question) -> Answered {
    let scene = question.scene()?;
    if !scene.scene.velocity.has_cutoff() {
        return Err(asked::no_cutoff(&scene));
    }
    asked::prepare(&scene)?;
    Ok((json!({ "cutoffs_hz": ascending(&scene.scene.sweep.cutoffs_hz) }), vec![]))
}

pub fn walk(question: &Question) -> Answered {
    let scene = question.scene()?;
    let prepared = asked::prepare(&scene)?;
    let cutoffs_hz = question.cutoffs_hz.as_deref().unwrap_or_default();
    let filters = filters(&scene.scene.velocity, cutoffs_hz);
    let plan = Plan { name: &scene.name, prepared: &prepared, filters: &filters };
    let repeat = repeats(question)?;
    let results = walks(Engine::lanes(), &[plan], Numeric::default(), repeat, &STOP, |_| ())?;
    let walked: Vec<Walked> =
        results.iter().flat_map(|result| &result.cutoffs).map(Walked::of).collect();
    Ok((json!({ "walked": walked }), vec![]))
}

fn repeats(question: &Question) -> Result<u32, Error> {
    let repeat = question.repeat.unwrap_or(1);
    match repeat {
        1..=1000 => Ok(repeat),
        _ => Err(Error::Input(format!("repeat is {repeat}, allowed 1 to 1000"))),
    }
}

/// Joins the results of all cutoffs to `boundary.csv` and `areas.csv`.
pub fn sweep(question: &Question) -> Answered {
    let scene = question.scene()?;
    let walked = question.walked.iter().map(|walked| walked.result(&scene.scene.velocity));
    let mut cutoffs: Vec<CutoffResult> = walked.collect();
    cutoffs.sort_by(|a, b| a.cutoff_hz.total_cmp(&b.cutoff_hz));
    let units = scene.scene.units;
    let study = Study {
        prepared: asked::prepare(&scene)?,
        numeric: Numeric::default(),
        repeats: repeats(question)?,
        result: SweepResult::of(cutoffs),
        envelopes: vec![],
        variants: vec![],
        limits: None,
        levers: None,
        rates: None,
        probability: None,
        limits_left_out: None,
        quiet: None,
        command: String::new(),
        scene,
    };
    let ideal = study.result.ideal;
    let answer = json!({
        "ideal_cutoff_hz": ideal.map(|ideal| ideal.cutoff_hz),
        "ideal_cutoff_range_hz": ideal.map(|ideal| ideal.range_hz),
        "notes": study.notes(),
    });
    let cutoffs = &study.result.cutoffs;
    let tables = [boundary_csv(cutoffs, study.repeats), areas_csv(cutoffs)];
    let tables = tables.map(|table| in_units::csv(units, table));
    Ok((answer, tables.map(String::into_bytes).into()))
}

/// Hits every wall of a grid, as `cargo sim grid --csv` does.
pub fn grid(question: &Question) -> Answered {
    let scene = question.scene()?;
    let units = scene.scene.units;
    let filters = match &question.cutoffs_hz {
        Some(cutoffs_hz) => asked::filters(&scene, cutoffs_hz)?,
        None => scene.scene.velocity.settings().into_iter().collect(),
    };
    if filters.is_empty() {
        return Err(Error::Input("cutoffs are missing".to_owned()));
    }
    let walls = Walls {
        filters,
        dampings: question.dampings.iter().map(|&b| units.damping_n_s_per_m(b)).collect(),
        stiffnesses: question.stiffnesses.iter().map(|&k| units.stiffness_n_per_m(k)).collect(),
        start_offset_counts: 0.0,
    };
    let points = walls.count();
    if !(1..=WALLS_MAX).contains(&points) {
        return Err(Error::Input(format!("the grid has {points} walls, allowed 1 to {WALLS_MAX}")));
    }
    walls.check(&scene, NAMES)?;
    let prepared = asked::prepare(&scene)?;
    let mut grid = Grid::new(units, false);
    let mut csv = grid.header().to_owned();
    stream(
        Engine::lanes(),
        &prepared,
        Numeric::default(),
        Depth::Whole,
        points,
        |number| walls.wall(number),
        &STOP,
        |number, outcome| {
            csv += &grid.row(&walls.wall(number), outcome, None)?;
            Ok(())
        },
    )?;
    Ok((json!({ "points": points, "stable": grid.counts.stable }), vec![csv.into_bytes()]))
}

/// Finds the best velocity filter for quiet walls, as `cargo sim design` does. Returns `design.csv` and the best scene.
pub fn design(question: &Question) -> Answered {
    let scene = question.scene()?;
    asked::prepare(&scene)?;
    let how = How { engine: Engine::lanes(), numeric: Numeric::default(), stop: &STOP };
    let ranked =
        ranked(how, &scene, Criterion::Quiet, None).map_err(|error| error.of(&scene.name))?;
    let budget = question.budget.unwrap_or(3000);
    within("budget", f64::from(budget), 100.0..=1e6).map_err(Error::Input)?;
    let name = format!("{} pushes", scene.scene.wall_hit.push_by.name());
    let asked = designed::Question {
        conditions: vec![Condition { name, scene: ranked.scene.scene }],
        gain_peak_db: None,
        delay_s: None,
        roughness_n: None,
        mistuned_share: None,
        sections: 1,
        budget,
        repeats: question.repeat.unwrap_or(4),
        seed: 1,
        numeric: how.numeric,
    };
    let study = designed::design(how.engine, asked, &STOP, |_| ())
        .map(Designs)
        .map_err(|error| error.of(&scene.name))?;
    let csv = in_units::csv(scene.scene.units, study.csv());
    let best = best_scene(&scene.scene, &study).map_err(Error::Internal)?;
    Ok((json!({ "text": study.text() }), vec![csv.into_bytes(), best.into_bytes()]))
}
