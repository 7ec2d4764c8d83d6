"""Comparisons beside those of the command line: the same bits."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zwidth
from conftest import Run, becomes_table, followed, refuses, rows, same_table, saved

COARSE = {
    "wall_hit.settle_s": 1.0,
    "wall_hit.window_s": 0.5,
    "walk.stiffness_step_n_per_m": 8000.0,
    "walk.stiffness_max_n_per_m": 200e3,
    "walk.damping_step_n_s_per_m": 60.0,
    "walk.damping_max_n_s_per_m": 1200.0,
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[zwidth.Scene, Path]:
    scene = zwidth.Scene.load("paper-2um").replace(COARSE)
    return scene, saved(scene, tmp_path_factory.mktemp("scene"))


# An estimator without a parameter, with one and two, that looks at more than the position; the reference left out.
@pytest.mark.parametrize("names, damping", [(["difference", "butterworth", "observer"], None), (["kalman-2"], 60)])
def test_a_comparison(
    scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path, names: list[str], damping: float | None
) -> None:
    here, file = scene
    made = followed(zwidth.compare, here, estimators=names, damping=damping, budget=6, repeat=2)
    options = ["--estimators", ",".join(names), "--budget", 6, "--repeat", 2, "--out", tmp_path]
    said = sim("compare", file, *options, *([] if damping is None else ["--damping", damping]))
    tables = {"compare": made.table, "tuning": made.tunings, "boundary": made.boundaries, "fidelity": made.fidelity}
    for name, table in tables.items():
        same_table(rows(tmp_path / f"{name}.csv"), table)
    assert list(made.table["estimator"]) == names
    wall = ("stiffness_n_per_m", "damping_n_s_per_m")
    for key in (*wall, "true_velocity_area_n2_s_per_m2", "impedance_error_of_loop"):
        assert said[key] == getattr(made, key), key
    assert said["notes"] == list(made.notes)
    for key in wall:
        assert [wall[key] for wall in said["walls"]] == made.walls[key].tolist()
    assert len(said["winners"]) == len(made.winners) > 0
    for winner, mine in zip(said["winners"], made.winners, strict=True):
        told = {"class" if key == "looks_at" else key: value for key, value in vars(mine).items()}
        assert winner == {key: list(value) if isinstance(value, tuple) else value for key, value in told.items()}
    becomes_table(made, made.table)


@pytest.mark.parametrize("damping", [None, 70])
def test_an_explanation(
    scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path, damping: float | None
) -> None:
    few = {"wall_hit.window_s": 0.1, "walk.damping_step_n_s_per_m": 200.0, "walk.stiffness_step_n_per_m": 20e3}
    here = scene[0].replace(few | {"walk.stiffness_max_n_per_m": 1e5, "walk.damping_max_n_s_per_m": 460.0})
    made = followed(zwidth.explain, here, damping=damping, budget=3, repeat=2)
    options = ["--budget", 3, "--repeat", 2, "--out", tmp_path / "out"]
    said = sim("explain", saved(here, tmp_path), *options, *([] if damping is None else ["--damping", damping]))
    assert said["damping_n_s_per_m"] == made.damping_n_s_per_m
    assert said["answers"] == list(made.answers)
    same_table(rows(tmp_path / "out/boundary.csv"), made.boundaries)
    commas = {name: made.table[name] for name in ("what", "cost")}  # the file has others, and no quotes
    in_file = {name: np.char.replace(texts, ",", ";") for name, texts in commas.items()}
    same_table(rows(tmp_path / "out/explain.csv"), zwidth.Table(dict(made.table) | in_file))
    for name, texts in commas.items():
        assert [row[name] for row in said["changes"]] == texts.tolist()
    becomes_table(made, made.table)


def test_defaults_of_other_systems(scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path) -> None:
    here, file = scene
    made = followed(zwidth.peers, here, limits=(15e-6, "felt", "felt=10"), steps=(20e3, 200), repeat=2)
    options = ["--limits", "15e-6,felt,felt=10", "--steps", "20e3,200", "--repeat", 2, "--out", tmp_path]
    said = sim("compare", file, "--peers", *options)
    same_table(rows(tmp_path / "peers.csv"), made.table)
    assert [area["does"] for area in said["areas"]] == made.table["does"].tolist()
    assert said["notes"] == list(made.notes)
    assert set(made.table["walks"]) == {2} and set(made.table["limit_unit"]) == {"m", "dB"}
    assert any("," in text for text in made.table["does"]) and all(made.table["does"])
    becomes_table(made, made.table)


def test_the_usual_limits_and_steps_of_other_systems(sim: Run, tmp_path: Path) -> None:
    brief = {"wall_hit.settle_s": 0.5, "wall_hit.window_s": 0.5}
    caps = {"walk.stiffness_max_n_per_m": 4000.0, "walk.damping_max_n_s_per_m": 40.0}
    steps = {"walk.stiffness_step_n_per_m": 4000.0, "walk.damping_step_n_s_per_m": 40.0}
    here = zwidth.Scene.load("paper-1um").replace(brief | caps | steps)
    sim("compare", saved(here, tmp_path), "--peers", "--out", tmp_path / "out")
    same_table(rows(tmp_path / "out/peers.csv"), zwidth.peers(here).table)


@pytest.mark.parametrize("percents", [(20, 5, 20.0), None])
def test_usable_areas(
    scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path, percents: tuple[float, ...] | None
) -> None:
    here, file = scene
    names = ["butterworth", "levant-explicit", "difference"] if percents else None
    asked: dict[str, Any] = {} if percents is None else {"percents": percents, "estimators": names}
    if percents is None:
        brief = {"walk.stiffness_step_n_per_m": 40e3, "walk.stiffness_max_n_per_m": 80e3}
        here = here.replace(brief | {"walk.damping_step_n_s_per_m": 200.0, "walk.damping_max_n_s_per_m": 260.0})
        file = saved(here, tmp_path)
    made = followed(zwidth.usable, here, budget=3, repeat=2, **asked)
    options = ["--usable", *(["20,5,20"] if percents else []), "--budget", 3, "--repeat", 2, "--out", tmp_path / "out"]
    said = sim("compare", file, *options, *(["--estimators", ",".join(names)] if names else []))
    same_table(rows(tmp_path / "out/usable.csv"), made.table)
    assert [area["hits"] for area in said["areas"]] == made.table["hits"].tolist()
    limits = made.table["within_percent"]
    assert set(limits[np.isfinite(limits)]) == ({5, 20} if percents else {5, 10, 20}) and np.isnan(limits[-1])
    becomes_table(made, made.table)


def test_engine_and_threads_change_nothing(scene: tuple[zwidth.Scene, Path]) -> None:
    asked: dict[str, Any] = {"estimators": ["butterworth"], "budget": 3, "repeat": 1}
    one = zwidth.compare(scene[0], engine="core", threads=1, **asked)
    two = zwidth.compare(scene[0], threads=2, **asked)
    assert one.winners == two.winners
    for name in ("table", "tunings", "boundaries", "fidelity"):
        for column, values in getattr(one, name).items():
            np.testing.assert_array_equal(values, getattr(two, name)[column])


COMPARE, EXPLAIN, PEERS, USABLE = zwidth.compare, zwidth.explain, zwidth.peers, zwidth.usable


@pytest.mark.parametrize(
    ("call", "asked", "options"),
    [
        (COMPARE, {"estimators": ["butterworth", "kalman"]}, ["compare", "--estimators", "butterworth,kalman"]),
        (COMPARE, {"estimators": ["fusion"]}, ["compare", "--estimators", "fusion"]),
        (COMPARE, {"damping": 1e9}, ["compare", "--damping", "1e9"]),
        (EXPLAIN, {"damping": 1e9}, ["explain", "--damping", "1e9"]),
        (PEERS, {"limits": [2.0]}, ["compare", "--peers", "--limits", "2"]),
        (PEERS, {"limits": ["felt=9999"]}, ["compare", "--peers", "--limits", "felt=9999"]),
        (PEERS, {"steps": (1e9, 1.0)}, ["compare", "--peers", "--steps", "1e9,1"]),
        (USABLE, {"percents": [5, 0]}, ["compare", "--usable", "5,0"]),
        (USABLE, {"estimators": ["kalman"]}, ["compare", "--usable", "--estimators", "kalman"]),
    ],
)
def test_a_bad_question_is_refused_as_on_the_command_line(
    scene: tuple[zwidth.Scene, Path], refused: Run, call: Run, asked: dict[str, Any], options: list[str]
) -> None:
    here, file = scene
    line = refused(options[0], file, *options[1:])
    refuses(call, line.replace("--usable", "percents").removeprefix("--"), here, **asked)


NO_LIMIT = "is no limit, allowed an RMS in m (above 0), quiet, felt, or felt=DB (DB over the threshold)"


@pytest.mark.parametrize(
    ("call", "asked", "line"),
    [
        *((call, {"estimators": []}, "estimators is empty") for call in (COMPARE, USABLE)),
        *((call, {"budget": 2}, "budget is 2, allowed 3 to 1000") for call in (COMPARE, EXPLAIN, USABLE)),
        *((call, {"repeat": 0}, "repeat is 0, allowed 1 to 1000") for call in (COMPARE, PEERS, USABLE)),
        (EXPLAIN, {"repeat": 1}, "repeat is 1, allowed 2 to 1000"),
        (USABLE, {"percents": []}, "percents is empty"),
        (PEERS, {"limits": []}, "limits is empty"),
        (PEERS, {"limits": [1e-6, -1.0]}, f"limits: `-1` {NO_LIMIT}"),
        (PEERS, {"limits": [math.nan]}, f"limits: `NaN` {NO_LIMIT}"),
        (PEERS, {"limits": ["faint"]}, f"limits: `faint` {NO_LIMIT}"),
        (PEERS, {"steps": [4000.0]}, "steps has 1 numbers, allowed 2"),
        (PEERS, {"engine": "gpu"}, 'engine is "gpu", allowed core, lanes'),
    ],
)
def test_a_bad_question(scene: tuple[zwidth.Scene, Path], call: Run, asked: dict[str, Any], line: str) -> None:
    refuses(call, line, scene[0], **asked)


@pytest.mark.parametrize("call", [COMPARE, EXPLAIN, PEERS, USABLE])
def test_what_progress_raises_ends_a_comparison(scene: tuple[zwidth.Scene, Path], call: Run) -> None:
    def stop(done: int, total: int) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        call(scene[0], progress=stop)
