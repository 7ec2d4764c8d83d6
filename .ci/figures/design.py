"""A designed filter, and what the study of limits, pushes, loops and designs was asked for."""

import functools

from . import block
from .estimators import share, true_area
from .source import area_of, mega, number, row, rows, significant, table

design_area = functools.partial(area_of, write=lambda area: significant(area, 3))


def area_and_delay(r):
    """With its delay where it is one."""
    delay = 1e3 * float(r["delay_s"])
    return design_area(r) + (f" ({delay:.1f} ms)" if delay >= 0.05 else "")


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
