# SPDX-License-Identifier: Apache-2.0
"""CyberRunner as built, over live ports and ROS: servos on a bus, a camera, hw_node, player, recorder, diagnosis."""

import json
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

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.processes import Processes
from labyrinth_msgs.action import PlaySequence
from labyrinth_msgs.msg import BallState

pytestmark = pytest.mark.realtime
SEQUENCE = """
description: A board that is out of balance shows on axis y.
ratio: {motor_x: 0.073, motor_y: 0.115}
initial_deg: {motor_x: 0, motor_y: 0}
trials: 2
command:
  motor_x:
    - hold: {lasts_s: 4.0}
  motor_y:
    - hold: {lasts_s: 0.2}
    - step: {to_deg: 2.5, lasts_s: 0.6}
    - ramp: {to_deg: 0, lasts_s: 0.4}
    - sine: {amplitude_deg: 2.5, frequency_hz: 1.0, lasts_s: 2.0}
    - hold: {lasts_s: 0.8}
"""


@pytest.fixture
def place(tmp_path: Path, domain: int) -> Iterator[Workplace]:
    (tmp_path / "board_y.yaml").write_text(SEQUENCE)
    ports = tmp_path / "ports"
    ports.mkdir()
    with workplace(tmp_path / "nodes", domain) as place:
        place.environment["XDG_RUNTIME_DIR"] = str(ports)
        place.processes = Processes(place.folder / "logs", place.environment)
        hidden = ["--config", "cyberrunner", "--seed", "1", "--effect", "gravity_load.y=medium"]
        testbed = [*hidden, "--video", "--video-rate", "10"]  # 30 would take most of a processor core
        place.processes.start("testbed", [executable("labyrinth_hw", "testbed"), *testbed])
        place.until(lambda: len(list(ports.rglob("*"))) >= 3)
        place.start("labyrinth_hw", "hw_node", config="cyberrunner", arm="true", disarm_after=0.0, rate=200.0)
        place.start("eps_tunnel_analysis", "analysis_node")
        patience = {"connect_timeout": 60.0, "silence_timeout": 5.0, "stall_timeout": 0.4, "rest_timeout": 60.0}
        place.start("eps_tunnel_analysis", "player", sides="[real]", limit_deg=90.0, **patience)
        yield place


@pytest.mark.study
def test_the_whole_loop_from_the_bus_to_the_named_effect(place: Workplace, tmp_path: Path) -> None:
    tilts: list[JointState] = []
    balls: list[BallState] = []
    place.node.create_subscription(JointState, "/real/board_states", tilts.append, 100)
    place.node.create_subscription(BallState, "/real/ball", balls.append, 100)
    client = place.action(PlaySequence, "/play_sequence")
    place.until(lambda: len(tilts) > 20)  # the camera sees the board
    place.until(lambda: any(ball.visible for ball in balls))  # and the blue marble on it
    goal = PlaySequence.Goal(
        sequence=str(tmp_path / "board_y.yaml"), trials=2, record=True, folder=str(tmp_path / "play")
    )
    handle = place.result(client.send_goal_async(goal))
    assert handle.accepted
    played = place.result(handle.get_result_async()).result
    assert played.success, played.message
    place.processes.stop()  # servos and camera would take half of the machine from the diagnosis
    bags = sorted((tmp_path / "play").iterdir())
    (play,) = load_recorded("cyberrunner", bags, efforts=True).plays
    board = play.trials.values[:, :, play.trials.index("board_y")]
    assert np.degrees(np.nanmax(board)) > 1.5  # of the board, not of the knob
    assert main(["diagnose", "--real", *map(str, bags), "--model", "cyberrunner", "--out", str(tmp_path / "why"),
                 "--candidates", "gravity_load", "--threads", "1"]) in (0, None)  # fmt: skip
    told = json.loads((tmp_path / "why" / "diagnosis.json").read_text())
    assert "gravity_load.y" in told["effects"], told["sentence"]
