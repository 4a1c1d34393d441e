# SPDX-License-Identifier: Apache-2.0
"""The hardware node as a real process, on the emulated testbed as another one."""

import importlib.util
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROS = importlib.util.find_spec("rclpy") is not None and importlib.util.find_spec("labyrinth_msgs") is not None
pytestmark = pytest.mark.skipif(not ROS, reason="rclpy or labyrinth_msgs not importable: source env.bash first")
PATIENCE = 30.0
DOMAIN = str(40 + os.getpid() % 60)


class Bench:
    """A testbed, a hardware node, and somebody who listens and commands."""

    def __init__(self, folder: Path) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState
        from std_srvs.srv import Trigger

        from labyrinth_msgs.msg import BallEvent, BallState

        self.folder = folder
        self.environment = {**os.environ, "ROS_DOMAIN_ID": DOMAIN, "LABYRINTH_TESTBED_DIR": str(folder / "links")}
        self.testbed: subprocess.Popen[str] | None = None
        self.node: subprocess.Popen[str] | None = None
        self.states: list = []
        self.diagnostics: list = []
        self.balls: list = []
        self.events: list = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=int(DOMAIN))
        self._peer = rclpy.create_node("peer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._peer)
        self._peer.create_subscription(JointState, "/real/joint_states", self.states.append, 100)
        self._peer.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)
        self._peer.create_subscription(BallState, "/real/ball", self.balls.append, 10)
        self._peer.create_subscription(BallEvent, "/real/ball_event", self.events.append, 10)
        self._commands = self._peer.create_publisher(JointState, "/real/joint_commands", 10)
        self._reset = self._peer.create_client(Trigger, "/real/reset")
        self.supply = self._peer.create_client(Trigger, "/real/supply_ball")
        self._goal: tuple[float, float] | None = None
        self._peer.create_timer(0.02, self._send)

    def start_testbed(self, *options: str) -> None:
        command = [sys.executable, "-m", "labyrinth_hw.nodes.testbed", "--config", "healthy", "--seed", "1", *options]
        self.testbed = self._start(command, subprocess.PIPE)
        assert self.testbed.stdout is not None
        while "Ctrl-C ends it" not in (line := self.testbed.stdout.readline()):
            assert line, "the testbed did not start"

    def start_node(self, **parameters: object) -> None:
        options = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        command = [sys.executable, "-m", "labyrinth_hw.nodes.hw_node", "--ros-args", "-p", "config:=healthy", *options]
        self.node = self._start(command, None)

    def _start(self, command: list[str], pipe: int | None) -> "subprocess.Popen[str]":
        errors = subprocess.PIPE if pipe is None else None
        return subprocess.Popen(
            command, env=self.environment, stdin=subprocess.PIPE, stdout=pipe, stderr=errors, text=True
        )

    def tell(self, fault: str) -> None:
        """Give the testbed an order and wait until it obeyed."""
        assert self.testbed is not None and self.testbed.stdin is not None and self.testbed.stdout is not None
        self.testbed.stdin.write(fault + "\n")
        self.testbed.stdin.flush()
        assert self.testbed.stdout.readline() == f"done: {fault}\n"

    def command(self, goal: tuple[float, float] | None) -> None:
        """Keep sending this goal, rad; None stops sending."""
        self._goal = goal

    def _send(self) -> None:
        from sensor_msgs.msg import JointState

        if self._goal is not None:
            message = JointState(name=["motor_x", "motor_y"], position=list(self._goal))
            message.header.stamp = self._peer.get_clock().now().to_msg()
            self._commands.publish(message)

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

    def close(self) -> None:
        for process in (self.node, self.testbed):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(20)
        self._executor.remove_node(self._peer)
        self._peer.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    yield made
    made.close()


@pytest.fixture
def running(bench: Bench) -> Bench:
    bench.start_testbed()
    bench.start_node()
    bench.more_states(5)
    return bench


def test_commands_move_both_axes_and_states_are_complete(running: Bench) -> None:
    running.command((0.05, -0.03))
    running.until(lambda: running.reaches((0.05, -0.03)), "both motors at their goals")
    running.more_states(100)
    state = running.states[-1]
    assert list(state.name) == ["motor_x", "motor_y", "board_x", "board_y"]
    assert state.position[2] == pytest.approx(0.05, abs=0.004)
    assert state.position[3] == pytest.approx(-0.03, abs=0.004)
    stamps = [s.header.stamp.sec + 1e-9 * s.header.stamp.nanosec for s in running.states[-100:]]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert abs(stamps[-1] - time.time()) < PATIENCE
    running.until(lambda: running.status().get("state") == "active", "diagnostics that tell the state")
    assert running.status()["motor_x temperature [degC]"] == "30"


def test_without_commands_the_rig_holds_and_goes_on_with_the_next(running: Bench) -> None:
    running.command((0.04, 0.0))
    running.until(lambda: running.reaches((0.04, 0.0)), "the goal")
    running.command(None)
    running.until(lambda: running.status().get("state") == "holding", "holding after silence")
    running.more_states(30)
    assert running.reaches((0.04, 0.0))
    running.command((0.0, 0.0))
    running.until(lambda: running.reaches((0.0, 0.0)), "the next goal")


def test_an_overload_switches_torque_off_until_reset(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    running.tell("alarm x 0x20")
    running.until(lambda: running.status().get("state") == "stopped", "the stop")
    assert "motor_x: the servo reports overload" in running.status()["message"]
    running.command((-0.03, 0.0))
    running.more_states(50)
    assert running.motor()[0] > -0.01, "nothing may move while stopped"
    running.tell("heal x")
    running.reset()
    running.until(lambda: running.reaches((-0.03, 0.0)), "motion after the reset")


def test_servos_unplugged_and_plugged_in_again(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    running.tell("unplug servos")
    running.until(lambda: "disconnected" in running.status().get("message", ""), "a word about the lost bus")
    before = len(running.states)
    running.command((0.0, 0.02))
    running.tell("plug servos")
    running.until(lambda: len(running.states) > before and running.reaches((0.0, 0.02)), "motion after the replug")
    running.until(lambda: running.status().get("reconnects") == "1", "the reconnect counted")


def test_bad_packets_late_servos_and_a_lost_sensor_line_do_not_stop_the_rig(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.tell("noise servos 0.01")
    running.more_states(300)
    running.tell("noise servos 0")
    running.tell("late servos 0.004")
    running.more_states(20)
    running.tell("late servos 0")
    running.tell("unplug sensors")
    running.until(
        lambda: running.states[-1].position[2] != running.states[-1].position[2], "NaN for the potentiometers"
    )
    assert running.reaches((0.03, 0.0)), "the servos go on"
    running.tell("plug sensors")
    running.until(lambda: abs(running.states[-1].position[2] - 0.03) < 0.004, "the potentiometers back")


def test_a_killed_node_leaves_a_rig_that_the_next_one_can_take_over(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    assert running.node is not None
    running.node.kill()
    running.node.wait()
    running.states.clear()
    running.command((0.0, 0.0))
    running.start_node()
    running.until(lambda: running.reaches((0.0, 0.0)), "motion under the new node")


def test_a_second_node_on_the_port_refuses_with_code_2(running: Bench) -> None:
    first = running.node
    running.start_node()
    second, running.node = running.node, first
    assert second is not None
    _, text = second.communicate(timeout=PATIENCE)
    assert second.returncode == 2
    assert "in use by another program" in text
    running.more_states(20)


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_torque_goes_off_when_the_node_ends(bench: Bench, how: int) -> None:
    from labyrinth_hw.control_tables import servo_model
    from labyrinth_hw.motors import Motor
    from labyrinth_hw.servo_bus import ServoBus

    bench.start_testbed()
    bench.start_node()
    bench.command((0.03, 0.0))
    bench.until(lambda: bool(bench.states) and bench.reaches((0.03, 0.0)), "the goal")
    assert bench.node is not None
    bench.node.send_signal(how)
    assert bench.node.wait(20) == 0
    bus = ServoBus(str(bench.folder / "links" / "servos"), 1_000_000, [Motor("motor_x", 1, servo_model("MX-64"))])
    bus.connect()
    assert bus.read("motor_x", "torque_enable") == 0
    bus.close()


def test_a_node_that_starts_first_waits_for_its_ports(bench: Bench) -> None:
    bench.start_node(connect_timeout="25.0")
    bench.start_testbed()
    bench.more_states(5)


def test_dry_run_measures_but_moves_nothing(bench: Bench) -> None:
    bench.start_testbed()
    bench.start_node(dry_run="true")
    bench.command((0.05, 0.05))
    bench.more_states(100)
    assert bench.reaches((0.0, 0.0))


def test_the_ball_is_seen_lost_and_supplied(bench: Bench) -> None:
    from std_srvs.srv import Trigger

    from labyrinth_msgs.msg import BallEvent

    bench.start_testbed("--video", "--video-rate", "15")
    bench.start_node()
    start = (0.166, 0.2205)  # of the medium layout's path

    def near_start() -> bool:
        ball = bench.balls[-1] if bench.balls else None
        return ball is not None and ball.visible and max(abs(ball.x - start[0]), abs(ball.y - start[1])) < 0.005

    bench.until(near_start, "the ball at its start")
    bench.command((-0.06, -0.06))
    for goal in ((0.06, -0.06), (0.06, 0.06), (-0.06, 0.06), (0.06, -0.06), (0.06, 0.06)):
        for _ in range(25):
            bench.more_states(5)
            if any(event.kind == BallEvent.LOST for event in bench.events):
                break
        bench.command(goal)
    bench.until(lambda: any(event.kind == BallEvent.LOST for event in bench.events), "the ball lost")
    bench.command((0.0, 0.0))
    bench.until(lambda: bench.reaches((0.0, 0.0)), "a level board")
    bench.until(bench.supply.call_async(Trigger.Request()).done, "the depot's service")
    bench.until(lambda: any(event.kind == BallEvent.SUPPLIED for event in bench.events), "the ball supplied")
    bench.until(near_start, "the ball at its start again")


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"config": "papr"}, "Did you mean 'paper'"),
        ({"rate": "5.0"}, "rate"),
        ({"spede": "1"}, "Unknown parameters"),
        ({"connect_timeout": "0.2"}, "does not exist"),
    ],
)
def test_bad_parameters_and_missing_hardware_end_with_code_2(bench: Bench, parameters: dict, complaint: str) -> None:
    bench.start_node(**parameters)
    assert bench.node is not None
    _, text = bench.node.communicate(timeout=PATIENCE)
    assert bench.node.returncode == 2
    assert complaint in text
