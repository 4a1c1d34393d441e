# SPDX-License-Identifier: Apache-2.0
"""Controllers that choose the emulated rig's commands from what is measured."""

import numpy as np
import pytest

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.hidden import TestbedConfig, TestbedFile, build
from labyrinth_hw.testbed.offline import Seen, run_controlled, run_many
from labyrinth_hw.testbed.scene import load_layout

TIME = np.arange(150) / 100.0
SINES = 0.03 * np.sin(4.0 * TIME)[:, None] * np.array([1.0, -0.5])


def rig(content: dict) -> TestbedConfig:
    return build(TestbedFile.model_validate(content), "rig")


def test_a_controller_that_ignores_what_it_sees_plays_as_commands_do() -> None:
    configs = [rig({}), rig({"quantities": {"play": 0.01}})]
    played = run_many(configs, TIME, SINES, 2, [3, 4])
    chosen = run_controlled(configs, TIME, lambda seen: np.tile(SINES[seen.sample], (4, 1)), 2, [3, 4])
    for a, b in zip(played, chosen, strict=True):
        np.testing.assert_array_equal(a.board, b.board)
        np.testing.assert_array_equal(a.stamps, b.stamps)
        assert b.commands.shape == (2, len(TIME), 2)
        np.testing.assert_array_equal(b.commands, np.broadcast_to(SINES, b.commands.shape))


def test_feedback_takes_away_what_a_load_leaves_and_each_trial_has_its_own() -> None:
    """Against a load out of balance integral action levels the board; two controllers run side by side."""
    loaded = rig({"quantities": {"gravity_moment": {"x": 0.3, "y": 0.0}}})
    total = np.zeros((4, 2))
    gain = np.repeat([0.0, 6.0], 2)[:, None]  # 1/s, of the two controllers

    def control(seen: Seen) -> np.ndarray:
        nonlocal total
        assert seen.time == pytest.approx(seen.sample / 100.0) and seen.ball is None
        total = total - 0.01 * gain * seen.board
        return total

    without, fed_back = run_controlled([loaded] * 2, TIME, control, 2, [5, 6])
    assert np.all(np.abs(without.board[:, -20:, 0].mean(axis=1)) > 0.008)
    assert np.all(np.abs(fed_back.board[:, -20:, 0].mean(axis=1)) < 0.001)
    assert not np.array_equal(fed_back.commands[0], fed_back.commands[1])


def test_balls_begin_where_they_are_put_and_are_seen() -> None:
    layout, begin = load_layout("medium"), np.array([0.057, 0.2])
    seen_at = []

    def control(seen: Seen) -> np.ndarray:
        assert seen.ball is not None
        seen_at.append(seen.ball.copy())
        return np.zeros((3, 2))

    run = run_controlled([rig({})], TIME[:20], control, 3, [1], layout, ball_start=begin)[0]
    assert run.ball is not None
    np.testing.assert_allclose(seen_at[0], np.tile(begin, (3, 1)), atol=0.003)
    np.testing.assert_array_equal(np.stack(seen_at, axis=1), run.ball)


def test_commands_of_another_shape_are_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        run_controlled([rig({})], TIME, lambda seen: np.zeros(2), 2, [1])
