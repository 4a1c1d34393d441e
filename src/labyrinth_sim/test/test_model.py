# SPDX-License-Identifier: Apache-2.0
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from labyrinth_sim.config import names
from labyrinth_sim.effect import drives, effects
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import DriveUse, EffectUse, load_model, save_model
from labyrinth_sim.registry import Registry
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


def test_a_complaint_names_file_line_and_parameter(tmp_path: Path) -> None:
    text = Path(load_model("horn").path or "").read_text().replace("value: 10.0", "value: 1.0e+6").replace("N m s/", "")
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        load_model(tmp_path / "wrong.yaml")
    first, second = caught.value.complaints
    assert first.startswith(f"{tmp_path / 'wrong.yaml'}:9: drive.horn.stiffness: must lie within [1e-05, ")
    assert first.endswith("got 1e+06.")
    expected = "drive.horn.damping: must be given in N m s/rad, got unit 'rad'. Convert the value."
    assert second == f"{tmp_path / 'wrong.yaml'}:10: {expected}"


def test_a_rig_is_found_beside_its_model_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    horn = load_rig("horn")
    (tmp_path / "study").mkdir()
    shutil.copy(horn.mjcf, tmp_path / "study" / "own.xml")
    rig = yaml.safe_load(Path(horn.path or "").read_text())
    (tmp_path / "study" / "own_rig.yaml").write_text(yaml.safe_dump({**rig, "name": "own", "mjcf": "own.xml"}))
    model = yaml.safe_load(Path(load_model("horn").path or "").read_text())
    (tmp_path / "study" / "own.yaml").write_text(yaml.safe_dump({**model, "rig": "own_rig.yaml"}))
    monkeypatch.chdir(tmp_path)
    first = load_model("study/own.yaml")
    save_model(first, Path("study/saved.yaml"))
    save_model(first, Path("elsewhere/saved.yaml"))
    (tmp_path / "study").rename(tmp_path / "moved")
    assert load_model("moved/saved.yaml").rig.path == tmp_path / "moved" / "own_rig.yaml"
    # There the rig is named in full, for it was in another folder than the model.
    with pytest.raises(InputError, match=r"saved.yaml:3: rig: Unknown rig .*study/own_rig.yaml"):
        load_model("elsewhere/saved.yaml")
    monkeypatch.chdir("moved")
    assert load_model("own.yaml").rig == load_model(tmp_path / "moved" / "own.yaml").rig


def test_a_path_in_a_model_is_not_relative_to_where_the_program_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(load_rig("horn").path or "", tmp_path / "own_rig.yaml")
    model = yaml.safe_load(Path(load_model("horn").path or "").read_text())
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "own.yaml").write_text(yaml.safe_dump({**model, "rig": "own_rig.yaml"}))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"Searched: {tmp_path / 'folder'}"):
        load_model("folder/own.yaml")


def test_numbers_that_nobody_stated_are_listed(tmp_path: Path) -> None:
    model = yaml.safe_load(Path(load_model("pendulum").path or "").read_text())
    del model["drives"]["pendulum"]["values"]["voltage"]
    del model["drives"]["pendulum"]["values"]["delay"]  # 0 adds nothing
    del model["effects"][0]["values"]["torque"]  # at its default this effect does nothing
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(model))
    (voltage,) = load_model(tmp_path / "model.yaml").unstated()
    assert (voltage.name, voltage.value, voltage.unit) == ("drive.pendulum.voltage", 7.4, "V")
    assert load_model(tmp_path / "model.yaml").with_values({"drive.pendulum.voltage": 5.0}).unstated() == ()
    assert all(load_model(name).unstated() == () for name in names("models"))


@pytest.mark.parametrize("kind", drives())
def test_what_a_drive_leaves_out_is_listed_or_adds_nothing(kind: str) -> None:
    model = load_model("two_link_arm")
    model = replace(model, drives={axis: DriveUse(drives()[kind], {}) for axis in model.drives})
    mine = {name: info for name, info in model.parameters().items() if name.startswith("drive.")}
    listed = {info.name: info.value for info in model.unstated()}
    assert listed and set(listed) == {name for name, info in mine.items() if info.value not in (0.0, info.off)}
    stated = model.with_values(listed)
    assert stated.unstated() == () and stated.values() == model.values()


@pytest.mark.parametrize("name", effects())
def test_what_an_effect_leaves_out_is_listed_or_adds_nothing(name: str) -> None:
    model = next(m for m in map(load_model, ("two_link_arm", "labyrinth")) if m.places(name))
    use = EffectUse(effects()[name], model.places(name)[0], {})
    model = replace(model, effects=(*model.effects, use))
    mine = {n: info for n, info in model.parameters().items() if n.startswith(f"{name}.{use.place}.")}
    listed = {info.name: info.value for info in model.unstated()}
    assert set(listed) == {n for n, info in mine.items() if info.value not in (0.0, info.off)}
    assert model.with_values(listed).unstated() == ()


def test_half_a_model_is_not_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(data: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("labyrinth_sim.model.yaml_text", fails)
    with pytest.raises(InputError, match="No space left"):
        save_model(load_model("horn"), tmp_path / "model.yaml")
    assert not list(tmp_path.iterdir())


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


def test_a_registry_travels_with_its_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bent_sensor.py").write_text(OWN)
    registry = Registry.load(tmp_path)
    assert registry.effect("bent_sensor").name == "bent_sensor"
    assert registry.rivals("bent_sensor") == {"sensor_gain"}
    assert "bent_sensor" in registry.rivals("sensor_gain")
    assert "bent_sensor" not in Registry.load().rivals("sensor_gain")
    with pytest.raises(InputError, match="Did you mean 'torque_pd'"):
        registry.drive("torque_pid")
    model = load_model("two_link_arm", registry)
    assert pickle.loads(pickle.dumps(model.registry)).folder == tmp_path
    monkeypatch.setenv("EPS_TUNNEL_EFFECTS", str(tmp_path))
    assert Registry.load().folder == tmp_path
    assert "bent_sensor" in load_model("two_link_arm").registry.effects


def test_an_effect_of_the_users_own_is_found(tmp_path: Path) -> None:
    (tmp_path / "bent_sensor.py").write_text(OWN)
    assert "bent_sensor" in effects(tmp_path)
    assert "bent_sensor" not in effects()
    plain_model = load_model("two_link_arm", tmp_path)
    assert plain_model.places("bent_sensor") == ("shoulder", "elbow")
    model = plain_model.with_effect("bent_sensor", "elbow")
    again = load_model(save_model(model, tmp_path / "bent.yaml"), plain_model.registry)
    assert again.effects == model.effects
    with pytest.raises(InputError, match="Unknown effect 'bent_sensor'"):
        load_model("two_link_arm").with_effect("bent_sensor", "elbow")
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
        ({"effects": 3}, "effects: expected a list, got 3"),
        ({"quantities": 4}, "quantities: expected a mapping, got 4"),
        ({"provenance": 7}, "provenance: expected a mapping, got 7"),
        ({"drives": {"horn": {"kind": ["x"], "values": 7}}}, "drives.horn.kind: expected text, got ['x']"),
        ({"drives": {"horn": {"kind": "x"}}}, "drives.horn.kind: Unknown drive 'x'"),
        ({"drives": {}}, "drives: axis 'horn' has no drive"),
        ({"effects": [3]}, "effects[0]: expected a mapping, got 3"),
        ({"rig": 5}, "rig: Unknown rig '5'"),
        ({"rig": ""}, "rig: Unknown rig ''"),
        ({"rig": ["x"]}, "rig: expected text, got ['x']"),
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


def test_an_effect_of_an_installed_package_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    about = tmp_path / "bent-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: bent\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[labyrinth_sim.effects]\nbent = bent_package:EFFECT\n")
    (tmp_path / "bent_package.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    assert "bent_sensor" in effects()
