"""Speed against accuracy, and where the arithmetic ends: tables made of what `trade` and a bench have stored."""

import math

from . import block
from .source import power, rows, said_in, significant, table

def response(r):
    """What a filter gets wrong, %, or why there is none."""
    return r["refused"] or (significant(100 * float(r["response_error"]), 2) if r["response_error"] else "-")


def missed(r):
    """What keeps a filter from doing just below its cutoffs."""
    return "refused" if r["refused_below"] else ", ".join(name for key, name in r.items() if key.startswith("missed_below."))


METHODS = {"exact": "exact", "semi-implicit-euler": "semi-implicit Euler", "rk4": "RK4", "dormand-prince": "Dormand-Prince"}


def method_and_setting(r):
    """In this order: a tolerance falls, steps grow."""
    return list(METHODS).index(r["method"]), float(r["setting"] or 0) * (-1 if r["method"] == "dormand-prince" else 1)


@block("method", "operations per simulated s", "trajectory off by, m", "verdicts that differ", "area changes by")
def trade_plant(name):
    for r in sorted(rows(f"trade-plant-{name}.csv"), key=method_and_setting):
        what, steps = METHODS[r["method"]], float(r["setting"] or 0)
        if r["method"] == "dormand-prince":
            what += f", tolerance {power(steps, 1)}"
        elif steps:
            what += f", {steps:g} step{'s' if steps > 1 else ''} per sample"
        if r["refused"]:
            yield what, r["refused"], "", "", ""
            continue
        off_m, change = float(r["trajectory_error_m"] or 0), r["area_change"]
        yield (what, power(r["operations_per_s"]) if r["operations_per_s"] else "-", power(off_m) if off_m else "0",
               f"{r['verdicts_wrong']} of {r['verdicts']}",
               "-" if not change else "0" if float(change) == 0 else f"{100 * float(change):+.1f} %")
    told = said_in(f"trade-{name}.json")["plant"]
    yield ("exact, start moved by a quarter of a count", "-", "-", f"{told['verdicts_chaotic']} of {told['verdicts']}",
           f"{100 * told['area_chaotic']:.1f} %")


@block("Q15 on `paper-1um`", "value")
def trade_q15():
    full_scale = said_in("trade-paper-1um.json")["q15_full_scale_m_per_s"]
    w = math.pi * 20.0 / 1e4  # paper's equation (2), not pre-warped
    b0 = w * w / (1 + math.sqrt(2) * w + w * w)
    yield "full scale, m/s", significant(full_scale, 3)
    yield "speed of impact without damping, and with it, m/s", ", ".join(significant(impact(b), 2) for b in (0.0, 5.5195))
    yield "LSB of the velocity, um/s", significant(full_scale / 2**15 * 1e6, 2)
    yield "`b0` at 20 Hz, in LSB of 2^-14, the format of its coefficients", significant(b0 * 2**14, 2)


def impact(damping):
    """Speed at 0.07 m of the paper's device, pushed with 2.835 N from 0, by small steps."""
    x = v = 0.0
    while x < 0.07:
        v += 1e-6 * (2.835 - damping * v - 11.0626 * (x - 0.0517)) / 0.416
        x += 1e-6 * v
    return v


@block()
def extremes_verdicts():
    pairs = rows("docs/figures/fixed-point-limits.csv")
    body = []
    for name, key in [("the core", "differ_fixed"), ("exact, its velocity rounded to the core's LSB", "differ_rounded_velocity")]:
        worst = max(pairs, key=lambda r: int(r[key]) / int(r["walls"]))
        where = f"{float(worst['resolution_m']) * 1e6:g} um, {float(worst['cutoff_hz']):g} Hz"
        body.append([name, f"{100 * int(worst[key]) / int(worst['walls']):.1f} % ({where})", sum(int(r[key]) == 0 for r in pairs)])
    few = sum(int(r["walls"]) - int(r["stable"]) < 6 for r in pairs)
    head = ["arithmetic", f"verdicts that differ from exact arithmetic, of {pairs[0]['walls']} walls, at most",
            f"pairs of resolution and cutoff without any, of {len(pairs)}"]
    return [*table(head, body), "", f"Pairs with fewer than six unstable walls: {few}."]
