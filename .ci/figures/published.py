"""The published order of the estimators."""

from . import block
from .estimators import of


@block("peak K over that of the filter of 50 Hz", "Levant", "windowing", "Kalman")
def comparison_published():
    def peak(name):
        return float(of("paper-1um", name)["stiffness_peak_mean_n_per_m"])

    pairs = [("levant-explicit", "levant-implicit"), ("foaw-end", "foaw-best"), ("kalman-2", "kalman-3")]
    yield "published", "2.07", "1.93", "1.33"
    yield "each tuned, no filter behind it", *(
        ", ".join(f"{peak(name) / peak('first-order at 50 Hz'):.1f} {name}" for name in pair) for pair in pairs)
