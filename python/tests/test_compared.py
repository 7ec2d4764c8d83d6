"""Comparisons beside those of the command line: the same bits."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zwidth
from conftest import Run, rows, same_table

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
    file = tmp_path_factory.mktemp("scene") / f"{scene.name}.toml"
    file.write_text(scene.to_toml())
    return scene, file


# An estimator without a parameter, with one and two, that looks at more than the position; the reference left out.
@pytest.mark.parametrize("names, damping", [(["difference", "butterworth", "observer"], None), (["kalman-2"], 60)])
def test_a_comparison(
    scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path, names: list[str], damping: float | None
) -> None:
    here, file = scene
    calls: list[tuple[int, int]] = []
    made = zwidth.compare(
        here,
        estimators=names,
        damping=damping,
        budget=6,
        repeat=2,
        progress=lambda done, total: calls.append((done, total)),
    )
    options = ["--estimators", ",".join(names), "--budget", 6, "--repeat", 2, "--out", tmp_path]
    said = sim("compare", file, *options, *([] if damping is None else ["--damping", damping]))
    tables = {"compare": made.table, "tuning": made.tunings, "boundary": made.boundaries, "fidelity": made.fidelity}
    for name, table in tables.items():
        same_table(rows(tmp_path / f"{name}.csv"), table)
    assert list(made.table["estimator"]) == names
    for key in (
        "damping_n_s_per_m",
        "stiffness_n_per_m",
        "true_velocity_area_n2_s_per_m2",
        "impedance_error_of_loop",
    ):
        assert said[key] == getattr(made, key), key
    assert said["notes"] == list(made.notes)
    for key in ("stiffness_n_per_m", "damping_n_s_per_m"):
        assert [wall[key] for wall in said["walls"]] == made.walls[key].tolist()
    assert len(said["winners"]) == len(made.winners) > 0
    for winner, mine in zip(said["winners"], made.winners, strict=True):
        told: dict[str, Any] = vars(mine)
        told = {"class" if key == "looks_at" else key: value for key, value in told.items()}
        assert winner == {key: list(value) if isinstance(value, tuple) else value for key, value in told.items()}
    assert 0 < calls[-1][0] <= calls[-1][1]
    assert made.to_pandas().shape == (len(names), len(made.table))
    assert made.to_arrow().column_names == list(made.table)


@pytest.mark.parametrize("damping", [None, 70])
def test_an_explanation(
    scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path, damping: float | None
) -> None:
    few = {"wall_hit.window_s": 0.1, "walk.damping_step_n_s_per_m": 200.0, "walk.stiffness_step_n_per_m": 20e3}
    here = scene[0].replace(few | {"walk.stiffness_max_n_per_m": 1e5, "walk.damping_max_n_s_per_m": 460.0})
    file = tmp_path / "few.toml"
    file.write_text(here.to_toml())
    calls: list[tuple[int, int]] = []
    made = zwidth.explain(
        here, damping=damping, budget=3, repeat=2, progress=lambda done, total: calls.append((done, total))
    )
    options = ["--budget", 3, "--repeat", 2, "--out", tmp_path / "out"]
    said = sim("explain", file, *options, *([] if damping is None else ["--damping", damping]))
    assert said["damping_n_s_per_m"] == made.damping_n_s_per_m
    assert said["answers"] == list(made.answers)
    same_table(rows(tmp_path / "out/boundary.csv"), made.boundaries)
    csv = rows(tmp_path / "out/explain.csv")
    for row in csv:
        del row["schema_version"]
    commas = {name: made.table[name] for name in ("what", "cost")}  # the file has others, and no quotes
    in_file = {name: np.char.replace(texts, ",", ";") for name, texts in commas.items()}
    same_table(csv, zwidth.Table(dict(made.table) | in_file))
    for name, texts in commas.items():
        assert [row[name] for row in said["changes"]] == texts.tolist()
    assert 0 < calls[-1][0] <= calls[-1][1]
    assert made.to_pandas().shape == (len(csv), len(made.table))
    assert made.to_arrow().column_names == list(made.table)


def told(file: Path) -> list[dict[str, str]]:
    """A CSV without its version."""
    made = rows(file)
    for row in made:
        del row["schema_version"]
    return made


def test_defaults_of_other_systems(scene: tuple[zwidth.Scene, Path], sim: Run, tmp_path: Path) -> None:
    here, file = scene
    calls: list[tuple[int, int]] = []
    made = zwidth.peers(
        here,
        limits=(15e-6, "felt", "felt=10"),
        steps=(20e3, 200),
        repeat=2,
        progress=lambda done, total: calls.append((done, total)),
    )
    options = ["--limits", "15e-6,felt,felt=10", "--steps", "20e3,200", "--repeat", 2, "--out", tmp_path]
    said = sim("compare", file, "--peers", *options)
    same_table(told(tmp_path / "peers.csv"), made.table)
    assert [area["does"] for area in said["areas"]] == made.table["does"].tolist()
    assert said["notes"] == list(made.notes)
    assert set(made.table["walks"]) == {2} and set(made.table["limit_unit"]) == {"m", "dB"}
    assert any("," in text for text in made.table["does"]) and all(made.table["does"])
    assert 0 < calls[-1][0] <= calls[-1][1]
    assert made.to_pandas().shape == (len(said["areas"]), len(made.table))
    assert made.to_arrow().column_names == list(made.table)


def test_the_usual_limits_and_steps_of_other_systems(sim: Run, tmp_path: Path) -> None:
    brief = {"wall_hit.settle_s": 0.5, "wall_hit.window_s": 0.5}
    caps = {"walk.stiffness_max_n_per_m": 4000.0, "walk.damping_max_n_s_per_m": 40.0}
    steps = {"walk.stiffness_step_n_per_m": 4000.0, "walk.damping_step_n_s_per_m": 40.0}
    here = zwidth.Scene.load("paper-1um").replace(brief | caps | steps)
    file = tmp_path / f"{here.name}.toml"
    file.write_text(here.to_toml())
    sim("compare", file, "--peers", "--out", tmp_path / "out")
    same_table(told(tmp_path / "out/peers.csv"), zwidth.peers(here).table)


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
        file = tmp_path / "brief.toml"
        file.write_text(here.to_toml())
    calls: list[tuple[int, int]] = []
    made = zwidth.usable(here, budget=3, repeat=2, progress=lambda *call: calls.append(call), **asked)
    options = ["--usable", *(["20,5,20"] if percents else []), "--budget", 3, "--repeat", 2, "--out", tmp_path / "out"]
    said = sim("compare", file, *options, *(["--estimators", ",".join(names)] if names else []))
    same_table(told(tmp_path / "out/usable.csv"), made.table)
    assert [area["hits"] for area in said["areas"]] == made.table["hits"].tolist()
    limits = made.table["within_percent"]
    assert set(limits[np.isfinite(limits)]) == ({5, 20} if percents else {5, 10, 20}) and np.isnan(limits[-1])
    assert 0 < calls[-1][0] <= calls[-1][1]
    assert made.to_pandas().shape == (len(said["areas"]), len(made.table))
    assert made.to_arrow().column_names == list(made.table)


def test_engine_and_threads_change_nothing(scene: tuple[zwidth.Scene, Path]) -> None:
    asked: dict[str, Any] = {"estimators": ["butterworth"], "budget": 3, "repeat": 1}
    one = zwidth.compare(scene[0], engine="core", threads=1, **asked)
    two = zwidth.compare(scene[0], threads=2, **asked)
    assert one.winners == two.winners
    for name in ("table", "tunings", "boundaries", "fidelity"):
        for column, values in getattr(one, name).items():
            np.testing.assert_array_equal(values, getattr(two, name)[column])


def test_a_bad_comparison(scene: tuple[zwidth.Scene, Path], refused: Run) -> None:
    here, file = scene
    refusals: list[tuple[dict[str, Any], list[str]]] = [
        ({"estimators": ["butterworth", "kalman"]}, ["--estimators", "butterworth,kalman"]),
        ({"estimators": ["fusion"]}, ["--estimators", "fusion"]),
        ({"damping": 1e9}, ["--damping", "1e9"]),
    ]
    for asked, option in refusals:
        with pytest.raises(ValueError) as raised:
            zwidth.compare(here, **asked)
        assert refused("compare", file, *option).removeprefix("--") == str(raised.value)
    bad: list[tuple[dict[str, Any], str]] = [
        ({"estimators": []}, "estimators is empty"),
        ({"budget": 2}, "budget is 2, allowed 3 to 1000"),
        ({"repeat": 0}, "repeat is 0, allowed 1 to 1000"),
    ]
    for asked, line in bad:
        with pytest.raises(ValueError) as raised:
            zwidth.compare(here, **asked)
        assert str(raised.value) == line


def test_a_bad_explanation(scene: tuple[zwidth.Scene, Path], refused: Run) -> None:
    here, file = scene
    with pytest.raises(ValueError) as raised:
        zwidth.explain(here, damping=1e9)
    assert refused("explain", file, "--damping", "1e9").removeprefix("--") == str(raised.value)
    for asked, line in (({"budget": 2}, "budget is 2, allowed 3 to 1000"), ({"repeat": 1}, "repeat is 1, allowed 2")):
        with pytest.raises(ValueError, match=line):
            zwidth.explain(here, **asked)


def test_bad_limits(scene: tuple[zwidth.Scene, Path], refused: Run) -> None:
    here, file = scene
    refusals: list[tuple[dict[str, Any], list[str]]] = [
        ({"limits": [2.0]}, ["--limits", "2"]),
        ({"limits": ["felt=9999"]}, ["--limits", "felt=9999"]),
        ({"steps": (1e9, 1.0)}, ["--steps", "1e9,1"]),
    ]
    for asked, option in refusals:
        with pytest.raises(ValueError) as raised:
            zwidth.peers(here, **asked)
        assert refused("compare", file, "--peers", *option).removeprefix("--") == str(raised.value)
    allowed = "is no limit, allowed an RMS in m above 0, felt, or felt=DB over the threshold"
    bad: list[tuple[dict[str, Any], str]] = [
        ({"limits": []}, "limits is empty"),
        ({"limits": [1e-6, -1.0]}, f"limits: `-1` {allowed}"),
        ({"limits": [math.nan]}, f"limits: `NaN` {allowed}"),
        ({"limits": ["faint"]}, f"limits: `faint` {allowed}"),
        ({"steps": [4000.0]}, "steps has 1 numbers, allowed 2"),
        ({"repeat": 0}, "repeat is 0, allowed 1 to 1000"),
        ({"engine": "gpu"}, 'engine is "gpu", allowed core, lanes'),
    ]
    for asked, line in bad:
        with pytest.raises(ValueError) as raised:
            zwidth.peers(here, **asked)
        assert str(raised.value) == line


def test_bad_percents(scene: tuple[zwidth.Scene, Path], refused: Run) -> None:
    here, file = scene
    refusals: list[tuple[dict[str, Any], list[str], str]] = [
        ({"percents": [5, 0]}, ["--usable", "5,0"], "--usable"),
        ({"estimators": ["kalman"]}, ["--usable", "--estimators", "kalman"], "--estimators"),
    ]
    for asked, option, name in refusals:
        with pytest.raises(ValueError) as raised:
            zwidth.usable(here, **asked)
        assert refused("compare", file, *option).replace(name, next(iter(asked))) == str(raised.value)
    bad: list[tuple[dict[str, Any], str]] = [
        ({"percents": []}, "percents is empty"),
        ({"estimators": []}, "estimators is empty"),
        ({"budget": 2}, "budget is 2, allowed 3 to 1000"),
        ({"repeat": 0}, "repeat is 0, allowed 1 to 1000"),
    ]
    for asked, line in bad:
        with pytest.raises(ValueError) as raised:
            zwidth.usable(here, **asked)
        assert str(raised.value) == line


def test_what_progress_raises_ends_a_comparison(scene: tuple[zwidth.Scene, Path]) -> None:
    def stop(done: int, total: int) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        zwidth.compare(scene[0], progress=stop)
    with pytest.raises(InterruptedError):
        zwidth.explain(scene[0], progress=stop)
    with pytest.raises(InterruptedError):
        zwidth.peers(scene[0], progress=stop)
    with pytest.raises(InterruptedError):
        zwidth.usable(scene[0], progress=stop)
