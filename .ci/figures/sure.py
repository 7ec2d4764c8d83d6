"""How faithful and how sure walls are, and what the port gives."""

import json

from . import block, slots, states
from .simulator import linear
from .source import DATA, constant, measured, number, rows, significant, table

USABLE = "usable-paper-1um.csv"
LIMITS = ("", "20", "10", "5")


@block
def theory_port():
    by_k = linear("paper-1um --cutoffs 1500 --dampings 1,2,3,4 --multirate --passivity")
    return table(["B, N s/m", *(f"{b:g}" for b in by_k)],
                 [["passive up to, N/m", *(number(r["stiffness_passive_n_per_m"], 0) for r in by_k.values())]])


def usable(limit, name=USABLE):
    """Rows of one limit, by place."""
    return sorted((r for r in rows(name) if r["within_percent"] == limit), key=lambda r: int(r["place"]))


def millions(r, key="area_n2_s_per_m2"):
    cut = "> " if int(r["capped_walks"]) else ""
    return cut + number(float(f"{float(r[key]) * 1e-6:.3g}"))


def usable_row(estimator, limit, name=USABLE):
    return next(r for r in usable(limit, name) if r["estimator"] == estimator)


@block
def comparison_usable(name):
    found = f"usable-{name}.csv"
    def cell(estimator, limit):
        r = usable_row(estimator, limit, found)
        return f"{millions(r)} ({r['place']}.)"
    return table(
        ["estimator", *("any error" if limit == "" else f"within {limit} %" for limit in LIMITS), "peak K, any error, kN/m",
         "mean error of those walls, %"],
        [[f"`{r['estimator']}`", *(cell(r["estimator"], limit) for limit in LIMITS),
          number(float(r["stiffness_peak_n_per_m"]) / 1e3, 1), significant(100 * float(r["impedance_error_mean"]), 2)]
         for r in usable("", found)])


def order(limit, name):
    return [r["estimator"] for r in usable(limit, name)]


CAPS = "usable-paper-1um-caps-doubled.csv"
SURE = {"paper-1um": "probability-paper-1um.json", "paper-2um": "probability-paper-2um.json",
        "uncertain": "probability-paper-2um-uncertain.json"}


def sure(name):
    return json.loads((DATA / SURE[name]).read_text())


def area(c, key):
    return significant(c[key] * 1e-6, 3)


@block
def theory_sure(name):
    said = sure(name)
    return table(
        ["cutoff, Hz", "walks, mean area", "integral of the share", "5 %", "50 %", "95 %", "best for", "ideal for",
         "cells undecided"],
        [[f"{c['cutoff_hz']:g}", area(w, "area_n2_s_per_m2"), area(c, "area_n2_s_per_m2"),
          *(area(c, f"area_{n}_percent_n2_s_per_m2") for n in (5, 50, 95)),
          *(f"{100 * c[f'{key}_share']:.0f} %" for key in ("best", "ideal", "undecided"))]
         for c, w in zip(said["probability"]["cutoffs"], said["cutoffs"]) if c["cutoff_hz"] >= 500])


@block
def theory_contour():
    body = []
    for text, name in (("paper-1um, 16 starts", "paper-1um"), ("paper-2um, 16 starts", "paper-2um"),
                       ("paper-2um, uncertain devices", "uncertain")):
        p = sure(name)["probability"]
        c = p["contour"]
        body.append([text, f"{p['recommended_cutoff_hz']:g}", number(c["length"], 2), str(c["draws"]),
                     f"{100 * c['share']:.1f} % ({100 * c['share_low']:.1f} to {100 * c['share_high']:.1f} %)"])
    return table(["who is drawn", "recommended cutoff, Hz", "length of the fitted contour", "fresh draws along it",
                  "of them hold (95 % interval)"], body)


states(
    "docs/theory.md",
    ("each interval contains the 95 % that it is for",
     lambda: all(c["share_low"] <= 0.95 <= c["share_high"] for c in (sure(name)["probability"]["contour"] for name in SURE))),
)


HAND = "usable-paper-1um-hand.csv"


def error(estimator, name=USABLE):
    return float(usable_row(estimator, "", name)["impedance_error_mean"])


def peaks(name):
    """Largest stable K of all but the observer."""
    return {r["estimator"]: float(r["stiffness_peak_n_per_m"]) for r in usable("", name) if r["estimator"] != "observer"}


def observer_gains():
    gains = [[float(usable_row("observer", limit, name)["area_n2_s_per_m2"]) / float(usable_row("kalman-3", limit, name)["area_n2_s_per_m2"])
              for limit in ("5", "10", "20")] for name in (USABLE, HAND)]
    light = all(float(usable_row("observer", limit, name)["second"]) < 0.416 for name in (USABLE, HAND) for limit in ("5", "10", "20"))
    return light and all(1 < a < b < c for a, b, c in gains)


states(
    "docs/comparison.md",
    ("the order within each of the three limits stays what it is.",
     lambda: all(order(limit, USABLE) == order(limit, CAPS) for limit in ("5", "10", "20"))),
    ("| Levant's form is stiffest | yes, shared with `kalman-3` | no, it is the softest |",
     lambda: {n for n, k in peaks(USABLE).items() if k == max(peaks(USABLE).values())} == {"levant-explicit", "kalman-3"}
     and min(peaks(HAND), key=peaks(HAND).get) == "levant-explicit"),
    ("| adaptive windowing is most faithful | no | no |",
     lambda: all(error(a, name) > error(b, name) for a in ("foaw-end", "foaw-best") for b in ("kalman-3", "least-squares-2")
                 for name in (USABLE, HAND))),
    ("The observer is first within each limit, too.",
     lambda: all(order(limit, name)[0] == "observer" for limit in ("5", "10", "20") for name in (USABLE, HAND))),
    ("what it gains over `kalman-3` grows with the error that it may make.", observer_gains),
)

slots(
    "docs/identification.md",
    ("Over {} records of the paper's device with noise of 0.5 counts, the", lambda: constant("tests/host/identify_joint.rs", r"const RECORDS: u64 = (\d+);")),
    ("within {} of the stated one;", lambda: number(float(measured("host/identify/correlation_off")), 2)),
)
