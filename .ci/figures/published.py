"""The published order of the estimators."""

from . import block
from .estimators import of
from .source import table

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
