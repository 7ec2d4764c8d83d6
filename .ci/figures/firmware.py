"""The firmware, faults, identification: what tests have measured on the virtual board, and the firmware's constants."""


from . import block
from .source import BOARDS, CLASSES, ENDS, constant, m, measured, number, power, rows, significant, table

MHZ = {"nucleo-f446re": 180.0, "discovery-f407": 168.0}


def value(key):
    return float(measured(key))


def span(key, room="control"):
    return f"{m(f'elf/{room}/{key}_least')} to {m(f'elf/{room}/{key}_most')}"


@block
def firmware_measured():
    head = ["board", "`sample`", "of it the core", "`render`", "`link`", "event to counter", "stack, kB", "flash, kB", "RAM, kB"]
    return table(head, [
        [board, *[span(f"{board}/{task}") for task in ("sample", "core", "render", "link", "delay")],
         *[number(value(f"elf/control/{board}/{what}") / 1e3, 1) for what in ("stack", "flash", "ram")]]
        for board in BOARDS])


@block
def firmware_longest():
    """What no board exceeds."""
    def most(key, digits=0):
        return number(max(value(f"elf/control/{board}/{key}") for board in BOARDS), digits)

    spread = [m(f"elf/control/nucleo-f446re/{key}") for key in ("spread", "spread_with_critical_sections")]
    register = [m(f"elf/{room}/nucleo-f446re/10/register_most") for room in ("period", "passivity")]
    return table(["longest", "value", "unit", "test of `tests/elf`"], [
        ["`sample`, whatever happens", most("sample_whatever"), "cycles", "`no_sample_is_longer`"],
        ["`sample` at period 1", most("sample_period_1"), "cycles", "`control`"],
        ["of it beside the core", most("beside_period_1"), "cycles", "`control`"],
        ["the core at 10 kHz", number(max(value(f"elf/control/{board}/core_mean") / MHZ[board] for board in BOARDS), 1),
         "% of the time", "`control`"],
        ["mask of the logger, a sample within it included", most("mask_us"), "us", "`control`"],
        ["spread of the delays, the image as built", spread[0], "cycles", "`control`"],
        ["the same with critical sections for masks", spread[1], "cycles", "`a_logger_with_a_critical_section`"],
        ["event to register at period 10, no `[passivity]`", register[0], "cycles", "`period`"],
        ["the same with `[passivity]`, where it has to divide", register[1], "cycles", "`passivity`"],
    ])


@block
def firmware_variants():
    body = [["`time-stamps`, with that estimator", "nucleo-f446re", span("sample", "edge_times"), span("delay", "edge_times")]]
    return table(["feature", "board", "`sample`", "event to counter"], body)


@block
def firmware_periods():
    body = []
    for board in BOARDS:
        for period in (1, 2, 5, 10):
            room = f"{board}/{period}"
            body.append([board, str(period), *[span(f"{room}/{task}", "period") for task in ("sample", "render", "delay", "register")],
                         f"{100 * value(f'elf/period/{room}/load'):.1f} %"])
    return table(["board", "period, samples", "`sample`", "`render`", "event to counter", "event to the force's register",
                  "`sample` and `render`, of the time at most"], body)


@block
def firmware_refused():
    body = []
    for period in (1, 2, 5, 10):
        room = f"elf/period/nucleo-f446re/{period}"
        names = measured(f"{room}/refused").split()
        body.append([str(period), m(f"{room}/allowed"),
                     ", ".join(f"`{name}`" for name in names) or "none",
                     f"`{measured(f'{room}/slowest')}`", m(f"{room}/slowest_sample")])
    return table(["period, samples", "cycles allowed", "refused", "the longest that is allowed", "`sample` with it, at most"], body)


@block
def firmware_latency():
    body = []
    for board, output, then in [
        ("nucleo-f446re", "DAC", "3 us of settling by the data sheet"),
        ("discovery-f407", "PWM", "taken over 14 us after the sample (`LEAD_CYCLES`)"),
    ]:
        cycles = [value(f"elf/control/{board}/register_{which}") for which in ("in_a_hit", "of_all")]
        body.append([f"{board}, {output}", *[f"{number(c)} cycles, {c / MHZ[board]:.1f} us" for c in cycles], then,
                     constant(f"scenes/{board}.toml", r"(?m)^latency = (\S+)"),
                     significant(value(f"elf/identify_telemetry/{board}/latency"), 2)])
    return table(["board", "event to register, in a hit", "the longest of all outputs", "and then", "latency", "as identified"], body)


@block
def firmware_walks():
    body = []
    for board in BOARDS:
        key = f"elf/walk/{board}"
        area, mean = value(f"{key}/area"), value(f"{key}/simulated")
        body.append([board, m(f"{key}/hits"), m(f"{key}/points"), *[power(a, 5) for a in (area, mean)],
                     f"+-{100 * value(f'{key}/spread'):.1f} %", f"{100 * (area / mean - 1):+.2f} %", f"{value(f'{key}/virtual_s') / 60:.0f}"])
    return table(["board", "hits", "points", "area, N^2 s/m^2", "simulated, mean of 16", "one walk of those", "difference", "minutes of the board's time"], body)


# Faults
def case(*names):
    """The longest time of both boards until enable is off, of some cases of the campaign."""
    times = []
    for name in names:
        for board in BOARDS:
            times.append(value(f"elf/faults/{name}/{board}"))
    return max(times)


def ms(us):
    return "0" if us < 0.5e-3 else "< 1 us" if us < 1 else f"{us / 1e3:.3f} ms" if us < 1e4 else f"{us / 1e3:.1f} ms"


def allowed(*names):
    limit = max(value(f"elf/faults/{name}/allowed") for name in names)
    return f"{limit:g} us" if limit < 100 else f"{limit / 1e3:g} ms"


SHORT_HALT = "debugger halt, 1.5 ms"


@block
def fault_campaign():
    body = []
    for r in rows("fault-cases.csv"):
        names = r["measured"].split("; ")
        off = case(*names)
        limit = allowed(*names)
        if names[0] == SHORT_HALT:  # the program stands still for the halt
            halted = 1.5e3
            off, limit = off - halted, f"{(value(f'elf/faults/{names[0]}/allowed') - halted) / 1e3:g} ms"
            shown = f"0, and {ms(off)} after it goes on"
            limit += " after it goes on"
        else:
            shown = ms(off)
        body.append([r["case"], r["how"], shown, limit, r["code"]])
    body += [
        ["RTT stall and flood", "nobody reads, all channels set to blocking, commands and garbage without a pause, at output"
         " period 10; at each period, read or not: [below](../faults.md#a-host-that-sends-without-a-pause)",
         "stays on: no output missed, no sample delayed", "", "none"],
        ["each byte of a settings record flipped", f"{m('elf/faults/flipped/cases')} boots",
         "stays off; the older settings, or the defaults, and `load` says so", "", "none"],
        ["power cut at each word of a `save`", "the ELF saves; the flash as it is before, in and after each store,"
         f" {m('elf/faults/cut in a save/cases')} boots", "stays off; the older settings or the new ones, whole", "", "none"],
        ["power cut in an erase", f"the other sector half erased, {m('elf/faults/cut in an erase/cases')} boots",
         "stays off; the newest settings", "", "none"],
    ]
    return table(["fault case", "how it is brought about", "enable off after", "allowed", "code"], body)


# What fills the channel, as tests/elf/flood.rs names it.
FLOODS = [
    ("get", "`get`, which takes longest for its length"), ("k 1", "`k 1`"), ("push 1", "`push 1`"), ("help", "`help`"),
    ("load", "`load`, free, with nothing saved; with each record in flash it takes longer"), ("x", "`x`, no command"),
    ("zeros", "bytes of 0, which are passed over one by one"), ("no line", "a line without an end"),
]


@block
def flood():
    periods = (1, 2, 5, 10)
    def off(name, period):
        return f"{1e3 * max(value(f'elf/flood/{board}/{period}/{name}') for board in BOARDS):.0f} ms"
    return table(["the channel is full of", *[f"period {period}" for period in periods]],
                 [[what, *[off(name, period) for period in periods]] for name, what in FLOODS])


def campaign_of(table_name):
    return rows(f"campaign-{table_name}.csv")


SOON_S = 3e-3
SITUATIONS = ["free", "full", "contact"]


def is_soon(row):
    return bool(row["off_s"]) and float(row["off_s"]) <= SOON_S


def situations():
    """Those that the stored campaign has."""
    return [s for s in SITUATIONS if any(row["situation"] == s for row in campaign_of("rows"))]


def by_fault():
    """The rows of each fault and situation, of both boards."""
    faults = {}
    for row in campaign_of("rows"):
        faults.setdefault((row["name"], row["situation"]), []).append(row)
    return faults


def worst(of):
    """The latest off (never is the latest), most speed and most travel of some rows, as text."""
    off = "never" if any(not row["off_s"] for row in of) else ms(max(float(row["off_s"]) for row in of) * 1e6)
    return [off, *(f"{max(float(row[key]) for row in of) * by:.3f}" for key, by in (("speed_m_per_s", 1), ("travel_m", 1e3)))]


@block
def campaign_rows():
    """What is not off within 3 ms on one of the boards, and does something; the worse of both."""
    body = []
    for (name, situation), of in by_fault().items():
        if all(is_soon(row) or row["class"] in ("no_effect", "bounded") for row in of):
            continue
        codes = sorted({row["code"] or "none" for row in of})
        reasons = sorted({row["reason"] for row in of if row["reason"]})
        body.append([name, situation, *worst(of), ", ".join(codes), "; ".join(reasons)])
    return table(["fault", "situation", "off after", "speed, m/s", "travel, mm", "code", "why it stays"], body)


@block
def campaign_soon():
    """The rows that are off within 3 ms."""
    body = []
    for board in BOARDS:
        for situation in situations():
            of = [row for row in campaign_of("rows") if (row["board"], row["situation"]) == (board, situation)]
            soon = [row for row in of if is_soon(row)]
            body.append([board, situation, len(of), len(soon), *worst(soon)])
    return table(["board", "situation", "rows", "off within 3 ms", "latest", "most speed, m/s", "most travel, mm"], body)


@block
def campaign_each():
    """Each fault that is off within 3 ms: the worse of both boards, in each situation."""
    faults = by_fault()
    body = []
    for name in dict.fromkeys(name for name, _ in faults):
        of = {s: [row for row in faults.get((name, s), []) if is_soon(row)] for s in situations()}
        boards = {row["board"] for rows_of in of.values() for row in rows_of}
        if boards:
            where = "both" if len(boards) == len(BOARDS) else boards.pop()
            body.append([name, where, *(cell for s in situations() for cell in (worst(of[s]) if of[s] else ["", "", ""]))])
    head = [f"{s}: {what}" for s in situations() for what in ("off after", "m/s", "mm")]
    return table(["fault", "boards", *head], body)


@block
def campaign_nothing():
    """What nobody has to find: the force is what it should be, or stays off."""
    harmless = {key: of for key, of in by_fault().items() if all(row["class"] in ("no_effect", "bounded") for row in of)}
    body = []
    for name in dict.fromkeys(name for name, _ in harmless):
        of = {s: harmless[name, s] for s in SITUATIONS if (name, s) in harmless}
        classes = sorted({row["class"].replace("_", " ") for rows_of in of.values() for row in rows_of})
        body.append([name, ", ".join(of), ", ".join(classes)])
    return table(["fault", "situation", "class"], body)


@block
def campaign_random():
    body = []
    for row in campaign_of("random"):
        counts = [int(row[name]) for name in ("no_effect", "bounded", "off_in_time", "off_late", "unnoticed")]
        share = f"{float(row['unnoticed_low']) * 100:.2f} to {float(row['unnoticed_high']) * 100:.2f}"
        body.append([row["board"], row["region"].replace("_", " "), sum(counts), *counts, share])
    head = ["board", "part", "flips", "no effect", "bounded", "off in time", "off late", "unnoticed", "unnoticed, %, 95 %"]
    return table(head, body)


@block
def campaign_image():
    """How flips in the program in flash ended."""
    body = []
    for row in rows("campaign-image.csv"):
        ends = [int(row[name]) for name in ENDS]
        share = f"{100 * float(row['wrong_low']):.2f} to {100 * float(row['wrong_high']):.2f}"
        body.append([row["board"], row["part"], sum(ends), *ends, share, f"{float(row['wrong_s']) * 1e3:.0f}",
                     f"{float(row['speed_m_per_s']):.3f}", f"{float(row['off_s']) * 1e3:.0f}"])
    head = ["board", "part", "flips", "found by the check, force right", "found by the check, force wrong before",
            "off by something else", "force wrong for longer than a pass", "unnoticed", "wrong before, %, 95 %",
            "force wrong, ms, at most", "speed, m/s, at most", "off after, ms, at most"]
    return table(head, body)


@block
def campaign_sample():
    """How flips in the data that `sample` keeps ended, both boards together."""
    sums = {}
    for row in rows("campaign-sample.csv") + rows("campaign-sample-estimators.csv"):
        of_setup = sums.setdefault(row["setup"], [0] * 6)
        sums[row["setup"]] = [was + int(row[name]) for was, name in zip(of_setup, ("flips", *CLASSES))]
    head = ["set by", "flips", "no effect", "bounded", "off in time", "off late", "unnoticed"]
    return table(head, [[f"`{setup}`", *counts] for setup, counts in sums.items()])


@block
def campaign_left():
    """What the random flips left late or unnoticed: none without a reason."""
    reasons = {row["place"]: row["reason"] for row in rows("campaign-reasons.csv")}
    found = {}
    for row in campaign_of("left"):
        _, place = row["name"].split(", ", 1)
        found.setdefault(place.split(" at cycle")[0], []).append(row)
    if missing := [place for place in found if place not in reasons]:
        raise SystemExit(f"error: docs/data/campaign-reasons.csv has no reason for {', '.join(missing)}")
    body = []
    for place, flips in found.items():
        where = ", ".join(f"{row['board']} {row['situation']}" for row in flips)
        kinds = ", ".join(dict.fromkeys(row["class"].replace("_", " ") for row in flips))
        most = [max(float(row[key]) for row in flips) for key in ("speed_m_per_s", "travel_m")]
        body.append([place, where, kinds, f"{most[0]:.3f}", f"{1e3 * most[1]:.3f}", reasons[place]])
    return table(["bit", "where", "class", "speed, m/s", "travel, mm", "why"], body)


@block
def registers():
    body = []
    for board in BOARDS:
        key = f"elf/faults/registers/{board}"
        memory = ms(value(f"elf/faults/memory/{board}"))
        body.append([board, m(f"{key}/rows"), ms(value(f"{key}/most")), memory, "3 ms"])
    head = ["registers that change, one at a time", "enable off after, at most", "the same, numbers"]
    return table(["board", *head, "allowed"], body)


@block
def acts():
    dac = ms(value("elf/faults/acts/dac"))
    body = [["DAC gives 5 % of full scale to all of it more or less", "pressed", dac, "-"]]
    for part, text in [("1", "full force away from what is asked"), ("-1", "full force the other way"), ("0", "no force")]:
        both = [ms(value(f"elf/faults/acts/{board}/stuck {part}")) for board in BOARDS]
        body.append([f"amplifier stuck: {text}", "pressed, its current read", *both])
    return table(["what", "where", *BOARDS], body)


# Identification
RECORDS = [
    ("two pulses, noise 0.5", "two pulses, noise of 0.5 counts RMS"), ("one pulse, noise 0.5", "one pulse, 0.5 counts"),
    ("two pulses, noise 0.1", "two pulses, 0.1 counts"), ("two pulses, no noise", "two pulses, no noise"),
    ("train, no noise", "train of pulses, no noise"),
]


@block
def identify_intervals():
    body = []
    for key, name in RECORDS:
        key = f"host/identify_accuracy/{key}"
        body.append([name, *[m(f"{key}/{p}_held") for p in ("m", "b", "k", "x0")], f"{100 * value(f'{key}/pooled'):.1f} %",
                     ", ".join(power(value(f"{key}/m_{what}")) for what in ("error", "half_width"))])
    return table(["record", "m", "b", "k", "x0", "pooled", "m: error, half-width"], body)


@block
def identify_summary():
    key = "host/identify_accuracy"
    largest = max(value(f"{key}/{record}/m_largest") for record, _ in RECORDS)
    return table(["over all records", "value"], [
        ["largest error of m", power(largest)],
        ["records at rest most of the time, no noise: true values inside the stated intervals", f"{100 * value(f'{key}/at rest/stated'):.1f} %"],
    ])


@block
def identify_terms():
    columns = ("m", "b", "k", "friction", "lag", "offset")
    body = []
    for kind, name in [("plain", "none"), ("friction", "friction"), ("lag", "lag"), ("offset", "offset"), ("all", "all three")]:
        key = f"host/identify_terms/{kind}"
        cells = [f"{m(f'{key}/{c}_held')} of {m(f'{key}/{c}_of')}" if c in ("m", "b", "k", kind) or kind == "all" else "" for c in columns]
        body.append([name, *cells, f"{100 * value(f'{key}/pooled'):.1f} %", f"{100 * value(f'{key}/invented'):.1f} %"])
    return table(["terms that are there", *columns, "pooled", "invented"], body)


@block
def identify_from_board():
    names = ["m", "b", "k"]
    recordings = [("telemetry", "two hits"), ("pulses", "`pulses 1.2`")]
    return table(["board", "recording", *[f"{n} off by, relative" for n in names], "latency found, samples", "latency of the scene"], [
        [board, recording, *[power(value(f"elf/identify_{key}/{board}/{n}"), 1) for n in names],
         significant(value(f"elf/identify_{key}/{board}/latency"), 2), constant(f"scenes/{board}.toml", r"(?m)^latency = (\S+)")]
        for board in BOARDS for key, recording in recordings])
