"""How faithful and how sure walls are, and what the port gives."""

from . import block
from .simulator import by_damping
from .source import mega, number, said_in, table


@block()
def theory_port():
    by = by_damping("paper-1um --cutoffs 1500 --dampings 1,2,3,4 --passivity")
    return table(["B, N s/m", *(f"{b:g}" for b in by)],
                 [["passive up to, N/m", *(number(r["stiffness_passive_n_per_m"], 0) for r in by.values())]])


SURE = {"paper-1um": "probability-paper-1um.json", "paper-2um": "probability-paper-2um.json",
        "uncertain": "probability-paper-2um-uncertain.json"}


@block("cutoff, Hz", "walks, mean area", "integral of the share", "5 %", "its interval", "50 %", "95 %", "leads, or not told apart",
       "best for", "ideal for", "cells undecided")
def theory_sure(name):
    said = said_in(SURE[name])
    for c, walk in zip(said["probability"]["cutoffs"], said["cutoffs"]):
        if c["cutoff_hz"] < 500:
            continue
        ends = [c[f"area_5_percent_{end}_n2_s_per_m2"] for end in ("low", "high")]
        interval = "" if ends == [None, None] else " to ".join("?" if end is None else mega(end) for end in ends)
        yield (f"{c['cutoff_hz']:g}", mega(walk["area_n2_s_per_m2"]), mega(c["area_n2_s_per_m2"]),
               mega(c["area_5_percent_n2_s_per_m2"]), interval, *(mega(c[f"area_{n}_percent_n2_s_per_m2"]) for n in (50, 95)),
               "yes" if c["cutoff_hz"] in said["probability"]["alike_hz"] else "",
               *(f"{100 * c[f'{key}_share']:.0f} %" for key in ("best", "ideal", "undecided")))


@block("who is drawn", "cutoff that leads, Hz", "length of the fitted contour", "fresh draws along it", "of them hold (95 % interval)")
def theory_contour():
    for text, name in (("paper-1um, 16 starts", "paper-1um"), ("paper-2um, 16 starts", "paper-2um"),
                       ("paper-2um, uncertain devices", "uncertain")):
        c = said_in(SURE[name])["probability"]["contour"]
        share, low, high = (f"{100 * c[key]:.1f}" for key in ("share", "share_low", "share_high"))
        yield text, f"{c['cutoff_hz']:g}", number(c["length"], 2), c["draws"], f"{share} % ({low} to {high} %)"
