# SPDX-License-Identifier: Apache-2.0
"""The recording analysis node: nothing is missing at the beginning, and it is killed and interrupted."""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

import rclpy
from nodes_under_test import Workplace, workplace
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.recording.bag import read_bag
from eps_tunnel_analysis.recording.decode import read
from labyrinth_msgs.msg import RunningModel
from labyrinth_msgs.srv import Record
from labyrinth_sim.errors import InputError

pytestmark = pytest.mark.realtime


class Recording(Workplace):
    """An analysis node that records what this process publishes at 100 Hz."""

    def begin(self) -> None:
        self.sent: list[int] = []
        self.start("eps_tunnel_analysis", "analysis_node")
        # Deep, so that what the recorder missed while it was stopped is sent again.
        self.publisher = self.node.create_publisher(JointState, "/real/joint_states", 1000)
        self.record = self.node.create_client(Record, "/record")
        folder = str(self.folder / "bags")
        answer = self.call(self.record, Record.Request(start=True, folder=folder, label="some", sequence="any"))
        assert answer.success, answer.message
        self.bag = Path(answer.bags[0])
        self._publish()
        self.node.create_timer(0.01, self._publish)

    def _publish(self) -> None:
        now = self.node.get_clock().now()
        message = JointState(name=["motor_x"], position=[float(len(self.sent))])
        message.header.stamp = now.to_msg()
        self.publisher.publish(message)
        self.sent.append(now.nanoseconds)

    def written_until(self) -> int:
        """The last stamp that a reader finds in the bag while it is written, ns; 0 before the first."""
        try:
            found = read(self.bag)
        except InputError:
            return 0
        topic = "/real/joint_states"
        return int(found.stamps(topic)[-1]) if topic in found.topics else 0

    def end(self, number: signal.Signals) -> int:
        process = self.processes._running.pop("analysis_node")
        process.send_signal(number)
        return process.wait(timeout=60)


@pytest.fixture
def recording(tmp_path: Path, domain: int) -> Iterator[Recording]:
    with workplace(tmp_path, domain) as place:
        place.__class__ = Recording
        place.begin()
        yield place


def test_a_killed_recorder_loses_at_most_the_last_second(recording: Recording) -> None:
    recording.until(lambda: len(recording.sent) > 200)
    before = recording.sent[-1]
    # Half a second, as the recorder and the disk are served.
    recording.until(lambda: recording.written_until() >= before)
    assert recording.end(signal.SIGKILL) == -signal.SIGKILL
    sent = np.array(recording.sent)
    found = read(recording.bag)
    assert not found.closed
    stamps = found.stamps("/real/joint_states")
    kept = np.isin(sent, stamps)
    assert (sent <= before).sum() > 200
    assert kept[sent <= before].all()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_recorder_leaves_a_whole_bag(recording: Recording, number: signal.Signals) -> None:
    recording.until(lambda: len(recording.sent) > 100)
    assert recording.end(number) == 0
    found = read(recording.bag)
    assert found.closed
    assert found.stamps("/real/joint_states")[0] == recording.sent[0]


def test_what_came_before_the_stop_is_in_the_bag_however_far_behind_the_recorder_is(recording: Recording) -> None:
    recording.until(lambda: len(recording.sent) > 50)
    process = recording.processes._running["analysis_node"]
    process.send_signal(signal.SIGSTOP)
    try:
        held = len(recording.sent)
        recording.until(lambda: len(recording.sent) > held + 150)
        sent = np.array(recording.sent)
        future = recording.record.call_async(Record.Request(start=False))
    finally:
        process.send_signal(signal.SIGCONT)
    answer = recording.result(future)
    assert answer.success, answer.message
    assert np.isin(sent, read(recording.bag).stamps("/real/joint_states")).all()


def test_a_second_recording_is_refused_and_stop_names_the_bags(recording: Recording) -> None:
    ask = {"start": True, "folder": str(recording.folder / "more")}
    again = recording.call(recording.record, Record.Request(label="other", **ask))
    assert not again.success
    assert "Already recording" in again.message
    done = recording.call(recording.record, Record.Request(start=False))
    assert done.success
    assert [Path(bag).name for bag in done.bags] == ["some_real"], "the simulation measured nothing"
    assert all((Path(bag) / "metadata.yaml").is_file() for bag in done.bags)
    idle = recording.call(recording.record, Record.Request(start=False))
    assert not idle.success
    assert "Nothing is being recorded" in idle.message
    nameless = recording.call(recording.record, Record.Request(label="", **ask))
    assert not nameless.success
    assert "label" in nameless.message


QUALITIES = {
    "reliable": QoSProfile(depth=100),
    "best effort": QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT),
}


def joint_state(number: int) -> JointState:
    message = JointState(name=["motor_x"], position=[float(number)])
    message.header.stamp.sec = 1 + number
    return message


@pytest.fixture
def bench(tmp_path: Path, domain: int) -> Iterator[Workplace]:
    with workplace(tmp_path, domain) as place:
        yield place


@contextmanager
def somebody(bench: Workplace) -> Iterator[Node]:
    """A node that neither the recorder nor the one who asks it knows yet, as that of a process that just began."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=bench.context.get_domain_id())
    node = Node("somebody", context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("young", ["recorder", "rig"])
def test_what_is_sent_at_once_after_the_answer_is_in_the_bag(bench: Workplace, quality: str, young: str) -> None:
    """Whoever began last. The rig is silent until the recorder answers."""
    client = bench.node.create_client(Record, "/record")
    topics = ("/real/joint_states", "/real/joint_commands", "/real/loads")
    if young == "rig":
        bench.start("eps_tunnel_analysis", "analysis_node")
        bench.until(client.service_is_ready)
    with somebody(bench) as rig:
        publishers = [rig.create_publisher(JointState, topic, QUALITIES[quality]) for topic in topics]
        if young == "recorder":
            bench.start("eps_tunnel_analysis", "analysis_node")
        ask = {"folder": str(bench.folder / "bags"), "label": "at_once", "sides": ["real"]}
        answer = bench.call(client, Record.Request(start=True, **ask))
        assert answer.success, answer.message
        assert "not matched" not in answer.message.lower()
        for number in range(20):
            for publisher in publishers:
                publisher.publish(joint_state(number))
        assert bench.call(client, Record.Request(start=False)).success
    found = read(Path(answer.bags[0]))
    for topic in topics:
        assert found.topics[topic].columns["motor_x.position"].tolist() == list(range(20))


def test_what_was_latched_before_is_in_the_bag_and_names_its_model(bench: Workplace) -> None:
    bench.start("eps_tunnel_analysis", "analysis_node")
    client = bench.node.create_client(Record, "/record")
    states = bench.node.create_publisher(JointState, "/sim/joint_states", 10)
    models = bench.node.create_publisher(
        RunningModel, "/sim/model", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    models.publish(RunningModel(name="some_model"))
    ask = {"folder": str(bench.folder / "bags"), "label": "latched", "sides": ["sim"]}
    answer = bench.call(client, Record.Request(start=True, **ask))
    assert answer.success, answer.message
    states.publish(joint_state(0))
    assert bench.call(client, Record.Request(start=False)).success
    bag = Path(answer.bags[0])
    assert read(bag).metadata["model"] == "some_model"
    assert len(read_bag(bag).topics["/sim/model"].messages) == 1


def lonely_request(bench: Workplace, connect_timeout: float, served: int) -> tuple[Client, Future]:
    """The client of `/record`, and a request to record a side that is not there, while a node waits for it.

    Args:
        served: calls of another service that the node answers meanwhile.
    """
    bench.start("eps_tunnel_analysis", "analysis_node", connect_timeout=connect_timeout)
    record = bench.node.create_client(Record, "/record")
    parameters = bench.node.create_client(GetParameters, "/analysis_node/get_parameters")
    bench.until(lambda: record.service_is_ready() and parameters.service_is_ready())
    bench.call(record, Record.Request(start=False))  # an answer finds its way only once both have found each other
    ask = {"folder": str(bench.folder / "bags"), "label": "lonely"}
    waiting = record.call_async(Record.Request(start=True, sides=["sim"], **ask))
    for _ in range(served):
        bench.call(parameters, GetParameters.Request(names=["rate"]))
    return record, waiting


def test_the_node_serves_while_an_answer_waits_for_a_side_that_is_not_there(bench: Workplace) -> None:
    record, waiting = lonely_request(bench, 4.0, served=3)
    assert not waiting.done()
    answer = bench.result(waiting)
    assert answer.success, "who names a side may record what will come"
    assert "Not matched yet: /sim/ (no joint states there)." in answer.message
    states = bench.node.create_publisher(JointState, "/sim/joint_states", 10)
    bench.until(states.get_subscription_count)
    for number in range(40):  # the recorder may learn of the publisher later than the other way round
        states.publish(joint_state(number))
        time.sleep(0.05)
    assert bench.call(record, Record.Request(start=False)).success


def test_a_node_that_is_stopped_answers_at_once_and_records_nothing(bench: Workplace) -> None:
    # The first call may be served before a request that came with it.
    _, waiting = lonely_request(bench, 600.0, served=2)
    process = bench.processes._running.pop("analysis_node")
    process.send_signal(signal.SIGTERM)
    answer = bench.result(waiting)
    assert not answer.success
    assert "being stopped" in answer.message
    assert process.wait(timeout=60) == 0
    assert not (bench.folder / "bags").exists()
