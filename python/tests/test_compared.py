"""Comparisons beside those of the command line: the same bits."""

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


def test_what_progress_raises_ends_a_comparison(scene: tuple[zwidth.Scene, Path]) -> None:
    def stop(done: int, total: int) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        zwidth.compare(scene[0], progress=stop)
    with pytest.raises(InterruptedError):
        zwidth.explain(scene[0], progress=stop)
