"""README, first results, device, theory of the loop, first power-up, passivity: what the simulator says in seconds."""

import math
import re

from . import block
from .source import lit, long, m, mega, number, rows, said, scene_of, significant, sim, table


def hz_range(low_high):
    return "{:g} to {:g}".format(*map(float, low_high))


def study(arguments, scene=None):
    """The sweep of one scene."""
    return sim(f"sweep {arguments}", scene)["scenes"][0]


def dial_in(result):
    """Cells of what a sweep recommends, and the area of the quiet walls, 10^6 N^2 s/m^2."""
    found = result["recommended"]
    return [f"**{found['cutoff_hz']:g} Hz**", f"{hz_range(found['range_hz'])} Hz", f"{found['stiffness_n_per_m'] / 1e3:g} kN/m",
            mega(found["area_n2_s_per_m2"])]


@block()
def readme_sweep():
    """What the terminal says at the end."""
    return ["```text", *said("sweep paper-2um").splitlines()[-6:], "```"]


# As `sweep --levers` puts them between the loop and the handle (host-sim/studies/src/study/levers.rs).
AMPLIFIER = "\n[amplifier]\nbandwidth_hz = 1000\n"


def key_of(scene, key):
    return float(re.search(rf"(?m)^{key} = (\S+)", scene)[1])


def hit_by(scene, line):
    """The scene with one more key of its hit."""
    return scene.replace("[wall_hit]\n", f"[wall_hit]\n{line}\n", 1)


def transmission(scene, share=0.24, per_s=2 * math.pi * 150, ratio=0.03):
    """A handle of that share of the device's mass beside it, the frequency of the two, and damping ratio."""
    mass = key_of(scene, "mass_kg")
    reduced = mass * share / (1 + share)
    return (f"\n[mode]\nmass_kg = {share * mass:.6f}\nstiffness_n_per_m = {reduced * per_s ** 2:.3f}\n"
            f"damping_n_s_per_m = {2 * ratio * reduced * per_s:.5f}\n")


@long("periods-quiet")
def make_periods():
    """What to dial in in each loop: as it is, with an amplifier, with that and a transmission."""
    loops = [("the paper's", scene_of("paper-1um"), 10)]
    loops += [("NUCLEO-F446RE", scene_of("nucleo-f446re", period=period), period) for period in (10, 5, 2, 1)]
    body = []
    for loop, scene, period in loops:
        for between, tables in [("", ""), ("amplifier", AMPLIFIER), ("amplifier and transmission", AMPLIFIER + transmission(scene))]:
            found = study("SCENE.toml --repeat 1", scene + tables)["recommended"]
            low, high = found["range_hz"]
            body.append({"loop": loop, "period": period, "between": between, "cutoff_hz": found["cutoff_hz"], "low_hz": low,
                         "high_hz": high, **{key: found[key] for key in ("stiffness_n_per_m", "area_n2_s_per_m2")}})
    return body


@long("elements-cost")
def make_elements():
    """Quiet walls with a gap in the transmission, and with a force that is not proportional to the command."""
    scene = scene_of("paper-1um")
    geared = transmission(scene) + "[integrator]\nmethod = \"rk4\"\nsteps_per_sample = 1\n"
    body = []
    for element, tables in [
            ("none", ""),
            *((f"force {share} % too small at full command", f"[amplifier_error]\ncubic = {-share / 100}\n") for share in (3, 10)),
            ("transmission of 150 Hz", geared),
            *((f"and a gap of {microns} um", f"{geared}[backlash]\ngap_m = {microns}e-6\n") for microns in (1, 10, 100))]:
        for push in ("motor", "hand"):
            found = sim("walk SCENE.toml --cutoff 500 --criterion quiet", hit_by(scene, f'push_by = "{push}"') + tables)
            body.append({"element": element, "push": push, **{key: found[key] for key in ("area_n2_s_per_m2", "stiffness_peak_n_per_m")}})
    return body


@block("scene", "force below, of the push", "amplifier", "dial in", "as good", "stiffest wall", "area, 10^6 N^2 s/m^2")
def quiet_choices():
    """The cutoff to dial in by other limits of the force, and with an amplifier of 1 kHz."""
    for name in ("paper-1um", "nucleo-f446re"):
        for share, amplifier in [(3, ""), (7, ""), (15, ""), (7, AMPLIFIER)]:
            scene = scene_of(name)
            scene = hit_by(scene, f"force_rms_limit_n = {share / 100 * key_of(scene, 'push_n'):.5f}")
            yield name, f"{share} %", "1 kHz" if amplifier else "none", *dial_in(study("SCENE.toml --repeat 1", scene + amplifier))


def encoder_scenes():
    """Devices with encoders of some resolutions: device, encoder, scene."""
    for device, name in [("the paper's, its loop", "paper-1um"), ("the paper's, on a NUCLEO-F446RE", "nucleo-f446re")]:
        for microns in ("0.5", "1", "2", "5", "10"):
            yield device, f"{microns} um", scene_of(name, resolution_m=f"{microns}e-6")
    turned = {"counts_per_turn": 4000, "encoder_on": '"motor"'}
    for device, name, changes in [
            ("knob like SmartKnob", "smartknob", {"counts_per_turn": 4000}), ("Hapkit", "hapkit", turned),
            ("Rice haptic paddle", "rice-paddle", turned), ("EPFL haptic paddle", "epfl-paddle", turned)]:
        scene = scene_of(name, **changes)
        ratio = key_of(scene, "ratio")
        yield device, "4,000 counts a turn, " + ("direct drive" if ratio == 1 else f"motor geared {ratio:.1f}:1"), scene


@long("encoders")
def make_encoders():
    """What to dial in with each encoder, and the stiffest wall, in the units of the scene."""
    body = []
    for device, encoder, scene in encoder_scenes():
        found = study("SCENE.toml --repeat 1", scene)["recommended"]
        low, high = found["range_hz"]
        per, unit = ("n_m_per_rad", "N m/rad") if "[rotary]" in scene else ("n_per_m", "N/m")
        body.append({"device": device, "encoder": encoder, "cutoff_hz": found["cutoff_hz"], "low_hz": low, "high_hz": high, "unit": unit,
                     "stiffness": found[f"stiffness_{per}"], "damping": found[f"damping_{per.replace('_per', '_s_per')}"]})
    return body


def ideal_range(r):
    """Of cutoffs, Hz."""
    low, high = (r[f"ideal_cutoff_range_hz.{end}"] for end in (0, 1))
    return (f"{low:g}" if low == high else hz_range((low, high))) + (" (the highest that was tried)" if high == 4000 else "")


# The loop against the linear one
def interval(r):
    """Of the area with 5 %, where it has one."""
    ends = [r[f"area_5_percent_{end}_n2_s_per_m2"] for end in ("low", "high")]
    return "" if ends == ["", ""] else " to ".join("?" if end == "" else mega(end) for end in ends)


@block("the paper's device at 500 Hz, as it runs", "passive", "linearly stable", "ratio")
def theory_passive():
    told = sim("linear paper-1um --cutoffs 500 --dampings 0:0.05:400 --passivity --multirate")
    by = {r["damping_n_s_per_m"]: r for r in told["rows"]}
    keys = ("stiffness_passive_n_per_m", "stiffness_max_n_per_m")
    passive, stable = (max(r[key] for r in by.values()) / 1e3 for key in keys)
    narrow, wide = (max(b for b, r in by.items() if r[key] > 0) for key in keys)
    yield "K at B = 0, N/m", *(number(by[0.0][key], 0) for key in keys), ""
    yield "largest K, kN/m", significant(passive, 3), significant(stable, 3), significant(stable / passive, 3)
    yield "largest B, N s/m (steps of 0.05)", significant(narrow, 3), significant(wide, 3), significant(wide / narrow, 2)


@block("wall", "no amplifier", "5 kHz", "3 kHz", "2 kHz", "1 kHz", right=range(1, 6))
def amplifier_walls():
    """First power-up: walls of the NUCLEO that are quiet with an ideal amplifier."""
    scene = scene_of("nucleo-f446re")
    amplifiers = ["", *(f"\n[amplifier]\nbandwidth_hz = {kilohertz}000\n" for kilohertz in (5, 3, 2, 1))]
    for k, b in [(157_000, 140), (27_000, 10), (50_000, 60)]:
        words = f"hit SCENE.toml --cutoff 360 --criterion quiet --stiffness {k} --damping {b}"
        hits = [sim(words, scene + amplifier)["rms_m"] for amplifier in amplifiers]
        yield f"K {number(k)} N/m, B {b} N s/m", *(significant(hit * 1e6, 2 if hit < 1e-4 else 3) for hit in hits)


@block("case", "known K, N/m", "loop with the core, between", "loop with the twin, between")
def theory_oscillation():
    for case, rate, known in [
            ("oscillation starts, 10 kHz, B = 0, no latency", "10000", r"\[\(1e4, ([\d_.]+)\), \(1e3, [\d_.]+\)\]"),
            ("the same at 1 kHz", "1000", r"\[\(1e4, [\d_.]+\), \(1e3, ([\d_.]+)\)\]")]:
        loops = [" to ".join(m(f"host/closed_loop/{rate}/{kind}_{end}", 1) for end in ("below", "above")) for kind in ("Fixed", "F64")]
        yield case, number(lit("tests/host/closed_loop.rs", known), 1), *loops


@block()
def stored(file):
    """A stored table as it stands."""
    return table(list(rows(file)[0]), [r.values() for r in rows(file)])


# The passivity controller beside the plain wall
@block()
def passivity(scene):
    found = sim(f"passivity {scene}")
    body = []
    for row in found["rows"]:
        first = [f"{significant(1e6 * row['limit'], 3)} µm, {number(row['cutoff_hz'])} Hz", "with" if row["controller"] else "without",
                 (">" if row["capped_walks"] else "") + mega(row["area_n2_s_per_m2"])]
        for of in ("without", "with"):
            if hits := row[f"at_boundary_{of}"]:
                body.append([*first, of, *(significant(scale * hits[key], 2) for key, scale in (
                    ("given_j", 1e3), ("withheld_fraction", 100), ("rms_motion_m", 1e6), ("roughness_n", 1)))])
    head = [f"`{scene}`, reserve {significant(1e3 * found['reserve_j'], 2)} mJ: limit, cutoff", "controller", "area, 10^6 N^2 s/m^2",
            "walls of the boundary", "most given, mJ", "withheld, %", "RMS, µm", "force above 100 Hz, N"]
    return table(head, body, right=(2, 4, 5, 6, 7))
