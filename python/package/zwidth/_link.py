"""Lines to and from a board over TCP, a port for each RTT channel, read by a thread of its own."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue

__all__ = ["Link", "LOOK_S"]

#: Time between two checks for signals and other events, s.
LOOK_S = 0.05
#: Longest time for a server to take a line, s; after it the board is lost.
SEND_S = 0.5

Sink = Callable[[bytes], None]


class Link:
    """The channels of one board.

    The thread reads all channels while the connection exists, since a board obeys no command if nobody reads its
    replies. The thread removes the answers to ``disarm`` and to :meth:`keep_promise`; every other line goes to
    :meth:`line`. It sends nothing while the board is there: a script that hangs must lose the force.
    """

    def __init__(self, host: str, commands: int, telemetry: int, replies: int, connect_s: float) -> None:
        self._address = (host, commands)
        self._sockets: list[socket.socket] = []
        try:
            for port in (commands, telemetry, replies):
                try:
                    made = socket.create_connection((host, port), timeout=connect_s)
                except OSError as error:
                    raise ConnectionError(f"{host}:{port}: {error}") from None
                self._sockets.append(made)
                made.settimeout(SEND_S)
                made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except BaseException:
            self._shut()
            raise
        #: The reason why the board is lost; None while it is connected.
        self.lost: str | None = None
        #: Receives the telemetry.
        self.sink: Sink | None = None
        self._lines: SimpleQueue[str] = SimpleQueue()
        self._unfinished = b""
        self._heard = time.monotonic()
        self._disarmed = threading.Event()
        self._sending = threading.Lock()
        self._promise_ms: int | None = None
        self._promised = 0.0
        #: Longest pause of a caller that waits, s: short enough for the promise.
        self.look_s = LOOK_S
        self._closing = False
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="zwidth board", daemon=True)
        self._thread.start()

    def send(self, line: str) -> None:
        """Send one line.

        Raises
        ------
        ConnectionError
            There is no board any more.
        """
        self.check()
        try:
            self._put(f"{line}\n".encode("ascii"))
        except OSError as error:
            self._lose(f"a line could not be sent: {error}")
            raise ConnectionError(self.lost) from None

    def line(self, wait_s: float) -> str | None:
        """The next line; None if none comes within `wait_s`.

        Raises
        ------
        ConnectionError
            There is no board any more.
        """
        end = time.monotonic() + wait_s
        while True:
            self.keep_promise()
            left = end - time.monotonic()
            with contextlib.suppress(Empty):
                return self._lines.get(timeout=min(max(left, 0.0), self.look_s))
            self.check()
            if left <= 0.0:
                return None

    def waiting(self) -> list[str]:
        """All lines that have come and were not read."""
        lines: list[str] = []
        with contextlib.suppress(Empty):
            while True:
                lines.append(self._lines.get_nowait())
        return lines

    def quiet(self, silence_s: float, most_s: float) -> None:
        """Wait until no line has come for `silence_s`, at most `most_s`."""
        begun = time.monotonic()
        while time.monotonic() - begun < most_s and time.monotonic() - max(self._heard, begun) < silence_s:
            self.check()
            time.sleep(LOOK_S / 5)

    def check(self) -> None:
        """Raise ConnectionError if the board is lost."""
        if self.lost is not None:
            raise ConnectionError(self.lost)

    def disarm(self, wait_s: float) -> bool:
        """Send ``disarm`` and wait for its answer. Return whether the answer came. Any thread may call it.

        Raises
        ------
        ConnectionError
            There is no board any more.
        """
        self._disarmed.clear()
        self.send("disarm")
        end = time.monotonic() + wait_s
        while not self._disarmed.wait(LOOK_S):
            self.check()
            if time.monotonic() > end:
                return False
        return True

    def promise(self, promise_ms: int | None) -> None:
        """Let :meth:`keep_promise` send ``alive`` four times per `promise_ms` from now on; None stops it."""
        self._promised = time.monotonic()
        self._promise_ms = promise_ms
        self.look_s = LOOK_S if promise_ms is None else min(LOOK_S, promise_ms / 4000)

    def keep_promise(self, at_once: bool = False) -> None:
        """Send ``alive`` if a quarter of the promised time is over, or `at_once`."""
        promise_ms, now = self._promise_ms, time.monotonic()
        if promise_ms is not None and (at_once or now - self._promised > promise_ms / 4000):
            self._promised = now
            self.send(f"alive {promise_ms}")

    def close(self, answered: bool) -> None:
        """End the connection; if the last line was not `answered`, leave the server time to take it."""
        self._closing = True
        if self.lost is None:
            with contextlib.suppress(OSError):
                self._sockets[0].shutdown(socket.SHUT_WR)
            # If a socket is closed with unread bytes, bytes that were not delivered yet are lost.
            if not answered:
                self._over.wait(LOOK_S * 6)
        self._over.set()
        if self._thread is not threading.current_thread():
            self._thread.join(2 * SEND_S)
        self.lost = self.lost or "the connection is closed"
        self._shut()

    def _shut(self) -> None:
        for made in self._sockets:
            made.close()

    def _put(self, line: bytes) -> None:
        # Code that a signal has interrupted may still hold the lock. The line is sent whole in any case.
        held = self._sending.acquire(timeout=SEND_S)
        try:
            self._sockets[0].sendall(line)
        finally:
            if held:
                self._sending.release()

    def _lose(self, why: str) -> None:
        if self.lost is not None:
            return
        self.lost = why
        if self._closing:
            return
        self._promise_ms = None
        with contextlib.suppress(OSError):
            self._sockets[0].sendall(b"\ndisarm\n")
            self._sockets[0].shutdown(socket.SHUT_WR)
        # A new connection may still take commands.
        with contextlib.suppress(OSError), socket.create_connection(self._address, timeout=SEND_S) as other:
            other.sendall(b"\ndisarm\n")
            other.shutdown(socket.SHUT_WR)
            other.settimeout(LOOK_S)
            other.recv(4096)

    def _run(self) -> None:
        handlers: tuple[Sink, ...] = (lambda _: None, self._take_telemetry, self._take_lines)
        with selectors.DefaultSelector() as selector:
            for made, handler in zip(self._sockets, handlers, strict=True):
                selector.register(made, selectors.EVENT_READ, handler)
            while not self._over.is_set() and self.lost is None:
                try:
                    for key, _ in selector.select(LOOK_S / 5):
                        assert isinstance(key.fileobj, socket.socket)
                        got = key.fileobj.recv(1 << 16)
                        if not got:
                            raise ConnectionError("the server closed the connection")
                        key.data(got)
                except TimeoutError:
                    continue
                except Exception as error:  # after any exception, no thread reads any more
                    self._lose(str(error) or type(error).__name__)

    def _take_telemetry(self, got: bytes) -> None:
        sink = self.sink
        if sink is not None:
            sink(got)

    def _take_lines(self, got: bytes) -> None:
        self._heard = time.monotonic()
        *whole, self._unfinished = (self._unfinished + got).split(b"\n")
        for line in whole:
            text = line.decode("ascii", "replace").strip()
            # Without a device record, or with a damaged image, the force is off; these lines refuse each command.
            if text == "ok disarm" or text.startswith(("error: no device record", "error: fault 46 (image)")):
                self._disarmed.set()
            if text and text != "ok disarm" and not (text == "ok alive" and self._promise_ms is not None):
                self._lines.put(text)
