"""The tables of measured.md and tables.md, which stand there as the pages show them, with places for figures."""

import fnmatch
import math
import re
import tomllib
from pathlib import Path

from . import BLOCKS, words
from .source import BOARDS, ROOT, grouped, lit, measured, ms, number, power, rows, said_in, significant, sim, value

FILES = [Path(__file__).with_name(name) for name in ("measured.md", "tables.md")]
SECTION = re.compile(r"(?m)^## (.+)\n\n((?:\w+: .*\n)*)\n?((?:\|.*\n)+)")
PLACE = re.compile(r"\{([^{}]+?)((?: [x/][\w./-]+)*)(?: ([.spgc])(\d?)| (ms|w))?(?: else (\S+))?\}")
SETTINGS = ("rows", "at", "where", "by", "order")
OF_BOARDS = re.compile(r"(?m)(?:^.*BOARD.*\n)+")


def flat(value, name=""):
    """A row of JSON: `range_hz.0` is the first value of `range_hz`, and a bare value is `value`."""
    if not isinstance(value, (dict, list)):
        return {name or "value": "" if value is None else value}
    items = value.items() if isinstance(value, dict) else enumerate(value)
    return {key: cell for part, of in items for key, cell in flat(of, f"{name}.{part}".lstrip(".")).items()}


def is_table(source):
    return source.endswith(".csv") and not source.startswith("cargo ")


def table_of(source, path):
    """The rows of a stored table, or of what is there in stored JSON or in what the simulator says."""
    if is_table(source):
        return [r for name in source.split("+") for r in rows(name)]
    if source.endswith(".toml"):
        found = tomllib.loads((ROOT / source).read_text())
    else:
        found = sim(source.removeprefix("cargo sim ")) if source.startswith("cargo sim ") else said_in(source)
    for key in filter(None, path.split(".")):
        found = found[int(key) if isinstance(found, list) else key]
    return [flat(r) for r in (found if isinstance(found, list) else [found])]


def meets(r, condition):
    """`COLUMN=VALUE`, with != <= >= too, or `ideal`: at the ideal cutoff."""
    if condition == "ideal":
        return r["cutoff_hz"] == r["ideal_cutoff_hz"]
    column, how, wanted = re.fullmatch(r"([\w.]+)(=|!=|<=|>=)(.*)", condition).groups()
    if how in ("<=", ">="):
        return float(r[column]) <= float(wanted) if how == "<=" else float(r[column]) >= float(wanted)
    try:
        alike = math.isclose(float(r[column]), float(wanted), rel_tol=1e-9)
    except ValueError:
        alike = r[column] == wanted
    return alike == (how == "=")


def chosen(found, conditions):
    """The rows that meet these; `most COLUMN` is the one of them that has the most there."""
    for condition in conditions:
        if condition.startswith("most "):
            found = sorted(found, key=lambda r: float(r[condition[5:]]))[-1:]
        else:
            found = [r for r in found if meets(r, condition)]
    return found


def picked(words, group=()):
    """The rows of `SOURCE, PLACE, CONDITION, ..`, or those of the group that meet the conditions."""
    conditions = words.split(", ") if words else []
    if conditions and re.match(r"cargo sim |.*\.(csv|json|toml)$", conditions[0]):
        source = conditions.pop(0)
        group = table_of(source, None if is_table(source) else conditions.pop(0))
    return chosen(group, conditions)


def largest(name):
    """Of the figures that a name with * stands for."""
    return max(map(value, fnmatch.filter((row["figure"] for row in rows("measured.csv")), name) or [name]))


def figure(place, group):
    """What stands in that place of a table; `group` are the rows that its line is about, the first one before others."""
    (name, scales, form, digits, word, none), line = place.groups(), group[0]
    conditions, _, key = name.rpartition(": ")
    found = picked(conditions, group)
    if not found and none is None:
        raise SystemExit(f"error: .ci/figures/tables.md: no row for {place[0]}")
    if not found or key.startswith("'"):
        return key.strip("'") if found else none.strip("'")
    r = line | found[0]
    beside, _, column = key.rpartition(".")
    if say := vars(words).get(column):
        return say({name.removeprefix(f"{beside}."): cell for name, cell in r.items() if name.startswith(beside)})
    write = {None: number, "ms": ms, "w": lambda text: text.replace("_", " "), ".": number, "s": significant, "p": power,
             "c": lambda value: f"{100 * (value - 1):+.{digits}f}",
             "g": (lambda value: number(f"{value:.{digits}g}")) if digits else "{:g}".format}[word or form]
    more = [int(digits)] if form in (".", "s", "p") else []

    def written(number):
        for scale in scales.split():
            by = float(r[scale[1:]] if scale[1:] in r else measured(scale[1:]) if "/" in scale[1:] else scale[1:])
            number = float(number) * by if scale[0] == "x" else float(number) / by
        return write(number if word == "w" else float(number), *more)

    def one(key):
        if constant := re.fullmatch(r"(\S+\.(?:rs|toml)) (\w+)", key):
            return written(lit(constant[1], rf"(?m)\b{constant[2]}(?:: f64)? = ([\d.]+)"))
        if "/" in key:
            return written(measured(key) if word == "w" else largest(key)) or none or ""
        # Of a row that is not there, or of JSON's null.
        is_none = none and beside and not any(name.startswith(f"{beside}.") for name in r)
        if missing := [column for column in key.split("+") if column not in r and not is_none]:
            raise SystemExit(f"error: .ci/figures/tables.md: no column {missing[0]} for {place[0]}")
        if "+" in key:
            return written(sum(float(r[column]) for column in key.split("+")))
        return (none or "").strip("'") if r.get(key, "") == "" else written(r[key])

    return " to ".join(dict.fromkeys(map(one, key.split(" to "))))


def filled(text, group=({},)):
    text = OF_BOARDS.sub(lambda found: "".join(found[0].replace("BOARD", board) for board in BOARDS), text)
    return PLACE.sub(lambda place: figure(place, group), text)


def exchanged(text, words):
    """With these values for words in capitals."""
    return re.sub(r"(?<![A-Za-z_])[A-Z_]{3,}(?![A-Z_])", lambda found: words.get(found[0], found[0]), text)


def groups(told):
    """The rows of each line of a table that is made of stored rows; for another one no rows, once."""
    if "rows" not in told:
        return [[{}]]
    found = chosen(table_of(told["rows"], told.get("at")), told["where"].split(", ") if "where" in told else [])
    if "order" in told:
        column = told["order"].removeprefix("falling ")
        found = sorted(found, key=lambda r: float(r[column]), reverse=column != told["order"])
    return list(grouped(found, *told["by"].split(", ")).values()) if "by" in told else [[r] for r in found]


def beside(told):
    """What named rows say: NAME.COLUMN."""
    return {f"{name}.{column}": cell for name, words in told.items() if name not in SETTINGS
            for r in picked(words)[:1] for column, cell in r.items()}


def block(heading, settings, lines):
    name, *parameters = heading.split()

    def make(*arguments):
        head, lines_of = [], []
        told = dict(line.split(": ", 1) for line in exchanged(settings, dict(zip(parameters, arguments))).splitlines())
        names, _, values = told.pop("each", "").partition(" in ")
        for each in values.split("; "):
            words = dict(zip(names.split(" / "), each.split(" / "))) | dict(zip(parameters, arguments))
            for first, *others in groups({key: exchanged(text, words) for key, text in told.items()}):
                texts = {column.upper(): str(text) for column, text in first.items()} | words
                others.insert(0, first | beside({key: exchanged(text, texts) for key, text in told.items()}))
                made = filled(exchanged(lines, texts), others).splitlines()
                head = head or made[:2]
                lines_of += made[2:]
        return head + lines_of

    BLOCKS[name] = make


for file in FILES:
    for section in SECTION.findall(file.read_text()):
        block(*section)
