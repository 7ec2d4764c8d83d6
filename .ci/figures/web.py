"""docs/web.md: what .ci/web has measured."""

from . import block
from .source import rows


@block
def web():
    """What must hold of the page without a server."""
    yield "| what | allowed | measured |"
    yield "|---|---|---|"
    for row in rows("web.csv"):
        yield f"| {row['what']} | {row['allowed']} | {row['measured']} |"
