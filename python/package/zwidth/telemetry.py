"""What a board tells of every output and every sample."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._link import Link
from .results import _Columns

__all__ = ["Outputs", "Recording", "Samples", "Telemetry"]

#: Longest capture: what ``cargo sim telemetry`` reads, more than an hour.
CAPTURE_MAX = 256 << 20


@dataclass(frozen=True, eq=False)
class Outputs(_Columns):
    """One row an output, in the integers of the control: the columns of ``cargo sim telemetry --csv``.

    Attributes
    ----------
    sequence : ndarray of uint32
        Number of the frame that told it.
    sample : ndarray of uint64
        Sample since the board's reset.
    position_counts, velocity_q16, force_q30, command : ndarray of int32
        Counts; 2^-16 counts per sample; 2^-30 of full scale, into the wall positive; code of DAC or PWM.
    flags, settings : ndarray of uint16
        Facts as bits (docs/telemetry.md); number of the settings in force.
    fault : ndarray of uint8
        Code of the latched fault, 0 for none.
    """

    sequence: NDArray[np.uint32]
    sample: NDArray[np.uint64]
    position_counts: NDArray[np.int32]
    velocity_q16: NDArray[np.int32]
    force_q30: NDArray[np.int32]
    command: NDArray[np.int32]
    flags: NDArray[np.uint16]
    settings: NDArray[np.uint16]
    fault: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Samples(_Columns):
    """One row a sample, as ``cargo sim telemetry --samples`` has them.

    Attributes
    ----------
    sample : ndarray of uint64
        Sample since the board's reset.
    position_counts, velocity_q16, force_q30 : ndarray of int32
        Position; velocity that the core computes, 0 where it cannot; force that acts from the last output on, 0 before
        the first.
    output, computed, driven : ndarray of bool
        Whether there was an output; whether the velocity is known; whether the force is.
    """

    sample: NDArray[np.uint64]
    position_counts: NDArray[np.int32]
    velocity_q16: NDArray[np.int32]
    force_q30: NDArray[np.int32]
    output: NDArray[np.bool_]
    computed: NDArray[np.bool_]
    driven: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Telemetry:
    """A capture of a board's telemetry, decoded.

    Attributes
    ----------
    capture : bytes
        The bytes as they came.
    outputs, samples : Outputs, Samples
        Columns.
    dropped, garbage_bytes : int
        Frames that are missing between those that came; bytes that belong to no frame, such as the end of the one that
        was under way at the beginning.
    faults : tuple of int
        Codes of the faults that were latched meanwhile.
    gaps : tuple of (int, int)
        First and last sample of what was not told.
    unknown : tuple of (int, int, str)
        Stretches of which the core computes nothing, and why.
    computed, velocities_equal, forces_equal, states_equal, energies_equal : int
        Samples that the core has computed; velocities, forces, states of the estimator and energies at the port that are
        the board's, bit for bit.
    first_difference : str or None
        The first that is not.
    rate_hz, resolution_m, full_scale_n : float or None
        Samples a second, metres a count (at the handle, of a rotary device too), force at full command, of the first
        settings that were told; None if none were.

    Examples
    --------
    >>> told = Telemetry.load("examples/samples.bin")  # doctest: +SKIP
    >>> told.outputs.force_q30 / 2**30 * told.full_scale_n  # doctest: +SKIP
    """

    capture: bytes = field(repr=False)
    outputs: Outputs = field(repr=False)
    samples: Samples = field(repr=False)
    dropped: int
    garbage_bytes: int
    faults: tuple[int, ...]
    gaps: tuple[tuple[int, int], ...]
    unknown: tuple[tuple[int, int, str], ...]
    computed: int
    velocities_equal: int
    forces_equal: int
    states_equal: int
    energies_equal: int
    first_difference: str | None
    rate_hz: float | None
    resolution_m: float | None
    full_scale_n: float | None

    @classmethod
    def decode(cls, capture: bytes) -> Telemetry:
        """Decode bytes of RTT up channel 1, which may begin and end anywhere.

        Raises
        ------
        ValueError
            There is no frame in them.

        Examples
        --------
        >>> Telemetry.decode(b"no frame")
        Traceback (most recent call last):
            ...
        ValueError: no telemetry frame of layout 1 or 2 in 8 bytes; docs/telemetry.md has the layout
        """
        capture = bytes(capture)
        told: Mapping[str, Any] = _native.decode(capture)
        parts = {"outputs": Outputs(**told["outputs"]), "samples": Samples(**told["samples"])}
        lists = {name: tuple(told[name]) for name in ("faults", "gaps", "unknown")}
        return cls(capture=capture, **{**told, **parts, **lists})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Telemetry:
        """Decode a capture in a file."""
        return cls.decode(Path(path).read_bytes())

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write the capture for ``cargo sim telemetry``, ``replay`` and ``identify``; `force` replaces a file."""
        with Path(path).open("wb" if force else "xb") as file:
            file.write(self.capture)


class Recording:
    """Telemetry of a board from the beginning of a ``with`` block to its end, made by ``Board.telemetry``."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._chunks: list[bytes] = []
        self._size = 0
        self._over = False
        self._told: Telemetry | None = None

    def _take(self, got: bytes) -> None:
        if self._size + len(got) <= CAPTURE_MAX:
            self._size += len(got)
            self._chunks.append(got)

    def __enter__(self) -> Recording:
        if self._over:
            raise RuntimeError("this recording is over: board.telemetry() makes another")
        if self._link.sink is not None:
            raise RuntimeError("this board's telemetry is being recorded already")
        self._link.sink = self._take
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._link.sink = None
        self._over = True

    @property
    def telemetry(self) -> Telemetry:
        """What was recorded, once the block is over; frames that were lost are a RuntimeWarning, too.

        Raises
        ------
        ValueError
            Nothing was recorded.
        RuntimeError
            The block is not over.
        """
        if not self._over:
            raise RuntimeError("the recording goes on: its telemetry is there after the with block")
        if self._told is None:
            self._told = Telemetry.decode(b"".join(self._chunks))
            if self._told.dropped:
                message = f"{self._told.dropped} frames of telemetry were lost, see gaps"
                warnings.warn(message, RuntimeWarning, stacklevel=2)
        return self._told
