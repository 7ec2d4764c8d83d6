"""The ready devices: what each gives, and what limits it."""

import os
import re
import tempfile
import time
import tomllib

from . import block, commands
from .source import long, rows, scene_of, significant, sim, table

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


@block("scene", "estimated")
def devices_estimated():
    for scene in DEVICES:
        keys = tomllib.loads(scene_of(scene)).get("estimated", [])
        yield f"`{scene}`", ", ".join(f"`{key}`" for key in keys) or "none"


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


@block("scene", "full force", "speed", "at the handle, m/s", "travel at the handle, mm")
def fault_speeds():
    """What full force gives the free handle until a fault is off, as `prepare` says."""
    for scene in DEVICES:
        told = sim(f"prepare {scene} --out {scene}.device")
        rotary = tomllib.loads(scene_of(scene)).get("rotary")
        length, of_force, force, speed = ("rad", "n_m", "N m", "rad/s") if rotary else ("m", "n", "N", "m/s")
        radius = rotary["handle_radius_m"] if rotary else 1
        full, fast, far = (told[key] for key in (f"full_scale_{of_force}", f"fault_speed_{length}_per_s", f"fault_travel_{length}"))
        yield (f"`{scene}`", f"{significant(full, 3)} {force}", f"{significant(fast, 3)} {speed}",
               significant(fast * radius, 3), significant(1e3 * far * radius, 3))
