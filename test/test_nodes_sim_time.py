# SPDX-License-Identifier: Apache-2.0
"""A simulation with a clock of its own: played and recorded at another pace, paused, stepped, reset."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from nodes_under_test import Workplace, workplace
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from eps_tunnel_analysis.recording.decode import read
from eps_tunnel_analysis.recording.trials import read_trials
from labyrinth_msgs.action import PlaySequence
from labyrinth_msgs.msg import RunningModel
from labyrinth_msgs.srv import LoadModel, StepSimulation

pytestmark = pytest.mark.realtime
SEQUENCE = """
description: A step.
initial_deg: {motor_x: 0, motor_y: 0}
trials: 1
command:
  motor_x: [{step: {to_deg: 1, lasts_s: 1.0}}]
  motor_y: [{hold: {lasts_s: 1.0}}]
"""
PATIENCE = {"silence_timeout": 20.0, "connect_timeout": 20.0, "rest_timeout": 60.0, "stall_timeout": 1.0}


class Simulation(Workplace):
    """A simulation, and all that it says."""

    def begin(self, **parameters: object) -> None:
        self.states: list[JointState] = []
        self.clocks: list[Clock] = []
        self.node.create_subscription(JointState, "/sim/joint_states", self.states.append, 1000)
        self.node.create_subscription(Clock, "/clock", self.clocks.append, 1000)
        self.start("labyrinth_sim", "sim_node", model="labyrinth_manual", **parameters)
        self.parameters = AsyncParameterClient(self.node, "/sim_node")

    def ask(self, kind: Any, name: str, **fields: Any) -> Any:
        return self.call(self.node.create_client(kind, name), kind.Request(**fields))

    def set(self, **values: Any) -> Any:
        """The answer to new values of the simulation's parameters."""
        self.until(self.parameters.services_are_ready)
        wanted = [Parameter(name, value=value) for name, value in values.items()]
        return self.result(self.parameters.set_parameters(wanted)).results[0]

    def get(self, name: str) -> Any:
        return self.result(self.parameters.get_parameters([name])).values[0]

    def play(self) -> PlaySequence.Result:
        sequence = self.folder / "short.yaml"
        sequence.write_text(SEQUENCE, encoding="utf-8")
        client = self.action(PlaySequence, "/play_sequence")
        goal = PlaySequence.Goal(sequence=str(sequence), record=True, folder=str(self.folder / "bags"))
        handle = self.result(client.send_goal_async(goal))
        return self.result(handle.get_result_async()).result


@pytest.fixture
def simulation(tmp_path: Path, domain: int) -> Iterator[Simulation]:
    with workplace(tmp_path, domain) as place:
        place.__class__ = Simulation
        yield place


def seconds(stamp: Any) -> float:
    return stamp.sec + 1e-9 * stamp.nanosec


def test_a_sequence_is_played_and_recorded_by_the_simulation_s_clock(simulation: Simulation) -> None:
    simulation.begin(real_time_factor=2.0, rate=50.0)
    simulation.start("eps_tunnel_analysis", "analysis_node", use_sim_time="true")
    simulation.start("eps_tunnel_analysis", "player", use_sim_time="true", sides="[sim]", rate=50.0, **PATIENCE)
    result = simulation.play()
    assert result.success, result.message
    assert [Path(bag).name for bag in result.bags] == ["short_sim"], "no bag of a side that did not play"
    recording = read(Path(result.bags[0]))
    states = recording.topics["/sim/joint_states"]
    assert states.header_stamps is not None
    for stamps in (states.header_stamps, states.log_times):
        assert 0 < stamps[0] < 3600e9, "by the simulation's clock, which begins at zero"
    assert np.median(np.diff(states.header_stamps)) == pytest.approx(0.02e9)
    trials = read_trials([Path(result.bags[0])], rate=50.0).trials
    assert trials.time[-1] == pytest.approx(1.0)
    reached = trials.values[0, -1, trials.signals.index("motor_x")]
    assert np.degrees(reached) == pytest.approx(1.0, abs=0.2)


@pytest.mark.study
def test_a_player_by_another_clock_than_the_simulation_s_refuses_to_play(simulation: Simulation) -> None:
    simulation.begin(real_time_factor=2.0)
    simulation.until(lambda: simulation.states)
    simulation.start("eps_tunnel_analysis", "player", sides="[sim]", connect_timeout=4.0)
    result = simulation.play()
    assert not result.success
    assert "use_sim_time:=true" in result.message


def test_a_paused_simulation_stands_and_goes_step_by_step(simulation: Simulation) -> None:
    simulation.begin(publish_clock="true")
    simulation.until(lambda: len(simulation.states) > 10)
    early = simulation.ask(StepSimulation, "/sim/step")
    assert not early.success
    assert "Pause it first" in early.message
    assert simulation.ask(SetBool, "/sim/pause", data=True).success

    def told() -> int:
        """Samples heard, once no more come."""
        before = -1
        while before != len(simulation.states):
            before = len(simulation.states)
            simulation.ask(Trigger, "/sim/reset")
        return before

    before, last = told(), seconds(simulation.states[-1].header.stamp)
    assert simulation.ask(StepSimulation, "/sim/step", samples=3).success
    simulation.until(lambda: len(simulation.states) >= before + 3)
    assert told() == before + 3
    assert seconds(simulation.states[-1].header.stamp) == pytest.approx(last + 0.03)
    assert seconds(simulation.clocks[-1].clock) == pytest.approx(last + 0.03)
    assert simulation.ask(SetBool, "/sim/pause", data=False).success
    simulation.until(lambda: len(simulation.states) > before + 20)
    stamps = [seconds(state.header.stamp) for state in simulation.states]
    assert np.diff(stamps) == pytest.approx(0.01), "time goes on where it stood"


def test_the_parameter_and_the_service_tell_the_same_model(simulation: Simulation) -> None:
    models: list[RunningModel] = []
    simulation.node.create_subscription(RunningModel, "/sim/model", models.append, 10)
    simulation.begin()
    assert simulation.ask(LoadModel, "/sim/load_model", model="labyrinth_es_x").success
    assert simulation.set(noise=0.001).successful
    assert simulation.get("model").string_value == "labyrinth_es_x"
    assert simulation.set(model="labyrinth_es_y").successful
    simulation.until(lambda: models and models[-1].name == "labyrinth_es_y")
    assert models[-1].loaded == 2
    refused = simulation.set(model="labyrinth_es_z")
    assert not refused.successful
    assert "'labyrinth_es_y' goes on" in refused.reason
    assert simulation.get("model").string_value == "labyrinth_es_y"
    fixed = simulation.set(seed=5)
    assert not fixed.successful
    assert "read-only" in fixed.reason
    clockless = simulation.set(real_time_factor=2.0)
    assert not clockless.successful
    assert "publish_clock" in clockless.reason
