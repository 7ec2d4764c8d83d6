"""The figures of the pages: each block is a function that makes the lines of a table. No check matches prose."""

BLOCKS = {}


def block(make):
    """Makes the table between `<!-- begin: NAME ARGUMENTS -->` and `<!-- end -->`."""
    BLOCKS[make.__name__] = make
    return make


from . import (  # noqa: E402,F401
    commands, criteria, design, devices, estimators, firmware, published, simulator, studies, sure, trade,
)
