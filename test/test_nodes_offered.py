# SPDX-License-Identifier: Apache-2.0
"""What is recorded of publishers with other qualities of service, and what a recording says that heard nothing."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from mcap.reader import make_reader
from nodes_under_test import Workplace, workplace
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.recording.bag import read_bag
from labyrinth_msgs.srv import Record

pytestmark = pytest.mark.realtime
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Rig(Workplace):
    """An analysis node, and publishers of this process under /real."""

    def begin(self, *options: str) -> None:
        self.processes.start("analysis_node", [executable("eps_tunnel_analysis", "analysis_node"), *options])
        self.record = self.node.create_client(Record, "/record")
        self.until(self.record.service_is_ready)

    def publish(self, kind: Any, topic: str, profile: QoSProfile, **fields: Any) -> Any:
        """Publishes the same message at 50 Hz."""
        publisher = self.node.create_publisher(kind, topic, profile)
        self.node.create_timer(0.02, lambda: publisher.publish(kind(**fields)))
        return publisher

    def ask(self, start: bool, **fields: Any) -> Any:
        return self.call(self.record, Record.Request(start=start, folder=str(self.folder / "bags"), **fields))

    def spin_for(self, messages: int) -> None:
        """Until as many more periods have passed as messages are wanted."""
        ticks: list[None] = []
        timer = self.node.create_timer(0.02, lambda: ticks.append(None))
        self.until(lambda: len(ticks) > messages)
        self.node.destroy_timer(timer)


@pytest.fixture
def rig(tmp_path: Path, domain: int) -> Iterator[Rig]:
    with workplace(tmp_path, domain) as place:
        place.__class__ = Rig
        yield place


def test_best_effort_and_latched_topics_are_recorded_as_offered(rig: Rig) -> None:
    rig.begin()
    rig.publish(JointState, "/real/joint_states", BEST_EFFORT, name=["motor_x"], position=[0.1])
    rig.publish(JointState, "/real/loads", BEST_EFFORT, name=["motor_x"], effort=[0.2])
    about = rig.node.create_publisher(String, "/real/about", LATCHED)
    about.publish(String(data="before the recording"))
    assert (started := rig.ask(True, label="soft", sides=["real"])).success, started.message
    rig.spin_for(50)
    done = rig.ask(False)
    assert done.success, done.message
    bag = Path(done.bags[0])
    found = {name: len(topic.messages) for name, topic in read_bag(bag).topics.items()}
    assert found["/real/joint_states"] > 25
    assert found["/real/loads"] > 25
    assert found["/real/about"] == 1
    told = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    offered = {
        entry["topic_metadata"]["name"]: entry["topic_metadata"]["offered_qos_profiles"][0]
        for entry in told["topics_with_message_count"]
    }
    assert offered["/real/joint_states"]["reliability"] == "best_effort"
    assert offered["/real/about"]["durability"] == "transient_local"
    assert told["ros_distro"] not in ("", "rosbags")
    with next(bag.glob("*.mcap")).open("rb") as stream:
        times = [(m.publish_time, m.log_time) for _, _, m in make_reader(stream).iter_messages(["/real/joint_states"])]
    assert all(0 < log - sent < 60e9 for sent, log in times), "sent first, heard then"


def test_a_recording_without_joint_states_is_an_error_that_says_why(rig: Rig) -> None:
    # Reliability is fixed by a parameter, so the node must stay deaf to this publisher, and say so.
    deaf = "qos_overrides./real/joint_states.subscription.reliability:=reliable"
    rig.begin("--ros-args", "-p", deaf, "-p", "connect_timeout:=2.0")
    rig.publish(JointState, "/real/joint_states", BEST_EFFORT, name=["motor_x"], position=[0.1])
    assert (started := rig.ask(True, label="deaf", sides=["real"])).success, started.message
    rig.spin_for(25)
    done = rig.ask(False)
    assert not done.success
    assert "0 messages on /real/joint_states: /test_client published nothing" in done.message
    assert "reliable" in done.message
    assert [Path(bag).name for bag in done.bags] == ["deaf_real"]
    asked = rig.ask(True, label="named", sides=["sim"])
    assert asked.success, asked.message
    silent = rig.ask(False)
    assert "0 messages on /sim/joint_states: nothing publishes there" in silent.message
    assert "Did you mean 'real'" in rig.ask(True, label="wrong", sides=["reel"]).message


def test_without_anybody_who_measures_nothing_is_recorded(rig: Rig) -> None:
    rig.begin()
    answer = rig.ask(True, label="none")
    assert not answer.success
    assert "No joint states under /real/ or /sim/" in answer.message
    assert not (rig.folder / "bags").exists()
