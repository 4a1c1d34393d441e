# SPDX-License-Identifier: Apache-2.0
"""The action /calibrate of a real node: a model is fitted to the bag of an emulated rig, or the fit is called off."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from action_msgs.msg import GoalStatus
from nodes_under_test import Workplace, from_home, workplace

from eps_tunnel_analysis.sequence_file import parse_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline
from labyrinth_msgs.action import Calibrate
from labyrinth_sim.model import load_model

SHORT = """
initial_deg: {motor_x: 0, motor_y: 0}
command:
  motor_x:
    - hold: {lasts_s: 0.1}
    - step: {to_deg: 3, lasts_s: 0.5}
    - step: {to_deg: -3, lasts_s: 0.5}
  motor_y:
    - hold: {lasts_s: 1.1}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Workplace]:
    with workplace(tmp_path_factory.mktemp("calibrate"), module_domain) as it:
        command = parse_sequence(yaml.safe_load(SHORT), "short", "short").commands[0]
        run = run_offline(load_testbed("healthy"), *command.sample(100.0), 2, 0)
        write_bag(it.folder / "bag", run, "short", command.hash)
        it.start("eps_tunnel_analysis", "calibrate_node", signals="[motor_x]")
        yield it


def sent(place: Workplace, told: list[Calibrate.Feedback], **goal: Any) -> Any:
    """The handle of a goal for the bag."""
    client = place.action(Calibrate, "/calibrate")
    asked = Calibrate.Goal(bags=[from_home(place.folder / "bag")], model="labyrinth_manual", **goal)
    return place.result(client.send_goal_async(asked, feedback_callback=lambda message: told.append(message.feedback)))


def test_a_goal_ends_with_a_model_that_fits_better(place: Workplace) -> None:
    told: list[Calibrate.Feedback] = []
    handle = sent(place, told, out=from_home(place.folder / "fitted"))
    assert handle.accepted
    answer = place.result(handle.get_result_async())
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.message
    assert answer.result.success
    assert 0 < answer.result.error_after < answer.result.error_before
    assert Path(answer.result.file).resolve() == (place.folder / "fitted.yaml").resolve()
    fitted, given = load_model(answer.result.file).values(), load_model("labyrinth_manual").values()
    assert fitted["drive.x.p"] != given["drive.x.p"]
    shares = [feedback.progress for feedback in told]
    assert shares == sorted(shares) and all(0 <= share <= 1 for share in shares)
    assert told[-1].evaluations > 1


def test_a_cancelled_fit_keeps_the_best_so_far_and_a_second_one_is_refused_meanwhile(place: Workplace) -> None:
    told: list[Calibrate.Feedback] = []
    handle = sent(place, told, out=str(place.folder / "cut"), method="es")
    assert handle.accepted
    place.until(lambda: told and told[-1].evaluations > 1)
    assert not sent(place, [], out=str(place.folder / "other")).accepted
    place.result(handle.cancel_goal_async())
    answer = place.result(handle.get_result_async())
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert not answer.result.success
    assert load_model(answer.result.file).values()
    assert not (place.folder / "other.yaml").exists()


def test_what_cannot_be_fitted_is_refused_with_the_reason(place: Workplace) -> None:
    handle = sent(place, [], out=str(place.folder / "never"), method="newton")
    answer = place.result(handle.get_result_async())
    assert answer.status == GoalStatus.STATUS_ABORTED
    assert "gauss-newton" in answer.result.message
