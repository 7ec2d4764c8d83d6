"""Telemetry of a board, recorded."""

from __future__ import annotations

import warnings
from types import TracebackType

from ._link import Link
from ._native import Telemetry

__all__ = ["Recording"]

#: Longest capture that ``cargo sim telemetry`` reads, bytes: more than an hour.
CAPTURE_MAX = 256 << 20


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
