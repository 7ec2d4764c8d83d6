# %% [markdown]
# # Estimators on recorded counts
#
# Velocity estimators of the control core over the counts of a recorded session: what each would have said, its noise
# near rest and its delay, both measured from the record. `python recorded_counts.py --out FOLDER` writes
# `gallery-recorded-counts.png` there and prints the table of the page. `--capture FILE` takes another record, in
# which the handle moves and then comes to rest.

# %%
import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator
from PIL import Image
from scipy.optimize import minimize_scalar
from scipy.signal import savgol_filter

import zwidth

NOTEBOOK = "ipykernel" in sys.modules
HERE = Path(__file__).resolve().parent if "__file__" in globals() else Path.cwd()
options = argparse.ArgumentParser(description="Velocity estimators over recorded counts: noise and delay.")
options.add_argument(
    "--capture",
    type=Path,
    default=HERE.parents[1] / "examples/samples.bin",
    metavar="FILE",
    help="telemetry with the counts of all samples, default: examples/samples.bin",
)
options.add_argument("--scene", default="paper-1um", help="the device's scene, default: paper-1um")
options.add_argument("--out", type=Path, default=Path("."), metavar="FOLDER", help="where the PNG goes, default: here")
options.add_argument("--show", action="store_true", help="open a window, too")
asked = options.parse_args([] if NOTEBOOK else None)
if not asked.out.is_dir():
    options.error(f"--out {asked.out}: there is no such folder")
if not (asked.show or NOTEBOOK):
    plt.switch_backend("Agg")

# %% [markdown]
# ## The record, and a reference
#
# The reference is the derivative of cubic polynomials that are fitted to the counts from both sides of each sample: 3
# ms to each side while the handle moves, 50 ms near rest. It looks into the future, so it has no delay; no controller
# could have it.

# %%
scene = zwidth.Scene.load(asked.scene)
told = zwidth.Telemetry.load(asked.capture)
counts = told.samples.position_counts
time_s = np.arange(len(counts)) / told.rate_hz


def reference(window_s):
    samples = 2 * round(window_s * told.rate_hz) + 1
    return savgol_filter(counts * told.resolution_m, samples, 3, deriv=1, delta=1 / told.rate_hz)


moving, resting = reference(3e-3), reference(50e-3)
fast = np.abs(moving) > 0.01  # m/s
rest = time_s > time_s[-1] - 0.5  # the last half second

# %% [markdown]
# ## Estimators
#
# *Noise*: RMS of the estimate about the reference over the last half second. *Delay*: the shift of the reference that
# leaves the least RMS of the difference, over all samples faster than 10 mm/s.


# %%
def measure(name, **tuning):
    velocity = zwidth.Estimator(name, scene, **tuning).process(counts)
    noise = np.sqrt(np.mean((velocity - resting)[rest] ** 2))

    def left(delay_s):
        return np.mean((velocity[fast] - np.interp(time_s[fast] - delay_s, time_s, moving)) ** 2)

    return velocity, noise, minimize_scalar(left, bounds=(-5e-3, 5e-3), method="bounded").x


families = {
    "butterworth": [{"cutoff": hz} for hz in (100, 200, 500, 1000, 1500, 3000)],
    "first-order": [{"cutoff": hz} for hz in (100, 200, 500, 1000, 1500, 3000)],
    "least-squares-1": [{"window_samples": n} for n in (4, 8, 16, 32, 64)],
    "foaw-best": [{"window_samples": n} for n in (4, 8, 16, 32)],
    "kalman-3": [{"jerk_rms_m_per_s3": 10.0**n} for n in (1, 2, 3, 4, 5)],
    "levant-explicit": [{"acceleration_max_m_per_s2": a} for a in (10, 15, 20, 30, 50)],
}
measured = {name: [measure(name, **tuning) for tuning in tunings] for name, tunings in families.items()}
chosen = {  # family and place in it
    "butterworth, 1500 Hz": ("butterworth", 4),
    "butterworth, 200 Hz": ("butterworth", 1),
    "least-squares-1, 32 samples": ("least-squares-1", 3),
    "foaw-best, 32 samples": ("foaw-best", 3),
    "kalman-3, 1000 m/s^3": ("kalman-3", 2),
}

# %%
figure, ((whole, trade), (hit, slow)) = plt.subplots(2, 2, figsize=(9, 7), dpi=130, layout="constrained")
colours = dict(zip(families, plt.colormaps["tab10"].colors, strict=False))
first = time_s[np.argmax(np.abs(moving))]
for axes, (begin, end), unit in ((hit, (first - 0.01, first + 0.03), 1), (slow, (time_s[-1] - 0.05, time_s[-1]), 1e3)):
    seen = (time_s > begin) & (time_s < end)
    for label, (name, place) in chosen.items():
        velocity, *_ = measured[name][place]
        style = ":" if label == "butterworth, 200 Hz" else "-"
        axes.plot(time_s[seen], unit * velocity[seen], style, lw=1.2, color=colours[name], label=label)
    axes.plot(time_s[seen], unit * (moving if unit == 1 else resting)[seen], "k--", lw=1, label="reference")
whole.plot(time_s, counts * told.resolution_m * 1e3, color="k", lw=1)
whole.set(xlabel="Time [s]", ylabel="Position [mm]", title="The record")
hit.set(xlabel="Time [s]", ylabel="Velocity [m/s]", title="A hit")
slow.set(xlabel="Time [s]", ylabel="Velocity [mm/s]", title="Near rest")
for name, points in measured.items():
    trade.plot([1e3 * p[2] for p in points], [1e3 * p[1] for p in points], "o-", ms=3, color=colours[name], label=name)
trade.set(yscale="log", xlabel="Delay [ms]", ylabel="Noise near rest [mm/s]", title="Noise and delay, by tuning")
trade.yaxis.set_major_locator(LogLocator(subs=(1, 3)))
trade.yaxis.set_major_formatter("{x:g}")
trade.minorticks_off()
trade.legend(fontsize=8)
hit.legend(fontsize=8)
for axes in (whole, trade, hit, slow):
    axes.grid(color="0.9")
png = asked.out / "gallery-recorded-counts.png"
figure.savefig(png)
Image.open(png).convert("RGB").quantize(128).save(png, optimize=True)  # a third of the bytes

# %%
print("| estimator | noise near rest, mm/s | delay, ms |\n|---|---|---|")
for label, (name, place) in chosen.items():
    _, noise, delay = measured[name][place]
    print(f"| {label} | {noise * 1e3:.2f} | {delay * 1e3:.2f} |")
if asked.show or NOTEBOOK:
    plt.show()
