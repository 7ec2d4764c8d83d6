//! Compares estimators, and explains what limits a scene's walls.

use std::sync::{Arc, atomic::AtomicBool};

use pyo3::{exceptions::PyValueError, prelude::*};
use sim_loop::{
    engine::Engine,
    error::Error,
    scene::{Criterion, NamedScene},
    simulation::prepared::Numeric,
};
use sim_studies::{
    analysis::{
        compare::{
            self as study, Entry, most_walks,
            peers::{LIMITS, PeerQuestion, compare_peers},
            search::Budget,
            table,
            usable::{self as commanded, UsableQuestion, UsableStudy},
            winners::winners,
        },
        explain as changed,
    },
    study::{
        How, asked,
        limits_asked::{LimitAsked, Names},
        recommended::{Ranked, ranked},
    },
    table::{Kind, Table},
};

use crate::{
    given::{Given, Item, Numbers, Progress, Several, Texts},
    result::{Part, Table as Told, Tuple, made, result},
    scene::serialized,
    studies::{engine_of, in_range, named, not_empty},
    work::{raised, run},
};

/// Checks the limits on the cost of a search. The rules are those of the command line.
fn budget_of(tunings: u32, repeats: u32, fewest_repeats: u32) -> PyResult<Budget> {
    in_range("budget", tunings, 3..=1000)?;
    in_range("repeat", repeats, fewest_repeats..=1000)?;
    Ok(Budget { tunings, repeats })
}

fn criterion_of(name: &str) -> PyResult<Criterion> {
    named("criterion", name, Criterion::ALL, Criterion::name)
}

/// Checks the scene and gives it the criterion that ranks walls.
fn ranked_of(
    engine: Engine,
    scene: &NamedScene,
    by: Criterion,
    stop: &AtomicBool,
) -> Result<Ranked, Error> {
    asked::prepare(scene)?;
    let how = How { engine, numeric: Numeric::Fixed, stop };
    let rms_of = scene.scene.wall_hit.rms_of.filter(|_| by != Criterion::Quiet);
    ranked(how, scene, by, rms_of).map_err(|error| error.of(&scene.name))
}

/// The estimators with these names, without repeated names. `None` if no names are given.
fn entries_of(named: Option<Texts>, scene: &NamedScene) -> PyResult<Option<Vec<Entry>>> {
    let Some(Several(named)) = named else { return Ok(None) };
    not_empty("estimators", &named)?;
    Entry::named(&named, scene, "estimators").map(Some).map_err(raised)
}

result! { value
    /// The best estimators by one criterion. They are compared with estimators that have the same inputs.
    Winner {
        /// Name of the criterion. It is a column of `Comparison.table`.
        criterion: String,
        /// Class of the estimators: `position_only` or `more_than_position`.
        looks_at: String,
        /// The estimators with the best mean.
        best: Tuple<String>,
        /// Further estimators. The repeats do not show that they are worse than the best.
        not_told_apart: Tuple<String>,
        /// Value of the best estimator, in the unit of the column.
        value: f64,
        /// Rank of the finite difference and Butterworth filter. It is 1 plus the number of estimators that are shown
        /// to be better. None if this estimator is not compared.
        butterworth_rank: Option<u32>,
    }
}

result! { table(table)
    /// A comparison of estimators. Each of them is tuned by the same search.
    Comparison {
        /// Name of the scene.
        scene: String,
        /// One row for each estimator, with the columns of the command line's `compare.csv`.
        table: Told,
        /// All tunings that the searches have tried, with the columns of `tuning.csv`.
        tunings: Told,
        /// Every point of every walk at the tunings that were found, with the columns of `boundary.csv`.
        boundaries: Told,
        /// Errors of the rendered impedance by wall and frequency, with the columns of `fidelity.csv`.
        fidelity: Told,
        /// K of the wall at which forces are compared, in N/m.
        stiffness_n_per_m: f64,
        /// B of the wall at which forces are compared, in N s/m. K of each boundary is also read at this B.
        damping_n_s_per_m: f64,
        /// The three walls at which the impedance is compared. The columns are `stiffness_n_per_m` and
        /// `damping_n_s_per_m`.
        walls: Told,
        /// Mean area if the loop gets the true velocity instead of an estimate, in N^2 s/m^2.
        true_velocity_area_n2_s_per_m2: f64,
        /// Impedance error with the true velocity. Only hold and latency cause it.
        impedance_error_of_loop: f64,
        /// The best estimators by each criterion.
        winners: Tuple<Part<Winner>>,
        /// Notes that a reader needs to understand the numbers.
        notes: Tuple<String>,
    }
}

/// Tune estimators by the same search and compare them.
///
/// Limit, push, arm, latency and output period come from the scene. Use `Scene.replace` to change them.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment. The scene's own estimator has no effect.
/// estimators : iterable of str, optional
///     Names of estimators. By default the usual estimators whose inputs the scene has.
/// criterion : str
///     Criterion that ranks walls. `"quiet"` uses a grid that suits quiet walls. `"rms"`, `"unsaturated"` and `"felt"`
///     use the scene's grid. With `"quiet"`, the column `scene_area_n2_s_per_m2` has the area by the scene's own
///     criterion at the same tuning.
/// damping : float, optional
///     B at which K is read and contacts are compared, N s/m. Default: the smaller of 100 and half of the largest B
///     that finite difference and Butterworth reaches.
/// budget : int
///     Largest number of tunings that the search tries for an estimator with one parameter, 3 to 1000. With two
///     parameters the limit is four times as large.
/// repeat : int
///     Number of walks at the result of each search. The starts are spread over a count.
/// engine, threads
///     As in `walk`.
/// progress : callable, optional
///     Called from this thread with the number of finished walks and the largest possible number. An exception in this
///     function ends the work.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, an estimator is unknown, or the handle does not reach the wall. Or the scene does not
///     have the inputs of an estimator.
///
/// Examples
/// --------
/// Coarse steps and a small budget are quick, but the areas are too small:
///
/// >>> steps = {"stiffness_step_n_per_m": 20e3, "damping_step_n_s_per_m": 200.0}
/// >>> scene = Scene.load("paper-2um").replace(walk=steps)
/// >>> made = compare(scene, estimators=["butterworth", "first-order"], criterion="rms", budget=3, repeat=2)
/// >>> made.table["estimator"].tolist()
/// ['butterworth', 'first-order']
/// >>> (made.table["area_n2_s_per_m2"] / 1e6).round(1).tolist()  # 10^6 N^2 s/m^2
/// [4.8, 13.2]
/// >>> made.winners[0].criterion, made.winners[0].best
/// ('area_n2_s_per_m2', ('first-order',))
#[pyfunction]
#[pyo3(signature = (
    scene, *, estimators = None, criterion = "quiet", damping = None, budget = 24, repeat = 4, engine = "lanes",
    threads = None, progress = None
))]
pub fn compare(
    py: Python<'_>,
    scene: Given,
    estimators: Option<Texts>,
    criterion: &str,
    damping: Option<f64>,
    budget: u32,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Comparison> {
    let (scene, engine, by) = (scene.0, engine_of(engine)?, criterion_of(criterion)?);
    let budget = budget_of(budget, repeat, 1)?;
    let entries = entries_of(estimators, &scene)?;
    let entries = entries.unwrap_or_else(|| Entry::usual(&scene.scene));
    if let Some(damping) = damping {
        asked::check_read_off(&scene, damping, "damping").map_err(raised)?;
    }
    let total = most_walks(&entries, budget);
    let of_work = Arc::clone(&scene);
    let (place, compared) = run(py, threads, progress.as_ref(), total, move |course| {
        let Ranked { scene, beside } = ranked_of(engine, &of_work, by, &course.stop)?;
        let (both, done) = ((&scene.scene, beside.as_ref()), |walks| course.add(walks));
        study::compare(engine, both, &entries, damping, budget, &course.stop, done)
    })?;
    let mut walls =
        Table::new([("stiffness_n_per_m", Kind::Number), ("damping_n_s_per_m", Kind::Number)]);
    for wall in place.walls {
        walls.rows.push(vec![wall.stiffness_n_per_m.into(), wall.damping_n_s_per_m.into()]);
    }
    let mut notes = table::notes(&compared, &place, scene.scene.units);
    notes.extend(scene.scene.estimated_note());
    let of_loop = compared.first().map(|first| first.fidelity.of_loop);
    let winners = winners(&compared, &place);
    let winners = winners.iter().map(|winner| {
        let told = serialized(py, winner)?;
        told.set_item("looks_at", told.call_method1("pop", ("class",))?)?;
        made(&told).map(Part)
    });
    Ok(Comparison {
        scene: scene.name.clone(),
        table: Told::of(py, &table::table(&compared, &place))?,
        tunings: Told::of(py, &table::tunings(&compared))?,
        boundaries: Told::of(py, &table::boundaries(&compared))?,
        fidelity: Told::of(py, &table::fidelities(&compared))?,
        stiffness_n_per_m: place.middle().stiffness_n_per_m,
        damping_n_s_per_m: place.middle().damping_n_s_per_m,
        walls: Told::of(py, &walls)?,
        true_velocity_area_n2_s_per_m2: place.told_area,
        impedance_error_of_loop: of_loop.unwrap_or(f64::NAN),
        winners: winners.collect::<PyResult<_>>()?,
        notes: notes.into_iter().collect(),
    })
}

result! { table(table)
    /// The answer to what limits the walls of a scene.
    Explanation {
        /// Name of the scene.
        scene: String,
        /// The unchanged scene, then the changes, the largest area first. The columns are those of the command line's
        /// `explain.csv`.
        table: Told,
        /// Every point of every walk. The columns are `change`, `repeat`, `damping_n_s_per_m` and `stiffness_n_per_m`.
        boundaries: Told,
        /// The B at which K is read, in N s/m.
        damping_n_s_per_m: f64,
        /// Sentences that say which part to buy, which walls are possible without a new part, and whether another
        /// estimator helps.
        answers: Tuple<String>,
    }
}

/// Change one element at a time, tune the velocity filter again for each change, and rank the changes.
///
/// Limit, push, arm, latency and output period come from the scene. Use `Scene.replace` to change them.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment.
/// criterion : str
///     As in `compare`.
/// damping : float, optional
///     B at which K is read, N s/m. Default: the smaller of 100 and half of the largest B that the scene reaches.
/// budget : int
///     Largest number of tunings that the search tries for each change, 3 to 1000. With two parameters the limit is
///     four times as large.
/// repeat : int
///     Number of walks at the result of each search, 2 or more. The starts are spread over a count.
/// engine, threads, progress
///     As in `compare`.
///
/// Raises
/// ------
/// ValueError
///     Something is out of range, or the handle does not reach the wall.
#[pyfunction]
#[pyo3(signature = (
    scene, *, criterion = "quiet", damping = None, budget = 8, repeat = 4, engine = "lanes", threads = None,
    progress = None
))]
pub fn explain(
    py: Python<'_>,
    scene: Given,
    criterion: &str,
    damping: Option<f64>,
    budget: u32,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Explanation> {
    let (scene, engine, by) = (scene.0, engine_of(engine)?, criterion_of(criterion)?);
    let budget = budget_of(budget, repeat, 2)?;
    if let Some(damping) = damping {
        asked::check_read_off(&scene, damping, "damping").map_err(raised)?;
    }
    let (name, total) = (scene.name.clone(), changed::most_walks(&scene.scene, budget));
    let found = run(py, threads, progress.as_ref(), total, move |course| {
        let Ranked { scene, beside } = ranked_of(engine, &scene, by, &course.stop)?;
        let (both, done) = ((&scene.scene, beside.as_ref()), |walks| course.add(walks));
        changed::explain(engine, both, damping, budget, &course.stop, done)
            .map_err(|error| error.of(&scene.name))
    })?;
    Ok(Explanation {
        scene: name,
        table: Told::of(py, &found.table())?,
        boundaries: Told::of(py, &found.boundaries())?,
        damping_n_s_per_m: found.damping_n_s_per_m,
        answers: found.answers().into_iter().collect(),
    })
}

const NAMES: Names = Names { limits: "limits", steps: "steps" };

/// A limit as Python gives it: a number in m, or a word as on the command line.
#[derive(FromPyObject)]
pub enum LimitGiven {
    Metres(f64),
    Words(String),
}

impl Item for LimitGiven {
    const NAMES: &str = "limits";
}

fn limit_of(words: &str) -> PyResult<LimitAsked> {
    LimitAsked::parse(words).map_err(|line| PyValueError::new_err(format!("limits: {line}")))
}

result! { table(table)
    /// The default velocity filters of other systems. They are compared with the scene's own estimator and the true
    /// velocity.
    Peers {
        /// Name of the scene.
        scene: String,
        /// One row for each loop, estimator and limit, with the columns of the command line's `peers.csv`.
        table: Told,
        /// Notes that a reader needs to understand the numbers. The notes also name the defaults that cannot run at the
        /// scene's rate.
        notes: Tuple<String>,
    }
}

/// Walk with the default velocity filters of other systems, without tuning.
///
/// The results also have the true velocity and the scene's own estimator. If the scene's own estimator has a cutoff,
/// the cutoffs 500 and 1500 Hz are used. All walks are made in the scene's own loop, and again with the latency and
/// output of each board. With the scene's own steps, the walks take minutes.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment.
/// limits : iterable of float or str, optional
///     `"quiet"`, a limit for the RMS of the true motion, m, or `"felt"` for the scene's sensation level. `"felt=10"`
///     sets another level, dB. Default: quiet, 15 um, 1 um, and felt.
/// steps : tuple of float, optional
///     Step of K, N/m, and step of B, N s/m. The walks also begin at these values. Default: a quarter of the scene's
///     step of K and half of its step of B.
/// repeat : int
///     Number of walks of each row. The starts are spread over a count.
/// engine, threads
///     As in `walk`.
/// progress : callable, optional
///     Called from this thread with the number of finished walks and the largest possible number. An exception in this
///     function ends the work.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, a limit is unknown, or the handle does not reach the wall.
#[pyfunction]
#[pyo3(signature = (
    scene, *, limits = None, steps = None, repeat = 4, engine = "lanes", threads = None, progress = None
))]
pub fn peers(
    py: Python<'_>,
    scene: Given,
    limits: Option<Several<LimitGiven>>,
    steps: Option<Numbers>,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Peers> {
    let (scene, engine) = (scene.0, engine_of(engine)?);
    in_range("repeat", repeat, 1..=1000)?;
    let limits: Vec<_> = match limits {
        Some(Several(limits)) => limits
            .into_iter()
            .map(|limit| match limit {
                LimitGiven::Metres(metres) => limit_of(&metres.to_string()),
                LimitGiven::Words(words) => limit_of(&words),
            })
            .collect::<PyResult<_>>()?,
        None => LIMITS.split(',').map(limit_of).collect::<PyResult<_>>()?,
    };
    not_empty("limits", &limits)?;
    let two = |Several(steps): Numbers| {
        let refused = |steps: Vec<f64>| format!("steps has {} numbers, allowed 2", steps.len());
        <[f64; 2]>::try_from(steps).map_err(|steps| PyValueError::new_err(refused(steps)))
    };
    let steps = steps.map(two).transpose()?;
    let question = PeerQuestion::of(&scene, &limits, steps, repeat, NAMES).map_err(raised)?;
    let total = question.walks();
    let of_work = Arc::clone(&scene);
    let found = run(py, threads, progress.as_ref(), total, move |course| {
        asked::prepare(&of_work)?;
        compare_peers(How { engine, numeric: Numeric::Fixed, stop: &course.stop }, question, || {
            course.add(1)
        })
        .map_err(|error| error.of(&of_work.name))
    })?;
    let table = Told::of(py, &found.table())?;
    let notes = found.notes.into_iter().chain(scene.scene.estimated_note()).collect();
    Ok(Peers { scene: scene.name.clone(), table, notes })
}

result! { table(table)
    /// Walls that are stable and whose rendered impedance is accurate. Each estimator is tuned for each limit.
    Usable {
        /// Name of the scene.
        scene: String,
        /// One row for each limit and estimator. The largest area comes first. The columns are those of the command
        /// line's `usable.csv`. `within_percent` is NaN if any error is allowed.
        table: Told,
    }
}

/// Tune estimators for walls that are stable and whose impedance error is below a limit.
///
/// Limit, push, arm, latency and output period come from the scene. Use `Scene.replace` to change them. With the usual
/// estimators, the function takes minutes.
///
/// Parameters
/// ----------
/// scene : Scene
///     Device and experiment. The scene's own estimator has no effect.
/// percents : iterable of float
///     Limits of the largest error from 1 to 30 Hz, % of the magnitude of K + jwB, 0.1 to 1000. A last limit that
///     allows any error is added.
/// estimators : iterable of str, optional
///     Names of estimators. By default the usual estimators of each kind whose inputs the scene has.
/// criterion, budget, repeat, engine, threads, progress
///     As in `compare`.
///
/// Raises
/// ------
/// ValueError
///     A value is out of range, a list is empty, an estimator is unknown, or the handle does not reach the wall. Or the
///     scene does not have the inputs of an estimator.
#[pyfunction]
#[pyo3(signature = (
    scene, *, percents = Several(vec![5.0, 10.0, 20.0]), estimators = None, criterion = "quiet", budget = 24, repeat = 4,
    engine = "lanes", threads = None, progress = None
))]
pub fn usable(
    py: Python<'_>,
    scene: Given,
    percents: Numbers,
    estimators: Option<Texts>,
    criterion: &str,
    budget: u32,
    repeat: u32,
    engine: &str,
    threads: Option<usize>,
    progress: Option<Progress>,
) -> PyResult<Usable> {
    let (scene, engine, by) = (scene.0, engine_of(engine)?, criterion_of(criterion)?);
    let budget = budget_of(budget, repeat, 1)?;
    not_empty("percents", &percents.0)?;
    let percents = commanded::percents(&percents.0, "percents").map_err(raised)?;
    let entries = entries_of(estimators, &scene)?;
    let entries = entries.unwrap_or_else(|| commanded::usual(&scene.scene));
    let question = UsableQuestion::of(entries, &percents, budget);
    let (name, total) = (scene.name.clone(), question.most_walks());
    let found = run(py, threads, progress.as_ref(), total, move |course| {
        let scene = ranked_of(engine, &scene, by, &course.stop)?.scene;
        let done = |walks| course.add(walks);
        let found = commanded::usable(engine, &scene.scene, &question, &course.stop, done)
            .map_err(|error| error.of(&scene.name))?;
        Ok(UsableStudy { question, found })
    })?;
    Ok(Usable { scene: name, table: Told::of(py, &found.table())? })
}
