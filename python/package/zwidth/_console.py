"""One line to the console gets one reply; without a reply the board is disarmed."""

from __future__ import annotations

import contextlib
import re
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

from ._link import LOOK_S, Link
from ._native import is_answer

__all__ = ["UNANSWERED", "Console", "to_the_end"]

#: Longest time for the answer to ``disarm``.
DISARM_S = 1.0
#: After so long without a line, all older lines have come: OpenOCD polls every 0.1 s.
SILENCE_S = 0.25

UNANSWERED = "disarm was not answered: keep clear, and look at the board"


def to_the_end(work: Callable[[], bool]) -> tuple[bool, bool]:
    """Do `work` to its end, also after Ctrl-C. Return its result, and whether Ctrl-C came."""
    if sys.is_finalizing():  # no thread can start any more
        return work(), False
    done: list[bool] = []
    thread = threading.Thread(target=lambda: done.append(work()), daemon=True)
    interrupted = False
    try:
        thread.start()
    except RuntimeError:  # the interpreter ends
        return work(), False
    while thread.is_alive():
        try:
            thread.join(LOOK_S)
        except KeyboardInterrupt:
            interrupted = True
    return bool(done and done[0]), interrupted


class Console:
    """The console at the other end of a link."""

    def __init__(self, link: Link, answer_s: float) -> None:
        self.link = link
        self.answer_s = answer_s
        #: Lines that are not replies to a command.
        self.events: deque[str] = deque(maxlen=10_000)
        #: The reason why the board was lost before the end, if it was.
        self.lost: str | None = None
        self._promises = False
        self._reset = False
        self._turn = threading.Lock()

    def greet(self, alive_s: float | None) -> None:
        """Begin: switch the force off, drop older lines, and make the promise that each call keeps."""
        self.link.send("disarm")
        self.link.quiet(SILENCE_S, 12 * SILENCE_S)
        self.disarm()
        self.link.waiting()
        if alive_s:
            word = f"{1000 * alive_s:.0f}"
            self.ask(f"alive {word}")
            self._promises = True
            self.link.promise(int(word))

    def ask(self, line: str, wait_s: float | None = None) -> str:
        """The answer to a line, without its ``ok``."""
        line = self._checked(line)
        if line.lower() == "disarm":
            return self.disarm()
        with self._alone(), self._safe():
            answer = self._answer(line, wait_s)
        return self._met(answer)

    def last(self, line: str, ends: str, wait_s: float, told: Callable[[str], object] | None = None) -> list[str]:
        """The lines of an experiment, up to one that matches `ends` at its start. ValueError if that is an error."""
        lines: list[str] = []
        with self._alone(), self._safe():
            answer = self._answer(line, None)
            limit = time.monotonic() + wait_s
            while answer.startswith("ok ") and not (lines and re.match(ends, lines[-1])):
                came = self.link.line(limit - time.monotonic())
                if came is None:
                    raise TimeoutError(f"{line!r} did not end within {wait_s:g} s")
                self._sort(came)
                lines.append(came)
                if told is not None:
                    told(came)
        self._met(answer)
        if lines[-1].startswith("error: "):
            raise ValueError(lines[-1].removeprefix("error: "))
        return lines

    def part_by_part(self, line: str, wait_s: float) -> list[str]:
        """The lines before the answer to a line, and the answer."""
        parts: list[str] = []
        with self._alone(), self._safe():
            answer = self._answer(line, wait_s, parts)
        return [*parts, answer]

    def stay(self, seconds: float) -> None:
        """Wait, and disarm after an exception, as when waiting for an answer."""
        limit = time.monotonic() + seconds
        with self._safe():
            while (left := limit - time.monotonic()) > 0:
                self.link.check()
                self.link.keep_promise()
                time.sleep(min(left, self.link.look_s))

    def disarm(self) -> str:
        """``disarm`` and its answer. From any thread."""
        if not self.link.disarm(DISARM_S):
            raise TimeoutError(UNANSWERED)
        return "disarm"

    def heard(self) -> tuple[str, ...]:
        """All lines up to now that are not replies to a command."""
        if self._turn.acquire(blocking=False):
            try:
                self._collect()
            finally:
                self._turn.release()
        return tuple(self.events)

    def end(self) -> bool:
        """End: switch the force off, stop ``alive``, close the connection. Return whether ``disarm`` was answered."""
        answered = False
        self.link.promise(None)
        self.lost = self.link.lost
        try:
            answered = self.link.disarm(DISARM_S)
            if answered and self._promises:
                self.link.waiting()
                self.link.send("alive 0")
                while self.link.line(DISARM_S) not in ("ok alive", None):
                    pass
        except ConnectionError as error:
            self.lost = str(error)
        finally:
            self.link.close(answered)
        return answered

    def _checked(self, line: str) -> str:
        line = line.strip()
        if not line or not line.isascii() or not line.isprintable():
            raise ValueError(f"{line!r} is no line of the console: one line of ASCII, not empty")
        if self._promises and line.lower().split()[0] == "alive":
            raise ValueError("this connection keeps its promise by itself: alive_s says which")
        return line

    @staticmethod
    def _met(answer: str) -> str:
        if not answer.startswith("ok "):
            raise ValueError(answer.removeprefix("error: "))
        return answer.removeprefix("ok ")

    def _answer(self, line: str, wait_s: float | None, before: list[str] | None = None) -> str:
        wait_s = self.answer_s if wait_s is None else wait_s
        self._collect()
        if self._reset:
            self._reset = False
            raise ConnectionError("the board was reset: its settings are those in flash, its zero is lost")
        # After a reset or fault 34 the board has no promise. The force must never be on without one.
        self.link.keep_promise(at_once=line.lower() == "arm")
        self.link.send(line)
        limit = time.monotonic() + wait_s
        while True:
            came = self.link.line(limit - time.monotonic())
            if came is None:
                raise TimeoutError(f"no answer to {line!r} within {wait_s:g} s")
            if is_answer(came):
                return came
            self.events.append(came)
            if before is not None:
                before.append(came)

    def _collect(self) -> None:
        for line in self.link.waiting():
            self._sort(line)

    def _sort(self, line: str) -> None:
        # This program has not asked for the version, so it is the greeting after a reset.
        self._reset |= line.startswith("ok version ")
        self.events.append(line)

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        if not self._turn.acquire(blocking=False):
            raise RuntimeError("another thread waits for an answer of this board; only disarm() does not wait for it")
        try:
            yield
        finally:
            self._turn.release()

    @contextlib.contextmanager
    def _safe(self) -> Iterator[None]:
        """Switch the force off if the block ends by an exception."""
        try:
            yield
        except TimeoutError as error:
            answered = self._off()
            raise TimeoutError(f"{error}; {'disarm was answered' if answered else UNANSWERED}") from None
        except BaseException:
            self._off()
            raise

    def _off(self) -> bool:
        def off() -> bool:
            try:
                self.link.send("stop")
                return self.link.disarm(DISARM_S)
            except ConnectionError:  # the link has already sent ``disarm``
                return False

        answered, _ = to_the_end(off)
        # Answers come in order, so lines that have come by now do not answer later commands.
        for line in self.link.waiting():
            if not is_answer(line):
                self._sort(line)
        return answered
