"""The published order of the estimators, and what the position of an estimator does to the walls."""

import itertools
import statistics
import tempfile
from pathlib import Path

from . import block
from .estimators import f, left, of, range_of, share, tuned
from .source import LONG, note_made, programs, rows, shell, store, table

STUDENTS = "students.csv"
COMMAND = "cargo sim study docs/data/students.toml --out students"
VARIED = ["friction.coulomb_n_m", "rotary.start_angle_rad", "wall_hit.push_n_m"]
BOUND = "walk.damping_max_n_m_s_per_rad"
PEAK, LARGEST = "stiffness_peak_n_m_per_rad", "damping_max_n_m_s_per_rad"


def walked():
    """The study's parts, one behind the other."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "students"
        done = shell(f"{programs() / 'host-sim'} study docs/data/students.toml --out {out}", check=True)
        print(done.stdout.strip())
        parts = [part.read_text().splitlines() for part in sorted(out.glob("part-*.csv"))]
    columns = parts[0][0].split(",")
    body = [dict(zip(columns, line.split(","), strict=True)) for part in parts for line in part[1:]]
    store(STUDENTS, body, ["estimator", *VARIED, BOUND, PEAK, LARGEST, "hits", "ended_by"])
    note_made(COMMAND, {"study": STUDENTS})


LONG["students"] = (COMMAND, {"study": STUDENTS}, walked)


def ratios():
    """For each condition: K near B = 0, peak K and largest B of the extrapolated position over the count's; none if no wall holds."""
    found = {(r["estimator"], r[BOUND], *[r[key] for key in VARIED]): r for r in rows(STUDENTS)}
    small, large = sorted({r[BOUND] for r in rows(STUDENTS)}, key=float)
    conditions = itertools.product(*[sorted({r[key] for r in rows(STUDENTS)}, key=float) for key in VARIED])
    made = {}
    for condition in conditions:
        pairs = [[found[name, bound, *condition][key] for name in ("first-order-position", "first-order")]
                 for bound, key in ((small, PEAK), (large, PEAK), (large, LARGEST))]
        made[condition] = [float(a) / float(b) for a, b in pairs] if all(b and float(b) > 0 for _, b in pairs) else None
    return made


def held():
    return [each for each in ratios().values() if each]


def middle(n):
    return statistics.median(each[n] for each in held())


@block
def comparison_students():
    def said(n):
        values = [each[n] for each in held()]
        return f"{middle(n):.2f} ({min(values):.2f} to {max(values):.2f})"
    return table(["over the filter of 50 Hz alone", "K near B = 0", "peak K", "largest B"],
                 [["published", "3.00", "1.93", "1.13"], ["here, median (smallest to largest)", *map(said, range(3))]])


PUBLISHED = [("2.07", ["levant-explicit", "levant-implicit"]), ("1.93", ["foaw-end", "foaw-best"]), ("1.33", ["kalman-2", "kalman-3"])]


@block
def comparison_published():
    base = float(of("paper-1um", "first-order at 50 Hz")["stiffness_peak_mean_n_per_m"])

    def here(names):
        each = [float(of("paper-1um", n)["stiffness_peak_mean_n_per_m"]) / base for n in names]
        return ", ".join(f"{ratio:.1f} {name}" for ratio, name in zip(each, names, strict=True))
    return table(["peak K over that of the filter of 50 Hz", "Levant", "windowing", "Kalman"],
                 [["published", *[value for value, _ in PUBLISHED]],
                  ["each tuned, no filter behind it", *[here(names) for _, names in PUBLISHED]]])


def placed(scene):
    return rows(f"compare-{scene}-position.csv")


@block
def comparison_position(scene):
    head = ["estimator", "tuning, second parameter", "area, 10^6 N^2 s/m^2 (lowest to highest)", "of the true velocity's, %",
            "area left at -3 dB /1.2, x1.2, %", "impedance error, %", "force above 100 Hz, mN (lowest to highest)"]
    return table(head, [
        [r["estimator"], tuned(r), range_of(r, "area_n2_s_per_m2", 1e-6, 1), share(r), left(r), f(r, "impedance_error", 100, 2),
         range_of(r, "roughness_n", 1e3, 0)] for r in placed(scene)])
