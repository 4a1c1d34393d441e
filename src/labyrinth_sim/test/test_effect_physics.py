# SPDX-License-Identifier: Apache-2.0
"""Effects against figures worked out by hand, where the laws that all effects share would not notice."""

import numpy as np
import pytest

from labyrinth_sim.effects.supply_sag import NO_LOAD
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate

MODEL = load_model("labyrinth_manual")
CORRIDOR = {"ball_x": 0.18, "ball_y": 0.135}  # 90 mm of free corridor ahead, then a wall
GRAVITY = 9.81


def roll(model: Model, tilt: float) -> np.ndarray:
    """(151,) m, `ball_x` from rest on a board that is tilted already."""
    time = np.arange(151) * 0.01
    start = {**CORRIDOR, "motor_y": tilt, "board_y": tilt}
    trials = simulate(model, time, np.stack([0 * time, 0 * time + tilt], axis=1), start)
    return np.asarray(trials.values[0, :, trials.index("ball_x")])


def test_a_slack_belt_leaves_the_board_behind_by_half_the_width_either_way() -> None:
    time = np.arange(401) * 0.01
    slow = np.interp(time, [0, 1, 3, 4], [0, 0.06, -0.06, 0])
    trials = simulate(MODEL.with_effect("backlash", "x", {"width": 0.03}), time, np.stack([slow, 0 * slow], axis=1))
    behind = trials.values[0, :, trials.index("motor_x")] - trials.values[0, :, trials.index("board_x")]
    assert (behind.min(), behind.max()) == pytest.approx((-0.015, 0.015), abs=5e-4)


@pytest.mark.parametrize("moving", [1, 2])
def test_the_supply_sags_to_where_voltage_and_torque_agree(moving: int) -> None:
    """At full duty each of n motors has f - v of its torque, v being back-EMF's share, and f = 1 - s n (f - v)."""
    model = MODEL.with_values({"drive.x.torque": 0.3, "drive.y.torque": 0.3}).with_effect(
        "supply_sag", "x", {"sag": 0.8}
    )
    model = model.with_effect("supply_sag", "y", {"sag": 0.8})
    time = np.arange(31) * 0.002
    step = np.full(31, 0.12)
    start = {"motor_x": 0.0, "motor_y": 0.0}
    model = model.with_values({"drive.x.delay": 0.0, "drive.y.delay": 0.0})
    trials = simulate(model, time, np.stack([step, step * (moving - 1)], axis=1), start)
    effort = trials.values[0, 2:12, trials.index("motor_x_effort")]
    turned = np.diff(trials.values[0, 1:12, trials.index("motor_x")]) / 0.002
    expected = (1 - turned / NO_LOAD) / (1 + 0.8 * moving)
    assert effort == pytest.approx(0.3 * expected, rel=0.01)
    assert effort[-1] < 0.985 * effort[0]


def test_no_sag_leaves_back_emf_out() -> None:
    time = np.arange(61) * 0.002
    step = np.stack([np.full(61, 0.12), np.zeros(61)], axis=1)
    start = {"motor_x": 0.0, "motor_y": 0.0}
    sagging = MODEL.with_effect("supply_sag", "x", {"sag": 1e-6})
    plain, faint = (simulate(m, time, step, start).values for m in (MODEL, sagging))
    assert faint == pytest.approx(plain, abs=1e-5)


def test_a_ball_rests_below_the_tilt_that_rolling_friction_holds() -> None:
    assert np.ptp(roll(MODEL.with_effect("rolling_friction", "ball", {"coefficient": 0.03}), 0.02)) < 3e-4


def test_rolling_friction_slows_the_ball_by_five_sevenths_of_c_g() -> None:
    way = roll(MODEL.with_effect("rolling_friction", "ball", {"coefficient": 0.01}), 0.05)
    expected = 5 / 7 * GRAVITY * (np.sin(0.05) - 0.01)
    assert 2 * (way[40] - way[0]) / 0.4**2 == pytest.approx(expected, rel=0.02)


def test_a_wrong_camera_scale_stretches_the_way_and_not_the_start() -> None:
    true, seen = (roll(m, 0.05)[:40] for m in (MODEL, MODEL.with_effect("camera_scale", "ball", {"scale": 1.1})))
    assert seen[0] == pytest.approx(true[0], abs=1e-6)
    assert np.ptp(seen) == pytest.approx(1.1 * np.ptp(true), rel=0.01)


def test_effects_survive_a_drive_that_is_switched_off_and_on() -> None:
    model = MODEL
    for name in (
        "backlash",
        "dead_band",
        "rate_limit",
        "positioning_error",
        "load_friction",
        "supply_sag",
        "gain_error",
    ):
        model = model.with_effect(name, "x")
    time = np.arange(201) * 0.01
    commands = np.stack([0.05 * np.sin(3 * time), 0 * time], axis=1)
    commands[60:120] = np.nan
    seen = simulate(model, time, commands)
    assert np.isfinite(seen.values).all()
    off = seen.values[0, 65:120, seen.index("motor_x_effort")]  # the drive is 30 ms late
    assert np.abs(off).max() == 0.0
    assert np.ptp(seen.values[0, 125:, seen.index("motor_x")]) > 0.01
