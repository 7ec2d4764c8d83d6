"""A board at its console: commands as methods, telemetry as arrays."""

from __future__ import annotations

import atexit
import contextlib
import os
import time
import warnings
import weakref
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from ._answers import BoardHit, BoardSelfTest, BoardStatus, BoardWalk
from ._console import UNANSWERED, Console, to_the_end
from ._link import Link
from ._native import Scene, Telemetry
from ._virtual import Program
from .recording import Recording

__all__ = ["SETTINGS", "Board"]

#: Settings of the console that are a number, for :meth:`Board.set`.
SETTINGS = (
    *("k", "b", "wall", "cutoff", "tuning", *(f"tuning{place}" for place in range(2, 9)), "period"),
    *("push", "start", "settle", "window", "rms", "force_rms", "kstart", "kstep", "kmax", "bstart", "bstep", "bmax", "fullscale"),
)

_OPEN: weakref.WeakSet[Board] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    for board in list(_OPEN):
        with contextlib.suppress(Exception):
            board.close()


class Board:
    """A board at its console, real or virtual: a context manager that disarms on every way out.

    Made by :meth:`connect` and :meth:`virtual`. **A board moves a handle.** Output is off until :meth:`arm`; nothing
    arms by itself. The connection begins and ends with ``disarm``; so does every wait that ends otherwise than by its
    answer: Ctrl-C, a time limit, what a callback raises, a connection that is lost. Beside that the board is promised a
    word every `alive_s` (console command ``alive``). Every method that types a line or waits sends it. If the script
    hangs or is killed, or the cable is pulled, the board takes the force away within that time. So in place of
    ``time.sleep`` use :meth:`wait`.

    Each method sends one line and returns what the board has answered. A rotary device speaks rad and N m; nothing is
    converted. One thread at a time may ask; :meth:`disarm` is for any.

    Raises
    ------
    ValueError
        The board refuses: the console's line.
    TimeoutError
        No answer in time; the board was disarmed, or it is said that this was not answered either.
    ConnectionError
        There is no board any more, or it was reset.

    Examples
    --------
    >>> with Board.virtual("nucleo-f446re") as board:  # doctest: +SKIP
    ...     board.zero()
    ...     board.wall(0.01)
    ...     board.k(8000)
    ...     board.b(30)
    ...     board.push(2.835)
    ...     board.unlock()
    ...     board.arm()
    ...     board.wait_armed()
    ...     print(board.hit().verdict)
    stable
    """

    _console: Console
    _program: Program | None
    _closed: bool

    def __init__(self) -> None:
        raise TypeError("a Board is made by Board.connect or Board.virtual")

    @classmethod
    def connect(
        cls,
        host: str = "127.0.0.1",
        commands: int = 9090,
        telemetry: int | None = None,
        replies: int | None = None,
        *,
        alive_s: float | None = 1.0,
        answer_s: float = 2.0,
        connect_s: float = 3.0,
    ) -> Board:
        """Connect to a board behind OpenOCD's ``rtt server``, or to a running ``cargo board serve``.

        Parameters
        ----------
        host : str
            Where the server is.
        commands, telemetry, replies : int
            Ports of RTT channels 0, 1 and 2; by default those after `commands`.
        alive_s : float or None
            The board is promised a word every so many seconds, 0.02 to 10: it takes the force away where none comes.
            None: no promise, and the force stays when the script hangs.
        answer_s : float
            Longest time for the answer to a command.
        connect_s : float
            Longest time for a connection.

        Raises
        ------
        ConnectionError
            Nobody is there.
        ValueError
            Nothing runs on the board (device record or image are not as they should be), or its firmware has no
            ``alive``.
        """
        telemetry = commands + 1 if telemetry is None else telemetry
        replies = commands + 2 if replies is None else replies
        return cls._begin(Link(host, commands, telemetry, replies, connect_s), None, alive_s, answer_s)

    @classmethod
    def virtual(
        cls,
        scene: Scene | str | os.PathLike[str] = "nucleo-f446re",
        program: str | os.PathLike[str] | None = None,
        *,
        board: str | None = None,
        device: str | os.PathLike[str] | None = None,
        elf: str | os.PathLike[str] | None = None,
        startup_s: float = 600.0,
        alive_s: float | None = 1.0,
        answer_s: float = 2.0,
    ) -> Board:
        """Start a virtual board (``cargo board serve``), which ends with this one.

        Parameters
        ----------
        scene : Scene, str or path
            What it drives: a scene, the name of a built-in one, or a scene file.
        program : str or path, optional
            The program ``virtual-board``; by default that of the checkout that the working directory is in, built if
            need be, for which `startup_s` has to be long enough.
        board, device, elf
            The options of ``cargo board serve``.
        startup_s : float
            Longest time until it is there.
        alive_s, answer_s
            As for :meth:`connect`.

        Raises
        ------
        ValueError
            It refuses the scene or an option: its line.
        """
        options = [] if board is None else ["--board", board]
        for name, file in (("--device", device), ("--elf", elf)):
            options += [] if file is None else [name, str(Path(file).absolute())]
        started = Program(scene, program, options, startup_s)
        try:
            link = Link("127.0.0.1", started.port, started.port + 1, started.port + 2, 3.0)
        except BaseException:
            started.end()
            raise
        return cls._begin(link, started, alive_s, answer_s)

    @classmethod
    def _begin(cls, link: Link, program: Program | None, alive_s: float | None, answer_s: float) -> Board:
        board = object.__new__(cls)
        board._console, board._program, board._closed = Console(link, answer_s), program, False
        _OPEN.add(board)
        try:
            board._console.greet(alive_s)
        except BaseException:
            board._leave(told=True)
            raise
        return board

    def __enter__(self) -> Board:
        if self._closed:
            raise RuntimeError("this board is closed")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave(told=error is not None)

    def __del__(self) -> None:
        if not getattr(self, "_closed", True):
            warnings.warn("a Board was not closed: use it in a with block", ResourceWarning, stacklevel=2)
            with contextlib.suppress(Exception):
                self.close()

    def close(self) -> None:
        """Disarm, and end the connection and the virtual board; again is allowed.

        Raises
        ------
        TimeoutError
            ``disarm`` was not answered.
        ConnectionError
            The connection was lost before.
        """
        self._leave(told=False)

    def _leave(self, told: bool) -> None:
        if self._closed:
            return
        answered, interrupted = to_the_end(self._end)
        lost = self._console.lost
        if interrupted:
            raise KeyboardInterrupt
        if answered:
            return
        if told:
            warnings.warn(lost or UNANSWERED, RuntimeWarning, stacklevel=3)
        elif lost is not None:
            raise ConnectionError(lost)
        else:
            raise TimeoutError(UNANSWERED)

    def _end(self) -> bool:
        try:
            return self._console.end()
        finally:
            try:
                if self._program is not None:
                    self._program.end()
            finally:
                self._closed = True

    def ask(self, line: str, timeout_s: float | None = None) -> str:
        """Type any line of the console (docs/tuning.md) and return the answer without its ``ok``.

        What an experiment says later is in :attr:`events`; :meth:`hit` and the like wait for it.
        """
        return self._console.ask(line, timeout_s)

    @property
    def events(self) -> tuple[str, ...]:
        """Lines that are not replies, oldest first: reports of experiments, and the greeting after a reset."""
        return self._console.heard()

    def status(self) -> BoardStatus:
        """The state of the board, with the newest output."""
        return BoardStatus._of("ok " + self.ask("status"))

    def version(self) -> str:
        """Version, commit, board, scene, envelope and layouts."""
        return self.ask("version").removeprefix("version ")

    def get(self) -> str:
        """All settings in force, with their units."""
        return self.ask("get").removeprefix("get ")

    def faults(self) -> str:
        """The latched fault, the output at which it began, and its present causes; ``"none"`` without a fault."""
        return self.ask("faults").removeprefix("faults ")

    def designs(self) -> tuple[str, ...]:
        """Names of the device's designs."""
        names = tuple(self.ask("designs").split()[1:])
        return () if names == ("none",) else names

    def zero(self) -> None:
        """Make the position here 0."""
        self.ask("zero")

    def arm(self) -> None:
        """Begin sign test and ramp, after which **force acts**; :meth:`wait_armed` waits for it."""
        self.ask("arm")

    def wait_armed(self, timeout_s: float = 10.0) -> None:
        """Ask for the status until the full force acts.

        Raises
        ------
        ValueError
            The force went off meanwhile.
        """
        limit = time.monotonic() + timeout_s
        while not (status := self.status()).armed:
            if not status.on:
                why = f", fault {status.fault} ({status.fault_text})" if status.fault is not None else ""
                raise ValueError(f"the board does not arm: {status.state}{why}")
            if time.monotonic() > limit:
                self.disarm()
                raise TimeoutError(f"the board is not armed within {timeout_s:g} s; it was disarmed")
            self._console.stay(0.02)

    def wait(self, seconds: float) -> None:
        """Wait, and keep the promise (`alive_s`) meanwhile, so that the force stays on."""
        self._console.stay(seconds)

    def disarm(self) -> None:
        """Switch the force off. It is off when this returns. Any thread may call it."""
        self._console.disarm()

    def stop(self) -> None:
        """End hit, walk, pulses or calibration; the push fades, the wall stays."""
        self.ask("stop")

    def clear(self) -> None:
        """Clear the latched fault."""
        self.ask("clear")

    def unlock(self) -> None:
        """Allow walls that are not predicted to be stable, until the force goes off."""
        self.ask("unlock envelope")

    def set(self, name: str, value: float) -> float:
        """Set one of :data:`SETTINGS`, in the unit of the console; returns what is in force.

        All digits of `value` are sent, of which the console takes 15.
        """
        if name not in SETTINGS:
            raise ValueError(f"{name!r} is no setting with a number, allowed {', '.join(SETTINGS)}")
        return self._number(name, value)

    def _number(self, name: str, value: float) -> float:
        answer = self.ask(f"{name} {_typed(value)}")
        for word in answer.split()[1:]:
            with contextlib.suppress(ValueError):
                return float(word)
        raise ValueError(answer)

    def k(self, stiffness: float) -> float:
        """Stiffness K of the wall, N/m; N m/rad of a rotary device. While force acts it fades in."""
        return self._number("k", stiffness)

    def b(self, damping: float) -> float:
        """Damping B of the wall, N s/m; N m s/rad of a rotary device. While force acts it fades in."""
        return self._number("b", damping)

    def wall(self, position: float) -> float:
        """Surface of the wall, m; rad of a rotary device."""
        return self._number("wall", position)

    def cutoff(self, cutoff_hz: float) -> float:
        """Nominal cutoff of the velocity filter, Hz."""
        return self._number("cutoff", cutoff_hz)

    def tuning(self, value: float, place: int = 1) -> float:
        """Set the estimator's parameter with this number (1: the first), in the unit that :meth:`get` shows."""
        return self.set("tuning" if place == 1 else f"tuning{place}", value)

    def estimator(self, name: str) -> str:
        """The velocity estimator; returns its name."""
        return self.ask(f"estimator {name}").removeprefix("estimator ")

    def criterion(self, name: str) -> str:
        """What counts as stable: ``"rms"`` as in the paper, or ``"quiet"``; returns its name."""
        return self.ask(f"criterion {name}").removeprefix("criterion ")

    def design(self, name: str) -> str:
        """Estimator and parameters of that design; returns its name."""
        return self.ask(f"design {name}").removeprefix("design ")

    def period(self, samples: int) -> int:
        """Output period, samples: 1, 2, 5 or 10."""
        return int(self._number("period", samples))

    def push(self, force: float) -> float:
        """Push of hits and walks, N; N m of a rotary device."""
        return self._number("push", force)

    def save(self) -> None:
        """Write the settings to flash."""
        self.ask("save", 10.0)

    def load(self) -> str:
        """Load the settings from flash; returns which ones were loaded."""
        return self.ask("load").removeprefix("load: ")

    def stream(self, on: bool) -> None:
        """Telemetry on or off."""
        self.ask(f"stream {'on' if on else 'off'}")

    def hit(self, timeout_s: float = 900.0) -> BoardHit:
        """Run a hit: **the handle moves by itself**, back to the start, then at the wall.

        By the criterion ``quiet`` it hits at four pushes, one after the other. A warm motor cools first, for up to some
        minutes.
        """
        return BoardHit._of(self._console.last("hit", r"ok hit \S|error: hit: ", timeout_s)[-1])

    def walk(self, timeout_s: float = 24 * 3600.0, told: Callable[[str], object] | None = None) -> BoardWalk:
        """Walk along the boundary of the stable walls: **hit after hit by itself**, at walls ever stiffer.

        `told` is called with each line as it comes; what it raises ends the walk and the force.
        """
        return BoardWalk._of(self._console.last("walk", r"ok walk over|error: walk: ", timeout_s, told))

    def pulses(self, force: float, timeout_s: float = 900.0) -> None:
        """Run the pulse train of an identification, N or N m: **the handle moves by itself**, to both sides."""
        self._console.last(f"pulses {_typed(force)}", r"ok pulses over|error: pulses: ", timeout_s)

    def calibrate(self, percent: float, timeout_s: float = 130.0) -> str:
        """Raise the force to `percent` of full scale; returns the line that says that it holds, or why it is over.

        The board holds it for 30 s; :meth:`stop` ends it, another :meth:`calibrate` goes on to another force.
        """
        line = f"calibrate {_typed(percent)}"
        return self._console.last(line, r"calibrate holds |ok calibrate over", timeout_s)[-1].removeprefix("ok ")

    def selftest(self, timeout_s: float = 10.0) -> BoardSelfTest:
        """Test the board's own parts, with the force off; the zero is lost."""
        return BoardSelfTest._of(self._console.part_by_part("selftest", timeout_s))

    def telemetry(self) -> Recording:
        """Record telemetry during a ``with`` block.

        Examples
        --------
        >>> with board.telemetry() as recording:  # doctest: +SKIP
        ...     board.hit()
        >>> recording.telemetry.outputs.force_q30  # doctest: +SKIP
        """
        return Recording(self._console.link)

    def record(self, seconds: float) -> Telemetry:
        """Record telemetry for so many seconds of this computer."""
        with self.telemetry() as recording:
            self._console.stay(seconds)
        return recording.telemetry


def _typed(value: float) -> str:
    return repr(float(value)).removesuffix(".0")
