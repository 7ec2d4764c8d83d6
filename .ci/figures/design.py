"""A designed filter, and what the study of limits, pushes, loops and designs was asked for."""

import math

from . import block
from .estimators import cost, share, true_area
from .source import LONG, m, measured, number, row, rows, significant, table

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


def off(key):
    """Farthest that our starts are from the independent program, percent."""
    own = [float(measured(f"host/criteria/{key}/{end}")) for end in ("low", "high")]
    theirs = float(measured(f"host/criteria/{key}/independent"))
    inside = own[0] <= theirs <= own[1]
    return 0.0 if inside else 100 * min(abs(value / theirs - 1) for value in own)


@block
def held_figures():
    hands = [f"by_hand/{name}" for name in ("butterworth", "kalman-3", "levant-explicit")]
    runs = [f"saturation/{key}" for key in ("10/motor", "20/motor", "100/motor", "5.2/hand", "10/hand", "100/hand")]
    cells = {key: (m(f"host/criteria/{key}/within"), m(f"host/criteria/{key}/cells")) for key in ("limits", "levels")}
    levers = [f"levers/{limit}" for limit in ("1um", "15um")]
    within, all_ = (sum(float(measured(f"host/criteria/{key}/{what}")) for key in levers) for what in ("within", "cells"))
    worst = max(float(measured(f"host/criteria/{key}/worst_percent")) for key in levers)
    more = int(cost("biquad")[0]) - int(cost("butterworth")[0])
    test = "cargo test --release --test host"
    body = [
        ["hand's push, three estimators", "3 %", f"{max(map(off, hands)):.1f} % between the ranges at most", f"`{test} criteria -- --ignored`"],
        ["six runs over the actuator's limit", "3 %", f"{max(map(off, runs)):.1f} % between the ranges at most", "the same"],
        ["areas by limit of the motion", "3 % above 10^6", f"{cells['limits'][0]} of {cells['limits'][1]} cells", "the same"],
        ["areas by sensation level", "3 % above 10^6", f"{cells['levels'][0]} of {cells['levels'][1]} cells", "the same"],
        ["true velocity", "3 %", f"{m('host/criteria/yardstick/cells')} of {m('host/criteria/yardstick/cells')} cells", "the same"],
        ["when the loop acts", "3 %", f"{within:.0f} of {all_:.0f} loops, {worst:.1f} % off at most", "the same"],
        ["cycles of `biquad` over Butterworth's", "5", more, "`cargo test --test elf estimator_cost -- --ignored`"],
        ["encoder with which the model feels nothing at 20 kN/m", "-",
         f"{float(measured('host/criteria/felt/paper/0/um')):.2g} um; with the board's latency "
         f"{float(measured('host/criteria/felt/board/0/um')):.2g} um", f"`{test} criteria::felt -- --ignored`"],
    ]
    return table(["figure, against an independent program", "asked", "found", "command"], body)
