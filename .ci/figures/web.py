"""docs/web.md: what .ci/web has measured, and the constants of its studies."""

from . import block, slots
from .source import constant, rows

STUDIES = "live/web/assets/studies.js"


def study(name):
    return lambda: constant(STUDIES, rf"const {name} = (\d+)")


@block
def web():
    """What must hold of the page without a server."""
    yield "| what | allowed | measured |"
    yield "|---|---|---|"
    for row in rows("web.csv"):
        yield f"| {row['what']} | {row['allowed']} | {row['measured']} |"


slots(
    "docs/web.md",
    ("`cargo sim grid` of {} x {} walls of the plane", study("GRID"), study("GRID")),
    ("`cargo sim design SCENE --budget {}`, in", study("BUDGET")),
)
