import pickle
from pathlib import Path

import numpy as np
import pytest

import zwidth
from conftest import ROOT


def test_every_built_in_scene_loads_and_comes_back_from_its_own_text() -> None:
    assert "paper-1um" in zwidth.SCENES
    for name in zwidth.SCENES:
        scene = zwidth.Scene.load(name)
        assert scene.name == name
        assert zwidth.Scene.parse(scene.to_toml()) == scene
        assert zwidth.Scene.load(ROOT / "scenes" / f"{name}.toml") == scene
        assert pickle.loads(pickle.dumps(scene)) == scene
        assert hash(scene) == hash(zwidth.Scene.load(name))


def test_values_are_exchanged_by_key_by_table_and_left_out() -> None:
    scene = zwidth.Scene.load("paper-1um")
    by_key = scene.replace({"encoder.resolution_m": 2e-6})
    assert by_key.to_dict()["encoder"]["resolution_m"] == 2e-6
    assert by_key == scene.replace(encoder={"resolution_m": np.float64(2e-6)})
    assert scene.to_dict()["encoder"]["resolution_m"] == 1e-6, "the scene itself stays"
    with_amplifier = scene.replace({"amplifier": {"bandwidth_hz": 1000}})
    assert with_amplifier.to_dict()["amplifier"]["bandwidth_hz"] == 1000.0
    assert with_amplifier.replace({"amplifier": None}) == scene
    with pytest.raises(AttributeError, match="replace"):
        scene.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        zwidth.Scene()


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"encoder.resolution_m": -1.0}, "encoder.resolution_m is -1, allowed"),
        ({"encoder.resolution": 1e-6}, "unknown field"),
        ({"encoder.resolution_m": "fine"}, "resolution_m"),
        ({"": 1.0}, "an empty key"),
        ({"encoder.resolution_m.x": 1.0}, "is no table"),
    ],
)
def test_what_is_not_allowed_is_refused_with_the_simulators_line(changes: dict[str, object], line: str) -> None:
    with pytest.raises(ValueError) as raised:
        zwidth.Scene.load("paper-1um").replace(changes)
    assert line in str(raised.value), raised.value


def test_a_file_names_itself_in_errors(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    text = zwidth.Scene.load("paper-1um").text
    file.write_text(text.replace("resolution_m = 1e-6", "resolution_m = nan"))
    with pytest.raises(ValueError, match=r"mine\.toml.*encoder\.resolution_m"):
        zwidth.Scene.load(file)
    with pytest.raises(ValueError, match="built-in scenes"):
        zwidth.Scene.load(tmp_path / "none.toml")
    with pytest.raises(TypeError, match="a scene holds no object"):
        zwidth.Scene.load("paper-1um").replace({"encoder.resolution_m": object()})


def test_a_curve_beside_a_scene_file_is_found_from_everywhere(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text("frequency_hz,threshold_rms_m\n1,1e-4\n1000,1e-6\n")
    text = zwidth.Scene.load("paper-1um").text
    file = tmp_path / "mine.toml"
    file.write_text(text.replace("[wall_hit]", '[wall_hit]\nfelt_curve = "curve.csv"'))
    scene = zwidth.Scene.load(file)
    other = scene.replace({"encoder.resolution_m": 2e-6})
    assert Path(other.to_dict()["wall_hit"]["felt_curve"]) == tmp_path / "curve.csv"
    assert pickle.loads(pickle.dumps(other)) == other


def test_a_rotary_scene_keeps_its_table() -> None:
    scene = zwidth.Scene.load("hapkit")
    keys = scene.to_dict()
    assert f"handle_radius_m = {keys['rotary']['handle_radius_m']}" in scene.text
    assert keys["device"]["mass_kg"] > 0.0, "the tables that follow from it are at the handle"
    wider = scene.replace(rotary={"handle_radius_m": 0.1})
    assert wider.to_dict()["rotary"]["handle_radius_m"] == 0.1
    assert "rotary" not in zwidth.Scene.load("paper-1um").to_dict()
