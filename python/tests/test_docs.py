"""Examples of docstrings and of the README run."""

import doctest
import importlib
import re

import pytest

import zwidth
import zwidth.board
from conftest import ROOT

# Those whose documentation shows what comes out.
SHOWN = {
    "scene": ("Scene.load", "Scene.replace"),
    "studies": ("grid", "hit", "linear", "study", "sweep", "walk"),
    "compared": ("compare",),
    "identified": ("identify_plan",),
    "estimator": ("Estimator", "Estimator.process"),
}


@pytest.mark.parametrize("name", ["zwidth", "zwidth.telemetry", *(f"zwidth.{module}" for module in SHOWN)])
def test_doctests(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    module = importlib.import_module(name)
    failed, tried = doctest.testmod(module)
    assert failed == 0 and tried > 0, capsys.readouterr().out
    shown = {test.name for test in doctest.DocTestFinder().find(module) if test.examples}
    assert shown >= {f"{name}.{of}" for of in SHOWN.get(name.removeprefix("zwidth."), ())}


def test_examples_that_need_a_board_are_of_its_module() -> None:
    assert doctest.testmod(zwidth.board).failed == 0, "test_board.py runs the page's"


@pytest.mark.parametrize("page", ["python/README.md", "docs/python.md"])
def test_the_examples_of_pages_run(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    text = (ROOT / page).read_text()
    for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(example, page, "exec"), {})
