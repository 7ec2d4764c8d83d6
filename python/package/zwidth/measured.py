"""What a board measured, beside what a scene or another estimator says: walks, and captures of samples."""

from __future__ import annotations

from dataclasses import dataclass, field
from os import fspath
from typing import Any

from . import _native
from .results import Path, Table, _Table
from .scene import Scene
from .studies import Engine, Progress

__all__ = ["Agreement", "Replay", "Suspect", "agree", "replay"]


@dataclass(frozen=True)
class Suspect:
    """A number of the scene that may explain why two walks differ.

    Attributes
    ----------
    name, key, unit : str
        For people; its key in the scene; the unit of its numbers.
    scene : float or None
        What the scene says; None if it has none.
    value, low, high : float
        The value that explains most, and the range of those that explain as much, of what was tried.
    at_edge : bool
        The range ends with what was tried.
    left_n_per_m : float
        Distance that it leaves, N/m.
    explains : bool
        Whether it explains all of the difference.
    """

    name: str
    key: str
    unit: str
    value: float
    low: float
    high: float
    at_edge: bool
    left_n_per_m: float
    explains: bool
    scene: float | None = None


@dataclass(frozen=True, eq=False)
class Agreement(_Table):
    """A measured walk beside the one that a scene predicts. As a table it is :attr:`walls`.

    Attributes
    ----------
    scene, measured : str
        Names of the scene and of the file.
    cutoff_hz : float or None
        Nominal cutoff; None for an estimator without one.
    agrees : bool
        Whether the measured walk is no farther from the prediction than the scene's own walks are.
    stiffness_step_n_per_m : float
        Step of K, which a walk cannot tell.
    distance_n_per_m, scatter_n_per_m : float
        Distance of the measured walk, and the largest of the scene's own; beyond that step.
    walls : Table
        For each B: ``damping_n_s_per_m``, predicted K with its range over the starts (``predicted_n_per_m``,
        ``predicted_low_n_per_m``, ``predicted_high_n_per_m``), ``measured_n_per_m``, and with the best suspect
        ``explained_n_per_m``, NaN if the walks agree. K is 0 where a walk does not reach that B.
    suspects : tuple of Suspect
        What leaves least first; empty if they agree.
    answers : tuple of str
        The answer in words.
    """

    scene: str
    measured: str
    cutoff_hz: float | None
    agrees: bool
    stiffness_step_n_per_m: float
    distance_n_per_m: float
    scatter_n_per_m: float
    walls: Table
    suspects: tuple[Suspect, ...]
    answers: tuple[str, ...]

    def columns(self) -> dict[str, Any]:
        return self.walls.columns()


def agree(
    scene: Scene,
    measured: Path,
    *,
    engine: Engine = "lanes",
    threads: int | None = None,
    progress: Progress | None = None,
) -> Agreement:
    """Say whether a measured walk agrees with the scene's, and if not, which number explains the difference best.

    Parameters
    ----------
    scene : Scene
        The one that predicts.
    measured : path
        The walk, as ``cargo board walk --csv`` writes it, in the scene's units.
    engine, threads
        As in :func:`walk`.
    progress : callable, optional
        Called with the walks done and the most that there can be, from this thread; what it raises ends the work.

    Raises
    ------
    ValueError
        The file cannot be read or is no walk of this scene, or the handle does not reach the wall.
    """
    made = _native.agree(scene._native, fspath(measured), engine, threads, progress)
    told = made["told"]
    return Agreement(
        scene=told["scene"],
        measured=told["measured"],
        cutoff_hz=told.get("cutoff_hz"),
        agrees=told["agrees"],
        stiffness_step_n_per_m=told["stiffness_step_n_per_m"],
        distance_n_per_m=told["distance_n_per_m"],
        scatter_n_per_m=told["scatter_n_per_m"],
        walls=Table(made["table"]),
        suspects=tuple(Suspect(**one) for one in told["suspects"]),
        answers=tuple(told["answers"]),
    )


@dataclass(frozen=True, eq=False)
class Replay(_Table):
    """Another estimator over the counts of a capture, beside the board's own. As a table it is :attr:`table`.

    Attributes
    ----------
    estimator : str
        Its name.
    cutoff_hz : float
        Nominal cutoff.
    samples, first_sample : int
        How many samples, which follow each other, and the number of the first.
    same_from_sample : int or None
        First sample from which on both say the same to the last bit, up to the end.
    difference_rms_m_per_s : float
        RMS of the difference to the board's.
    later_s : float or None
        By how much it is later than the board's; None if nothing moved.
    board_change_rms_m_per_s, change_rms_m_per_s : float
        RMS of the change from sample to sample, the board's and the estimator's.
    lsb_m_per_s : float
        One of the velocities' integers, m/s.
    table : Table
        ``sample``, ``position_counts``, ``board_velocity_lsb``, ``velocity_lsb``, in the integers of the control.
    """

    estimator: str
    cutoff_hz: float
    samples: int
    first_sample: int
    same_from_sample: int | None
    difference_rms_m_per_s: float
    later_s: float | None
    board_change_rms_m_per_s: float
    change_rms_m_per_s: float
    lsb_m_per_s: float
    table: Table = field(repr=False)

    def columns(self) -> dict[str, Any]:
        return self.table.columns()


def replay(scene: Scene, capture: Path, *, estimator: str | None = None, cutoff: float = 1500.0) -> Replay:
    """Run an estimator over the counts of all samples of a capture, from rest, beside the board's own.

    Parameters
    ----------
    scene : Scene
        The one that the board is built for.
    capture : path
        The bytes of RTT up channel 1 as they came (:meth:`Telemetry.save` writes them).
    estimator : str, optional
        One of :data:`ESTIMATORS`; the scene's by default.
    cutoff : float
        Nominal cutoff, Hz; what else tunes it is the scene's, or the default.

    Raises
    ------
    ValueError
        There is no such estimator, its cutoff is out of range, it looks at more than counts, or the capture has no
        stretch of all samples.
    """
    made = _native.replay(scene._native, fspath(capture), estimator, cutoff)
    told: dict[str, Any] = {"same_from_sample": None, "later_s": None} | made["told"]
    return Replay(lsb_m_per_s=made["lsb_m_per_s"], table=Table(made["table"]), **told)
