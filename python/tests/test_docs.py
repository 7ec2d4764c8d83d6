"""Examples of docstrings and of the README run."""

import doctest
import re

import pytest

import zwidth
import zwidth.board
import zwidth.estimator
import zwidth.scene
import zwidth.telemetry
from conftest import ROOT


def test_doctests() -> None:
    for module in (zwidth, zwidth.scene, zwidth.estimator, zwidth.telemetry):
        failed, tried = doctest.testmod(module)
        assert failed == 0 and tried > 0, module.__name__
    assert doctest.testmod(zwidth.board).failed == 0, "its examples need a board: test_board.py runs the page's"


@pytest.mark.parametrize("page", ["python/README.md", "docs/python.md"])
def test_the_examples_of_pages_run(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    text = (ROOT / page).read_text()
    for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(example, page, "exec"), {})
