"""Long work: Ctrl-C, progress that raises, threads beside it."""

import os
import signal
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

PROGRAM = """
import signal, sys, time, numpy, zwidth
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background begins without
scene = zwidth.Scene.load("paper-1um")
{before}
print("begins", flush=True)
try:
    {work}
except KeyboardInterrupt:
    print(time.monotonic(), flush=True)
    sys.exit(7)
"""


def interrupted(work: str, seconds: float, before: str = "") -> tuple[float, float]:
    """How long after Ctrl-C, which comes so long after the work's begin, it is an exception, and the process ends."""
    code = PROGRAM.format(work=work, before=before)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "begins\n"
        time.sleep(seconds)
        begun = time.monotonic()
        child.send_signal(signal.SIGINT)
        raised = float(child.stdout.readline())
        assert child.wait(10) == 7
        return raised - begun, time.monotonic() - begun


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
    _, took = interrupted(work.format(log=str(log), capture=str(capture), **FILES), 1.0)
    assert took < 1.0, f"{took:.2f} s"  # with the end of the process


# A number that the parser takes long for: halfway between two floats.
HARD = "1.00000000000000011102230246251565404236316680908203125"

@pytest.fixture(scope="module")
def unread(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A record of 235 MB, which is read for more than a second before anything looks whether to stop."""
    file = tmp_path_factory.mktemp("unread") / "unread.csv"
    with file.open("w") as text:
        text.write("time_s,voltage_v,position_m\n")
        for _ in range(14):
            text.write(f"{HARD},{HARD},{HARD}\n" * 100_000)
    yield file
    file.unlink()


@pytest.mark.parametrize(
    "work", ["zwidth.identify({file!r}, base=scene, gain=1.0)", "zwidth.Estimator('kalman-3', scene).process(counts)"]
)
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_does_not_wait_for_work_that_looks_away(work: str, unread: Path) -> None:
    counts = "counts = numpy.arange(80_000_000) // 3"
    # The machine has other work too.
    times = [interrupted(work.format(file=str(unread)), 0.2, counts) for _ in range(3)]
    assert all(ended < 1.0 for _, ended in times), times  # at once, whatever the worker does
    assert 0.0 < min(raised for raised, _ in times) < 0.2, times


INTERRUPTED = """
import os, signal, time, zwidth

class Late(Exception):
    pass

def late(*_):
    raise Late

signal.signal(signal.SIGALRM, late)
walls = {"cutoffs": [500], "dampings": [10], "stiffnesses": [2000 + n for n in range(100_000)]}
scene = zwidth.Scene.load("paper-1um")
before = len(os.listdir("/proc/self/task"))
one = zwidth.walk(scene, cutoff=500)

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGESIZE")

def settled():
    end = time.monotonic() + 10
    while len(os.listdir("/proc/self/task")) > before and time.monotonic() < end:
        time.sleep(0.01)
    return resident()

sizes = []
for n in range(60):
    signal.setitimer(signal.ITIMER_REAL, 0.01)
    try:
        zwidth.grid(scene, threads=2, **walls)
    except Late:
        sizes.append(settled())
assert len(sizes) == 60, len(sizes)
after = len(os.listdir("/proc/self/task"))
assert after == before, (after, before)
assert sizes[-1] < sizes[19] + 20e6, sizes
again = zwidth.walk(scene, cutoff=500)
assert (again.area, again.hits) == (one.area, one.hits)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_interrupted_calls_leave_no_thread_and_no_memory_behind() -> None:
    made = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr


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


FORKS = """
import os, sys, time, zwidth
scene = zwidth.Scene.load("paper-2um")
def work():
    return zwidth.grid(scene, cutoffs=[500], dampings=[10, 100], stiffnesses=[10e3, 40e3]).verdict.tolist()
first = work()
child = os.fork()
if child == 0:
    os._exit(0 if work() == first and work() == first else 1)
end = time.monotonic() + 20.0
while True:
    ended, status = os.waitpid(child, os.WNOHANG)
    if ended:
        sys.exit(os.waitstatus_to_exitcode(status))
    if time.monotonic() > end:
        os.kill(child, 9)
        sys.exit(3)
    time.sleep(0.01)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="fork")
def test_a_process_that_was_forked_after_work_works_too() -> None:
    made = subprocess.run([sys.executable, "-W", "ignore", "-c", FORKS], check=False, timeout=60)
    assert made.returncode == 0, "3: it hangs"
