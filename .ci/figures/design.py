"""A designed filter."""

import math

from . import block, slots, states
from .source import constant, lit, m, number, row, rows, significant, table


DESIGNS = [("1 um, 15 um of the counts, motor", "paper-1um"), ("2 um, 15 um of the counts, motor", "paper-2um"),
           ("1 um, 15 um of the counts, hand", "paper-1um-hand"), ("2 um, 15 um of the counts, hand", "paper-2um-hand"),
           ("1 um, 1 um of the motion, motor, K by 1000", "paper-1um-quiet"),
           ("2 um, 1 um of the motion, motor, K by 1000", "paper-2um-quiet")]


def design_area(r):
    area = float(r["area_n2_s_per_m2"]) / 1e6
    return f"{'> ' if int(r['capped_walks']) else ''}{significant(area, 3)}"


@block
def design_areas():
    body = []
    for text, name in DESIGNS:
        filters = rows(f"design-{name}.csv")
        best = float(filters[0]["area_n2_s_per_m2"])
        asked = {"hand": 6, "quiet": 3}.get(name.split("-")[-1], math.inf)
        cells = []
        for peak in (3, 6, math.inf):
            below = [r for r in filters if float(r["gain_peak_db"]) <= peak]
            cells.append(design_area(below[0]) if below and peak <= asked else "")
        body.append([text, significant(best / float(filters[0]["times_butterworth"]) / 1e6, 3), *cells])
    return table(["encoder, RMS limit, push", "Butterworth's best", "gain peak 3 dB", "6 dB", "no limit"], body)


def design_cell(filters, peak):
    """The best below that gain peak, with its delay where it is one."""
    below = [r for r in filters if float(r["gain_peak_db"]) <= peak]
    if not below:
        return "-"
    best = max(below, key=lambda r: float(r["area_n2_s_per_m2"]))
    delay = 1e3 * float(best["delay_s"])
    return design_area(best) + (f" ({delay:.1f} ms)" if delay >= 0.05 else "")


@block
def design_two():
    body = []
    for encoder, scene in [("1 um", "paper-1um"), ("2 um", "paper-2um")]:
        for text, tail in [("one section", ""), ("two, no delay", "-two-no-delay"), ("two, any delay", "-two")]:
            filters = rows(f"design-{scene}{tail}.csv")
            body.append([encoder, text, *(design_cell(filters, peak) for peak in (3, 6, math.inf))])
    return table(["encoder", "filter", "gain peak 3 dB", "6 dB", "no limit"], body)


@block
def design_front(name):
    body = [[number(float(r["gain_peak_db"]), 1), design_area(r), f"{float(r['times_butterworth']):.2f}",
             number(1e3 * float(r["delay_s"]), 3), number(1e3 * float(r["roughness_n"]), 0) if r["roughness_n"] else "-",
             f"{100 * float(r['mistuned_share']):.0f} %", f"{float(r['frequency_hz']):g}", f"{float(r['damping']):g}",
             f"{float(r['lead_s']):g}", f"{float(r['zero']):g}"] for r in rows(f"design-{name}.csv")]
    return table(["gain peak, dB", "area, 10^6 N^2 s/m^2", "times Butterworth's", "delay, ms", "force above 100 Hz, mN",
                  "left when mistuned", "`frequency_hz`", "`damping`", "`lead_s`", "`zero`"], body)


slots(
    "docs/design.md",
    ("It costs {} cycles more", lambda: int(float(m("elf/estimator_cost/biquad-2/most"))) - int(float(m("elf/estimator_cost/biquad/most")))),
)


def best_below(name, peak):
    return max(float(r["area_n2_s_per_m2"]) for r in rows(f"design-{name}.csv") if float(r["gain_peak_db"]) <= peak)


def gains(scene, tail):
    """By gain peak: per cent that the second section adds to the area."""
    return [round(100 * (best_below(scene + tail, peak) / best_below(scene, peak) - 1)) for peak in (3, 6, math.inf)]


def ends_of(values):
    return min(values), max(values)


THEIRS = "tests/host/design.rs"


def theirs(name, n):
    """An area of the independent search, as the test has it."""
    wanted = constant(THEIRS, rf'the_front_holds(?s:.*?)\("{name}", \[\(f64::INFINITY, ([^\]]*)\)\]').replace("(", "").replace(")", "").split(", ")
    return lambda: number(float(wanted[2 * n]))


def quiet(n):
    pair = constant(THEIRS, r'\[\("paper-1um", ([\d.]+\), \("paper-2um", [\d.]+)\)\] \{\s+let mut scene').split('), ("paper-2um", ')
    return lambda: number(float(pair[n]))


slots(
    "docs/design.md",
    ("found {}, {} and {} without a limit, at 6 and 3 dB (1 um, 15 um, motor), {}, {} and {} with the 2 um encoder, {} by hand "
     "at 6 dB, {} and {} at a limit", *[theirs(name, n) for name in ("paper-1um", "paper-2um") for n in range(3)],
     lambda: constant(THEIRS, r'"paper-1um", OF_THEIRS \* (\d+)'), quiet(0), quiet(1)),
    ("The best has a peak of {} dB only,", lambda: number(float(rows("design-paper-2um-hand.csv")[0]["gain_peak_db"]), 1)),
    ("asks for {} % of each at least,", lambda: number(100 * lit(THEIRS, r"OF_THEIRS: f64 = ([\d.]+)"))),
    ("a second section is worth {} to {} % with the 1 um encoder and {} to {} % with the 2 um one.", *[
        lambda scene=scene, end=end: ends_of(gains(scene, "-two-no-delay"))[end] for scene in ("paper-1um", "paper-2um") for end in (0, 1)]),
    ("the area with the 1 um encoder grows by {} to {} %:", *[lambda end=end: ends_of(gains("paper-1um", "-two"))[end] for end in (0, 1)]),
)
states(
    "docs/design.md",
    ("such filters lag by 1 to 2 ms below their poles,", lambda: all(
        1e-3 < float(r["delay_s"]) < 2.3e-3 for r in rows("design-paper-1um-two.csv"))),
    ("With 3 dB it is still ahead of Butterworth's best in every row.", lambda: all(
        best_below(name, 3) > float(rows(f"design-{name}.csv")[0]["area_n2_s_per_m2"]) / float(rows(f"design-{name}.csv")[0]["times_butterworth"])
        for _, name in DESIGNS)),
    ("with the 2 um encoder the one that allows a delay has found less than the one that does not.", lambda: all(
        best_below("paper-2um-two", peak) < best_below("paper-2um-two-no-delay", peak) for peak in (3, 6, math.inf))),
)


@block
def design_six():
    found = rows("design-paper-1um-six-conditions.csv")
    names = list(dict.fromkeys(r["condition"] for r in found))
    filters = rows("design-paper-1um-six.csv")
    shown = [0] + [n for n, r in enumerate(filters) if float(r["gain_peak_db"]) <= 6][:1]

    def of(condition, name):
        return design_area(row("design-paper-1um-six-conditions.csv", condition=condition, filter=name))
    heads = [f"filter of {float(filters[n]['gain_peak_db']):.1f} dB" for n in shown]
    return table(["who pushes, arm", "Butterworth's best", *heads],
                 [[name.replace(" pushes", ""), of(name, "butterworth"), *(of(name, str(n + 1)) for n in shown)] for name in names])
