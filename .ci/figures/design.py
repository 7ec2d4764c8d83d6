"""A designed filter, and what the study of limits, pushes, loops and designs was asked for."""

import functools
import math

from . import block
from .estimators import share, true_area
from .source import LONG, area_of, mega, number, row, rows, significant, table

DESIGNS = [("1 um, 15 um of the counts, motor", "paper-1um"), ("2 um, 15 um of the counts, motor", "paper-2um"),
           ("1 um, 15 um of the counts, hand", "paper-1um-hand"), ("2 um, 15 um of the counts, hand", "paper-2um-hand"),
           ("1 um, 1 um of the motion, motor, K by 1000", "paper-1um-quiet"),
           ("2 um, 1 um of the motion, motor, K by 1000", "paper-2um-quiet")]
design_area = functools.partial(area_of, write=lambda area: significant(area, 3))


def best_below(name, peak):
    """The filter of most area below that gain peak, if there is one."""
    below = [r for r in rows(f"design-{name}.csv") if float(r["gain_peak_db"]) <= peak]
    return max(below, key=lambda r: float(r["area_n2_s_per_m2"]), default=None)


@block("encoder, RMS limit, push", "Butterworth's best", "gain peak 3 dB", "6 dB", "no limit")
def design_areas():
    for text, name in DESIGNS:
        asked = {"hand": 6, "quiet": 3}.get(name.split("-")[-1], math.inf)
        found = {peak: best_below(name, peak) for peak in (3, 6, math.inf)}
        butterworth = float(found[math.inf]["area_n2_s_per_m2"]) / float(found[math.inf]["times_butterworth"])
        yield text, mega(butterworth), *(design_area(best) if best and peak <= asked else "" for peak, best in found.items())


@block("encoder", "filter", "gain peak 3 dB", "6 dB", "no limit")
def design_two():
    """The best below each gain peak, with its delay where it is one."""
    def cell(best):
        delay = 1e3 * float(best["delay_s"]) if best else 0
        return (design_area(best) if best else "-") + (f" ({delay:.1f} ms)" if delay >= 0.05 else "")

    for encoder in ("1 um", "2 um"):
        for text, tail in [("one section", ""), ("two, no delay", "-two-no-delay"), ("two, any delay", "-two")]:
            name = f"paper-{encoder.replace(' ', '')}{tail}"
            yield encoder, text, *(cell(best_below(name, peak)) for peak in (3, 6, math.inf))


@block()
def design_six():
    conditions, filters = "design-paper-1um-six-conditions.csv", rows("design-paper-1um-six.csv")
    shown = [0, *[n for n, r in enumerate(filters) if float(r["gain_peak_db"]) <= 6][:1]]
    body = []
    for name in dict.fromkeys(r["condition"] for r in rows(conditions)):
        found = [row(conditions, condition=name, filter=one) for one in ("butterworth", *(str(n + 1) for n in shown))]
        body.append([name.replace(" pushes", ""), *map(design_area, found)])
    return table(["who pushes, arm", "Butterworth's best", *(f"filter of {float(filters[n]['gain_peak_db']):.1f} dB" for n in shown)], body)


# Column, stored table.
CONDITIONS = {"15 um, motor": "compare-paper-1um.csv", "15 um, hand": "compare-paper-1um-hand-15um.csv",
              "1 um, motor": "compare-paper-1um-motor-1um.csv", "1 um, hand": "compare-paper-1um-hand-1um.csv",
              "1 um, motor, 0.115 samples": "compare-paper-1um-board-1um.csv"}
ASKED = ["butterworth", "first-order", "least-squares-2", "tracking-loop", "kalman-3", "levant-explicit"]


@block("estimator", *CONDITIONS)
def comparison_conditions():
    def cell(file, name):
        r, area = row(file, estimator=name), lambda name: float(row(file, estimator=name)["area_n2_s_per_m2"])
        place = sorted(ASKED, key=area, reverse=True).index(name) + 1
        cut = "> " if float(r["damping_max_mean_n_s_per_m"]) >= 4000 else ""
        tuning = f", {number(r['tuning'], 0)} Hz" if r["tuning_unit"] == "Hz" else ""
        return f"{cut}{mega(area(name))} ({place}.), {share(r)} %{tuning}"

    for name in ASKED:
        yield f"`{name}`", *(cell(file, name) for file in CONDITIONS.values())
    yield "true velocity", *(significant(true_area(file), 3) for file in CONDITIONS.values())


# Question of `design` in docs/data, largest gain peak, least area asked.
DESIGNED = [
    ("paper-1um", math.inf, 118), ("paper-1um", 6, 83), ("paper-1um", 3, 63), ("paper-2um", math.inf, 96), ("paper-2um", 6, 67),
    ("paper-2um", 3, 53), ("paper-1um-hand", 6, 900), ("paper-2um-hand", 6, 670), ("paper-1um-quiet", 3, 15.0),
    ("paper-2um-quiet", 3, 9.4),
]


@block("command", "gain peak", "asked, 10^6", "found, 10^6", "held")
def held_designs():
    for name, peak, least in DESIGNED:
        best = best_below(name, peak)
        yield (f"`{LONG[f'design-{name}'][0]}`", "no limit" if peak == math.inf else f"{peak} dB", least, design_area(best),
               "yes" if float(best["area_n2_s_per_m2"]) >= least * 1e6 else "**no**")
