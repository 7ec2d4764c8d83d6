"""docs/scenes.md: the range of each key, held to what the program says when it refuses a number."""

import re
import tempfile
from pathlib import Path

from . import states
from .source import ROOT, programs, shell

PAGE = "docs/scenes.md"
BASE = (ROOT / "scenes/paper-1um.toml").read_text()
# Tables that the scene has not, whole; each is added for its own keys.
TABLES = {
    "amplifier": "bandwidth_hz = 1000",
    "mode": "mass_kg = 0.1\nstiffness_n_per_m = 1e5\ndamping_n_s_per_m = 1",
    "arm": "mass_kg = 1\nstiffness_n_per_m = 20\ndamping_n_s_per_m = 5\nrest_position_m = 0\n"
           "grip_stiffness_n_per_m = 900\ngrip_damping_n_s_per_m = 15",
    "cogging": "amplitude_n = 0.1\npitch_m = 0.01\nphase_rad = 0",
    "friction": "coulomb_n = 0.1\nstatic_n = 0.2\nstribeck_speed_m_per_s = 0.01",
    "offset": "force_n = 0.1",
    "encoder_noise": "rms_m = 1e-7\nseed = 1",
    "encoder_error": "cycle_m = 4e-6\nfirst_m = 0\nsecond_m = 0\nphase_rad = 0",
}
# Those of `[velocity]` are the estimator's, and held by a test of the core.
HELD = {*TABLES, *re.findall(r"(?m)^\[(\w+)\]$", BASE)} - {"velocity"}
NUMBER = r"-?[\d.]+(?:e-?\d+)?"


def with_key(table, key, value):
    """The scene with that key, of a table that it has or that is added."""
    text = BASE if re.search(rf"(?m)^\[{table}\]$", BASE) else f"{BASE}\n[{table}]\n{TABLES.get(table, '')}\n"
    head, rest = re.split(rf"(?m)^\[{table}\]\n", text)
    body, *after = re.split(r"(?m)^(?=\[)", rest, maxsplit=1)
    body = re.sub(rf"(?m)^{key} = .*\n?", "", body)
    return "".join([head, f"[{table}]\n{key} = {value}\n", body, *after])


def allowed(table, key):
    """What a refusal of a large number says."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.toml").write_text(with_key(table, key, 10**9 if key == "period" else "1e15"))
        said = shell(f"{programs()}/host-sim linear scene.toml --cutoffs 500 --dampings 1", folder).stderr
    found = re.search(rf"{table}\.{key} is .*, allowed ({NUMBER}) to ({NUMBER})", said)
    return [float(end) for end in found.groups()] if found else said


def rows():
    """Rows with a range in numbers for each of their keys: the row, and what must hold of it."""
    table = None
    for line in (ROOT / PAGE).read_text().split("\n"):
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if not line.startswith("|") or len(cells) < 4:
            continue
        if named := re.fullmatch(r"`\[(\w+)\]`", cells[0]):
            table = named[1]
        keys = re.findall(r"`([\w.]+)`", cells[0]) if "." in cells[0] else re.findall(r"`(\w+)`", cells[1])
        keys = [key.split(".") if "." in key else [table, key] for key in keys]
        ranges = [part.split(" to ") for part in cells[-1].strip(" |").split(", ")]
        plain = all(len(ends) == 2 and all(re.fullmatch(NUMBER, end) for end in ends) for ends in ranges)
        if not keys or len(keys) != len(ranges) or not plain or keys[0][0] not in HELD:
            continue
        yield line, lambda keys=keys, ranges=ranges: all(
            allowed(*key) == [float(end) for end in ends] for key, ends in zip(keys, ranges))


HOLDS = list(rows())
assert len(HOLDS) > 20, "docs/scenes.md has other tables than this reads"
states(PAGE, *HOLDS)
