# SPDX-License-Identifier: Apache-2.0
"""Player, analysis node and two simulations as real processes over real DDS."""

import signal
import sys
import time
from array import array
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

from action_msgs.msg import GoalStatus
from nodes_under_test import Workplace, workplace
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import JointState

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.nodes.messages import nanoseconds
from eps_tunnel_analysis.nodes.pace import TOGETHER, both_clocks
from eps_tunnel_analysis.nodes.play import TAIL
from eps_tunnel_analysis.recording.decode import read
from eps_tunnel_analysis.recording.recording import Recording
from eps_tunnel_analysis.recording.trials import read_trials
from eps_tunnel_analysis.sequence import Command
from eps_tunnel_analysis.sequence_file import load_sequence
from labyrinth_msgs.action import PlaySequence
from labyrinth_msgs.msg import Srg, TunnelSample

pytestmark = pytest.mark.realtime
ROOT = Path(__file__).parents[1]
SEQUENCE = """
description: A step on one axis, a sine on the other.
initial_deg: {motor_x: 1, motor_y: 0}
trials: 2
command:
  motor_x: [{step: {to_deg: -1, lasts_s: 1.2}}]
  motor_y: [{sine: {amplitude_deg: 2, frequency_hz: 1.25, lasts_s: 0.8}}]
"""


class Rigs(Workplace):
    """Two simulations as /real and /sim, the analysis node and the player."""

    def begin(self) -> None:
        self.srg: list[Srg] = []
        self.samples: list[TunnelSample] = []
        self.commands: dict[str, list[JointState]] = {"real": [], "sim": []}
        self.node.create_subscription(Srg, "/srg", self.srg.append, 10)
        self.node.create_subscription(TunnelSample, "/srg/tunnel", self.samples.append, 1000)
        self.sequence = self.folder / "short.yaml"
        self.sequence.write_text(SEQUENCE, encoding="utf-8")
        self.start("labyrinth_sim", "sim_node", "sim_node", model="labyrinth_manual")
        noisy = {"side": "real", "noise": 0.0005, "seed": 3}
        self.start("labyrinth_sim", "sim_node", "other_node", model="labyrinth_es_x", **noisy)
        self.start("eps_tunnel_analysis", "analysis_node")
        # Other work on this machine may hold a node up; a rig that is gone is silent for good.
        patience = {"silence_timeout": 20.0, "connect_timeout": 60.0, "rest_timeout": 60.0, "stall_timeout": 0.4}
        self.start("eps_tunnel_analysis", "player", **patience)
        self.client = self.action(PlaySequence, "/play_sequence")

    def send(self, feedback: list[PlaySequence.Feedback] | None = None, **goal: Any) -> Any:
        """Sends a goal and returns its handle."""
        told = (lambda message: feedback.append(message.feedback)) if feedback is not None else None
        return self.result(self.client.send_goal_async(PlaySequence.Goal(**goal), feedback_callback=told))

    def outcome(self, handle: Any) -> Any:
        assert handle.accepted
        return self.result(handle.get_result_async())


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Rigs]:
    with workplace(tmp_path_factory.mktemp("rigs"), module_domain) as place:
        place.__class__ = Rigs
        place.begin()
        yield place


@pytest.fixture(scope="module")
def run(rigs: Rigs) -> tuple[PlaySequence.Result, list[PlaySequence.Feedback]]:
    """One run of two trials, recorded; while it lasts a second goal is refused."""
    feedback: list[PlaySequence.Feedback] = []
    folder = str(rigs.folder / "bags")
    ears = [
        rigs.node.create_subscription(JointState, f"/{side}/joint_commands", heard.append, 1000)
        for side, heard in rigs.commands.items()
    ]
    rigs.until(lambda: all(ear.get_publisher_count() for ear in ears))
    first = rigs.send(feedback, sequence=str(rigs.sequence), record=True, folder=folder)
    second = rigs.send(sequence="paper_8s")
    assert not second.accepted
    answer = rigs.outcome(first)
    assert answer.result.success, answer.result.message
    assert answer.status == GoalStatus.STATUS_SUCCEEDED
    for ear in ears:
        rigs.node.destroy_subscription(ear)
    return answer.result, feedback


def test_one_bag_per_side_is_recorded_with_what_was_played(rigs: Rigs, run: Any) -> None:
    result, _ = run
    assert [Path(bag).name for bag in result.bags] == ["short_real", "short_sim"]
    sequence = load_sequence(rigs.sequence)
    for bag, side, model in zip(result.bags, ("real", "sim"), ("", "labyrinth_manual"), strict=True):
        recording = read(bag)
        assert recording.closed
        assert recording.metadata["sequence"] == "short"
        assert recording.metadata["sequence_hash"] == sequence.hash
        assert recording.metadata["side"] == side
        assert recording.metadata["model"] == model
        assert "version.rosbags" in recording.metadata
        assert {f"/{side}/{name}" for name in ("joint_commands", "joint_states", "trial")} <= {
            name for name, topic in recording.topics.items() if len(topic)
        }


def phases(recording: Recording) -> list[str]:
    """The marks of a recording, without those of trials that a busy machine made the player begin anew."""
    found = [mark.phase for mark in recording.marks]
    while "aborted" in found[:-1]:
        at = found.index("aborted")
        assert found[at - 1] == "start"
        del found[at - 1 : at + 1]
    return found


def whole_trials(recording: Recording) -> list[int]:
    """Stamps (ns) at which the trials began that were played to their end."""
    marks = recording.marks
    return [one.stamp for one, two in pairwise(marks) if (one.phase, two.phase) == ("start", "end")]


def check_commands(bags: list[str], command: Command) -> None:
    """Both sides got the same targets with the same stamps, on the even grid that the sequence tells."""
    real, sim = (read(bag) for bag in bags)
    _, expected = command.sample(100.0)
    assert [(m.stamp, m.phase, m.trial) for m in real.marks] == [(m.stamp, m.phase, m.trial) for m in sim.marks]
    for start in whole_trials(real):
        rows = []
        for recording, side in ((real, "real"), (sim, "sim")):
            stamps = recording.stamps(f"/{side}/joint_commands")
            inside = (stamps >= start) & (stamps < start + round(command.duration * 1e9))
            # What follows a trial goes on in its grid.
            followed = (stamps >= start) & (stamps < start + round((command.duration + TAIL) * 1e9))
            ticks = (stamps[followed] - start) / 1e7
            assert np.abs(ticks - ticks.round()).max() < 1e-6
            steps = (stamps[inside] - start) / 1e7
            assert steps[0] == 0
            # A busy machine may skip a tick, never more of them than a stall of 0.4 s.
            assert np.diff(steps).max() <= 42
            columns = recording.topics[f"/{side}/joint_commands"].columns
            played = np.column_stack([columns[f"{channel}.position"][inside] for channel in command.channels])
            assert np.array_equal(played, expected[steps.round().astype(int)])
            rows.append(played)
        assert np.array_equal(rows[0], rows[1])


def test_both_sides_get_the_same_commands_with_the_same_stamps(rigs: Rigs, run: Any) -> None:
    check_commands(run[0].bags, load_sequence(rigs.sequence).commands[0])
    assert phases(read(run[0].bags[0])) == ["start", "end", "start", "end"]


def test_the_first_command_is_in_the_bag(rigs: Rigs, run: Any) -> None:
    for bag, (side, heard) in zip(run[0].bags, rigs.commands.items(), strict=True):
        stamps = read(bag).stamps(f"/{side}/joint_commands")
        first = nanoseconds(heard[0].header.stamp)
        assert first in stamps
        assert first - stamps[0] < 0.1e9, "what was heard here began with the play"


def test_two_clocks_that_something_came_between_are_read_again() -> None:
    began = time.monotonic_ns()
    pauses = [0.05, 0.02]

    def interrupted() -> int:
        now = time.monotonic_ns()
        if pauses:
            time.sleep(pauses.pop())
        return now

    steady, other = both_clocks(interrupted)
    assert not pauses
    assert abs(steady - other * 1e-9) <= TOGETHER
    assert other > began


def test_every_trial_starts_at_rest_in_the_initial_pose(rigs: Rigs, run: Any) -> None:
    command = load_sequence(rigs.sequence).commands[0]
    for bag, side in zip(run[0].bags, ("real", "sim"), strict=True):
        recording = read(bag)
        stamps = recording.stamps(f"/{side}/joint_states")
        for mark in recording.marks:
            if mark.phase != "start":
                continue
            before = np.flatnonzero(stamps < mark.stamp)[-10:]
            for channel, target in zip(command.channels, command.initial, strict=True):
                measured = recording.topics[f"/{side}/joint_states"].columns[f"{channel}.position"][before]
                assert np.ptp(measured) < np.radians(0.4)
                assert measured.mean() == pytest.approx(target, abs=np.radians(0.5))


def test_progress_is_told_phase_by_phase(run: Any) -> None:
    feedback = run[1]
    phases = [f.phase for f in feedback]
    assert {"settling", "playing"} <= set(phases) <= {"returning", "settling", "playing", "recording"}
    shares = [f.progress for f in feedback]
    assert all(0 <= share <= 1 for share in shares)
    assert {(f.trial, f.trials) for f in feedback} == {(0, 2), (1, 2)}


def test_the_live_figures_at_the_end_are_those_of_the_bags(rigs: Rigs, run: Any) -> None:
    signals = rigs.until(lambda: rigs.srg and rigs.srg[-1].signals)
    real, sim = (read_trials([bag], signals=signals).trials for bag in run[0].bags)
    offline = compare(real, sim)
    assert real.count == 2
    whole = (real.count, len(real.time))
    live = rigs.until(lambda: rigs.srg and (rigs.srg[-1].trials, rigs.srg[-1].samples) == whole and rigs.srg[-1])
    assert live.signals == signals
    assert set(live.signals) >= {"motor_x", "motor_y", "board_x", "board_y"}
    table = np.array(live.alikeness).reshape(len(live.signals), len(live.k))
    for row, name in enumerate(live.signals):
        assert table[row].tolist() == [a.shares[name] for a in offline.alikeness]
    assert list(live.joint) == [a.joint for a in offline.alikeness]


def test_the_tunnel_is_told_sample_by_sample(rigs: Rigs, run: Any) -> None:
    # After a pause of the analysis many samples are told by their newest, so how many come is not sure.
    rigs.until(lambda: rigs.samples)
    for sample in rigs.samples[:: 1 + len(rigs.samples) // 20]:
        assert len(sample.signals) == len(sample.mean) == len(sample.alike)
        assert max(sample.lower) <= 0 <= min(sample.upper)


def test_a_cancelled_run_ends_with_aborted_marks_and_whole_bags(rigs: Rigs, run: Any) -> None:
    path = rigs.folder / "endless.yaml"
    path.write_text(SEQUENCE.replace("lasts_s: 1.2", "lasts_s: 120"), encoding="utf-8")
    feedback: list[PlaySequence.Feedback] = []
    handle = rigs.send(feedback, sequence=str(path), record=True, folder=str(rigs.folder / "cancelled"))
    rigs.until(lambda: feedback and feedback[-1].phase == "playing")
    rigs.result(handle.cancel_goal_async())
    answer = rigs.outcome(handle)
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert "cancelled" in answer.result.message
    for bag in answer.result.bags:
        recording = read(bag)
        assert recording.closed
        assert phases(recording) == ["start", "aborted"]


@pytest.mark.study
def test_a_trial_that_a_stall_of_the_player_spoiled_is_begun_anew(rigs: Rigs, run: Any) -> None:
    path = rigs.folder / "long.yaml"
    path.write_text(SEQUENCE.replace("lasts_s: 1.2", "lasts_s: 4"), encoding="utf-8")
    feedback: list[PlaySequence.Feedback] = []
    handle = rigs.send(feedback, sequence=str(path), trials=1, record=True, folder=str(rigs.folder / "stalled"))
    rigs.until(lambda: feedback and feedback[-1].phase == "playing")
    player = rigs.processes._running["player"]
    player.send_signal(signal.SIGSTOP)
    time.sleep(1.0)
    player.send_signal(signal.SIGCONT)
    result = rigs.outcome(handle).result
    assert result.success, result.message
    for bag in result.bags:
        recording = read(bag)
        assert [mark.phase for mark in recording.marks][:3] == ["start", "aborted", "start"]
        assert phases(recording) == ["start", "end"]
        assert {mark.trial for mark in recording.marks} == {0}
        trials = read_trials([bag]).trials
        assert trials.count == 1
        assert len(trials.time) == 401
    check_commands(result.bags, load_sequence(path).commands[0])


def test_each_command_of_a_sequence_goes_into_bags_of_its_own(rigs: Rigs, run: Any) -> None:
    text = (ROOT / "config" / "sequences" / "rotations_x.yaml").read_text(encoding="utf-8")
    content = yaml.safe_load(text.replace("lasts_s: 2}", "lasts_s: 0.6}"))
    content["commands"] = {name: content["commands"][name] for name in ("-2.0deg", "+5.0deg")}
    path = rigs.folder / "rotations.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    folder = rigs.folder / "rotations"
    result = rigs.outcome(rigs.send(sequence=str(path), trials=2, record=True, folder=str(folder))).result
    assert result.success, result.message
    commands = load_sequence(path).commands
    names = [f"rotations_{label}_{side}" for label in content["commands"] for side in ("real", "sim")]
    assert [Path(bag).name for bag in result.bags] == names
    for number, command in enumerate(commands):
        bags = result.bags[2 * number : 2 * number + 2]
        check_commands(bags, command)
        for bag in bags:
            recording = read(bag)
            assert recording.metadata["sequence_hash"] == command.hash
            assert phases(recording) == ["start", "end"] * 2
            assert read_trials([bag]).trials.count == 2


@pytest.mark.parametrize(
    ("goal", "told"),
    [
        ({"sequence": "paper8s"}, "Did you mean 'paper_8s'"),
        ({"sequence": ""}, "No sequence named"),
        ({"sequence": "paper_8s", "trials": 2**32 - 1}, "4294967295 trials of each command; expected at most 100000"),
        ({"sequence": "short", "too_far": True}, "moves motor_x from 0 to 30 deg; allowed are -5 to 5 deg"),
    ],
)
def test_what_cannot_be_played_is_refused_with_the_reason(
    rigs: Rigs, run: Any, goal: dict[str, Any], told: str
) -> None:
    if goal.pop("too_far", False):
        path = rigs.folder / "far.yaml"
        text = "initial_deg: {motor_x: 0}\ncommand: {motor_x: [{step: {to_deg: 30, lasts_s: 1}}]}"
        path.write_text(text, encoding="utf-8")
        goal = {"sequence": str(path)}
    answer = rigs.outcome(rigs.send(**goal))
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert told in answer.result.message


def test_a_recording_that_exists_is_not_overwritten(rigs: Rigs, run: Any) -> None:
    goal = {"sequence": str(rigs.sequence), "record": True, "folder": str(rigs.folder / "bags")}
    answer = rigs.outcome(rigs.send(**goal))
    assert not answer.result.success
    assert "not overwritten" in answer.result.message


def test_the_parameter_file_names_every_parameter_at_its_default(rigs: Rigs) -> None:
    file = ROOT / "config" / "nodes" / "eps_tunnel_analysis.yaml"
    for name in ("player", "analysis_node"):
        asked = AsyncParameterClient(rigs.node, name)
        rigs.until(asked.services_are_ready)
        declared = rigs.result(asked.list_parameters([], 0)).result.names
        own = [p for p in declared if p.split(".")[0] not in ("use_sim_time", "start_type_description_service",
                                                              "qos_overrides")]  # fmt: skip
        values = yaml.safe_load(file.read_text(encoding="utf-8"))[f"/**/{name}"]["ros__parameters"]
        assert sorted(values) == sorted(own)
        given = rigs.result(asked.get_parameters(own)).values
        told = {p: parameter_value_to_python(v) for p, v in zip(own, given, strict=True)}
        changed = {"silence_timeout", "connect_timeout", "rest_timeout", "stall_timeout"} if name == "player" else set()
        assert {p: list(v) if isinstance(v, array) else v for p, v in told.items() if p not in changed} == {
            p: v for p, v in values.items() if p not in changed
        }
        descriptors = rigs.result(asked.describe_parameters(own)).descriptors
        assert all(d.description.endswith("]") for d in descriptors)
