# SPDX-License-Identifier: Apache-2.0
"""Batches that are stepped from outside move as roll-outs do, and answer to what is measured."""

import numpy as np
import pytest

from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.stepping import BatchStepper

TIME = np.arange(80) / 100.0
COMMANDS = 0.04 * np.sin(np.array([3.0, 5.0])[:, None, None] * TIME[:, None]) * np.array([1.0, 0.5])  # (2, T, 2)
RICH = (
    load_model("labyrinth_manual").with_effect("backlash", "x").with_effect("coulomb_friction", "x")
    .with_effect("sensor_lag", "board_x").with_effect("command_delay", "y")
)  # fmt: skip


@pytest.mark.parametrize("ball", [False, True])
def test_stepped_is_as_rolled_out(ball: bool) -> None:
    signals = ("motor_x", "motor_y", "board_x", "board_y", *(("ball_x", "ball_y") if ball else ()))
    expected = simulate_batch(RICH, (), np.empty((1, 0)), TIME, COMMANDS, {}, signals=signals, with_ball=ball).values[0]
    stepper = BatchStepper(RICH, 2, with_ball=ball)
    columns, seen = stepper.index(*signals), []
    for k in range(len(TIME)):
        seen.append(stepper.seen[:, columns])
        stepper.advance(COMMANDS[:, k])
    np.testing.assert_allclose(np.stack(seen, axis=1), expected, atol=1e-9)
    assert not stepper.failed.any()


def test_each_simulation_begins_where_it_is_put_and_obeys_its_own_controller() -> None:
    goal = np.array([0.0, 0.03])
    stepper = BatchStepper(load_model("labyrinth_manual"), 2, with_ball=True, initial={"ball_y": [0.18, 0.2]})
    np.testing.assert_allclose(stepper.seen[:, stepper.index("ball_y")[0]], [0.18, 0.2], atol=1e-6)
    total, column = np.zeros(2), stepper.index("board_x")[0]
    for _ in range(150):
        total += 0.01 * 5.0 * (goal - stepper.seen[:, column])
        stepper.advance(np.column_stack([total, np.zeros(2)]))
    np.testing.assert_allclose(stepper.seen[:, column], goal, atol=5e-4)
    assert stepper.ball().shape == (2, 3)


def test_at_least_one_simulation() -> None:
    with pytest.raises(InputError, match="at least 1"):
        BatchStepper(load_model("labyrinth_manual"), 0)
