"""Estimators beside each other, and what limits the walls of a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from . import _native
from .results import Table, _Table
from .scene import Scene
from .studies import Engine, Progress, _floats

__all__ = ["Comparison", "Explanation", "Peers", "Usable", "Winner", "compare", "explain", "peers", "usable"]


@dataclass(frozen=True)
class Winner:
    """Who is best by a criterion, among the estimators that look at the same.

    Attributes
    ----------
    criterion : str
        The criterion, a column of :attr:`Comparison.table`.
    looks_at : str
        ``position_only`` or ``more_than_position``.
    best, not_told_apart : tuple of str
        The estimators with the best mean, and those that the repeats cannot tell apart from it.
    value : float
        Its value, in the unit of the column.
    butterworth_rank : int or None
        1 and how many are shown to be better than finite difference and Butterworth; None if that is not among them.
    """

    criterion: str
    looks_at: str
    best: tuple[str, ...]
    not_told_apart: tuple[str, ...]
    value: float
    butterworth_rank: int | None


@dataclass(frozen=True, eq=False)
class Comparison(_Table):
    """Estimators, each tuned by the same search.

    Attributes
    ----------
    scene : str
        Name of the scene.
    table : Table
        One row for each estimator, with the columns of the command line's ``compare.csv``.
    tunings, boundaries, fidelity : Table
        Those of ``tuning.csv`` (what the searches tried), ``boundary.csv`` (every point of every walk at their results)
        and ``fidelity.csv`` (impedance errors by wall and frequency).
    stiffness_n_per_m, damping_n_s_per_m : float
        The wall at which force is compared; K is read off each boundary at its B.
    walls : Table
        The three walls at which the impedance is: ``stiffness_n_per_m``, ``damping_n_s_per_m``.
    true_velocity_area_n2_s_per_m2 : float
        Mean area of the true velocity in place of an estimate.
    impedance_error_of_loop : float
        Impedance error of hold and latency alone, with the true velocity.
    winners : tuple of Winner
        The best by each criterion.
    notes : tuple of str
        What a reader must know beside the numbers.
    """

    scene: str
    table: Table
    tunings: Table
    boundaries: Table
    fidelity: Table
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    walls: Table
    true_velocity_area_n2_s_per_m2: float
    impedance_error_of_loop: float
    winners: tuple[Winner, ...]
    notes: tuple[str, ...]

    def columns(self) -> dict[str, Any]:
        return self.table.columns()


@dataclass(frozen=True, eq=False)
class Explanation(_Table):
    """What limits the walls of a scene.

    Attributes
    ----------
    scene : str
        Name of the scene.
    table : Table
        The scene as it is, then its changes by area, with the columns of the command line's ``explain.csv``.
    boundaries : Table
        Every point of every walk: ``change``, ``repeat``, ``damping_n_s_per_m``, ``stiffness_n_per_m``.
    damping_n_s_per_m : float
        B at which K is read off.
    answers : tuple of str
        Which part to buy, what can be had without one, and whether another estimator is worth it.
    """

    scene: str
    table: Table
    boundaries: Table
    damping_n_s_per_m: float
    answers: tuple[str, ...]

    def columns(self) -> dict[str, Any]:
        return self.table.columns()


@dataclass(frozen=True, eq=False)
class Peers(_Table):
    """The defaults of other systems, untuned, beside the scene's own estimator and the true velocity.

    Attributes
    ----------
    scene : str
        Name of the scene.
    table : Table
        One row for each loop, estimator and limit, with the columns of the command line's ``peers.csv``.
    notes : tuple of str
        What a reader must know beside the numbers: defaults that cannot run at the scene's rate.
    """

    scene: str
    table: Table
    notes: tuple[str, ...]

    def columns(self) -> dict[str, Any]:
        return self.table.columns()


@dataclass(frozen=True, eq=False)
class Usable(_Table):
    """Walls that are stable and rendered as commanded, each estimator tuned for each limit.

    Attributes
    ----------
    scene : str
        Name of the scene.
    table : Table
        One row for each limit and estimator, the largest area first, with the columns of the command line's
        ``usable.csv``; ``within_percent`` is NaN where any error counts.
    """

    scene: str
    table: Table

    def columns(self) -> dict[str, Any]:
        return self.table.columns()


def compare(
    scene: Scene,
    *,
    estimators: Iterable[str] | None = None,
    damping: float | None = None,
    budget: int = 24,
    repeat: int = 4,
    engine: Engine = "lanes",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Tune estimators by the same search and compare them.

    Limit, criterion, push, arm, latency and output period are the scene's: :meth:`Scene.replace` sets others.

    Parameters
    ----------
    scene : Scene
        Device and experiment; its own estimator does not matter.
    estimators : iterable of str, optional
        Their names; by default the usual ones that the scene can feed.
    damping : float, optional
        B at which K is read off and contacts are compared, N s/m; by default 100, or half of the largest B that finite
        difference and Butterworth reaches, if that is less.
    budget : int
        Tunings that the search may try for an estimator with one parameter, 3 to 1000; with two four times as many.
    repeat : int
        Walks at the result of each search, from starts that are spread over a count.
    engine, threads
        As in :func:`walk`.
    progress : callable, optional
        Called with the walks done and the most that there can be, from this thread; what it raises ends the work.

    Raises
    ------
    ValueError
        Something is out of range, an estimator is unknown or the scene cannot feed it, or the handle does not reach the
        wall.

    Examples
    --------
    Coarse steps and a small budget are quick, and their areas too small:

    >>> steps = {"stiffness_step_n_per_m": 20e3, "damping_step_n_s_per_m": 200.0}
    >>> scene = Scene.load("paper-2um").replace(walk=steps)
    >>> made = compare(scene, estimators=["butterworth", "first-order"], budget=3, repeat=2)
    >>> made.table["estimator"].tolist()
    ['butterworth', 'first-order']
    >>> (made.table["area_n2_s_per_m2"] / 1e6).round(1).tolist()  # 10^6 N^2 s/m^2
    [4.8, 13.2]
    >>> made.winners[0].criterion, made.winners[0].best
    ('area_n2_s_per_m2', ('first-order',))
    """
    named = None if estimators is None else list(estimators)
    made = _native.compare(scene._native, named, damping, budget, repeat, engine, threads, progress)
    return Comparison(
        scene=scene.name,
        table=Table(made.pop("table")),
        tunings=Table(made.pop("tunings")),
        boundaries=Table(made.pop("boundaries")),
        fidelity=Table(made.pop("fidelity")),
        walls=Table(made.pop("walls")),
        winners=tuple(_winner(one) for one in made.pop("winners")),
        notes=tuple(made.pop("notes")),
        **made,
    )


def explain(
    scene: Scene,
    *,
    damping: float | None = None,
    budget: int = 8,
    repeat: int = 4,
    engine: Engine = "lanes",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Explanation:
    """Change one element at a time, tune the velocity filter anew for each, and rank the changes.

    Limit, criterion, push, arm, latency and output period are the scene's: :meth:`Scene.replace` sets others.

    Parameters
    ----------
    scene : Scene
        Device and experiment.
    damping : float, optional
        B at which K is read off, N s/m; by default 100, or half of the largest B that the scene reaches, if that is
        less.
    budget : int
        Tunings that the search may try for each change, 3 to 1000; with two parameters four times as many.
    repeat : int
        Walks at the result of each search, 2 or more, from starts that are spread over a count.
    engine, threads, progress
        As in :func:`compare`.

    Raises
    ------
    ValueError
        Something is out of range, or the handle does not reach the wall.
    """
    made = _native.explain(scene._native, damping, budget, repeat, engine, threads, progress)
    return Explanation(
        scene=scene.name,
        table=Table(made["table"]),
        boundaries=Table(made["boundaries"]),
        damping_n_s_per_m=made["damping_n_s_per_m"],
        answers=tuple(made["answers"]),
    )


def peers(
    scene: Scene,
    *,
    limits: Iterable[float | str] = (15e-6, 5e-6, 2e-6, 1e-6, "felt"),
    steps: tuple[float, float] | None = None,
    repeat: int = 4,
    engine: Engine = "lanes",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Peers:
    """Walk with the velocity filters that other systems have by default, untuned.

    Beside them stand the scene's own estimator, at 500 and 1500 Hz if it has a cutoff, and the true velocity; in the
    scene's own loop, and with the latency and output of each board. With the scene's own steps it takes minutes.

    Parameters
    ----------
    scene : Scene
        Device and experiment.
    limits : iterable of float or str
        RMS of the true motion, m; ``"felt"`` for the scene's sensation level, ``"felt=10"`` for another one, dB.
    steps : tuple of float, optional
        Steps of K, N/m, and B, N s/m, of the walks, which are also the first ones; by default a quarter and a half of
        the scene's.
    repeat : int
        Walks each, from starts that are spread over a count.
    engine, threads
        As in :func:`walk`.
    progress : callable, optional
        Called with the walks done and the most that there can be, from this thread; what it raises ends the work.

    Raises
    ------
    ValueError
        Something is out of range or no limit, or the handle does not reach the wall.
    """
    asked = [limit if isinstance(limit, str) else float(limit) for limit in limits]
    made = _native.peers(scene._native, asked, _floats(steps), repeat, engine, threads, progress)
    return Peers(scene=scene.name, table=Table(made["table"]), notes=tuple(made["notes"]))


def usable(
    scene: Scene,
    *,
    percents: Iterable[float] = (5, 10, 20),
    estimators: Iterable[str] | None = None,
    budget: int = 24,
    repeat: int = 4,
    engine: Engine = "lanes",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Usable:
    """Tune estimators for the walls that are stable and whose rendered impedance is off by no more than a limit.

    Limit, criterion, push, arm, latency and output period are the scene's: :meth:`Scene.replace` sets others. With the
    usual estimators and the scene's own steps it takes minutes.

    Parameters
    ----------
    scene : Scene
        Device and experiment; its own estimator does not matter.
    percents : iterable of float
        Limits of the largest error from 1 to 30 Hz, % of the magnitude of K + jwB, 0.1 to 1000; any error is a last
        one.
    estimators : iterable of str, optional
        Their names; by default the usual ones of each kind that the scene can feed.
    budget, repeat, engine, threads, progress
        As in :func:`compare`.

    Raises
    ------
    ValueError
        Something is out of range or empty, an estimator is unknown or the scene cannot feed it, or the handle does not
        reach the wall.
    """
    named = None if estimators is None else list(estimators)
    asked = _floats(percents) or []
    made = _native.usable(scene._native, asked, named, budget, repeat, engine, threads, progress)
    return Usable(scene=scene.name, table=Table(made["table"]))


def _winner(told: dict[str, Any]) -> Winner:
    return Winner(
        criterion=told["criterion"],
        looks_at=told["class"],
        best=tuple(told["best"]),
        not_told_apart=tuple(told["not_told_apart"]),
        value=told["value"],
        butterworth_rank=told.get("butterworth_rank"),
    )
