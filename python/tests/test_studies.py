"""Results beside those of the command line: the same bits."""

import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zwidth
from conftest import Run, becomes_table, followed, rows, saved, simulate

SHORT = {"wall_hit.settle_s": 0.6, "wall_hit.window_s": 0.4}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[zwidth.Scene, Path]:
    scene = zwidth.Scene.load("paper-2um").replace(
        SHORT | {"walk.stiffness_step_n_per_m": 4000.0, "walk.damping_step_n_s_per_m": 40.0}
    )
    return scene, saved(scene, tmp_path_factory.mktemp("scene"))


@pytest.mark.parametrize("numeric", ["fixed", "f64", "f64-rounded"])
def test_a_hit(scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path, numeric: Any) -> None:
    here, file = scene
    for stiffness in (8000.0, 60000.0):
        made = zwidth.hit(here, stiffness=stiffness, damping=30.0, cutoff=500, numeric=numeric, trace=True)
        trace = tmp_path / f"{stiffness}.csv"
        wall = ["--stiffness", stiffness, "--damping", 30, "--cutoff", 500, "--numeric", numeric]
        said = sim("hit", file, *wall, "--trace", trace)
        assert said["stable"] == made.stable
        for key, value in vars(made).items():
            if key not in ("scene", "trace"):
                assert said.get(key) == value, key  # what a scene has not is absent there, None here
        assert made.trace is not None
        table = rows(trace)
        for name, column in made.trace.columns().items():
            assert [float(row[name]) for row in table] == column.tolist(), name
    assert zwidth.hit(here, stiffness=8000, damping=30, cutoff=500).trace is None


def test_a_walk(scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path) -> None:
    here, file = scene
    said = sim("walk", file, "--cutoff", 500, "--start-offset", 0.25, "--csv", tmp_path / "walk.csv")
    for engine in ("lanes", "core"):
        made = zwidth.walk(here, cutoff=500, start_offset=0.25, engine=engine, threads=1)  # type: ignore[arg-type]
        assert made.area == said["area_n2_s_per_m2"]
        assert made.stiffness_peak_n_per_m == said["stiffness_peak_n_per_m"]
        assert made.damping_max_n_s_per_m == said["damping_max_n_s_per_m"]
        assert (made.hits, made.ended_by) == (said["hits"], said["ended_by"])
        table = rows(tmp_path / "walk.csv")
        for name, column in made.columns().items():
            assert [float(row[name]) for row in table] == column.tolist(), name


def test_a_sweep(scene: tuple[zwidth.Scene, Path], tmp_path: Path) -> None:
    here, file = scene
    made = followed(zwidth.sweep, here, cutoffs=[500, 100], repeat=2, ends=(4, 4))
    out = tmp_path / "out"
    options = ["--cutoffs", "100,500", "--repeat", 2, "--plain", "--out", out]
    assert simulate("sweep", file, *options).returncode == 0
    boundary = rows(out / "boundary.csv")
    points = [
        (hz, b, k)
        for hz, walks in zip(made.cutoffs_hz, made.walks, strict=True)
        for walk in walks
        for b, k in zip(walk.damping_n_s_per_m, walk.stiffness_n_per_m, strict=True)
    ]
    names = ("cutoff_hz", "damping_n_s_per_m", "stiffness_n_per_m")
    assert [tuple(float(row[name]) for name in names) for row in boundary] == points
    areas = rows(out / "areas.csv")
    assert list(areas[0]) == list(made.columns())
    for name in made.columns():
        assert [float(row[name]) for row in areas] == made.columns()[name].tolist(), name
    assert made.ideal_cutoff_hz in (100, 500)
    assert made.areas.shape == (2, 2)


def test_a_grid(scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path) -> None:
    here, file = scene
    made = zwidth.grid(here, cutoffs=[100, 500], dampings=[10, 40, 80], stiffnesses=[4e3, 16e3, 64e3, 256e3])
    lists = ["--cutoffs", "100,500", "--dampings", "10,40,80", "--stiffnesses", "4000,16000,64000,256000"]
    said = sim("grid", file, *lists, "--csv", tmp_path / "grid.csv")
    assert made.verdict.shape == made.rms_m.shape == (2, 3, 4)
    assert int(made.stable.sum()) == said["stable"]
    table = rows(tmp_path / "grid.csv")
    columns = made.columns()
    assert [row["verdict"] for row in table] == columns["verdict"].tolist()
    for name in ("cutoff_hz", "damping_n_s_per_m", "stiffness_n_per_m"):
        assert [float(row[name]) for row in table] == columns[name].tolist()
    for row, rms_m in zip(table, columns["rms_m"], strict=True):
        assert math.isnan(rms_m) if row["rms_m"] == "" else float(row["rms_m"]) == rms_m


@pytest.mark.parametrize("multirate", [False, True])
def test_a_linear_boundary(scene: tuple[zwidth.Scene, Path], sim: Run, multirate: bool) -> None:
    here, file = scene
    dampings = [0, 10, 50, 150]
    made = zwidth.linear(here, cutoff=500, dampings=dampings, multirate=multirate, passivity=True)
    options = ["--cutoffs", 500, "--dampings", "0,10,50,150", "--passivity"]
    said = sim("linear", file, *options, *(["--multirate"] if multirate else []))
    assert [row["stiffness_max_n_per_m"] for row in said["rows"]] == made.stiffness_max_n_per_m.tolist()
    assert made.stiffness_passive_n_per_m is not None
    assert [row["stiffness_passive_n_per_m"] for row in said["rows"]] == made.stiffness_passive_n_per_m.tolist()
    assert [row["gain_margin_holds"] for row in said["rows"]] == made.gain_margin_holds.tolist()
    assert said["left_out"] == list(made.left_out)


def test_results_do_not_change_and_become_tables(scene: tuple[zwidth.Scene, Path]) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    made = zwidth.walk(scene[0], cutoff=500)
    with pytest.raises(ValueError, match="read-only"):
        made.stiffness_n_per_m[0] = 0.0
    with pytest.raises(AttributeError):
        made.area = 0.0  # type: ignore[misc]
    assert isinstance(made.to_pandas(), pandas.DataFrame)
    becomes_table(made, made.columns())
    assert np.array_equal(made.to_arrow()["stiffness_n_per_m"].to_numpy(), made.stiffness_n_per_m)


def test_bad_input_is_refused_as_on_the_command_line(scene: tuple[zwidth.Scene, Path], refused: Run) -> None:
    here, file = scene
    with pytest.raises(ValueError, match="cutoff is -1, allowed") as raised:
        zwidth.walk(here, cutoff=-1)
    assert refused("walk", file, "--cutoff", -1).replace("--cutoff", "cutoff") == str(raised.value)
    with pytest.raises(ValueError, match="a cutoff is missing"):
        zwidth.walk(here)
    with pytest.raises(ValueError, match="first point of the walk") as raised:
        zwidth.walk(here.replace({"walk.damping_start_n_s_per_m": 3000.0}), cutoff=50)
    for call, line in [
        (lambda: zwidth.hit(here, stiffness=-5, damping=0, cutoff=500), "stiffness is -5, allowed"),
        (lambda: zwidth.hit(here, stiffness=5, damping=0, cutoff=500, numeric="f16"), "allowed fixed"),  # type: ignore
        (lambda: zwidth.walk(here, cutoff=500, engine="gpu"), "allowed core, lanes"),  # type: ignore[arg-type]
        (lambda: zwidth.walk(here, cutoff=500, threads=0), "threads is 0"),
        (lambda: zwidth.sweep(here, cutoffs=[]), "cutoffs is empty"),
        (lambda: zwidth.sweep(here, repeat=0), "repeat is 0"),
        (lambda: zwidth.grid(here, cutoffs=[500], dampings=[1], stiffnesses=[]), "stiffnesses is empty"),
        (lambda: zwidth.grid(here, cutoffs=[500], dampings=[math.nan], stiffnesses=[1]), "dampings is NaN"),
        (lambda: zwidth.linear(here, cutoff=500, dampings=[]), "dampings is empty"),
    ]:
        with pytest.raises(ValueError) as raised:
            call()
        assert line in str(raised.value), raised.value


def test_what_is_no_scene_and_no_list_is_named() -> None:
    scene = zwidth.Scene.load("paper-2um")
    calls: list[Callable[[Any], object]] = [
        lambda other: zwidth.hit(other, stiffness=1e3, damping=1.0),
        lambda other: zwidth.walk(other),
        lambda other: zwidth.Estimator("difference", other),
        lambda other: zwidth.identify("log.csv", base=other),
    ]
    for call in calls:
        with pytest.raises(TypeError, match=r"'paper-2um' is no scene, allowed zwidth\.Scene\.load\('paper-2um'\)"):
            call("paper-2um")
        with pytest.raises(TypeError, match="None is no scene, allowed"):
            call(None)
    texts: list[Callable[[Any], object]] = [
        lambda text: zwidth.sweep(scene, cutoffs=text),
        lambda text: zwidth.grid(scene, cutoffs=[500], stiffnesses=text, dampings=[1]),
        lambda text: zwidth.linear(scene, cutoff=500, dampings=text),
        lambda text: zwidth.usable(scene, percents=text),
        lambda text: zwidth.compare(scene, estimators=text),
        lambda text: zwidth.peers(scene, limits=text),
    ]
    for call in texts:
        with pytest.raises(TypeError, match="'55', allowed several"):
            call("55")
    with pytest.raises(TypeError, match="55, allowed several numbers: a list or an array"):
        zwidth.sweep(scene, cutoffs=55)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="a cutoff is missing"):
        zwidth.walk(scene)


def test_results_are_frozen_pickled_compared_and_short() -> None:
    scene = zwidth.Scene.load("paper-2um").replace(walk={"stiffness_step_n_per_m": 20e3, "damping_step_n_s_per_m": 200.0})
    made = zwidth.sweep(scene, cutoffs=[100, 500, 2000], repeat=4)
    assert len(repr(made)) < 1000, repr(made)
    assert "ideal_cutoff_hz=" in repr(made) and "walks=<tuple of 3>" in repr(made)
    again = pickle.loads(pickle.dumps(made))
    assert np.array_equal(again.areas, made.areas) and again.notes == made.notes
    assert np.array_equal(again.walks[1][0].stiffness_n_per_m, made.walks[1][0].stiffness_n_per_m)
    assert not again.areas.flags.writeable
    with pytest.raises(AttributeError):
        made.area = None  # type: ignore[misc]
    hit = zwidth.hit(scene, stiffness=10e3, damping=30.0, cutoff=500)
    assert hit == zwidth.hit(scene, stiffness=10e3, damping=30.0, cutoff=500) == pickle.loads(pickle.dumps(hit))
    assert hit != zwidth.hit(scene, stiffness=11e3, damping=30.0, cutoff=500)
    assert len({hit, pickle.loads(pickle.dumps(hit))}) == 1
    assert repr(hit).startswith("Hit(scene='paper-2um', cutoff_hz=500.0, stiffness_n_per_m=10000.0,")


def test_progress_of_a_recommendation_is_of_the_walks_that_are_planned(scene: tuple[zwidth.Scene, Path]) -> None:
    seen: list[tuple[int, int]] = []
    zwidth.recommended(scene[0], cutoffs=[300, 500], progress=lambda done, planned: seen.append((done, planned)))
    assert all(done <= planned and planned >= 2 for done, planned in seen), seen
    assert seen[-1][0] == seen[-1][1] > 2, "cutoffs between are walked too"
