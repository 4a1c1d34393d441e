# SPDX-License-Identifier: Apache-2.0
"""Lets clients of ros2_control's controllers drive a side (rig or simulation) and receive its joint states.

It takes the messages of forward_command_controller, of joint_trajectory_controller's topic, and the joint states that
ros2_control's mock hardware mirrors, and sends each as a stream of commands. The newest of them counts.
"""

import signal
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from labyrinth_hw.errors import InputError
from labyrinth_hw.nodes.start import start_ros
from labyrinth_hw.trajectory import Array, Path, path_through

BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class ControllerForwarder(Node):
    """Sends SIDE/joint_commands at an even rate from what came last, and republishes SIDE/joint_states."""

    def __init__(self) -> None:
        super().__init__("controller_forwarder")
        side = str(self._declare("side", "real", "side to drive: prefix of the topics [-]")).strip("/")
        joints = self._declare("joints", ["motor_x", "motor_y"], "command channels, in the controllers' order [-]")
        self._joints = [str(joint) for joint in joints]
        rate = float(self._declare("rate", 100.0, "commands per second [Hz]", 1.0, 500.0))
        self._hold = float(
            self._declare("hold", 10.0, "how long the last angle is repeated; 0: forever [s]", 0.0, 86400.0)
        )
        unknown = [n for n in self._parameter_overrides if not self.has_parameter(n) and not n.startswith(BUILT_IN)]
        if unknown:
            valid = ", ".join(sorted(n for n in self._parameters if not n.startswith(BUILT_IN)))
            raise InputError(f"Unknown parameter {', '.join(map(repr, unknown))}. Available: {valid}.")
        if not self._joints or len(set(self._joints)) != len(self._joints):
            raise InputError(f"Parameter 'joints': expected different names, got {self._joints}.")
        self._measured: dict[str, float] = {}
        self._path: Path | None = None
        self._began = 0.0  # s of the node's clock
        self._commands = self.create_publisher(JointState, f"{side}/joint_commands", 10)
        self._states = self.create_publisher(JointState, "joint_states", 10)
        sensor = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(JointState, f"{side}/joint_states", self._hear, sensor)
        self.create_subscription(Float64MultiArray, "forward_command_controller/commands", self._forward, 10)
        self.create_subscription(JointTrajectory, "joint_trajectory_controller/joint_trajectory", self._follow, 10)
        self.create_subscription(JointState, "mock_hardware/joint_states", self._mirror, sensor)
        # By the machine's clock, so that a signal is answered while /clock stands.
        self.create_timer(1.0 / rate, self._send, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _declare(self, name: str, default: Any, text: str, low: float | None = None, high: float | None = None) -> Any:
        about = ParameterDescriptor(description=text, read_only=True)
        if low is not None and high is not None:
            about.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        return self.declare_parameter(name, default, about).value

    @property
    def _now(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _hear(self, message: JointState) -> None:
        self._measured.update(zip(message.name, message.position, strict=False))
        self._states.publish(message)

    def _forward(self, message: Float64MultiArray) -> None:
        self._take(lambda: self._jump(self._joints, list(message.data)))

    def _mirror(self, message: JointState) -> None:
        driven = {n: p for n, p in zip(message.name, message.position, strict=False) if n in self._joints}
        self._take(lambda: self._jump(list(driven), list(driven.values())))

    def _follow(self, message: JointTrajectory) -> None:
        begin = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self._take(lambda: self._trajectory(message), begin)

    def _take(self, make: Any, begin: float = 0.0) -> None:
        """A new path, from now on or from a moment of the node's clock, s."""
        try:
            path = make()
        except InputError as error:
            self.get_logger().warning(f"Refused: {error}", throttle_duration_sec=1.0)
            return
        self._path, self._began = path, begin or self._now

    def _jump(self, names: list[str], angles: list[float]) -> Path:
        if sorted(names) != sorted(self._joints) or len(angles) != len(self._joints) or not np.isfinite(angles).all():
            raise InputError(
                f"{len(angles)} angles for {names}; expected a finite one, rad, for each of {self._joints}."
            )
        ordered = dict(zip(names, angles, strict=True))
        return Path(np.zeros(1), np.array([[ordered[joint] for joint in self._joints]]))

    def _trajectory(self, message: JointTrajectory) -> Path:
        names, start = list(message.joint_names), self._pose()
        if sorted(names) != sorted(self._joints):
            raise InputError(f"A trajectory of {names}; expected one of {self._joints}.")
        if not message.points:  # how a controller's client stops it
            return Path(np.zeros(1), start[None])
        order = [names.index(joint) for joint in self._joints]

        def ordered(row: Sequence[float]) -> list[float]:
            return [row[i] for i in order] if len(row) == len(order) else list(row)

        return path_through(
            start,
            [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in message.points],
            [ordered(point.positions) for point in message.points],
            [ordered(point.velocities) for point in message.points],
        )

    def _pose(self) -> Array:
        """Where the joints were commanded to be, or else where they were measured."""
        if self._path is not None:
            return self._path.at(self._now - self._began)
        if absent := [joint for joint in self._joints if joint not in self._measured]:
            raise InputError(f"Nothing was measured of {', '.join(absent)} yet. Is the side's node running?")
        return np.array([self._measured[joint] for joint in self._joints])

    def _send(self) -> None:
        if self._path is None:
            return
        passed = self._now - self._began
        if self._hold and passed > self._path.duration + self._hold:
            self._path = None
            self.get_logger().info(f"Nothing new for {self._hold:g} s; commands end here.")
            return
        message = JointState(name=self._joints, position=self._path.at(passed).tolist())
        message.header.stamp = self.get_clock().now().to_msg()
        self._commands.publish(message)


def main(args: Sequence[str] | None = None) -> int:
    """Runs the node until it is interrupted; exit code 2 for bad parameters."""
    about = "Forwards the commands of ros2_control's controllers to a side, and its joint states back."
    start_ros("controller_forwarder", about, sys.argv[1:] if args is None else args)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        rclpy.spin(ControllerForwarder())
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except Exception as error:  # parameters that ROS or we refuse
        print(f"controller_forwarder: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
