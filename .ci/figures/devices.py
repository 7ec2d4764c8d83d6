"""The ready devices: what each gives, and what limits it."""

import csv
import json
import os
import re
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path

from . import block, commands, slots
from .source import DATA, LONG, ROOT, note_made, number, programs, row, rows, significant, table
from .source import sim as asked

# Scene, its name on the page.
DEVICES = {
    "epfl-paddle": "EPFL haptic paddle", "rice-paddle": "Rice haptic paddle", "hapkit": "Hapkit", "smartknob": "knob like SmartKnob",
    "nucleo-f446re": "the paper's device", "discovery-f407": "the paper's device",
}
ESTIMATORS = "butterworth,first-order,tracking-loop,kalman-3,levant-explicit"
FILE = "devices.csv"
# From examples/ to a board that holds a wall, builds included.
TUTORIAL_SECONDS, TUTORIAL_TIME = 600, "tutorial-seconds.csv"


def times(text, key, factor):
    """The scene with that key's number times a factor."""
    changed, n = re.subn(rf"(?m)^({key} = )([0-9.e-]+)", lambda found: f"{found[1]}{float(found[2]) * factor:g}", text)
    assert n == 1, (key, n)
    return changed


def without(text, name):
    return re.sub(rf"(?ms)^\[{name}\]\n.*?(?=^\[|\Z)", "", text)


def changes(text):
    """What could limit a device's walls: the scene with one thing changed."""
    rotary = "[rotary]" in text
    yield "encoder four times finer", times(text, *(("counts_per_turn", 4) if rotary else ("resolution_m", 0.25)))
    yield "an output for every sample", times(text, "period", 0.1).replace("period = 1.0", "period = 1")
    yield "no latency", times(text, "latency", 0)
    yield "twice the force", times(text, "supply_v" if "supply_v =" in text else "limit_v", 2)
    plain = re.sub(r"(?ms)^estimated = \[.*?^\]\n", "", text)
    if "[amplifier]" in text:
        yield "no lag of the amplifier", without(plain, "amplifier")
    if "[friction]" in text:
        yield "no friction", without(without(plain, "friction"), "integrator")


def sim(folder, words):
    ran = subprocess.run(f"{programs()}/host-sim {words} --json", shell=True, cwd=folder, text=True, stdout=subprocess.PIPE, check=True)
    return json.loads(ran.stdout)


def swept(folder, text):
    """The sweep of a scene, and area, peak K and largest B at its ideal cutoff, and how many walks a cap cut there."""
    (Path(folder) / "SCENE.toml").write_text(text)
    told = sim(folder, "sweep SCENE.toml --plain --repeat 2 --force")["scenes"][0]
    best = next(c for c in told["cutoffs"] if c["cutoff_hz"] == told["ideal_cutoff_hz"])
    # In the units of the scene.
    values = {next(words for words in ("area", "stiffness_peak", "damping_max") if key.startswith(words)): value
              for key, value in best.items() if re.match(r"area_n|stiffness_peak|damping_max", key)}
    for what in ("stiffness", "damping"):
        # `stiffness_max`, `damping_max`, `stiffness_and_damping_max`; what ended a walk by itself is `closed`
        values[f"{what}_cut"] = sum(what in walk["ended_by"] for walk in best["walks"])
    return told, values


def make():
    """Runs all of it and stores docs/data/devices.csv."""
    body = []
    for scene in DEVICES:
        text = (ROOT / f"scenes/{scene}.toml").read_text()
        with tempfile.TemporaryDirectory() as folder:
            told, own = swept(folder, text)
            low, high = told["ideal_cutoff_range_hz"]
            compared = sim(folder, f"compare SCENE.toml --estimators {ESTIMATORS} --budget 16 --out compare")
            areas = {r["estimator"]: next(value for key, value in r.items() if key.startswith("area_n"))
                     for r in compared["estimators"]}
            best = max(areas, key=areas.get)
            tried = {name: swept(folder, changed)[1]["area"] / own["area"] for name, changed in changes(text)}
            limit = max(tried, key=tried.get)
            body.append({
                "scene": scene, "ideal_cutoff_hz": told["ideal_cutoff_hz"], "ideal_low_hz": low, "ideal_high_hz": high,
                "stiffness_peak": own["stiffness_peak"], "damping_max": own["damping_max"],
                "stiffness_cut": own["stiffness_cut"], "damping_cut": own["damping_cut"], "best": best,
                "best_times_butterworth": areas[best] / areas["butterworth"], "limit": limit, "times": tried[limit],
                **{name.replace(" ", "_"): tried.get(name, "") for name in ALL}})
    with (DATA / FILE).open("w", newline="") as file:
        writer = csv.DictWriter(file, list(body[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(body)
    note_made("cargo sim sweep, compare of each of scenes/*.toml", {"devices": FILE})


ALL = ["encoder four times finer", "an output for every sample", "no latency", "twice the force", "no lag of the amplifier", "no friction"]
LONG["devices"] = ("cargo sim compare SCENE --estimators " + ESTIMATORS + " --budget 16", {"devices": FILE}, make)


def units(scene):
    return ("N m/rad", "N m s/rad") if "[rotary]" in (ROOT / f"scenes/{scene}.toml").read_text() else ("N/m", "N s/m")


def hertz(r):
    low, high = float(r["ideal_low_hz"]), float(r["ideal_high_hz"])
    return number(low) if low == high else f"{number(low)} to {number(high)}"


@block
def devices():
    body = []
    for r in rows(FILE):
        (k, b), best = units(r["scene"]), float(r["best_times_butterworth"])
        def most(key, cut):
            return ("> " if int(r[cut]) else "") + number(float(r[key]))
        body.append([f"{DEVICES[r['scene']]}, `{r['scene']}`", hertz(r), f"{most('stiffness_peak', 'stiffness_cut')} {k}",
                     f"{most('damping_max', 'damping_cut')} {b}", f"`{r['best']}`, {best:.2f} times"])
    return table(["device, scene", "ideal cutoff range, Hz", "largest K", "largest B", "best of five, its area against Butterworth's"], body)


@block
def devices_limits():
    shown = [name for name in ALL if any(r[name.replace(" ", "_")] for r in rows(FILE))]
    body = []
    for scene in DEVICES:
        r = row(FILE, scene=scene)
        cells = [r[name.replace(" ", "_")] for name in shown]
        body.append([f"`{scene}`", *(significant(float(cell), 3) + (" **" if name == r["limit"] else "") if cell else "" for name, cell in zip(shown, cells))])
    body = [[cell.replace(" **", " (most)") for cell in cells] for cells in body]
    return table(["scene", *shown], body)


@block
def devices_estimated():
    body = []
    for scene in DEVICES:
        text = (ROOT / f"scenes/{scene}.toml").read_text()
        found = re.search(r"(?ms)^estimated = \[(.*?)\]", text)
        keys = re.findall(r'"([^"]+)"', found[1]) if found else []
        body.append([f"`{scene}`", ", ".join(f"`{key}`" for key in keys) or "none"])
    return table(["scene", "estimated"], body)


@block
def tutorial_walk():
    predicted, found = ({float(r["damping_n_s_per_m"]): float(r["stiffness_n_per_m"]) for r in rows(f"tutorial-{kind}.csv")}
                        for kind in ("predicted", "measured"))
    return table(["B, N s/m", "largest K predicted, N/m", "largest K on the board, N/m"],
                 [[number(b), number(predicted.get(b, 0.0)), number(found.get(b, 0.0))] for b in sorted(predicted | found)])


def timed_tutorial():
    """The tutorial's commands, typed as they stand, with nothing built before."""
    begun, commands.SECONDS = time.monotonic(), TUTORIAL_SECONDS
    with tempfile.TemporaryDirectory() as empty:
        os.environ["CARGO_TARGET_DIR"] = empty
        failed = commands.run("docs/tutorial.md")
    seconds = time.monotonic() - begun
    if failed or seconds > TUTORIAL_SECONDS:
        raise SystemExit("\n".join(["error: the tutorial", *failed, f"took {seconds:.0f} s, {TUTORIAL_SECONDS} are allowed"]))
    with (DATA / TUTORIAL_TIME).open("w") as file:
        file.write(f"cores,seconds\n{len(os.sched_getaffinity(0))},{seconds:.0f}\n")
    note_made(".ci/pages --long tutorial", {"seconds": TUTORIAL_TIME})


LONG["tutorial"] = (".ci/pages --long tutorial", {"seconds": TUTORIAL_TIME}, timed_tutorial)


slots("docs/tutorial.md", ("with nothing built before, took {} on {} cores",
                           lambda: f"{float(row(TUTORIAL_TIME)['seconds']) / 60:.1f} minutes", lambda: row(TUTORIAL_TIME)["cores"]))


@block
def fault_speeds():
    """What full force gives the free handle until a fault is off, as `prepare` says."""
    body = []
    with tempfile.TemporaryDirectory() as folder:
        for scene in DEVICES:
            told = sim(folder, f"prepare {scene} --out {scene}.device")
            turns = "full_scale_n_m" in told
            length, of_force = ("rad", "n_m") if turns else ("m", "n")
            force = told[f"full_scale_{of_force}"]
            speed, travel = told[f"fault_speed_{length}_per_s"], told[f"fault_travel_{length}"]
            radius = tomllib.loads((ROOT / f"scenes/{scene}.toml").read_text())["rotary"]["handle_radius_m"] if turns else 1
            body.append([f"`{scene}`", f"{significant(force, 3)} {'N m' if turns else 'N'}",
                         f"{significant(speed, 3)} {'rad/s' if turns else 'm/s'}",
                         significant(speed * radius, 3), significant(1e3 * travel * radius, 3)])
    return table(["scene", "full force", "speed", "at the handle, m/s", "travel at the handle, mm"], body)


@block
def agree_example():
    found = asked(f"agree {ROOT}/examples/known.toml {ROOT}/docs/data/tutorial-measured.csv")
    def cells(row):
        scene, value, low, high, left = ("none" if row[key] is None else significant(row[key], 3)
                                         for key in ("scene", "value", "low", "high", "left_n_per_m"))
        return [row["name"], f"`{row['key']}`", scene, f"{value} ({low} to {high})", row["unit"], left, "yes" if row["explains"] else "no"]
    differ = significant(found["distance_n_per_m"], 3)
    return table(["number", "key", "in the scene", "explains best (range)", "unit", f"leaves, of {differ} N/m", "explains all"],
                 [cells(row) for row in found["suspects"]])
