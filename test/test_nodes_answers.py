# SPDX-License-Identifier: Apache-2.0
"""A lost answer is asked for again, and an action's server is not asked before it knows who asks."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from nodes_under_test import Workplace, workplace
from rclpy.action import ActionClient, ActionServer, GoalResponse
from std_srvs.srv import Trigger

from eps_tunnel_analysis.nodes import answers
from labyrinth_msgs.action import Calibrate


@pytest.fixture
def place(tmp_path: Path, domain: int) -> Iterator[Workplace]:
    with workplace(tmp_path, domain) as it:
        yield it


def test_a_request_whose_answer_is_lost_is_sent_again(place: Workplace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answers, "ASK_AGAIN", 0.2)
    came: list[Trigger.Request] = []

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        came.append(request)
        response.success = True
        return response

    place.node.create_service(Trigger, "/ask", answer)
    client: Any = place.node.create_client(Trigger, "/ask")
    place.until(client.service_is_ready)
    asked = answers.Repeated(client, Trigger.Request())
    with pytest.raises(ValueError, match="no answer yet"):
        asked.result()
    assert not asked.done()
    client.remove_pending_request(asked._futures[0])  # as if its answer had been lost
    place.until(asked.done)
    assert asked.result().success
    assert len(came) == 2


def test_an_action_s_server_is_met_without_a_goal(place: Workplace) -> None:
    meeting = answers.Meeting(place.node, ActionClient(place.node, Calibrate, "/calibrate"), "/calibrate")
    for _ in range(3):
        place.executor.spin_once(timeout_sec=0.05)
        assert not meeting.done(), "there is no server yet"
    goals: list[Any] = []

    def goal(request: Any) -> GoalResponse:
        goals.append(request)
        return GoalResponse.REJECT

    for _ in range(2):  # the second one is another server
        server = ActionServer(place.node, Calibrate, "/calibrate", lambda _: Calibrate.Result(), goal_callback=goal)
        place.until(meeting.done)
        server.destroy()
        place.until(lambda: not meeting.done())
    assert not goals
