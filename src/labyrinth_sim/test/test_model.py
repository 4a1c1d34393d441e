# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest
import yaml

from labyrinth_sim.config import names
from labyrinth_sim.effect import effects
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model, save_model
from labyrinth_sim.rig import load_rig
from labyrinth_sim.simulate import simulate

OWN = """
from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.filters import Map

def measure(values, site, step, start):
    return Map(lambda angle: angle + values["size"][:, None] * angle**2)

EFFECT = Effect(
    name="bent_sensor", title="Bent sensor", physics="The scale is bent.", equation="y = a + c a^2",
    parameters=(Parameter("size", "1/rad", 0.0, 1.0, 0.0, 0.5, "an example"),), stage="measurement", mark="Bent.",
    shows="scaled", confused_with=("sensor_gain",), separated_by="Large angles.", where="signal", measure=measure)
"""


@pytest.mark.parametrize("name", names("models"))
def test_every_model_of_ours_runs(name: str) -> None:
    model = load_model(name)
    trials = simulate(model, np.arange(51) * 0.01, np.full((51, len(model.rig.axes)), 0.05))
    assert np.isfinite(trials.values).all()
    assert trials.values[0, -1, 0] != 0.0
    assert all(info.unit and info.source for info in model.parameters().values())


def test_saving_and_loading_keeps_everything(tmp_path: Path) -> None:
    model = load_model("labyrinth").with_effect("backlash", "x", {"width": 0.02}).with_effect("sensor_bias", "board_y")
    model = model.with_values({"joint.motor_x.armature": 0.02, "drive.y.p": 7.25}, source="a test")
    again = load_model(save_model(model, tmp_path / "mine.yaml"))
    assert again.parameters() == model.parameters()
    assert again.parameters()["drive.y.p"].source == "a test"
    with pytest.raises(InputError, match="never overwritten"):
        save_model(model, tmp_path / "mine.yaml")


def test_a_bad_model_file_gets_all_its_complaints(tmp_path: Path) -> None:
    wrong = {
        "name": "wrong",
        "rig": "horn",
        "drives": {
            "horn": {
                "kind": "torque_pd",
                "values": {
                    "stiffness": {"value": 1e6, "unit": "N m/rad", "from": "x"},
                    "damping": {"value": 0.1, "unit": "deg", "from": "x"},
                    "dampening": {"value": 0.1, "unit": "N m s/rad", "from": "x"},
                },
            }
        },
        "effects": [
            {"name": "backlsh", "place": "horn", "values": {}},
            {"name": "rolling_friction", "place": "ball", "values": {}},
            {"name": "cross_coupling", "place": "horn", "values": {}},
        ],
        "quantities": {"joint.horn.armatur": {"value": 0.1, "unit": "kg m^2", "from": "x"}},
    }
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(wrong))
    with pytest.raises(InputError) as caught:
        load_model(path)
    text = str(caught.value)
    assert len(caught.value.complaints) == 7, text
    for part in ("must lie within", "'deg'", "'damping'", "'backlash'", "no ball", "other_axis", "joint.horn.armature"):
        assert part in text


def test_an_mjcf_that_does_not_compile_is_told(tmp_path: Path) -> None:
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>")
    rig = yaml.safe_load(Path(load_rig("horn").path or "").read_text())
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({**rig, "mjcf": "broken.xml"}))
    model = yaml.safe_load(Path(load_model("horn").path or "").read_text())
    (tmp_path / "model.yaml").write_text(yaml.safe_dump({**model, "rig": "rig.yaml"}))
    with pytest.raises(InputError, match=r"broken\.xml does not compile.*mass"):
        load_model(tmp_path / "model.yaml")


def test_a_rig_that_misnames_its_mjcf_hears_the_names(tmp_path: Path) -> None:
    rig = yaml.safe_load(Path(load_rig("horn").path or "").read_text())
    rig["axes"]["horn"] |= {"joint": "hron", "actuator": "hron"}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    model = yaml.safe_load(Path(load_model("horn").path or "").read_text())
    (tmp_path / "model.yaml").write_text(yaml.safe_dump({**model, "rig": "rig.yaml"}))
    with pytest.raises(InputError) as caught:
        load_model(tmp_path / "model.yaml")
    assert len(caught.value.complaints) == 2
    assert "Did you mean 'horn'" in str(caught.value)


def test_an_effect_of_the_users_own_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bent_sensor.py").write_text(OWN)
    assert "bent_sensor" in effects(tmp_path)
    assert "bent_sensor" not in effects()
    monkeypatch.setenv("EPS_TUNNEL_EFFECTS", str(tmp_path))
    model = load_model("two_link_arm").with_effect("bent_sensor", "elbow")
    trials = simulate(model, np.arange(51) * 0.01, np.full((51, 2), 0.5))
    plain = simulate(load_model("two_link_arm"), np.arange(51) * 0.01, np.full((51, 2), 0.5))
    column = trials.index("elbow")
    bent = plain.values[0, :, column] + 0.5 * plain.values[0, :, column] ** 2
    assert trials.values[0, :, column] == pytest.approx(bent, abs=1e-12)


@pytest.mark.parametrize("text", ["raise ValueError('no')", "EFFECT = 3", "x = 1"])
def test_a_broken_effect_file_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "broken.py").write_text(text)
    with pytest.raises(InputError, match=r"broken\.py"):
        effects(tmp_path)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"effects": 3}, "'effects' must be a list"),
        ({"quantities": 4}, "'quantities' must be a mapping"),
        ({"provenance": 7}, "'provenance' must be a mapping"),
        ({"drives": {"horn": {"kind": ["x"], "values": 7}}}, "Unknown drive"),
        ({"rig": 5}, "Unknown rig '5'"),
    ],
)
def test_a_malformed_entry_is_told_beside_an_unknown_one(
    tmp_path: Path, change: dict[str, object], complaint: str
) -> None:
    horn = yaml.safe_load(load_model("horn").path.read_text())
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump({**horn, **change, "colour": "red"}))
    with pytest.raises(InputError) as told:
        load_model(tmp_path / "wrong.yaml")
    assert complaint in str(told.value)
    assert "colour" in str(told.value)


@pytest.mark.parametrize(
    "change",
    [{"mjcf": 7}, {"sample_time": True}, {"ball": 3}, {"topics": [1]}, {"axes": {"a": {"limits": ["a", "b"]}}}],
)
def test_a_malformed_rig_is_told(tmp_path: Path, change: dict[str, object]) -> None:
    horn = yaml.safe_load(load_rig("horn").path.read_text())
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({**horn, **change}))
    with pytest.raises(InputError):
        load_rig(tmp_path / "rig.yaml")


def test_an_effect_of_an_installed_package_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    about = tmp_path / "bent-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: bent\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[labyrinth_sim.effects]\nbent = bent_package:EFFECT\n")
    (tmp_path / "bent_package.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    assert "bent_sensor" in effects()
