"""The command line beside which results are held."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
Run = Callable[..., Any]


def simulate(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = ["cargo", "run", "--quiet", "--release", "--package", "host-sim", "--", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


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
