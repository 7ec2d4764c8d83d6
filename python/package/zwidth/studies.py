"""Hits, walks, sweeps, grids and the linear boundary."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from os import PathLike, fspath
from typing import Any, Literal

import numpy as np

from . import _native
from .results import Grid, Hit, Linear, Study, Sweep, Table, Trace, Walk
from .scene import Scene

__all__ = ["grid", "hit", "linear", "study", "sweep", "walk"]

Engine = Literal["lanes", "core"]
Numeric = Literal["fixed", "f64", "f64-rounded"]
Progress = Callable[[int, int], object]


def _floats(values: Iterable[float] | None) -> list[float] | None:
    return None if values is None else [float(value) for value in values]


def hit(
    scene: Scene,
    *,
    stiffness: float,
    damping: float,
    cutoff: float | None = None,
    start_offset: float = 0.0,
    numeric: Numeric = "fixed",
    trace: bool = False,
) -> Hit:
    """Hit one wall and say whether it is stable.

    Parameters
    ----------
    scene : Scene
        Device and experiment.
    stiffness, damping : float
        The wall, N/m and N s/m.
    cutoff : float, optional
        Nominal cutoff of the velocity filter, Hz; an estimator without one takes none.
    start_offset : float
        Counts beyond the scene's start.
    numeric : {"fixed", "f64", "f64-rounded"}
        The core's fixed point, or its twin in floats, also with the velocity rounded as the core does.
    trace : bool
        Keep every sample.

    Raises
    ------
    ValueError
        Something is out of range; the line names it, its value and what is allowed.

    Examples
    --------
    >>> scene = Scene.load("paper-2um")
    >>> made = hit(scene, stiffness=10e3, damping=30.0, cutoff=500)
    >>> made.verdict, round(made.rms_m * 1e6, 3), round(made.peak_penetration_m * 1e3, 3)  # um, mm
    ('stable', 0.998, 7.117)
    >>> hit(scene, stiffness=200e3, damping=30.0, cutoff=500).verdict
    'unstable'
    """
    made = _native.hit(scene._native, stiffness, damping, cutoff, start_offset, numeric, trace)
    samples = made.pop("trace", None)
    return Hit(
        scene=scene.name,
        stiffness_n_per_m=float(stiffness),
        damping_n_s_per_m=float(damping),
        trace=None if samples is None else Trace(**samples),
        **made,
    )


def walk(
    scene: Scene,
    *,
    cutoff: float | None = None,
    start_offset: float = 0.0,
    engine: Engine = "lanes",
    numeric: Numeric = "fixed",
    threads: int | None = None,
) -> Walk:
    """Follow the boundary of the stable walls at one cutoff.

    Parameters
    ----------
    scene : Scene
        Device and experiment.
    cutoff : float, optional
        Nominal cutoff of the velocity filter, Hz; an estimator without one takes none.
    start_offset : float
        Counts beyond the scene's start; the repeats of a sweep use 0, 1/4, 1/2, 3/4.
    engine : {"lanes", "core"}
        Hits side by side in vector lanes, or by the core itself; the bits are the same.
    numeric : {"fixed", "f64", "f64-rounded"}
        As in :func:`hit`.
    threads : int, optional
        Threads; all cores by default. The result does not depend on it.

    Raises
    ------
    ValueError
        Something is out of range, or the first wall of the walk is unstable, with what to change.

    Examples
    --------
    Coarse steps are quick:

    >>> steps = {"stiffness_step_n_per_m": 10e3, "damping_step_n_s_per_m": 100.0}
    >>> made = walk(Scene.load("paper-2um").replace(walk=steps), cutoff=500)
    >>> made.damping_n_s_per_m.tolist()
    [10.0, 110.0, 210.0, 310.0, 410.0, 510.0]
    >>> made.stiffness_n_per_m.tolist()
    [2000.0, 52000.0, 62000.0, 62000.0, 42000.0, 22000.0]
    >>> round(made.area), made.hits
    (24200000, 23)
    """
    made = _native.walk(scene._native, cutoff, start_offset, engine, numeric, threads)
    return Walk(scene=scene.name, **made)


def sweep(
    scene: Scene,
    *,
    cutoffs: Iterable[float] | None = None,
    repeat: int = 4,
    engine: Engine = "lanes",
    numeric: Numeric = "fixed",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Walk at every cutoff and name the ideal one.

    Parameters
    ----------
    scene : Scene
        Device and experiment.
    cutoffs : iterable of float, optional
        Nominal cutoffs, Hz; the scene's by default.
    repeat : int
        Walks of each cutoff, from starts that are spread over a count.
    engine, numeric, threads
        As in :func:`walk`.
    progress : callable, optional
        Called with the walks done and the walks in all, from this thread; what it raises ends the sweep.

    Raises
    ------
    ValueError
        Something is out of range, or the handle does not reach the wall.

    Examples
    --------
    >>> steps = {"stiffness_step_n_per_m": 10e3, "damping_step_n_s_per_m": 100.0}
    >>> made = sweep(Scene.load("paper-2um").replace(walk=steps), cutoffs=[100, 500, 2000], repeat=2)
    >>> (made.area / 1e6).round(2).tolist()  # 10^6 N^2 s/m^2
    [1.4, 24.2, 35.2]
    >>> made.ideal_cutoff_hz
    2000.0
    >>> made.notes[1]
    'the ideal range touches an end of the cutoffs that were tried; it may go on beyond'
    """
    made = _native.sweep(scene._native, _floats(cutoffs), repeat, engine, numeric, threads, progress)
    cutoffs_hz = made["cutoffs_hz"]
    has_cutoff = bool(np.any(cutoffs_hz > 0.0))
    walks = made.pop("walks")
    return Sweep(
        scene=scene.name,
        walks=tuple(
            tuple(Walk(scene=scene.name, cutoff_hz=float(hz) if has_cutoff else None, **one) for one in of)
            for hz, of in zip(cutoffs_hz, walks, strict=True)
        ),
        notes=tuple(made.pop("notes")),
        **made,
    )


def grid(
    scene: Scene,
    *,
    stiffnesses: Iterable[float],
    dampings: Iterable[float],
    cutoffs: Iterable[float] | None = None,
    start_offset: float = 0.0,
    engine: Engine = "lanes",
    numeric: Numeric = "fixed",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Grid:
    """Hit every wall of a grid once.

    Parameters
    ----------
    scene : Scene
        Device and experiment.
    stiffnesses, dampings : iterable of float
        K, N/m, and B, N s/m.
    cutoffs : iterable of float, optional
        Nominal cutoffs, Hz; an estimator without one takes none.
    start_offset, engine, numeric, threads
        As in :func:`walk`.
    progress : callable, optional
        Called with the walls done and the walls in all, from this thread; what it raises ends the grid.

    Raises
    ------
    ValueError
        Something is out of range or empty.

    Examples
    --------
    >>> scene = Scene.load("paper-2um")
    >>> made = grid(scene, stiffnesses=[10e3, 40e3, 160e3], dampings=[10, 100], cutoffs=[500])
    >>> made.stable.tolist()  # by cutoff, B and K
    [[[False, False, False], [True, True, False]]]
    >>> (made.rms_m[0, 1] * 1e6).round(2).tolist()  # um
    [1.02, 1.35, 868.12]
    """
    made = _native.grid(
        scene._native,
        _floats(cutoffs),
        _floats(dampings) or [],
        _floats(stiffnesses) or [],
        start_offset,
        engine,
        numeric,
        threads,
        progress,
    )
    shape = tuple(len(made[axis]) for axis in ("cutoffs_hz", "dampings_n_s_per_m", "stiffnesses_n_per_m"))
    for values in ("verdict", "rms_m"):
        made[values] = made[values].reshape(shape)
    return Grid(scene=scene.name, **made)


def linear(
    scene: Scene,
    *,
    dampings: Iterable[float],
    cutoff: float | None = None,
    multirate: bool = False,
    passivity: bool = False,
) -> Linear:
    """Linear stability boundary K(B), without quantisation, saturation and one-sided wall.

    Parameters
    ----------
    scene : Scene
        Device and linear elements.
    dampings : iterable of float
        B of the wall, N s/m.
    cutoff : float, optional
        Nominal cutoff of the velocity filter, Hz.
    multirate : bool
        The loop as it runs, with output period and latency; else a force at every sample and at once, as in the
        paper's equations (3) to (5).
    passivity : bool
        Add the largest K that is passive whatever holds the handle.

    Raises
    ------
    ValueError
        Something is out of range, or the estimator is no linear function of the position alone.

    Examples
    --------
    >>> made = linear(Scene.load("paper-2um"), dampings=[0, 30, 300], cutoff=500, passivity=True)
    >>> made.stiffness_max_n_per_m.round().tolist()
    [110414.0, 571914.0, 1451017.0]
    >>> made.stiffness_passive_n_per_m.round().tolist()  # 0: none
    [110390.0, 0.0, 0.0]
    """
    made = _native.linear(scene._native, cutoff, _floats(dampings) or [], multirate, passivity)
    return Linear(scene=scene.name, left_out=tuple(made.pop("left_out")), **made)


def study(
    study: str | PathLike[str] | Mapping[str, Any],
    *,
    engine: Engine = "lanes",
    numeric: Numeric = "fixed",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Study:
    """Walk, hit or sweep at every point of a product or list; in memory, without the command line's folder.

    Parameters
    ----------
    study : path or mapping
        The path of a study's file, or its keys: ``measure``, ``scenes`` (names and paths), ``product``, ``list`` ..
    engine, numeric, threads
        As in :func:`walk`.
    progress : callable, optional
        Called with the units done and the units in all, from this thread; what it raises ends the study.

    Raises
    ------
    ValueError
        A key or value is wrong, or a scene with its changes; the line names it and what is allowed.

    Examples
    --------
    >>> made = study(
    ...     {
    ...         "measure": "hit",
    ...         "scenes": ["paper-2um"],
    ...         "cutoffs_hz": [500],
    ...         "stiffnesses": [10e3, 40e3],
    ...         "dampings": [100],
    ...         "product": {"actuator.latency": [5, 20]},
    ...     }
    ... )
    >>> made.points, made.table["actuator.latency"].tolist()
    (4, [5.0, 5.0, 20.0, 20.0])
    >>> made.table["verdict"].tolist()
    ['stable', 'stable', 'stable', 'unstable']
    """
    asked = dict(study) if isinstance(study, Mapping) else fspath(study)
    made = _native.study(asked, engine, numeric, threads, progress)
    return Study(table=Table(made.pop("columns")), **made)
