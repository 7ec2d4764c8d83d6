"""The scripts of the gallery, run as a user does: figures, tables, and their numbers by other calls."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import signal

import zwidth
from conftest import ROOT

GALLERY = ROOT / "python" / "gallery"
FIGURES = ROOT / "docs" / "figures"
SCRIPTS = ("paper", "own_device", "recorded_counts", "tuned_by_scipy")
PNG_BYTES = 150_000  # the book is kept small
STARTS = (0.0, 0.25, 0.5, 0.75)


def figure(script: str) -> str:
    return f"gallery-{script.replace('_', '-')}.png"


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False, timeout=300)


def lines(text: str) -> list[str]:
    """The rows of all tables of a text."""
    return [line for line in text.splitlines() if line.startswith("|")]


@dataclass
class Made:
    """What a script has made and said."""

    png: Path
    text: str

    def row(self, name: str) -> list[str]:
        """The cells beside the row's name."""
        found = [cells for cells in (line.strip("| ").split(" | ") for line in lines(self.text)) if cells[0] == name]
        assert len(found) == 1, name
        return found[0][1:]

    def numbers(self, name: str) -> list[float]:
        return [float(cell.split()[0]) for cell in self.row(name)]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Made]:
    """Every script, from another folder and without arguments."""
    results = {}
    for script in SCRIPTS:
        folder = tmp_path_factory.mktemp(script)
        ran = run(GALLERY / f"{script}.py", cwd=folder)
        assert ran.returncode == 0, ran.stderr
        assert [path.name for path in folder.iterdir()] == [figure(script)]
        results[script] = Made(folder / figure(script), ran.stdout)
    return results


def test_the_gallery_is_whole() -> None:
    assert sorted(path.stem for path in GALLERY.glob("*.py")) == sorted(SCRIPTS)
    assert sorted(path.name for path in FIGURES.glob("gallery-*")) == sorted(map(figure, SCRIPTS))


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_figure(made: dict[str, Made], script: str) -> None:
    size = None
    for png in (made[script].png, FIGURES / figure(script)):
        assert 10_000 < png.stat().st_size < PNG_BYTES
        with Image.open(png) as image:
            image.load()
            assert image.format == "PNG" and size in (None, image.size)
            size = image.size
            grey = np.asarray(image.convert("L"))
            colours = image.convert("RGB").getcolors(1 << 24)
        assert 800 <= size[0] <= 1200 and 400 <= size[1] <= 1200
        assert 0.02 < np.mean(grey < 250) < 0.9 and colours is not None and len(colours) > 32, "an empty picture"


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_page_has_what_the_script_prints(made: dict[str, Made], script: str) -> None:
    page = (ROOT / "docs" / "python.md").read_text()
    sections = [part for part in re.split(r"\n###? ", page) if f"(figures/{figure(script)})" in part]
    assert len(sections) == 1
    assert f"`python python/gallery/{script}.py --out docs/figures`" in sections[0]
    assert lines(sections[0]) == lines(made[script].text), "copy the tables that the script prints into the page"


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_is_a_notebook(script: str) -> None:
    text = (GALLERY / f"{script}.py").read_text()
    cells = re.split(r"(?m)^# %%(.*)\n", text)
    assert cells[0] == "", "something stands before the first cell"
    kinds, bodies = cells[1::2], cells[2::2]
    assert kinds[0] == " [markdown]" and bodies[0].startswith("# # ") and set(kinds) == {"", " [markdown]"}
    for kind, body in zip(kinds, bodies, strict=True):
        if kind:
            assert all(line.startswith("#") for line in body.strip().splitlines()), body
        else:
            compile(body, script, "exec")
    assert figure(script) in text


def test_cells_run_where_there_is_no_file(tmp_path: Path) -> None:
    """In Jupyter there is no `__file__`, and the arguments are the kernel's."""
    folder = tmp_path / "python" / "gallery"
    shutil.copytree(GALLERY, folder)
    (tmp_path / "examples").mkdir()
    shutil.copy(ROOT / "examples" / "samples.bin", tmp_path / "examples")
    notebook = (
        "import re, sys, types; sys.modules['ipykernel'] = types.ModuleType('ipykernel'); space = {}\n"
        "for cell in re.split('(?m)^# %%.*', open('recorded_counts.py').read()): exec(cell, space)"
    )
    ran = run("-c", notebook, "-f", "kernel.json", cwd=folder)
    assert ran.returncode == 0 and (folder / figure("recorded_counts")).exists(), ran.stderr


@pytest.mark.parametrize("script", SCRIPTS)
def test_refusals(tmp_path: Path, script: str) -> None:
    for arguments, said in (
        (["--out", "nowhere"], "error: --out nowhere: there is no such folder"),
        (["--outt=."], "error: unrecognized arguments: --outt=."),
    ):
        ran = run(GALLERY / f"{script}.py", *arguments, cwd=tmp_path)
        assert ran.returncode == 2 and ran.stderr.strip().endswith(said)
    assert not list(tmp_path.iterdir())


def test_files_that_are_given(tmp_path: Path) -> None:
    """They are the ones that are read: others are refused, by name."""
    for script, option in (("own_device", "--scene"), ("recorded_counts", "--capture"), ("recorded_counts", "--scene")):
        ran = run(GALLERY / f"{script}.py", option, "nothing.toml", cwd=tmp_path)
        assert ran.returncode != 0 and "nothing.toml" in ran.stderr
    (tmp_path / "out").mkdir()
    coarse = zwidth.Scene.load("paper-1um").replace(
        walk={"stiffness_step_n_per_m": 10e3, "damping_step_n_s_per_m": 50.0},
        wall_hit={"settle_s": 2.0, "window_s": 0.5},
        sweep={"cutoffs_hz": [500, 1000]},
    )
    (tmp_path / "own.toml").write_text(coarse.to_toml())
    ran = run(GALLERY / "own_device.py", "--scene", "own.toml", "--out", "out", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert [line.split(" | ")[0] for line in lines(ran.stdout)[2:6]] == ["| 2", "| 1", "| 0.5", "| 0.25"]
    assert (tmp_path / "out" / figure("own_device")).exists()


def unstable_poles(stiffness: float, damping: float, cutoff: float) -> bool:
    """The paper's equation (4), by scipy: zero-order hold of the device, bilinear Butterworth, difference."""
    keys = zwidth.Scene.load("paper-1um").to_dict()
    device, period = keys["device"], 1 / keys["control"]["rate_hz"]
    motion = [device["mass_kg"], device["damping_n_s_per_m"], device["stiffness_n_per_m"]]
    (over,), under, _ = signal.cont2discrete(([1.0], motion), period, "zoh")
    w = 2 * np.pi * cutoff
    top, bottom = signal.bilinear([w * w], [1, np.sqrt(2) * w, w * w], 1 / period)
    wall = np.polyadd(stiffness * np.polymul(bottom, [1, 0]), damping / period * np.polymul(top, [1, -1]))
    poles = np.roots(np.polyadd(np.polymul(under, np.polymul(bottom, [1, 0])), np.polymul(over, wall)))
    return bool(np.abs(poles).max() > 1)


def test_paper(made: dict[str, Made]) -> None:
    said = made["paper"]
    for place, name in enumerate(("paper-1um", "paper-2um")):
        scene = zwidth.Scene.load(name)
        cutoffs = scene.to_dict()["sweep"]["cutoffs_hz"]
        walks = [[zwidth.walk(scene, cutoff=hz, start_offset=start) for start in STARTS] for hz in cutoffs]
        areas = np.array([np.mean([walk.area for walk in of]) for of in walks])
        ideal = int(np.argmax(areas >= 0.98 * areas.max()))
        assert said.numbers("ideal cutoff, Hz")[place] == cutoffs[ideal]
        assert said.row("area at the ideal cutoff, 10^6 N^2 s/m^2")[place] == f"{areas[ideal] / 1e6:.1f}"
        peak = walks[cutoffs.index(2000)][0].stiffness_peak_n_per_m
        assert said.numbers("largest K at 2000 Hz, simulated, kN/m")[place] == peak / 1e3
        low, high = map(float, said.row("ideal range, Hz")[place].split(" to "))
        assert low <= cutoffs[ideal] <= high
        at_once = 1e3 * said.numbers("the same, linear, force at once, kN/m")[place]
        dampings = np.arange(20.0, 4001.0, 20.0)
        assert not all(unstable_poles(0.999 * at_once, b, 2000) for b in dampings)
        assert all(unstable_poles(1.001 * at_once, b, 2000) for b in dampings)
        # As the loop runs: a tenth of the outputs, a delay of one. At small B the simulated boundary is this one.
        runs = zwidth.linear(scene, cutoff=2000, dampings=[100], multirate=True).stiffness_max_n_per_m[0]
        walk = walks[cutoffs.index(2000)][0]
        found = walk.stiffness_n_per_m[walk.damping_n_s_per_m == 100][0]
        assert 0.9 * runs < found <= runs
        assert peak / 2e3 < said.numbers("the same, linear, as the loop runs, kN/m")[place] < 2 * peak / 1e3


def test_own_device(made: dict[str, Made]) -> None:
    said = made["own_device"]
    source = (GALLERY / "own_device.py").read_text()
    text = source.split('SLIDER = """')[1].split('"""')[0]
    device = zwidth.Scene.parse(text, "slider")
    rows = [said.numbers(encoder) for encoder in ("10", "5", "2.5", "1.25")]
    assert np.all(np.diff(rows, axis=0) > 0), "a finer encoder holds more, at a higher cutoff"
    for encoder, (cutoff, stiffness, damping) in zip((10, 5, 2.5, 1.25), rows, strict=True):
        walk = zwidth.walk(device.replace({"encoder.resolution_m": encoder * 1e-6}), cutoff=cutoff, engine="core")
        assert walk.stiffness_peak_n_per_m == pytest.approx(1e3 * stiffness, abs=51)
        assert walk.damping_max_n_s_per_m == damping

    # The walk's own steps in place of coarse ones, a sweep in place of the search: within 6 % (seen: 2 %).
    def area(scene: zwidth.Scene) -> float:
        return float(zwidth.sweep(scene, cutoffs=np.geomspace(500, 4000, 20)).area.max())

    for change, other in (
        ("half the latency, 2.5 samples", {"actuator.latency": 2.5}),
        ("encoder 4 times as fine, 1.25 um", {"encoder.resolution_m": 1.25e-6}),
    ):
        times = area(device.replace(other)) / area(device)
        assert said.numbers(change)[0] == pytest.approx(times, rel=0.06)
    assert "Which part to buy?" in said.text


def test_recorded_counts(made: dict[str, Made]) -> None:
    said = made["recorded_counts"]
    scene = zwidth.Scene.load("paper-1um")
    noise, delay_ms = {}, {}
    for name in (row.strip("| ").split(" | ")[0] for row in lines(said.text)[2:]):
        noise[name], delay_ms[name] = said.numbers(name)
    # docs/estimators.md: 1/2 + sqrt(2) / w samples, window/2 samples, none at low frequencies.
    for cutoff in (1500, 200):
        samples = 0.5 + np.sqrt(2) / (2 * np.pi * cutoff / 10e3)
        assert delay_ms[f"butterworth, {cutoff} Hz"] == pytest.approx(samples / 10, abs=0.02)
    assert delay_ms["least-squares-1, 32 samples"] == pytest.approx(1.6, abs=0.02)
    assert abs(delay_ms["kalman-3, 1000 m/s^3"]) < 0.05
    assert noise["butterworth, 200 Hz"] < noise["butterworth, 1500 Hz"]
    # Noise by another function of the package, about a polynomial in place of the reference.
    for cutoff in (1500, 200):
        replayed = zwidth.replay(scene, ROOT / "examples/samples.bin", estimator="butterworth", cutoff=cutoff)
        velocity = 1e3 * replayed.lsb_m_per_s * replayed.table["velocity_lsb"][-5000:].astype(float)
        time = np.linspace(-1, 1, 5000)
        left = velocity - np.polyval(np.polyfit(time, velocity, 4), time)
        assert noise[f"butterworth, {cutoff} Hz"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.05)


def test_tuned_by_scipy(made: dict[str, Made]) -> None:
    said = made["tuned_by_scipy"]
    scene = zwidth.Scene.load("paper-2um").replace(wall_hit={"rms_limit_m": 2e-6, "rms_of": "motion"})
    swept, searched = said.numbers("area, 10^6 N^2 s/m^2")
    assert searched >= 0.995 * swept
    for cutoff, area in zip(said.numbers("cutoff of the largest area, Hz"), (swept, searched), strict=True):
        # The cutoff is printed to 1 Hz.
        assert zwidth.sweep(scene, cutoffs=[cutoff]).area[0] == pytest.approx(1e6 * area, rel=0.02)
    walks, of_search = said.numbers("walks")
    assert walks == 24 * 4 and 0 < of_search < walks and of_search % 4 == 0
    hits, of_search = said.numbers("hits")
    assert hits > 24 * 20 * 20 * 4 and 0 < of_search < hits / 4

    by_grid, tuned = said.numbers("stiffest wall: stiffness K, kN/m")
    assert tuned >= by_grid
    places = zip(
        said.numbers("stiffest wall: cutoff, Hz"), said.numbers("stiffest wall: damping B, N s/m"), strict=True
    )
    (cutoff, damping), tuned_place = places

    def stable(stiffness: float, cutoff: float, damping: float) -> bool:
        walls = (
            zwidth.hit(scene, stiffness=1e3 * stiffness, damping=damping, cutoff=cutoff, start_offset=start)
            for start in STARTS
        )
        return all(wall.stable for wall in walls)

    # The grid's place and the steps of K are printed with all their digits; the tuned place is rounded.
    coarse = np.arange(4, by_grid + 0.01, 4)
    assert all(stable(k, cutoff, damping) for k in [*coarse, *np.arange(coarse[-1] + 0.4, by_grid + 0.01, 0.4)])
    assert not stable(by_grid + 0.4, cutoff, damping)
    assert all(stable(part * tuned, *tuned_place) for part in (0.3, 0.5, 0.7, 0.9))
    assert not stable(1.05 * tuned, *tuned_place)
    # No wall of another grid is stiffer by more than the edge's roughness.
    cutoffs, dampings = np.linspace(300, 800, 11), np.arange(110, 230, 15)
    stable_from_all = np.ones((11, 8, 1), dtype=bool)
    for start in STARTS:
        around = zwidth.grid(scene, start_offset=start, cutoffs=cutoffs, dampings=dampings, stiffnesses=[1060 * tuned])
        stable_from_all &= around.stable
    assert not stable_from_all.any()
