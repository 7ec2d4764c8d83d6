"""README, first results, device, theory of the loop, first power-up: what the simulator says in seconds."""

import functools
import math
import tempfile
from pathlib import Path

from . import block, slots, states
from .source import ROOT, programs, shell, changed_scene, constant, lit, number, row, rows, significant, sim, table, m, measured


def hz_range(low_high):
    return "{:g} to {:g}".format(*low_high)


def study(name):
    """The default sweep of one of the paper's scenes."""
    return next(s for s in sim("sweep")["scenes"] if s["scene"] == name)


def area(result, cutoff_hz):
    return next(c["area_n2_s_per_m2"] for c in result["cutoffs"] if c["cutoff_hz"] == cutoff_hz)


def ideal(arguments, scene=None):
    """Ideal range of a sweep, with what it says of the last cutoff."""
    result = sim(f"sweep {arguments}", scene)["scenes"][0]
    return result["ideal_cutoff_range_hz"], result["cutoffs"][-1]["cutoff_hz"]


@block
def readme_study():
    body = []
    for name, encoder in [("paper-1um", "1 um"), ("paper-2um", "2 um")]:
        result = study(name)
        best = result["ideal_cutoff_hz"]
        share = {c: area(result, c) / area(result, best) - 1 for c in (2500.0, 3000.0, 4000.0)}
        changes = ", ".join(f"{100 * share[c]:+.1f} % at {c:g} Hz" for c in share)
        body.append([encoder, f"{hz_range(result['ideal_cutoff_range_hz'])} Hz", f"{best:g} Hz", changes])
    return table(["encoder", "ideal cutoff range", "ideal cutoff", "area beyond it, against that at the ideal cutoff"], body)


FINE = dict(stiffness_step_n_per_m=500, damping_step_n_s_per_m=5, rms_limit_m="1e-6")


def by_hand(name):
    """The scene with the key that lets a hand push."""
    return changed_scene(name).replace("[wall_hit]\n", '[wall_hit]\npush_by = "hand"\n')


@block
def device_choices():
    """Each cell a sweep of its own, or a variant of `--sensitivity`."""
    devices = ["paper-1um", "paper-2um"]
    variants = [sim(f"sweep {name} --sensitivity")["scenes"][0] for name in devices]

    def cell(low_high, last):
        text = "{:g}".format(low_high[0]) if low_high[0] == low_high[1] else hz_range(low_high)
        return text + (" (the highest that was tried)" if low_high[1] == last else "")

    def variant(name):
        found = [next(v for v in all_["sensitivity"] if v["name"] == name) for all_ in variants]
        return [cell(v["ideal_cutoff_range_hz"], 4000.0) for v in found]

    def own(arguments, scene):
        return [cell(*ideal(f"SCENE.toml {arguments}", scene(name))) for name in devices]

    return table(
        ["choice", "1 um encoder", "2 um encoder"],
        [
            ["as the paper: RMS limit 15 um, latency 10 samples, push by the motor, wall that never pulls",
             *[cell(v["ideal_cutoff_range_hz"], 4000.0) for v in variants]],
            ["RMS limit 30 um", *variant("rms_limit_double")],
            ["RMS limit 5 um", *variant("rms_limit_third")],
            ["RMS limit 1 um, steps of 500 N/m and 5 N s/m, `--cutoffs 100:100:1000`", *own("--cutoffs 100:100:1000", lambda name: changed_scene(name, **FINE))],
            ["a hand pushes, with a constant force of the same 2.835 N", *own("", by_hand)],
            ["latency 5 samples", *variant("latency_half")],
            ["latency 20 samples", *variant("latency_double")],
            ["an output every 5 samples", *variant("output_rate_double")],
            ["the wall may pull", *variant("push_only_flipped")],
            ["slower impact (start at 35 mm)", *variant("slower_impact")],
        ],
    )


def one_um():
    return [ideal("SCENE.toml --cutoffs 100:100:1000", changed_scene(name, **FINE))[0] for name in ("paper-1um", "paper-2um")]


def with_hand(name):
    return sim("sweep SCENE.toml", by_hand(name))["scenes"][0]


slots(
    "README.md",
    ("At a limit of 1 um the ideal range falls to {} Hz and {} Hz; when a hand pushes, it begins at {} and {} Hz:",
     lambda: hz_range(one_um()[0]), lambda: hz_range(one_um()[1]),
     lambda: f"{with_hand('paper-1um')['ideal_cutoff_range_hz'][0]:g}",
     lambda: f"{with_hand('paper-2um')['ideal_cutoff_range_hz'][0]:g}"),
)

slots(
    "docs/start.md",
    ("Nominal 2000 Hz at 10 kHz is -3 dB at {} Hz.", lambda: number(study("paper-1um")["ideal_true_cutoff_hz"], 1)),
)

PAPERS = ("paper-1um", "paper-2um")
states("docs/start.md", ("More repeats, `--repeat 16`, tell more cutoffs apart; here both ranges stay as they are.", lambda: all(
    ideal(f"{name} --plain --repeat 16")[0] == study(name)["ideal_cutoff_range_hz"] for name in PAPERS)))

slots(
    "docs/device.md",
    ("With the hand's push the largest areas are {} and {} times as large", *[
        lambda name=name: significant(
            max(c["area_n2_s_per_m2"] for c in with_hand(name)["cutoffs"])
            / max(c["area_n2_s_per_m2"] for c in study(name)["cutoffs"]), 2)
        for name in ("paper-1um", "paper-2um")]),
)


# The loop against the linear one
def linear(arguments):
    return {r["damping_n_s_per_m"]: r for r in sim(f"linear {arguments}")["rows"]}


@block
def theory_boundaries():
    lines = linear("paper-1um --cutoffs 1500 --dampings 0:50:600 --multirate")
    walked = [
        {p["damping_n_s_per_m"]: p["stiffness_n_per_m"] for p in
         sim(f"linear {name} --cutoffs 1500 --dampings 0:50:600 --multirate --simulated")["simulated"]}
        for name in ("paper-1um", "paper-2um")
    ]
    return table(
        ["B, N s/m", "linear, as it runs, N/m", "simulated, 1 um, N/m", "2 um, N/m"],
        [[f"{b}", number(lines[b]["stiffness_max_n_per_m"], 0), *[number(w[b], 0) for w in walked]]
         for b in (50, 100, 200, 300, 400, 600)],
    )


@block
def theory_passive():
    by_k = linear("paper-1um --cutoffs 500 --dampings 0:0.05:400 --multirate --passivity")
    rows_ = list(by_k.values())
    passive, stable = (max(r[key] for r in rows_) for key in ("stiffness_passive_n_per_m", "stiffness_max_n_per_m"))
    widest = [max(r["damping_n_s_per_m"] for r in rows_ if r[key] > 0)
              for key in ("stiffness_passive_n_per_m", "stiffness_max_n_per_m")]
    return table(
        ["the paper's device at 500 Hz, as it runs", "passive", "linearly stable", "ratio"],
        [
            ["K at B = 0, N/m", *[number(by_k[0.0][k], 0) for k in ("stiffness_passive_n_per_m", "stiffness_max_n_per_m")], ""],
            ["largest K, kN/m", significant(passive / 1e3, 3), significant(stable / 1e3, 3), significant(stable / passive, 3)],
            ["largest B, N s/m (steps of 0.05)", significant(widest[0], 3), significant(widest[1], 3),
             significant(widest[1] / widest[0], 2)],
        ],
    )


@block
def amplifier_walls():
    """First power-up: two walls on the edge of the NUCLEO's envelope."""
    bandwidths = [None, 5000, 3000, 2000, 1000]
    text = changed_scene("nucleo-f446re")
    body = []
    for k, b in [(117_000, 60), (27_000, 10)]:
        hits = [
            sim(f"hit SCENE.toml --cutoff 1500 --stiffness {k} --damping {b}",
                text + (f"\n[amplifier]\nbandwidth_hz = {f}\n" if f else ""))["rms_m"]
            for f in bandwidths
        ]
        body.append([f"K {number(k)} N/m, B {b} N s/m", *[significant(hit * 1e6, 2 if hit < 1e-4 else 3) for hit in hits]])
    head = ["wall", *["no amplifier" if f is None else f"{f // 1000} kHz" for f in bandwidths]]
    return table(head, body, right=range(1, 6))


# What tests measure
BOUNDS = "tests/host/filter.rs"


@block
def theory_filter():
    lsb = ", ".join(f"{c} {m(f'host/filter/{c}_lsb', 2)}" for c in ("b0", "b1", "b2", "a1", "a2"))
    return table(
        ["property", "measured by `tests/host/filter.rs`"],
        [
            ["coefficients against SciPy, 1, 10 and 50 kHz", f"{lsb} LSB of 2^-30"],
            ["DC gain", "exactly 1"],
            ["-3 dB frequency after quantisation", f"within {m('host/filter/cutoff_error', 2, 100)} % of the asked one, worst at the lowest cutoff"],
            ["measured frequency response", f"within {m('host/filter/response_error', 4)} of theory"],
            ["constant speed", f"sum(out - in) spans {m('host/filter/drift_counts', 2)} counts over 10^6 samples, which is the ripple of the counts"],
            ["after a stop", f"{m('host/filter/rest_lsb')} LSB left after 20/fc"],
        ],
    )


@block
def theory_shaping():
    body = []
    for part in ("4e-5", "0.001", "0.01", "0.05", "0.1", "0.4"):
        key = "0.00004" if part == "4e-5" else part
        first, second = (significant(float(measured(f"host/filter/shaping/{key}/{order}")), 2) for order in ("first", "second"))
        body.append([f"{float(part) * 1e4:g} Hz", first, second])
    return table(["cutoff at 10 kHz", "first order, LSB RMS", "second order, LSB RMS"], body)


@block
def theory_peers():
    def peers(key, digits=0):
        return [m(f"host/peers/{key}/{who}", digits) for who in ("here", "idsp", "idsp_wide")]

    lowest = [value if value != "0" else "saturates" for value in peers("lowest")]
    drift = peers("drift", 3)[:1] + peers("drift", 1)[1:]
    return table(
        ["", "here", "idsp, first-order feedback", "idsp, wide state"],
        [
            ["step to full scale, lowest output, LSB", lowest[0], *[f"wraps to {value}" for value in lowest[1:]]],
            ["largest rest 20/fc after a stop, 0.35 to 2 Hz, LSB", *peers("rest")],
            ["sum(out - in) after 8 * 10^6 samples at 1 Hz, counts", drift[0], f"{drift[1]} (bounded by 39)", f"{drift[2]}, growing"],
            ["instructions on Cortex-M4", *[m(f"elf/control_path/{name}") for name in
             ("zwidth_filter", "idsp_dither", "idsp_wide")]],
        ],
    )


@block
def theory_instructions():
    return table(
        ["part", "instructions"],
        [["filter", m("elf/control_path/zwidth_filter")],
         ["a sample, encoder included, without a loop", m("elf/control_path/zwidth_sample")],
         ["an output", m("elf/control_path/zwidth_render")]],
    )


@block
def theory_fixed_point():
    walks, points = m("host/paper/walks_up_to_200_hz"), m("host/paper/points_that_differ")
    return table(
        ["", "measured"],
        [
            ["mean relative error of the area", f"{m('host/paper/area_error', 2, 100)} %"],
            ["boundary points more than one step of K off the exact twin",
             f"core {m('host/paper/share_off_fixed', 1, 100)} %, twin with its velocity rounded to the LSB {m('host/paper/share_off_rounded', 1, 100)} %"],
            [f"points that differ in the {walks} walks of 50, 100 and 200 Hz", f"{points}, at 200 Hz"],
        ],
    )


@block
def theory_oscillation():
    text = constant("tests/host/closed_loop.rs", r"\[\(1e4, ([\d_.]+)\), \(1e3, [\d_.]+\)\]")
    slow = constant("tests/host/closed_loop.rs", r"\[\(1e4, [\d_.]+\), \(1e3, ([\d_.]+)\)\]")
    body = []
    for case, rate, known in [("oscillation starts, 10 kHz, B = 0, no latency", "10000", text), ("the same at 1 kHz", "1000", slow)]:
        known = float(known.replace("_", ""))
        cells = [[float(measured(f"host/closed_loop/{rate}/{kind}_{end}")) for end in ("below", "above")] for kind in ("Fixed", "F64")]
        body.append([case, number(known, 1), *[" to ".join(number(k, 1) for k in found) for found in cells]])
    return table(["case", "known K, N/m", "loop with the core, between", "loop with the twin, between"], body)


slots(
    "docs/theory.md",
    ("Unfiltered, one count more is full scale force at B = {} N s/m (1 um), or at B = {} N s/m (2 um)",
     lambda: number(5.906 / 1e-2, 0), lambda: number(5.906 / 2e-2, 0)),
    ("nominal 2000 Hz at 10 kHz is -3 dB at {} Hz.", lambda: number(study("paper-1um")["ideal_true_cutoff_hz"], 1)),
    ("10 nm; cutoffs, B and latencies) | within {} % at {} points |", lambda: m("host/small_signal/worst", 3, 100), lambda: m("host/small_signal/points")),
    ("linear envelope with amplifier, mode and arm | within {} % at {} points |",
     lambda: number(lit("tests/host/linear_elements.rs", r"ASIDE: f64 = ([\d.]+);") * 100),
     lambda: m("host/linear_elements/points")),
    ("energy norm, {} chains of 3 to 7 states, time constants from 1 ns | {} of max(1, norm(A) T); {} at most |",
     *[lambda key=key: measured(f"sim_loop/augmented/{key}") for key in ("chains", "step_of_size", "step")]),
    ("share of the largest value | {} |", lambda: measured("sim_loop/augmented/trajectory")),
    ("order on the linear plant: Euler, RK4, Dormand-Prince | {} to {}, {} to {}, {} to {} |",
     *[lambda key=f"{method}_{end}", digits=digits: m(f"sim_loop/order/{key}", digits)
       for method, digits in (("euler", 4), ("rk4", 2), ("dormand_prince", 2)) for end in ("least", "most")]),
    ("damped stops: Euler, RK4 | {}, {} |", lambda: m("sim_loop/order/run_1", 3), lambda: m("sim_loop/order/run_4", 2)),
    ("of its energy bound | {} or more undamped, never above |", lambda: m("sim_loop/stop/least", 5)),
    ("In {} random loops with elements, eigenvalues agree with all {} crossings.",
     *[lambda key=key: measured(f"sim_studies/crossings/{key}") for key in ("loops", "found")]),
    ("The design takes the quieter one, to {} %:", lambda: number(math.ceil(100 * float(measured("host/filter/shaping/noisier"))))),
)


def beside_linear(name):
    """At 1500 Hz: steps of K from the linear boundary down to the simulated one, up to B = 200, and the first B and the last one
    at which it is beyond."""
    points = sim(f"linear {name} --cutoffs 1500 --dampings 0 --multirate --simulated")["simulated"]
    below = max(p["linear_n_per_m"] // 2000 - p["stiffness_n_per_m"] // 2000 for p in points if p["damping_n_s_per_m"] <= 200)
    return below, min(p["damping_n_s_per_m"] for p in points if p["linearly_unstable"]), max(
        p["damping_n_s_per_m"] for p in points if not p["linearly_unstable"])


states(
    "docs/theory.md",
    ("less up to three of the grid's steps of 2000 N/m.", lambda: max(beside_linear(name)[0] for name in PAPERS) == 3),
    ("Beyond about 230 its walls are linearly unstable", lambda: all(200 < b <= 240 for name in PAPERS for b in beside_linear(name)[1:])),
)


EDGE = "hit paper-2um --cutoff 1500 --stiffness 24000 --damping 620"
slots(
    "docs/theory.md",
    (f"`cargo sim {EDGE}` is {{}}, with `--start-offset 0.001`, a thousandth of a count, {{}}.", lambda: sim(EDGE)["verdict"],
     lambda: sim(f"{EDGE} --start-offset 0.001")["verdict"]),
)
slots(
    "docs/device.md",
    *[(text, lambda: 1 + len(sim("sweep paper-2um --sensitivity")["scenes"][0]["sensitivity"]))
      for text in ("what is uncertain; takes {} times as long |", "It makes {} studies instead of one.")],
)
slots(
    "docs/scenes.md",
    ("(half of it, {} times the area at 2 um)", lambda: significant(
        next(v for v in sim("sweep paper-2um --sensitivity")["scenes"][0]["sensitivity"] if v["name"] == "latency_half")
        ["area_at_ideal_n2_s_per_m2"] / max(c["area_n2_s_per_m2"] for c in study("paper-2um")["cutoffs"]), 2)),
    ("resolution {} um, gain {} N/V.", lambda: significant(2 * math.pi * 0.07 / (13 * 4096) * 1e6, 2),
     lambda: significant(13 * 0.02 * 0.5 / 0.07, 3)),
)


@block
def stored(file):
    """A stored table as it stands."""
    return table(list(rows(file)[0]), [r.values() for r in rows(file)])


def chatters_below():
    """A wall that is stable above others that are not, all of them on the walk's grid."""
    wall = "paper-2um --cutoffs 4000 --dampings 390 --stiffnesses"
    soft = sim(f"grid {wall} 2000:2000:40000")
    return sim(f"grid {wall} 52000")["stable"] == 1 and soft["unstable"] == soft["points"] == 20


states("docs/files.md", ("K = 52,000 N/m is stable, everything from 2000 to 40,000 is not", chatters_below))


# Columns of the files
@functools.cache
def heads():
    """First lines of the CSV files, by name."""
    commands = [
        "sweep paper-2um --sensitivity --cutoffs 1500 --repeat 2 --out sweep",
        "hit paper-1um --cutoff 1500 --stiffness 20000 --damping 100 --trace trace.csv",
        "walk paper-1um --cutoff 100 --csv walk.csv",
        "grid paper-1um --cutoffs 1500 --stiffnesses 2000 --dampings 10 --csv grid.csv",
        "linear paper-1um --cutoffs 1500 --dampings 100 --multirate --csv linear.csv",
        "identify log.csv --gain 0.59 --csv identify.csv",
    ]
    with tempfile.TemporaryDirectory() as folder:
        log = f"python3 {ROOT}/.ci/figures/log.py > log.csv"
        for command in [log, *[f"{programs()}/host-sim {c}" for c in commands]]:
            ran = shell(command, folder)
            if ran.returncode:
                raise SystemExit(f"error: {command}: {ran.stderr}")
        return {str(f.relative_to(folder)): f.read_text().split("\n")[0] for f in Path(folder).rglob("*.csv")}


def head(name):
    return lambda: heads()[name] if name in heads() else ",".join(rows(name)[0])


slots(
    "docs/files.md",
    ("one row per sample: `{}`.", head("trace.csv")),
    ("(caps that were reached). `--csv FILE` writes `{}`.", head("walk.csv")),
    ("`--csv FILE` writes `{}`, K running fastest", head("grid.csv")),
    ("| `areas.csv` | `{}`; its", head("sweep/areas.csv")),
    ("every point of every walk: `{}` |", head("sweep/boundary.csv")),
    ("for the firmware, see below: `{}` |", head("sweep/envelope.csv")),
    ("with `--sensitivity`: `{}` |", head("sweep/sensitivity.csv")),
    ("`--csv FILE` writes `{}` (`inf` if no K is unstable)", head("linear.csv")),
    ("`--csv FILE` writes `{}` of the first log", head("identify.csv")),
    ("| `tuning.csv` | `{}`: every tuning", head("compare-paper-1um-tuning.csv")),
    ("| `fidelity.csv` | `{}`: the impedance", head("compare-paper-1um-fidelity.csv")),
)
