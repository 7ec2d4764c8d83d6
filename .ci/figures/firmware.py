"""The firmware and faults: what tests have measured on the virtual board, and stored campaigns."""

from . import block
from .source import BOARDS, CLASSES, grouped, ms, rows, value
from .templates import filled


@block("fault case", "how it is brought about", "enable off after", "allowed", "code")
def fault_campaign():
    """The longest time of both boards until enable is off, of some cases of the campaign."""
    for r in rows("fault-cases.csv"):
        if r["stays"]:
            yield r["case"], filled(r["how"]), r["stays"], "", r["code"]
            continue
        names = r["measured"].split("; ")
        off = max(value(f"elf/faults/{name}/{board}") for name in names for board in BOARDS)
        limit = max(value(f"elf/faults/{name}/allowed") for name in names)
        halted = 1.5e3 if names[0] == "debugger halt, 1.5 ms" else 0  # the program stands still for the halt
        shown, limit = ms(off - halted), limit - halted
        limit = f"{limit:g} us" if limit < 100 else f"{limit / 1e3:g} ms"
        yield (r["case"], r["how"], f"0, and {shown} after it goes on" if halted else shown,
               f"{limit} after it goes on" if halted else limit, r["code"])


CAMPAIGN = rows("campaign-rows.csv")
# Those that the stored campaign has.
SITUATIONS = [s for s in ("free", "full", "contact") if any(row["situation"] == s for row in CAMPAIGN)]


def is_soon(row):
    return bool(row["off_s"]) and float(row["off_s"]) <= 3e-3


def does_nothing(row):
    return row["class"] in ("no_effect", "bounded")


def most(of, key, scale=1):
    return f"{max(float(row[key]) for row in of) * scale:.3f}"


def worst(of):
    """The latest off (never is the latest), most speed and most travel of some rows, as text."""
    off = "never" if any(not row["off_s"] for row in of) else ms(max(float(row["off_s"]) for row in of) * 1e6)
    return off, most(of, "speed_m_per_s"), most(of, "travel_m", 1e3)


@block("fault", "situation", "off after", "speed, m/s", "travel, mm", "code", "why it stays")
def campaign_rows():
    """What is not off within 3 ms on one of the boards, and does something; the worse of both."""
    for fault, of in grouped(CAMPAIGN, "name", "situation").items():
        if not all(is_soon(row) or does_nothing(row) for row in of):
            codes = sorted({row["code"] or "none" for row in of})
            yield *fault, *worst(of), ", ".join(codes), "; ".join(sorted({row["reason"] for row in of if row["reason"]}))


@block("board", "situation", "rows", "off within 3 ms", "latest", "most speed, m/s", "most travel, mm")
def campaign_soon():
    """The rows that are off within 3 ms."""
    found = grouped(CAMPAIGN, "board", "situation")
    for board in BOARDS:
        for situation in SITUATIONS:
            of = found[board, situation]
            soon = [row for row in of if is_soon(row)]
            yield board, situation, len(of), len(soon), *worst(soon)


@block("fault", "boards", *(f"{s}: {what}" for s in SITUATIONS for what in ("off after", "m/s", "mm")))
def campaign_each():
    """Each fault that is off within 3 ms: the worse of both boards, in each situation."""
    for (name,), of in grouped(CAMPAIGN, "name").items():
        soon = [row for row in of if is_soon(row)]
        boards = list({row["board"] for row in soon})
        if boards:
            by = [[row for row in soon if row["situation"] == s] for s in SITUATIONS]
            yield name, boards[0] if len(boards) == 1 else "both", *(cell for of in by for cell in (worst(of) if of else ["", "", ""]))


@block("fault", "situation", "class")
def campaign_nothing():
    """What nobody has to find: the force is what it should be, or stays off."""
    harmless = {}
    for (name, situation), of in grouped(CAMPAIGN, "name", "situation").items():
        if all(does_nothing(row) for row in of):
            harmless.setdefault(name, {})[situation] = {row["class"].replace("_", " ") for row in of}
    for name, classes in harmless.items():
        yield name, ", ".join(s for s in SITUATIONS if s in classes), ", ".join(sorted(set().union(*classes.values())))


ENDED = ["no effect", "bounded", "off in time", "off late", "unnoticed"]


@block("set by", "flips", *ENDED)
def campaign_sample():
    """How flips in the data that `sample` keeps ended, both boards together."""
    sums = {}
    for row in rows("campaign-sample.csv") + rows("campaign-sample-estimators.csv"):
        counts = [int(row[name]) for name in ("flips", *CLASSES)]
        sums[row["setup"]] = [sum(both) for both in zip(counts, sums.get(row["setup"], [0] * 6))]
    return [[f"`{setup}`", *counts] for setup, counts in sums.items()]


@block("bit", "where", "class", "speed, m/s", "travel, mm", "why")
def campaign_left():
    """What the random flips left late or unnoticed: none without a reason."""
    reasons = {row["place"]: row["reason"] for row in rows("campaign-reasons.csv")}
    found = {}
    for row in rows("campaign-left.csv"):
        place = row["name"].split(", ", 1)[1].split(" at cycle")[0]
        found.setdefault(place, []).append(row)
    if missing := [place for place in found if place not in reasons]:
        raise SystemExit(f"error: docs/data/campaign-reasons.csv has no reason for {', '.join(missing)}")
    for place, flips in found.items():
        yield (place, ", ".join(f"{row['board']} {row['situation']}" for row in flips),
               ", ".join(dict.fromkeys(row["class"].replace("_", " ") for row in flips)),
               most(flips, "speed_m_per_s"), most(flips, "travel_m", 1e3), reasons[place])
