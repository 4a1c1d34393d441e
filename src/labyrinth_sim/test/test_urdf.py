# SPDX-License-Identifier: Apache-2.0
"""The URDF written from an MJCF moves as the MJCF does: MuJoCo, which reads URDF too, is asked where everything is."""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest

from labyrinth_sim.asset import compile_spec, read_spec
from labyrinth_sim.model import load_model
from labyrinth_sim.urdf import urdf, urdf_of

TURNED = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="base" pos="0.1 0.2 0.3" euler="0.3 -0.4 0.5">
      <inertial pos="0 0 0.01" mass="1" diaginertia="0.01 0.01 0.01"/>
      <joint name="turn" axis="0 0 1" pos="0.02 0.03 0" range="-1 1"/>
      <joint name="lift" type="slide" axis="0 1 0" pos="0.01 0 0.04" range="-0.5 0.5"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0" euler="0.1 0.2 0.3"/>
      <body name="still" pos="0 0.1 0" euler="0 1.5707963267948966 0">
        <geom type="sphere" size="0.05"/>
        <body name="tip" pos="0.3 0 0">
          <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
          <joint name="spin" axis="1 0 0" pos="0 0 -0.05"/>
          <geom type="capsule" size="0.01 0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def places(model: mujoco.MjModel, angles: dict[str, float]) -> dict[str, np.ndarray]:
    """Centre of each drawn geom, m, and its axes, by the order of drawing."""
    data = mujoco.MjData(model)
    for name, angle in angles.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return {str(i): np.r_[data.geom_xpos[i], data.geom_xmat[i]] for i in range(model.ngeom)}


def of_urdf(text: str) -> mujoco.MjModel:
    """With what is drawn; links between two joints of a body weigh nothing, which MuJoCo refuses otherwise."""
    options = 'discardvisual="false" fusestatic="false" boundmass="1e-6" boundinertia="1e-6"'
    return mujoco.MjModel.from_xml_string(text.replace("<link", f"<mujoco><compiler {options}/></mujoco><link", 1))


@pytest.mark.parametrize("angles", [{}, {"turn": 0.7, "lift": 0.2, "spin": -1.1}])
def test_every_geom_is_where_the_mjcf_has_it(angles: dict[str, float]) -> None:
    model = mujoco.MjModel.from_xml_string(TURNED)
    written = of_urdf(urdf_of(model, "turned", {}))
    expected, found = places(model, angles), places(written, angles)
    assert len(found) == len(expected) == 3
    for name, place in expected.items():
        assert found[name] == pytest.approx(place, abs=1e-6)


def test_the_labyrinth_s_board_moves_as_in_the_simulation() -> None:
    rig = load_model("labyrinth").rig
    model = compile_spec(read_spec(rig.mjcf), rig.mjcf)
    text = urdf(rig)
    robot = ET.fromstring(text)
    joints = {joint.get("name"): joint.get("type") for joint in robot.iter("joint")}
    assert {name for name, kind in joints.items() if kind != "fixed"} == {"board_x", "board_y", "motor_x", "motor_y"}
    written = of_urdf(text)
    data, other = mujoco.MjData(model), mujoco.MjData(written)
    for one, two in ((model, data), (written, other)):
        for name, angle in (("board_x", 0.1), ("board_y", -0.07)):
            two.qpos[one.joint(name).qposadr[0]] = angle
        mujoco.mj_kinematics(one, two)
    assert other.body("board_origin").xpos == pytest.approx(data.site("board_origin").xpos, abs=1e-9)
    assert sum(1 for _ in robot.iter("visual")) > 50
