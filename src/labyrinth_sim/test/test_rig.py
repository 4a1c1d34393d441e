# SPDX-License-Identifier: Apache-2.0
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from labyrinth_sim.effect import slide_unit
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.rig import Rig, load_rig
from labyrinth_sim.simulate import simulate

# A carriage on a rail, and an arm on the carriage.
CARRIAGE = """
<mujoco model="carriage">
  <compiler angle="radian" autolimits="true"/>
  <default><default class="rail"><joint type="slide" axis="1 0 0" armature="0.5"/></default></default>
  <worldbody>
    <body name="carriage">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <joint name="Rail_X" class="rail"/>
      <body name="arm">
        <inertial pos="0 0 -0.1" mass="0.1" diaginertia="0.001 0.001 0.001"/>
        <joint name="FL_hip_joint" axis="0 1 0" armature="0.01"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="Rail_X" joint="Rail_X"/><motor name="hip" joint="FL_hip_joint"/></actuator>
</mujoco>
"""


TURNING = {"N/m": "N m/rad", "N s/m": "N m s/rad", "N": "N m"}


def carriage() -> dict[str, Any]:
    return {
        "name": "carriage",
        "mjcf": "carriage.xml",
        "axes": {
            "Rail": {
                "command": "Rail_X",
                "actuator": "Rail_X",
                "joint": "Rail_X",
                "limits": [-1.0, 1.0],
                "measured": {
                    "Rail_X": {"joint": "Rail_X", "quantity": "position"},
                    "Rail_X_velocity": {"joint": "Rail_X", "quantity": "velocity"},
                    "Rail_X_effort": {"joint": "Rail_X", "quantity": "torque"},
                },
            },
            "Hip": {
                "command": "FL_hip_joint",
                "actuator": "hip",
                "joint": "FL_hip_joint",
                "measured": {"FL_hip_joint": {"joint": "FL_hip_joint", "quantity": "position"}},
            },
        },
    }


def written(folder: Path, rig: dict[str, Any]) -> Path:
    (folder / "carriage.xml").write_text(CARRIAGE)
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig, sort_keys=False))
    return folder / "rig.yaml"


def with_signal(folder: Path, axis: str, quantity: str, **entry: object) -> Rig:
    rig = carriage()
    rig["axes"][axis]["measured"] = {"s": {"joint": rig["axes"][axis]["joint"], "quantity": quantity, **entry}}
    return load_rig(written(folder, rig))


def test_slide_joints_are_axes_in_m_and_n_and_names_may_be_upper_case(tmp_path: Path) -> None:
    rig = load_rig(written(tmp_path, carriage()))
    assert dict(zip(rig.signals, rig.units, strict=True)) == {
        "Rail_X": "m", "Rail_X_velocity": "m/s", "Rail_X_effort": "N", "FL_hip_joint": "rad",
    }  # fmt: skip
    assert (rig.axis("Rail").slides, rig.axis("Hip").slides) == (True, False)
    assert (rig.sample_time, rig.rate) == (0.01, 100.0)
    assert rig.positions == ("Rail_X", "FL_hip_joint")


def test_a_model_of_a_slide_joint_is_in_its_units_and_runs(tmp_path: Path) -> None:
    written(tmp_path, carriage())
    values = {"stiffness": (50.0, "N/m"), "damping": (5.0, "N s/m"), "torque": (10.0, "N"), "delay": (0.0, "s")}
    drives: dict[str, Any] = {"Rail": {"kind": "torque_pd", "values": {}}, "Hip": {"kind": "torque_pd", "values": {}}}
    for name, (value, unit) in values.items():
        for axis, own in (("Rail", unit), ("Hip", TURNING.get(unit, unit))):
            drives[axis]["values"][name] = {"value": value, "unit": own, "from": "chosen"}
    mass = {"joint.Rail_X.armature": {"value": 0.2, "unit": "kg", "from": "chosen"}}
    content = {"name": "carriage", "rig": "rig.yaml", "drives": drives, "quantities": mass}
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    model = load_model(tmp_path / "model.yaml").with_effect("viscous_friction", "Rail", {"damping": 0.5})
    units = {name: info.unit for name, info in model.parameters().items()}
    assert units["drive.Rail.stiffness"] == "N/m"
    assert units["drive.Hip.stiffness"] == "N m/rad"
    assert units["viscous_friction.Rail.damping"] == "N s/m"
    assert units["joint.Rail_X.armature"] == "kg"
    assert units["joint.FL_hip_joint.armature"] == "kg m^2"
    assert model.effects[0].values["damping"].unit == "N s/m"
    commands = np.column_stack([np.full(301, 0.2), np.zeros(301)])
    trials = simulate(model, np.arange(301) * 0.01, commands)
    assert trials.units == model.rig.units
    assert trials.values[0, -1, trials.index("Rail_X")] == pytest.approx(0.2, abs=1e-3)
    content["drives"]["Rail"]["values"]["stiffness"]["unit"] = "N m/rad"
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match="must be given in N/m, got unit 'N m/rad'"):
        load_model(tmp_path / "wrong.yaml")


@pytest.mark.parametrize(
    ("hinge", "slide"),
    [("N m s/rad", "N s/m"), ("kg m^2", "kg"), ("1/rad^2", "1/m^2"), ("N m/A", "N/A"), ("1/s^2", "1/s^2")],
)
def test_units_of_a_slide_joint(hinge: str, slide: str) -> None:
    assert slide_unit(hinge) == slide


@pytest.mark.parametrize(
    ("axis", "quantity", "entry", "recorded", "si"),
    [
        ("Hip", "position", {}, 0.25, 0.25),
        ("Hip", "position", {"unit": "deg"}, 90.0, math.pi / 2),
        ("Hip", "position", {"unit": "deg", "zero": 45}, 90.0, math.pi / 4),
        ("Hip", "position", {"unit": "ticks", "ticks_per_turn": 4096, "zero": 2048}, 3072, math.pi / 2),
        ("Hip", "position", {"unit": "ticks", "ticks_per_turn": -4096}, 1024, -math.pi / 2),
        ("Hip", "velocity", {"unit": "rpm"}, 60.0, 2 * math.pi),
        ("Hip", "velocity", {"unit": "deg/s"}, 180.0, math.pi),
        ("Hip", "velocity", {"unit": "ticks/s", "ticks_per_turn": 4096}, 4096, 2 * math.pi),
        ("Hip", "torque", {"unit": "A", "torque_constant": 1.5}, 2.0, 3.0),
        ("Hip", "torque", {"unit": "mA", "torque_constant": 1.5}, 2000.0, 3.0),
        ("Hip", "torque", {"unit": "duty", "stall_torque": 4.0}, -0.5, -2.0),
        ("Rail", "position", {"unit": "mm"}, 250.0, 0.25),
        ("Rail", "position", {"unit": "ticks", "ticks_per_m": 1e5}, 5e4, 0.5),
        ("Rail", "velocity", {"unit": "mm/s"}, 250.0, 0.25),
        ("Rail", "torque", {"unit": "A", "torque_constant": 20.0}, 0.5, 10.0),
    ],
)
def test_recorded_units_become_si(
    tmp_path: Path, axis: str, quantity: str, entry: dict[str, object], recorded: float, si: float
) -> None:
    (channel,) = with_signal(tmp_path, axis, quantity, **entry).axis(axis).measured
    assert channel.recorded.to_si([[recorded, channel.recorded.zero]]) == pytest.approx(np.array([[si, 0.0]]))
    assert channel.unit in ("rad", "rad/s", "N m", "m", "m/s", "N")
    assert not channel.recorded.free


@pytest.mark.parametrize(
    ("unit", "si", "recorded", "seen"),
    [("A", "A", 2.0, 2.0), ("mA", "A", 2.0, 2e-3), ("duty", "1", 0.5, 0.5), ("raw", "1", 9, 9)],
)
def test_an_effort_without_its_constant_is_no_torque(
    tmp_path: Path, unit: str, si: str, recorded: float, seen: float
) -> None:
    rig = with_signal(tmp_path, "Hip", "torque", unit=unit)
    (channel,) = rig.axis("Hip").measured
    assert (channel.recorded.free, channel.unit) == (True, si)
    assert channel.recorded.to_si(recorded) == pytest.approx(seen)
    assert rig.units[-1] == si


def test_a_tick_is_a_resolution_and_resolutions_are_in_the_recorded_unit(tmp_path: Path) -> None:
    for entry, tick in (
        ({"unit": "ticks", "ticks_per_turn": -4096}, 2 * math.pi / 4096),
        ({"unit": "ticks", "ticks_per_turn": 4096, "resolution": 4}, 8 * math.pi / 4096),
        ({"unit": "deg", "resolution": 0.1}, math.radians(0.1)),
        ({"resolution": 0.005}, 0.005),
        ({}, 0.0),
    ):
        (channel,) = with_signal(tmp_path, "Hip", "position", **entry).axis("Hip").measured
        assert channel.resolution == pytest.approx(tick)


def test_a_command_may_be_recorded_in_another_unit(tmp_path: Path) -> None:
    rig = carriage()
    rig["axes"]["Hip"]["command"] = {"channel": "FL_hip_joint", "unit": "deg", "zero": 10}
    rig["axes"]["Rail"]["command"] = {"channel": "Rail_X", "unit": "mm"}
    loaded = load_rig(written(tmp_path, rig))
    assert loaded.command_channels == ("Rail_X", "FL_hip_joint")
    assert loaded.axis("Hip").recorded.to_si([100.0, 10.0]) == pytest.approx([math.pi / 2, 0.0])
    assert loaded.axis("Rail").recorded.to_si(50.0) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("axis", "quantity", "entry", "complaint"),
    [
        ("Hip", "position", {"unit": "m"}, "s.unit: Unknown position unit 'm'.*deg, rad, ticks"),
        ("Rail", "position", {"unit": "rad"}, "Unknown position unit 'rad'.*m, mm, ticks"),
        ("Hip", "position", {"unit": "ticks"}, "the unit ticks needs 'ticks_per_turn'"),
        ("Rail", "position", {"unit": "ticks"}, "the unit ticks needs 'ticks_per_m'"),
        ("Hip", "position", {"unit": "ticks", "ticks_per_turn": 0}, "ticks_per_turn: must not be 0"),
        ("Hip", "torque", {"torque_constant": 2.0}, "the unit here is N m; it belongs to the unit A or mA"),
        ("Hip", "torque", {"unit": "raw", "stall_torque": 2.0}, "it belongs to the unit duty"),
        ("Hip", "position", {"unit": "deg", "stall_torque": 2.0}, "no position of this joint has it"),
        ("Hip", "torque", {"unit": "A", "torque_constant": "2"}, "torque_constant: expected a number, got '2'"),
        ("Hip", "speed", {}, "expected 'position', 'velocity' or 'torque', got 'speed'"),
        ("Hip", "position", {"resolution": -1.0}, "resolution: must be greater than or equal to 0, got -1"),
        ("Hip", "position", {"colour": 1}, "Unknown entry 'colour'"),
    ],
)
def test_a_wrong_unit_is_refused(
    tmp_path: Path, axis: str, quantity: str, entry: dict[str, object], complaint: str
) -> None:
    with pytest.raises(InputError, match=complaint):
        with_signal(tmp_path, axis, quantity, **entry)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"mjcf": 7}, "mjcf: Unknown mjcf '7'"),
        ({"mjcf": ["x"]}, "mjcf: expected text"),
        ({"sample_time": True}, "sample_time: expected a number, got True"),
        ({"sample_time": 2}, "sample_time: must be less than or equal to 1 s, got 2"),
        ({"ball": 3}, "ball: expected a mapping, got 3"),
        ({"ball": {"joint": "ball"}}, "ball: 'site' is missing"),
        ({"topics": [1]}, r"topics: expected a mapping, got \[1\]"),
        ({"topics": {"state": "x"}}, "topics: Unknown topic 'state'. Did you mean 'states'"),
        ({"axes": {}}, "axes: .*at least 1"),
        ({"axes": {"a": {"limits": ["a", "b"]}}}, r"axes.a.limits\[0\]: expected a number, got 'a'"),
        ({"axes": {"a": {"limits": [1, 0]}}}, r"axes.a.limits: expected \[low, high\] with low < high"),
        ({"axes": {"a": {"turns": {"motor": 0}}}}, "axes.a.turns.motor: expected how often it turns"),
        ({"axes": {"a": {"joint": {"b": 1}}}}, "axes.a.joint: expected text, got {'b': 1}"),
        ({"axes": {"a": {"turns": 12}}}, "axes.a.turns: expected a mapping, got 12"),
        ({"axes": {"a": 3}}, "axes.a: expected a mapping, got 3"),
        ({"axes": {"a-b": {}}}, "'a-b' must be letters, digits and single underscores"),
        ({"colour": "red"}, "Unknown entry 'colour'"),
    ],
)
def test_a_malformed_rig_is_refused_with_all_complaints(
    tmp_path: Path, change: dict[str, object], complaint: str
) -> None:
    wrong = {**carriage(), "name": ["x"], **change}
    with pytest.raises(InputError, match=complaint) as caught:
        load_rig(written(tmp_path, wrong))
    assert f"{tmp_path / 'rig.yaml'}:1: name: expected text, got ['x']." in caught.value.complaints


def test_axes_are_checked_one_by_one(tmp_path: Path) -> None:
    rig = carriage()
    del rig["axes"]["Rail"]["limits"]
    rig["axes"]["Hip"] |= {"belt": "b", "command": [1]}
    rig["axes"]["Hip"]["measured"]["hip__angle"] = rig["axes"]["Hip"]["measured"]["FL_hip_joint"]
    rig["axes"]["Rail"]["measured"]["FL_hip_joint"] = rig["axes"]["Hip"]["measured"]["FL_hip_joint"]
    with pytest.raises(InputError) as caught:
        load_rig(written(tmp_path, rig))
    text = str(caught.value)
    for part in ("a slide joint needs 'limits", "axes.Hip.command", "'hip__angle' must be a legal ROS topic word"):
        assert part in text, part


def test_what_turns_with_an_axis_is_stated_by_its_turns(tmp_path: Path) -> None:
    rig = carriage()
    rig["axes"]["Hip"]["turns"] = {"motor": 12, "belt wheel": -2.5}
    assert load_rig(written(tmp_path, rig)).axis("Hip").turns == {"motor": 12.0, "belt wheel": -2.5}
    assert load_rig(written(tmp_path, rig)).axis("Rail").turns == {}


def test_a_signal_belongs_to_one_axis(tmp_path: Path) -> None:
    rig = carriage()
    rig["axes"]["Rail"]["measured"]["FL_hip_joint"] = rig["axes"]["Hip"]["measured"]["FL_hip_joint"]
    with pytest.raises(InputError, match="the signal 'FL_hip_joint' occurs in two axes"):
        load_rig(written(tmp_path, rig))


def test_a_free_joint_is_no_axis(tmp_path: Path) -> None:
    written(tmp_path, carriage())
    free = CARRIAGE.replace('<joint name="Rail_X" class="rail"/>', '<freejoint name="Rail_X"/>')
    (tmp_path / "carriage.xml").write_text(free)
    (tmp_path / "model.yaml").write_text(yaml.safe_dump({"name": "m", "rig": "rig.yaml", "drives": {}}))
    with pytest.raises(InputError, match="joint 'Rail_X' must be a hinge or a slide joint"):
        load_model(tmp_path / "model.yaml")
