# %% [markdown]
# # A controller tuned by scipy
#
# Two searches by `scipy.optimize`, each beside a plain sweep: the cutoff with the largest area of stable walls, and
# cutoff and damping of the stiffest stable wall. Both count what they asked of the simulator. `python tuned_by_scipy.py
# --out FOLDER` writes `gallery-tuned-by-scipy.png` there and prints the table of the page.

# %%
import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image
from scipy.optimize import minimize, minimize_scalar

import zwidth

NOTEBOOK = "ipykernel" in sys.modules
options = argparse.ArgumentParser(description="Cutoff and damping by scipy.optimize, beside plain sweeps.")
options.add_argument("--out", type=Path, default=Path("."), metavar="FOLDER", help="where the PNG goes, default: here")
options.add_argument("--show", action="store_true", help="open a window, too")
asked = options.parse_args([] if NOTEBOOK else None)
if not asked.out.is_dir():
    options.error(f"--out {asked.out}: there is no such folder")
if not (asked.show or NOTEBOOK):
    plt.switch_backend("Agg")

# %% [markdown]
# ## One parameter: the cutoff with the largest area
#
# A wall is stable while the RMS of the handle's motion stays below 2 um. The area is the mean of four walks, from
# starts that are spread over a count. The search is over the cutoff's logarithm; it ends within 2 %.

# %%
STARTS = (0.0, 0.25, 0.5, 0.75)  # counts
scene = zwidth.Scene.load("paper-2um").replace(wall_hit={"rms_limit_m": 2e-6, "rms_of": "motion"})
study = zwidth.sweep(scene, cutoffs=np.geomspace(100, 4000, 24).round(), repeat=len(STARTS))
best = study.area.argmax()
tried = []  # cutoff, area


def less_area(log_cutoff):
    cutoff = np.exp(log_cutoff)
    tried.append((cutoff, np.mean([zwidth.walk(scene, cutoff=cutoff, start_offset=start).area for start in STARTS])))
    return -tried[-1][1]


one = minimize_scalar(less_area, bounds=np.log([100, 4000]), method="bounded", options={"xatol": 0.02})

# %% [markdown]
# ## Two parameters: the stiffest stable wall
#
# At a cutoff and a damping K is raised by 4 kN/m until a wall is not stable from all four starts, then by 400 N/m
# within the last step. Nelder and Mead's search begins at the first search's cutoff. The plain way is a grid by
# steps of 4 kN/m; where that is largest K is refined in the same way.

# %%
COARSE, FINE = 4e3 * np.arange(1, 21), 400.0 * np.arange(1, 10)  # N/m
hits = 0


def stable_steps(cutoffs, dampings, stiffnesses):
    """How many steps of K are stable from all starts, up to the first that is not."""
    global hits
    walls = {"cutoffs": cutoffs, "dampings": dampings, "stiffnesses": stiffnesses}
    grids = [zwidth.grid(scene, start_offset=start, **walls).stable for start in STARTS]
    hits += len(STARTS) * grids[0].size
    return np.logical_and.accumulate(np.all(grids, axis=0), axis=2).sum(axis=2)


def stiffest(cutoff, damping):
    coarse = COARSE[0] * stable_steps([cutoff], [damping], COARSE)[0, 0]
    return coarse + FINE[0] * stable_steps([cutoff], [damping], coarse + FINE)[0, 0]


places = []


def less_stiff(log_place):
    places.append(np.exp(log_place))
    return -stiffest(*places[-1])


begin = np.exp(one.x)
corners = np.log([(begin, 40), (1.5 * begin, 40), (begin, 80)])  # Hz, N s/m
limits = {"xatol": 0.02, "fatol": FINE[0], "initial_simplex": corners}
two = minimize(less_stiff, corners[0], method="Nelder-Mead", bounds=np.log([(50, 4000), (5, 600)]), options=limits)
searched, searched_hits, hits = np.array(places), hits, 0

cutoffs, dampings = np.geomspace(100, 2000, 24).round(), np.arange(20, 401, 20)
plain = COARSE[0] * stable_steps(cutoffs, dampings, COARSE)
largest = [(cutoffs[row], dampings[column]) for row, column in np.argwhere(plain == plain.max())]
on_grid, place = max((stiffest(*place), place) for place in largest)
grid_hits = hits

# %%
figure, (area, plane) = plt.subplots(1, 2, figsize=(9, 4.2), dpi=130, layout="constrained")
tried = np.array(tried)
area.plot(study.cutoffs_hz, study.area / 1e6, "o-", ms=3, color="tab:blue", label=f"sweep, {study.areas.size} walks")
area.plot(tried[:, 0], tried[:, 1] / 1e6, "x", color="tab:red", label=f"search, {len(tried) * len(STARTS)} walks")
area.plot(np.exp(one.x), -one.fun / 1e6, "*", ms=12, color="tab:red", label="its result")
area.set(xlim=(100, 4000), ylim=(0, None), ylabel="Area [10$^6$ N$^2$ s/m$^2$]", title="Area of the stable walls")
colours = plane.pcolormesh(cutoffs, dampings, np.ma.masked_equal(plain.T, 0) / 1e3)
figure.colorbar(colours, ax=plane, label="Largest stiffness K, grid [kN/m]")
plane.plot(*searched.T, "o", ms=4, color="white", mec="k", mew=0.6, label=f"search, {searched_hits} hits")
plane.plot(*place, "s", ms=9, mfc="none", mec="tab:orange", mew=2, label=f"grid's best, {grid_hits} hits")
plane.plot(*np.exp(two.x), "*", ms=12, color="tab:red", label="its result")
plane.set(xlim=(100, 2000), ylim=(10, 410), ylabel="Damping B [N s/m]", title="Largest stable stiffness")
for axes, ticks in ((area, (100, 200, 500, 1000, 2000, 4000)), (plane, (100, 200, 500, 1000, 2000))):
    axes.set(xscale="log", xlabel="Cutoff [Hz]")
    axes.minorticks_off()
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
area.grid(color="0.9")
area.legend(fontsize=8)
plane.legend(fontsize=8)
png = asked.out / "gallery-tuned-by-scipy.png"
figure.savefig(png)
Image.open(png).convert("RGB").quantize(128).save(png, optimize=True)  # a third of the bytes

# %%
cutoff, damping = np.exp(two.x)
print("| figure | plain sweep | scipy.optimize |\n|---|---|---|")
print(f"| cutoff of the largest area, Hz | {study.cutoffs_hz[best]:.0f} | {np.exp(one.x):.0f} |")
print(f"| area, 10^6 N^2 s/m^2 | {study.area[best] / 1e6:.2f} | {-one.fun / 1e6:.2f} |")
print(f"| walks | {study.areas.size} | {len(tried) * len(STARTS)} |")
print(f"| stiffest wall: cutoff, Hz | {place[0]:.0f} | {cutoff:.0f} |")
print(f"| stiffest wall: damping B, N s/m | {place[1]:.0f} | {damping:.0f} |")
print(f"| stiffest wall: stiffness K, kN/m | {on_grid / 1e3:.1f} | {-two.fun / 1e3:.1f} |")
print(f"| hits | {grid_hits} | {searched_hits} |")
if asked.show or NOTEBOOK:
    plt.show()
