"""The figures of the pages: each block is a function that makes the lines of a table. No check matches prose."""

from .source import table

BLOCKS = {}


def block(*head, right=()):
    """Makes the table between `<!-- begin: NAME ARGUMENTS -->` and `<!-- end -->`: its rows below this head, or without a
    head all lines."""
    def named(make):
        BLOCKS[make.__name__] = (lambda *arguments: table(head, make(*arguments), right)) if head else make
        return make
    return named


from . import commands, firmware, simulator, stored, templates  # noqa: E402,F401
