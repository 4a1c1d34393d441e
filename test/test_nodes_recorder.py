# SPDX-License-Identifier: Apache-2.0
"""The recording analysis node, killed and interrupted."""

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from nodes_under_test import Workplace, workplace
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.recording.reader import read
from labyrinth_msgs.srv import Record

pytestmark = pytest.mark.realtime


class Recording(Workplace):
    """An analysis node that records what this process publishes at 100 Hz."""

    def begin(self) -> None:
        self.sent: list[int] = []
        self.start("eps_tunnel_analysis", "analysis_node")
        # Deep, so that what the recorder missed until it was matched, or while it was stopped, is sent again.
        self.publisher = self.node.create_publisher(JointState, "/real/joint_states", 1000)
        self.record = self.node.create_client(Record, "/record")
        self.until(lambda: self.publisher.get_subscription_count() == 1)
        self.node.create_timer(0.01, self._publish)
        folder = str(self.folder / "bags")
        answer = self.call(self.record, Record.Request(start=True, folder=folder, label="some", sequence="any"))
        assert answer.success, answer.message
        self.bag = Path(answer.bags[0])
        self.sent.clear()

    def _publish(self) -> None:
        now = self.node.get_clock().now()
        message = JointState(name=["motor_x"], position=[float(len(self.sent))])
        message.header.stamp = now.to_msg()
        self.publisher.publish(message)
        self.sent.append(now.nanoseconds)

    def until_grown(self) -> None:
        """Waits until one more chunk of the bag is on the disk."""
        before = sum(file.stat().st_size for file in self.bag.iterdir())
        self.until(lambda: sum(file.stat().st_size for file in self.bag.iterdir()) > before)

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
    # A chunk holds half a second, as the recorder is served; the second from now holds all that was sent before.
    before = recording.sent[-1]
    recording.until_grown()
    recording.until_grown()
    assert recording.end(signal.SIGKILL) == -signal.SIGKILL
    sent = np.array(recording.sent)
    found = read(recording.bag)
    assert not found.closed
    stamps = found.stamps("/real/joint_states")
    kept = np.isin(sent, stamps)
    assert (sent <= before).sum() > 100
    assert kept[sent <= before].all()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_recorder_leaves_a_whole_bag(recording: Recording, number: signal.Signals) -> None:
    recording.until(lambda: len(recording.sent) > 100)
    assert recording.end(number) == 0
    found = read(recording.bag)
    assert found.closed
    assert len(found.topics["/real/joint_states"]) > 50


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
    assert [Path(bag).name for bag in done.bags] == ["some_real", "some_sim"]
    assert all((Path(bag) / "metadata.yaml").is_file() for bag in done.bags)
    idle = recording.call(recording.record, Record.Request(start=False))
    assert not idle.success
    assert "Nothing is being recorded" in idle.message
    nameless = recording.call(recording.record, Record.Request(label="", **ask))
    assert not nameless.success
    assert "label" in nameless.message
