use std::{path::Path, sync::atomic::AtomicBool};

use super::{unit::Made, *};
use crate::{engine::Engine, simulation::prepared::Numeric, study::How, table};

const SHORT: &str = "wall_hit = { settle_s = [0.6], window_s = [0.4] }
walk = { stiffness_step_n_per_m = [8000], damping_step_n_s_per_m = [80] }\n";

fn study(text: &str) -> Result<Study, Error> {
    Study::new(StudyFile::parse(text.into(), "s.toml", Path::new(""))?)
}

fn made(study: &Study, engine: Engine, threads: usize) -> Vec<Made> {
    let stop = AtomicBool::new(false);
    let how = How { engine, numeric: Numeric::Fixed, stop: &stop };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| (0..study.units).map(|unit| study.run(unit, how).unwrap()).collect())
}

#[test]
fn units_are_the_same_on_any_engine_and_threads_and_however_points_are_grouped() {
    for measure in [
        "measure = \"walk\"\nstarts_counts = [0, 0.5]",
        "measure = \"hit\"\nstarts_counts = [0, 0.5]\nstiffnesses = [4000, 200000]\ndampings = \"10:20:50\"",
        "measure = \"sweep\"\nrepeat = 2",
    ] {
        let text = |per_unit: u32| {
            format!(
                "{measure}\nscenes = [\"paper-2um\"]\nestimators = [\"difference\", {{ estimator = \"butterworth\", \
                 prewarp = false }}]\ncutoffs_hz = [200, 1500]\npoints_per_unit = {per_unit}\n[product]\n{SHORT}\
                 actuator.latency = [0, 10]\n[[list]]\ndevice.mass_kg = 0.2\n[[list]]\ndevice.mass_kg = 0.4\n"
            )
        };
        let study = |per_unit| study(&text(per_unit)).unwrap();
        let (one, three) = (study(1), study(3));
        assert_eq!(one.units, one.points);
        let whole = made(&three, Engine::lanes(), 2);
        assert_eq!(made(&three, Engine::lanes(), 1), whole);
        assert_eq!(made(&three, Engine::Core, 2), whole);
        let rows = |all: Vec<Made>| -> Vec<Vec<table::Cell>> {
            all.into_iter().flat_map(|made| made.table.rows).collect()
        };
        assert_eq!(rows(made(&one, Engine::lanes(), 2)), rows(whole));
        let mut keys: Vec<String> =
            (0..one.units).map(|unit| one.unit_key(unit, Numeric::Fixed)).collect();
        assert_ne!(keys[0], one.unit_key(0, Numeric::F64));
        keys.sort();
        keys.dedup();
        assert_eq!(keys.len() as u64, one.units, "every unit has a key of its own");
    }
}

#[test]
fn points_run_in_the_order_that_the_page_says() {
    let text = "measure = \"hit\"\nscenes = [\"paper-1um\", \"paper-2um\"]\ncutoffs_hz = [500, 1500]\nstiffnesses = \
        [1000, 2000]\ndampings = [10, 20]\nstarts_counts = [0, 0.5]\n[product]\nactuator.latency = [0, 10]\n\
        actuator.period = [5, 10]\n[[list]]\ndevice.mass_kg = 0.2\n[[list]]\ndevice.mass_kg = 0.4\n";
    let study = study(text).unwrap();
    assert_eq!((study.points, study.file.variants()), (2 * 2 * 4 * 2 * 2 * 4, 8));
    let block = &study.blocks[0];
    let hit = |n: u64| {
        let Point { cutoff_hz, stiffness, damping, start_offset_counts, .. } =
            study.point(block, n);
        [cutoff_hz.unwrap(), start_offset_counts, damping, stiffness]
    };
    assert_eq!(hit(0), [500.0, 0.0, 10.0, 1000.0]);
    assert_eq!(hit(1), [500.0, 0.0, 10.0, 2000.0]);
    assert_eq!(hit(2), [500.0, 0.0, 20.0, 1000.0]);
    assert_eq!(hit(4), [500.0, 0.5, 10.0, 1000.0]);
    assert_eq!(hit(8), [1500.0, 0.0, 10.0, 1000.0]);
    assert_eq!(study.point(block, 16).variant, 1);
    let told = |variant| study.described(block, variant);
    let of = |mass, latency, period| {
        format!(
            "s.toml: paper-1um with device.mass_kg = {mass}, actuator.latency = {latency}, actuator.period = {period}"
        )
    };
    assert_eq!(told(0), of("0.2", "0", "5"));
    assert_eq!(told(1), of("0.2", "0", "10"));
    assert_eq!(told(2), of("0.2", "10", "5"));
    assert_eq!(told(4), of("0.4", "0", "5"));
    assert_eq!(study.blocks[1].first_point, 128);
    assert_eq!(study.block_of(study.blocks[1].first_unit).name, "paper-2um");
}

#[test]
fn a_walk_and_a_sweep_of_a_study_are_those_of_their_commands() {
    use crate::study::{sweep::Plan, walk::walk};
    let stop = AtomicBool::new(false);
    let text = format!(
        "measure = \"walk\"\nscenes = [\"paper-2um\"]\ncutoffs_hz = [500]\nstarts_counts = [0.25]\n[product]\n{SHORT}"
    );
    let of_walk = study(&text).unwrap();
    let scene = of_walk.scene(&of_walk.blocks[0], 0).unwrap();
    assert_eq!(scene.scene.wall_hit.settle_s, 0.6);
    let prepared = asked::prepare(&scene).unwrap();
    let numeric = Numeric::Fixed;
    let filter = scene.scene.velocity.at(500.0);
    let boundary = walk(Engine::Core, &prepared, numeric, filter, 0.25, &stop).unwrap();
    let row = made(&of_walk, Engine::lanes(), 2).remove(0).table.rows.remove(0);
    assert_eq!(row[9], table::Cell::Number(boundary.area));
    assert_eq!(row[12], table::Cell::Whole(boundary.hits));
    let of_sweep =
        study(&text.replace("walk\"", "sweep\"").replace("starts_counts = [0.25]\n", "")).unwrap();
    let plan = [Plan { name: "s", prepared: &prepared, filters: &[filter] }];
    let swept = crate::study::sweep::sweep(Engine::Core, &plan, numeric, 4, &stop, |_| ()).unwrap();
    let row = made(&of_sweep, Engine::lanes(), 1).remove(0).table.rows.remove(0);
    assert_eq!(row[9], table::Cell::Number(swept[0].cutoffs[0].boundaries.area()));
    assert_eq!(row[15], table::Cell::Number(swept[0].ideal.unwrap().cutoff_hz));
}

/// Every wrong value of every key of the file. Each has the error line that it must give.
#[test]
fn what_a_study_cannot_be_is_refused_with_key_value_and_what_is_allowed() {
    let good = "measure = \"walk\"\nscenes = [\"paper-2um\"]\ncutoffs_hz = [500]\n";
    let hit = good.replace("walk", "hit");
    let with = |text: &str, more: &str| format!("{text}{more}\n");
    let mut wrong = vec![];
    for (text, wanted) in [
        (
            good.replace("walk", "jump"),
            "s.toml:1: `measure = \"jump\"`: unknown variant `jump`, expected one of `walk`, `hit`, `sweep`",
        ),
        (
            good.replace("measure", "meassure"),
            "s.toml:1: `meassure = \"walk\"`: unknown field `meassure`",
        ),
        (good.replace("measure = \"walk\"\n", ""), "missing field `measure`"),
        (
            good.replace("[\"paper-2um\"]", "[]"),
            "scenes is empty, allowed built-in names and scene files",
        ),
        (good.replace("paper-2um", "paper-3um"), "paper-3um cannot be read"),
        (
            good.replace("[\"paper-2um\"]", "[\"paper-2um\", \"paper-2um\"]"),
            "scenes has two of the name paper-2um",
        ),
        (
            good.replace("[\"paper-2um\"]", "[\"paper-2um\", \"hapkit\"]"),
            "one of them rotary; allowed is one kind",
        ),
        (good.replace("[500]", "[]"), "the list is empty"),
        (good.replace("[500]", "[\"x\"]"), "expected numbers: [A, B] or \"FROM:STEP:TO\""),
        (good.replace("[500]", "\"500:0:900\""), "the step is 0, allowed above 0"),
        (good.replace("[500]", "[nan]"), "paper-2um: cutoffs_hz is NaN, allowed 0.35 to 4990"),
        (good.replace("[500]", "[500, 5000]"), "cutoffs_hz is 5000, allowed 0.35 to 4990"),
        (
            with(good, "starts_counts = [1e9]"),
            "starts_counts is 1000000000, allowed -1000000 to 1000000",
        ),
        (
            with(good, "starts_counts = [90000]"),
            "starts_counts is 90000, allowed -1000000 to 35000",
        ),
        (
            with(good, "stiffnesses = [1]"),
            "stiffnesses is given, but measure is walk, allowed with hit",
        ),
        (with(good, "dampings = [1]"), "dampings is given, but measure is walk, allowed with hit"),
        (with(good, "repeat = 4"), "repeat is given, but measure is walk, allowed with sweep"),
        (with(&good.replace("walk", "sweep"), "repeat = 0"), "repeat is 0, allowed 1 to 1000"),
        (
            with(&good.replace("walk", "sweep"), "starts_counts = [0]"),
            "starts_counts is given, but measure is sweep, allowed with hit and walk",
        ),
        (hit.clone(), "stiffnesses is missing, measure = \"hit\" needs it"),
        (with(&hit, "stiffnesses = [1]"), "dampings is missing, measure = \"hit\" needs it"),
        (
            with(&hit, "stiffnesses = [-1]\ndampings = [1]"),
            "stiffnesses is -1, allowed 0 to 10000000",
        ),
        (
            with(&hit, "stiffnesses = [1]\ndampings = [1e5]"),
            "dampings is 100000, allowed 0 to 10000",
        ),
        (with(good, "points_per_unit = 0"), "points_per_unit is 0, allowed 1 to 1000000"),
        (with(good, "estimators = [3]"), "estimators has 3, allowed names and tables"),
        (
            with(good, "estimators = [\"kalman\"]"),
            "with the estimator { estimator = \"kalman\" }: velocity.estimator: unknown variant `kalman`",
        ),
        (
            with(good, "estimators = [\"difference\"]"),
            "cutoffs_hz is given, but the estimator difference has none",
        ),
        (
            with(good, "[product]\nactuator.latency = []"),
            "product.actuator.latency is empty, allowed",
        ),
        (
            with(good, "[product]\nactuator.latency = 3"),
            "product.actuator.latency is 3, allowed [A, B]",
        ),
        (
            with(good, "[product]\nactuator.latency = \"3:\""),
            "product.actuator.latency: `3:` is neither A,B,C nor FROM:STEP:TO",
        ),
        (
            with(good, "[product]\nactuator.latency = [1, 1001]"),
            "paper-2um with actuator.latency = 1001: actuator.latency is 1001, allowed 0 to 1000",
        ),
        (
            with(good, "[product]\nactuator.delay = [1]"),
            "paper-2um with actuator.delay = 1: actuator: unknown field `delay`",
        ),
        (
            with(good, "[product]\nactuator.latency.x = [1]"),
            "actuator.latency.x: latency is no table of the scene",
        ),
        (
            with(good, "[product]\nactuator.latency = [1, true]"),
            "product.actuator.latency has true, allowed are numbers, texts, or true and false, all of one kind",
        ),
        (
            with(good, "[product]\nactuator.latency = [[1]]"),
            "product.actuator.latency has [1], allowed are numbers",
        ),
        (
            with(good, "[product]\nmass = [1]"),
            "product has mass, allowed for that: keys as TABLE.KEY",
        ),
        (
            with(good, "[product]\nvelocity.estimator = [\"difference\"]"),
            "product has velocity.estimator, allowed for that: the key `estimators`",
        ),
        (
            with(good, "[product]\nsweep.cutoffs_hz = [500]"),
            "product has sweep.cutoffs_hz, allowed for that: the key `cutoffs_hz`",
        ),
        (
            with(good, "[product]\nwall_hit.felt_curve = [\"x\"]"),
            "product has wall_hit.felt_curve, allowed for that: the scene's own file",
        ),
        (
            with(good, "[[list]]\ndevice.mass_kg = -1"),
            "paper-2um with device.mass_kg = -1: device.mass_kg is -1, allowed 0.001 to 100",
        ),
        (
            with(good, "[product]\n\"actuator.latency\" = [1]\nactuator.latency = [2]"),
            "product has actuator.latency twice, allowed once",
        ),
        (with(good, "[[list]]"), "list: entry 1 is empty, allowed keys of a scene"),
        (
            with(good, "[[list]]\ndevice.mass_kg = 1\n[[list]]\ncontrol.rate_hz = 1"),
            "list: entry 2 has the keys control.rate_hz, allowed those of the first: device.mass_kg",
        ),
        (
            with(good, "[[list]]\ndevice.mass_kg = [1]"),
            "list.device.mass_kg has [1], allowed are numbers",
        ),
        (
            with(good, "[[list]]\ndevice.mass_kg = 1\n[[list]]\ndevice.mass_kg = \"x\""),
            "list.device.mass_kg has \"x\", allowed are numbers",
        ),
        (
            with(good, "[product]\ndevice.mass_kg = [1]\n[[list]]\ndevice.mass_kg = 1"),
            "device.mass_kg is in [product] and in [[list]], allowed in one of them",
        ),
        (
            with(
                good,
                "[product]\ndevice.mass_kg = \"1:0.001:9\"\ndevice.damping_n_s_per_m = \"1:0.001:9\"",
            ),
            "make 64016001 scenes, allowed 1000000",
        ),
        (
            with(
                &hit,
                "stiffnesses = \"1:1:9999\"\ndampings = \"1:0.1:900\"\nstarts_counts = \"0:0.01:0.99\"",
            ),
            "points, allowed 1000000000",
        ),
        (
            with(&hit, "stiffnesses = \"1:1:9999\"\ndampings = \"1:1:999\"\npoints_per_unit = 1"),
            "units, allowed 100000; raise points_per_unit",
        ),
    ] {
        let line = study(&text).map(|_| ()).unwrap_err().to_string();
        if !line.starts_with("s.toml") || !line.contains(wanted) || line.lines().count() != 1 {
            wrong.push(format!("{line}\nshould say {wanted}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
