# %% [markdown]
# # An own device
#
# A slider of one's own, from mass, damping, encoder and actuator to the walls that it can hold, and what limits them.
# `python own_device.py --out FOLDER` writes `gallery-own-device.png` there and prints the tables of the page.
# `--scene FILE` takes another device.

# %%
import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator
from PIL import Image

import zwidth

NOTEBOOK = "ipykernel" in sys.modules
options = argparse.ArgumentParser(description="The walls that an own device can hold, and what limits them.")
options.add_argument("--scene", metavar="FILE", help="a scene file, default: the slider of this script")
options.add_argument("--out", type=Path, default=Path("."), metavar="FOLDER", help="where the PNG goes, default: here")
options.add_argument("--show", action="store_true", help="open a window, too")
asked = options.parse_args([] if NOTEBOOK else None)
if not asked.out.is_dir():
    options.error(f"--out {asked.out}: there is no such folder")
if not (asked.show or NOTEBOOK):
    plt.switch_backend("Agg")

# %% [markdown]
# ## The device
#
# The text is that of a scene file. Its numbers are an example: no such device was measured.

# %%
SLIDER = """
device = { mass_kg = 0.15, damping_n_s_per_m = 1.2, stiffness_n_per_m = 0, rest_position_m = 0, start_position_m = 0 }
encoder = { resolution_m = 5e-6, rounding = "floor" }
actuator = { gain_n_per_v = 1.2, limit_v = 5, period = 5, latency = 5 }     # period and latency in samples
control = { rate_hz = 10000 }
velocity = { estimator = "butterworth" }
wall = { position_m = 0.02, push_only = true }
wall_hit = { push_n = 1, settle_s = 1, window_s = 0.5, rms_limit_m = 1e-5 } # stable: RMS of the position below this
sweep = { cutoffs_hz = [100, 200, 300, 500, 700, 1000, 1500, 2000, 3000] }
[walk]
stiffness_start_n_per_m = 500
stiffness_step_n_per_m = 500
stiffness_max_n_per_m = 1e6
damping_start_n_s_per_m = 2
damping_step_n_s_per_m = 2
damping_max_n_s_per_m = 1000
"""
device = zwidth.Scene.load(asked.scene) if asked.scene else zwidth.Scene.parse(SLIDER, "slider")
resolution_m = device.to_dict()["encoder"]["resolution_m"]

# %% [markdown]
# ## One element, swept
#
# Encoders of twice to a quarter of the device's counts, each with a sweep over the cutoffs.

# %%
sweeps = {}
for factor in (2, 1, 0.5, 0.25):
    encoder = {"encoder.resolution_m": factor * resolution_m}
    sweeps[f"{factor * resolution_m * 1e6:g}"] = zwidth.sweep(device.replace(encoder))

# %% [markdown]
# ## What limits the walls
#
# One element is changed at a time, and the velocity filter is tuned anew for each. Steps of the walk that are six
# times as coarse and two starts make it quick.

# %%
coarse = {f"walk.{name}": 6 * step for name, step in device.to_dict()["walk"].items() if "_step_" in name}
found = zwidth.explain(device.replace(coarse), criterion="rms", repeat=2)
first = np.argsort(-found.table["times_the_area"], kind="stable")[:8]  # what has none comes last
changes = [[found.table[key][n] for key in ("what", "times_the_area", "times_low", "times_high")] for n in first]

# %%
figure = plt.figure(figsize=(9, 7), dpi=130, layout="constrained")
upper, lower = figure.subfigures(2, 1, height_ratios=[1.2, 1])
(areas, boundary), factors = upper.subplots(1, 2), lower.subplots()
colours = plt.colormaps["viridis"](np.linspace(0.0, 0.8, len(sweeps)))
rows = []
for (encoder, study), colour in zip(sweeps.items(), colours, strict=True):
    if study.ideal_cutoff_hz is None:
        sys.exit(f"error: an encoder of {encoder} um has no stable wall; [walk] may begin at another one")
    walk = study.walks[list(study.cutoffs_hz).index(study.ideal_cutoff_hz)][0]
    values = study.ideal_cutoff_hz, walk.stiffness_peak_n_per_m / 1e3, walk.damping_max_n_s_per_m
    rows.append("| {} | {:.0f} | {:.1f} | {:.0f} |".format(encoder, *values))
    areas.plot(study.cutoffs_hz, study.area / 1e6, "o-", ms=3, color=colour, label=f"{encoder} um")
    label = f"{encoder} um, {study.ideal_cutoff_hz:.0f} Hz"
    boundary.plot(walk.damping_n_s_per_m, walk.stiffness_n_per_m / 1e3, color=colour, label=label)
areas.set(xscale="log", ylim=(0, None), xlabel="Cutoff [Hz]", ylabel="Area [10$^6$ N$^2$ s/m$^2$]")
areas.set_title("Area of the stable walls")
areas.legend(title="Encoder")
boundary.set(xlim=(0, None), xlabel="Damping B [N s/m]", ylabel="Stiffness K [kN/m]")
boundary.set_ylim(0, 1.45 * boundary.dataLim.y1)
boundary.set_title("Stable walls at the ideal cutoff")
boundary.legend(title="Encoder, ideal cutoff", ncols=2, fontsize=8)
what, times, low, high = zip(*changes, strict=True)
factors.errorbar(times, what, xerr=[np.subtract(times, low), np.subtract(high, times)], fmt="o", ms=4, capsize=3)
factors.axvline(1, color="k", lw=1)
factors.set(xscale="log", xlabel="Times the area of the device as it is, with the spread of the starts")
factors.set_title("One change at a time, the filter tuned anew")
factors.invert_yaxis()
for axes in (areas, factors):
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
for axes in (areas, boundary, factors):
    axes.grid(color="0.9")
png = asked.out / "gallery-own-device.png"
figure.savefig(png)
Image.open(png).convert("RGB").quantize(128).save(png, optimize=True)  # a third of the bytes

# %%
print("| encoder, um | ideal cutoff, Hz | largest K, kN/m | largest B, N s/m |\n|---|---|---|---|")
print(*rows, sep="\n")
print("\n| one change | times the area |\n|---|---|")
for n, (name, *values) in zip(first[:5], changes, strict=False):
    larger = "> " if found.table["capped_walks"][n] else ""  # a cap of [walk] has cut it
    print("| {} | {}{:.2f} ({:.2f} to {:.2f}) |".format(name, larger, *values))
print()
print(*found.answers, sep="\n")
if asked.show or NOTEBOOK:
    plt.show()
