# SPDX-License-Identifier: Apache-2.0
"""The analysis node while samples go wrong, with a reference bag, and while it diagnoses."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nodes_under_test import Workplace, from_home, workplace
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from short_sequence import SHORTER

from eps_tunnel_analysis.nodes.messages import to_time
from eps_tunnel_analysis.sequence_file import parse_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline
from labyrinth_msgs.action import Diagnose
from labyrinth_msgs.msg import Diagnosis, LiveCounters, RunningModel, Srg, Trial
from labyrinth_sim import config

pytestmark = pytest.mark.realtime
SECOND = 1_000_000_000
STEP = SECOND // 100
TOPIC = "/real/joint_states"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def place(tmp_path: Path, domain: int) -> Iterator[Workplace]:
    with workplace(tmp_path, domain) as it:
        yield it


class Sender:
    """Joint states of one side with the stamps that a test chooses."""

    def __init__(self, place: Workplace, side: str) -> None:
        self._place, self.now = place, place.node.get_clock().now().nanoseconds
        self._states = place.node.create_publisher(JointState, f"/{side}/joint_states", 1000)
        self._marks = place.node.create_publisher(Trial, f"/{side}/trial", 10)
        place.until(lambda: self._states.get_subscription_count() and self._marks.get_subscription_count())

    def send(self, stamp: int, value: float = 0.0) -> None:
        message = JointState(name=["motor_x"], position=[value])
        message.header.stamp = to_time(stamp)
        self._states.publish(message)

    def run(self, count: int) -> None:
        """Samples in their place, 10 ms apart."""
        for _ in range(count):
            self.now += STEP
            self.send(self.now)

    def play(self, rate: float, seconds: float) -> None:
        """One trial between samples at that rate, Hz."""
        start = self.now + SECOND
        self.mark(Trial.START, start, 0, seconds)
        for _ in range(round((seconds + 2.0) * rate)):
            self.now += round(SECOND / rate)
            self.send(self.now)
        self.mark(Trial.END, start + round(seconds * SECOND), 0, seconds)

    def mark(self, phase: int, stamp: int, trial: int, seconds: float) -> None:
        message = Trial(phase=phase, sequence="any", sequence_hash="c" * 64, trial=trial, duration=seconds)
        message.header.stamp = to_time(stamp)
        self._marks.publish(message)

    def close(self) -> None:
        self._place.node.destroy_publisher(self._states)


def test_every_mishap_is_counted_and_told(place: Workplace) -> None:
    counted: list[LiveCounters] = []
    told: list[DiagnosticArray] = []
    place.node.create_subscription(LiveCounters, "/srg/counters", counted.append, 10)
    place.node.create_subscription(DiagnosticArray, "/diagnostics", told.append, 10)
    place.start("eps_tunnel_analysis", "analysis_node")
    sender = Sender(place, "real")
    sender.now -= 4 * SECOND  # older than may be when they come: all of them are late
    sender.run(60)
    sender.send(sender.now)  # twice
    sender.send(sender.now - STEP)  # out of order
    sender.now += 3 * STEP  # three lost
    sender.run(20)
    sender.now += 3600 * SECOND  # the clock jumps
    sender.run(20)

    def seen() -> LiveCounters | None:
        last = counted[-1] if counted else None
        return last if last and TOPIC in last.topics and last.received[last.topics.index(TOPIC)] >= 102 else None

    first = place.until(seen)
    at = first.topics.index(TOPIC)
    figures = [int(column[at]) for column in (first.lost, first.reordered, first.duplicated)]
    assert figures == [3, 1, 1]
    assert first.received[at] == 102
    assert first.late[at] == 82  # those after the jump come from the future
    assert (first.clock_jumps, first.restarts) == (1, 0)
    sender.close()
    again = Sender(place, "real")
    again.now = sender.now
    again.run(1)
    place.until(lambda: counted[-1].restarts == 1)

    def warned() -> bool:
        return any(
            status.name == "analysis_node: samples"
            and status.level == DiagnosticStatus.WARN
            and TOPIC in status.message
            for array in told
            for status in array.status
        )

    place.until(warned)
    assert f"stamps on {TOPIC} jumped" in (place.folder / "logs" / "analysis_node.log").read_text()


def bag(folder: Path) -> Path:
    """Three trials of the emulated rig with an unbalanced board."""
    rig = load_testbed("healthy", ["gravity_load.x=strong"])
    command = parse_sequence(yaml.safe_load(SHORTER), "two", "two").commands[0]
    run = run_offline(rig, *command.sample(100.0), 3, 1)
    return write_bag(folder / "two_real", run, "two", "c" * 64)


def test_the_tunnel_of_a_reference_bag_judges_a_simulation_alone(place: Workplace) -> None:
    told: list[Srg] = []
    place.node.create_subscription(Srg, "/srg", told.append, 100)
    place.start("eps_tunnel_analysis", "analysis_node", reference=f"['{bag(place.folder)}']", max_gap=1.0)
    sender = Sender(place, "sim")
    start = sender.now + SECOND
    sender.run(90)
    sender.mark(Trial.START, start, 0, 2.0)
    sender.run(220)
    sender.mark(Trial.END, start + 2 * SECOND, 0, 2.0)
    live = place.until(lambda: told and told[-1].samples > 190 and told[-1])
    assert live.trials == 3
    assert live.signals == ["motor_x"]
    # A simulation that stands still leaves the tunnel of a rig that moves.
    assert 0.0 < live.alikeness[0] < 0.5


def test_both_sides_are_compared_at_the_rate_of_the_rig_that_is_simulated(place: Workplace) -> None:
    told: list[Srg] = []
    place.node.create_subscription(Srg, "/srg", told.append, 100)
    place.start("eps_tunnel_analysis", "analysis_node")
    running = place.node.create_publisher(RunningModel, "/sim/model", LATCHED)
    sides = [Sender(place, side) for side in ("real", "sim")]
    place.until(running.get_subscription_count)
    running.publish(RunningModel(name="pendulum", file=str(config.find("models", "pendulum"))))
    log = place.folder / "logs" / "analysis_node.log"
    place.until(lambda: "at 200 Hz" in log.read_text())
    for side in sides:
        side.play(200.0, 1.0)
    assert place.until(lambda: told and told[-1].samples > 150 and told[-1]).samples == 201


def test_a_reference_that_is_no_bag_is_refused(place: Workplace) -> None:
    place.start("eps_tunnel_analysis", "analysis_node", reference="['nothing']")
    process = place.processes._running.pop("analysis_node")
    assert process.wait(timeout=120) == 2
    assert "no such bag" in (place.folder / "logs" / "analysis_node.log").read_text()


def test_a_diagnosis_is_made_on_request_and_told_to_whoever_comes_later(place: Workplace) -> None:
    place.start("eps_tunnel_analysis", "analysis_node")
    client = place.action(Diagnose, "/diagnose")
    stages: list[str] = []

    def asked(**given: object) -> Diagnose.Result:
        goal = Diagnose.Goal(bags=[from_home(place.folder / "two_real")], model="labyrinth_manual", **given)
        future = client.send_goal_async(goal, feedback_callback=lambda m: stages.append(m.feedback.stage))
        handle = place.result(future)
        assert handle.accepted
        return place.result(handle.get_result_async()).result

    bag(place.folder)
    wrong = asked(out=str(place.folder / "why"), candidates=["gravity"])
    assert not wrong.success
    assert "gravity_load" in wrong.message
    result = asked(out=str(place.folder / "why"), candidates=["gravity_load", "return_spring"])
    assert result.success, result.message
    assert (result.diagnosis.verdict, result.diagnosis.effects) == ("effect", ["gravity_load.x"])
    assert Path(result.file).is_file()
    assert Path(result.diagnosis.report).is_file()
    assert result.diagnosis.held_out_after < result.diagnosis.held_out_before
    assert np.isclose(sum(result.diagnosis.probabilities), 1.0)
    assert any("roll-outs" in stage for stage in stages)
    late: list[Diagnosis] = []
    place.node.create_subscription(Diagnosis, "/srg/diagnosis", late.append, LATCHED)
    place.until(lambda: late)
    assert late[0].sentence == result.message
