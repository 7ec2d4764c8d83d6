"""Studies beside those of the command line: the same values."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zwidth
from conftest import Run, becomes_table, refuses, rows, same_table, simulate

COMMON: dict[str, Any] = {
    "scenes": ["paper-2um"],
    "cutoffs_hz": [500, 1500],
    "points_per_unit": 3,
    "product": {
        "wall_hit": {"settle_s": [0.6], "window_s": [0.4]},
        "walk": {"stiffness_step_n_per_m": [8000], "damping_step_n_s_per_m": [80]},
        "wall.push_only": [True, False],
    },
    "list": [{"actuator.latency": 5}, {"actuator.latency": 10.0}],
}
MEASURES: list[dict[str, Any]] = [
    {"measure": "walk", "starts_counts": [0, 0.5], "estimators": ["difference", {"estimator": "taylor", "order": 2}]},
    {"measure": "walk", "starts_counts": "0:0.25:0.75"},
    {"measure": "hit", "stiffnesses": [4000, 100e3], "dampings": [20, 40]},
    {"measure": "sweep", "repeat": 2},
]


def toml(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case dict():
            return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
        case list():
            return "[" + ", ".join(map(toml, value)) + "]"
        case str():
            return f'"{value}"'
    return repr(value)


def keys(measure: dict[str, Any]) -> dict[str, Any]:
    asked = COMMON | measure
    if "estimators" in measure:
        asked = {key: value for key, value in asked.items() if key != "cutoffs_hz"}
    return asked


@pytest.mark.parametrize("measure", MEASURES)
def test_a_study(tmp_path: Path, measure: dict[str, Any]) -> None:
    asked = keys(measure)
    file = tmp_path / "study.toml"
    file.write_text("".join(f"{key} = {toml(value)}\n" for key, value in asked.items()))
    calls: list[tuple[int, int]] = []
    made = zwidth.study(file, progress=lambda done, total: calls.append((done, total)))
    ran = simulate("study", file, "--out", tmp_path / "out")
    assert ran.returncode == 0, ran.stderr
    parts = sorted((tmp_path / "out").glob("part-*.csv"))
    said = [row for part in parts for row in rows(part)]
    assert (len(parts), calls[-1]) == (made.units, (made.units, made.units))
    same_table(said, made.table)
    for other in (zwidth.study(asked, engine="core", threads=1), zwidth.study(str(file), threads=2)):
        assert (other.hits, other.points) == (made.hits, made.points)
        for name, column in other.table.items():
            np.testing.assert_array_equal(column, made.table[name])
    becomes_table(made, made.table)


def test_a_bad_study(tmp_path: Path, refused: Run) -> None:
    file = tmp_path / "study.toml"
    for change in ({"cutoffs_hz": [9000]}, {"points_per_unit": 0}, {"product": {"device.mass_kg": [-1]}}, {"x": 1}):
        asked = keys({"measure": "walk"}) | change
        file.write_text("".join(f"{key} = {toml(value)}\n" for key, value in asked.items()))
        refuses(zwidth.study, refused("study-plan", file), file)
        with pytest.raises(ValueError, match=r"^study:"):
            zwidth.study(asked)
    with pytest.raises(ValueError, match="cannot be read"):
        zwidth.study(tmp_path / "missing.toml")


def test_what_progress_raises_ends_a_study() -> None:
    def stop(done: int, total: int) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        zwidth.study(keys({"measure": "walk"}), progress=stop)
