"""Which estimator, speed against accuracy, velocity estimators: tables made of what `compare`, `trade` and the tests
have stored."""

import csv
import functools
import math

from . import block
from .source import LONG, ROOT, long, number, row, rows, rows_of, said, significant

FUSION = "compare-paper-1um-accelerometer.csv"


def of(scene, estimator):
    return row(FUSION if estimator == "fusion" else f"compare-{scene}.csv", estimator=estimator)


def f(r, key, scale=1.0, digits=0, none="-"):
    return number(float(r[key]) * scale, digits) if r[key] else none


def tuned(r):
    def one(key, unit, edge):
        value = float(r[key])
        text = significant(value, 3) if value < 100 and r[unit] != "samples" else number(value, 0)
        return text + (f" {r[unit]}" if r[unit] != "1" else "") + ("*" if r[edge] == "true" else "")
    keys = [("tuning", "tuning_unit", "tuning_at_edge"), ("second", "second_unit", "second_at_edge")]
    return ", ".join(one(*names) for names in keys if r[names[0]])


def share(r):
    """Of the area that the true velocity has, %; an estimator that is told a force can have more."""
    return significant(100 * float(r["share_of_true_velocity"]), 2)


def percent(r):
    """The same as a whole number, where it is not too small for that."""
    share = 100 * float(r["share_of_true_velocity"])
    return f"{share:.{0 if share >= 9.95 else 1}f}"


def tuning_hz(r):
    return f"{float(r['tuning']):.0f} Hz" if r["tuning_unit"] == "Hz" else ""


def true_area(file):
    """What the true velocity reaches, by the same walks, 10^6 N^2 s/m^2."""
    r = row(file, estimator="butterworth")
    return float(r["area_n2_s_per_m2"]) / float(r["share_of_true_velocity"]) / 1e6


def cost(name):
    """Cycles and bytes as the tests hold them; a fixed tuning has its estimator's."""
    base = {"observer told in time": "observer", "first-order at 50 Hz": "first-order"}.get(name, name)
    return row("host-sim/data/estimator_cost.csv", estimator=base)


def roughness(r):
    """Mean, smallest and largest of the repeats, mN."""
    mean, low, high = (f(r, f"roughness{end}_n", 1e3) for end in ("", "_low", "_high"))
    return f"{mean} ({low} to {high})" if r["roughness_n"] else "-"


def left(r):
    """Of the area, with a bandwidth that is wrong, %."""
    low, high = (f(r, f"left_when_bandwidth_{end}", 100) for end in ("low", "high"))
    return "-" if low == high == "-" else f"{low}, {high}"


def area_to_cap(r):
    cut = float(r["damping_max_mean_n_s_per_m"]) >= 4000
    return f(r, "area_n2_s_per_m2", 1e-6, 1) + (" (up to the cap of B)" if cut else "")


def winners(r):
    """Who is best by a criterion, and who is not told apart from those."""
    best, alike = ([name for key, name in r.items() if key.startswith(f"{part}.")] for part in ("best", "not_told_apart"))
    beside = ", ".join(name for name in alike if name not in best)
    return ", ".join(best) + (f"; not told apart: {beside}" if beside else "")


def delay(r):
    hand, motor = (f(r, key, 1e3, 3) for key in ("delay_hand_s", "delay_motor_s"))
    return hand if hand == motor else f"{hand} / {motor}"


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
    for name in ("kalman-3", "fusion"):
        yield f"beside it: {name}", f(of("paper-1um", name), "area_n2_s_per_m2", 1e-6, 1)


@block("table", "command", "at commit")
def made_by(*patterns):
    """Stored tables with command and commit."""
    for r in rows("made.csv"):
        if r["file"].startswith(patterns):
            yield f"[{r['file']}](data/{r['file']})", f"`{r['command']}`", r["commit"]


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


@block("estimator", *(f"{machine}: {what}" for machine, unit in (("EMPS", "mm/s"), ("QUBE", "deg/s"))
                       for what in ("-3 dB, Hz", f"error, {unit}", f"by ideal counts, {unit}")))
def ranked_counts():
    """Errors of the estimators on real counts, and on ideal ones."""
    machines = {"emps": 1e3, "qube": 180 / math.pi}
    of = {machine: {r["estimator"]: r for r in rows(f"rank-{machine}.csv")} for machine in machines}

    def errors(r):
        return [float(error) for key, error in r.items() if "error" in key]

    def cells(machine, name):
        r = of[machine][name]
        return f(r, "bandwidth_hz", none=""), *(significant(machines[machine] * error, 3) for error in errors(r))

    def correlation(machine):
        real, ideal = zip(*map(errors, of[machine].values()))
        apart = sum((sorted(real).index(a) - sorted(ideal).index(b)) ** 2 for a, b in zip(real, ideal))
        return f"{1 - 6 * apart / (len(real) * (len(real) ** 2 - 1)):.2f}"

    for name in of["emps"]:
        yield f"`{name}`", *cells("emps", name), *cells("qube", name)
    yield "rank correlation of both errors", "", "", correlation("emps"), "", "", correlation("qube")
