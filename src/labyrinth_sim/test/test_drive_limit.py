# SPDX-License-Identifier: Apache-2.0
"""What servos give near their limits: the same whenever within a step of a roll-out a command or a limit comes."""

import numpy as np
import pytest

from labyrinth_sim.build import compiled
from labyrinth_sim.command_steps import command_steps
from labyrinth_sim.drive_limit import BEGINNING, END
from labyrinth_sim.engine import Engine
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import numbers_of, simulate_batch

STEP, PART = 0.0025, 0.0003125  # s
BEGINS, SECONDS = 0.3, 0.7
FROM, TO = -0.03, 0.04  # rad


@pytest.fixture(scope="module")
def model() -> Model:
    values = {"drive.y.p": 18.0, "drive.y.d": 4.0, "drive.y.delay": 0.005, "drive.y.speed_gain": 1.9}
    return load_model("labyrinth_manual").with_values(values)


def turned(model: Model, later: float, step: float) -> np.ndarray:
    """(T,) rad every 10 ms, under a command that steps so much later than a step of the roll-out begins."""
    samples, parts = round(SECONDS / step), max(round(step / PART), 1)
    width = step / parts
    starts = np.arange(samples * parts) * width
    commands = np.zeros((1, samples * parts, 2))
    commands[0, :, 1] = FROM + (TO - FROM) * np.clip((starts + width - BEGINS - later) / width, 0.0, 1.0)
    at = {"motor_y": [FROM], "board_y": [FROM]}
    result = simulate_batch(
        model, (), np.empty((1, 0)), np.arange(samples) * step, commands, at, signals=["motor_y"], timestep=step,
        nthread=1, extrapolate=True, parts=parts,
    )  # fmt: skip
    return np.asarray(result.values[0, 0, :: round(0.01 / step), 0])


@pytest.mark.parametrize(
    ("effect", "values", "most"),
    [
        ("", {"drive.y.torque": 2.8}, 1e-4),  # only just reached
        ("", {"drive.y.torque": 0.14}, 2e-4),
        ("torque_saturation", {"torque_saturation.y.share": 0.4}, 1e-4),
        ("supply_sag", {"supply_sag.y.sag": 5.0}, 2e-4),
    ],
)
def test_a_step_of_a_command_moves_a_limited_axis_as_much_whenever_it_comes(
    model: Model, effect: str, values: dict[str, float], most: float
) -> None:
    limited = (model.with_effect(effect, "y") if effect else model).with_values(values)
    for later in np.arange(0, 8) * PART:
        off = turned(limited, later, STEP) - turned(limited, later, PART / 2.0)
        assert np.abs(off).max() < most, later
        assert np.ptp(turned(limited, later, STEP)) > 0.05


def test_a_drive_that_reaches_no_limit_moves_to_the_last_bit_as_without_them(model: Model) -> None:
    strong = model.with_values({"drive.x.torque": 2.8, "drive.y.torque": 2.8})
    plan, targets = compiled(strong, False), np.zeros((1, 100, 2))
    targets[0, 30:60, 1] = 0.05  # asks for 2 N m

    def rolled(limits: int | None) -> np.ndarray:
        engine = Engine(strong, plan, numbers_of(strong, 1), 1, STEP, nthread=1, limits=limits)
        nv, nq = plan.mj.nv, plan.mj.nq
        engine.start(np.zeros((1, nq)), np.zeros((1, nv)), np.zeros((1, 2)))
        return engine.roll(targets)

    assert np.array_equal(rolled(END), rolled(None))


def test_a_drive_that_is_off_is_not_limited(model: Model) -> None:
    weak = model.with_values({"drive.y.torque": 0.14})
    plan, targets = compiled(weak, False), np.zeros((1, 200, 2))
    targets[0, :40, 1] = np.nan
    targets[0, 50:, 1] = -0.06

    def rolled(limits: int | None) -> np.ndarray:
        engine = Engine(weak, plan, numbers_of(weak, 1), 1, STEP, nthread=1, limits=limits)
        engine.start(np.full((1, plan.mj.nq), 0.05), np.full((1, plan.mj.nv), -0.6), np.full((1, 2), np.nan))
        return engine.roll(targets)

    assert np.array_equal(rolled(END)[:, :40], rolled(None)[:, :40])
    assert not np.array_equal(rolled(END), rolled(None))


def test_stretches_of_what_is_switched_on_change_nothing(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    weak = model.with_values({"drive.y.torque": 0.14})
    plan, targets = compiled(weak, False), np.zeros((1, 160, 2))
    for k, target in ((30, 0.05), (70, -0.05), (110, 0.02)):
        targets[0, k, 1], targets[0, k + 1 :, 1] = 0.4 * target, target  # within a sample

    def rolled() -> np.ndarray:
        engine = Engine(weak, plan, numbers_of(weak, 1), 1, STEP, nthread=1, limits=END)
        engine.start(np.zeros((1, plan.mj.nq)), np.zeros((1, plan.mj.nv)), np.zeros((1, 2)))
        return engine.roll(targets)

    whole = rolled()
    monkeypatch.setattr("labyrinth_sim.engine._switched", lambda off: {20, 31, 50, 71, 90, 111})
    assert np.array_equal(rolled(), whole)


def test_a_control_steps_where_it_changes_at_once_and_not_where_it_goes_on() -> None:
    controls = np.zeros((2, 30, 1))
    controls[0, 10:] = 1.0
    controls[0, 10] = 0.3
    controls[1] = 0.2 * np.arange(30)[:, None]
    found, steps = command_steps(controls, np.array([[1.0], [1.0]]), END)
    assert steps is not None
    assert np.allclose(steps.jumps(0), [[10.0, 0.0, 0.3, 1.0, -1.0, -0.7]])
    assert not len(steps.jumps(1))
    assert found[0, 10, 0] == 1.0
    assert np.array_equal(found[1], controls[1])
    assert command_steps(controls, np.full((2, 1), 100.0), END)[1] is None
    assert command_steps(controls, np.full((2, 1), 1.0), BEGINNING)[1] is None
