# SPDX-License-Identifier: Apache-2.0
"""The rig and its simulation side by side: who listens to one can listen to the other."""

import math
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from diagnostic_msgs.msg import DiagnosticArray
from nodes_under_test import Workplace, workplace
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_srvs.srv import Trigger

from eps_tunnel_analysis.nodes.rig_processes import executable
from labyrinth_msgs.msg import BallEvent, BallState

pytestmark = pytest.mark.realtime
SIDES = ("real", "sim")
NODES = {"real": "hw_node", "sim": "sim_node"}
KINDS: dict[str, Any] = {"joint_states": JointState, "ball": BallState, "ball_event": BallEvent}
ONLY_REAL = {"camera/annotated", "camera/image_raw", "camera/camera_info"}  # the simulation has no camera
ONLY_SIM_TOPICS = {"model", "robot_description"}  # a rig knows neither
ONLY_SIM = {"load_model", "pause", "step"}  # nor can another rig be loaded, or time be stopped
GOAL = (0.05, -0.03)  # rad
GEOMETRY = Path(__file__).parents[1] / "config" / "labyrinth_geometry.yaml"
START = yaml.safe_load(GEOMETRY.read_text())["layouts"]["medium"]["path"][0]  # m


class Both(Workplace):
    """The emulated testbed behind its node as /real, the simulation as /sim."""

    def begin(self) -> None:
        self.heard: dict[tuple[str, str], list[Any]] = {(side, name): [] for side in SIDES for name in KINDS}
        self.arrivals: dict[tuple[str, str], list[int]] = {key: [] for key in self.heard}
        self.refused = {"hw_node": 0, "sim_node": 0}
        for (side, name), kept in self.heard.items():

            def hear(message: Any, kept: list[Any] = kept, when: list[int] = self.arrivals[side, name]) -> None:
                kept.append(message)
                when.append(self.node.get_clock().now().nanoseconds)

            self.node.create_subscription(KINDS[name], f"/{side}/{name}", hear, 1000)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._count_refused, 10)
        self.publishers = [self.node.create_publisher(JointState, f"/{side}/joint_commands", 10) for side in SIDES]
        self.goal: tuple[float, float] | None = None
        self.node.create_timer(0.02, self._command)
        testbed = [executable("labyrinth_hw", "testbed"), "--config", "healthy", "--seed", "1"]
        self.processes.start("testbed", [*testbed, "--video", "--video-rate", "15"])
        self.start("labyrinth_hw", "hw_node", config="healthy", connect_timeout=60.0, arm="true")
        self.start("labyrinth_sim", "sim_node")
        self.until(lambda: all(self.last(side, "ball") and self.last(side, "ball").visible for side in SIDES))
        # What is there gets known one by one, the ends of topics before the names of their nodes.
        self.until(lambda: set(NODES.values()) <= set(self.node.get_node_names()))
        self.until(lambda: all({"reset", "supply_ball"} <= set(self.services(side)) for side in SIDES))
        self.until(lambda: set(self.services("sim")) >= ONLY_SIM and set(self.topics("real")) >= ONLY_REAL)
        self.until(lambda: all(self.ends(side, name) for side in SIDES for name in ("joint_commands", *KINDS)))

    def topics(self, side: str) -> dict[str, list[str]]:
        return names(self.node.get_topic_names_and_types(), side)

    def services(self, side: str) -> dict[str, list[str]]:
        return names(self.node.get_service_names_and_types_by_node(NODES[side], "/"), side)

    def ends(self, side: str, name: str) -> list[Any]:
        """Publishers and subscribers of the side's own node."""
        topic = f"/{side}/{name}"
        found = [*self.node.get_publishers_info_by_topic(topic), *self.node.get_subscriptions_info_by_topic(topic)]
        return [end for end in found if end.node_name == NODES[side]]

    def last(self, side: str, name: str) -> Any:
        return self.heard[side, name][-1] if self.heard[side, name] else None

    def _command(self) -> None:
        if self.goal is not None:
            for publisher in self.publishers:
                message = JointState(name=["motor_x", "motor_y"], position=list(self.goal))
                message.header.stamp = self.node.get_clock().now().to_msg()
                publisher.publish(message)

    def _count_refused(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name.split(":")[0]
            for value in status.values:
                if value.key == "commands refused":
                    self.refused[name] = int(value.value)

    def at_goal(self, side: str) -> bool:
        state = self.last(side, "joint_states")
        return bool(np.allclose(state.position, [*GOAL, *GOAL], atol=0.006))


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Both]:
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("both")
        patch.setenv("LABYRINTH_TESTBED_DIR", str(folder / "links"))
        with workplace(folder, module_domain) as place:
            place.__class__ = Both
            place.begin()
            yield place


@pytest.fixture(scope="module")
def moved(both: Both) -> dict[str, list[JointState]]:
    """Joint states of both sides while they go from level to GOAL, and rest there."""
    begun = {side: len(both.heard[side, "joint_states"]) for side in SIDES}
    both.goal = GOAL
    both.until(lambda: all(both.at_goal(side) for side in SIDES))
    rest = {side: len(both.heard[side, "joint_states"]) + 150 for side in SIDES}
    both.until(lambda: all(len(both.heard[side, "joint_states"]) > rest[side] for side in SIDES))
    return {side: both.heard[side, "joint_states"][max(0, begun[side] - 10) :] for side in SIDES}


def seconds(message: Any) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def names(found: list[tuple[str, list[str]]], side: str) -> dict[str, list[str]]:
    return {name.removeprefix(f"/{side}/"): kinds for name, kinds in found if name.startswith(f"/{side}/")}


def test_topics_have_the_same_names_and_types(both: Both) -> None:
    real, sim = both.topics("real"), both.topics("sim")
    assert set(real) - set(sim) == ONLY_REAL
    assert set(sim) - set(real) == ONLY_SIM_TOPICS
    assert all(real[name] == sim[name] for name in set(sim) - ONLY_SIM_TOPICS)
    assert {"joint_commands", *KINDS} <= set(sim)


@pytest.mark.parametrize("topic", ["joint_commands", *KINDS])
def test_quality_of_service_is_the_same(both: Both, topic: str) -> None:
    def offered(side: str) -> set[tuple[Any, ...]]:
        return {
            (
                end.endpoint_type,
                q.reliability,
                q.durability,
                q.liveliness,
                q.deadline.nanoseconds,
                q.lifespan.nanoseconds,
            )
            for end in both.ends(side, topic)
            for q in [end.qos_profile]
        }

    assert len(offered("real")) == 1
    assert offered("real") == offered("sim")


def test_the_camera_s_ball_is_where_the_testbed_has_it(both: Both) -> None:
    """On a level board it rests at the start of the layout's path; the camera is good for 3 mm."""
    ball = both.last("real", "ball")
    assert math.dist((ball.x, ball.y), START) < 0.003


def test_the_camera_s_picture_comes_raw_with_its_lens(both: Both) -> None:
    pictures: list[Image] = []
    lenses: list[CameraInfo] = []
    listening = both.node.create_subscription(Image, "/real/camera/image_raw", pictures.append, 10)
    both.node.create_subscription(CameraInfo, "/real/camera/camera_info", lenses.append, 100)

    def paired() -> list[tuple[Image, CameraInfo]]:
        return [(p, i) for p in pictures for i in lenses if p.header == i.header]

    both.until(paired)
    picture, lens = paired()[0]
    assert (picture.width, picture.height) == (lens.width, lens.height)
    assert len(picture.data) == 3 * picture.width * picture.height
    assert picture.header.frame_id == "camera_optical_frame"
    assert lens.distortion_model == "plumb_bob"
    assert len(lens.d) == 5
    assert 0 < lens.k[2] < lens.width
    both.node.destroy_subscription(listening)


def test_services_have_the_same_names_types_and_answers(both: Both) -> None:
    found = {side: both.services(side) for side in SIDES}
    assert set(found["sim"]) - set(found["real"]) == ONLY_SIM
    assert set(found["real"]) <= set(found["sim"])
    assert all(found["sim"][name] == kinds for name, kinds in found["real"].items())
    for side in SIDES:
        for service in ("reset", "supply_ball"):
            answer = both.call(both.node.create_client(Trigger, f"/{side}/{service}"), Trigger.Request())
            assert answer.success and answer.message
        both.until(lambda side=side: both.last(side, "ball_event") is not None)
        event = both.last(side, "ball_event")
        assert (event.kind, event.hole, event.header.frame_id) == (BallEvent.SUPPLIED, -1, "board_origin")


def test_joints_have_the_same_names_and_the_same_numbers_are_measured(moved: dict[str, list[JointState]]) -> None:
    for messages in moved.values():
        assert {tuple(m.name) for m in messages} == {("motor_x", "motor_y", "board_x", "board_y")}
        assert all(len(m.position) == len(m.velocity) == len(m.effort) == 4 for m in messages)
        assert all(math.isfinite(angle) for m in messages for angle in m.position)
    # After a gap the real board's speed is NaN until there are samples enough again.
    for field, joints in (("velocity", [True] * 4), ("effort", [True, True, False, False])):
        for messages in moved.values():
            numbers = np.isfinite([getattr(m, field) for m in messages])
            assert numbers.any(axis=0).tolist() == joints


@pytest.mark.parametrize("side", SIDES)
def test_units_are_rad_and_rad_per_second(moved: dict[str, list[JointState]], side: str) -> None:
    messages = moved[side]
    time = np.array([seconds(m) for m in messages])
    angles, speeds = np.array([m.position for m in messages]), np.array([m.velocity for m in messages])
    efforts = np.array([m.effort for m in messages])[:, :2]
    assert np.abs(angles).max() < 0.1
    assert np.abs(efforts).max() < 10  # N m, more than any of these servos has
    # A speed in other units, or of the wrong sign, does not add up to the way. Gaps, and NaN after them, are left out.
    step, mean = np.diff(time)[:, None], 0.5 * (speeds[1:] + speeds[:-1])
    told = np.isfinite(mean) & (step < 0.03)
    way = np.sum(np.diff(angles, axis=0), axis=0, where=told)
    assert (np.abs(way) > 0.015).all()
    assert np.sum(mean * step, axis=0, where=told) == pytest.approx(way, abs=0.012)


@pytest.mark.parametrize("side", SIDES)
def test_joint_states_come_at_the_same_rate_with_the_time_of_measurement(both: Both, moved: Any, side: str) -> None:
    stamps = np.array([seconds(m) for m in moved[side]])
    assert all(a < b for a, b in pairwise(stamps))
    assert np.median(np.diff(stamps)) == pytest.approx(0.01, rel=0.1)
    ages = 1e-9 * np.array(both.arrivals[side, "joint_states"]) - [seconds(m) for m in both.heard[side, "joint_states"]]
    assert -0.001 < np.median(ages) < 60.0, "by this clock, and a busy machine may be late"


@pytest.mark.parametrize("side", SIDES)
def test_the_ball_lies_on_the_board_in_metres_with_stamps_in_order(both: Both, moved: Any, side: str) -> None:
    balls = both.heard[side, "ball"]
    stamps = [seconds(ball) for ball in balls]
    assert all(a < b for a, b in pairwise(stamps))
    assert {ball.header.frame_id for ball in balls} == {"board_origin"}
    assert all(0 < ball.x < 0.28 and 0 < ball.y < 0.235 for ball in balls if ball.visible)


@pytest.mark.parametrize("goal", [math.nan, math.inf])
def test_a_goal_that_is_no_angle_is_refused_and_changes_nothing(both: Both, moved: Any, goal: float) -> None:
    before = dict(both.refused)
    both.until(lambda: all(both.at_goal(side) for side in SIDES))
    both.goal = (goal, 0.0)
    both.until(lambda: all(both.refused[node] > before[node] + 10 for node in before))
    assert all(both.at_goal(side) for side in SIDES)
    both.goal = GOAL
