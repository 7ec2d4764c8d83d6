"""How faithful and how sure walls are, and what the port gives."""

from . import block
from .simulator import by_damping
from .source import mega, number, table


@block()
def theory_port():
    by = by_damping("paper-1um --cutoffs 1500 --dampings 1,2,3,4 --passivity")
    return table(["B, N s/m", *(f"{b:g}" for b in by)],
                 [["passive up to, N/m", *(number(r["stiffness_passive_n_per_m"], 0) for r in by.values())]])


def interval(r):
    """Of the area with 5 %, where it has one."""
    ends = [r[f"area_5_percent_{end}_n2_s_per_m2"] for end in ("low", "high")]
    return "" if ends == ["", ""] else " to ".join("?" if end == "" else mega(end) for end in ends)
