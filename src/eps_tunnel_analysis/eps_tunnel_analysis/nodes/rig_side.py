# SPDX-License-Identifier: Apache-2.0
"""One side of the comparison, real or sim, as the player sees it."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.motion import Array, RestWatch
from eps_tunnel_analysis.nodes.messages import measured, reliable
from eps_tunnel_analysis.nodes.pace import Pace
from eps_tunnel_analysis.outputs import shown_number
from eps_tunnel_analysis.sequence import Command
from labyrinth_msgs.msg import Trial
from labyrinth_msgs.srv import Record
from labyrinth_sim.errors import InputError

SIDE_DEPTH = 10
RECORDERS_PERIOD = 0.02  # s between two looks for who records


class RecordClient:
    """Calls the service record from a thread that may wait, while the node is spun by others."""

    def __init__(self, node: Node, sides: Sequence[str]) -> None:
        self._sides = list(sides)
        self._client = node.create_client(Record, "record")

    def start(
        self, folder: Path, command: Command, appears: float, timeout: float, check: Callable[[], None]
    ) -> tuple[str, ...]:
        """Paths of the bags that are now recorded, one per side.

                Args:
                    appears, timeout: longest wait for the recorder, and for its answer, s.
                    check: called repeatedly while waiting for the recorder; raises to give up.

                Raises:
        InputError: no recorder is running.
        """
        label = command.name.replace("/", "_")
        return self._call(
            Record.Request(
                start=True,
                folder=str(folder.resolve()),
                label=label,
                sequence=command.name,
                sequence_hash=command.hash,
                sides=self._sides,
            ),
            appears,
            timeout,
            check,
        )

    def stop(self, appears: float, timeout: float) -> tuple[str, ...]:
        """Paths of the bags, now closed; times as for `start`. Raises InputError when it failed."""
        return self._call(Record.Request(start=False), appears, timeout)

    def _call(
        self, request: Record.Request, appears: float, timeout: float, check: Callable[[], None] = lambda: None
    ) -> tuple[str, ...]:
        deadline = time.monotonic() + appears
        while not self._client.service_is_ready():
            if time.monotonic() > deadline:
                raise InputError(
                    f"No recorder is running: the service {self._client.service_name} did not appear within "
                    f"{appears:g} s. Start `ros2 run eps_tunnel_analysis analysis_node`, or play without recording."
                )
            check()
            time.sleep(RECORDERS_PERIOD)
        answered = threading.Event()
        future: Any = self._client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(timeout):
            raise InputError(f"The analysis node did not answer {self._client.service_name} within {timeout:g} s.")
        response: Record.Response = future.result()
        if not response.success:
            raise InputError(f"Recording failed: {response.message}")
        return tuple(response.bags)


class RigSide:
    """Commands and trial marks to one side, and its joint states back.

    Measurements are received as best effort, which any publisher offers; commands and marks are sent reliably.

    Attributes:
        name: `real` or `sim`.
        positions: last measured position of each joint in rad.
        target: last commanded position (u,) in rad; None before the first command.
        stamp: of the last joint states, s of the clock that stamped them; 0 where there is none.
    """

    def __init__(self, node: Node, name: str, rest: RestWatch, pace: Pace) -> None:
        overridable = QoSOverridingOptions.with_default_policies()
        self.name, self.rest = name, rest
        self.positions: dict[str, float] = {}
        self.target: Array | None = None
        self.stamp = 0.0
        self._node = node
        self._pace = pace
        self._heard = -math.inf
        self._commands = node.create_publisher(
            JointState, f"{name}/joint_commands", reliable(SIDE_DEPTH), qos_overriding_options=overridable
        )
        self._marks = node.create_publisher(
            Trial, f"{name}/trial", reliable(SIDE_DEPTH), qos_overriding_options=overridable
        )
        self._states = node.create_subscription(
            JointState, f"{name}/joint_states", self._measured, measured(SIDE_DEPTH), qos_overriding_options=overridable
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
        """s of the run's clock since the last joint states."""
        return self._pace.now() - self._heard

    @property
    def measured(self) -> bool:
        """Whether joint states have a publisher."""
        return self._node.count_publishers(self._states.topic_name) > 0

    def excuse(self, now: float) -> None:
        """Restarts the silence at `now`, s of the run's clock: until then this process could not listen."""
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
        speed = shown_number(math.degrees(self.rest.speeds[fastest]), 2)
        return f"{self.name}: {sorted(self.positions)[fastest]} moves {speed} deg/s"

    def _measured(self, message: JointState) -> None:
        if len(message.position) != len(message.name):
            return
        self._heard = self._pace.now()
        self.positions = dict(zip(message.name, message.position, strict=True))
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        self.stamp = stamp
        self.rest.add(stamp, np.array([self.positions[name] for name in sorted(self.positions)]))
