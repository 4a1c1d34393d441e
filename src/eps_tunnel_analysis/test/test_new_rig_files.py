# SPDX-License-Identifier: Apache-2.0
"""Models and tables as other people write them, through new-rig."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from eps_tunnel_analysis.new_rig.joints import read_robot
from eps_tunnel_analysis.new_rig.tables import csv_bags
from eps_tunnel_analysis.new_rig.write import NewRig, new_rig
from eps_tunnel_analysis.recording import read_all
from labyrinth_sim.model import load_model
from labyrinth_sim.simulate import simulate

STEP = 0.01
TIME = np.arange(300) * STEP
TARGET = 0.5 * np.sin(2.0 * TIME) + 0.2 * np.sin(6.0 * TIME)
ANGLE = np.concatenate([np.zeros(5), TARGET[:-5]])
DISC = """<mujoco model="disc"><compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <inertial pos="0 0 0" mass="0.4" diaginertia="0.002 0.002 0.002"/>
  <joint name="disc" axis="0 0 1" armature="0.01" range="-1.6 1.6"/></body></worldbody>
  <actuator>{actuators}</actuator></mujoco>"""


def table(file: Path, header: str, *columns: np.ndarray) -> Path:
    """A CSV of time and columns."""
    np.savetxt(file, np.column_stack([TIME, *columns]), fmt="%.9g", delimiter=",", header=header, comments="")
    return file


def made(folder: Path, mjcf: str, csv: Path, **units: str) -> NewRig:
    """A rig of a disc and a table."""
    (folder / "disc.xml").write_text(mjcf)
    robot = read_robot(folder / "disc.xml")
    bags, notes = csv_bags([csv], robot.joints, folder / "bags")
    found = new_rig(robot, read_all(bags), folder, **units)
    return NewRig(found.model, (*notes, *found.notes), found.known)


def alone(folder: Path) -> np.ndarray:
    """What the model does under the target, (T,) rad."""
    model = load_model(folder / "model.yaml")
    return np.asarray(simulate(model, TIME, TARGET[:, None]).select(["disc"]).values[0, :, 0])


@pytest.mark.parametrize(
    ("actuators", "told", "kept"),
    [
        ('<position joint="disc" kp="100"/>', "has no name in disc.xml; in robot.xml it is called disc", ["disc"]),
        (
            '<position joint="disc" kp="100"/><velocity name="brake" joint="disc" kv="5"/>',
            "acts by brake; disc would act beside it and is switched off",
            ["disc", "brake"],
        ),
        (
            '<motor name="m" joint="disc"/><position name="hold" joint="disc" kp="100"/>',
            "acts by m; hold would act beside it",
            ["m", "hold"],
        ),
    ],
)
def test_an_actuator_without_a_name_or_beside_another_does_not_act_beside_the_drive(
    tmp_path: Path, actuators: str, told: str, kept: list[str]
) -> None:
    expected = tmp_path / "expected"
    expected.mkdir()
    csv = table(tmp_path / "run.csv", "t,target,angle", TARGET, ANGLE)
    assert "switched off" not in " ".join(made(expected, DISC.format(actuators=""), csv).notes)
    found = made(tmp_path, DISC.format(actuators=actuators), csv)
    assert told in " ".join(found.notes)
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert [mj.actuator(i).name for i in range(mj.nu)] == kept
    assert alone(tmp_path) == pytest.approx(alone(expected), abs=1e-9)
