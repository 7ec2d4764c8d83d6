"""Which estimator, speed against accuracy, velocity estimators: tables made of what `compare`, `trade` and the tests
have stored."""

import json
import math
import re

from . import block, slots, states
from .source import DATA, MADE, ROOT, commit, constant, m, measured, number, power, row, rows, significant, table  # noqa: F401

FUSION = "compare-paper-1um-accelerometer.csv"


def compared(scene):
    """The rows of `compare`; for the finer encoder with those of the scene with an accelerometer."""
    found = [dict(r) for r in rows(f"compare-{scene}.csv")]
    if scene == "paper-2um":
        later = {r["estimator"]: dict(r) for r in rows("compare-paper-2um-added.csv")}
        found = [later.pop(r["estimator"], r) for r in found] + list(later.values())
    if scene == "paper-1um":
        found += [{**r, "estimator": "fusion (accelerometer scene)"} for r in rows(FUSION) if r["estimator"] == "fusion"]
    return found


def of(scene, estimator):
    return row(FUSION if estimator == "fusion" else f"compare-{scene}.csv", estimator=estimator)


def said(scene):
    return json.loads((DATA / f"compare-{scene}.json").read_text())


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


@block
def comparison_areas(scene):
    head = ["estimator", "needs", "tuning, second parameter", "walks", "area, 10^6 N^2 s/m^2 (lowest to highest)",
            "peak K, kN/m", "K at B, kN/m", "largest B, N s/m", "area left at -3 dB /1.2, x1.2, %"]
    return table(head, [
        [r["estimator"], r["needs"], tuned(r), walks(r), range_of(r, "area_n2_s_per_m2", 1e-6, 1),
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
    winners = said(scene)["winners"]

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
    told = said("paper-1um")
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
    return table(["estimator", *[f"limit of {um} um" for um in (5, 15, 30)]],
                 [[name, *[cell(name, um) for um in (5, 15, 30)]] for name in LIMITED])


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


PUBLISHED = [("2.07", ["levant-explicit", "levant-implicit"]), ("1.93", ["foaw-end", "foaw-best"]), ("1.33", ["kalman-2", "kalman-3"])]


@block
def comparison_published():
    base = float(of("paper-1um", "first-order at 50 Hz")["stiffness_peak_mean_n_per_m"])
    def here(names):
        ratios = [float(of("paper-1um", n)["stiffness_peak_mean_n_per_m"]) / base for n in names]
        return ", ".join(f"{ratio:.1f} {name}" for ratio, name in zip(ratios, names, strict=True))
    return table(["peak K over that of the filter of 50 Hz", "Levant", "windowing", "Kalman"],
                 [["published", *[value for value, _ in PUBLISHED]],
                  ["each tuned, no filter behind it", *[here(names) for _, names in PUBLISHED]]])


@block
def made_by(*patterns):
    """Stored tables with command and commit."""
    found = [r for r in rows("made.csv") if any(r["file"].startswith(p) for p in patterns)]
    return table(["table", "command", "at commit"],
                 [[f"[{r['file']}](data/{r['file']})", f"`{r['command']}`", r["commit"]] for r in found])


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
    names = ["difference", "central-difference", "taylor-2", "taylor-3", "least-squares-1", "least-squares-2", "first-order",
             "butterworth", "foaw-end", "foaw-best", "kalman-2", "kalman-3", "levant-explicit", "levant-implicit"]
    stated = {
        "difference": "0", "central-difference": "0", "taylor-2": "0.6, against exact weights", "taylor-3": "the same",
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


def levant(after, n):
    """A number that the invariants hold the page's errors to, for a lambda_ratio up to 1.5 or above."""
    pair = constant("tests/invariants/src/stated.rs", after + r" \{ \[([\d., ]+)\] \}")
    return f"{float(pair.split(', ')[n]):g}"


slots(
    "docs/estimators.md",
    ("| `levant-explicit` | -1/2 | {} max(c, sqrt(c)); {} c at whole counts per sample", *[
        lambda n=n: levant(r"if lambda_ratio <= 1\.5", n) for n in (0, 1)]),
    ("Above 1.5 those of `levant-explicit` are {} max(c, sqrt(c)) and {} c.", *[
        lambda n=n: levant(r"\[2\.5, 2\.0\] \} else", n) for n in (0, 1)]),
    ("finds each delay within {} + {} span samples of it", *[
        lambda n=n: constant("tests/host/estimators_time_stamps.rs", r"let limit = ([\d.]+ \+ [\d.]+) \* f64::from\(span").split(" + ")[n]
        for n in (0, 1)]),
    ("from c = 1e-4 to 0.05 at most {} of that.", lambda: m("host/estimators/levant-implicit/twin_of_stated_below_c_0.2", 2)),
    ("over 2 * 10^6 samples it drifts by {} counts.", lambda: m("host/estimators/kalman_drift_counts", 3)),
)


# Speed against accuracy
FORMS = {"direct-1": "direct 1", "direct-2t": "transposed direct 2", "state-variable": "state-variable", "delta": "delta"}
FORMATS = {
    "i32-feedback": "i32, i64 sums, error feedback (the core)", "i32": "i32, i64 sums", "q15-feedback": "Q15, error feedback",
    "q15": "Q15", "f32": "f32", "f64": "f64", "idsp-dither": "idsp 0.23.1, first-order feedback", "idsp-wide": "idsp, wide state",
    "cmsis-q31": "CMSIS-DSP Q31", "cmsis-32x64": "CMSIS-DSP Q31, 32x64",
}


def filters(**wanted):
    return [r for r in rows("trade-filters-paper-1um.csv") if all(r[k] == v for k, v in wanted.items())]


@block
def trade_filters():
    body, before = [], None
    for one in json.loads((DATA / "trade-paper-1um.json").read_text())["filters"]:
        format_, form, good = one["format"], one["form"], one["would_do_hz"]
        why = "refused" if one["refused_below"] else ", ".join(one["missed_below"])
        body.append([FORMATS[format_] if format_ != before else "", FORMS[form], number(one["cycles"]), number(one["ram_bytes"]),
                     f"{good[0]:g} to {good[1]:g}" if good else "none", why])
        before = format_
    return table(["format", "form", "cycles", "bytes", "would do, Hz", "misses just below"], body)


@block
def trade_at(cutoff_hz, *variants):
    """What some filters get wrong at one cutoff."""
    def cell(r, key, scale=1.0):
        return significant(float(r[key]) * scale, 2) if r[key] else "-"
    body = []
    for variant in variants:
        format_, form = variant.split("/")
        r = filters(format=format_, form=form, cutoff_hz=cutoff_hz)[0]
        if r["refused"]:
            body.append([f"{FORMATS[format_]}, {FORMS[form]}", r["refused"], *[""] * 5])
            continue
        body.append([f"{FORMATS[format_]}, {FORMS[form]}", cell(r, "response_error", 100), cell(r, "cutoff_error", 100),
                     cell(r, "drift_counts"), cell(r, "bias_m_per_s", 1e3), cell(r, "limit_cycle_m_per_s", 1e3),
                     cell(r, "area_change", 100)])
    return table(["filter", "response off by, %", "-3 dB frequency off by, %", "drift in 10^6 samples, counts",
                  "bias at constant speed, mm/s", "left after a stop, mm/s", "area changes by, %"], body)


METHODS = {"exact": "exact", "semi-implicit-euler": "semi-implicit Euler", "rk4": "RK4", "dormand-prince": "Dormand-Prince"}


@block
def trade_plant(name):
    body = []
    for r in sorted(rows(f"trade-plant-{name}.csv"), key=lambda r: (list(METHODS).index(r["method"]) if r["method"] in METHODS else 9,
                                                                  -float(r["setting"] or 0) if "prince" in r["method"] else float(r["setting"] or 0))):
        what = METHODS.get(r["method"], r["method"])
        if r["setting"]:
            value = float(r["setting"])
            what += f", tolerance {power(value, 1)}" if "prince" in r["method"] else f", {value:g} step{'s' if value > 1 else ''} per sample"
        if r["refused"]:
            body.append([what, r["refused"], "", "", ""])
            continue
        change = 100 * float(r["area_change"]) if r["area_change"] else None
        body.append([what, power(float(r["operations_per_s"])) if r["operations_per_s"] else "-",
                     power(float(r["trajectory_error_m"])) if r["trajectory_error_m"] and float(r["trajectory_error_m"]) else "0",
                     f"{r['verdicts_wrong']} of {r['verdicts']}", "-" if change is None else "0" if change == 0 else f"{change:+.1f} %"])
    told = json.loads((DATA / f"trade-{name}.json").read_text())["plant"]
    body.append(["exact, start moved by a quarter of a count", "-", "-", f"{told['verdicts_chaotic']} of {told['verdicts']}",
                 f"{100 * told['area_chaotic']:.1f} %"])
    return table(["method", "operations per simulated s", "trajectory off by, m", "verdicts that differ", "area changes by"], body)


@block
def trade_q15():
    told = json.loads((DATA / "trade-paper-1um.json").read_text())
    full_scale = told["q15_full_scale_m_per_s"]
    w = math.pi * 20.0 / 1e4  # paper's equation (2), not pre-warped
    b0 = w * w / (1 + math.sqrt(2) * w + w * w)
    return table(["Q15 on `paper-1um`", "value"], [
        ["full scale, m/s", significant(full_scale, 3)],
        ["speed of impact without damping, and with it, m/s", ", ".join(significant(impact(b), 2) for b in (0.0, 5.5195))],
        ["LSB of the velocity, um/s", significant(full_scale / 2**15 * 1e6, 2)],
        ["`b0` at 20 Hz, in LSB of 2^-14, the format of its coefficients", significant(b0 * 2**14, 2)],
    ])


def impact(damping):
    """Speed at 0.07 m of the paper's device, pushed with 2.835 N from 0, by small steps."""
    x = v = 0.0
    while x < 0.07:
        v += 1e-6 * (2.835 - damping * v - 11.0626 * (x - 0.0517)) / 0.416
        x += 1e-6 * v
    return v


@block
def extremes_verdicts():
    body = []
    pairs = rows("docs/figures/fixed-point-limits.csv")
    for name, key in [("the core", "differ_fixed"), ("exact, its velocity rounded to the core's LSB", "differ_rounded_velocity")]:
        worst = max(pairs, key=lambda r: int(r[key]) / int(r["walls"]))
        body.append([name, f"{100 * int(worst[key]) / int(worst['walls']):.1f} % ({float(worst['resolution_m']) * 1e6:g} um, "
                     f"{float(worst['cutoff_hz']):g} Hz)", sum(int(r[key]) == 0 for r in pairs)])
    few = sum(int(r["walls"]) - int(r["stable"]) < 6 for r in pairs)
    head = ["arithmetic", f"verdicts that differ from exact arithmetic, of {pairs[0]['walls']} walls, at most",
            f"pairs of resolution and cutoff without any, of {len(pairs)}"]
    return [*table(head, body), "", f"Pairs with fewer than six unstable walls: {few}."]


# Defaults of other systems
PEERS = "peers-paper-1um.csv"
PEER_LIMITS = [("1.5e-05", "15 um"), ("5e-06", "5 um"), ("2e-06", "2 um"), ("1e-06", "1 um"), ("0.0", "felt, 0 dB")]


def peer(loop, estimator, limit):
    return next(r for r in rows(PEERS) if r["loop"] == loop and r["estimator"] == estimator and float(r["limit"]) == float(limit))


def peer_names():
    return list(dict.fromkeys(r["estimator"] for r in rows(PEERS)))


def peer_area(r):
    cut = "> " if int(r["capped_walks"]) else ""
    return cut + number(float(f"{float(r['area_n2_s_per_m2']) * 1e-6:.3g}"))


@block
def peers(loop):
    def cell(name, limit):
        r = peer(loop, name, limit)
        share = 100 * float(r["share_of_true_velocity"])
        return f"{peer_area(r)} ({share:.{0 if share >= 9.95 else 1}f} %)"

    return table(["estimator", *(text for _, text in PEER_LIMITS)],
                 [[f"`{name}`", *(cell(name, limit) for limit, _ in PEER_LIMITS)] for name in peer_names()])


@block
def peers_sources():
    of = {r["estimator"]: r for r in rows(PEERS)}
    return table(["row", "what it does", "where that stands"],
                 [[f"`{name}`", r["does"], r["source"]] for name, r in of.items() if r["source"]])


@block
def readme_peers():
    columns = [(loop, text, limit, name) for loop, text in [("paper-1um", "paper's loop"), ("nucleo-f446re", "board")]
               for limit, name in (PEER_LIMITS[0], PEER_LIMITS[3], PEER_LIMITS[4])]
    return table(["velocity by default", *(f"{text}, {name}" for _, text, _, name in columns)],
                 [[f"`{row_}`", *(peer_area(peer(loop, row_, limit)) for loop, _, limit, _ in columns)] for row_ in peer_names()])


def times(loop, limit, a, b):
    return number(float(f"{float(peer(loop, a, limit)['area_n2_s_per_m2']) / float(peer(loop, b, limit)['area_n2_s_per_m2']):.2g}"))


def percent(loop, limit, a, b):
    return f"{100 * float(peer(loop, a, limit)['area_n2_s_per_m2']) / float(peer(loop, b, limit)['area_n2_s_per_m2']):.0f}"


DIAL_IN = (
    "**Dial in 500 Hz** where nobody has swept the device (the firmware starts with the paper's 1500 Hz). On the paper's "
    "device at a limit of 1 um, its area is {} times that of 1500 Hz in the paper's loop and {} times on the board; at 15 um "
    "it is {} % and at most {} %.",
    *[lambda loop=loop: times(loop, "1e-06", "butterworth-500", "butterworth-1500") for loop in ("paper-1um", "nucleo-f446re")],
    *[lambda loop=loop: percent(loop, "1.5e-05", "butterworth-500", "butterworth-1500") for loop in ("paper-1um", "nucleo-f446re")],
)
slots("README.md", DIAL_IN)
slots("docs/comparison.md", DIAL_IN)
DEFAULTS = "tests/host/defaults.rs"


def held_at(which):
    """Latencies, or limits in um, at which the table is held; in the order of the test."""
    columns = re.findall(r"\(\s+([\d.]+),\s+([\d.e-]+),\s+\[[\d., ]+\],\s+\[", (ROOT / DEFAULTS).read_text())
    return [f"{float(value) * (1, 1e6)[which]:g}" for value in dict.fromkeys(column[which] for column in columns)]


slots(
    "docs/comparison.md",
    ("holds {} of these rows against an independent program, at latencies of {} and {} samples and limits of {} and {} um:",
     lambda: constant(DEFAULTS, r"const NAMES: \[&str; (\d+)\]"), *[
         lambda n=n, which=which: held_at(which)[n] for which in (0, 1) for n in (0, 1)]),
    ("areas above 10^6 agree to {} %,", lambda: f'{100 * float(constant(DEFAULTS, r"theirs > 1.0 && off.abs.. > ([0-9.]+)")):g}'),
)


# What is said in words
def measure(estimator, key, scene="paper-1um"):
    return float(of(scene, estimator)[key])


def area_at(um, estimator):
    return float(row(at_limit(um), estimator=estimator)["area_n2_s_per_m2"])


def ranking(um):
    return sorted(LIMITED, key=lambda name: -area_at(um, name))


def peer_over(a, b, limit):
    return float(peer("paper-1um", a, limit)["area_n2_s_per_m2"]) / float(peer("paper-1um", b, limit)["area_n2_s_per_m2"])


def fusion_is_best():
    share = "impedance_error_of_estimator"
    others = ["butterworth", "kalman-3", "levant-explicit"]
    return (measure("fusion", "area_n2_s_per_m2") > 0.98 * max(measure(name, "area_n2_s_per_m2") for name in others)
            and measure("fusion", "noise_in_motion_m_per_s") < min(measure(name, "noise_in_motion_m_per_s") for name in others)
            and measure("fusion", share) < min(float(r[share]) for r in rows("compare-paper-1um.csv") if r[share]))


def far_below_a_count():
    """Of the stiff plant: (error of the trajectory, change of the area)."""
    of_integrators = [r for r in rows("trade-plant-paper-1um-stiff.csv") if r["method"] != "exact"]
    pairs = [(float(r["trajectory_error_m"]), abs(float(r["area_change"]))) for r in of_integrators]
    far_below = max(change for error, change in pairs if error < 1e-8)
    some = [change for error, change in pairs if 1e-7 < error < 1e-5]
    return far_below > 0.8 * min(some) and max(some) < 1.5 * far_below and max(c for _, c in pairs) > 2 * max(some)


def own_mass_over_fusion():
    tried = [float(r["area_n2_s_per_m2"]) for r in rows("compare-paper-1um-tuning.csv")
             if r["estimator"] == "observer told in time" and abs(float(r["second"] or 0) / 0.416 - 1) < 1e-3]
    return max(tried) / measure("fusion", "area_n2_s_per_m2")


states(
    "docs/comparison.md",
    ("With the device's own mass it is hardly better than `fusion`", lambda: 1 < own_mass_over_fusion() < 1.05),
    ("| an accelerometer | `fusion` | as much area, less noise, the smallest share of the impedance error |", fusion_is_best),
    ("have one of the largest areas of all that a hand can use, no delay, little noise and roughness, and the smallest share "
     "of the impedance error.", fusion_is_best),
    ("Another limit turns the ranking over", lambda: all((peer_over("moteus-exact", "butterworth-500", limit) > 1) == (limit == "1.5e-05") for limit in ("1.5e-05", "1e-06"))),
    ("Which of the two is first depends on the limit, and so does the order of the low-passes.",
     lambda: all(len({tuple(name for name in ranking(um) if name in pair) for um in (5, 15, 30)}) > 1
                 for pair in (("kalman-3", "levant-explicit"), ("butterworth", "first-order")))),
    ("At each of these limits `kalman-3` and Levant's explicit form are ahead of both low-passes.",
     lambda: all(set(ranking(um)[:2]) == {"kalman-3", "levant-explicit"} for um in (5, 15, 30))),
    ("Their area is below Butterworth's, at the shortest span.",
     lambda: area_at(15, "time-stamps") < area_at(15, "butterworth") and measure("time-stamps", "tuning") == 1),
)
states("docs/trade.md", ("errors of the trajectory far below a count move it as much as errors of some counts do, tens of counts more.",
                         far_below_a_count))


# Who pushes, what counts
def limit_rows(file, **wanted):
    return [r for r in rows(file) if all(r[key] == value for key, value in wanted.items())]


def limit_name(r):
    return f"{float(r['limit']) * 1e6:g} um" if r["limit_unit"] == "m" else f"felt, {float(r['limit']):g} dB"


def limit_area(r):
    cut = "> " if int(r["capped_walks"]) else ""
    star = "*" if r["cutoff_hz"] and r["cutoff_hz"] == r["ideal_cutoff_hz"] else ""
    millions = float(r["area_n2_s_per_m2"]) * 1e-6
    return f"{cut}{number(float(f'{millions:.3g}'))}{star}"


@block
def criteria_limits():
    file = "limits-paper-1um.csv"
    shown = ["50", "100", "200", "500", "1000", "1500", "2000", "3000", "4000"]
    wanted = [("1.5e-05", "motor"), ("1.5e-05", "hand"), ("5e-06", "motor"), ("1e-06", "motor"), ("1e-06", "hand"),
              ("20", "motor"), ("10", "motor"), ("0", "motor")]
    body = []
    for limit, push in wanted:
        found = [r for r in limit_rows(file, push=push, estimator="scene") if float(r["limit"]) == float(limit)]
        cells = [limit_area(next(r for r in found if float(r["cutoff_hz"]) == float(hz))) for hz in shown]
        low, high = (f"{float(found[0][f'ideal_{end}_hz']):g}" for end in ("low", "high"))
        body.append([f"{limit_name(found[0])}, {push}", *cells, low if low == high else f"{low} to {high}"])
    return table(["limit, push", *shown, "ideal range, Hz"], body)


@block
def criteria_levers(limit, push):
    """Area at the ideal cutoff, and that cutoff, by loop and what is between."""
    file, body = "levers-paper-1um.csv", []
    found = [r for r in limit_rows(file, push=push) if abs(float(r["limit"]) / float(limit) - 1) < 1e-9]
    for of_loop, period in dict.fromkeys((r["loop"], r["output_period_samples"]) for r in found):
        in_row = [r for r in found if (r["loop"], r["output_period_samples"]) == (of_loop, period)]
        cells = []
        for between in ("as-is", "amplifier", "amplifier-and-mode"):
            of_it = [r for r in in_row if r["between"] == between and r["estimator"] == "scene"]
            best = next(r for r in of_it if r["cutoff_hz"] == r["ideal_cutoff_hz"])
            cells.append(f"{plain_area(best)} ({float(best['cutoff_hz']):g} Hz)")
        told = next(r for r in in_row if r["estimator"] == "true-velocity")
        body.append([of_loop, period, *cells, plain_area(told)])
    return table(["loop", "samples an output", "as it is", "amplifier of 1 kHz", "and a transmission of 150 Hz",
                  "true velocity"], body)


@block
def readme_levers():
    found = [r for r in limit_rows("levers-paper-1um.csv", push="motor", estimator="scene", limit_unit="m")
             if float(r["limit"]) == 1e-6 and r["cutoff_hz"] == r["ideal_cutoff_hz"] and r["loop"] != "discovery-f407"]
    def area(of_loop, period, between):
        return plain_area(next(r for r in found if (r["loop"], r["output_period_samples"], r["between"]) == (of_loop, period, between)))
    loops = dict.fromkeys((r["loop"], r["output_period_samples"]) for r in found)
    return table(["loop", "samples an output", "as it is", "amplifier of 1 kHz, transmission of 150 Hz"],
                 [["the paper's" if name == "paper-1um" else "NUCLEO-F446RE", period, area(name, period, "as-is"),
                   area(name, period, "amplifier-and-mode")] for name, period in loops])


def plain_area(r):
    cut, millions = "> " if int(r["capped_walks"]) else "", float(r["area_n2_s_per_m2"]) * 1e-6
    return f"{cut}{number(float(f'{millions:.3g}'))}"


@block
def criteria_yardstick():
    file = "limits-paper-1um.csv"
    body = []
    for told in limit_rows(file, push="motor", estimator="true-velocity"):
        own = [r for r in limit_rows(file, push="motor", estimator="scene", limit=told["limit"], limit_unit=told["limit_unit"])
               if r["cutoff_hz"] == r["ideal_cutoff_hz"]]
        share = 100 * float(own[0]["share_of_true_velocity"])
        body.append([limit_name(told), limit_area(own[0]).rstrip("*"), limit_area(told), f"{share:.0f} %"])
    return table(["limit, motor", "ideal cutoff", "true velocity", "share"], body)


def three(key):
    return number(float(f"{float(measured(f'host/criteria/{key}')):.3g}"))


def ends(key):
    low, high = three(f"{key}/low"), three(f"{key}/high")
    return low if low == high else f"{low} to {high}"


@block
def criteria_saturation():
    rows_ = [("10", "motor"), ("20", "motor"), ("100", "motor"), ("5.2", "hand"), ("10", "hand"), ("100", "hand")]
    return table(["limit of the command, who pushes", "four starts", "twin in `f64`", "independent program"],
                 [[f"{limit} V, {who}", ends(f"saturation/{limit}/{who}"), three(f"saturation/{limit}/{who}/twin"),
                   three(f"saturation/{limit}/{who}/independent")] for limit, who in rows_])


@block
def criteria_by_hand():
    body = []
    for name in ("butterworth", "kalman-3", "levant-explicit"):
        motor = f(of("paper-1um", name), "area_n2_s_per_m2", 1e-6, 1)
        body.append([f"`{name}`, {tuned(of('paper-1um', name))}", motor, ends(f"by_hand/{name}"), three(f"by_hand/{name}/twin"),
                     three(f"by_hand/{name}/independent")])
    return table(["estimator", "motor", "hand, four starts", "twin in `f64`", "independent program"], body)


@block
def criteria_felt():
    body = {}
    for encoder in ("1um", "2um"):
        for r in limit_rows(f"felt-paper-{encoder}.csv", estimator="scene"):
            if r["cutoff_hz"] != r["ideal_cutoff_hz"]:
                continue
            who = "the worst of all" if r["push"] == "worst" else f"{r['arm'] or 'free'}, {r['push']}"
            key = (f"{encoder[0]} um", who)
            body.setdefault(key, {})[float(r["limit"])] = f"{limit_area(r).rstrip('*')} at {float(r['cutoff_hz']):g}"
    return table(["encoder", "arm, push", "12 dB more sensitive", "the model", "12 dB less sensitive"],
                 [[*key, *(cells[level] for level in (-12.0, 0.0, 12.0))] for key, cells in body.items()])


@block
def criteria_felt_design():
    found = rows("felt-design-paper-1um-0.csv")
    names = list(dict.fromkeys(r["condition"] for r in found))
    def of(condition, name):
        return design_area(row("felt-design-paper-1um-0.csv", condition=condition, filter=name))
    return table(["who pushes, arm", "Butterworth's best", "designed"],
                 [[name.replace(" pushes", "").split(", felt")[0], of(name, "butterworth"), of(name, "1")] for name in names])


@block
def criteria_second():
    body = [[limit, *(m(f"host/criteria/levers/{key}/{which}", 0) for which in ("cells", "within")),
             f"{float(m(f'host/criteria/levers/{key}/worst_percent')):.1f} %"] for limit, key in [("1 um", "1um"), ("15 um", "15um")]]
    return table(["limit, motor", "loops", "within 3 %", "farthest off"], body)


@block
def criteria_resolution():
    body = []
    for text, level in [("12 dB less sensitive", 12), ("the model", 0), ("12 dB more sensitive", -12)]:
        cells = []
        for name in ("paper", "board"):
            um, hz, b = (float(measured(f"host/criteria/felt/{name}/{level}/{key}")) for key in ("um", "cutoff_hz", "damping"))
            cells.append(f"{significant(um, 2)} um ({hz:g} Hz, {b:g} N s/m)")
        body.append([text, *cells])
    return table(["who feels", "the paper's loop", "with the NUCLEO-F446RE's latency"], body)


@block
def criteria_held():
    told = [("RMS 5, 2, 1, 0.5 um, both encoders, nine cutoffs", "table_of_limits", "limits"),
            ("felt 0, 10, 20 dB, both encoders, eight cutoffs", "table_of_levels", "levels"),
            ("true velocity", "yardstick", "yardstick")]
    body = []
    for text, test, key in told:
        cells = m(f"host/criteria/{key}/cells")
        # of the yardstick every cell has to be
        within = cells if key == "yardstick" else m(f"host/criteria/{key}/within")
        body.append([f"{text} (`criteria::tables::{test}`)", cells, within])
    return table(["table", "cells above 10^6", "theirs within 3 % of the range of ours"], body)


@block
def criteria_beyond():
    body = [[cell, *[three(f"limits/{key}/{which}") for which in ("independent", "fixed_low", "fixed_high", "twin_low", "twin_high")]]
            for cell, key in [("2 um, 1500 Hz, below 5 um", "5um"), ("2 um, 500 Hz, below 1 um", "1um")]]
    return table(["cell, 10^6", "independent program", "ours, lowest", "highest", "our twin in `f64`, lowest", "highest"], body)


def kept(limit, unit):
    found = limit_rows("limits-paper-1um.csv", push="motor", estimator="scene", limit_unit=unit)
    found = [r for r in found if float(r["limit"]) == limit]
    best = max(float(r["area_n2_s_per_m2"]) for r in found)
    at = next(float(r["area_n2_s_per_m2"]) for r in found if float(r["cutoff_hz"]) == 1500)
    return f"{100 * at / best:.0f}"


slots(
    "docs/criteria.md",
    ("where 1500 Hz keeps {} %, or {} %, of the best area.", lambda: kept(1e-6, "m"), lambda: kept(0.0, "dB")),
    ("At 15 um the area depends on the grid: {} with K from 1000 by 1000", lambda: three("yardstick/paper-1um")),
    ("1 % in the cutoff is {} % in the area there.", lambda: m("host/criteria/limits/percent_per_percent", 0)),
)


def limit_best(limit, unit, push):
    """Area at the ideal cutoff, that cutoff, and its range."""
    r = next(r for r in limit_rows("limits-paper-1um.csv", push=push, estimator="scene", limit_unit=unit)
             if float(r["limit"]) == limit and r["cutoff_hz"] == r["ideal_cutoff_hz"])
    return [float(r[key]) for key in ("area_n2_s_per_m2", "ideal_cutoff_hz", "ideal_low_hz", "ideal_high_hz")]


QUIET = [(5e-6, "m"), (2e-6, "m"), (1e-6, "m"), (5e-7, "m"), (20.0, "dB"), (10.0, "dB"), (0.0, "dB")]


def pushes_alike():
    pairs = [[limit_best(*limit, push) for push in ("motor", "hand")] for limit in QUIET]
    return all(a[1] == b[1] and abs(a[0] / b[0] - 1) < 0.02 for a, b in pairs)


def kept_of_last_rows(limit):
    """Of the loops with an output every sample: least and most part of the area that is left with amplifier, and with transmission."""
    found = [r for r in limit_rows("levers-paper-1um.csv", push="motor", estimator="scene", output_period_samples="1")
             if abs(float(r["limit"]) / limit - 1) < 1e-9 and r["cutoff_hz"] == r["ideal_cutoff_hz"]]
    area = {(r["loop"], r["between"]): float(r["area_n2_s_per_m2"]) for r in found}
    parts = [a / area[loop, "as-is"] for (loop, between), a in area.items() if between != "as-is"]
    return min(parts), max(parts)


def felt_best(encoder):
    return {(r["arm"], r["push"], float(r["limit"])): r for r in rows(f"felt-paper-{encoder}.csv")
            if r["estimator"] == "scene" and r["cutoff_hz"] == r["ideal_cutoff_hz"]}


def within_a_step(encoder):
    """Of the ideal cutoffs, in the list of those that were tried."""
    found = felt_best(encoder)
    tried = sorted({float(r["cutoff_hz"]) for r in rows(f"felt-paper-{encoder}.csv") if r["cutoff_hz"]})
    place = {key: tried.index(float(r["cutoff_hz"])) for key, r in found.items()}
    return all(abs(n - place["", "motor", level]) <= 1 for (_, _, level), n in place.items())


states(
    "docs/criteria.md",
    ("At the paper's limit who pushes decides, and 1200 to 3000 Hz win.", lambda: (
        min(limit_best(15e-6, "m", push)[2] for push in ("motor", "hand")), max(limit_best(15e-6, "m", push)[3] for push in ("motor", "hand"))
    ) == (1200, 3000)),
    ("From 5 um on it no longer matters who pushes,", pushes_alike),
    ("at 1 um, or felt at 0 to 20 dB, the ideal cutoff is 200 to 500 Hz,", lambda: {
        limit_best(*limit, "motor")[1] for limit in QUIET if limit[1] == "dB" or limit[0] == 1e-6} == {200, 500}),
    ("keep a third of the last rows at 1 um, and a half or more at 15 um.", lambda: (
        all(0.3 < part < 0.4 for part in kept_of_last_rows(1e-6)) and 0.48 < kept_of_last_rows(15e-6)[0])),
    ("a filter that leads the velocity ([design](design.md)) undoes a part of the loop's latency and goes beyond it.", lambda: (
        max(float(r["area_n2_s_per_m2"]) for r in rows("design-paper-1um.csv")) > max(
            float(r["area_n2_s_per_m2"]) for r in limit_rows("limits-paper-1um.csv", push="motor", estimator="true-velocity", limit="0.000015")))),
    ("from that of the free handle and the motor's push, arm and hand move it by a step of the list of cutoffs at most.",
     lambda: within_a_step("1um") and within_a_step("2um")),
    ("Who feels more wants a lower cutoff;", lambda: all(
        float(of_[*key, -12.0]["cutoff_hz"]) <= float(of_[*key, 0.0]["cutoff_hz"]) <= float(of_[*key, 12.0]["cutoff_hz"])
        for of_ in map(felt_best, ("1um", "2um")) for key in {key[:2] for key in of_})),
    ("At 1 um the cutoff is the same in every hand; at 15 um it is not.", lambda: [
        len({r["cutoff_hz"] for r in limit_rows("limits-paper-1um-arms.csv", estimator="scene", limit=limit)
             if r["cutoff_hz"] == r["ideal_cutoff_hz"]}) for limit in ("0.000001", "0.000015")][0] == 1),
)
slots(
    "docs/criteria.md",
    ("Such areas depend on the start by up to {} %.", lambda: f"""{max(100 * (float(measured(f'host/criteria/saturation/{v}/hand/high'))
        / float(measured(f'host/criteria/saturation/{v}/hand/low')) - 1) for v in ('5.2', '10')):.0f}"""),
)


@block
def criteria_arms():
    file = "limits-paper-1um-arms.csv"
    body = {}
    for r in limit_rows(file, estimator="scene"):
        if r["cutoff_hz"] == r["ideal_cutoff_hz"] and (r["limit_unit"] == "m" or float(r["limit"]) == 0):
            who = "the worst of all" if r["push"] == "worst" else f"{r['arm'] or 'none'}, {r['push']}"
            cell = f"{limit_area(r).rstrip('*')} at {float(r['cutoff_hz']):g}"
            body.setdefault(who, {})[limit_name(r)] = cell
    names = ["15 um", "1 um", "felt, 0 dB"]
    return table(["arm, push", *names], [[who, *(cells[name] for name in names)] for who, cells in body.items()])


# A designed filter
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
