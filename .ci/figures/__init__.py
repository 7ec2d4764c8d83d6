"""The figures of the pages. A block is a function that makes the lines of a table; a slot is a sentence or row of a page
with `{}` where figures stand, and their values. What a sentence says of the figures in words is held to them too."""

BLOCKS = {}
SLOTS = {}
STATES = {}


def block(make):
    """Makes the table between `<!-- begin: NAME ARGUMENTS -->` and `<!-- end -->`."""
    BLOCKS[make.__name__] = make
    return make


def slots(page, *entries):
    """(text with {}, value, ..) each."""
    SLOTS.setdefault(page, []).extend(entries)


def states(page, *entries):
    """(sentence or row, what must hold of the data) each: a comparison in words drifts as a figure does."""
    STATES.setdefault(page, []).extend(entries)


from . import commands, constants, criteria, design, devices, estimators, firmware, held, passivity, published, scenes, simulator, studies, sure, trade, web  # noqa: E402,F401
