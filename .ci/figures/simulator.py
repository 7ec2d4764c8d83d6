"""README, first results, device, theory of the loop, first power-up, passivity: what the simulator says in seconds."""

import math
import re

from . import block
from .source import changed_scene, constant, lit, long, m, measured, number, rows, said, significant, sim, table


def hz_range(low_high):
    return "{:g} to {:g}".format(*low_high)


def study(name):
    """The default sweep of a scene."""
    return sim(f"sweep {name}")["scenes"][0]


def ideal(arguments, scene=None):
    """Ideal range of a sweep, with what it says of the last cutoff."""
    result = sim(f"sweep {arguments}", scene)["scenes"][0]
    return result["ideal_cutoff_range_hz"], result["cutoffs"][-1]["cutoff_hz"]


def dial_in(result):
    """Cells of what a sweep recommends."""
    found = result["recommended"]
    low_high = hz_range(found["range_hz"])
    return [f"**{found['cutoff_hz']:g} Hz**", f"{low_high} Hz", f"{found['stiffness_n_per_m'] / 1e3:g} kN/m"]


def dial_in_with_area(result):
    """These, and the area of the quiet walls, 10^6 N^2 s/m^2."""
    return [*dial_in(result), significant(result["recommended"]["area_n2_s_per_m2"] / 1e6, 3)]


@block
def readme_study():
    body = []
    for name, encoder in [("paper-1um", "the paper's, 1 um"), ("paper-2um", "the paper's, 2 um"),
                          ("nucleo-f446re", "NUCLEO-F446RE, 1 um")]:
        result = study(name)
        own = f"{result['ideal_cutoff_hz']:g} Hz, {hz_range(result['ideal_cutoff_range_hz'])} Hz"
        body.append([encoder, *dial_in(result), own])
    return table(["loop, encoder", "dial in", "as good", "stiffest wall", "by the paper's criterion, its range"], body)


@block
def readme_sweep():
    """What the terminal says at the end."""
    lines = said("sweep paper-2um").splitlines()
    return ["```text", *lines[-6:], "```"]


# As `sweep --levers` puts them between the loop and the handle (host-sim/studies/src/study/levers.rs).
AMPLIFIER = "\n[amplifier]\nbandwidth_hz = 1000\n"


def transmission(scene, share=0.24, hertz=150, ratio=0.03):
    """A handle of that share of the device's mass beside it, that frequency of the two, and damping ratio."""
    mass = float(re.search(r"(?m)^mass_kg = (\S+)", scene)[1])
    reduced, per_s = mass * share / (1 + share), 2 * math.pi * hertz
    return (f"\n[mode]\nmass_kg = {share * mass:.6f}\nstiffness_n_per_m = {reduced * per_s ** 2:.3f}\n"
            f"damping_n_s_per_m = {2 * ratio * reduced * per_s:.5f}\n")


@long("periods-quiet")
def make_periods():
    """What to dial in in each loop: as it is, with an amplifier, with that and a transmission."""
    loops = [("the paper's", changed_scene("paper-1um"), 10)]
    loops += [("NUCLEO-F446RE", changed_scene("nucleo-f446re", period=period), period) for period in (10, 5, 2, 1)]
    body = []
    for loop, scene, period in loops:
        for between, tables in [("", ""), ("amplifier", AMPLIFIER), ("amplifier and transmission", AMPLIFIER + transmission(scene))]:
            found = sim("sweep SCENE.toml --repeat 1", scene + tables)["scenes"][0]["recommended"]
            low, high = found["range_hz"]
            body.append({"loop": loop, "period": period, "between": between, "cutoff_hz": found["cutoff_hz"], "low_hz": low, "high_hz": high,
                         "stiffness_n_per_m": found["stiffness_n_per_m"], "area_n2_s_per_m2": found["area_n2_s_per_m2"]})
    return body


@block
def criteria_periods():
    body = []
    for r in rows("periods-quiet.csv"):
        hertz, area = f"{float(r['cutoff_hz']):g} Hz", significant(float(r["area_n2_s_per_m2"]) / 1e6, 3)
        if r["between"]:
            body[-1].append(f"{area} ({hertz})")
            continue
        low_high = hz_range([float(r["low_hz"]), float(r["high_hz"])])
        body.append([r["loop"], r["period"], f"**{hertz}**", f"{low_high} Hz", f"{float(r['stiffness_n_per_m']) / 1e3:g} kN/m", area])
    return table(["loop", "samples an output", "dial in", "as good", "stiffest wall", "area, 10^6 N^2 s/m^2", "amplifier of 1 kHz",
                  "and a transmission of 150 Hz"], body)


@long("elements-cost")
def make_elements():
    """Quiet walls with a gap in the transmission, and with a force that is not proportional to the command."""
    scene = changed_scene("paper-1um")
    geared = transmission(scene) + "[integrator]\nmethod = \"rk4\"\nsteps_per_sample = 1\n"
    body = []
    for element, tables in [
            ("none", ""), *((f"force {share:g} % too small at full command", f"[amplifier_error]\ncubic = {-share / 100}\n") for share in (3, 10)),
            ("transmission of 150 Hz", geared),
            *((f"and a gap of {microns:g} um", f"{geared}[backlash]\ngap_m = {microns}e-6\n") for microns in (1, 10, 100))]:
        for push in ("motor", "hand"):
            found = sim("walk SCENE.toml --cutoff 500 --criterion quiet",
                        scene.replace("[wall_hit]\n", f"[wall_hit]\npush_by = \"{push}\"\n", 1) + tables)
            body.append({"element": element, "push": push, "area_n2_s_per_m2": found["area_n2_s_per_m2"],
                         "stiffness_peak_n_per_m": found["stiffness_peak_n_per_m"]})
    return body


@block
def elements_cost():
    by = {}
    for r in rows("elements-cost.csv"):
        by.setdefault(r["element"], []).extend([significant(float(r["area_n2_s_per_m2"]) / 1e6, 3), f"{float(r['stiffness_peak_n_per_m']) / 1e3:g}"])
    head = [f"{push}: {what}" for push in ("motor's push", "hand's push") for what in ("area, 10^6 N^2 s/m^2", "peak K, kN/m")]
    return table(["element", *head], [[element, *cells] for element, cells in by.items()])


@block
def quiet_choices():
    """The cutoff to dial in by other limits of the force, and with an amplifier of 1 kHz."""
    body = []
    for name in ("paper-1um", "nucleo-f446re"):
        for share, amplifier in [(3, False), (7, False), (15, False), (7, True)]:
            scene = changed_scene(name)
            push_n = float(re.search(r"(?m)^push_n = (\S+)", scene)[1])
            scene = scene.replace("[wall_hit]\n", f"[wall_hit]\nforce_rms_limit_n = {share / 100 * push_n:.5f}\n", 1)
            scene += AMPLIFIER if amplifier else ""
            result = sim("sweep SCENE.toml --repeat 1", scene)["scenes"][0]
            body.append([name, f"{share} %", "1 kHz" if amplifier else "none", *dial_in_with_area(result)])
    return table(["scene", "force below, of the push", "amplifier", "dial in", "as good", "stiffest wall",
                  "area, 10^6 N^2 s/m^2"], body)


@block
def encoders():
    """The cutoff to dial in with encoders of other resolutions."""
    body = []
    for microns in (0.5, 1, 2, 5, 10):
        scene = re.sub(r"(?m)^resolution_m = \S+", f"resolution_m = {microns}e-6", changed_scene("paper-1um"))
        result = sim("sweep SCENE.toml --repeat 1", scene)["scenes"][0]
        body.append([f"{microns:g} um", *dial_in_with_area(result)])
    return table(["encoder", "dial in", "as good", "stiffest wall", "area, 10^6 N^2 s/m^2"], body)


@block
def quiet_protocols():
    """The stiffest quiet wall of ready scenes, tried in other ways."""
    body = []
    kilo = lambda n_per_m: "none" if n_per_m is None else f"{significant(n_per_m / 1e3, 2)} kN/m"
    for name in ("paper-1um", "paper-2um", "nucleo-f446re", "discovery-f407"):
        found = sim(f"sweep {name} --repeat 1")["scenes"][0]["recommended"]
        stiffness = found["stiffness_n_per_m"]
        held = {row["protocol"]: row["stiffness_n_per_m"] for row in found["protocols"]}
        cells = [kilo(held[protocol]) for protocol in ("press", "taps", "hand")]
        body.append([name, f"{found['cutoff_hz']:g} Hz", f"{found['damping_n_s_per_m']:g} N s/m", kilo(stiffness), *cells])
    return table(["scene", "cutoff", "B", "constant push, K", "press", "taps", "hand"], body)


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
            ["**the paper**, simulated (its Figure 7)", "no gain above 2000", "1700"],
            ["**the paper**, measured (its Figure 8)", "no gain above 2000", "1500"],
            ["**quiet walls**, to be dialled in", *[hz_range(v["recommended"]["range_hz"]) for v in variants]],
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
    """First power-up: walls of the NUCLEO that are quiet with an ideal amplifier."""
    bandwidths = [None, 5000, 3000, 2000, 1000]
    text = changed_scene("nucleo-f446re")
    body = []
    for k, b in [(157_000, 140), (27_000, 10), (50_000, 60)]:
        hits = [
            sim(f"hit SCENE.toml --cutoff 360 --criterion quiet --stiffness {k} --damping {b}",
                text + (f"\n[amplifier]\nbandwidth_hz = {f}\n" if f else ""))["rms_m"]
            for f in bandwidths
        ]
        body.append([f"K {number(k)} N/m, B {b} N s/m", *[significant(hit * 1e6, 2 if hit < 1e-4 else 3) for hit in hits]])
    head = ["wall", *["no amplifier" if f is None else f"{f // 1000} kHz" for f in bandwidths]]
    return table(head, body, right=range(1, 6))


# What tests measure


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


@block
def theory_elements():
    """What holds for the elements of a scene, and the test that has measured it."""
    def kept(key, digits=None):
        return m(f"sim_loop/{key}", digits) if digits else measured(f"sim_loop/{key}")

    orders = [f"{kept(f'order/{name}_least', digits)} to {kept(f'order/{name}_most', digits)}"
              for name, digits in (("euler", 4), ("rk4", 2), ("dormand_prince", 2))]
    loops, found = (measured(f"sim_studies/crossings/{key}") for key in ("loops", "found"))
    aside = number(100 * lit("tests/host/linear_elements.rs", r"ASIDE: f64 = ([\d.]+);"))
    changes, points = "simulated growth and decay change places at the", {
        name: m(f"host/{name}/points") for name in ("small_signal", "linear_elements")}
    return table(["claim", "measured", "test"], [
        [f"one exact step against 50 digits, energy norm, {kept('augmented/chains')} chains of 3 to 7 states, time "
         "constants from 1 ns",
         f"{kept('augmented/step_of_size')} of max(1, norm(A) T); {kept('augmented/step')} at most",
         "`host-sim/loop/src/plant/exact/tests.rs`"],
        ["60,000 exact steps under changing force against 60 digits, share of the largest value",
         kept("augmented/trajectory"), "same"],
        [f"{changes} multirate envelope (bilateral contact, saturation out of reach, 10 nm; cutoffs, B and latencies)",
         f"within {m('host/small_signal/worst', 3, 100)} % at {points['small_signal']} points",
         "`tests/host/small_signal.rs`"],
        [f"{changes} linear envelope with amplifier, mode and arm",
         f"within {aside} % at {points['linear_elements']} points", "`tests/host/linear_elements.rs`"],
        ["crossings of random loops with elements that eigenvalues agree with", f"all {found}, in {loops} loops",
         "`host-sim/studies/src/analysis/linear/boundary/tests.rs`"],
        ["order on the linear plant: Euler, RK4, Dormand-Prince", ", ".join(orders),
         "`host-sim/loop/src/numerics/integrator/tests.rs`"],
        ["order of a run through sticking, breakaway and damped stops: Euler, RK4",
         f"{kept('order/run_1', 3)}, {kept('order/run_4', 2)}", "`host-sim/loop/src/plant/integrated/tests.rs`"],
        ["stopping distance under Coulomb friction, RK4 and Dormand-Prince", "1e-12 of `m v^2 / (2 F)`", "same"],
        ["stuck: speed 0, position the same to the bit", "exactly", "same"],
        ["depth in a spring stop, of its energy bound", f"{kept('stop/least', 5)} or more undamped, never above",
         "same"],
        ["energy of the free plant, any elements", "never grows beyond the error control's 1e-8 a sample", "same"],
    ])


@block
def stored(file):
    """A stored table as it stands."""
    return table(list(rows(file)[0]), [r.values() for r in rows(file)])


# The passivity controller beside the plain wall
@block
def passivity_random():
    return table(
        ["of {} random scenes (mass, damping, resolution, full scale, period, latency, arm, wall)".format(m("host/passivity/ran")), "without the controller", "with it"],
        [["a contact gives more than the reserve", m("host/passivity/gave"), m("host/passivity/beyond")],
         ["most that one gives, in reserves", m("host/passivity/plain_highest", 3), m("host/passivity/highest", 3)],
         ["motion changes faster than the acceleration allows", "", m("host/passivity/faster")],
         ["outputs saturated, %", m("host/passivity/saturated_without", 3), m("host/passivity/saturated_with", 3)]],
        right=(1, 2))


@block
def passivity(scene):
    found = sim(f"passivity {scene}")
    body = []
    for row in found["rows"]:
        cut = ">" if row["capped_walks"] else ""
        name = "with" if row["controller"] else "without"
        for of, hits in (("without", row["at_boundary_without"]), ("with", row["at_boundary_with"])):
            if hits:
                body.append([f"{significant(1e6 * row['limit'], 3)} µm, {number(row['cutoff_hz'])} Hz", name, cut + significant(row["area_n2_s_per_m2"] / 1e6, 3),
                             of, significant(1e3 * hits["given_j"], 2), significant(100 * hits["withheld_fraction"], 2),
                             significant(1e6 * hits["rms_motion_m"], 2), significant(hits["roughness_n"], 2)])
    head = [f"`{scene}`, reserve {significant(1e3 * found['reserve_j'], 2)} mJ: limit, cutoff", "controller", "area, 10^6 N^2 s/m^2",
            "walls of the boundary", "most given, mJ", "withheld, %", "RMS, µm", "force above 100 Hz, N"]
    return table(head, body, right=(2, 4, 5, 6, 7))


@block
def passivity_lengths():
    found = sim("passivity paper-1um --cutoffs 1500 --limits 15e-6 --repeat 1 --settle 4,30,120,600")
    body = [[number(row["settle_s"]), "with" if row["controller"] else "without", significant(1e3 * row["given_j"], 2),
             significant(1e3 * row["given_by_motion_j"], 2), significant(1e3 * row["fed_w"], 2),
             significant(100 * row["withheld_fraction"], 2), significant(100 * row["withheld_most_fraction"], 2),
             significant(row["sag"], 3)] for row in found["lengths"]]
    return table(["length, s", "controller", "most given, mJ", "by motion, mJ", "fed by the hum, mW", "withheld, %", "most, %", "sag"],
                 body, right=(0, 2, 3, 4, 5, 6, 7))
