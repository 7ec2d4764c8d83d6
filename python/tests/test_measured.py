"""What was measured on a device, beside what the command line makes of it: the same bits."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zwidth
from conftest import ROOT, Run, becomes_table, followed, refuses, rows, same_table, saved, simulate

KNOWN = ROOT / "examples/known.toml"
PULSE = ROOT / "examples/pulse.bin"
GAIN: dict[str, Any] = {"gain": 0.5906}


@pytest.fixture(scope="module")
def base() -> zwidth.Scene:
    return zwidth.Scene.load(KNOWN)


def options(asked: dict[str, Any]) -> list[object]:
    """The command line's options for arguments of `identify`."""
    made: list[object] = []
    for name, value in asked.items():
        option = "--" + name.replace("_", "-")
        match name, value:
            case "terms", str():
                made += [option, value]
            case "terms", _:
                made += [f"--{term}" for term in value]
            case "spring", _:
                made += [] if value else ["--no-spring"]
            case "span", (start, end):
                made += [] if start is None else ["--from", start]
                made += [] if end is None else ["--to", end]
            case _, bool():
                made += [option] if value else []
            case _:
                made += [option, value]
    return made


def same_estimate(said: dict[str, float] | None, mine: zwidth.Estimate | None) -> None:
    assert said == (None if mine is None else {name: getattr(mine, name) for name in said or {}})


def told(asked: dict[str, Any], sim: Run, out: Path) -> zwidth.Identification:
    base = zwidth.Scene.load(KNOWN)
    made = zwidth.identify(PULSE, base=base, **asked)
    said = sim("identify", PULSE, "--base", KNOWN, *options(asked), "--out", out / "a.toml", "--csv", out / "a.csv")
    for key in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "rest_position_m", "gain_n_per_v", "latency_s"):
        same_estimate(said[key], getattr(made, key))
    terms = said.get("terms", {"tests": []})
    for key in ("friction_n", "amplifier_lag_s", "offset_n"):
        same_estimate(terms.get(key), getattr(made, key))
    error = terms.get("encoder_error")
    assert (error is None) == (made.encoder_error is None)
    for key in error or ():
        same_estimate(error[key], getattr(made.encoder_error, key))
    assert terms["tests"] == [vars(test) for test in made.tests]
    for key in ("rows", "step_s", "confidence", "gain_source", "widening"):
        assert said[key] == getattr(made, key), key
    assert said["logs"] == list(made.logs)
    assert said["residual"] == vars(made.residual)
    initial = made.initial
    assert said["initial"] == [
        dict(zip(initial, values, strict=True)) for values in zip(*initial.values(), strict=True)
    ]
    arguments = [
        line.replace("--no-spring", "spring=False").replace("--fit-latency", "fit_latency") for line in said["warnings"]
    ]
    assert arguments == list(made.warnings)
    assert made.scene == zwidth.Scene.load(out / "a.toml")
    # The command line writes fewer digits of these.
    formats = {"time_s": ".7f", "voltage_v": "", "position_m": "", "model_m": ".9f", "residual_m": ".3e"}
    (fit,) = made.fits
    table = rows(out / "a.csv")
    assert list(table[0]) == list(fit) == list(made.columns()) == list(formats)
    for name, form in formats.items():
        assert [float(row[name]) for row in table] == [float(f"{value:{form}}") for value in fit[name]], name
    assert made.to_pandas().shape == (made.rows, 5)
    return made


# The record has friction and a slow amplifier, and is a bad one without them.
SPAN: dict[str, Any] = {"span": (0.061, 3.238)}
ASKED: list[dict[str, Any]] = [
    GAIN | SPAN,
    GAIN | SPAN | {"terms": ["friction", "amplifier"], "fit_latency": True, "latency": 0.0},
    GAIN | SPAN | {"terms": ["friction", "phase"], "encoder_cycle": 1e-3},
    GAIN | SPAN | {"terms": ["friction", "offset"], "rest_position": 0.0},
    GAIN | SPAN | {"resolution": 2e-6},
    SPAN | {"torque_constant": 0.05, "amplifier_gain": 1.0, "drum_radius": 0.08},
    SPAN | {"calibration_mass": 0.5, "calibration_voltage": 8.0},
]


@pytest.mark.parametrize("asked", ASKED)
def test_an_identification(asked: dict[str, Any], sim: Run, tmp_path: Path) -> None:
    told(asked, sim, tmp_path)


def test_records_of_every_form_and_number(base: zwidth.Scene, sim: Run, tmp_path: Path) -> None:
    frames = tmp_path / "frames.csv"
    assert simulate("telemetry", PULSE, "--csv", frames).returncode == 0
    one = zwidth.identify(PULSE, base=base, **GAIN, **SPAN)
    again = zwidth.identify(frames, base=base, **GAIN, **SPAN)
    assert (one.mass_kg, one.residual) == (again.mass_kg, again.residual)
    log = tmp_path / "log.csv"
    fit = one.fits[0]
    lines = zip(fit["time_s"], fit["voltage_v"], fit["position_m"], strict=True)
    text = "".join(f"{t!r},{u!r},{x!r}\n" for t, u, x in (map(float, line) for line in lines))
    log.write_text("time_s,voltage_v,position_m\n" + text)
    both = zwidth.identify([str(log), PULSE], base=base, **GAIN, **SPAN)
    said = sim("identify", log, PULSE, "--base", KNOWN, *options(GAIN | SPAN))
    assert said["mass_kg"] == vars(both.mass_kg)
    assert said["logs"] == list(both.logs) == [str(log), str(PULSE)]
    assert len(both.fits) == len(said["initial"]) == len(both.initial["time_s"]) == 2


def test_a_bad_identification(base: zwidth.Scene, refused: Run, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time_s,voltage_v,position_m\n0,0,0\n")
    refusals: list[tuple[Path, dict[str, Any]]] = [
        (PULSE, {}),
        (PULSE, GAIN),
        (PULSE, GAIN | SPAN | {"terms": "none"}),
        (PULSE, GAIN | {"latency": -3.0}),
        (PULSE, GAIN | {"resolution": 0.1}),
        (PULSE, GAIN | {"encoder_cycle": 9.0}),
        (PULSE, GAIN | {"rest_position": 1e9}),
        (PULSE, {"gain": -1.0}),
        (PULSE, SPAN | {"added_mass": 0.2}),
        (PULSE, GAIN | SPAN | {"terms": ["offset"]}),
        (PULSE, GAIN | SPAN | {"spring": False}),
        (log, GAIN),
        (tmp_path / "missing.csv", GAIN),
    ]
    for path, asked in refusals:
        line = refused("identify", path, "--base", KNOWN, *options(asked)).replace("--no-spring", "spring=False")
        line = re.sub(r"--([a-z-]+)", lambda option: option[1].replace("-", "_"), line)
        refuses(zwidth.identify, line, path, base=base, **asked)
    bad: list[tuple[dict[str, Any], str]] = [
        (GAIN | SPAN | {"added_mass": 1.0}, "more than one way"),
        (SPAN | {"torque_constant": 1.0}, "is not given"),
        (GAIN | {"terms": ["lag"]}, 'terms has "lag", allowed auto or none alone, or some of friction, stribeck, amplifier'),
    ]
    for asked, words in bad:
        with pytest.raises(ValueError, match=words):
            zwidth.identify(PULSE, base=base, **asked)
    with pytest.raises(ValueError, match="records is empty"):
        zwidth.identify([], base=base, **GAIN)


def test_a_device_that_no_scene_may_have_says_so_where_the_scene_is_asked_for(
    base: zwidth.Scene, refused: Run, tmp_path: Path
) -> None:
    weak: dict[str, Any] = {"gain": 0.1}  # its full force is below the push of a hit
    made = zwidth.identify(PULSE, base=base, **SPAN, **weak)
    with pytest.raises(ValueError) as raised:
        _ = made.scene
    asked = options(SPAN | weak)
    line = refused("identify", PULSE, "--base", KNOWN, *asked, "--out", tmp_path / "a.toml")
    assert line.replace(str(KNOWN), "known") == str(raised.value)


@pytest.mark.parametrize("name", ["paper-1um", "nucleo-f446re", KNOWN, "rice-paddle"])
def test_a_plan(sim: Run, name: str | Path) -> None:
    scene = zwidth.Scene.load(name)
    made = zwidth.identify_plan(scene)
    said = sim("identify", "--plan", "--base", name)
    same: tuple[str, ...] = ("scene",)
    if name != "rice-paddle":  # the command line says lengths and forces of a rotary scene in its units
        same += ("start_m", "push_n", "force_rms_n", "continuous_force_n")
        assert list(made.pulses) == list(said["pulses"][0])
        for key, values in made.pulses.items():
            assert [pulse[key] for pulse in said["pulses"]] == values.tolist(), key
    for key in same:
        assert said[key] == getattr(made, key), key
    for key in ("guessed", "console"):
        assert said[key] == list(getattr(made, key)), key
    assert made.pulses["push_n"][0] == made.push_n > made.force_rms_n > 0
    assert made.console[0] == "zero" and made.console[-1] == "disarm"
    becomes_table(made, made.pulses)


def test_a_bad_plan(refused: Run, tmp_path: Path) -> None:
    scene = zwidth.Scene.load("paper-1um").replace({"safety.speed_max_m_per_s": 1e-4})
    refuses(zwidth.identify_plan, refused("identify", "--plan", "--base", saved(scene, tmp_path)), scene)


@pytest.mark.parametrize("own", [False, True])
def test_an_agreement(base: zwidth.Scene, sim: Run, tmp_path: Path, own: bool) -> None:
    measured = ROOT / "docs/data/tutorial-measured.csv"
    if own:
        measured = tmp_path / "own.csv"
        assert simulate("walk", KNOWN, "--cutoff", 1500, "--csv", measured).returncode == 0
    made = followed(zwidth.agree, base, measured)
    said = sim("agree", KNOWN, measured, "--csv", tmp_path / "a.csv")
    same_table(rows(tmp_path / "a.csv"), made.walls)
    for wall, values in zip(said["walls"], zip(*made.walls.values(), strict=True), strict=True):
        assert list(wall.values()) == [None if math.isnan(value) else value for value in values]
    assert said["suspects"] == [
        {name: getattr(suspect, name) for name in said["suspects"][0]} for suspect in made.suspects
    ]
    names = ("scene", "measured", "cutoff_hz", "agrees")
    for key in (*names, "stiffness_step_n_per_m", "distance_n_per_m", "scatter_n_per_m"):
        assert said[key] == getattr(made, key), key
    assert said["answers"] == list(made.answers)
    assert made.agrees == own == (len(made.suspects) == 0)
    becomes_table(made, made.walls)


def test_a_bad_agreement(base: zwidth.Scene, refused: Run, tmp_path: Path) -> None:
    walk = tmp_path / "walk.csv"
    head = "cutoff_hz,damping_n_s_per_m,stiffness_n_per_m\n"
    for text in (head, head + "1500,33,4000\n", head + "1500,20,x\n", head + "99999,20,4000\n", "a,b\n"):
        walk.write_text(text)
        refuses(zwidth.agree, refused("agree", KNOWN, walk), base, walk)
    with pytest.raises(ValueError, match="cannot be read"):
        zwidth.agree(base, tmp_path / "missing.csv")


SAMPLES = ROOT / "examples/samples.bin"


@pytest.mark.parametrize(
    "estimator, cutoff", [(None, None), ("butterworth", 100), ("kalman-3", 500), ("taylor-2", 1000)]
)
def test_a_replay(sim: Run, tmp_path: Path, estimator: str | None, cutoff: float | None) -> None:
    scene = zwidth.Scene.load("paper-1um")
    asked: dict[str, Any] = {"estimator": estimator, "cutoff": cutoff}
    asked = {name: value for name, value in asked.items() if value is not None}
    made = zwidth.replay(scene, SAMPLES, **asked)
    said = sim("replay", SAMPLES, "--scene", "paper-1um", *options(asked), "--csv", tmp_path / "a.csv")
    same_table(rows(tmp_path / "a.csv"), made.table)
    mine = vars(made)
    told = {name: value for name, value in said.items() if name not in ("command", "schema_version")}
    assert told == {name: value for name, value in mine.items() if name not in ("table", "lsb_m_per_s")}
    board = made.table["board_velocity_lsb"].astype(float) * made.lsb_m_per_s
    assert made.samples > 20_000 and 1e-3 < np.abs(board).max() < 10
    becomes_table(made, made.table)


def test_a_bad_replay(refused: Run, tmp_path: Path) -> None:
    scene = zwidth.Scene.load("paper-1um")
    empty = tmp_path / "empty.bin"
    empty.write_bytes(b"nothing")
    refusals: list[tuple[Path, dict[str, Any]]] = [
        (SAMPLES, {"estimator": "kalman"}),
        (SAMPLES, {"estimator": "fusion"}),
        (SAMPLES, {"cutoff": 1e6}),
        (PULSE, {}),
        (empty, {}),
        (tmp_path / "missing.bin", {}),
    ]
    for path, asked in refusals:
        line = refused("replay", path, "--scene", "paper-1um", *options(asked))
        refuses(zwidth.replay, line.removeprefix("--"), scene, path, **asked)
