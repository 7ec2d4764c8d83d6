"""The command line beside which results are held."""

import csv
import json
import math
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zwidth

ROOT = Path(__file__).parents[2]
Run = Callable[..., Any]


def simulate(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = ["cargo", "run", "--quiet", "--release", "--package", "host-sim", "--", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def rows(file: Path) -> list[dict[str, str]]:
    """A CSV of the command line, without its version."""
    with file.open() as text:
        return [{name: cell for name, cell in row.items() if name != "schema_version"} for row in csv.DictReader(text)]


def saved(scene: zwidth.Scene, folder: Path) -> Path:
    """The scene as a file of its name."""
    file = folder / f"{scene.name}.toml"
    file.write_text(scene.to_toml())
    return file


def followed(call: Run, *given: Any, ends: tuple[int, int] | None = None, **asked: Any) -> Any:
    """What a call makes, whose progress says how far it is, and where it ends."""
    calls: list[tuple[int, int]] = []
    made = call(*given, progress=lambda done, total: calls.append((done, total)), **asked)
    assert 0 < calls[-1][0] <= calls[-1][1] and ends in (None, calls[-1])
    return made


def becomes_table(made: Any, table: Mapping[str, Any]) -> None:
    """A result is that table for Arrow and pandas too."""
    frame = made.to_pandas()
    assert made.to_arrow().column_names == list(frame.columns) == list(table)
    assert len(frame) == len(next(iter(table.values())))


def refuses(call: Run, line: str, *given: Any, **asked: Any) -> None:
    """The call says just that line."""
    with pytest.raises(ValueError) as raised:
        call(*given, **asked)
    assert str(raised.value) == line


def same(cell: str, value: Any) -> bool:
    if isinstance(value, (bool, np.bool_)):
        return cell == str(bool(value)).lower()
    if isinstance(value, str):
        return cell == value
    return math.isnan(value) if cell == "" else float(cell) == float(value)


def same_table(said: list[dict[str, str]], table: Mapping[str, Any]) -> None:
    """A CSV and a result have the same columns and the same bits; the result's cannot be written."""
    assert list(table) == list(said[0])
    for name, column in table.items():
        assert len(column) == len(said) and not column.flags.writeable
        assert all(same(row[name], value) for row, value in zip(said, column, strict=True)), name


@pytest.fixture(scope="session")
def sim() -> Run:
    """Runs `cargo sim .. --json` and reads what it prints."""

    def run(*arguments: object) -> Any:
        made = simulate(*arguments, "--json")
        assert made.returncode == 0, made.stderr
        return json.loads(made.stdout)

    return run


@pytest.fixture(scope="session")
def refused() -> Run:
    """Runs `cargo sim ..`, which refuses it, and gives its line."""

    def run(*arguments: object) -> str:
        made = simulate(*arguments)
        assert made.returncode == 2, made.stderr
        return made.stderr.strip().removeprefix("error: ")

    return run
