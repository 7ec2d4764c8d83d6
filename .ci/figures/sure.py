"""How faithful and how sure walls are, and what the port gives."""

from . import block
from .simulator import linear
from .source import area_of, number, row, rows_of, said_in, significant, table

LIMITS = ("", "20", "10", "5")


@block
def theory_port():
    by_k = linear("paper-1um --cutoffs 1500 --dampings 1,2,3,4 --multirate --passivity")
    return table(["B, N s/m", *(f"{b:g}" for b in by_k)],
                 [["passive up to, N/m", *(number(r["stiffness_passive_n_per_m"], 0) for r in by_k.values())]])


@block
def comparison_usable(name):
    found = f"usable-{name}.csv"
    def cell(estimator, limit):
        r = row(found, estimator=estimator, within_percent=limit)
        return f"{area_of(r)} ({r['place']}.)"
    return table(
        ["estimator", *("any error" if limit == "" else f"within {limit} %" for limit in LIMITS), "peak K, any error, kN/m",
         "mean error of those walls, %"],
        [[f"`{r['estimator']}`", *(cell(r["estimator"], limit) for limit in LIMITS),
          number(float(r["stiffness_peak_n_per_m"]) / 1e3, 1), significant(100 * float(r["impedance_error_mean"]), 2)]
         for r in sorted(rows_of(found, within_percent=""), key=lambda r: int(r["place"]))])


SURE = {"paper-1um": "probability-paper-1um.json", "paper-2um": "probability-paper-2um.json",
        "uncertain": "probability-paper-2um-uncertain.json"}


def area(c, key):
    return significant(c[key] * 1e-6, 3)


@block
def theory_sure(name):
    said = said_in(SURE[name])
    alike = said["probability"]["alike_hz"]

    def interval(c):
        ends = [c[f"area_5_percent_{end}_n2_s_per_m2"] for end in ("low", "high")]
        return "" if ends == [None, None] else " to ".join("?" if end is None else significant(end * 1e-6, 3) for end in ends)

    return table(
        ["cutoff, Hz", "walks, mean area", "integral of the share", "5 %", "its interval", "50 %", "95 %", "leads, or not told apart",
         "best for", "ideal for", "cells undecided"],
        [[f"{c['cutoff_hz']:g}", area(w, "area_n2_s_per_m2"), area(c, "area_n2_s_per_m2"),
          area(c, "area_5_percent_n2_s_per_m2"), interval(c),
          *(area(c, f"area_{n}_percent_n2_s_per_m2") for n in (50, 95)), "yes" if c["cutoff_hz"] in alike else "",
          *(f"{100 * c[f'{key}_share']:.0f} %" for key in ("best", "ideal", "undecided"))]
         for c, w in zip(said["probability"]["cutoffs"], said["cutoffs"]) if c["cutoff_hz"] >= 500])


@block
def theory_contour():
    body = []
    for text, name in (("paper-1um, 16 starts", "paper-1um"), ("paper-2um, 16 starts", "paper-2um"),
                       ("paper-2um, uncertain devices", "uncertain")):
        p = said_in(SURE[name])["probability"]
        c = p["contour"]
        body.append([text, f"{c['cutoff_hz']:g}", number(c["length"], 2), str(c["draws"]),
                     f"{100 * c['share']:.1f} % ({100 * c['share_low']:.1f} to {100 * c['share_high']:.1f} %)"])
    return table(["who is drawn", "cutoff that leads, Hz", "length of the fitted contour", "fresh draws along it",
                  "of them hold (95 % interval)"], body)
