"""A designed filter, and what the study of limits, pushes, loops and designs was asked for."""

import math

from . import block
from .estimators import share, true_area
from .source import LONG, number, row, rows, significant, table

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


# Column, stored table, its command's name in LONG.
CONDITIONS = [("15 um, motor", "compare-paper-1um.csv"), ("15 um, hand", "compare-paper-1um-hand-15um.csv"),
              ("1 um, motor", "compare-paper-1um-motor-1um.csv"), ("1 um, hand", "compare-paper-1um-hand-1um.csv"),
              ("1 um, motor, 0.115 samples", "compare-paper-1um-board-1um.csv")]
ASKED = ["butterworth", "first-order", "least-squares-2", "tracking-loop", "kalman-3", "levant-explicit"]


def area(file, name):
    r = row(file, estimator=name)
    capped = float(r["damping_max_mean_n_s_per_m"]) >= 4000
    return float(r["area_n2_s_per_m2"]) / 1e6, capped


def ranking(file):
    return sorted(ASKED, key=lambda name: -area(file, name)[0])


@block
def comparison_conditions():
    def cell(file, name):
        found, capped = area(file, name)
        tuning = row(file, estimator=name)
        return f"{'> ' if capped else ''}{significant(found, 3)} ({ranking(file).index(name) + 1}.), {share(tuning)} %" + (
            f", {float(tuning['tuning']):.0f} Hz" if tuning["tuning_unit"] == "Hz" else "")
    return table(["estimator", *[text for text, _ in CONDITIONS]],
                 [[f"`{name}`", *[cell(file, name) for _, file in CONDITIONS]] for name in ASKED]
                 + [["true velocity", *[significant(true_area(file), 3) for _, file in CONDITIONS]]])


# Question of `design` in docs/data, largest gain peak, least area asked.
DESIGNED = [
    ("paper-1um", math.inf, 118), ("paper-1um", 6, 83), ("paper-1um", 3, 63), ("paper-2um", math.inf, 96), ("paper-2um", 6, 67),
    ("paper-2um", 3, 53), ("paper-1um-hand", 6, 900), ("paper-2um-hand", 6, 670), ("paper-1um-quiet", 3, 15.0),
    ("paper-2um-quiet", 3, 9.4),
]


@block
def held_designs():
    body = []
    for name, peak, least in DESIGNED:
        below = [r for r in rows(f"design-{name}.csv") if float(r["gain_peak_db"]) <= peak]
        best = max(below, key=lambda r: float(r["area_n2_s_per_m2"]))
        command = LONG[f"design-{name}"][0]
        limit = "no limit" if peak == math.inf else f"{peak} dB"
        holds = "yes" if float(best["area_n2_s_per_m2"]) >= least * 1e6 else "**no**"
        body.append([f"`{command}`", limit, least, design_area(best), holds])
    return table(["command", "gain peak", "asked, 10^6", "found, 10^6", "held"], body)


@block
def held_times():
    return table(["command", "processor time, s", "half, s"],
                 [[f"`{r['command']}`", round(float(r["cpu_s"])), round(float(r["cpu_s"]) / 2)] for r in rows("command-times.csv")])
