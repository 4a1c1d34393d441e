# SPDX-License-Identifier: Apache-2.0
"""Two rigs on one domain, each in a namespace of its own, play and record side by side."""

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from nodes_under_test import Workplace, workplace

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.recording.decode import read
from eps_tunnel_analysis.recording.trials import read_trials
from labyrinth_msgs.action import PlaySequence

pytestmark = [pytest.mark.realtime, pytest.mark.study]
RIGS = {"rig1": "labyrinth_manual", "rig2": "labyrinth_es_x"}
SEQUENCE = """
description: A step.
initial_deg: {motor_x: 0, motor_y: 0}
trials: 1
command:
  motor_x: [{step: {to_deg: 1, lasts_s: 0.6}}]
  motor_y: [{hold: {lasts_s: 0.6}}]
"""


class TwoRigs(Workplace):
    """For each namespace a noisy simulation as real/, one as sim/, analysis and player."""

    def begin(self) -> None:
        self.sequence = self.folder / "short.yaml"
        self.sequence.write_text(SEQUENCE, encoding="utf-8")
        patience = {"silence_timeout": 20.0, "connect_timeout": 60.0, "rest_timeout": 60.0, "stall_timeout": 0.5}
        for space, model in RIGS.items():
            # The simulation's node is renamed: bags know its model all the same.
            self.put(space, "labyrinth_sim", "sim_node", "digital_twin", model=model, rate=50.0)
            noisy = {"side": "real", "noise": 0.0005, "seed": 3, "rate": 50.0}
            self.put(space, "labyrinth_sim", "sim_node", "other", model=model, **noisy)
            self.put(space, "eps_tunnel_analysis", "analysis_node", "analysis_node")
            self.put(space, "eps_tunnel_analysis", "player", "player", rate=50.0, **patience)
        self.clients = {space: self.action(PlaySequence, f"/{space}/play_sequence") for space in RIGS}

    def put(self, space: str, package: str, name: str, called: str, **parameters: object) -> None:
        given = [part for key, value in parameters.items() for part in ("-p", f"{key}:={value}")]
        names = ["-r", f"__ns:=/{space}", "-r", f"__node:={called}"]
        self.processes.start(f"{space}_{called}", [executable(package, name), "--ros-args", *names, *given])

    def play(self, space: str) -> Any:
        """A goal on its way."""
        goal = PlaySequence.Goal(sequence=str(self.sequence), record=True, folder=str(self.folder / space))
        return self.clients[space].send_goal_async(goal)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[dict[str, PlaySequence.Result]]:
    with workplace(tmp_path_factory.mktemp("rigs"), module_domain) as place:
        place.__class__ = TwoRigs
        place.begin()
        sent = {space: place.play(space) for space in RIGS}
        handles = {space: place.result(future) for space, future in sent.items()}
        assert all(handle.accepted for handle in handles.values())
        ends = {space: handle.get_result_async() for space, handle in handles.items()}
        yield {space: place.result(future).result for space, future in ends.items()}


def test_each_rig_records_its_own_topics_and_no_other(played: dict[str, PlaySequence.Result]) -> None:
    for space, result in played.items():
        assert result.success, result.message
        assert [Path(bag).name for bag in result.bags] == ["short_real", "short_sim"]
        for bag, side in zip(result.bags, ("real", "sim"), strict=True):
            recording = read(Path(bag))
            topics = [*recording.topics, *recording.others]
            assert f"/{space}/{side}/joint_states" in topics
            assert all(topic.startswith(f"/{space}/{side}/") for topic in topics)


def test_bags_name_the_model_whatever_the_simulation_s_node_is_called(played: dict[str, PlaySequence.Result]) -> None:
    told = {space: read(Path(result.bags[1])).metadata["model"] for space, result in played.items()}
    assert told == RIGS


def test_bags_of_a_rig_in_a_namespace_are_trials_as_any(played: dict[str, PlaySequence.Result]) -> None:
    real, sim = (read_trials([Path(bag)], rate=50.0).trials for bag in played["rig1"].bags)
    assert set(real.signals) >= {"motor_x", "motor_y"}
    compared = compare(real, sim, signals=["motor_x", "motor_y"])
    assert max(error.rms for error in compared.errors) < math.radians(0.5), "the same model on both sides"
