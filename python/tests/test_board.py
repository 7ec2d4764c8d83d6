"""The virtual board through the package: beside the same session typed by hand, and on every way out."""

import contextlib
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import zwidth
from conftest import ROOT, Run, rows
from zwidth._answers import BoardHit, BoardStatus
from zwidth._virtual import Program

SCENE = "nucleo-f446re"
#: Up to the arming of a session with short hits, line by line.
LINES = ["zero", "wall 0.01", "push 2.835", "settle 0.5", "window 0.3", "k 8000", "b 30", "unlock envelope", "arm"]


@pytest.fixture(scope="module")
def program() -> Path:
    """The program ``virtual-board``."""
    subprocess.run(["cargo", "build", "--quiet", "--release", "--package", "virtual-board-cli"], cwd=ROOT, check=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return target / "release" / ("virtual-board.exe" if sys.platform == "win32" else "virtual-board")


@pytest.fixture
def served(program: Path) -> Iterator[int]:
    """The first port of a virtual board that outlives the connections to it."""
    started = Program(SCENE, program, [], 600.0)
    try:
        yield started.port
    finally:
        started.end()


def by_hand(program: Path, scene: str | Path, *lines: str) -> list[str]:
    """What ``cargo board run`` prints for those lines."""
    made = subprocess.run(
        [program, "run", scene], input="\n".join(lines) + "\n", cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
    return made.stdout.splitlines()


def seen(port: int) -> BoardStatus:
    """The status, asked for by other means than the package's: those begin with ``disarm``."""
    with contextlib.ExitStack() as stack:
        commands, replies = (
            stack.enter_context(socket.create_connection(("127.0.0.1", port + n), timeout=5.0)) for n in (0, 2)
        )
        time.sleep(0.5)
        if select.select([replies], [], [], 0.0)[0]:
            replies.recv(1 << 16)
        commands.sendall(b"status\n")
        said = b""
        while not said.endswith(b"\n"):
            said += replies.recv(4096)
    return BoardStatus._of(said.decode().splitlines()[-1])


def arm(board: zwidth.Board) -> None:
    board.zero()
    board.wall(0.01)
    board.push(2.835)
    board.set("settle", 0.5)
    board.set("window", 0.3)
    board.k(8000)
    board.b(30)
    board.unlock()
    board.arm()
    board.wait_armed()


def rest(board: zwidth.Board) -> None:
    """Wait until the handle of a stiff spring is at rest, 4 s of the board."""
    begun = board.status().sample
    while board.status().sample < begun + 40_000:
        time.sleep(0.1)


def test_a_hit_and_a_walk_are_those_of_a_session_typed_by_hand(program: Path, tmp_path: Path) -> None:
    # At rest what comes does not depend on when it is asked for, and then it is the same to the last bit.
    scene = zwidth.Scene.load(SCENE).replace({"device.stiffness_n_per_m": 100.0})
    (tmp_path / "stiff.toml").write_text(scene.to_toml())
    grid = {"kstep": 20_000, "bstep": 10, "bmax": 10}
    typed = [f"{name} {value}" for name, value in grid.items()]
    lines = [*LINES, "wait 4", "hit", "wait 6", *typed, "walk", "wait 8"]
    said = by_hand(program, tmp_path / "stiff.toml", *lines)
    came: list[str] = []
    with zwidth.Board.virtual(scene, program, alive_s=None) as board:  # a word between two hits would delay the next
        arm(board)
        rest(board)
        hit = board.hit()
        rest(board)
        for name, value in grid.items():
            assert board.set(name, value) == value
        walk = board.walk(told=came.append)
    (line,) = [line for line in said if line.startswith("ok hit ")]
    assert hit == BoardHit._of(line)
    assert hit.verdict == "stable" and 0.0 < hit.rms_m < 1e-5 and 0.009 < hit.mean_m < 0.012
    assert came == [line for line in said if line.startswith(("walk hit", "walk boundary", "ok walk over"))]
    assert walk.hit_verdict.tolist() == ["stable", "unstable"]
    assert (walk.stiffness.tolist(), walk.damping.tolist(), walk.area) == ([2000.0], [10.0], 20_000.0)


def test_refusals_are_the_consoles_line(program: Path) -> None:
    lines = ["hit", "k -1", "k 0.30000000000000004", "estimator none", "clear", "fly"]
    said = [line for line in by_hand(program, SCENE, *lines) if line.startswith("error: ")]
    assert len(said) == len(lines)
    with zwidth.Board.virtual(SCENE, program) as board:
        for line, refusal in zip(lines, said, strict=True):
            with pytest.raises(ValueError) as raised:
                board.ask(line)
            assert f"error: {raised.value}" == refusal
        for call in (board.hit, lambda: board.k(-1), lambda: board.k(0.1 + 0.2), lambda: board.estimator("none")):
            with pytest.raises(ValueError):
                call()
        assert board.status().state == "off", "nothing arms by itself"


def test_what_the_program_refuses_is_refused(program: Path) -> None:
    for scene, board in (("none", None), (SCENE, "no-board")):
        options = [] if board is None else ["--board", board]
        command = [program, "serve", scene, *options]
        said = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60).stderr
        with pytest.raises(ValueError) as raised:
            zwidth.Board.virtual(scene, program, board=board)
        assert said == f"error: {raised.value}\n"
    with pytest.raises(ValueError, match="No such file|cannot find"):
        zwidth.Board.virtual(SCENE, ROOT / "no-program")
    with pytest.raises(TimeoutError, match="did not start within 0.01 s"):
        zwidth.Board.virtual(SCENE, program, startup_s=0.01)


def test_the_telemetry_is_that_of_the_command_line(program: Path, sim: Run, tmp_path: Path) -> None:
    with zwidth.Board.virtual(SCENE, program) as board:
        arm(board)
        with board.telemetry() as recording:
            with pytest.raises(RuntimeError, match="goes on"):
                _ = recording.telemetry
            with pytest.raises(RuntimeError, match="already"), board.telemetry():
                pass
            hit = board.hit()
        told = recording.telemetry
        later = board.record(0.3)
    told.save(tmp_path / "capture.bin")
    with pytest.raises(FileExistsError):
        told.save(tmp_path / "capture.bin")
    told.save(tmp_path / "capture.bin", force=True)
    options = ["--csv", tmp_path / "outputs.csv", "--samples", tmp_path / "samples.csv"]
    said = sim("telemetry", tmp_path / "capture.bin", *options)
    for table, part in (("outputs", told.outputs), ("samples", told.samples)):
        file = rows(tmp_path / f"{table}.csv")
        assert len(file) > 500
        columns = part.columns()
        for name in file[0]:
            fact = {"velocity_q16": "computed", "force_q30": "driven"}.get(name)
            known = columns.get(fact, np.ones(len(file), dtype=bool))
            here = [str(int(value)) if there else "" for value, there in zip(columns[name], known, strict=True)]
            assert [row[name] for row in file] == here, name
    for name in ("dropped", "garbage_bytes", "computed", "velocities_equal", "forces_equal", "states_equal"):
        assert getattr(told, name) == said[name], name
    assert [list(gap) for gap in told.gaps] == said["gaps"]
    assert (said["first_difference"], told.first_difference) == (None, None)
    assert told.computed > 5_000 and told.forces_equal > 100
    assert (told.rate_hz, told.resolution_m) == (10_000.0, 1e-6)
    assert told.full_scale_n == pytest.approx(5.906)
    assert told.outputs.position_counts.max() * told.resolution_m > hit.mean_m
    with pytest.raises(ValueError, match="read-only"):
        told.outputs.force_q30[0] = 1
    assert told.outputs.to_pandas().shape == (len(told.outputs.sample), 9)
    assert later.outputs.sample[0] > told.outputs.sample[-1]
    assert zwidth.Telemetry.load(tmp_path / "capture.bin").dropped == told.dropped


def test_lost_frames_are_counted_and_told(program: Path) -> None:
    with zwidth.Board.virtual(SCENE, program) as board:
        told = board.record(0.5)
    frames = told.capture.split(b"ZW\x02")
    cut = b"ZW\x02".join([*frames[:100], *frames[103:]])
    assert zwidth.Telemetry.decode(cut).dropped == told.dropped + 3
    with pytest.raises(ValueError, match="no telemetry frame"):
        zwidth.Telemetry.decode(b"")


def test_an_exception_disarms(served: int) -> None:
    with pytest.raises(ZeroDivisionError):
        with zwidth.Board.connect(commands=served) as board:
            arm(board)
            assert board.status().armed
            1 / 0  # noqa: B018
    status = seen(served)
    assert (status.state, status.fault, status.force_percent) == ("off", None, 0.0)
    with zwidth.Board.connect(commands=served) as board:
        board.unlock()
        board.arm()
        board.wait_armed()
        with pytest.raises(ZeroDivisionError):
            board.walk(told=lambda line: 1 // 0)
        status = board.status()
        assert (status.state, status.activity, status.fault) == ("off", "idle", None)
        while board.status().contact:
            time.sleep(0.1)
        board.unlock()
        board.arm()
        board.wait(1.5)
        assert board.status().armed, "the promise is kept meanwhile"
        time.sleep(3.0)
        status = board.status()
        assert (status.state, status.fault_text) == ("fault", "host silent"), "the script hung"


HITS = """
import signal, sys
sys.path.insert(0, sys.argv[2])
signal.signal(signal.SIGINT, signal.default_int_handler)
import zwidth
from test_board import arm
try:
    with zwidth.Board.connect(commands=int(sys.argv[1])) as board:
        arm(board)
        board.set("settle", 15)
        print("hits", flush=True)
        board.hit()
except KeyboardInterrupt:
    sys.exit(7)
"""


@contextlib.contextmanager
def hitting(port: int) -> Iterator[subprocess.Popen[bytes]]:
    """A script in a hit of that board."""
    command = [sys.executable, "-c", HITS, str(port), str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"hits\n"
        yield child


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_a_hit_and_the_force(served: int) -> None:
    with hitting(served) as child:
        time.sleep(0.5)
        begun = time.monotonic()
        child.send_signal(signal.SIGINT)
        assert child.wait(20) == 7
        took = time.monotonic() - begun
    status = seen(served)
    assert (status.state, status.activity, status.fault, status.force_percent) == ("off", "idle", None, 0.0)
    assert took < 2.0, f"{took:.2f} s"  # 0.3 s on an idle machine, the interpreter's end included


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_script_that_is_killed_takes_the_force_with_it(served: int) -> None:
    with hitting(served) as child:
        child.kill()
        child.wait(10)
    time.sleep(1.5)
    status = seen(served)
    assert (status.state, status.fault, status.fault_text) == ("fault", 34, "host silent")


def test_a_virtual_board_that_ends_is_told_and_one_that_is_left_ends(program: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        with zwidth.Board.virtual(SCENE, program) as board:
            assert board._program is not None
            left = board._program.pid
            1 / 0  # noqa: B018
    with pytest.raises(ProcessLookupError):
        os.kill(left, 0)
    with pytest.warns(RuntimeWarning), pytest.raises(ConnectionError, match="closed|reset"):
        with zwidth.Board.virtual(SCENE, program) as board:
            arm(board)
            assert board._program is not None
            os.kill(board._program.pid, signal.SIGTERM)
            begun = time.monotonic()
            while time.monotonic() - begun < 10:
                board.status()
                time.sleep(0.01)


def test_a_rotary_device_speaks_of_angles(program: Path) -> None:
    with zwidth.Board.virtual("smartknob", program) as board:
        assert board.ask("push 0.002") == "push 0.002 N m"
        assert board.push(0.001) == 0.001
        assert "N m/rad" in board.get()


def test_the_example_of_the_page_runs_with_the_checkouts_own_program(
    program: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT / "python")
    (example,) = re.findall(r"```py\n(.*?)```", (ROOT / "docs/python.md").read_text(), re.DOTALL)
    exec(compile(example, "docs/python.md", "exec"), {})
    assert capsys.readouterr().out.startswith("stable ")
    monkeypatch.chdir("/")
    with pytest.raises(ValueError, match="in no checkout"):
        zwidth.Board.virtual(SCENE)


def test_self_test_settings_and_flash(program: Path) -> None:
    with zwidth.Board.virtual(SCENE, program) as board:
        assert board.version().split(",")[2] == f" board {SCENE}"
        assert board.faults() == "none"
        tested = board.selftest()
        assert tested.parts["chip"].startswith("pass") and tested.parts["encoder"].startswith("fail")
        assert not tested.passed
        assert board.cutoff(500) == 500
        board.save()
        assert board.load() == "newest settings"
        assert board.designs() == ()
        board.stream(False)
        with board.telemetry():
            time.sleep(1.0)  # frames that were under way
        with pytest.raises(ValueError, match="no telemetry frame"):
            board.record(0.2)
