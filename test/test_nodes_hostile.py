# SPDX-License-Identifier: Apache-2.0
"""Messages and requests that make no sense: the nodes that hear them say so and go on."""

import math
import sys
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from builtin_interfaces.msg import Time
from nodes_under_test import Workplace, free_port, workplace
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.recording.decode import read
from labyrinth_msgs.msg import Srg, Trial, TunnelSample
from labyrinth_msgs.srv import Record

pytestmark = pytest.mark.realtime
LENGTHS = (math.nan, math.inf, -5.0, 0.0, 1e7, 1e300)
JOINTS = ["shoulder-pan", "a/b", ""]  # ROS leaves the names of joints free


@pytest.fixture
def place(tmp_path: Path, domain: int) -> Iterator[Workplace]:
    with workplace(tmp_path, domain) as it:
        yield it


def publisher(place: Workplace, kind: Any, topic: str) -> Any:
    """One that is heard already."""
    made = place.node.create_publisher(kind, topic, 50)
    place.until(lambda: made.get_subscription_count() > 0)
    return made


def marks(sequence: str = "wrong") -> list[Trial]:
    return [Trial(phase=Trial.START, sequence=sequence, sequence_hash="a" * 64, duration=length) for length in LENGTHS]


def test_the_analysis_node_records_on_among_messages_that_make_no_sense(place: Workplace) -> None:
    place.start("eps_tunnel_analysis", "analysis_node")
    told: list[Srg] = []
    place.node.create_subscription(Srg, "/srg", told.append, 100)
    states = {side: publisher(place, JointState, f"/{side}/joint_states") for side in ("real", "sim")}
    trials = {side: publisher(place, Trial, f"/{side}/trial") for side in ("real", "sim")}

    sent: list[int] = []

    def measure() -> None:
        at = len(sent)
        sent.append(at)
        for states_of_side in states.values():
            message = JointState(name=JOINTS, position=[0.01 * at, math.nan, math.inf])
            message.header.stamp = Time(sec=100 + at // 100, nanosec=at % 100 * 10_000_000)
            states_of_side.publish(message)

    measure()
    for side in trials:
        for mark in marks():
            trials[side].publish(mark)
    good = Trial(phase=Trial.START, sequence="good", sequence_hash="b" * 64, duration=0.5)
    good.header.stamp = Time(sec=100, nanosec=100_000_000)
    for side in trials:
        trials[side].publish(good)
    place.node.create_timer(0.01, measure)
    place.until(lambda: told and told[-1].signals and told[-1].samples > 30)
    assert told[-1].signals == ["shoulder-pan"], "what is measured on both sides, under whatever name"
    record = place.node.create_client(Record, "/record")
    for folder, label in (
        (place.folder, "x" * 5000),
        ("y" * 5000, "a"),
        ("/proc/no_folder", "a"),
        (place.folder, "a/b"),
    ):
        answer = place.call(record, Record.Request(start=True, folder=str(folder), label=label, sides=["real"]))
        assert not answer.success and answer.message
    answer = place.call(record, Record.Request(start=True, folder=str(place.folder), label="whole", sides=["real"]))
    assert answer.success, answer.message
    before = len(sent)
    place.until(lambda: len(sent) > before + 100)
    answer = place.call(record, Record.Request(start=False))
    assert answer.success, answer.message
    assert len(read(Path(answer.bags[0])).topics["/real/joint_states"]) > 50


def test_the_monitor_goes_on_among_figures_that_do_not_belong_together(place: Workplace) -> None:
    port = free_port()
    place.start("eps_tunnel_analysis", "monitor", port=port, ask_token="false", folder=place.folder / "out")
    trials, samples, figures = (
        publisher(place, kind, topic)
        for kind, topic in ((Trial, "/sim/trial"), (TunnelSample, "/srg/tunnel"), (Srg, "/srg"))
    )
    two, three = [0.0, math.inf], [0.0, 1.0, math.nan]
    for mark in marks():
        trials.publish(mark)
    logs = place.folder / "logs" / "monitor.log"

    def sent_until(words: str, send: Any) -> None:
        """Sends what fits and what does not until the monitor has told of the latter."""
        timer = place.node.create_timer(0.2, lambda: [send(mean) for mean in (two, three, [])])
        place.until(lambda: words in logs.read_text())
        place.node.destroy_timer(timer)

    tunnel = {"time": 0.1, "signals": ["a", "b"], "lower": two, "upper": two, "simulated": two, "alike": [True, False]}
    sent_until("Ignored a TunnelSample", lambda mean: samples.publish(TunnelSample(mean=mean, **tunnel)))
    shares = {"signals": ["a", "b"], "k": two, "samples": 9, "trials": 9}
    sent_until("Ignored a Srg", lambda mean: figures.publish(Srg(alikeness=mean, joint=mean, rig_joint=mean, **shares)))
    connection = HTTPConnection("127.0.0.1", port, timeout=90)
    connection.request("GET", "/")
    assert connection.getresponse().status == 200
    place.processes.check()
