# SPDX-License-Identifier: Apache-2.0
"""A testbed and a hardware node as real processes, and somebody who listens and commands."""

import importlib.util
import os
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import IO, Any

import pytest

PATIENCE = 60.0  # s; only what hangs takes so long
SOON = 2.0  # s from a signal to the end of a node
ROS = importlib.util.find_spec("rclpy") is not None and importlib.util.find_spec("labyrinth_msgs") is not None
ROS_IN_REAL_TIME = [
    pytest.mark.skipif(not ROS, reason="rclpy or labyrinth_msgs not importable: source env.bash first"),
    pytest.mark.realtime,
]
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
_numbers = count()
COMMANDER = """
import sys, time, rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("commander")
publisher = node.create_publisher(JointState, "/real/joint_commands", 10)
while True:
    message = JointState(name=["motor_x", "motor_y"], position=[float(word) for word in sys.argv[1:]])
    message.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(message)
    time.sleep(0.01)
"""


class Bench:
    """A testbed, a hardware node, and somebody who listens and commands."""

    def __init__(self, folder: Path, domain: int) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState
        from std_srvs.srv import SetBool, Trigger

        from labyrinth_msgs.msg import BallEvent, BallState

        self.folder = folder
        self.environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "LABYRINTH_TESTBED_DIR": str(folder / "links")}
        self.testbed: subprocess.Popen[str] | None = None
        self.node: subprocess.Popen[str] | None = None
        self.commander: subprocess.Popen[str] | None = None
        self.states: list = []
        self.diagnostics: list = []
        self.balls: list = []
        self.events: list = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._peer = rclpy.create_node("peer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._peer)
        self._peer.create_subscription(JointState, "/real/joint_states", self.states.append, 1000)
        self._peer.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 100)
        self._peer.create_subscription(BallState, "/real/ball", self.balls.append, 1000)
        self._peer.create_subscription(BallEvent, "/real/ball_event", self.events.append, 100)
        self._commands: Any = None
        self._reset = self._peer.create_client(Trigger, "/real/reset")
        self._arm = self._peer.create_client(SetBool, "/real/arm")
        self.supply = self._peer.create_client(Trigger, "/real/supply_ball")
        self._goal: tuple[float, float] | None = None
        self._ahead = 0.0
        self._peer.create_timer(0.02, self._send)

    def start_testbed(self, *options: str) -> None:
        command = [
            sys.executable,
            "-m",
            "labyrinth_hw.testbed.command_line",
            "--config",
            "healthy",
            "--seed",
            "1",
            *options,
        ]
        self.testbed = self._start(command, subprocess.PIPE)
        assert self.testbed.stdout is not None
        while "Ctrl-C ends it" not in (line := self.testbed.stdout.readline()):
            assert line, "the testbed did not start"

    def start_node(self, **parameters: object) -> None:
        """The hardware node, armed unless told otherwise."""
        parameters = {"arm": "true", **parameters}
        options = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        command = [sys.executable, "-m", "labyrinth_hw.nodes.hw_node", "--ros-args", "-p", "config:=healthy", *options]
        # A file, for nobody empties a pipe while the node runs.
        self._told = self.folder / f"hw_node_{next(_numbers)}.log"
        with self._told.open("w") as file:
            self.node = self._start(command, subprocess.DEVNULL, file)

    def _start(self, command: list[str], out: int, errors: IO[str] | None = None) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            command, env=self.environment, stdin=subprocess.PIPE, stdout=out, stderr=errors, text=True
        )

    def ended(self, within: float = PATIENCE) -> tuple[int, str]:
        """Waits, s, for the end of the node started last; its exit code, and what it told on stderr."""
        assert self.node is not None
        return self.node.wait(within), self.said()

    def said(self) -> str:
        """What the node started last wrote to stderr so far."""
        return self._told.read_text()

    def tell(self, fault: str) -> None:
        """Give the testbed an order and wait until it obeyed."""
        assert self.testbed is not None and self.testbed.stdin is not None and self.testbed.stdout is not None
        self.testbed.stdin.write(fault + "\n")
        self.testbed.stdin.flush()
        assert self.testbed.stdout.readline() == f"done: {fault}\n"

    def command(self, goal: tuple[float, float] | None, ahead: float = 0.0) -> None:
        """Keep sending this goal, rad, with stamps `ahead` s of the clock; None stops sending."""
        if self._commands is None:
            self._commands = self.publisher()
        self._goal, self._ahead = goal, ahead

    def publisher(self) -> Any:
        """Another publisher of commands."""
        from sensor_msgs.msg import JointState

        return self._peer.create_publisher(JointState, "/real/joint_commands", 10)

    def send_once(self, publisher: Any, ahead: float = 0.0, **goals: float) -> None:
        """One message, stamped `ahead` s of the clock."""
        from rclpy.duration import Duration
        from sensor_msgs.msg import JointState

        message = JointState(name=list(goals), position=list(goals.values()))
        message.header.stamp = (self._peer.get_clock().now() + Duration(seconds=ahead)).to_msg()
        publisher.publish(message)

    def start_commander(self, goal: tuple[float, float]) -> "subprocess.Popen[str]":
        """A process of its own that keeps sending this goal, rad."""
        self.commander = self._start([sys.executable, "-c", COMMANDER, *map(str, goal)], subprocess.DEVNULL)
        return self.commander

    def _send(self) -> None:
        if self._goal is not None:
            self.send_once(self._commands, self._ahead, motor_x=self._goal[0], motor_y=self._goal[1])

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Listen until a condition holds."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            self._executor.spin_once(0.05)
            assert time.monotonic() < deadline, f"waited {PATIENCE:g} s for: {what}; newest: {self.status()}"

    def more_states(self, count: int = 20) -> None:
        goal = len(self.states) + count
        self.until(lambda: len(self.states) >= goal, f"{count} more joint states")

    def motor(self) -> tuple[float, float]:
        return tuple(self.states[-1].position[:2]) if self.states else (9.0, 9.0)

    def reaches(self, goal: tuple[float, float]) -> bool:
        return max(abs(a - b) for a, b in zip(self.motor(), goal, strict=True)) < 0.004

    def status(self) -> dict[str, str]:
        for array in reversed(self.diagnostics):
            for status in array.status:
                if status.name == "hw_node: servos":
                    return {"message": status.message, **{v.key: v.value for v in status.values}}
        return {}

    def reset(self) -> None:
        from std_srvs.srv import Trigger

        future = self._reset.call_async(Trigger.Request())
        self.until(future.done, "the reset service")

    def arm(self, on: bool = True) -> Any:
        """Asks for it; the answer."""
        from std_srvs.srv import SetBool

        return self.call(self._arm, SetBool.Request(data=on))

    def call(self, client: Any, request: Any) -> Any:
        """A service's answer."""
        self.until(client.service_is_ready, f"the service {client.srv_name}")
        future = client.call_async(request)
        self.until(future.done, f"an answer of {client.srv_name}")
        return future.result()

    def has_node(self, name: str) -> bool:
        return name in self._peer.get_node_names()

    @property
    def publisher_in_use(self) -> Any:
        """What `command` sends by."""
        return self._commands

    def client(self, kind: Any, name: str) -> Any:
        return self._peer.create_client(kind, name)

    def close(self) -> None:
        for process in (self.commander, self.node, self.testbed):
            if process is not None and process.poll() is None:
                process.terminate()
                try:
                    process.wait(PATIENCE)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
        self._executor.remove_node(self._peer)
        self._peer.destroy_node()
        self._context.try_shutdown()
