"""Coefficients of the second-order Butterworth low-pass: butterworth.csv and butterworth_prewarped.csv.

    H(s) = w^2 / (s^2 + sqrt(2) w s + w^2),   s = 2 rate (z - 1) / (z + 1)
    H(z) = (b0 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2)

butterworth.csv: the paper's eq. (2) with 2 sqrt(2) where it prints 2.8: w = 2 pi cutoff, not pre-warped.
butterworth_prewarped.csv: w = 2 rate tan(pi cutoff / rate), so that the -3 dB frequency is the cutoff.
true_cutoff_hz is where |H|^2 = 1/2.

The values come from mpmath in 50 digits, because SciPy in doubles loses them at low cutoffs (b0 is what is
left of 1 + a1 + a2). Where SciPy is accurate, from cutoff = SCIPY_FROM rate up, `scipy.signal.bilinear`
(and `butter` for the pre-warped file) must agree to SCIPY_AGREES; below, to what the cancellation leaves.
|H|^2 at true_cutoff_hz and H(0) = 1 are asserted in 40 digits.

Made with Python 3, mpmath 1.3.0, SciPy 1.17.1, NumPy 2.4.6. Deterministic: run `python3 butterworth.py` here.
"""

import csv
from mpmath import mp, mpf, atan, expj, nstr, pi, sqrt, tan
from scipy import signal

mp.dps = 50
DIGITS = 17
RATES = (1000.0, 10000.0, 50000.0)
LOWEST, HIGHEST, COUNT = 2.43e-5, 0.49, 40  # of the rate; the lowest is what the fixed-point core accepts
FIELD = (20.0, 50.0, 100.0, 200.0, 300.0, 500.0, 700.0, 1000.0, 1200.0, 1500.0, 1700.0, 2000.0, 2500.0, 3000.0, 4000.0)
SCIPY_FROM = 1e-3
SCIPY_AGREES = 1e-9  # relative, of b0: doubles leave 1e-16 / (2 pi 1e-3)^2 = 3e-12 of it


def coefficients(rate, omega):
    """Bilinear transform of H(s) at w = omega rad/s; exact algebra, T w = w here."""
    w = omega / rate
    a0 = 4 + 2 * sqrt(mpf(2)) * w + w * w
    b0 = w * w / a0
    return b0, 2 * b0, b0, (2 * w * w - 8) / a0, (4 - 2 * sqrt(mpf(2)) * w + w * w) / a0


def check(rate, cutoff, values, true_cutoff, prewarp):
    b0, b1, b2, a1, a2 = values

    def h(hz):
        back = 1 / expj(2 * pi * hz / rate)
        return (b0 + b1 * back + b2 * back**2) / (1 + a1 * back + a2 * back**2)

    assert abs(abs(h(true_cutoff)) ** 2 - mpf(1) / 2) < mpf(10) ** -38
    assert abs(h(mpf(0)) - 1) < mpf(10) ** -38
    if prewarp:
        b, a = signal.butter(2, cutoff, fs=rate)
    else:
        w = float(2 * pi * cutoff)
        b, a = signal.bilinear([w * w], [1.0, float(sqrt(mpf(2))) * w, w * w], fs=rate)
    agrees = SCIPY_AGREES if cutoff >= SCIPY_FROM * rate else 1e-15 / (6.28 * cutoff / rate) ** 2
    for ours, theirs in zip(values, list(b) + list(a)[1:]):
        # a1 passes through 0 at a quarter of the rate
        assert abs(ours - mpf(theirs)) <= agrees * max(abs(ours), b0), (rate, cutoff, prewarp, ours, theirs)


def write(name, prewarp):
    with open(name, "w", newline="") as out:
        rows = csv.writer(out, lineterminator="\n")
        rows.writerow("rate_hz,cutoff_hz,b0,b1,b2,a1,a2,true_cutoff_hz".split(","))
        for rate in RATES:
            grid = [rate * LOWEST * (HIGHEST / LOWEST) ** (i / (COUNT - 1)) for i in range(COUNT)]
            for cutoff in sorted(set(grid + [hz for hz in FIELD if hz < HIGHEST * rate])):
                hz, fs = mpf(cutoff), mpf(rate)
                omega = 2 * fs * tan(pi * hz / fs) if prewarp else 2 * pi * hz
                true_cutoff = fs / pi * atan(omega / (2 * fs))
                values = coefficients(fs, omega)
                check(rate, cutoff, values, true_cutoff, prewarp)
                rows.writerow([repr(rate), repr(cutoff)] + [nstr(v, DIGITS) for v in (*values, true_cutoff)])


if __name__ == "__main__":
    write("butterworth.csv", False)
    write("butterworth_prewarped.csv", True)
