"""What was measured on a device, beside what its scene says."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from os import PathLike, fspath
from typing import Any, Literal

import numpy as np

from . import _native
from .results import Table, _Table
from .scene import Scene
from .studies import Engine, Progress

__all__ = [
    "Agreement",
    "EncoderTerm",
    "Estimate",
    "Identification",
    "Replay",
    "Residual",
    "Suspect",
    "TermTest",
    "agree",
    "identify",
    "replay",
]

Path = str | PathLike[str]
Term = Literal["friction", "amplifier", "offset", "phase"]


@dataclass(frozen=True)
class Estimate:
    """A value that was fitted, with its 95 % interval; both ends are the value where it was given.

    Attributes
    ----------
    value, low, high : float
        In the unit that the attribute says which holds it.
    white_half_width : float
        Half of the interval that white noise would give.
    """

    value: float
    low: float
    high: float
    white_half_width: float


@dataclass(frozen=True)
class EncoderTerm:
    """The periodic error of the encoder.

    Attributes
    ----------
    first_m, second_m : Estimate
        Amplitudes once and twice per cycle, m.
    phase_rad : Estimate
        Phase at position 0, rad.
    cycle_m : Estimate
        Travel per cycle, m.
    """

    first_m: Estimate
    second_m: Estimate
    phase_rad: Estimate
    cycle_m: Estimate


@dataclass(frozen=True)
class TermTest:
    """How a term was told from none.

    Attributes
    ----------
    term : str
        ``friction``, ``amplifier``, ``offset`` or ``phase``.
    standard_errors : float
        Value over standard error.
    p : float
        Probability of such a value without the term, for all candidates together.
    """

    term: str
    standard_errors: float
    p: float


@dataclass(frozen=True)
class Residual:
    """What a fit leaves.

    Attributes
    ----------
    rms_m : float
        RMS, m.
    rms_counts, noise_counts : float or None
        RMS, and noise before the quantiser that explains it, counts; None for a sensor without counts.
    white, bound_by_quantisation : bool
        Whether it is white, and whether quantisation, not noise, makes it.
    whiteness_p, autocorrelation : float
        p-value of the Ljung-Box test; autocorrelation from row to row.
    coherence : float
        Part of the quantiser's sawtooth that is left, 0 to 1.
    peak_per_rms : float
        Largest residual over the RMS.
    """

    rms_m: float
    white: bool
    whiteness_p: float
    autocorrelation: float
    bound_by_quantisation: bool
    coherence: float
    peak_per_rms: float
    rms_counts: float | None = None
    noise_counts: float | None = None


@dataclass(frozen=True, eq=False)
class Identification(_Table):
    """The device of records. As a table it is the first record's fit.

    Attributes
    ----------
    logs : tuple of str
        The records.
    rows : int
        Rows that were fitted, of all records.
    step_s, confidence : float
        Time from row to row, s; that of the intervals, 0.95.
    gain_source : str
        ``given``, ``motor``, ``weight`` or ``added_mass``.
    mass_kg, damping_n_s_per_m, gain_n_per_v, latency_s : Estimate
        At the handle, of a rotary device too: kg, N s/m, N/V, s.
    stiffness_n_per_m, rest_position_m : Estimate or None
        N/m and m; None without a spring.
    friction_n, amplifier_lag_s, offset_n : Estimate or None
        Dry friction, N; time constant of the amplifier, s; constant force, N. None where it is not in the model.
    encoder_error : EncoderTerm or None
        None where it is not in the model.
    tests : tuple of TermTest
        Of each of these terms that is in the model.
    initial : Table
        ``time_s``, ``position_m``, ``speed_m_per_s`` at the first fitted row of each record.
    residual : Residual
        What the fit leaves.
    widening : float
        Largest ratio of a stated interval to that of white noise.
    warnings, notes : tuple of str
        What a reader should know, of the fit and of the scene.
    fits : tuple of Table
        Of each record: ``time_s``, ``voltage_v``, ``position_m``, ``model_m``, ``residual_m``; the residual is the
        position, with half a count added for a floor encoder, less the model.
    """

    logs: tuple[str, ...]
    rows: int
    step_s: float
    confidence: float
    gain_source: str
    mass_kg: Estimate
    damping_n_s_per_m: Estimate
    stiffness_n_per_m: Estimate | None
    rest_position_m: Estimate | None
    gain_n_per_v: Estimate
    latency_s: Estimate
    friction_n: Estimate | None
    amplifier_lag_s: Estimate | None
    offset_n: Estimate | None
    encoder_error: EncoderTerm | None
    tests: tuple[TermTest, ...]
    initial: Table
    residual: Residual
    widening: float
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    fits: tuple[Table, ...] = field(repr=False)
    _scene: Scene | str = field(repr=False)

    @property
    def scene(self) -> Scene:
        """The base scene with the device.

        Raises
        ------
        ValueError
            No scene may have this device; the line says why.
        """
        if isinstance(self._scene, str):
            raise ValueError(self._scene)
        return self._scene

    def columns(self) -> dict[str, Any]:
        return self.fits[0].columns()


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


def identify(
    records: Path | Iterable[Path],
    *,
    base: Scene,
    gain: float | None = None,
    torque_constant: float | None = None,
    amplifier_gain: float | None = None,
    drum_radius: float | None = None,
    calibration_mass: float | None = None,
    calibration_voltage: float | None = None,
    added_mass: float | None = None,
    latency: float | None = None,
    fit_latency: bool = False,
    spring: bool = True,
    terms: Literal["auto", "none"] | Iterable[Term] = "auto",
    rest_position: float | None = None,
    encoder_cycle: float | None = None,
    resolution: float | None = None,
    span: tuple[float | None, float | None] = (None, None),
) -> Identification:
    """Find mass, damping, stiffness and more of a device in recorded voltage and position.

    One record cannot tell them from the force per volt: that is given in one of four ways, but for a rotary base scene,
    which has its own. Lengths and forces are at the handle, of a rotary scene too.

    Parameters
    ----------
    records : path or iterable of path
        Logs, telemetry captures, or the CSV of one. Several of one device are fitted at once.
    base : Scene
        Gives encoder, voltage limit, latency and sample rate, and all else that a scene needs.
    gain : float, optional
        Force per volt, N/V.
    torque_constant, amplifier_gain, drum_radius : float, optional
        The force per volt as torque constant, N m/A, times amplifier gain, A/V, over radius, m.
    calibration_mass, calibration_voltage : float, optional
        The force per volt by a weight, kg, and the voltage that holds it still, V.
    added_mass : float, optional
        The second of two records was made with this much more mass, kg: the force per volt is found too.
    latency : float, optional
        From a row's time to its voltage's effect, samples of the base scene; by default its own.
    fit_latency : bool
        Find the latency too, beginning with that.
    spring : bool
        Whether the device has a spring.
    terms : {"auto", "none"} or iterable of {"friction", "amplifier", "offset", "phase"}
        What is fitted beside mass, damping and spring: what the records tell, nothing, or these.
    rest_position : float, optional
        Where the spring rests without any other force, m: a constant force can then be told from it.
    encoder_cycle : float, optional
        Travel per cycle of the encoder's signals, m; by default the base scene's, else it is looked for.
    resolution : float, optional
        Size of a count, m; 0 for a sensor without counts. By default the base scene's.
    span : tuple of float or None
        From and to which time stamp the records are used, s; None is their end.

    Raises
    ------
    ValueError
        Something is out of range, a file cannot be read, or the records do not tell: the line says why.
    """
    paths = [records] if isinstance(records, (str, PathLike)) else list(records)
    asked = {
        "gain": gain,
        "torque_constant": torque_constant,
        "amplifier_gain": amplifier_gain,
        "drum_radius": drum_radius,
        "calibration_mass": calibration_mass,
        "calibration_voltage": calibration_voltage,
        "added_mass": added_mass,
        "latency": latency,
        "fit_latency": fit_latency,
        "spring": spring,
        "terms": [terms] if isinstance(terms, str) else list(terms),
        "rest_position": rest_position,
        "encoder_cycle": encoder_cycle,
        "resolution": resolution,
        "span": span,
    }
    made = _native.identify([fspath(path) for path in paths], base._native, asked)
    told = made["told"]
    found: dict[str, Any] = told.pop("terms", {})
    phase = found.get("encoder_error")
    initial: list[dict[str, float]] = told.pop("initial")
    of_initial = ("time_s", "position_m", "speed_m_per_s")

    def estimate(of: dict[str, Any], name: str) -> Estimate | None:
        return Estimate(**of[name]) if name in of else None

    return Identification(
        logs=tuple(told["logs"]),
        rows=told["rows"],
        step_s=told["step_s"],
        confidence=told["confidence"],
        gain_source=told["gain_source"],
        mass_kg=Estimate(**told["mass_kg"]),
        damping_n_s_per_m=Estimate(**told["damping_n_s_per_m"]),
        stiffness_n_per_m=estimate(told, "stiffness_n_per_m"),
        rest_position_m=estimate(told, "rest_position_m"),
        gain_n_per_v=Estimate(**told["gain_n_per_v"]),
        latency_s=Estimate(**told["latency_s"]),
        friction_n=estimate(found, "friction_n"),
        amplifier_lag_s=estimate(found, "amplifier_lag_s"),
        offset_n=estimate(found, "offset_n"),
        encoder_error=phase and EncoderTerm(**{name: Estimate(**of) for name, of in phase.items()}),
        tests=tuple(TermTest(**test) for test in found.get("tests", ())),
        initial=Table({name: np.array([row[name] for row in initial]) for name in of_initial}),
        residual=Residual(**told["residual"]),
        widening=told["widening"],
        warnings=tuple(told["warnings"]),
        notes=tuple(made["notes"]),
        fits=tuple(Table(fit) for fit in made["fits"]),
        _scene=Scene._of(made["scene"]) if "scene" in made else made["refused"],
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
