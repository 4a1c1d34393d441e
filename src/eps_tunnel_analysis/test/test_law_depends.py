# SPDX-License-Identifier: Apache-2.0
"""What a missing force depends on, on motions and forces that are known: no roll-outs."""

import math

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.added_force import Motion
from eps_tunnel_analysis.law.depends import Depends, better, by_chance, depends, traced
from eps_tunnel_analysis.law.design import Design, Explained
from eps_tunnel_analysis.law.missing_force import MissingForce, PlayAnswer
from labyrinth_sim.trials import Array

SECONDS, STEP, NOISE = 6.0, 0.02, 0.3
TIME = np.arange(0.0, SECONDS, STEP)


def motion(angle: Array, command: Array) -> Motion:
    speed = np.gradient(angle, STEP)
    direction = np.sign(speed)
    turns = np.flatnonzero(np.diff(direction, prepend=0.0))
    since = TIME - TIME[turns[np.searchsorted(turns, np.arange(len(TIME)), side="right") - 1]]
    load = 0.2 + 0.1 * np.abs(np.sin(1.3 * TIME))
    none = np.empty(0)
    return Motion(TIME, angle, speed, direction, since, load, 0.0 * TIME, command, none, none)


def said(angle: Array, force: Array, seed: int = 0, command: Array | None = None) -> Depends:
    """Of residuals that a force leaves which the motor's own inertia smooths, and noise."""
    moved = motion(angle, angle if command is None else command)
    lag = np.exp(-np.maximum(TIME[:, None] - TIME[None, :], 0.0) / 0.05) * (TIME[:, None] >= TIME[None, :])
    answer = 5.0 * lag
    residuals = answer @ force + NOISE * np.random.default_rng(seed).normal(size=len(TIME))
    fold = np.minimum((TIME / 0.75).astype(np.int64), 7)
    ones = np.ones_like(TIME)
    play = PlayAnswer(
        moved, TIME, residuals, answer, np.column_stack([answer @ moved.speed]), TIME, np.zeros(len(TIME), np.int64),
        fold, ones, 0 * ones, ones,
    )  # fmt: skip
    missing = MissingForce("a", ("a",), "N m", (play,), 1.0, (float(np.mean(residuals**2)), NOISE**2))
    return depends(Design.of(missing), ("a",), ratios={"joint": 1.0, "motor": 12.0})


SWINGS = 0.8 * np.sin(2 * np.pi * 0.4 * TIME) + 0.4 * np.sin(2 * np.pi * 1.1 * TIME + 0.3)


@pytest.mark.parametrize("form", ["drag", "waves", "friction", "nothing"])
def test_the_variable_is_named_and_noise_names_none(form: str) -> None:
    speed = np.gradient(SWINGS, STEP)
    period = 2 * math.pi / 24  # of the joint: two waves a turn of the motor
    force = {
        "drag": -0.1 * speed * np.abs(speed),
        "waves": np.sin(2 * np.pi * SWINGS / period),
        "friction": -0.5 * np.sign(speed),
        "nothing": 0.0 * TIME,
    }[form]
    found = said(SWINGS, force)
    if form == "nothing":
        assert found.first is None and found.words == ""
        return
    assert found.first is not None
    assert found.first.curve == {"drag": "curve_speed", "waves": "curve_angle", "friction": "curve_speed"}[form]
    if form == "waves":
        assert found.first.period == pytest.approx(period, rel=0.03)
        assert found.first.traced == "2 waves a turn of the motor"


def test_a_constant_is_named_and_a_curve_over_the_angle_still_is() -> None:
    constant = said(SWINGS, np.full(len(TIME), 0.5))
    assert constant.first is not None and constant.first.constant and constant.words == "constant force"
    bent = said(SWINGS, 0.5 + 1.5 * SWINGS**2)
    assert bent.first is not None and not bent.first.constant and bent.first.curve == "curve_angle"


def test_a_constant_error_is_traced_to_its_sensor() -> None:
    moved = motion(SWINGS, SWINGS)
    rng = np.random.default_rng(3)
    signal = np.repeat([0, 1], len(TIME))
    residuals = NOISE * rng.normal(size=2 * len(TIME)) + 2.0 * signal
    lag = np.exp(-np.maximum(TIME[:, None] - TIME[None, :], 0.0) / 0.05) * (TIME[:, None] >= TIME[None, :])
    twice, ones = np.concatenate([TIME, TIME]), np.ones(2 * len(TIME))
    fold = np.minimum((twice / 0.75).astype(np.int64), 7)
    play = PlayAnswer(
        moved, TIME, residuals, np.vstack([5.0 * lag, 5.0 * lag]), np.empty((len(ones), 0)), twice, signal, fold,
        ones, 0 * ones, ones,
    )  # fmt: skip
    missing = MissingForce("a", ("a", "b"), "N m", (play,), 1.0, (float(np.mean(residuals**2)), NOISE**2))
    found = depends(Design.of(missing), ("a", "b"))
    assert found.first is not None and found.first.constant and found.first.place == "b"
    assert found.first.share > 0.9


def test_a_product_of_two_variables_is_named_as_a_pair() -> None:
    speed = np.gradient(SWINGS, STEP)
    found = said(SWINGS, np.cos(3.0 * SWINGS) * speed)
    assert found.first is not None and found.first.pair
    assert {"angle", "speed"} <= set(found.first.variable.replace(",", " ").split())
    assert found.first.share > max(d.share for d in found.dependences if not d.pair) + 0.1
    drag = said(SWINGS, -0.1 * speed * np.abs(speed))
    assert drag.first is not None and not drag.first.pair and drag.words == "speed"


def test_a_way_that_explains_much_by_chance_hides_no_other() -> None:
    rng = np.random.default_rng(0)

    def moved(draws: int) -> Array:
        """Shares by chance of ten ways, the first of which explains much of any slow misfit."""
        return np.column_stack([rng.normal(0.6, 0.05, draws), rng.normal(0.02, 0.03, (draws, 9))])

    levels = np.array([by_chance(moved(39)) for _ in range(200)])
    assert np.all(levels[:, 0] > 0.6) and np.all(levels[:, 1:] < 0.4), "each has a level of its own"
    exceeded = np.mean([np.mean(np.any(moved(50) > level, axis=1)) for level in levels])
    assert 0.03 < exceeded < 0.07, "by chance any of them exceeds its own in one of twenty"


def test_of_two_misfits_each_is_counted_in_its_own_size() -> None:
    def explained(misfit: float, share: float) -> Explained:
        """Of ten stretches alike, as of forces and of a sensor's errors, whose misfits differ."""
        return Explained(share, np.tile([misfit, misfit * (1.0 - share)], (10, 1)), np.empty(0), 1.0)

    assert better(explained(100.0, 0.5), explained(1.0, 0.1), seed=0)
    assert not better(explained(1.0, 0.1), explained(100.0, 0.5), seed=0)
    assert not better(explained(100.0, 0.5), explained(1.0, 0.5), seed=0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_names_no_pair_either(seed: int) -> None:
    found = said(SWINGS, 0.0 * TIME, seed)
    assert found.first is None and any(d.pair for d in found.dependences)


def test_the_direction_and_the_command_are_variables_of_their_own() -> None:
    speed = np.gradient(SWINGS, STEP)
    found = said(SWINGS, -0.5 * np.sign(speed))
    assert found.first is not None and (found.first.variable, found.first.curve) == ("direction", "curve_speed")
    # A joint that trails its command: what depends on the command is no function of the angle.
    ahead = np.interp(TIME + 0.3, TIME, SWINGS)
    found = said(SWINGS, np.tanh(4.0 * ahead), command=ahead)
    assert found.first is not None and (found.first.variable, found.first.curve) == ("command", "curve_angle")
    off = said(SWINGS, -0.1 * speed * np.abs(speed), command=np.full_like(SWINGS, np.nan))
    assert "command" not in [d.variable for d in off.dependences]


def test_variables_that_the_motion_ties_together_are_said_together() -> None:
    """One slow way up: the angle grows as the time does."""
    found = said(0.3 * TIME + 1e-3 * np.sin(TIME), 0.4 * np.sin(0.6 * TIME))
    assert found.first is not None and found.first.curve == "curve_angle"
    assert "curve_time" in [d.curve for d in found.ties]
    assert found.words.startswith("angle or ") and "time" in found.words


def test_a_period_is_traced_to_what_turns_with_it() -> None:
    turns = {"joint": 1.0, "motor": 12.0, "belt wheel": 2.5}
    assert traced(2 * math.pi / 12, turns) == "1 wave a turn of the motor"
    assert traced(2 * math.pi / 2.5, turns) == "1 wave a turn of the belt wheel"
    assert traced(2 * math.pi / 7, turns) == "7 waves a turn of the joint"
    assert traced(2 * math.pi / 7.4, {"joint": 1.0}) == ""
