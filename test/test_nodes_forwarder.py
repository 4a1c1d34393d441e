# SPDX-License-Identifier: Apache-2.0
"""What ros2_control's controllers send and hear, through the forwarder, with the simulation as the side it drives."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from builtin_interfaces.msg import Duration
from nodes_under_test import Workplace, workplace
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytestmark = pytest.mark.realtime


class Controlled(Workplace):
    """A simulation, and the forwarder between it and this process, which stands for the controllers' clients."""

    def begin(self) -> None:
        self.states: list[JointState] = []
        self.node.create_subscription(JointState, "/joint_states", self.states.append, 100)
        self.start("labyrinth_sim", "sim_node", model="labyrinth_manual")
        self.start("labyrinth_hw", "controller_forwarder", side="sim")
        self.until(lambda: self.states)

    def publisher(self, kind: Any, name: str) -> Any:
        publisher = self.node.create_publisher(kind, name, 10)
        self.until(publisher.get_subscription_count)
        return publisher

    def angle(self, joint: str) -> float:
        return float(self.states[-1].position[list(self.states[-1].name).index(joint)])

    def near(self, x: float, y: float) -> Callable[[], bool]:
        return lambda: abs(self.angle("motor_x") - x) < 2e-3 and abs(self.angle("motor_y") - y) < 2e-3


@pytest.fixture(scope="module")
def controlled(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Controlled]:
    with workplace(tmp_path_factory.mktemp("controlled"), module_domain) as place:
        place.__class__ = Controlled
        place.begin()
        yield place


def test_angles_of_forward_command_controller_are_reached(controlled: Controlled) -> None:
    commands = controlled.publisher(Float64MultiArray, "/forward_command_controller/commands")
    commands.publish(Float64MultiArray(data=[0.03, -0.02]))
    controlled.until(controlled.near(0.03, -0.02))
    commands.publish(Float64MultiArray(data=[0.01]))  # one too few: refused, and the angles stay
    seen = len(controlled.states)
    controlled.until(lambda: len(controlled.states) > seen + 50)
    assert controlled.near(0.03, -0.02)()


def test_a_trajectory_is_followed_to_its_end_whatever_the_order_of_its_joints(controlled: Controlled) -> None:
    trajectory = controlled.publisher(JointTrajectory, "/joint_trajectory_controller/joint_trajectory")
    points = [
        JointTrajectoryPoint(positions=[0.04, -0.04], time_from_start=Duration(nanosec=400_000_000)),
        JointTrajectoryPoint(positions=[0.02, -0.01], time_from_start=Duration(nanosec=800_000_000)),
    ]
    begun = len(controlled.states)
    trajectory.publish(JointTrajectory(joint_names=["motor_y", "motor_x"], points=points))
    controlled.until(controlled.near(-0.01, 0.02))
    index = list(controlled.states[-1].name).index("motor_y")
    assert max(state.position[index] for state in controlled.states[begun:]) > 0.03, "by the first point"


def test_what_mock_hardware_mirrors_is_sent_on(controlled: Controlled) -> None:
    mirrored = controlled.publisher(JointState, "/mock_hardware/joint_states")
    message = JointState(name=["motor_y", "other", "motor_x"], position=[0.015, 9.0, -0.025])
    there = controlled.near(-0.025, 0.015)

    def arrived() -> bool:
        # A stream, as from the hardware: it is heard with best effort, so a single message may be lost.
        mirrored.publish(message)
        return there()

    controlled.until(arrived)
