# SPDX-License-Identifier: Apache-2.0
"""The simulation node as a real process, seen from outside."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2")
labyrinth_msgs = pytest.importorskip("labyrinth_msgs.srv", reason="needs the workspace to be built and sourced")

from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from labyrinth_msgs.msg import BallState  # noqa: E402

START = "from labyrinth_sim.nodes.sim_node import main; main()"
PATIENCE = 60.0  # s; only what hangs takes so long
SOON = 2.0  # s from a signal to the end of the node
pytestmark = pytest.mark.realtime


def start(*parameters: str) -> subprocess.Popen[str]:
    flags = [word for parameter in parameters for word in ("-p", parameter)]
    return subprocess.Popen(
        [sys.executable, "-c", START, *(["--ros-args", *flags] if flags else [])],
        stderr=subprocess.PIPE,
        text=True,
    )


class Watcher:
    """A node that keeps what it hears."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("watcher", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.states: list[JointState] = []
        self.balls: list[BallState] = []
        self.clocks: list[Clock] = []
        self.node.create_subscription(JointState, "/sim/joint_states", self.states.append, 1000)
        self.node.create_subscription(BallState, "/sim/ball", self.balls.append, 1000)
        self.node.create_subscription(Clock, "/clock", self.clocks.append, 1000)
        self.commands = self.node.create_publisher(JointState, "/sim/joint_commands", 10)

    def until(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < end, "waited in vain"
            self.executor.spin_once(timeout_sec=0.05)

    def call(self, kind: type, name: str, **fields: object) -> object:
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**fields))
        self.until(future.done)
        return future.result()

    def angle(self, joint: str) -> float:
        return float(self.states[-1].position[list(self.states[-1].name).index(joint)])


@pytest.fixture(autouse=True)
def own_domain(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))


@pytest.fixture
def watcher(own_domain: None, domain: int) -> Iterator[Watcher]:
    watcher = Watcher(domain)
    yield watcher
    watcher.executor.shutdown()
    watcher.node.destroy_node()
    rclpy.shutdown(context=watcher.context)


def test_the_node_obeys_changes_its_model_and_leaves_cleanly(watcher: Watcher) -> None:
    node = start("model:=labyrinth_manual")
    try:
        watcher.until(lambda: len(watcher.states) > 20 and len(watcher.balls) > 20)
        assert set(watcher.states[-1].name) == {"motor_x", "motor_y", "board_x", "board_y"}
        stamps = [s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in watcher.states]
        assert {round((b - a) / 1e6) for a, b in pairwise(stamps)} == {10}
        watcher.commands.publish(JointState(name=["motor_x"], position=[0.03]))
        watcher.until(lambda: abs(watcher.angle("board_x") - 0.03) < 1e-3)
        refused = watcher.call(labyrinth_msgs.LoadModel, "/sim/load_model", model="labyrinth_manuel")
        assert not refused.success
        assert "labyrinth_manual" in refused.message
        taken = watcher.call(labyrinth_msgs.LoadModel, "/sim/load_model", model="labyrinth_es_x")
        assert taken.success, taken.message
        heard = len(watcher.states)
        watcher.until(lambda: len(watcher.states) > heard + 20)
        assert watcher.angle("motor_x") == pytest.approx(0.03, abs=5e-3)
        assert watcher.call(Trigger, "/sim/supply_ball").success
        assert watcher.call(Trigger, "/sim/reset").success
        watcher.until(lambda: abs(watcher.angle("motor_x")) < 1e-3)
    finally:
        node.send_signal(signal.SIGINT)
        _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 0, errors
    assert "Traceback" not in errors


def test_a_disarmed_simulation_refuses_commands_until_it_is_activated(watcher: Watcher) -> None:
    node = start("model:=labyrinth_manual", "arm:=false", "autostart:=false")

    def go(transition: int) -> bool:
        return bool(watcher.call(ChangeState, "/sim_node/change_state", transition=Transition(id=transition)).success)

    def commanded() -> bool:
        watcher.commands.publish(JointState(name=["motor_x"], position=[0.03]))
        watcher.executor.spin_once(timeout_sec=0.02)
        return watcher.angle("motor_x") > 0.02

    try:
        assert not watcher.call(SetBool, "/sim/arm", data=True).success, "not configured"
        assert not watcher.states
        assert go(Transition.TRANSITION_CONFIGURE)
        watcher.until(lambda: len(watcher.states) > 5 and watcher.commands.get_subscription_count() > 0)
        assert not any(commanded() for _ in range(100))
        assert go(Transition.TRANSITION_ACTIVATE)
        watcher.until(commanded)
        assert watcher.call(SetBool, "/sim/arm", data=False).success
        assert go(Transition.TRANSITION_CLEANUP)
        assert go(Transition.TRANSITION_CONFIGURE)
        watcher.until(lambda: abs(watcher.angle("motor_x")) < 1e-3)  # from rest, and the old goal is forgotten
        assert not any(commanded() for _ in range(50))
        assert watcher.call(SetBool, "/sim/arm", data=True).success
        watcher.until(commanded)
    finally:
        node.send_signal(signal.SIGTERM)
        _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 0, errors


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_without_a_clock_it_simulates_and_ends(watcher: Watcher, how: int) -> None:
    node = start("use_sim_time:=true")
    try:
        watcher.until(lambda: len(watcher.states) > 20)
        assert all(state.header.stamp.sec >= 0 for state in watcher.states)
        node.send_signal(how)
        _, errors = node.communicate(timeout=SOON)
    finally:
        node.kill()
    assert node.returncode == 0, errors


def test_commands_that_piled_up_are_not_followed_one_by_one(watcher: Watcher) -> None:
    node = start("model:=labyrinth_manual", "real_time_factor:=50.0")  # more than it can: its thread is always busy
    many = watcher.node.create_publisher(JointState, "/sim/joint_commands", 50)
    try:
        watcher.until(lambda: len(watcher.states) > 20 and many.get_subscription_count() > 0)
        node.send_signal(signal.SIGSTOP)
        for angle in [-0.05] * 45 + [0.05]:
            many.publish(JointState(name=["motor_x"], position=[angle]))
        node.send_signal(signal.SIGCONT)
        heard = len(watcher.states)
        watcher.until(lambda: watcher.angle("motor_x") > 0.045)
        assert min(s.position[list(s.name).index("motor_x")] for s in watcher.states[heard:]) > -0.035
    finally:
        node.send_signal(signal.SIGCONT)
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=PATIENCE)


def test_the_clock_runs_at_the_factor_asked_for(watcher: Watcher) -> None:
    node = start("real_time_factor:=4.0")
    try:
        watcher.until(lambda: len(watcher.clocks) > 100)
        stamp = watcher.states[-1].header.stamp
        assert 0 < stamp.sec + stamp.nanosec * 1e-9 < 600, "counted from the start, not by the calendar"
    finally:
        node.send_signal(signal.SIGTERM)
        node.communicate(timeout=PATIENCE)
    assert node.returncode == 0


@pytest.mark.parametrize("wrong", ["model:=no_such_model", "real_time_factor:=0.0", "rate:=fast"])
def test_wrong_parameters_are_refused(wrong: str) -> None:
    node = start(wrong)
    _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 2
    assert wrong.split(":=")[0] in errors
    assert "Traceback" not in errors
