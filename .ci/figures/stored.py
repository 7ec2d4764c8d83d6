"""Tables of stored rows that are more than a template: sums, ranks, and heads that the rows make."""

import csv
import functools
import math

from . import block
from .source import (
    LONG, ROOT, area_of, at_ideal, grouped, long, mega, number, power, row, rows, rows_of, said, said_in, significant, table,
)
from .templates import filled, picked
from .words import area_3, area_at, f, of_true_velocity


@block()
def stored(file):
    """A stored table as it stands."""
    return table(list(rows(file)[0]), [r.values() for r in rows(file)])


@block("table", "command", "at commit")
def made_by(*patterns):
    """Stored tables with command and commit."""
    for r in rows("made.csv"):
        if r["file"].startswith(patterns):
            yield f"[{r['file']}](data/{r['file']})", f"`{r['command']}`", r["commit"]


@block()
def criteria_rates(limit, push):
    """Area at the ideal cutoff, and that cutoff, by encoder rate and output rate."""
    by_rates, true_velocity = (
        grouped(picked(f"rates-paper-1um.csv, limit={limit}, push={push}, estimator={name}"), "encoder_rate_hz", "output_rate_hz")
        for name in ("scene", "true-velocity"))
    encoders, outputs = (sorted(set(rates), key=float) for rates in zip(*by_rates))

    def cell(found):
        if not (best := at_ideal(found)):
            return "none" if found else ""
        highest = max(found, key=lambda r: float(r["cutoff_hz"]))
        return area_at(best[0]).replace(" Hz)", " Hz*)" if best[0] is highest else " Hz)")

    body = [[number(encoder), *(cell(by_rates.get((encoder, output), [])) for output in outputs)] for encoder in encoders]
    body.append([f"true velocity, {number(encoders[-1])}", *(area_of(true_velocity[encoders[-1], output][0]) for output in outputs)])
    return table(["encoder rate, Hz", *(f"outputs at {number(output)} Hz" for output in outputs)], body)


@block()
def design_six():
    conditions, filters = "design-paper-1um-six-conditions.csv", rows("design-paper-1um-six.csv")
    shown = [0, *[n for n, r in enumerate(filters) if float(r["gain_peak_db"]) <= 6][:1]]
    body = []
    for name in dict.fromkeys(r["condition"] for r in rows(conditions)):
        found = [row(conditions, condition=name, filter=one) for one in ("butterworth", *(str(n + 1) for n in shown))]
        body.append([name.replace(" pushes", ""), *map(area_3, found)])
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
        return f"{cut}{mega(area(name))} ({place}.), {of_true_velocity(r)} %{tuning}"

    for name in ASKED:
        yield f"`{name}`", *(cell(file, name) for file in CONDITIONS.values())
    true = "{{{}, estimator=butterworth: area_n2_s_per_m2 /share_of_true_velocity /1e6 s3}}".format
    yield "true velocity", *(filled(true(file)) for file in CONDITIONS.values())


@block("estimator", "1 Hz", "10 Hz", "50 Hz", "100 Hz")
def comparison_frequencies():
    def mean(name, part=""):
        """Of the walls, at each frequency."""
        scene = "paper-1um-accelerometer" if name == "fusion" else "paper-1um"
        for hz in (1, 10, 50, 100):
            errors = [float(r[f"impedance_error{part}"]) for r in rows_of(f"compare-{scene}-fidelity.csv", estimator=name)
                      if abs(float(r["frequency_hz"]) / hz - 1) < 0.01]
            yield significant(100 * sum(errors) / len(errors), 2)

    yield "hold and latency alone", *mean("butterworth", "_of_loop")
    for name in ("butterworth", "kalman-3", "levant-explicit", "levant-implicit", "time-stamps", "fusion", "observer"):
        yield name, *map(" / ".join, zip(mean(name), mean(name, "_of_estimator")))


@block("bandwidth of the observer told in time, with the device's own mass, Hz", "area, 10^6 N^2 s/m^2")
def comparison_observer():
    """Every tuning that was tried with the device's own mass, beside two others."""
    tried = sorted((r for r in rows_of("compare-paper-1um-tuning.csv", estimator="observer told in time")
                    if abs(float(r["second"] or 0) / 0.416 - 1) < 1e-3), key=lambda r: float(r["tuning"]))
    best = max(tried, key=lambda r: float(r["area_n2_s_per_m2"]))
    picked = {float(r["tuning"]): r for r in [*tried[:: max(1, len(tried) // 6)], best]}
    for hz, r in sorted(picked.items()):
        yield significant(hz, 3) + (" (the best)" if r is best else ""), f(r, "area_n2_s_per_m2", 1e-6, 1)
    for name, file in (("kalman-3", "compare-paper-1um.csv"), ("fusion", "compare-paper-1um-accelerometer.csv")):
        yield f"beside it: {name}", f(row(file, estimator=name), "area_n2_s_per_m2", 1e-6, 1)


@block("machine", "rank correlation of the errors on real and on ideal counts")
def ranked_correlation():
    for machine in ("emps", "qube"):
        real, ideal = zip(*([float(error) for key, error in r.items() if "error" in key] for r in rows(f"rank-{machine}.csv")))
        apart = sum((sorted(real).index(a) - sorted(ideal).index(b)) ** 2 for a, b in zip(real, ideal))
        yield machine.upper(), f"{1 - 6 * apart / (len(real) * (len(real) ** 2 - 1)):.2f}"


# Real counts: records of machines that are not part of the project
def ranked(machine):
    """The ranks on the record MACHINE.csv, if it lies in the root."""
    record = ROOT / f"{machine}.csv"
    if not record.exists():
        raise SystemExit(f"error: {machine}.csv is not here; docs/lab/estimators-measured.md says where it is from")
    command = LONG[f"rank-{machine}"][0].removeprefix("cargo sim ").replace(record.name, str(record))
    return list(csv.DictReader(said(f"{command} --csv ranks.csv", wrote="ranks.csv").splitlines()))


for machine in ("emps", "qube"):
    long(f"rank-{machine}")(functools.partial(ranked, machine))


METHODS = {"exact": "exact", "semi-implicit-euler": "semi-implicit Euler", "rk4": "RK4", "dormand-prince": "Dormand-Prince"}


def method_and_setting(r):
    """In this order: a tolerance falls, steps grow."""
    return list(METHODS).index(r["method"]), float(r["setting"] or 0) * (-1 if r["method"] == "dormand-prince" else 1)


@block("method", "operations per simulated s", "trajectory off by, m", "verdicts that differ", "area changes by")
def trade_plant(name):
    for r in sorted(rows(f"trade-plant-{name}.csv"), key=method_and_setting):
        what, steps = METHODS[r["method"]], float(r["setting"] or 0)
        if r["method"] == "dormand-prince":
            what += f", tolerance {power(steps, 1)}"
        elif steps:
            what += f", {steps:g} step{'s' if steps > 1 else ''} per sample"
        if r["refused"]:
            yield what, r["refused"], "", "", ""
            continue
        off_m, change = float(r["trajectory_error_m"] or 0), r["area_change"]
        yield (what, power(r["operations_per_s"]) if r["operations_per_s"] else "-", power(off_m) if off_m else "0",
               f"{r['verdicts_wrong']} of {r['verdicts']}",
               "-" if not change else "0" if float(change) == 0 else f"{100 * float(change):+.1f} %")
    told = said_in(f"trade-{name}.json")["plant"]
    yield ("exact, start moved by a quarter of a count", "-", "-", f"{told['verdicts_chaotic']} of {told['verdicts']}",
           f"{100 * told['area_chaotic']:.1f} %")


@block("Q15 on `paper-1um`", "value")
def trade_q15():
    full_scale = said_in("trade-paper-1um.json")["q15_full_scale_m_per_s"]
    w = math.pi * 20.0 / 1e4  # paper's equation (2), not pre-warped
    b0 = w * w / (1 + math.sqrt(2) * w + w * w)
    yield "full scale, m/s", significant(full_scale, 3)
    yield "speed of impact without damping, and with it, m/s", ", ".join(significant(impact(b), 2) for b in (0.0, 5.5195))
    yield "LSB of the velocity, um/s", significant(full_scale / 2**15 * 1e6, 2)
    yield "`b0` at 20 Hz, in LSB of 2^-14, the format of its coefficients", significant(b0 * 2**14, 2)


def impact(damping):
    """Speed at 0.07 m of the paper's device, pushed with 2.835 N from 0, by small steps."""
    x = v = 0.0
    while x < 0.07:
        v += 1e-6 * (2.835 - damping * v - 11.0626 * (x - 0.0517)) / 0.416
        x += 1e-6 * v
    return v


@block()
def extremes_verdicts():
    pairs = rows("docs/figures/fixed-point-limits.csv")
    body = []
    for name, key in [("the core", "differ_fixed"), ("exact, its velocity rounded to the core's LSB", "differ_rounded_velocity")]:
        worst = max(pairs, key=lambda r: int(r[key]) / int(r["walls"]))
        where = f"{float(worst['resolution_m']) * 1e6:g} um, {float(worst['cutoff_hz']):g} Hz"
        body.append([name, f"{100 * int(worst[key]) / int(worst['walls']):.1f} % ({where})", sum(int(r[key]) == 0 for r in pairs)])
    few = sum(int(r["walls"]) - int(r["stable"]) < 6 for r in pairs)
    head = ["arithmetic", f"verdicts that differ from exact arithmetic, of {pairs[0]['walls']} walls, at most",
            f"pairs of resolution and cutoff without any, of {len(pairs)}"]
    return [*table(head, body), "", f"Pairs with fewer than six unstable walls: {few}."]
