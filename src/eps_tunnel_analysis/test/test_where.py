# SPDX-License-Identifier: Apache-2.0
"""Where a model fails: phases of the command, and how the misfit spreads over them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from tunnel_cases import make_trials, pairs

from eps_tunnel_analysis.phases import MEANING, MOVING, NOWHERE, channel_of, phases, sentences, target_before, where

STEP = 0.01
TIME = np.arange(600) * STEP


def at(label, second):
    return label[round(second / STEP)]


def step_command():
    """0, up to 0.1 rad at 1 s, back to 0 at 3 s, NaN from 5 s on."""
    command = np.where((TIME >= 1 - 1e-9) & (TIME < 3 - 1e-9), 0.1, 0.0)
    command[500:] = np.nan
    return command


def test_phases_of_a_step_and_back():
    label = phases(TIME, step_command())
    assert [at(label.phase, s) for s in (0.5, 1.0, 1.4, 2.0, 3.2, 4.0, 5.5)] == [
        "rest", "moving", "moving", "hold", "moving", "rest", "no command",
    ]  # fmt: skip
    assert [at(label.direction, s) for s in (0.5, 1.0, 2.9, 3.0, 4.0)] == ["none", "up", "up", "down", "down"]
    assert at(label.amplitude, 0.5) == 0
    assert at(label.amplitude, 4) == pytest.approx(0.1)


def test_phases_of_a_triangle_turn_round_at_its_peaks():
    command = 0.07 * (1 - np.abs((TIME / 1.0) % 2 - 1))  # peaks at 1, 3, 5 s
    label = phases(TIME, command)
    assert at(label.phase, 0.5) == "moving"
    assert at(label.phase, 1.1) == "reversal"
    assert at(label.phase, 1.5) == "moving"
    assert at(label.direction, 0.5) == "up"
    assert at(label.direction, 1.5) == "down"
    assert at(label.amplitude, 1.5) == pytest.approx(0.07)


def test_a_quantised_slow_ramp_is_one_motion():
    tick = 0.001534
    label = phases(TIME, np.floor(TIME * 0.014 / tick) * tick)  # about 9 ticks a second
    assert set(label.phase[20:]) == {"moving"}
    assert set(label.direction[20:]) == {"up"}


def test_a_command_that_never_moves_is_rest():
    assert set(phases(TIME, np.full(600, 0.2)).phase) == {"rest"}
    assert set(phases(TIME, np.full(600, np.nan)).phase) == {"no command"}
    assert "rest" in MEANING


@pytest.mark.parametrize("back", [False, True], ids=["a single step", "a step there and back"])
def test_a_step_at_time_zero_moves_from_the_initial_pose(back):
    command = np.full(600, -0.04)
    if back:
        command[200:] = 0.04
    measured = -0.037 + 0.074 * np.exp(-TIME / 0.1)  # it rests a little off its target at either end
    before = target_before(TIME, command, measured)
    assert before == pytest.approx(0.04 if back else 0.037)
    label = phases(TIME, command, before)
    assert [at(label.phase, s) for s in (0.0, 0.4, 1.5)] == ["moving", "moving", "hold"]
    assert [at(label.direction, s) for s in (0.0, 1.5)] == ["down", "down"]
    assert at(label.amplitude, 0.0) == pytest.approx(0.08 if back else 0.077)
    if back:
        assert [at(label.phase, s) for s in (2.1, 4.0)] == ["moving", "rest"]


def test_an_offset_from_a_target_that_stands_is_no_step():
    rest = np.full(600, 0.04)
    assert np.isnan(target_before(TIME, rest, np.full(600, 0.03)))
    assert np.isnan(target_before(TIME, step_command(), np.full(600, 0.01)))
    assert np.isnan(target_before(TIME, np.full(600, np.nan), np.zeros(600)))
    later = phases(TIME, step_command(), np.nan)
    assert np.array_equal(later.phase, phases(TIME, step_command(), 0.0).phase)


def test_a_signal_finds_its_command_channel():
    channels = ("motor_x", "motor_y")
    assert channel_of("motor_x", channels) == "motor_x"
    assert channel_of("motor_y_velocity", channels) == "motor_y"
    assert channel_of("board_x", channels) == "motor_x"
    assert channel_of("board_y_velocity", channels) == "motor_y"
    assert channel_of("ball_x", channels) == "motor_y"
    assert channel_of("temperature", channels) is None
    assert channel_of("anything", ("servo",)) == "servo"


def test_an_offset_while_holding_is_found_there_and_nowhere_else():
    command = step_command()
    real = np.stack([np.zeros(600), np.zeros(600)])[:, :, None]
    sim = np.where(phases(TIME, command).phase == "hold", 0.01, 0.0)[None, :, None]
    commands = np.repeat(command[None, :, None], 2, axis=0)
    rows = where(make_trials(real, commands=commands), make_trials(sim, commands=commands[:1]))
    worst = next(m for m in rows if m.kind == "phase")
    assert worst.group == "hold"
    assert worst.error_share == pytest.approx(1)
    assert worst.mean == pytest.approx(0.01)
    assert worst.rms == pytest.approx(0.01)
    assert "hold, after moving upwards: 100% of its squared error" in sentences(rows)[0]
    assert "0.573 deg above" in sentences(rows)[0]


def test_a_trial_apart_from_the_others_is_the_worst_trial():
    values = np.zeros((3, 50, 1))
    values[1] += 1.0
    rows = [m for m in where(make_trials(values), make_trials(np.zeros((1, 50, 1)))) if m.kind == "trial"]
    assert rows[0].group == "trial 2"
    assert rows[0].error_share == pytest.approx(1)
    assert rows[0].mean == -1  # simulation minus real


@given(pairs(holes=True))
def test_shares_of_each_kind_sum_to_one_or_to_nothing(pair):
    t = pair[0].values.shape[1]
    ramp = np.linspace(0, 1, t)[None, :, None]
    real, sim = (make_trials(s.values, commands=np.repeat(ramp, s.count, axis=0)) for s in pair)
    rows = where(real, sim)
    for kind, signal in {(m.kind, m.signal) for m in rows if m.kind != "axis"}:
        group = [m for m in rows if (m.kind, m.signal) == (kind, signal)]
        assert sum(m.time_share for m in group) == pytest.approx(1)
        assert sum(m.error_share for m in group) == pytest.approx(1) or all(m.rms == 0 for m in group)
        assert [m.error_share for m in group] == sorted((m.error_share for m in group), reverse=True)


def test_a_perfect_model_fails_nowhere():
    trials = make_trials(np.ones((2, 20, 2)), commands=np.zeros((2, 20, 1)))
    assert sentences(where(trials, trials)) == ()


def noisy(errors, spreads, commands, trials=4):
    """Real trials about zero with these repeat spreads (one a signal), and a simulation off by `errors` (T, m)."""
    draw = np.random.default_rng(3).normal(size=(trials, *errors.shape))
    draw = (draw - draw.mean(axis=0)) * np.asarray(spreads)
    commands = np.repeat(commands[None], trials, axis=0)
    return make_trials(draw, commands=commands, channels=("a",)), make_trials(
        errors[None], commands=commands[:1], channels=("a",)
    )


def test_where_to_look_is_ranked_across_signals_in_units_of_the_repeat_spread():
    command = step_command()[:500]
    moving = np.isin(phases(TIME[:500], command).phase, MOVING)
    # a is off by less than b in every unit of angle, but by far more than it repeats.
    errors = np.stack([np.where(moving, 0.002, 0.0), np.where(moving, 0.02, 0.0)], axis=1)
    rows = where(*noisy(errors, (1e-5, 5e-3), command[:, None]))
    words = sentences(rows)
    assert [w.split(",")[0] for w in words[:2]] == ["a", "a"]
    assert words[0].startswith("a, moving, ")
    assert "times the rig's repeat spread" in words[0]
    axes = [m for m in rows if m.kind == "axis"]
    assert [m.signal for m in axes] == ["a", "b"]
    assert axes[0].error_share > 0.99


def test_an_error_within_the_repeat_spread_is_nowhere():
    errors = np.full((500, 2), 0.001)
    inside = where(*noisy(errors, (0.004, 0.004), step_command()[:500, None]))
    assert sentences(inside) == (NOWHERE,)
    outside = where(*noisy(errors, (0.004, 0.0001), step_command()[:500, None]))
    assert [w.split(":")[0] for w in sentences(outside)] == ["b"]


def test_an_even_offset_is_told_as_such():
    commands = np.repeat(step_command()[None, :500, None], 2, axis=0)
    rows = where(make_trials(np.zeros((2, 500, 1)), commands=commands), make_trials(np.full((1, 500, 1), -0.1)))
    assert sentences(rows) == (
        "a: the error is spread evenly over the phases of the command; the simulation is 5.73 deg below the real mean "
        "on average (RMS 5.73 deg).",
    )


def test_an_error_that_comes_with_the_other_axis_is_told_as_such():
    still, moving = np.zeros(500), step_command()[:500]
    commands = np.stack([still, moving], axis=1)[None]
    channels = ("motor_x", "motor_y")
    error = np.isin(phases(TIME[:500], moving).phase, MOVING) * 0.01
    sim = make_trials(error[None, :, None], commands=commands, channels=channels)
    real = make_trials(np.zeros((1, 500, 1)), commands=commands, channels=channels)
    rows = where(*(replace(trials, signals=("board_x",)) for trials in (real, sim)))
    worst = next(m for m in rows if m.kind == "other axes")
    assert worst.group == "another moves"
    assert worst.error_share == pytest.approx(1)
    assert worst.time_share < 0.5
