"""Estimators beside the simulator's own controller: the same bits, whatever the blocks."""

import copy
import itertools
import signal
import sys
import time

import numpy as np
import pytest

import zwidth

SCENE = zwidth.Scene.load("paper-1um").replace({"wall_hit.settle_s": 0.6, "wall_hit.window_s": 0.4})


#: Those that know more than the position: a trace does not say what they knew.
TOLD = {"observer", "observer-force", "time-stamps", "fusion"}


def made(name: str, scene: zwidth.Scene) -> zwidth.Estimator:
    try:
        return zwidth.Estimator(name, scene, cutoff=500.0)
    except ValueError as error:
        assert "has no cutoff" in str(error), error
        return zwidth.Estimator(name, scene)


POSITION = [name for name in zwidth.ESTIMATORS if name not in TOLD]


@pytest.mark.parametrize("name", POSITION)
def test_it_says_what_the_loop_said_in_blocks_of_any_size(name: str) -> None:
    estimator = made(name, SCENE)
    assert estimator.needs is None
    cutoff = estimator.cutoff_hz
    trace = zwidth.hit(estimator.scene, stiffness=8000, damping=20, cutoff=cutoff, trace=True).trace
    assert trace is not None
    whole = estimator.process(trace.count)
    assert np.array_equal(whole, trace.velocity_m_per_s)
    random = np.random.default_rng(1)
    estimator.reset()
    ends = np.sort(random.integers(0, len(trace.count), 50))
    blocks = [trace.count[a:b] for a, b in itertools.pairwise([0, *ends, len(trace.count)])]
    parts = [estimator.process(block, bits=True) for block in blocks]
    assert np.array_equal(np.concatenate(parts) * estimator.lsb_m_per_s, whole)


def test_a_counter_that_wraps_makes_no_spike() -> None:
    estimator = zwidth.Estimator("difference", zwidth.Scene.load("paper-1um"))
    counts = (np.arange(-50, 50, dtype=np.int64) * 3) & 0xFFFF_FFFF
    velocity = estimator.process(counts)
    assert velocity[0] == 0.0
    assert np.allclose(velocity[1:], 3 * 1e-6 * 1e4, rtol=0, atol=estimator.lsb_m_per_s)


def test_the_width_of_the_counter_is_that_of_the_numbers() -> None:
    scene = zwidth.Scene.load("paper-1um")
    counts = np.arange(-50, 50) * 1000
    whole = zwidth.Estimator("difference", scene).process(counts)
    for kind in (np.int16, np.uint16, np.int32, np.uint32, np.int64):
        estimator = zwidth.Estimator("difference", scene)
        assert np.array_equal(estimator.process(counts.astype(kind)), whole), kind
    with pytest.raises(ValueError, match="another width"):
        estimator.process(counts.astype(np.int16))
    estimator.reset()
    assert np.array_equal(estimator.process(counts.astype(np.int16)), whole)
    for other in (counts.astype(np.int8), counts.astype(float), counts > 0):
        with pytest.raises(ValueError, match=f"counts are {other.dtype}, allowed whole numbers of 16, 32 or 64 bits"):
            zwidth.Estimator("difference", scene).process(other)


def test_a_force_in_newtons_is_no_force_of_the_core() -> None:
    observer = zwidth.Estimator("observer", zwidth.Scene.load("paper-1um"), cutoff=500)
    for force in (1.0, [1.0, 1.0], np.ones(2)):
        with pytest.raises(ValueError, match="force is float64, allowed whole numbers of 32 bits in the core's format"):
            observer.process([0, 1], force=force)
    with pytest.raises(ValueError, match="force is out of range"):
        observer.process([0, 1], force=[0, 2**31])
    stamps = zwidth.Estimator("time-stamps", zwidth.Scene.load("paper-1um"))
    with pytest.raises(ValueError, match="edge_age is float64, allowed whole numbers of 2"):
        stamps.process([0, 1], edge_age=[0.5, 0.5], edge_up=[True, True])
    with pytest.raises(ValueError, match="edge_up is float64, allowed truth values"):
        stamps.process([0, 1], edge_age=[1, 1], edge_up=[1.0, 0.0])
    for up in ([True, False], [1, 0]):
        assert len(stamps.process([0, 1], edge_age=[1, 1], edge_up=up)) == 2


def test_a_copy_goes_on_by_itself() -> None:
    estimator = zwidth.Estimator("butterworth", zwidth.Scene.load("paper-1um"), cutoff=500)
    estimator.process(np.arange(100))
    for other in (copy.copy(estimator), copy.deepcopy(estimator)):
        first = other.process(np.arange(100, 200))
        other.process(np.arange(200, 0, -1))
        again = copy.copy(estimator).process(np.arange(100, 200))
        assert np.array_equal(first, again)


@pytest.mark.parametrize("name", ["butterworth", "kalman-3"])
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_an_exception_leaves_the_state_at_any_time(name: str) -> None:
    class Rings(Exception):
        pass

    def ring(*_: object) -> None:
        raise Rings

    counts = np.arange(3_000_000)
    estimator = made(name, SCENE)
    estimator.process(np.arange(100, 0, -1))
    begun = time.monotonic()
    copy.copy(estimator).process(counts)
    took = time.monotonic() - begun
    after = copy.copy(estimator).process([7, 8, 9])
    before, rang = signal.signal(signal.SIGALRM, ring), 0
    try:
        for part in np.linspace(0.1, 1.0, 10):
            kept = copy.copy(estimator)
            whole = None
            try:
                signal.setitimer(signal.ITIMER_REAL, part * took)
                whole = kept.process(counts)
                signal.setitimer(signal.ITIMER_REAL, 0)
            except Rings:
                rang += 1
                assert whole is not None or np.array_equal(kept.process([7, 8, 9]), after), part
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert rang > 0


def test_what_is_missing_or_wrong_is_named() -> None:
    scene = zwidth.Scene.load("paper-1um")
    with pytest.raises(ValueError, match='no estimator "magic", allowed butterworth'):
        zwidth.Estimator("magic", scene)
    with pytest.raises(ValueError, match='estimator "dual-rate" is no more: use window-difference'):
        zwidth.Estimator("dual-rate", scene)
    with pytest.raises(ValueError, match="has no cutoff"):
        zwidth.Estimator("difference", scene, cutoff=500)
    with pytest.raises(ValueError, match="cutoff is 1e9|cutoff is 1000000000"):
        zwidth.Estimator("butterworth", scene, cutoff=1e9)
    observer = zwidth.Estimator("observer", scene, cutoff=500)
    assert observer.scene.to_dict()["velocity"]["mass_kg"] == scene.to_dict()["device"]["mass_kg"]
    assert observer.needs == "force"
    with pytest.raises(ValueError, match="needs force"):
        observer.process([0, 1, 2])
    assert len(observer.process([0, 1, 2], force=[0, 0, 0])) == 3
    with pytest.raises(ValueError, match="not as many"):
        observer.process([0, 1, 2], force=[0])
    with pytest.raises(ValueError, match="whole numbers"):
        observer.process([0.5])
