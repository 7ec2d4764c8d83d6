"""What the functions return: frozen, with numpy arrays that cannot be written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from os import PathLike
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas
    import pyarrow

__all__ = ["VERDICTS", "Grid", "Hit", "Linear", "Study", "Sweep", "Table", "Trace", "Walk"]

#: Names of the codes in :attr:`Grid.verdict`.
VERDICTS = ("stable", "unstable", "no_contact", "out_of_range")

Floats = NDArray[np.float64]
Path = str | PathLike[str]


class _Table:
    """Results that are a table as well."""

    def columns(self) -> dict[str, Any]:
        """The columns of the table, as the command line's CSV names them."""
        raise NotImplementedError

    def to_arrow(self) -> pyarrow.Table:
        """The table as a :class:`pyarrow.Table`; needs pyarrow."""
        import pyarrow

        return pyarrow.table(self.columns())

    def to_pandas(self) -> pandas.DataFrame:
        """The table as a :class:`pandas.DataFrame`; needs pandas."""
        import pandas

        return pandas.DataFrame(self.columns())


@dataclass(frozen=True, eq=False, repr=False)
class Table(Mapping[str, NDArray[Any]], _Table):
    """Arrays by the names of their columns, in the order of the command line's CSV.

    A number that there is not is NaN, such a text is empty.
    """

    _arrays: Mapping[str, NDArray[Any]]

    def __post_init__(self) -> None:
        def array(values: Any) -> NDArray[Any]:
            made: NDArray[Any] = np.array(values, dtype=np.str_) if isinstance(values, list) else np.asarray(values)
            made.flags.writeable = False
            return made

        arrays = {name: array(values) for name, values in self._arrays.items()}
        object.__setattr__(self, "_arrays", MappingProxyType(arrays))

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        rows = len(next(iter(self._arrays.values()), ()))
        return f"Table({rows} rows of {', '.join(self._arrays)})"

    def columns(self) -> dict[str, Any]:
        return dict(self._arrays)


class _Frozen:
    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False


class _Columns(_Frozen, _Table):
    """Every attribute is a column."""

    def columns(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Trace(_Columns):
    """Every sample of a hit.

    Attributes
    ----------
    time_s, position_m, velocity_m_per_s : ndarray of float
        Time from the start, true position of the handle, the controller's velocity.
    count : ndarray of int32
        What the encoder counted.
    force_n, output_n : ndarray of float
        Force that the controller asks for, held from output to output; force on the handle at the end of the sample,
        after latency and the output's quantisation.
    flags : ndarray of uint8
        Sum of 1 (inside the wall), 2 (an output was computed) and 4 (the last output saturated).
    port_energy_j : ndarray of float
        What the wall has taken in this contact, by its force and the counts, J; below 0 it has given.
    """

    time_s: Floats
    position_m: Floats
    count: NDArray[np.int32]
    velocity_m_per_s: Floats
    force_n: Floats
    output_n: Floats
    flags: NDArray[np.uint8]
    port_energy_j: Floats


@dataclass(frozen=True)
class Hit:
    """One hit on a wall.

    Attributes
    ----------
    scene : str
        Name of the scene.
    cutoff_hz : float or None
        Nominal cutoff; None for an estimator without one.
    stiffness_n_per_m, damping_n_s_per_m : float
        The wall.
    verdict : str
        ``"stable"``, ``"unstable"`` or ``"no_contact"``, by the scene's criterion.
    rms_m, rms_motion_m : float
        RMS about the mean over the window, of the counts and of the true motion, m.
    mean_m, peak_penetration_m : float
        Mean position of the counts over the window; deepest place behind the surface during the whole hit, m.
    saturated_fraction, contact_fraction, velocity_clipped_fraction, window_at_limit_fraction : float
        Shares of the hit's outputs that saturated, of the window in contact, of the samples with a velocity at the end
        of its range, of the window's outputs at the actuator's limit.
    sensation_db : float or None
        Level of the window's motion over what a hand feels, dB; None if the window has none.
    port_taken_j, port_given_j : float
        What the wall has taken in the last contact, by its force and the counts; the most that it had given beyond what it
        had taken, in any contact, J.
    port_limited_fraction, port_withheld_fraction : float or None
        Of the outputs in contact the share that the passivity controller has changed, and of the wall's force the share
        that it has withheld; None without one.
    trace : Trace or None
        Every sample, if it was asked for.
    """

    scene: str
    cutoff_hz: float | None
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    verdict: str
    rms_m: float
    rms_motion_m: float
    mean_m: float
    peak_penetration_m: float
    saturated_fraction: float
    contact_fraction: float
    velocity_clipped_fraction: float
    window_at_limit_fraction: float
    sensation_db: float | None
    port_taken_j: float
    port_given_j: float
    port_limited_fraction: float | None
    port_withheld_fraction: float | None
    trace: Trace | None = None

    @property
    def stable(self) -> bool:
        """Whether the wall counts as stable."""
        return self.verdict == "stable"


@dataclass(frozen=True, eq=False)
class Walk(_Frozen, _Table):
    """The boundary of the stable walls at one cutoff.

    Attributes
    ----------
    scene : str
        Name of the scene.
    cutoff_hz : float or None
        Nominal cutoff; None for an estimator without one.
    damping_n_s_per_m, stiffness_n_per_m : ndarray of float
        Points of the boundary: the largest stable K at each B, B ascending.
    area : float
        Area under it, N^2 s/m^2.
    hits : int
        Wall hits that it took.
    ended_by : str or None
        Why it ends where it does; None if its first point is unstable.
    """

    scene: str
    cutoff_hz: float | None
    damping_n_s_per_m: Floats
    stiffness_n_per_m: Floats
    area: float
    hits: int
    ended_by: str | None

    @property
    def stiffness_peak_n_per_m(self) -> float:
        """Largest K of the boundary, N/m; 0 if it is empty."""
        return float(self.stiffness_n_per_m.max(initial=0.0))

    @property
    def damping_max_n_s_per_m(self) -> float:
        """Largest B with a stable K, N s/m; 0 if the boundary is empty."""
        return float(self.damping_n_s_per_m.max(initial=0.0))

    def columns(self) -> dict[str, Any]:
        cutoff = np.nan if self.cutoff_hz is None else self.cutoff_hz
        return {
            "cutoff_hz": np.full(len(self.damping_n_s_per_m), cutoff),
            "damping_n_s_per_m": self.damping_n_s_per_m,
            "stiffness_n_per_m": self.stiffness_n_per_m,
        }


@dataclass(frozen=True, eq=False)
class Sweep(_Frozen, _Table):
    """Walks at every cutoff, repeated from several starts.

    Attributes
    ----------
    scene : str
        Name of the scene.
    cutoffs_hz, true_cutoffs_hz : ndarray of float, shape (n,)
        Nominal cutoffs, ascending, and where the discrete filter's -3 dB really are.
    area : ndarray of float, shape (n,)
        Mean area over the repeats, N^2 s/m^2.
    walks : tuple of tuple of Walk
        ``walks[n][repeat]``.
    ideal_cutoff_hz : float or None
        Lowest cutoff whose mean area is at least 98 % of the largest; None where every walk failed.
    ideal_range_hz : tuple of float or None
        Lowest and highest cutoff that the repeats cannot tell from it.
    ideal_basis : str or None
        What the range is based on.
    notes : tuple of str
        What a reader must know beside the numbers.
    """

    scene: str
    cutoffs_hz: Floats
    true_cutoffs_hz: Floats
    area: Floats
    walks: tuple[tuple[Walk, ...], ...]
    ideal_cutoff_hz: float | None
    ideal_range_hz: tuple[float, float] | None
    ideal_basis: str | None
    notes: tuple[str, ...]

    @property
    def areas(self) -> Floats:
        """Area of every walk, shape (n, repeats), N^2 s/m^2."""
        return np.array([[walk.area for walk in walks] for walks in self.walks])

    def columns(self) -> dict[str, Any]:
        areas = self.areas

        def peaks(of: list[list[float]]) -> Floats:
            highest: Floats = np.array(of).max(axis=1)
            return highest

        return {
            "cutoff_hz": self.cutoffs_hz,
            "true_cutoff_hz": self.true_cutoffs_hz,
            "area": self.area,
            "area_low": areas.min(axis=1),
            "area_high": areas.max(axis=1),
            "stiffness_peak_n_per_m": peaks([[walk.stiffness_peak_n_per_m for walk in of] for of in self.walks]),
            "damping_max_n_s_per_m": peaks([[walk.damping_max_n_s_per_m for walk in of] for of in self.walks]),
        }


@dataclass(frozen=True, eq=False)
class Grid(_Frozen, _Table):
    """Every wall of a grid, hit once.

    Attributes
    ----------
    scene : str
        Name of the scene.
    cutoffs_hz, dampings_n_s_per_m, stiffnesses_n_per_m : ndarray of float
        The axes.
    verdict : ndarray of uint8, shape (cutoffs, dampings, stiffnesses)
        Codes: places in :data:`zwidth.VERDICTS`.
    rms_m : ndarray of float, same shape
        RMS of the counts, m; NaN where there is none.
    """

    scene: str
    cutoffs_hz: Floats
    dampings_n_s_per_m: Floats
    stiffnesses_n_per_m: Floats
    verdict: NDArray[np.uint8]
    rms_m: Floats

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Which walls are stable."""
        stable: NDArray[np.bool_] = self.verdict == 0
        return stable

    def columns(self) -> dict[str, Any]:
        axes = np.meshgrid(self.cutoffs_hz, self.dampings_n_s_per_m, self.stiffnesses_n_per_m, indexing="ij")
        cutoff, damping, stiffness = (axis.ravel() for axis in axes)
        return {
            "cutoff_hz": cutoff,
            "damping_n_s_per_m": damping,
            "stiffness_n_per_m": stiffness,
            "verdict": np.array(VERDICTS)[self.verdict.ravel()],
            "rms_m": self.rms_m.ravel(),
        }


@dataclass(frozen=True, eq=False)
class Linear(_Frozen, _Table):
    """The linear stability boundary at one cutoff (paper, section 2.1).

    Attributes
    ----------
    scene : str
        Name of the scene.
    cutoff_hz : float or None
        Nominal cutoff; None for an estimator without one.
    damping_n_s_per_m, stiffness_max_n_per_m : ndarray of float
        Stable for every K from 0 to this; infinite if no K is unstable.
    gain_margin_holds : ndarray of bool
        Whether the paper's gain-margin method gives the same.
    stiffness_passive_n_per_m : ndarray of float or None
        Largest K up to which no motion takes energy out of wall and damper, if it was asked for; 0 if none is.
    left_out : tuple of str
        Tables of the scene that have no place in a linear analysis.
    """

    scene: str
    cutoff_hz: float | None
    damping_n_s_per_m: Floats
    stiffness_max_n_per_m: Floats
    gain_margin_holds: NDArray[np.bool_]
    stiffness_passive_n_per_m: Floats | None
    left_out: tuple[str, ...]

    def columns(self) -> dict[str, Any]:
        cutoff = np.nan if self.cutoff_hz is None else self.cutoff_hz
        columns: dict[str, Any] = {
            "cutoff_hz": np.full(len(self.damping_n_s_per_m), cutoff),
            "damping_n_s_per_m": self.damping_n_s_per_m,
            "stiffness_max_n_per_m": self.stiffness_max_n_per_m,
        }
        if self.stiffness_passive_n_per_m is not None:
            columns["stiffness_passive_n_per_m"] = self.stiffness_passive_n_per_m
        return columns


@dataclass(frozen=True, eq=False)
class Study(_Table):
    """Every point of a study.

    Attributes
    ----------
    measure : str
        ``walk``, ``hit`` or ``sweep``.
    points, units, hits : int
        How many.
    table : Table
        The columns of the command line's parts, one row a point (of a sweep: a cutoff of a point), in their order.
    """

    measure: str
    points: int
    units: int
    hits: int
    table: Table

    def columns(self) -> dict[str, Any]:
        return self.table.columns()
