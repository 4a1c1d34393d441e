# SPDX-License-Identifier: Apache-2.0
"""One side of the comparison, /real or /sim, as the player sees it."""

import math
import time

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.motion import Array, RestWatch
from eps_tunnel_analysis.sequence import Command
from labyrinth_msgs.msg import Trial

RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class RigSide:
    """Commands and trial marks to one side, and its joint states back.

    Attributes:
        name: `real` or `sim`.
        positions: last measured position of each joint in rad.
        target: last commanded position (u,) in rad; None before the first command.
    """

    def __init__(self, node: Node, name: str, rest: RestWatch) -> None:
        overridable = QoSOverridingOptions.with_default_policies()
        self.name, self.rest = name, rest
        self.positions: dict[str, float] = {}
        self.target: Array | None = None
        self._heard = -math.inf
        self._commands = node.create_publisher(
            JointState, f"/{name}/joint_commands", RELIABLE, qos_overriding_options=overridable
        )
        self._marks = node.create_publisher(Trial, f"/{name}/trial", RELIABLE, qos_overriding_options=overridable)
        self._states = node.create_subscription(
            JointState, f"/{name}/joint_states", self._measured, RELIABLE, qos_overriding_options=overridable
        )

    @property
    def topics(self) -> tuple[str, str]:
        """The names of the topics of commands and states after remapping."""
        return self._commands.topic_name, self._states.topic_name

    @property
    def listeners(self) -> int:
        """How many subscribers the commands reach."""
        return int(self._commands.get_subscription_count())

    @property
    def silence(self) -> float:
        """s since the last joint states."""
        return time.monotonic() - self._heard

    def excuse(self, now: float) -> None:
        """Starts the silence anew at `now`, monotonic s: until then this process could not listen."""
        if math.isfinite(self._heard):
            self._heard = max(self._heard, now)

    def send(self, stamp: Time, command: Command, targets: Array) -> None:
        """Publishes targets (u,) in rad of the command's channels."""
        message = JointState(name=list(command.channels), position=targets.tolist())
        message.header.stamp = stamp
        self._commands.publish(message)
        self.target = targets

    def mark(self, stamp: Time, phase: int, command: Command, trial: int) -> None:
        """Publishes a mark of a trial: Trial.START, END or ABORTED."""
        message = Trial(
            phase=phase, sequence=command.name, sequence_hash=command.hash, trial=trial, duration=command.duration
        )
        message.header.stamp = stamp
        self._marks.publish(message)

    def pose(self, command: Command) -> Array:
        """Where the command's channels are (u,) in rad: the last target, or measured before the first."""
        if self.target is not None and len(self.target) == len(command.channels):
            return self.target
        return np.array([self.positions[channel] for channel in command.channels])

    def restless(self) -> str:
        """The joint that moves most and its speed, in words."""
        if not len(self.rest.speeds) or np.isnan(self.rest.speeds).all():
            return f"{self.name}: too few joint states to judge"
        fastest = int(np.nanargmax(self.rest.speeds))
        return (
            f"{self.name}: {sorted(self.positions)[fastest]} moves {math.degrees(self.rest.speeds[fastest]):.2g} deg/s"
        )

    def _measured(self, message: JointState) -> None:
        if len(message.position) != len(message.name):
            return
        self._heard = time.monotonic()
        self.positions = dict(zip(message.name, message.position, strict=True))
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        self.rest.add(stamp, np.array([self.positions[name] for name in sorted(self.positions)]))
