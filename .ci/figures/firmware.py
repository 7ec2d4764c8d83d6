"""The firmware, faults, identification: what tests have measured on the virtual board, and the firmware's constants."""

from . import block
from .measured import filled
from .source import BOARDS, CLASSES, ENDS, constant, grouped, m, measured, number, power, rows, significant, value

MHZ = {"nucleo-f446re": 180.0, "discovery-f407": 168.0}


def spans(place, *parts):
    """Of each part the least and the most."""
    return [f"{m(f'elf/{place}/{part}_least')} to {m(f'elf/{place}/{part}_most')}" for part in parts]


@block("board", "`sample`", "of it the core", "`render`", "`link`", "event to counter", "stack, kB", "flash, kB", "RAM, kB")
def firmware_measured():
    for board in BOARDS:
        yield (board, *spans(f"control/{board}", "sample", "core", "render", "link", "delay"),
               *(m(f"elf/control/{board}/{what}", 1, 1e-3) for what in ("stack", "flash", "ram")))


@block("longest", "value", "unit", "test of `tests/elf`")
def firmware_longest():
    """What no board exceeds."""
    def most(key):
        return number(max(value(f"elf/control/{board}/{key}") for board in BOARDS), 0)

    core = max(value(f"elf/control/{board}/core_mean") / MHZ[board] for board in BOARDS)
    spread = [m(f"elf/control/nucleo-f446re/{key}") for key in ("spread", "spread_with_critical_sections")]
    register = [m(f"elf/{room}/nucleo-f446re/10/register_most") for room in ("period", "passivity")]
    yield "`sample`, whatever happens", most("sample_whatever"), "cycles", "`no_sample_is_longer`"
    yield "`sample` at period 1", most("sample_period_1"), "cycles", "`control`"
    yield "of it beside the core", most("beside_period_1"), "cycles", "`control`"
    yield "the core at 10 kHz", number(core, 1), "% of the time", "`control`"
    yield "mask of the logger, a sample within it included", most("mask_us"), "us", "`control`"
    yield "spread of the delays, the image as built", spread[0], "cycles", "`control`"
    yield "the same with critical sections for masks", spread[1], "cycles", "`a_logger_with_a_critical_section`"
    yield "event to register at period 10, no `[passivity]`", register[0], "cycles", "`period`"
    yield "the same with `[passivity]`, where it has to divide", register[1], "cycles", "`passivity`"


@block("board", "period, samples", "`sample`", "`render`", "event to counter", "event to the force's register",
       "`sample` and `render`, of the time at most")
def firmware_periods():
    for board in BOARDS:
        for period in (1, 2, 5, 10):
            room = f"period/{board}/{period}"
            yield board, period, *spans(room, "sample", "render", "delay", "register"), f"{100 * value(f'elf/{room}/load'):.1f} %"


@block("period, samples", "cycles allowed", "refused", "the longest that is allowed", "`sample` with it, at most")
def firmware_refused():
    for period in (1, 2, 5, 10):
        room = f"elf/period/nucleo-f446re/{period}"
        refused = ", ".join(f"`{name}`" for name in measured(f"{room}/refused").split())
        yield period, m(f"{room}/allowed"), refused or "none", f"`{measured(f'{room}/slowest')}`", m(f"{room}/slowest_sample")


def latencies(board, recording):
    """As identified from a recording, and of the scene."""
    return significant(value(f"elf/identify_{recording}/{board}/latency"), 2), constant(f"scenes/{board}.toml", r"(?m)^latency = (\S+)")


@block("board", "event to register, in a hit", "the longest of all outputs", "and then", "latency", "as identified")
def firmware_latency():
    for board, output, then in [
            ("nucleo-f446re", "DAC", "3 us of settling by the data sheet"),
            ("discovery-f407", "PWM", "taken over 14 us after the sample (`LEAD_CYCLES`)")]:
        cycles = [value(f"elf/control/{board}/register_{which}") for which in ("in_a_hit", "of_all")]
        found, stated = latencies(board, "telemetry")
        yield f"{board}, {output}", *(f"{number(c)} cycles, {c / MHZ[board]:.1f} us" for c in cycles), then, stated, found


@block("board", "hits", "points", "area, N^2 s/m^2", "simulated, mean of 16", "one walk of those", "difference",
       "minutes of the board's time")
def firmware_walks():
    for board in BOARDS:
        key = f"elf/walk/{board}"
        area, mean = value(f"{key}/area"), value(f"{key}/simulated")
        yield (board, m(f"{key}/hits"), m(f"{key}/points"), power(area, 5), power(mean, 5), f"+-{100 * value(f'{key}/spread'):.1f} %",
               f"{100 * (area / mean - 1):+.2f} %", f"{value(f'{key}/virtual_s') / 60:.0f}")


# Faults
def ms(us):
    return "0" if us < 0.5e-3 else "< 1 us" if us < 1 else f"{us / 1e3:.3f} ms" if us < 1e4 else f"{us / 1e3:.1f} ms"


SHORT_HALT = "debugger halt, 1.5 ms"


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
        halted = 1.5e3 if names[0] == SHORT_HALT else 0  # the program stands still for the halt
        shown, limit = ms(off - halted), limit - halted
        limit = f"{limit:g} us" if limit < 100 else f"{limit / 1e3:g} ms"
        yield (r["case"], r["how"], f"0, and {shown} after it goes on" if halted else shown,
               f"{limit} after it goes on" if halted else limit, r["code"])


# What fills the channel, as tests/elf/flood.rs names it.
FLOODS = {
    "get": "`get`, which takes longest for its length", "k 1": "`k 1`", "push 1": "`push 1`", "help": "`help`",
    "load": "`load`, free, with nothing saved; with each record in flash it takes longer", "x": "`x`, no command",
    "zeros": "bytes of 0, which are passed over one by one", "no line": "a line without an end",
}


@block("the channel is full of", "period 1", "period 2", "period 5", "period 10")
def flood():
    for name, what in FLOODS.items():
        off_s = [max(value(f"elf/flood/{board}/{period}/{name}") for board in BOARDS) for period in (1, 2, 5, 10)]
        yield what, *(f"{1e3 * off:.0f} ms" for off in off_s)


CAMPAIGN = rows("campaign-rows.csv")
SOON_S = 3e-3
# Those that the stored campaign has.
SITUATIONS = [s for s in ("free", "full", "contact") if any(row["situation"] == s for row in CAMPAIGN)]


def is_soon(row):
    return bool(row["off_s"]) and float(row["off_s"]) <= SOON_S


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


def share_of(row, name):
    """An interval of it, %."""
    return f"{100 * float(row[f'{name}_low']):.2f} to {100 * float(row[f'{name}_high']):.2f}"


ENDED = ["no effect", "bounded", "off in time", "off late", "unnoticed"]


@block("board", "part", "flips", *ENDED, "unnoticed, %, 95 %")
def campaign_random():
    for row in rows("campaign-random.csv"):
        counts = [int(row[name]) for name in CLASSES]
        yield row["board"], row["region"].replace("_", " "), sum(counts), *counts, share_of(row, "unnoticed")


@block("board", "part", "flips", "found by the check, force right", "found by the check, force wrong before", "off by something else",
       "force wrong for longer than a pass", "unnoticed", "wrong before, %, 95 %", "force wrong, ms, at most", "speed, m/s, at most",
       "off after, ms, at most")
def campaign_image():
    """How flips in the program in flash ended."""
    for row in rows("campaign-image.csv"):
        ends = [int(row[name]) for name in ENDS]
        yield (row["board"], row["part"], sum(ends), *ends, share_of(row, "wrong"), f"{float(row['wrong_s']) * 1e3:.0f}",
               f"{float(row['speed_m_per_s']):.3f}", f"{float(row['off_s']) * 1e3:.0f}")


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


@block("board", "registers that change, one at a time", "enable off after, at most", "the same, numbers", "allowed")
def registers():
    for board in BOARDS:
        changed, numbers = (ms(value(f"elf/faults/{key}")) for key in (f"registers/{board}/most", f"memory/{board}"))
        yield board, m(f"elf/faults/registers/{board}/rows"), changed, numbers, "3 ms"


@block("what", "where", *BOARDS)
def acts():
    def off(key):
        return ms(value(f"elf/faults/acts/{key}"))

    yield "DAC gives 5 % of full scale to all of it more or less", "pressed", off("dac"), "-"
    for part, text in [("1", "full force away from what is asked"), ("-1", "full force the other way"), ("0", "no force")]:
        yield f"amplifier stuck: {text}", "pressed, its current read", *(off(f"{board}/stuck {part}") for board in BOARDS)


# Identification
RECORDS = {
    "two pulses, noise 0.5": "two pulses, noise of 0.5 counts RMS", "one pulse, noise 0.5": "one pulse, 0.5 counts",
    "two pulses, noise 0.1": "two pulses, 0.1 counts", "two pulses, no noise": "two pulses, no noise",
    "train, no noise": "train of pulses, no noise",
}
ACCURACY = "host/identify_accuracy"


@block("record", "m", "b", "k", "x0", "pooled", "m: error, half-width")
def identify_intervals():
    for record, name in RECORDS.items():
        key = f"{ACCURACY}/{record}"
        yield (name, *(m(f"{key}/{p}_held") for p in ("m", "b", "k", "x0")), f"{100 * value(f'{key}/pooled'):.1f} %",
               ", ".join(power(value(f"{key}/m_{what}")) for what in ("error", "half_width")))


@block("over all records", "value")
def identify_summary():
    yield "largest error of m", power(max(value(f"{ACCURACY}/{record}/m_largest") for record in RECORDS))
    yield ("records at rest most of the time, no noise: true values inside the stated intervals",
           f"{100 * value(f'{ACCURACY}/at rest/stated'):.1f} %")


@block("terms that are there", "m", "b", "k", "friction", "lag", "offset", "pooled", "invented")
def identify_terms():
    for kind, name in [("plain", "none"), ("friction", "friction"), ("lag", "lag"), ("offset", "offset"), ("all", "all three")]:
        key = f"host/identify_terms/{kind}"
        cells = [f"{m(f'{key}/{c}_held')} of {m(f'{key}/{c}_of')}" if c in ("m", "b", "k", kind) or kind == "all" else ""
                 for c in ("m", "b", "k", "friction", "lag", "offset")]
        yield name, *cells, *(f"{100 * value(f'{key}/{what}'):.1f} %" for what in ("pooled", "invented"))


@block("board", "recording", *(f"{n} off by, relative" for n in "mbk"), "latency found, samples", "latency of the scene")
def identify_from_board():
    for board in BOARDS:
        for key, recording in [("telemetry", "two hits"), ("pulses", "`pulses 1.2`")]:
            yield (board, recording, *(power(value(f"elf/identify_{key}/{board}/{n}"), 1) for n in ("m", "b", "k")), *latencies(board, key))
