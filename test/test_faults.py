# SPDX-License-Identifier: Apache-2.0
"""Faults while a recording runs: motion stops where it must, and what was recorded until then is readable."""

import resource
import signal
import sys
from collections.abc import Iterator
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
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.recording.decode import read
from eps_tunnel_analysis.recording.recording import Recording
from labyrinth_msgs.srv import Record
from labyrinth_sim.errors import InputError

pytestmark = pytest.mark.realtime
ROOT = Path(__file__).parents[1]
STATES, COMMANDS = "/real/joint_states", "/real/joint_commands"
SECOND = 1_000_000_000  # ns
SLOW = 0.05  # rad/s, so that the goal is far when the fault comes
SEQUENCE = """
description: One step that a slow servo follows for two seconds.
initial_deg: {motor_x: 0, motor_y: 0}
trials: 1
command:
  motor_x: [{step: {to_deg: 5, lasts_s: 8}}]
  motor_y: [{hold: {lasts_s: 8}}]
"""


class Bench(Workplace):
    """The emulated testbed with slow servos, its node, and the analysis node that records."""

    def begin(self) -> None:
        rig = yaml.safe_load((ROOT / "config" / "testbed" / "healthy.yaml").read_text())
        (self.folder / "slow.yaml").write_text(yaml.safe_dump({**rig, "quantities": {"command_rate": SLOW}}))
        self.states: list[JointState] = []
        self.told: dict[str, str] = {}
        self.goal: tuple[float, float] | None = None
        self.node.create_subscription(JointState, STATES, self.states.append, 1000)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 50)
        self.publisher: Any = None
        self.node.create_timer(0.02, self._command)
        self.record = self.node.create_client(Record, "/record")
        testbed = executable("labyrinth_hw", "testbed")
        self.processes.start("testbed", [testbed, "--config", self.folder / "slow.yaml", "--seed", "1"])
        self.start("labyrinth_hw", "hw_node", config="healthy", connect_timeout=60.0, arm="true")
        self.start("eps_tunnel_analysis", "analysis_node")
        self.more_states()

    def _note(self, message: DiagnosticArray) -> None:
        self.told |= {status.name: status.message for status in message.status}

    def _command(self) -> None:
        if self.goal is not None:
            if self.publisher is None:  # only then, for the rig obeys one publisher
                self.publisher = self.node.create_publisher(JointState, COMMANDS, 50)
            message = JointState(name=["motor_x", "motor_y"], position=list(self.goal))
            message.header.stamp = self.node.get_clock().now().to_msg()
            self.publisher.publish(message)

    def more_states(self, count: int = 100) -> None:
        goal = len(self.states) + count
        self.until(lambda: len(self.states) >= goal)

    def recording(self, label: str) -> Path:
        """Starts one; returns the bag of /real."""
        folder = str(self.folder / "bags")
        answer = self.call(self.record, Record.Request(start=True, folder=folder, label=label, sides=["real"]))
        assert answer.success, answer.message
        return next(Path(bag) for bag in answer.bags if bag.endswith("_real"))

    def stop(self) -> Record.Response:
        return self.call(self.record, Record.Request(start=False))

    def now(self) -> int:
        """ns of the clock that stamps."""
        return int(self.node.get_clock().now().nanoseconds)

    def size(self, bag: Path) -> int:
        """Bytes written so far."""
        return sum(file.stat().st_size for file in bag.iterdir())

    def kill(self, name: str) -> None:
        process = self.processes._running.pop(name)
        process.send_signal(signal.SIGKILL)
        process.wait()

    def motor(self) -> float:
        return float(self.states[-1].position[0])


@pytest.fixture
def bench(tmp_path: Path, domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("LABYRINTH_TESTBED_DIR", str(tmp_path / "links"))
    with workplace(tmp_path / "work", domain) as place:
        place.__class__ = Bench
        place.begin()
        yield place


def stamps_heard(bench: Bench) -> np.ndarray:
    return np.array([s.header.stamp.sec * 10**9 + s.header.stamp.nanosec for s in bench.states])


def written_until(bag: Path) -> int:
    """The last stamp of a joint state that a reader finds in a bag still being written, ns; 0 before the first."""
    try:
        found = read(bag)
    except InputError:
        return 0
    return int(found.stamps(STATES)[-1]) if STATES in found.topics else 0


def first_kept(bench: Bench, found: Recording, begin: int) -> bool:
    """Whether the first joint state heard here with a stamp from `begin` on, ns, is in the bag."""
    heard = stamps_heard(bench)
    return bool(heard[heard >= begin][0] in found.stamps(STATES))


def share_kept(bench: Bench, found: Recording, begin: int, end: int) -> float:
    """Of the joint states heard here with stamps from `begin` to `end`, ns, how many are in the bag."""
    heard = stamps_heard(bench)
    asked = heard[(heard >= begin) & (heard < end)]
    assert len(asked) >= 30
    return float(np.isin(asked, found.stamps(STATES)).mean())


@pytest.mark.study
def test_a_full_disk_ends_the_recording_with_a_word_and_leaves_what_was_written(bench: Bench) -> None:
    bag = bench.recording("full")
    begin = bench.now()
    process = bench.processes._running["analysis_node"]
    bench.more_states(150)
    before = bench.now()
    bench.until(lambda: written_until(bag) > before)
    written, room = read(bag).stamps(STATES), bench.size(bag)
    # No file of this process may grow further: what a full disk is to it.
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (room + 4096, room + 4096))
    bench.until(lambda: "recording stopped" in bench.told.get("analysis_node: recording", ""))
    assert process.poll() is None, "the node goes on"
    answer = bench.stop()
    assert not answer.success
    assert "What was written before can be read" in answer.message
    found = read(bag)
    assert not found.closed
    assert np.isin(written, found.stamps(STATES)).all()
    assert first_kept(bench, found, begin)
    # DDS keeps 50 messages for a listener that is not served.
    assert share_kept(bench, found, begin, before) > 0.9
    bench.goal = (0.02, 0.0)
    bench.until(lambda: abs(bench.motor() - 0.02) < 0.004)


def test_a_killed_player_ends_motion_and_the_bag_shows_it(bench: Bench) -> None:
    sequence = bench.folder / "step.yaml"
    sequence.write_text(SEQUENCE, encoding="utf-8")
    bag = bench.recording("player")
    patience = {"silence_timeout": 20.0, "connect_timeout": 60.0, "rest_timeout": 60.0}
    bench.start("eps_tunnel_analysis", "player", sequence=sequence, sides="[real]", **patience)
    bench.until(lambda: 0.02 < bench.motor() < 0.04)
    bench.kill("player")
    bench.until(lambda: bench.told.get("hw_node: servos", "").startswith("no fresh command, holding still"))
    bench.more_states(100)
    assert bench.stop().success
    found = read(bag)
    assert found.closed
    last = found.stamps(COMMANDS)[-1]
    time, angle = 1e-9 * (found.stamps(STATES) - last), found.topics[STATES].columns["motor_x.position"]
    # 200 ms to notice; then 30 of the node's own periods, which are longer on a busy machine, for the servo to stop in.
    after = angle[time > 0.2][30:]
    assert len(after) > 30
    assert np.ptp(after) < 0.005, "encoder ticks and noise only"
    assert after.mean() < np.radians(5) - 0.02, "the goal was not reached"


def test_a_killed_hardware_node_leaves_a_gap_and_its_successor_goes_on(bench: Bench) -> None:
    bag = bench.recording("node")
    begin = bench.now()
    bench.goal = (0.02, 0.0)
    bench.until(lambda: abs(bench.motor() - 0.02) < 0.004)
    bench.more_states(250)
    killed = bench.now()
    bench.kill("hw_node")
    bench.start("labyrinth_hw", "hw_node", "hw_node_2", config="healthy", arm="true")
    bench.goal = (-0.02, 0.0)
    bench.until(lambda: abs(bench.motor() + 0.02) < 0.004)
    there = bench.now()
    bench.more_states(50)
    end = bench.now()
    bench.more_states(50)
    assert bench.stop().success
    found = read(bag)
    assert found.closed
    assert first_kept(bench, found, begin)
    # What a killed node had not delivered is lost with it; and DDS keeps 50 messages for a listener that is not served.
    assert share_kept(bench, found, begin, killed - SECOND) > 0.9
    assert share_kept(bench, found, there, end) > 0.9
    assert (np.diff(found.stamps(STATES)) > 0).all()
    assert np.isfinite(found.topics[STATES].columns["board_x.position"]).all()
