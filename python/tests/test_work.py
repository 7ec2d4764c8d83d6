"""Long work: Ctrl-C, progress that raises, threads beside it."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import zwidth
from conftest import ROOT

LONG = """
import signal, sys, zwidth
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background begins without
scene = zwidth.Scene.load("paper-1um")
print("begins", flush=True)
try:
    {work}
except KeyboardInterrupt:
    print("interrupted", flush=True)
    sys.exit(7)
"""


WORK = (
    "zwidth.grid(scene, cutoffs=[500], dampings=[10], stiffnesses=[2000 + n for n in range(200_000)])",
    "zwidth.compare(scene)",
    "zwidth.explain(scene)",
    "zwidth.agree(zwidth.Scene.load({known!r}), {walk!r})",
    "zwidth.replay(scene, {capture!r})",
    "zwidth.identify({log!r}, base=scene, gain=1.0, latency=0.0)",
)


FILES = {"known": str(ROOT / "examples/known.toml"), "walk": str(ROOT / "docs/data/tutorial-measured.csv")}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of 50 s in two sines, which takes some seconds to identify."""
    time_s = np.arange(500_000) * 1e-4
    voltage_v, position_m = np.zeros(time_s.size), np.zeros(time_s.size)
    for w in (6.0, 45.0):
        voltage_v += np.sin(w * time_s)
        impedance = 10.0 - 0.5 * w**2 + 5.0j * w
        position_m += np.imag(np.exp(1j * w * time_s) / impedance)
    file = tmp_path_factory.mktemp("log") / "log.csv"
    columns = np.column_stack([time_s, voltage_v, np.floor(position_m / 1e-6) * 1e-6])
    np.savetxt(file, columns, "%.7g", ",", header="time_s,voltage_v,position_m", comments="")
    return file


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A capture of 130 MB, which takes some seconds to decode."""
    file = tmp_path_factory.mktemp("capture") / "capture.bin"
    file.write_bytes((ROOT / "examples/samples.bin").read_bytes() * 800)
    yield file
    file.unlink()


@pytest.mark.parametrize("work", WORK)
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_work_soon(work: str, log: Path, capture: Path) -> None:
    import signal

    code = LONG.format(work=work.format(log=str(log), capture=str(capture), **FILES))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "begins\n"
        time.sleep(1.0)
        begun = time.monotonic()
        child.send_signal(signal.SIGINT)
        assert child.wait(10) == 7
        took = time.monotonic() - begun
    assert took < 1.0, f"{took:.2f} s"  # 0.2 s on an idle machine


def test_what_progress_raises_ends_the_work_and_comes_out() -> None:
    class Enough(Exception):
        pass

    def progress(done: int, total: int) -> None:
        if done:
            raise Enough(f"{done} of {total}")

    scene = zwidth.Scene.load("paper-1um")
    begun = time.monotonic()
    with pytest.raises(Enough):
        zwidth.grid(scene, cutoffs=[500], dampings=[10], stiffnesses=range(2000, 202_000), progress=progress)
    assert time.monotonic() - begun < 30


def test_other_threads_run_meanwhile() -> None:
    ticks = 0
    over = threading.Event()

    def tick() -> None:
        nonlocal ticks
        while not over.wait(0.005):
            ticks += 1

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        # A second of work: were the lock kept, at most the tick before it and the one after it would come.
        zwidth.sweep(zwidth.Scene.load("paper-2um"), cutoffs=[200], repeat=400, threads=1)
    finally:
        over.set()
        thread.join()
    assert ticks > 3
