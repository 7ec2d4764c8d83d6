"""Estimators beside the simulator's own controller: the same bits, whatever the blocks."""

import itertools

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
