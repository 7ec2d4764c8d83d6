"""What is typed, and what happens when a board does not answer as it should: beside a server that is in our hands."""

import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import zwidth
from conftest import ROOT
from fake_board import FakeBoard, usual
from zwidth._native import is_answer

STATUS = (
    "ok status armed, fault 34 (host silent), hit, sample 123, position -5 counts, velocity -0.5 counts/sample, "
    "force -4.402 %, code 2048, zeroed, in contact, stop closed, supply good, settings valid, envelope locked"
)
HIT = "ok hit no contact, rms 7.5e-7 m, mean 0.0105 m, taken 0 J, given 0 J"


def connect(fake: FakeBoard, **options: Any) -> zwidth.Board:
    return zwidth.Board.connect(commands=fake.port, **options)


@pytest.fixture
def fake() -> Iterator[FakeBoard]:
    with FakeBoard() as fake:
        yield fake


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda board: board.zero(), "zero"),
        (lambda board: board.arm(), "arm"),
        (lambda board: board.disarm(), "disarm"),
        (lambda board: board.stop(), "stop"),
        (lambda board: board.clear(), "clear"),
        (lambda board: board.unlock(), "unlock envelope"),
        (lambda board: board.k(8000), "k 8000"),
        (lambda board: board.k(np.float64(0.1) + 0.2), "k 0.30000000000000004"),
        (lambda board: board.b(1e-7), "b 1e-07"),
        (lambda board: board.wall(-0.01), "wall -0.01"),
        (lambda board: board.cutoff(1500), "cutoff 1500"),
        (lambda board: board.tuning(0.4), "tuning 0.4"),
        (lambda board: board.tuning(3, 2), "tuning2 3"),
        (lambda board: board.push(2.835), "push 2.835"),
        (lambda board: board.period(5), "period 5"),
        (lambda board: board.set("kstep", 123456789012345), "kstep 123456789012345"),
        (lambda board: board.estimator("butterworth"), "estimator butterworth"),
        (lambda board: board.design("soft"), "design soft"),
        (lambda board: board.save(), "save"),
        (lambda board: board.load(), "load"),
        (lambda board: board.stream(False), "stream off"),
        (lambda board: board.version(), "version"),
        (lambda board: board.get(), "get"),
        (lambda board: board.faults(), "faults"),
        (lambda board: board.designs(), "designs"),
        (lambda board: board.ask(" get "), "get"),
        (lambda board: board.ask("disarm"), "disarm"),
    ],
)
def test_each_method_types_one_line(fake: FakeBoard, call: Callable[[zwidth.Board], object], line: str) -> None:
    with connect(fake) as board:
        fake.since()
        call(board)
        assert fake.since() == [line]
    assert fake.since() == ["disarm"]


def test_nothing_is_typed_but_disarm_and_the_promise(fake: FakeBoard) -> None:
    with connect(fake, alive_s=0.2) as board:
        board.wait(0.5)
        assert set(fake.typed) == {"disarm"}
        assert set(fake.alive) == {"alive 200"} and len(fake.alive) > 5
        fake.since()
    assert fake.since() == ["disarm"]
    assert fake.alive[-1] == "alive 0", "the next one who arms has promised nothing"
    fake.alive.clear()
    with connect(fake, alive_s=None) as board:
        time.sleep(0.3)
        assert board.ask("alive 300") == "alive"
    assert fake.alive == ["alive 300"]


def test_the_promise_is_kept_by_calls_and_by_nothing_else(fake: FakeBoard) -> None:
    typed: list[str] = []

    def answer(line: str) -> list[str]:
        typed.append(line)
        return ["ok hit"] if line == "hit" else usual(line)

    with connect(fake, alive_s=0.2) as board:
        fake.answer = answer
        time.sleep(0.5)
        assert typed == [], "a script that hangs"
        board.get()
        assert typed == ["alive 200", "get"]
        typed.clear()
        board.arm()
        assert typed == ["alive 200", "arm"], "a board that was reset has no promise"
        typed.clear()
        threading.Timer(0.5, fake.say, [HIT]).start()
        board.hit()
        assert typed[0] == "hit" and typed.count("alive 200") > 3
    fake.answer = usual
    with connect(fake, alive_s=0.02) as board:
        fake.alive.clear()
        board.wait(0.5)
        assert len(fake.alive) > 25, "the shortest promise"


def test_answers_are_read(fake: FakeBoard) -> None:
    said = {
        "status": [STATUS],
        "k 5": ["ok k 5.5 N m/rad"],
        "designs": ["ok designs soft hard"],
        "load": ["ok load: newest settings"],
        "hit": ["ok hit", HIT],
        "selftest": ["selftest chip: pass", "selftest encoder: fail, 0 edges", "error: selftest: 1 of 2 failed"],
        "calibrate 20": ["ok calibrate", "calibrate holds 19.9 % of full scale, code 2457, 1.18 N with full scale 6 N"],
    }
    fake.answer = lambda line: said.get(line) or usual(line)
    with connect(fake) as board:
        status = board.status()
        assert (status.state, status.fault, status.fault_text) == ("armed", 34, "host silent")
        assert (status.sample, status.position_counts, status.velocity_counts_per_sample) == (123, -5, -0.5)
        assert (status.force_percent, status.code, status.activity) == (-4.402, 2048, "hit")
        facts = (status.zeroed, status.contact, status.stop_closed, status.supply_good, status.settings_valid)
        assert all(facts) and not status.unlocked and status.on and status.armed
        said["status"] = [STATUS.replace("34 (host silent)", "none").replace("zeroed", "not zeroed")]
        said["status"] = [said["status"][0].replace("in contact", "free").replace("armed", "off")]
        status = board.status()
        assert (status.state, status.fault, status.zeroed, status.contact) == ("off", None, False, False)
        assert not status.on and not status.armed
        assert board.k(5) == 5.5
        assert board.designs() == ("soft", "hard")
        assert board.load() == "newest settings"
        hit = board.hit()
        assert (hit.verdict, hit.stable, hit.rms_m, hit.mean_m, hit.unit) == ("no_contact", False, 7.5e-7, 0.0105, "m")
        with pytest.raises(AttributeError):
            hit.rms = 0.0  # type: ignore[misc]
        said["hit"] = ["ok hit", HIT.replace(" m,", " rad,")]
        hit = board.hit()
        assert (hit.rms, hit.unit) == (7.5e-7, "rad")
        with pytest.raises(ValueError, match="speaks rad"):
            _ = hit.rms_m
        assert (hit.force_rms, hit.penetration_ratio) == (None, None)
        pushes = [f"hit push {n}: 2 N, stable, rms 0 m, force rms 0.1 N, ratio 1" for n in range(1, 5)]
        said["hit"] = ["ok hit", *pushes, HIT + ", force rms 0.125 N, ratio 0.99"]
        hit = board.hit()
        assert (hit.force_rms, hit.penetration_ratio) == (0.125, 0.99)
        said["hit"] = ["ok hit", HIT + ", force rms 0 N m, ratio none"]
        hit = board.hit()
        assert (hit.force_rms, hit.penetration_ratio) == (0.0, None)
        tested = board.selftest()
        assert pickle.loads(pickle.dumps(tested)) == tested
        assert not tested.passed
        assert tested.parts == {"chip": "pass", "encoder": "fail, 0 edges"}
        assert board.calibrate(20).startswith("calibrate holds 19.9 %")


def test_a_walk_is_read_line_by_line(fake: FakeBoard) -> None:
    lines = [
        "walk hit 1: k 2000 N/m, b 10 N s/m, stable, rms 7.83140047075e-7 m, force rms 0.1 N, ratio 1.01",
        "walk hit 2: k 22000 N/m, b 10 N s/m, unstable, rms 0.000105234735933 m",
        "walk boundary 1: k 2000 N/m, b 10 N s/m",
        "ok walk over, area 880000 N^2 s/m^2, peak k 2000 N/m, largest b 10 N s/m, hits 2, points 1, ended by cap",
    ]
    fake.answer = lambda line: ["ok walk", *lines] if line == "walk" else usual(line)
    came: list[str] = []
    with connect(fake) as board:
        walk = board.walk(told=came.append)
        assert came == lines
        assert walk.stiffness.tolist() == [2000] and walk.damping.tolist() == [10]
        assert walk.hit_stiffness.tolist() == [2000, 22000] and walk.hit_damping.tolist() == [10, 10]
        assert walk.hit_verdict.tolist() == ["stable", "unstable"]
        assert walk.hit_rms.tolist() == [7.83140047075e-7, 0.000105234735933]
        assert (walk.area, walk.ended_by) == (880000, "cap")
        assert walk.units == ("N/m", "N s/m", "m", "N^2 s/m^2")
        with pytest.raises(ValueError, match="read-only"):
            walk.stiffness[0] = 0.0
        del lines[1]
        with pytest.raises(ConnectionError, match="1 hits"):
            board.walk()
        lines[:] = ["error: walk: stopped, area 0 N^2 s/m^2, peak k 0 N/m, hits 0, points 0"]
        with pytest.raises(ValueError, match="^walk: stopped, area 0"):
            board.walk()
        assert fake.since()[-1] == "walk", "an answer of the board is no reason to disarm"


def test_refusals_are_the_consoles_line(fake: FakeBoard) -> None:
    fake.answer = lambda line: ["error: the output is on"] if line in ("arm", "hit", "k nan") else usual(line)
    with connect(fake) as board:
        for call in (board.arm, board.hit, lambda: board.k(float("nan")), lambda: board.ask("arm")):
            with pytest.raises(ValueError) as raised:
                call()
            assert str(raised.value) == "the output is on"
        fake.answer = lambda line: ["ok pulses", "error: pulses: held"] if line == "pulses 1" else usual(line)
        with pytest.raises(ValueError, match="^pulses: held"):
            board.pulses(1)
        fake.since()
        for line in ("k 1\narm", "", "  ", "k \N{MICRO SIGN}", "k\0", "alive 0"):
            with pytest.raises(ValueError):
                board.ask(line)
        with pytest.raises(ValueError, match="no setting"):
            board.set("arm", 1)
        assert fake.since() == [], "what is no line is not sent"


@pytest.mark.parametrize("what", ["no device record: there is none", "fault 46 (image): it is not sealed"])
def test_a_board_on_which_nothing_runs_says_why(fake: FakeBoard, what: str) -> None:
    why = f"{what}; nothing runs, see help"
    fake.answer = lambda line: [f"error: {why}"]
    with pytest.raises(ValueError) as raised:
        connect(fake)
    assert str(raised.value) == why


def test_lines_of_an_experiment_are_no_answers(fake: FakeBoard) -> None:
    fake.answer = lambda line: ["walk hit 7: k 1 N/m", HIT, "ok k 5 N/m"] if line == "k 5" else usual(line)
    with connect(fake) as board:
        assert board.k(5) == 5
        assert board.events == ("walk hit 7: k 1 N/m", HIT)
        fake.say("ok pulses over")
        time.sleep(0.1)
        assert board.events[-1] == "ok pulses over"
    for line in ("ok hit", "ok walk", "ok pulses", "ok calibrate", "ok selftest", "error: on already", "ok k 5 N/m"):
        assert is_answer(line), line
    for line in (HIT, "hit push 1: 2 N, stable", "ok walk over, area", "ok pulses over", "ok calibrate over: x", "error: hit: x", "selftest a: x"):
        assert not is_answer(line), line


def test_what_came_before_the_connection_answers_nothing() -> None:
    before = "ok version 0.1.0\nok load: defaults\nok disarm\nok status half of"
    with FakeBoard(before=before + "\n") as fake, connect(fake) as board:
        assert board.ask("help") == "help"
        assert board.events == ()


def test_an_answer_that_does_not_come(fake: FakeBoard) -> None:
    fake.answer = lambda line: [] if line in ("zero", "hit") else usual(line)
    with connect(fake, answer_s=0.3) as board:
        fake.since()
        begun = time.monotonic()
        with pytest.raises(TimeoutError, match="no answer to 'zero' within 0.3 s; disarm was answered"):
            board.zero()
        assert 0.3 <= time.monotonic() - begun < 1.0
        assert fake.since() == ["zero", "stop", "disarm"]
        fake.answer = lambda line: ["ok zero", "ok get late"] if line == "get" else usual(line)
        assert board.ask("get") == "zero"
        time.sleep(0.1)
        assert board.ask("status") == "status", "what came too late answers nothing"
        fake.answer = lambda line: ["ok hit"] if line == "hit" else usual(line)
        with pytest.raises(TimeoutError, match="'hit' did not end within 0.2 s; disarm was answered"):
            board.hit(timeout_s=0.2)
        assert fake.since()[-2:] == ["stop", "disarm"]
        assert "ok stop" not in board.events


def test_a_board_that_answers_nothing_any_more() -> None:
    mute = False
    with FakeBoard(lambda line: [] if mute else usual(line)) as fake:
        with pytest.warns(RuntimeWarning, match="disarm was not answered"):
            with pytest.raises(TimeoutError, match="disarm was not answered: keep clear"):
                with connect(fake, answer_s=0.2) as board:
                    mute = True
                    fake.since()
                    board.zero()
        assert fake.since() == ["zero", "stop", "disarm", "disarm"]
        mute = False
        board = connect(fake)
        mute = True
        begun = time.monotonic()
        with pytest.raises(TimeoutError, match="disarm was not answered"):
            board.close()
        assert time.monotonic() - begun < 3.0
        board.close()


@pytest.mark.parametrize(("channel", "again"), [(0, True), (1, True), (2, True), (1, False), (2, False)])
def test_a_lost_channel_disarms_by_what_is_left(fake: FakeBoard, channel: int, again: bool) -> None:
    with pytest.raises(ConnectionError):
        with connect(fake) as board:
            fake.since()
            if not again:
                fake.refuse()
            fake.vanish(channel)
            fake.wait_for("disarm")
            begun = time.monotonic()
            with pytest.raises(ConnectionError, match="closed|reset"):
                board.zero()
            assert time.monotonic() - begun < 0.5
            assert "zero" not in fake.typed


def test_a_thread_that_fails_disarms(fake: FakeBoard) -> None:
    with pytest.warns(RuntimeWarning), pytest.raises(ConnectionError, match="by zero"):
        with connect(fake) as board:
            fake.since()
            board._console.link.sink = lambda got: 1 // 0
            fake.tell(b"ZW")
            fake.wait_for("disarm")
            board.zero()


def test_a_server_that_is_gone(fake: FakeBoard) -> None:
    with pytest.warns(RuntimeWarning):
        with pytest.raises(ConnectionError):
            with connect(fake) as board:
                threading.Timer(0.3, fake.vanish).start()
                fake.answer = lambda line: ["ok hit"] if line == "hit" else usual(line)
                board.hit()
    with pytest.raises(ConnectionError, match=str(fake.port)):
        connect(fake, connect_s=0.5)


def test_a_reset_is_told_at_the_next_command(fake: FakeBoard) -> None:
    with connect(fake) as board:
        fake.say("ok version 0.1.0, commit x", "ok load: newest settings")
        time.sleep(0.1)
        fake.since()
        with pytest.raises(ConnectionError, match="the board was reset"):
            board.arm()
        assert "arm" not in fake.typed
        assert board.ask("zero") == "zero"


def test_every_way_out_disarms(fake: FakeBoard) -> None:
    class Odd(BaseException):
        pass

    for error in (ZeroDivisionError, KeyboardInterrupt, SystemExit, Odd):
        with pytest.raises(error):
            with connect(fake):
                fake.since()
                raise error
        assert fake.since() == ["disarm"], error
    board = connect(fake)
    fake.since()
    with pytest.warns(ResourceWarning, match="with block"):
        del board
    assert fake.since() == ["disarm"], "one that was forgotten"
    with connect(fake) as board:
        fake.answer = lambda line: ["ok walk", "walk hit 1: x"] if line == "walk" else usual(line)
        fake.since()
        with pytest.raises(ZeroDivisionError):
            board.walk(told=lambda line: 1 // 0)
        assert fake.since() == ["walk", "stop", "disarm"]
    with pytest.raises(RuntimeError, match="closed"), board:
        pass


def test_any_thread_may_disarm(fake: FakeBoard) -> None:
    def answer(line: str) -> list[str]:
        ended = ["error: hit: the force went off: see status and faults"]
        return {"hit": ["ok hit"], "disarm": ["ok disarm", *ended]}.get(line) or usual(line)

    with connect(fake) as board:
        fake.answer = answer
        refused: list[BaseException] = []

        def other() -> None:
            fake.wait_for("hit")
            try:
                board.status()
            except RuntimeError as error:
                refused.append(error)
            board.disarm()

        thread = threading.Thread(target=other)
        thread.start()
        with pytest.raises(ValueError, match="^hit: the force went off"):
            board.hit(timeout_s=5)
        thread.join()
        assert len(refused) == 1


WAITS = """
import signal, sys, zwidth
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    with zwidth.Board.connect(commands=int(sys.argv[1])) as board:
        {call}
except KeyboardInterrupt:
    sys.exit(7)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("call", ["hit()", "walk()", "pulses(1)", "calibrate(9)", "selftest()", "zero()", "record(60)"])
def test_ctrl_c_stops_and_disarms_soon(fake: FakeBoard, call: str) -> None:
    line = {"pulses(1)": "pulses 1", "calibrate(9)": "calibrate 9", "record(60)": "get"}.get(call, call[:-2])
    fake.answer = lambda typed: [] if typed in ("zero", "selftest") else usual(typed)
    program = WAITS.format(call=f"board.get(); board.{call}")
    with subprocess.Popen([sys.executable, "-c", program, str(fake.port)], cwd=ROOT) as child:
        fake.wait_for(line, 20.0)
        time.sleep(0.2)
        fake.since()
        begun = time.monotonic()
        child.send_signal(signal.SIGINT)
        fake.wait_for("disarm")
        assert fake.at[-1] - begun < 0.5, "0.01 s on an idle machine"
        assert child.wait(10) == 7
        assert fake.since() == ["stop", "disarm", "disarm"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_script_that_ends_without_closing_has_disarmed(fake: FakeBoard) -> None:
    program = f"import zwidth; board = zwidth.Board.connect(commands={fake.port}); board.ask('arm')"
    command = [sys.executable, "-W", "always::ResourceWarning", "-c", program]
    made = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (made.returncode, made.stderr) == (0, ""), "before the interpreter takes things apart"
    assert fake.since()[-2:] == ["arm", "disarm"]
