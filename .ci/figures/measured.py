"""The tables of measured.md, with their figures."""

import fnmatch
import re
from pathlib import Path

from . import BLOCKS
from .source import BOARDS, lit, ms, number, power, rows, short, significant, value

PLACE = re.compile(r"\{(?:(\S+\.(?:rs|toml)) (\w+)|([^{}]+?))(?: ([x/])([\d.]+))?(?: ([.spg])(\d)| (ms))?\}")
OF_BOARDS = re.compile(r"(?m)(?:^.*BOARD.*\n)+")


def largest(name):
    """Of the figures that a name with * stands for."""
    return max(map(value, fnmatch.filter((row["figure"] for row in rows("measured.csv")), name) or [name]))


def figure(place):
    """What stands in that place of a table."""
    file, constant, key, scale, factor, form, digits, in_ms = place.groups()
    write = ms if in_ms else {".": number, "s": significant, "p": power, "g": short, None: number}[form]
    more = [int(digits)] if form in (".", "s", "p") else []

    def written(found):
        by = float(factor or 1)
        return write(found / by if scale == "/" else found * by, *more)

    if file:
        return written(lit(file, rf"(?m)\b{constant}(?:: f64)? = ([\d.]+)"))
    return " to ".join(dict.fromkeys(written(largest(name)) for name in key.split(" to ")))


def filled(text):
    text = OF_BOARDS.sub(lambda found: "".join(found[0].replace("BOARD", board) for board in BOARDS), text)
    return PLACE.sub(figure, text)


for name, lines in re.findall(r"(?m)^## (\w+)\n\n((?:\|.*\n)+)", Path(__file__).with_suffix(".md").read_text()):
    BLOCKS[name] = lambda lines=lines: filled(lines).splitlines()
