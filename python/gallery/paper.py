# %% [markdown]
# # The paper's figures
#
# The device of Chawda, Celik and O'Malley (DSCC2013): the area of the stable walls over the cutoff, the boundaries of
# the stable walls in the (B, K) plane, and the linear boundary beside the simulated one. `python paper.py --out FOLDER`
# writes `gallery-paper.png` there and prints the table of the page.

# %%
import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import zwidth

NOTEBOOK = "ipykernel" in sys.modules
options = argparse.ArgumentParser(description="The paper's figures, with the linear boundary beside the simulated one.")
options.add_argument("--out", type=Path, default=Path("."), metavar="FOLDER", help="where the PNG goes, default: here")
options.add_argument("--show", action="store_true", help="open a window, too")
asked = options.parse_args([] if NOTEBOOK else None)
if not asked.out.is_dir():
    options.error(f"--out {asked.out}: there is no such folder")
if not (asked.show or NOTEBOOK):
    plt.switch_backend("Agg")

# %% [markdown]
# ## Sweeps
#
# Four walks at every cutoff of the scene, from starts that are spread over one count.

# %%
scenes = {"1 um": zwidth.Scene.load("paper-1um"), "2 um": zwidth.Scene.load("paper-2um")}
studies = {encoder: zwidth.sweep(scene) for encoder, scene in scenes.items()}

# %% [markdown]
# ## Linear boundaries
#
# The paper's equations (3) to (5) apply a force at every sample and at once. The loop as it runs has an output every 10
# samples and a latency of 10 samples. Neither knows an encoder: they hold for both scenes.

# %%
cutoffs = [100, 200, 500, 1000, 2000, 4000]
at_once = {hz: zwidth.linear(scenes["1 um"], cutoff=hz, dampings=np.arange(0, 4001, 20)) for hz in cutoffs}
runs = {hz: zwidth.linear(scenes["1 um"], cutoff=hz, dampings=np.arange(0, 801, 2), multirate=True) for hz in cutoffs}

# %% [markdown]
# ## Figure

# %%
figure, ((areas, linear), boundaries) = plt.subplots(2, 2, figsize=(9, 7), dpi=130, layout="constrained")
colours = dict(zip(cutoffs, plt.colormaps["viridis"](np.linspace(0.0, 0.85, len(cutoffs))), strict=True))

for (encoder, study), colour in zip(studies.items(), ("tab:blue", "tab:orange"), strict=True):
    low, high = study.area - study.areas.min(axis=1), study.areas.max(axis=1) - study.area
    areas.errorbar(
        study.cutoffs_hz,
        study.area / 1e6,
        np.array([low, high]) / 1e6,
        fmt="o-",
        ms=3,
        capsize=2,
        color=colour,
        label=f"encoder of {encoder}",
    )
    areas.axvspan(*study.ideal_range_hz, color=colour, alpha=0.15, lw=0, label=f"ideal range, {encoder}")
areas.set(xscale="log", ylim=(0, None), xlabel="Cutoff [Hz]", ylabel="Area [10$^6$ N$^2$ s/m$^2$]")
areas.minorticks_off()
areas.set_xticks([50, 100, 200, 500, 1000, 2000, 4000], ["50", "100", "200", "500", "1000", "2000", "4000"])
areas.set_title("Area of the stable walls, 4 starts")
areas.legend(loc="upper left")

for hz, boundary in at_once.items():
    linear.plot(boundary.damping_n_s_per_m, boundary.stiffness_max_n_per_m / 1e6, color=colours[hz], label=f"{hz} Hz")
linear.set(xlim=(0, 4000), ylim=(0, 18), xlabel="Damping B [N s/m]", ylabel="Stiffness K [MN/m]")
linear.set_title("Linear, force at every sample and at once")
linear.legend(title="Cutoff", ncols=3)

for axes, (encoder, study) in zip(boundaries, studies.items(), strict=True):
    for hz, (walk, *_) in zip(study.cutoffs_hz, study.walks, strict=True):
        if hz in colours:
            axes.plot(walk.damping_n_s_per_m, walk.stiffness_n_per_m / 1e3, ".-", ms=3, color=colours[hz])
            axes.plot(runs[hz].damping_n_s_per_m, runs[hz].stiffness_max_n_per_m / 1e3, "--", lw=1, color=colours[hz])
    axes.plot([], [], "k.-", ms=3, label="simulated")
    axes.plot([], [], "k--", lw=1, label="linear, as the loop runs")
    axes.set(xlim=(0, 800), ylim=(0, 125), xlabel="Damping B [N s/m]", ylabel="Stiffness K [kN/m]")
    axes.set_title(f"Boundaries, encoder of {encoder}")
    axes.legend(loc="upper right")
for axes in (areas, linear, *boundaries):
    axes.grid(color="0.9")
png = asked.out / "gallery-paper.png"
figure.savefig(png)
Image.open(png).convert("RGB").quantize(128).save(png, optimize=True)  # a third of the bytes

# %% [markdown]
# ## Table


# %%
def at(study, hz, values):
    return values[list(study.cutoffs_hz).index(hz)]


both = list(studies.values())
rows = {
    "ideal cutoff, Hz": [f"{study.ideal_cutoff_hz:.0f}" for study in both],
    "ideal range, Hz": ["{:.0f} to {:.0f}".format(*study.ideal_range_hz) for study in both],
    "area at the ideal cutoff, 10^6 N^2 s/m^2": [
        f"{at(study, study.ideal_cutoff_hz, study.area) / 1e6:.1f}" for study in both
    ],
    "largest K at 2000 Hz, simulated, kN/m": [
        f"{at(study, 2000, study.walks)[0].stiffness_peak_n_per_m / 1e3:.0f}" for study in both
    ],
    "the same, linear, as the loop runs, kN/m": [f"{runs[2000].stiffness_max_n_per_m.max() / 1e3:.0f}"] * 2,
    "the same, linear, force at once, kN/m": [f"{at_once[2000].stiffness_max_n_per_m.max() / 1e3:.0f}"] * 2,
}
print("| encoder |", " | ".join(studies), "|\n|---|---|---|")
for name, values in rows.items():
    print(f"| {name} |", " | ".join(values), "|")
if asked.show or NOTEBOOK:
    plt.show()
