"""Which estimator, speed against accuracy, velocity estimators: tables made of what `compare`, `trade` and the tests
have stored."""

import csv
import functools
import math
import tempfile

from . import block
from .source import (
    LONG, ROOT, area_of, long, m, measured, number, power, programs, row, rows, rows_of, said_in, shell, significant, table,
)

FUSION = "compare-paper-1um-accelerometer.csv"


def compared(scene):
    """The rows of `compare`; for the finer encoder with those of the scene with an accelerometer."""
    found = [dict(r) for r in rows(f"compare-{scene}.csv")]
    if scene == "paper-2um":
        later = {r["estimator"]: dict(r) for r in rows("compare-paper-2um-added.csv")}
        found = [later.pop(r["estimator"], r) for r in found] + list(later.values())
    if scene == "paper-1um":
        found += [{**r, "estimator": "fusion (accelerometer scene)"} for r in rows_of(FUSION, estimator="fusion")]
    return found


def of(scene, estimator):
    return row(FUSION if estimator == "fusion" else f"compare-{scene}.csv", estimator=estimator)


def f(r, key, scale=1.0, digits=0):
    return number(float(r[key]) * scale, digits) if r[key] else "-"


def range_of(r, key, scale, digits):
    """Mean, smallest and largest of the repeats."""
    if not r[f"{key}"]:
        return "-"
    stem, unit = (key[:4], key[4:]) if key.startswith("area") else ("roughness", "_n")
    low, high = (f(r, f"{stem}_{end}{unit}", scale, digits) for end in ("low", "high"))
    return f"{f(r, key, scale, digits)} ({low} to {high})"


def tuned(r):
    if not r["tuning"]:
        return ""
    def one(value, unit, edge):
        value = float(value)
        text = significant(value, 3) if value < 100 and unit != "samples" else number(value, 0)
        return f"{text}{' ' + unit if unit != '1' else ''}{'*' if edge == 'true' else ''}"
    second = f", {one(r['second'], r['second_unit'], r['second_at_edge'])}" if r["second"] else ""
    return one(r["tuning"], r["tuning_unit"], r["tuning_at_edge"]) + second


def walks(r):
    return r["search_walks"] + ("+" if r["search_settled"] == "false" else "")


def left(r):
    if not r["left_when_bandwidth_low"] and not r["left_when_bandwidth_high"]:
        return "-"
    return ", ".join(f(r, f"left_when_bandwidth_{end}", 100) for end in ("low", "high"))


def share(r):
    """Of the area that the true velocity has, %; an estimator that is told a force can have more."""
    return significant(100 * float(r["share_of_true_velocity"]), 2)


def true_area(file):
    """What the true velocity reaches, by the same walks, 10^6 N^2 s/m^2."""
    r = row(file, estimator="butterworth")
    return float(r["area_n2_s_per_m2"]) / float(r["share_of_true_velocity"]) / 1e6


@block
def comparison_areas(scene):
    head = ["estimator", "needs", "tuning, second parameter", "walks", "area, 10^6 N^2 s/m^2 (lowest to highest)",
            "of the true velocity's, %", "peak K, kN/m", "K at B, kN/m", "largest B, N s/m", "area left at -3 dB /1.2, x1.2, %"]
    return table(head, [
        [r["estimator"], r["needs"], tuned(r), walks(r), range_of(r, "area_n2_s_per_m2", 1e-6, 1), share(r),
         f(r, "stiffness_peak_mean_n_per_m", 1e-3, 1), f(r, "stiffness_at_damping_mean_n_per_m", 1e-3, 1),
         f(r, "damping_max_mean_n_s_per_m"), left(r)]
        for r in compared(scene)])


def cost(name):
    """Cycles and bytes as the tests hold them; a fixed tuning has its estimator's."""
    base = {"observer told in time": "observer", "first-order at 50 Hz": "first-order",
            "fusion (accelerometer scene)": "fusion"}.get(name, name)
    found = row("host-sim/data/estimator_cost.csv", estimator=base)
    return [found["cycles"], found["ram_bytes"]]


def delay(r):
    hand, motor = (f(r, key, 1e3, 3) for key in ("delay_hand_s", "delay_motor_s"))
    return hand if hand == motor else f"{hand} / {motor}"


@block
def comparison_measures(scene):
    head = ["estimator", "-3 dB of difference and filter, Hz", "delay at 5 Hz by hand / by motor, ms",
            "noise at rest / in motion, mm/s", "force above 100 Hz, mN (lowest to highest)",
            "impedance error, %: all / estimator's share", "cycles", "RAM, bytes"]
    return table(head, [
        [r["estimator"], f(r, "bandwidth_hz"), delay(r),
         f"{f(r, 'noise_at_rest_m_per_s', 1e3, 2)} / {f(r, 'noise_in_motion_m_per_s', 1e3, 2)}",
         range_of(r, "roughness_n", 1e3, 0),
         f"{f(r, 'impedance_error', 100, 2)} / {f(r, 'impedance_error_of_estimator', 100, 2)}" if r["impedance_error"] else "-",
         *cost(r["estimator"])]
        for r in compared(scene)])


CRITERIA = [
    ("area_n2_s_per_m2", "area"), ("stiffness_peak_mean_n_per_m", "peak K"),
    ("stiffness_at_damping_mean_n_per_m", "K at B"), ("damping_max_mean_n_s_per_m", "largest B"),
    ("delay_hand_s", "delay by hand"), ("delay_motor_s", "delay by motor"),
    ("noise_at_rest_m_per_s", "noise at rest"), ("noise_in_motion_m_per_s", "noise in motion"),
    ("roughness_n", "force above 100 Hz"), ("impedance_error", "impedance error"),
    ("impedance_error_of_estimator", "the estimator's share of it"),
    ("left_when_bandwidth_wrong", "area left at a bandwidth 1.2 times off, the worse way"),
    ("cycles", "cycles"), ("ram_bytes", "RAM"),
]


@block
def comparison_winners(scene):
    winners = said_in(f"compare-{scene}.json")["winners"]

    def cell(criterion, kind):
        found = [w for w in winners if w["criterion"] == criterion and w["class"] == kind]
        if not found:
            return ["-", "-"] if kind == "position_only" else ["-"]
        text = ", ".join(found[0]["best"])
        beside = [name for name in found[0]["not_told_apart"] if name not in found[0]["best"]]
        text += f"; not told apart: {', '.join(beside)}" if beside else ""
        rank = found[0]["butterworth_rank"]
        return [text, rank if rank is not None else "-"] if kind == "position_only" else [text]

    return table(
        ["criterion", "by the position only", "rank of butterworth", "of those that know more (an observer's area and K: see below)"],
        [[name, *cell(key, "position_only"), *cell(key, "more_than_position")] for key, name in CRITERIA])


@block
def comparison_walls():
    told = said_in("compare-paper-1um.json")
    walls = [f"{number(w['stiffness_n_per_m'])} N/m with {w['damping_n_s_per_m']:g} N s/m" for w in told["walls"]]
    return table(["what", "walls"], [["force above 100 Hz", f"K {walls[1]}"], ["impedance", ", ".join(f"K {w}" for w in walls)],
                                     ["hold and latency alone, with the true velocity",
                                      f"an impedance error of {100 * told['impedance_error_of_loop']:.2f} %"]])


@block
def comparison_short():
    def gain(name, scene):
        return 100 * (float(of(scene, name)["area_n2_s_per_m2"]) / float(of(scene, "butterworth")["area_n2_s_per_m2"]) - 1)

    def worst(name, scene):
        r = of(scene, name)
        return f"{100 * float(r['left_when_bandwidth_wrong']):.0f} %"

    names = ["butterworth", "kalman-3", "levant-explicit", "fusion"]
    body = []
    for name in names:
        both = ["paper-1um"] if name == "fusion" else ["paper-1um", "paper-2um"]
        cells = [f"{gain(name, s):+.0f} %" for s in both] + ["-"] * (2 - len(both))
        offs = [worst(name, s) for s in both] + ["-"] * (2 - len(both))
        body.append([name, cost(name)[0], *cells, *offs, f(of("paper-1um", name), "noise_in_motion_m_per_s", 1e3, 2),
                     f(of("paper-1um", name), "roughness_n", 1e3)])
    return table(["estimator", "cycles", "area against butterworth, 1 um", "2 um", "area left when mistuned by 1.2, 1 um", "2 um",
                  "noise in motion, 1 um, mm/s", "force above 100 Hz, 1 um, mN"], body)


LIMITED = ["butterworth", "first-order", "kalman-3", "levant-explicit", "time-stamps"]


def at_limit(um):
    return "compare-paper-1um.csv" if um == 15 else f"compare-paper-1um-limit-{um}um.csv"


@block
def comparison_limits(column, scale, digits):
    def cell(name, um):
        r = row(at_limit(um), estimator=name)
        cut = column == "area_n2_s_per_m2" and float(r["damping_max_mean_n_s_per_m"]) >= 4000
        return f(r, column, float(scale), int(digits)) + (" (up to the cap of B)" if cut else "")
    ceiling = [["the true velocity", *[f"{true_area(at_limit(um)):.{digits}f}" for um in (5, 15, 30)]]]
    ceiling = ceiling if column == "area_n2_s_per_m2" else []
    return table(["estimator", *[f"limit of {um} um" for um in (5, 15, 30)]],
                 [[name, *[cell(name, um) for um in (5, 15, 30)]] for name in LIMITED] + ceiling)


@block
def comparison_cutoffs():
    return table(["limit of the RMS, um", "butterworth's best cutoff, Hz"],
                 [[um, f(row(at_limit(um), estimator="butterworth"), "tuning")] for um in (5, 15, 30)])


FIDELITY = ["butterworth", "kalman-3", "levant-explicit", "levant-implicit", "time-stamps", "fusion", "observer"]


@block
def comparison_frequencies():
    def mean(name, hz):
        file = "compare-paper-1um-accelerometer-fidelity.csv" if name == "fusion" else "compare-paper-1um-fidelity.csv"
        found = [r for r in rows(file) if r["estimator"] == name and abs(float(r["frequency_hz"]) / hz - 1) < 0.01]
        total, share, loop = (100 * sum(float(r[key]) for r in found) / len(found) for key in
                              ("impedance_error", "impedance_error_of_estimator", "impedance_error_of_loop"))
        return total, share, loop

    hz = (1, 10, 50, 100)
    body = [["hold and latency alone", *[significant(mean("butterworth", h)[2], 2) for h in hz]]]
    for name in FIDELITY:
        body.append([name, *["{} / {}".format(*[significant(x, 2) for x in mean(name, h)[:2]]) for h in hz]])
    return table(["estimator", *[f"{h} Hz" for h in hz]], body)


@block
def comparison_observer():
    """Every tuning that was tried with the device's own mass, beside two others."""
    tried = [r for r in rows("compare-paper-1um-tuning.csv")
             if r["estimator"] == "observer told in time" and abs(float(r["second"] or 0) / 0.416 - 1) < 1e-3]
    wanted = sorted(tried, key=lambda r: float(r["tuning"]))
    best = max(wanted, key=lambda r: float(r["area_n2_s_per_m2"]))
    step = max(1, len(wanted) // 6)
    picked = sorted({float(r["tuning"]): r for r in [*wanted[::step], best]}.items())
    return table(
        ["bandwidth of the observer told in time, with the device's own mass, Hz", "area, 10^6 N^2 s/m^2"],
        [[significant(hz, 3) + (" (the best)" if r is best else ""), f(r, "area_n2_s_per_m2", 1e-6, 1)] for hz, r in picked]
        + [[f"beside it: {name}", f(of("paper-1um", name), "area_n2_s_per_m2", 1e-6, 1)] for name in ("kalman-3", "fusion")])


@block
def comparison_observers():
    names = ["observer", "observer told in time", "kalman-3"]
    def line(name):
        r = of("paper-1um", name)
        area = float(r["area_n2_s_per_m2"]) / float(of("paper-1um", "butterworth")["area_n2_s_per_m2"])
        mass = f"{f(r, 'left_when_mass_low', 100)}, {f(r, 'left_when_mass_high', 100)}" if r["left_when_mass_low"] else "-"
        return [name, significant(area, 2), delay(r), f(r, "phase_100_hz_hand_deg", 1, 0), f(r, "phase_100_hz_motor_deg", 1, 0),
                f(r, "impedance_error", 100, 1), f(r, "impedance_error_of_estimator", 100, 2), mass]
    return table(["estimator", "area, times butterworth's", "delay by hand / by motor, ms", "phase at 100 Hz by hand, degrees",
                  "by motor, degrees", "impedance error, %", "estimator's share, %", "area left with a mass 20 % too small, too large, %"],
                 [line(name) for name in names])


@block
def comparison_coarser():
    names = ["levant-explicit", "kalman-3", "butterworth", "time-stamps"]
    def loss(name):
        fine, coarse = (float(of(s, name)["area_n2_s_per_m2"]) for s in ("paper-1um", "paper-2um"))
        return 100 * (1 - coarse / fine)
    return table(["estimator", "area that the coarser encoder costs", "tuning at 1 um", "at 2 um"],
                 [[name, f"{loss(name):.0f} %", *[tuned(of(s, name)) for s in ("paper-1um", "paper-2um")]]
                  for name in sorted(names, key=loss)])


@block
def made_by(*patterns):
    """Stored tables with command and commit."""
    found = [r for r in rows("made.csv") if any(r["file"].startswith(p) for p in patterns)]
    return table(["table", "command", "at commit"],
                 [[f"[{r['file']}](data/{r['file']})", f"`{r['command']}`", r["commit"]] for r in found])


# Real counts: records of machines that are not part of the project
def ranked(machine):
    """The ranks on the record MACHINE.csv, if it lies in the root."""
    command = LONG[f"rank-{machine}"][0].removeprefix("cargo sim ")
    if not (ROOT / f"{machine}.csv").exists():
        raise SystemExit(f"error: {machine}.csv is not here; docs/lab/estimators-measured.md says where it is from")
    with tempfile.TemporaryDirectory() as folder:
        ran = shell(f"{programs()}/host-sim {command} --csv {folder}/ranks.csv", ROOT)
        if ran.returncode:
            raise SystemExit(ran.stderr)
        with open(f"{folder}/ranks.csv", newline="") as file:
            return list(csv.DictReader(file))


for machine in ("emps", "qube"):
    long(f"rank-{machine}")(functools.partial(ranked, machine))


@block
def ranked_counts():
    """Errors of the estimators on real counts, and on ideal ones."""
    of = {machine: {r["estimator"]: r for r in rows(f"rank-{machine}.csv")} for machine in ("emps", "qube")}

    def cells(r, scale):
        speeds = [float(value) for key, value in r.items() if "error" in key]
        return [number(float(r["bandwidth_hz"]), 0) if r["bandwidth_hz"] else "", *(significant(scale * speed, 3) for speed in speeds)]
    body = [[f"`{name}`", *cells(r, 1e3), *cells(of["qube"][name], 180 / math.pi)] for name, r in of["emps"].items()]

    def correlation(machine):
        real, ideal = ([float(r[next(key for key in r if key.startswith(start))]) for r in of[machine].values()] for start in ("error", "simulated"))
        apart = sum((sorted(real).index(a) - sorted(ideal).index(b)) ** 2 for a, b in zip(real, ideal, strict=True))
        return f"{1 - 6 * apart / (len(real) * (len(real) ** 2 - 1)):.2f}"
    body.append(["rank correlation of both errors", "", "", correlation("emps"), "", "", correlation("qube")])
    return table(["estimator", *(f"{machine}: {what}" for machine, unit in (("EMPS", "mm/s"), ("QUBE", "deg/s"))
                                 for what in ("-3 dB, Hz", f"error, {unit}", f"by ideal counts, {unit}"))], body)


@block
def identified_machines():
    """What `identify` finds on records of real machines, beside what others have found."""
    return table(["machine", "value", "published", "inverse dynamic model", "`identify`"],
                 [[r["machine"], r["value"], r["published"], r["inverse_dynamic"], r["identify"]] for r in rows("identify-machines.csv")])


# Velocity estimators
@block
def estimator_costs():
    made = []
    for r in rows("host-sim/data/estimator_cost.csv"):
        cycles = [m(f"elf/estimator_cost/{r['estimator']}/{key}") for key in ("most", "mean")]
        made.append([f"`{r['estimator']}`", *cycles, r["ram_bytes"]])
    return table(["estimator", "cycles, at most", "mean at the default", "state and coefficients, bytes"], made)


@block
def estimator_twins():
    names = ["difference", "taylor-2", "taylor-3", "least-squares-1", "least-squares-2", "first-order",
             "butterworth", "foaw-end", "foaw-best", "kalman-2", "kalman-3", "levant-explicit", "levant-implicit"]
    stated = {
        "difference": "0", "taylor-2": "0.6, against exact weights", "taylor-3": "the same",
        "least-squares-1": "the same", "least-squares-2": "the same", "first-order": "1.5",
        "butterworth": "`1.5 + speed * 3 * 2^-31 / (4 b0)`, speed in LSB: a1 and a2 are rounded to 2^-30 and 2^-31, `4 b0` is their sum with 1",
        "foaw-end": "0.5, the rounding", "foaw-best": "the same", "kalman-2": "1.1: the residue of the rounding is carried",
        "kalman-3": "the same", "levant-explicit": "2, while the acceleration stays below C",
        "levant-implicit": "1, while the acceleration stays below C and c >= 0.2; below, see the text",
    }
    body = []
    for name in names:
        value = float(measured(f"host/estimators/{name}/twin_lsb"))
        body.append([f"`{name}`", "0" if value == 0 else number(value, 1), stated[name]])
    return table(["estimator", "largest difference, LSB", "stated, LSB"], body)


@block
def estimator_slow():
    speeds = ["0.05", "0.7", "-0.347"]
    return table(
        ["speed, counts per sample", *speeds],
        [[name, *[power(float(measured(f"elf/edge_times/speed_{s}/{key}"))) if key != "difference"
                  else number(float(measured(f"elf/edge_times/speed_{s}/{key}")), 2) for s in speeds]]
         for name, key in [("velocity off by at most", "off"), ("stated", "stated"), ("finite difference off by", "difference")]])


# Defaults of other systems
PEERS = "peers-paper-1um.csv"
PEER_LIMITS = [("1.5e-05", "15 um"), ("5e-06", "5 um"), ("2e-06", "2 um"), ("1e-06", "1 um"), ("0.0", "felt, 0 dB")]


def peer(loop, estimator, limit):
    return next(r for r in rows(PEERS) if r["loop"] == loop and r["estimator"] == estimator and float(r["limit"]) == float(limit))


def peer_names():
    return list(dict.fromkeys(r["estimator"] for r in rows(PEERS)))


@block
def peers(loop):
    def cell(name, limit):
        r = peer(loop, name, limit)
        share = 100 * float(r["share_of_true_velocity"])
        return f"{area_of(r)} ({share:.{0 if share >= 9.95 else 1}f} %)"

    return table(["estimator", *(text for _, text in PEER_LIMITS)],
                 [[f"`{name}`", *(cell(name, limit) for limit, _ in PEER_LIMITS)] for name in peer_names()])


@block
def peers_sources():
    of = {r["estimator"]: r for r in rows(PEERS)}
    return table(["row", "what it does", "where that stands"],
                 [[f"`{name}`", r["does"], r["source"]] for name, r in of.items() if r["source"]])


@block
def peers_quiet():
    """Quiet walls first, then the paper's criterion."""
    quiet = {(r["loop"], r["estimator"]): area_of(r) for r in rows("peers-paper-1um-quiet.csv")}
    loops = [("paper-1um", "paper's loop"), ("nucleo-f446re", "board")]
    body = [[f"`{name}`", *(quiet[loop, name] for loop, _ in loops),
             *(area_of(peer(loop, name, PEER_LIMITS[0][0])) for loop, _ in loops)] for name in peer_names()]
    return table(["velocity by default", *(f"{text}, {by}" for by in ("quiet", PEER_LIMITS[0][1]) for _, text in loops)], body)


@block
def comparison_quiet():
    def cells(scene):
        return {r["estimator"]: [significant(float(r["area_n2_s_per_m2"]) / 1e6, 3),
                                 f"{100 * float(r['share_of_true_velocity']):.0f} %",
                                 significant(float(r["scene_area_n2_s_per_m2"]) / 1e6, 3),
                                 f"{float(r['tuning']):.0f} Hz" if r["tuning_unit"] == "Hz" else ""]
                for r in rows(f"compare-{scene}-quiet.csv")}

    paper, board = cells("paper-1um"), cells("nucleo-f446re")
    order = sorted(paper, key=lambda name: -float(paper[name][0]))
    head = ["quiet", "of the true velocity's", "by 15 um", "at"]
    return table(["estimator", *(f"{loop}: {text}" for loop in ("paper's loop", "board") for text in head)],
                 [[f"`{name}`", *paper[name], *board[name]] for name in order])
