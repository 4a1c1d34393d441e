# SPDX-License-Identifier: Apache-2.0
"""Effects on the ball, from an emulated rig with a ball to their names; its ball shares no line with MuJoCo's."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.ball import part_name, sees_ball, without_ball
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command, Hold, Step
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import Run, run_offline
from labyrinth_hw.testbed.scene import load_layout
from labyrinth_sim.model import Model, load_model, save_model
from labyrinth_sim.trials import Trials

SIGNALS = ("motor_y", "board_y", "motor_y_effort", "ball_x", "ball_y")
UNITS = ("rad", "rad", "N m", "m", "m")
POCKET = (0.2545, 0.03)  # m, lower right on the medium layout; 15 mm from the walls on both sides
ON_BALL = ("board_not_level", "camera_latency", "camera_scale")


LONG = find_sequence("ball_3s").commands[0]
# To one wall and back, without the rest at either: enough for one strong effect.
_TILTS = (Hold(0.15), Step(0.6, np.radians(2.0)), Step(0.75, np.radians(-2.0)), Step(0.2, 0.0))
SHORT = Command("ball", LONG.channels, (0.0, 0.0), ((Hold(1.7),), _TILTS))


def recorded(*effects: str, seed: int, command: Command = LONG) -> Run:
    layout = replace(load_layout("medium"), path=(POCKET,))
    return run_offline(load_testbed("healthy", effects), *command.sample(100.0), 5, seed, layout)


def as_play(run: Run, command: Command = LONG) -> Play:
    time, targets = command.sample(100.0)
    assert run.ball is not None
    raw = [part[:, :, 1] for part in (run.motor, run.board, run.effort)] + [run.ball[:, :, 0], run.ball[:, :, 1]]
    values = np.stack([[np.interp(time, run.stamps[i], part[i]) for part in raw] for i in range(5)])
    trials = Trials(time, SIGNALS, UNITS, values.swapaxes(1, 2), ("motor_x", "motor_y"), np.tile(targets, (5, 1, 1)))
    return Play("ball", trials)


def model() -> Model:
    """Its ball rolls and bounces as the healthy rig's."""
    bouncing = load_model("labyrinth_manual").with_effect("restitution", "ball", {"coefficient": 0.5})
    return bouncing.with_effect("rolling_friction", "ball", {"coefficient": 0.002})


def diagnosed(effect: str, only: Sequence[str], seed: int) -> Diagnosis:
    play = as_play(recorded(effect, seed=seed, command=SHORT), SHORT)
    return diagnose(model(), [play], only=only, experiments=False)


@pytest.mark.study
@pytest.mark.parametrize(
    ("start", "only"), [(model(), ON_BALL[:2]), (load_model("labyrinth_manual"), ON_BALL[:1])], ids=["told", "plain"]
)
def test_a_healthy_ball_is_given_no_name(start: Model, only: Sequence[str]) -> None:
    v = diagnose(start, [as_play(recorded(seed=51))], only=only).verdict
    assert (v.verdict, v.effects) == ("complete", ())
    assert set(v.floor) == {"y", "ball"}


@pytest.mark.parametrize(
    ("hidden", "only", "name", "value"),
    [
        pytest.param("camera_scale.both=strong", ("camera_scale",), "camera_scale.ball", 1.1, marks=pytest.mark.study),
        pytest.param("board_not_level.x=strong", ON_BALL[:2], "board_not_level.x", 0.02, marks=pytest.mark.study),
    ],
)
def test_what_is_wrong_with_ball_or_camera_is_named(hidden: str, only: Sequence[str], name: str, value: float) -> None:
    v = diagnosed(hidden, only, seed=52).verdict
    assert (v.verdict, v.effects) == ("effect", (name,))
    assert next(v.values[n] for n in v.values if n.startswith(name)) == pytest.approx(value, rel=0.15)
    assert v.ball[2].held_out < 0.5 * v.ball[1].held_out


@pytest.mark.study
def test_without_effects_on_the_ball_to_consider_the_ball_changes_nothing() -> None:
    play = as_play(recorded(seed=53))
    one, other = (
        diagnose(model(), [p], only=[]).verdict.to_json() | {"seconds": 0.0} for p in (play, without_ball(play))
    )
    assert {**one, "notes": None} == {**other, "notes": None}


@pytest.mark.study
def test_a_ball_that_was_not_seen_at_first_is_told() -> None:
    play = as_play(recorded(seed=53))
    values = play.trials.values.copy()
    values[:, :5, 3:] = np.nan
    late = replace(play, trials=replace(play.trials, values=values))
    assert not sees_ball(model(), [late])
    v = diagnose(model(), [late], only=["camera_latency"]).verdict
    assert "ball" not in v.floor
    assert any("ball was not visible" in note for note in v.notes)


@pytest.mark.study
def test_the_commands_name_and_add_an_effect_on_the_ball(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", recorded("camera_latency", seed=54, command=SHORT), SHORT.name, SHORT.hash)
    reading = ["--real", str(bag), "--model", str(save_model(model(), tmp_path / "m.yaml"))]
    few = ["--candidates", "camera_latency"]
    assert main(["diagnose", *reading, *few, "--out", str(tmp_path / "why")]) == 0
    content = json.loads((tmp_path / "why" / "diagnosis.json").read_text())
    assert content["effects"] == ["camera_latency.ball"]
    assert "ball_after" in content
    page = (tmp_path / "why" / "report.html").read_text()
    assert "camera latency on the ball" in page and part_name("ball").capitalize() in page
    assert "add-effect camera_latency.ball" in page
    assert main(["add-effect", "camera_latency.ball", *reading, "--out", str(tmp_path / "m2.yaml")]) == 0
    added = load_model(tmp_path / "m2.yaml")
    assert added.values()["camera_latency.ball.delay"] == pytest.approx(0.12, rel=0.15)
    assert added.provenance["held_out_after"] < 0.5 * added.provenance["held_out_before"]
