"""Examples of docstrings and of the README run."""

import doctest
import inspect
import re

import pytest

import zwidth
from conftest import ROOT

# Those whose documentation shows what comes out.
SHOWN = {
    *("Scene.load", "Scene.replace", "Estimator", "Estimator.process", "Telemetry", "Telemetry.decode"),
    *("compare", "grid", "hit", "identify_plan", "linear", "recommended", "study", "sweep", "walk"),
}


def documented() -> dict[str, str]:
    """The documentation of all public names, and of what classes have, that holds an example."""
    names = {name: getattr(zwidth, name) for name in zwidth.__all__}
    inside = {
        f"{name}.{part}": of
        for name, of in names.items()
        if isinstance(of, type)
        for part, of in inspect.getmembers(of)
        if not part.startswith("_")
    }
    texts = {name: inspect.getdoc(of) or "" for name, of in (names | inside).items()}
    return {name: text for name, text in texts.items() if ">>>" in text}


@pytest.mark.parametrize("name", sorted(SHOWN))
def test_doctests(name: str) -> None:
    test = doctest.DocTestParser().get_doctest(documented()[name], dict(vars(zwidth)), name, None, None)
    said: list[str] = []
    assert doctest.DocTestRunner().run(test, out=said.append).failed == 0, "".join(said)


def test_no_example_is_left_out() -> None:
    assert documented().keys() - SHOWN <= {"Board", "Board.telemetry"}, "test_board.py runs the page's"
    assert doctest.testmod(zwidth).failed == 0


def test_every_public_name_is_explained() -> None:
    for name in zwidth.__all__:
        of = getattr(zwidth, name)
        if callable(of):
            assert len(of.__doc__ or "") > 10, name
            attributes = [part for part in vars(of) if not part.startswith("_")] if isinstance(of, type) else []
            assert all(inspect.getdoc(getattr(of, part)) for part in attributes), name


@pytest.mark.parametrize("page", ["python/README.md", "docs/python.md"])
def test_the_examples_of_pages_run(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    text = (ROOT / page).read_text()
    for example in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(example, page, "exec"), {})
