# SPDX-License-Identifier: Apache-2.0
"""A parameter is declared once, for a toy servo; its unit and bounds follow the axis."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from labyrinth_sim.effect import GROWS, Parameter, Size, drives, effects
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model

HINGE = Size()
EMPS = Size.of_axis(slides=True, limits=(0.0, 0.25), full=351.5)  # a carriage of 95 kg on a ball screw
PARAMETERS = {(kind.name, p.name): p for kind in (*effects().values(), *drives().values()) for p in kind.parameters}


def test_a_toy_servo_has_what_is_declared() -> None:
    toy = Size.of_axis(slides=False, limits=(-3.2, 3.2), full=2.8)
    assert toy == HINGE
    assert all(p.sized(toy) == p for p in PARAMETERS.values())


@pytest.mark.parametrize(
    ("owner", "name", "value", "unit"),
    [
        ("viscous_friction", "damping", 203.5, "N s/m"),
        ("direction_viscous_friction", "damping", -73.7, "N s/m"),
        ("coulomb_friction", "torque", 20.39, "N"),
        ("constant_torque", "torque", -3.16, "N"),
        ("lugre_friction", "bend", 1e-4, "m"),
        ("torque_pd", "damping", 8557.3, "N s/m"),
        ("torque_pd", "torque", 351.5, "N"),
        ("rate_limit", "rate", 0.3, "m/s"),
        ("dc_motor_servo", "torque_constant", 0.5, "N m/A"),
        ("dc_motor_servo", "gear", 6283.0, "1"),
    ],
)
def test_a_linear_axis_of_95_kg_lies_within_its_bounds(owner: str, name: str, value: float, unit: str) -> None:
    here = PARAMETERS[owner, name].sized(EMPS)
    assert here.unit == unit
    assert here.low <= value <= here.high


def test_no_unit_of_a_turn_is_left_on_a_slide() -> None:
    for p in PARAMETERS.values():
        if p.fixed != "unit":
            assert "rad" not in p.sized(EMPS).unit, p
            assert "N m" not in p.sized(EMPS).unit, p
    assert not {p.unit for p in PARAMETERS.values() if "rad" in p.unit or "N m" in p.unit} - set(GROWS)


def test_off_stays_off_and_typical_within_the_bounds() -> None:
    for p in PARAMETERS.values():
        here = p.sized(EMPS)
        assert here.low <= here.typical <= here.high
        if p.off in (0.0, p.low, p.high):
            assert here.off in (0.0, here.low, here.high)


def test_a_limit_that_vanishes_at_its_largest_value_has_that_value_on_any_axis() -> None:
    """Its hook compares with that number."""
    for effect in effects().values():
        for p in effect.parameters:
            if p.off == p.high and p.unit in GROWS:
                assert p.sized(EMPS).off == p.off, (effect.name, p.name)


def test_what_is_stated_widens_the_search_and_only_sign_and_order_are_checked() -> None:
    stiffness = PARAMETERS["torque_pd", "stiffness"]
    assert stiffness.sized(EMPS).high < 1.37e6
    assert stiffness.complaint(EMPS, 1.37e6) == ""
    assert stiffness.sized(EMPS, 1.37e6).high == pytest.approx(3 * 1.37e6)
    for wrong in (-1.0, 0.0, 1e12, math.nan, math.inf):
        assert "must lie within" in stiffness.complaint(EMPS, wrong)


def test_times_and_shares_and_angles_of_a_hinge_keep_their_bounds() -> None:
    for owner, name in (("command_delay", "delay"), ("torque_saturation", "share"), ("backlash", "width")):
        p = PARAMETERS[owner, name]
        strong = Size.of_axis(slides=False, limits=(-3.2, 3.2), full=200.0)
        assert p.sized(strong) == p
        assert p.complaint(strong, 2.0 * p.high)


def test_bounds_of_either_sign_widen_to_their_side() -> None:
    p = Parameter("torque", "N m", -1.0, 1.0, 0.0, 0.2, "either sign")
    assert (p.sized(HINGE, -30.0).low, p.sized(HINGE, -30.0).high) == (-90.0, 1.0)


def test_a_value_stated_near_its_bound_has_room_beyond_it() -> None:
    damping = PARAMETERS["torque_pd", "damping"]
    assert damping.sized(HINGE, 19.0).high == pytest.approx(57.0)
    assert damping.sized(HINGE, 0.2) == damping


def test_a_value_with_choices_is_settled_and_typically_one_of_them() -> None:
    kind = Parameter("kind", "1", 0.0, 2.0, None, 0.0, "one or the other", settled=True, choices=(0.0, 2.0))
    assert kind.sized(HINGE).choices == (0.0, 2.0)
    for wrong in ({"settled": False}, {"typical": 1.0}, {"choices": (0.0, 3.0)}):
        with pytest.raises(InputError, match=r"Parameter kind: .*choices"):
            replace(kind, **wrong)


MJCF = """<mujoco><worldbody><body><inertial pos="0 0 0" mass="0.01" diaginertia="1 1 1"/>
<joint name="carriage" type="slide" axis="1 0 0"/></body></worldbody>
<actuator><motor name="carriage" joint="carriage"/></actuator></mujoco>"""


def test_a_model_of_a_linear_axis_takes_its_values_and_is_searched_about_them(tmp_path: Path) -> None:
    axis = {"command": "carriage", "actuator": "carriage", "joint": "carriage", "limits": [0.0, 0.25]}
    axis |= {"measured": {"carriage": {"joint": "carriage", "quantity": "position"}}}
    drive = {"stiffness": (1.37e6, "N/m"), "damping": (8557.0, "N s/m"), "torque": (351.5, "N"), "delay": (0.0, "s")}
    plain = {"armature": (95.1, "kg"), "damping": (203.5, "N s/m")}

    def stated(values: dict[str, tuple[float, str]], prefix: str = "") -> dict[str, dict[str, object]]:
        return {prefix + n: {"value": v, "unit": unit, "from": "paper"} for n, (v, unit) in values.items()}

    content = {
        "name": "axis",
        "rig": "rig.yaml",
        "drives": {"x": {"kind": "torque_pd", "values": stated(drive)}},
        "effects": [{"name": "coulomb_friction", "place": "x", "values": stated({"torque": (20.39, "N")})}],
        "quantities": stated(plain, "joint.carriage."),
    }
    (tmp_path / "axis.xml").write_text(MJCF)
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"name": "axis", "mjcf": "axis.xml", "axes": {"x": axis}}))
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    model = load_model(tmp_path / "model.yaml")
    known = model.parameters()
    assert known["drive.x.stiffness"].high == pytest.approx(3 * 1.37e6)
    for name, info in known.items():
        assert info.low <= info.value <= info.high, name
    assert known["coulomb_friction.x.torque"].high == pytest.approx(0.3 * 351.5), "of what the drive gives"
    dry = model.with_values({"coulomb_friction.x.torque": 60.0}, "paper").parameters()["coulomb_friction.x.torque"]
    assert dry.high == pytest.approx(3 * 60.0), "of what is stated, where that is more"
    richer = model.with_effect("direction_viscous_friction", "x").with_effect("constant_torque", "x", {"torque": -3.16})
    assert richer.parameters()["direction_viscous_friction.x.damping"].unit == "N s/m"
    assert abs(richer.values()["direction_viscous_friction.x.damping"]) > 100.0
    assert model.places("gravity_load") == ()
    with pytest.raises(InputError, match=r"carriage.armature must lie within .* kg"):
        model.with_values({"joint.carriage.armature": -1.0})
