"""Where figures come from: the simulator, what the tests have measured, stored tables, constants of the source."""

import csv
import functools
import json
import math
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from tools import ROOT, run

DATA = ROOT / "docs/data"
PAGES = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", *(
    f"{folder}/{page.name}" for folder in ("docs", "docs/lab") for page in sorted((ROOT / folder).glob("*.md")))]
# What `figure` of tests/figure.rs leaves, one file for each.
LEFT_BY_TESTS = ROOT / "target/tmp/figures"

# Of what a command prints, what the pages need.
KEPT = {"winners", "walls", "damping_n_s_per_m", "stiffness_n_per_m", "impedance_error_of_loop", "filters", "plant",
        "q15_full_scale_m_per_s"}


def shell(command, folder=ROOT, seconds=None, **more):
    return subprocess.run(command, shell=True, cwd=folder, text=True, capture_output=True, timeout=seconds, **more)


def commit():
    """The last commit that changed the programs; + where they have been changed since."""
    where = "src host-sim lab virtual-board scenes Cargo.lock rust-toolchain.toml"
    changed = shell(f"git status --porcelain --untracked-files=no -- {where}").stdout
    return shell(f"git log -1 --abbrev=9 --format=%h -- {where}").stdout.strip() + ("+" if changed else "")


@functools.cache
def rows(name):
    """A stored table: docs/data/NAME, or a path from the root."""
    path = ROOT / name if "/" in name else DATA / name
    return list(csv.DictReader(path.read_text().splitlines(keepends=True)))


def store(name, body, columns=None):
    """Writes docs/data/NAME, whole or not at all: these columns of the rows, or all that the first row has."""
    draft = DATA / f"{name}.new"
    with draft.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns or list(body[0]), lineterminator="\n", extrasaction="ignore")
        writer.writeheader()
        writer.writerows(body)
    draft.rename(DATA / name)
    rows.cache_clear()


def rows_of(name, **wanted):
    """The rows of a stored table that have these values."""
    return [r for r in rows(name) if all(r[key] == value for key, value in wanted.items())]


def row(name, **wanted):
    found = rows_of(name, **wanted)
    if not found:
        raise SystemExit(f"error: {name} has no row {wanted}")
    return found[0]


def grouped(found, *keys):
    """Rows by their values of these keys."""
    groups = {}
    for r in found:
        groups.setdefault(tuple(r[key] for key in keys), []).append(r)
    return groups


def lit(path, pattern):
    """The number that the group of the pattern matches in a source file, in one place of it."""
    found = re.findall(pattern, (ROOT / path).read_text())
    if len(found) != 1:
        raise SystemExit(f"error: {path} has {len(found)} places like {pattern}")
    return float(found[0].replace("_", ""))


# Commands of minutes, as docs/data/made.csv has them: NAME, and of each file that a command writes where it is stored;
# `json` is what it prints.
LONG = {}
for made in rows("made.csv"):
    if made["name"]:
        LONG.setdefault(made["name"], (made["command"], {}))[1][made["of"]] = made["file"]
# What makes the rows of a table by itself, by the same names.
MAKERS = {}


def long(name):
    """Makes the one table that `.ci/pages --long NAME` stores."""
    return lambda make: MAKERS.setdefault(name, make)


class NeedsProgram(Exception):
    """A table that the stored data alone do not make."""


# Set where nothing may be compiled.
stored_only = False


@functools.cache
def programs():
    """The simulator, built; its folder."""
    if stored_only:
        raise NeedsProgram
    run("cargo", "build", "--quiet", "--release", "--package", "host-sim")
    return ROOT / "target/release"


@functools.cache
def sim(arguments, scene=None):
    """What `cargo sim ARGUMENTS --json` says; `scene` is the text of SCENE.toml beside it."""
    return json.loads(said(f"{arguments} --json", scene))


def said(arguments, scene=None, wrote=None):
    """What `cargo sim ARGUMENTS` says, or the text of a file that it writes."""
    with tempfile.TemporaryDirectory() as folder:
        if scene:
            (Path(folder) / "SCENE.toml").write_text(scene)
        ran = shell(f"{programs()}/host-sim {arguments}", folder, env=os.environ | {"ROOT": str(ROOT)})
        if ran.returncode:
            raise SystemExit(f"error: cargo sim {arguments}: {ran.stderr}")
        return (Path(folder) / wrote).read_text() if wrote else ran.stdout


def scene_of(name, **changes):
    """A scene's text with the values of some keys exchanged; of keys that stand in it once."""
    text = (ROOT / f"scenes/{name}.toml").read_text()
    for key, value in changes.items():
        text, n = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
        assert n == 1, (name, key, n)
    return text


def measured(key):
    """What a test has measured, as it stands in docs/data/measured.csv."""
    return row("measured.csv", figure=key)["value"]


def value(key):
    """The same as a number."""
    return float(measured(key))


def number(value, digits=None):
    """With so many digits behind the point; thousands with commas from 10,000 on."""
    text = f"{float(value):.{digits}f}" if digits is not None else f"{float(value):g}"
    if not float(text):
        text = text.removeprefix("-")
    whole, point, rest = text.partition(".")
    return (f"{int(whole):,}" if abs(int(whole)) >= 10_000 else whole) + point + rest


def significant(value, digits):
    """So many significant digits; an exponent where there would be many zeros."""
    value = float(value)
    if abs(value) < 1e-4:
        return power(value, digits) if value else "0"
    return number(value, max(0, digits - 1 - math.floor(math.log10(abs(value)))))


def short(value):
    """Three digits, without zeros at their end."""
    return number(f"{value:.3g}")


def mega(area):
    """An area in 10^6 N^2 s/m^2, three digits."""
    return significant(float(area) / 1e6, 3)


def area_of(r, write=short):
    """In 10^6 N^2 s/m^2; that of a walk which a cap has ended is larger."""
    return ("> " if int(r["capped_walks"]) else "") + write(float(r["area_n2_s_per_m2"]) * 1e-6)


def at_ideal(found):
    """Those of the ideal cutoff, of rows of `sweep --limits`."""
    return [r for r in found if r["cutoff_hz"] == r["ideal_cutoff_hz"]]


def hertz(r, key="cutoff_hz"):
    return f"{float(r[key]):g}"


def said_in(name):
    """Stored JSON."""
    return json.loads((DATA / name).read_text())


def power(value, digits=2):
    """4.3e-5."""
    mantissa, exponent = f"{float(value):.{digits - 1}e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def ms(us):
    return "0" if us < 0.5e-3 else "< 1 us" if us < 1 else f"{us / 1e3:.3f} ms" if us < 1e4 else f"{us / 1e3:.1f} ms"


def table(head, body, right=()):
    """Lines of a table; columns of `right` are aligned there."""
    rule = ["---:" if n in right else "---" for n in range(len(head))]
    return ["| " + " | ".join(map(str, cells)) + " |" for cells in [head, rule, *body]]


# What another build of the image moves, though nothing that it does has changed: cycles by a few per cent, and where in
# an output period a fault's cause falls, so its time by that period and a sample. Budgets are tests of their own.
LOOSE = {"elf/": (0.05, 0.0), "elf/identify_": (0.05, 1e-5), "elf/faults/": (0.05, 1200.0), "elf/flood/": (0.05, 0.06)}
FEW_CYCLES = 8


def same(key, a, b):
    """Equal, or the same number but for what another build or processor moves."""
    relative, absolute = LOOSE[max(starts, key=len)] if (starts := [s for s in LOOSE if key.startswith(s)]) else (1e-6, 0.0)
    if starts and a.isdigit() and b.isdigit():
        absolute = max(absolute, FEW_CYCLES)
    try:
        return a == b or math.isclose(float(a), float(b), rel_tol=relative, abs_tol=absolute)
    except ValueError:
        return False


def take_measured(change):
    """Takes over what tests have left, or says where it differs from what is stored."""
    told = {row["figure"]: {**row, "line": n} for n, row in enumerate(rows("measured.csv"), 2)}
    differences, now = [], commit() if change else ""
    for file in sorted(path for path in LEFT_BY_TESTS.rglob("*") if path.is_file()):
        key, found = str(file.relative_to(LEFT_BY_TESTS)), file.read_text()
        old = told.get(key, {"value": "", "line": 1})
        if not same(key, old["value"], found):
            differences.append(f"docs/data/measured.csv:{old['line']}: {key} is {old['value']}, the test says {found}")
            told[key] = {"figure": key, "value": found, "commit": now}
    if change and differences:
        store("measured.csv", [told[key] for key in sorted(told)], ["figure", "value", "commit"])
    return differences


# Classes of a fault, in the order of `cargo board campaign`.
BOARDS = ["nucleo-f446re", "discovery-f407"]
CLASSES = ["no_effect", "bounded", "off_in_time", "off_late", "unnoticed"]
# Of random flips: `disarm`, sent afterwards, ends nothing.
HEARD = [*CLASSES, "unheard"]


# Ends of a flip in the program in flash, in the same order.
ENDS = ["harmless", "wrong", "other", "late", "unnoticed"]


def campaign(command, files):
    """Runs a campaign of faults and stores what it says of each kind that has a file."""
    def ended(row, counts, ends, *shares):
        """How flips ended, with 95 % intervals of these shares."""
        intervals = {f"{name}_{end}": value for name in shares for end, value in zip(("low", "high"), row[name][1:])}
        return {**row, **{end: row[counts].get(end, 0) for end in ends}, **intervals}

    ran = subprocess.run(f"{command} --json", shell=True, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if not ran.stdout:
        raise SystemExit(ran.returncode)
    # That it found something wrong does not stop it: an error may follow.
    told = json.JSONDecoder().raw_decode(ran.stdout)[0]
    columns = ["board", "name", "situation", "class", "off_s", "speed_m_per_s", "travel_m", "code"]
    tables = {
        "rows": ([row for row in told["rows"] if not row["region"]], [*columns, "reason"]),
        "left": ([row for row in told["rows"] if row["region"] and row["class"] in HEARD[3:]], [*columns, "region"]),
        "random": ([ended(row, "counts", HEARD, "off_late", "unnoticed") | {"region": row["region"] or "all"} for row in told["random"]],
                   ["board", "region", *HEARD, "off_late_low", "off_late_high", "unnoticed_low", "unnoticed_high"]),
        "image": ([ended(row, "ends", ENDS, "wrong") | {"part": row["part"] or "all"} for row in told["image"]],
                  ["board", "part", *ENDS, "wrong_s", "speed_m_per_s", "off_s", "wrong_low", "wrong_high"]),
        "sample": ([ended(row, "counts", CLASSES) for row in told["sample_bits"]], ["board", "setup", "flips", *CLASSES]),
    }
    for kind, name in files.items():
        store(name, *tables[kind])


def run_long(name):
    """Runs it, stores its tables, and notes the commit in docs/data/made.csv."""
    command, files = LONG[name]
    if name in MAKERS:
        store(*files.values(), MAKERS[name]())
    elif command.startswith("cargo board walk"):
        subprocess.run(f"{command} --force --csv {DATA / files['csv']}", shell=True, cwd=ROOT, check=True)
    elif command.startswith("cargo board"):
        campaign(command, files)
    else:
        simulated(command, files)
    note_made(files.values())


def simulated(command, files):
    """Runs the simulator and stores what it writes."""
    with tempfile.TemporaryDirectory() as folder:
        words = command.removeprefix("cargo sim ").replace("docs/data/", f"{DATA}/")
        told = json.loads(run(f"{programs()}/host-sim {words} --json --out {folder}/out", shell=True))
        for made, stored in files.items():
            if made == "json":
                told = {key: value for key, value in told.items() if key in KEPT}
                (DATA / stored).write_text(json.dumps(told, indent=1) + "\n")
            else:
                shutil.copy(f"{folder}/out/{made}", DATA / stored)


def note_made(files):
    """Says in docs/data/made.csv of which commit these files are."""
    store("made.csv", [made | {"commit": commit()} if made["file"] in files else made for made in rows("made.csv")])
