"""The tables of measured.md, with their figures."""

import re
from pathlib import Path

from . import BLOCKS
from .source import lit, m, number

PLACE = re.compile(r"\{([^{}]+?)(?: ([A-Z]+))?(?: \.(\d))?(?: x(\d+))?\}")


def figure(place):
    """What stands in that place of a table."""
    key, name, digits, times = place.groups()
    if name:
        return number(lit(key, rf"\b{name}: f64 = ([\d.]+);") * int(times or 1))
    return m(key, digits and int(digits), int(times or 1))


def filled(text):
    return PLACE.sub(figure, text)


for name, lines in re.findall(r"(?m)^## (\w+)\n\n((?:\|.*\n)+)", Path(__file__).with_suffix(".md").read_text()):
    BLOCKS[name] = lambda lines=lines: filled(lines).splitlines()
