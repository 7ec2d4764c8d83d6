"""The device of records: mass, damping, spring and more."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from os import PathLike, fspath
from typing import Any, Literal

import numpy as np

from . import _native
from .results import Path, Table, _Table
from .scene import Scene

__all__ = ["EncoderTerm", "Estimate", "Identification", "Plan", "Residual", "TermTest", "identify", "identify_plan"]

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


@dataclass(frozen=True, eq=False)
class Plan(_Table):
    """Pulses that identify a scene's device. As a table it is :attr:`pulses`.

    Attributes
    ----------
    scene : str
        Name of the scene.
    start_m, push_n : float
        Where each pulse starts, m; the train's force, N.
    pulses : Table
        In their order: force ``push_n``, N, duration ``seconds``, s, and by the scene's device how far it goes from the
        start, ``excursion_m``, m, and how fast, ``speed_m_per_s``, m/s.
    force_rms_n, continuous_force_n : float
        RMS of the force over the whole train, pauses included, and what the motor stands for ever, N.
    guessed : tuple of str
        Limits that are not in the scene: guesses.
    console : tuple of str
        Lines for the board's console. These and `guessed` are in the scene's units, all else is at the handle.
    """

    scene: str
    start_m: float
    push_n: float
    pulses: Table
    force_rms_n: float
    continuous_force_n: float
    guessed: tuple[str, ...]
    console: tuple[str, ...]

    def columns(self) -> dict[str, Any]:
        return self.pulses.columns()


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


def identify_plan(scene: Scene) -> Plan:
    """Plan the pulses that identify a scene's device: as strong as travel, speed and motor allow.

    **It moves.** The plan takes the scene's own mass, damping, spring and friction: with a first guess of a device
    begin with a tenth of the force, hands off and clear of the whole way.

    Parameters
    ----------
    scene : Scene
        The device on its board.

    Raises
    ------
    ValueError
        The travel leaves no room for pulses.

    Examples
    --------
    >>> made = identify_plan(Scene.load("paper-1um"))
    >>> (made.pulses["excursion_m"] * 1e3).round(2).tolist()  # mm
    [21.17, 21.17, 20.36, 20.36]
    >>> "; ".join(made.console)
    'zero; k 0; b 0; arm; wait 1; start 0.051700; pulses 2.9530; wait 21; disarm'
    """
    made = _native.identify_plan(scene._native)
    pulses: list[dict[str, float]] = made.pop("pulses")
    of_pulse = ("push_n", "seconds", "excursion_m", "speed_m_per_s")
    return Plan(
        pulses=Table({name: np.array([pulse[name] for pulse in pulses]) for name in of_pulse}),
        guessed=tuple(made.pop("guessed")),
        console=tuple(made.pop("console")),
        **made,
    )
