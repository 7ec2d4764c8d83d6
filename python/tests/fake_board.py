"""What answers as a board does behind three ports, without one: what it says is in the tests' hands."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType

Answer = Callable[[str], list[str]]


def listen() -> list[socket.socket]:
    """Three ports in a row."""
    for _ in range(100):
        listeners = [socket.create_server(("127.0.0.1", 0))]
        first = listeners[0].getsockname()[1]
        try:
            listeners += [socket.create_server(("127.0.0.1", first + n)) for n in (1, 2)]
        except OSError:
            for listener in listeners:
                listener.close()
        else:
            return listeners
    raise OSError("no three ports in a row are free")


def usual(line: str) -> list[str]:
    return [f"ok {line.split()[0]}" if line.startswith("alive") else f"ok {line}"]


class FakeBoard:
    """Answers each line with those that `answer` gives for it; `typed` has all lines but ``alive``."""

    def __init__(self, answer: Answer = usual, *, before: str = "") -> None:
        self.answer = answer
        self.before = before
        self.typed: list[str] = []
        self.at: list[float] = []
        self.alive: list[str] = []
        self._listeners = listen()
        self.port: int = self._listeners[0].getsockname()[1]
        self._clients: dict[int, socket.socket] = {}
        self._over = False
        for channel, listener in enumerate(self._listeners):
            threading.Thread(target=self._accept, args=(channel, listener), daemon=True).start()

    def __enter__(self) -> FakeBoard:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.vanish()

    def vanish(self, *channels: int) -> None:
        """End these channels, or all and their ports."""
        if not channels:
            self.refuse()
        for channel in channels or (0, 1, 2):
            with contextlib.suppress(KeyError, OSError):
                self._clients[channel].shutdown(socket.SHUT_RDWR)

    def refuse(self) -> None:
        """Take no further connection."""
        self._over = True
        for listener in self._listeners:
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()

    def say(self, *lines: str) -> None:
        for line in lines:
            self._clients[2].sendall(f"{line}\n".encode())

    def tell(self, telemetry: bytes) -> None:
        self._clients[1].sendall(telemetry)

    def wait_for(self, line: str, seconds: float = 5.0) -> None:
        end = time.monotonic() + seconds
        while line not in self.typed:
            assert time.monotonic() < end, f"{line} was not typed, but {self.typed}"
            time.sleep(0.005)

    def since(self) -> list[str]:
        """What was typed since it was last asked for."""
        typed, self.typed, self.at = self.typed, [], []
        return typed

    def _accept(self, channel: int, listener: socket.socket) -> None:
        while not self._over:
            try:
                client, _ = listener.accept()
            except OSError:
                return
            self._clients[channel] = client
            if channel == 2 and self.before:
                client.sendall(self.before.encode())
            with contextlib.suppress(OSError), client:
                self._attend(channel, client)

    def _attend(self, channel: int, client: socket.socket) -> None:
        rest = b""
        while got := client.recv(4096):
            *lines, rest = (rest + got).split(b"\n")
            for line in lines:
                if channel == 0 and line:
                    self._obey(line.decode())

    def _obey(self, line: str) -> None:
        if line.startswith("alive"):
            self.alive.append(line)
        else:
            self.at.append(time.monotonic())
            self.typed.append(line)
        with contextlib.suppress(OSError, KeyError):
            self.say(*self.answer(line))
