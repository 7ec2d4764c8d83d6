"""README, first results, device, theory of the loop, first power-up, passivity: what the simulator says in seconds."""

import math
import os
import re
import resource
import subprocess
import tempfile
import time
from pathlib import Path

from . import block, commands
from .source import ROOT, lit, long, mega, number, programs, rows, said, scene_of, significant, sim, table, value


def study(arguments, scene=None):
    """The sweep of one scene."""
    return sim(f"sweep {arguments}", scene)["scenes"][0]


def dialled(found):
    """What a sweep recommends, as it is stored."""
    low, high = found["range_hz"]
    return {"cutoff_hz": found["cutoff_hz"], "low_hz": low, "high_hz": high}


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
            body.append({"loop": loop, "period": period, "between": between, **dialled(found),
                         **{key: found[key] for key in ("stiffness_n_per_m", "area_n2_s_per_m2")}})
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
            found = study("SCENE.toml --repeat 1", scene + amplifier)["recommended"]
            yield (name, f"{share} %", "1 kHz" if amplifier else "none", f"**{found['cutoff_hz']:g} Hz**",
                   "{:g} to {:g} Hz".format(*found["range_hz"]), f"{found['stiffness_n_per_m'] / 1e3:g} kN/m",
                   mega(found["area_n2_s_per_m2"]))


def encoder_scenes():
    """Devices with encoders of some resolutions: device, encoder, scene."""
    for device, name in [("the paper's, its loop", "paper-1um"), ("the paper's, on a NUCLEO-F446RE", "nucleo-f446re")]:
        for microns in ("0.5", "1", "2", "5", "10"):
            yield device, f"{microns} um", scene_of(name, resolution_m=f"{microns}e-6")
    for device, name in [("knob like SmartKnob", "smartknob"), ("Hapkit", "hapkit"), ("Rice haptic paddle", "rice-paddle"),
                         ("EPFL haptic paddle", "epfl-paddle")]:
        scene = scene_of(name, counts_per_turn=4000, **({} if name == "smartknob" else {"encoder_on": '"motor"'}))
        ratio = key_of(scene, "ratio")
        yield device, "4,000 counts a turn, " + ("direct drive" if ratio == 1 else f"motor geared {ratio:.1f}:1"), scene


@long("encoders")
def make_encoders():
    """What to dial in with each encoder, and the stiffest wall, in the units of the scene."""
    body = []
    for device, encoder, scene in encoder_scenes():
        found = study("SCENE.toml --repeat 1", scene)["recommended"]
        per, unit = ("n_m_per_rad", "N m/rad") if "[rotary]" in scene else ("n_per_m", "N/m")
        body.append({"device": device, "encoder": encoder, **dialled(found), "unit": unit,
                     "stiffness": found[f"stiffness_{per}"], "damping": found[f"damping_{per.replace('_per', '_s_per')}"]})
    return body


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
        loops = [" to ".join(number(value(f"host/closed_loop/{rate}/{kind}_{end}"), 1) for end in ("below", "above"))
                 for kind in ("Fixed", "F64")]
        yield case, number(lit("tests/host/closed_loop.rs", known), 1), *loops


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


@block("largest K, N/mm", *(f"output at {rate} Hz" for rate in ("250", "1000", "5000", "10,000", "40,000")), "last over first")
def criteria_people():
    """Largest K of a spring alone by rate of the output, of an estimated device, beside what people called clean."""
    yield "people, published", "0.325", "", "", "", "0.904", "2.8"
    told = (ROOT / "docs/data/choi-tan.toml").read_text()
    for name, text in {"rigid, no lag": without(told, "amplifier"), "force lags by 1.6 ms (100 Hz)": told}.items():
        for criterion in ("quiet", "felt"):
            scenes = [text.replace("period = 160", f"period = {period}") for period in (160, 40, 8, 4, 1)]
            peaks = [sim(f"walk SCENE.toml --criterion {criterion}", scene)["stiffness_peak_n_per_m"] for scene in scenes]
            yield f"{name}, `{criterion}`", *(f"{1e-3 * peak:.3g}" for peak in peaks), significant(peaks[-1] / peaks[0], 2)


DEVICES = ["epfl-paddle", "rice-paddle", "hapkit", "smartknob", "nucleo-f446re", "discovery-f407"]
ESTIMATORS = "butterworth,first-order,tracking-loop,kalman-3,levant-explicit"
SWEEPS = "devices-sweeps.csv"
# From examples/ to a board that holds a wall, builds included.
TUTORIAL_SECONDS = 600


def times(text, key, factor):
    """The scene with that key's number times a factor."""
    changed, n = re.subn(rf"(?m)^({key} = )([0-9.e-]+)", lambda found: f"{found[1]}{float(found[2]) * factor:g}", text)
    assert n == 1, (key, n)
    return changed


def without(text, name):
    """The scene without that table, and without the list of estimated keys, which may name it."""
    text = re.sub(r"(?ms)^estimated = \[.*?^\]\n", "", text)
    return re.sub(rf"(?ms)^\[{name}\]\n.*?(?=^\[|\Z)", "", text)


def changes(text):
    """What could limit a device's walls: the scene with one thing changed."""
    rotary = "[rotary]" in text
    yield "encoder four times finer", times(text, *(("counts_per_turn", 4) if rotary else ("resolution_m", 0.25)))
    yield "an output for every sample", times(text, "period", 0.1).replace("period = 1.0", "period = 1")
    yield "no latency", times(text, "latency", 0)
    yield "twice the force", times(text, "supply_v" if "supply_v =" in text else "limit_v", 2)
    if "[amplifier]" in text:
        yield "no lag of the amplifier", without(text, "amplifier")
    if "[friction]" in text:
        yield "no friction", without(without(text, "friction"), "integrator")


def swept(scene, changed, text):
    """What a sweep answers for that scene, in the units of the scene: by quiet walls, and by the scene's own criterion."""
    told = sim("sweep SCENE.toml --repeat 2", text)["scenes"][0]
    found = told["recommended"] or {}
    answer = {**found, **found.get("free_motion", {})}
    def value(words):
        return next((value for key, value in answer.items() if key.startswith(words)), "")
    low, high = found.get("range_hz", ("", ""))
    own_low, own_high = told["ideal_cutoff_range_hz"] or ("", "")
    return {"scene": scene, "changed": changed, "cutoff_hz": value("cutoff_hz"), "low_hz": low, "high_hz": high,
            "stiffness": value("stiffness"), "damping_max": value("damping_max"), "area": value("area"),
            "is_capped": int(value("is_capped") or 0), "inertia": value("inertia") or value("mass"),
            "friction": value("friction"), "own_low_hz": own_low, "own_high_hz": own_high}


@long("devices-sweeps")
def make_sweeps():
    """Each scene swept, as it is and with one thing changed."""
    return [swept(scene, changed, text) for scene in DEVICES
            for changed, text in [("", scene_of(scene)), *changes(scene_of(scene))]]


@long("devices")
def make_best():
    """The best of five estimators of each scene."""
    body = []
    for scene in DEVICES:
        compared = sim(f"compare SCENE.toml --estimators {ESTIMATORS} --budget 16 --out compare", scene_of(scene))
        areas = {r["estimator"]: next(value for key, value in r.items() if key.startswith("area_n")) for r in compared["estimators"]}
        best = max(areas, key=areas.get)
        body.append({"scene": scene, "best": best, "best_times_butterworth": areas[best] / areas["butterworth"]})
    return body


@block()
def devices_limits():
    body, shown = [], list(dict.fromkeys(r["changed"] for r in rows(SWEEPS) if r["changed"]))
    for scene in DEVICES:
        found = {r["changed"]: r for r in rows(SWEEPS) if r["scene"] == scene}
        areas = {name: float(r["area"]) for name, r in found.items() if r["area"]}
        limit = max(areas, key=areas.get)
        def cell(name):
            if name not in areas:
                return "no quiet wall" if name in found else ""
            cut = "~ " if int(found[""]["is_capped"]) else "> " if int(found[name]["is_capped"]) else ""
            return f"{cut}{significant(areas[name] / areas[''], 3)}{' (most)' if name == limit else ''}"
        body.append([f"`{scene}`", *map(cell, shown)])
    return table(["scene", *shown], body)


@long("tutorial")
def timed_tutorial():
    """The tutorial's commands, typed as they stand, with nothing built before."""
    begun, commands.SECONDS = time.monotonic(), TUTORIAL_SECONDS
    with tempfile.TemporaryDirectory() as empty:
        os.environ["CARGO_TARGET_DIR"] = empty
        failed = commands.run("docs/tutorial.md")
    seconds = time.monotonic() - begun
    if failed or seconds > TUTORIAL_SECONDS:
        raise SystemExit("\n".join(["error: the tutorial", *failed, f"took {seconds:.0f} s, {TUTORIAL_SECONDS} are allowed"]))
    return [{"cores": len(os.sched_getaffinity(0)), "seconds": f"{seconds:.0f}"}]


# Of hits, by cutoffs, K and B. The walls are spread over the same ranges, so that as many of them are stable.
SIZES = {10**3: (10, 10, 10), 10**4: (10, 40, 25), 10**5: (10, 100, 100), 10**6: (10, 400, 250)}
ALLOWED_S = 180


def spread(n, low, high):
    return [low + (high - low) * i / (n - 1) for i in range(n)]


@long("hits")
def timed_hits():
    """Studies of single hits, each size in a folder of its own: what a user waits for, the folder written and flushed."""
    program, body = programs() / "host-sim", []
    for hits, (cutoffs, stiffnesses, dampings) in SIZES.items():
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "hits.toml").write_text(f"""measure = "hit"
scenes = ["paper-2um"]
cutoffs_hz = {spread(cutoffs, 300, 3000)}
stiffnesses = {spread(stiffnesses, 1e3, 100e3)}
dampings = {spread(dampings, 0, 300)}
""")
            begun, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([program, "study", "hits.toml", "--out", "hits"], cwd=folder, stdout=subprocess.PIPE, check=True)
            seconds, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
            busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            size = sum(path.stat().st_size for path in Path(folder, "hits").rglob("*") if path.is_file())
        body.append({"hits": hits, "cores": len(os.sched_getaffinity(0)), "seconds": f"{seconds:.3f}", "busy_s": f"{busy:.3f}",
                     "bytes": size})
        print(body[-1], flush=True)
    if seconds > ALLOWED_S:
        raise SystemExit(f"error: {hits} hits took {seconds:.0f} s, {ALLOWED_S} are allowed")
    return body
