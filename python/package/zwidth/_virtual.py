"""The virtual board as a program of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, SimpleQueue

from ._link import LOOK_S
from ._native import Scene

__all__ = ["Program"]

#: Longest time for the program to end by itself, s.
END_S = 3.0


def _checkout() -> Path:
    here = Path.cwd()
    for folder in (here, *here.parents):
        if (folder / "virtual-board" / "Cargo.toml").is_file():
            return folder
    raise ValueError(f"{here} is in no checkout of zwidth: say program=, the path of the program virtual-board")


class Program:
    """``virtual-board serve`` of a scene, from its start until :meth:`end`; :attr:`port` is its first port."""

    def __init__(
        self,
        scene: Scene | str | os.PathLike[str],
        program: str | os.PathLike[str] | None,
        options: Sequence[str],
        startup_s: float,
    ) -> None:
        self._room = tempfile.TemporaryDirectory(prefix="zwidth-")
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        try:
            self.port = self._start(scene, program, options, startup_s)
        except BaseException:
            self.end()
            raise

    def _start(
        self,
        scene: Scene | str | os.PathLike[str],
        program: str | os.PathLike[str] | None,
        options: Sequence[str],
        startup_s: float,
    ) -> int:
        if program is None:
            folder: Path | None = _checkout()
            begin = ["cargo", "run", "--quiet", "--release", "--package", "virtual-board-cli", "--"]
        else:
            folder, begin = None, [os.fspath(program)]
        command = [*begin, "serve", self._named(scene), "--rtt", "0", *options]
        said = Path(self._room.name) / "stderr.txt"
        with said.open("w") as stderr:
            try:
                # A process group of its own: Ctrl-C then reaches only the script, which still has to disarm the board.
                self._process = subprocess.Popen(
                    command,
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=stderr,
                    text=True,
                    start_new_session=True,
                )
            except OSError as error:
                raise ValueError(f"{command[0]}: {error.strerror}") from None
        address = self._address(startup_s)
        if address is None:
            raise TimeoutError(f"the virtual board did not start within {startup_s:g} s")
        port = address.rpartition(":")[2]
        if not port.isdecimal():
            lines = [line for line in said.read_text(errors="replace").splitlines() if line.strip()]
            errors = [line for line in lines if line.startswith("error: ")] or lines or ["error: it said nothing"]
            raise ValueError(errors[-1].removeprefix("error: "))
        return int(port)

    def _named(self, scene: Scene | str | os.PathLike[str]) -> str:
        if not isinstance(scene, Scene):
            name = os.fspath(scene)
            return str(Path(name).absolute()) if Path(name).is_file() else name
        with contextlib.suppress(ValueError):
            # A board's own scene uses the device record of the image.
            if Scene.load(scene.name) == scene:
                return scene.name
        file = Path(self._room.name) / f"{Path(scene.name).name}.toml"
        file.write_text(scene._portable_text())
        return str(file)

    def _address(self, wait_s: float) -> str | None:
        """The first line on stdout; empty if the program ended without a line, None if no line comes in time."""
        assert self._process is not None and self._process.stdout is not None
        stdout, lines = self._process.stdout, SimpleQueue[str]()

        def read() -> None:
            lines.put(stdout.readline())
            for _ in stdout:
                pass

        self._reader = threading.Thread(target=read, daemon=True)
        self._reader.start()
        end = time.monotonic() + wait_s
        while time.monotonic() < end:
            with contextlib.suppress(Empty):
                return lines.get(timeout=LOOK_S).strip()
        return None

    @property
    def pid(self) -> int:
        """Number of the process."""
        assert self._process is not None
        return self._process.pid

    def end(self) -> None:
        """End the program, by force if necessary. It may be called again."""
        process = self._process
        if process is not None and process.returncode is None:
            try:
                self._signal(process, signal.SIGTERM)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(END_S)
            finally:
                if process.returncode is None:
                    self._signal(process, None)
                    process.wait()
            if self._reader is not None and process.stdout is not None:
                self._reader.join(END_S)
                if not self._reader.is_alive():
                    process.stdout.close()
        self._room.cleanup()

    @staticmethod
    def _signal(process: subprocess.Popen[str], number: signal.Signals | None) -> None:
        with contextlib.suppress(ProcessLookupError):
            if sys.platform == "win32":
                process.kill()
            else:
                os.killpg(process.pid, number or signal.SIGKILL)
