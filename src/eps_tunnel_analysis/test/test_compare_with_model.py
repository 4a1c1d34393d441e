# SPDX-License-Identifier: Apache-2.0
"""A model played with recorded commands and compared with the recording it should explain."""

import json
from dataclasses import replace

import numpy as np
import pytest
from bag_files import START, STEP, Header, JointState, Time, write_bag
from command_line import eps_tunnel
from fit_cases import on_grid

from eps_tunnel_analysis.calibration.calibrate import judge
from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.fit.problem import CommandError, Objective
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import axes_at_rest, roll_out, same_commands
from eps_tunnel_analysis.stamped import Series, StampedTrial
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.trials import Trials

TIME = np.arange(150) * 0.01
SIGNALS = ("motor_x", "motor_y", "board_x", "board_y")


@pytest.fixture(scope="module")
def model():
    return load_model("labyrinth_manual")


def commands(late=0):
    """(T, u) rad: one axis after the other, `late` samples late."""
    x = np.where((np.arange(150) >= 20 + late) & (np.arange(150) < 70 + late), 0.04, -0.02)
    y = np.where(np.arange(150) >= 90 + late, -0.03, 0.01)
    return np.column_stack([x, y])


def measured(model, *plays, noise=0.0):
    """Trials as the model itself would give them, from the commands of each trial."""
    start = {"motor_x": -0.02, "board_x": -0.02, "motor_y": 0.01, "board_y": 0.01}
    runs = [on_grid(model, play, start).select(SIGNALS) for play in plays]
    values = np.concatenate([run.values for run in runs])
    values = values + noise * np.random.default_rng(3).normal(size=values.shape)
    return replace(runs[0], values=values, commands=np.stack(plays))


def test_a_model_explains_its_own_data(model):
    real = measured(model, commands(), commands(), commands())
    assert all(e.worst < 1e-12 for e in compare(real, roll_out(model, Play("", real))).errors)


def test_another_model_does_not(model):
    real = measured(model, commands(), commands(), noise=1e-5)
    comparison = compare(real, roll_out(load_model("labyrinth"), Play("", real)))
    assert comparison.alikeness[-1].joint < 0.9
    assert all(e.rms > 10 * e.repeat_rms for e in comparison.errors)


def test_jitter_is_one_command_and_other_sequences_are_several(model):
    same, late, other = commands(), commands(late=1), commands(late=30)
    assert same_commands(np.stack([same, same]))
    assert same_commands(np.stack([same, late]))
    assert not same_commands(np.stack([same, other]))
    assert roll_out(model, Play("", measured(model, same, late))).count == 1
    assert roll_out(model, Play("", measured(model, same, other))).count == 2


@pytest.mark.parametrize("late", [1, 30])
def test_comparison_fit_and_scores_say_the_same_of_one_model_and_one_recording(model, late):
    """Four trials, two of them late; the first three samples of one signal were not seen."""
    real = measured(model, commands(), commands(late), commands(), commands(late), noise=1e-4)
    values = np.array(real.values)
    values[:, :3, 2] = np.nan
    play = Play("", replace(real, values=values))
    other = load_model("labyrinth")
    comparison = compare(play.trials, roll_out(other, play), signals=SIGNALS)
    scores = judge(other, [play], SIGNALS)
    for error, score in zip(comparison.errors, scores, strict=True):
        fit = Objective(other, (), [play], (score.signal,))
        fitness = CommandError(fit.weights)(fit(np.empty((1, 0))))[0]
        assert score.error == error.command_error == pytest.approx(fitness, rel=1e-9)
        assert score.alikeness == {a.k_real: a.shares[score.signal] for a in comparison.alikeness}
    assert 0 < scores[0].alikeness[1.0] < 1


def test_commands_act_at_their_own_stamps(model):
    """A command 4 ms after a sample is 4 ms late; on the grid it would be a whole sample."""
    real = measured(model, commands())
    late = [
        StampedTrial(
            t.seconds, {n: Series(s.time + 0.004 * (s.time > 0), s.values) for n, s in t.commands.items()}, t.signals
        )
        for t in Play("", real).at_stamps
    ]
    on_time = roll_out(model, Play("", real))
    shifted = roll_out(model, Play("", real, stamped=tuple(late)))
    sample = replace(real, commands=np.concatenate([real.commands[:, :1], real.commands[:, :-1]], axis=1))
    whole = roll_out(model, Play("", sample))
    i = on_time.index("motor_x")
    moved, most = (np.abs(run.values[0, :, i] - on_time.values[0, :, i]).sum() for run in (shifted, whole))
    assert moved == pytest.approx(0.4 * most, rel=0.05)


def test_each_trial_is_rolled_out_with_its_own_command(model):
    real = measured(model, commands(), commands(late=30))
    sim = roll_out(model, Play("", real))
    assert np.allclose(sim.select(SIGNALS).values, real.values, atol=1e-12)


def test_a_drive_switched_off_is_no_jitter():
    off = commands()
    off[60:] = np.nan
    assert same_commands(np.stack([off, off]))
    assert not same_commands(np.stack([commands(), off]))


def test_a_roll_out_starts_at_the_first_pose_that_was_seen(model):
    real = measured(model, commands(), commands())
    values = np.array(real.values)
    values[:, 0, 0] = np.nan  # seen from the second sample on
    sim = roll_out(model, Play("", replace(real, values=values)))
    assert sim.values[0, 0, sim.index("motor_x")] == pytest.approx(values[0, 1, 0])


def test_recordings_without_the_rigs_commands_are_refused(model):
    bare = Trials(TIME, ("motor_x",), ("rad",), np.zeros((1, 150, 1)), (), np.zeros((1, 150, 0)))
    with pytest.raises(InputError, match=r"motor_x, motor_y.*have none"):
        roll_out(model, Play("", bare))


def test_bags_of_a_model_are_explained_by_it_on_the_command_line(model, tmp_path):
    real = measured(model, commands(), commands(), commands(), noise=1e-6)
    for i in range(real.count):
        rows = {"joint_commands": (real.command_channels, real.commands[i]), "joint_states": (SIGNALS, real.values[i])}
        write_bag(
            tmp_path / "real" / str(i),
            {f"/real/{topic}": ("sensor_msgs/msg/JointState", list(_messages(*row))) for topic, row in rows.items()},
        )
    result = eps_tunnel(
        "compare", "--real", tmp_path / "real", "--model", "labyrinth_manual", "--signals", *SIGNALS, "--json"
    )
    assert result.returncode == 0, result.stderr
    content = json.loads(result.stdout)
    assert ["model", "labyrinth_manual, rig labyrinth"] in content["sources"]
    assert content["signals"] == list(SIGNALS)
    assert all(e["rms"] < 2e-6 for e in content["errors"])


def _messages(names, values):
    for n, row in enumerate(values):
        stamp = START + n * STEP
        header = Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
        empty = np.array([])
        yield stamp, JointState(header=header, name=list(names), position=row, velocity=empty, effort=empty)


@pytest.mark.parametrize(
    ("first", "early", "rests"),
    [
        (0.5, lambda t: np.full_like(t, 0.48), True),  # short of its goal by what carries its load
        (0.5, lambda t: 0.48 - 0.1 * t, False),  # still on its way
        (1.5, lambda t: np.full_like(t, 0.48), False),  # that command moves it
        (np.nan, lambda t: np.full_like(t, 0.48), False),  # the drive is off
    ],
)
def test_whether_an_axis_rests_as_a_play_begins_is_read_off_its_first_samples(first, early, rests):
    time = np.arange(200) * 0.01
    seen = np.where(time < 0.5, early(time), 0.48 - np.clip(time - 0.5, 0.0, 0.5) * 2.0)
    seen += 1e-4 * np.random.default_rng(1).standard_normal(len(time))
    sent = Series(time, np.where(time < 0.3, first, -0.5))
    trial = StampedTrial(1.99, {"pendulum": sent}, {"pendulum": Series(time, seen)})
    assert axes_at_rest(load_model("pendulum"), [trial]).tolist() == [rests]


def test_a_step_right_at_the_start_is_no_unrest():
    """What is measured after the command has changed says nothing of how the axis was before."""
    time = np.arange(200) * 0.01
    sent = Series(time, np.where(time < 0.03, 0.5, -0.5))
    moved = Series(time, 0.49 - np.clip(time - 0.04, 0.0, 0.3) * 3.0)
    trial = StampedTrial(1.99, {"pendulum": sent}, {"pendulum": moved})
    assert axes_at_rest(load_model("pendulum"), [trial]).tolist() == [True]


def test_that_one_trial_s_samples_lie_a_tick_apart_is_no_unrest():
    """A coarse sensor at the edge between two ticks: one trial's halves differ, those of most trials do not."""
    time, tick = np.arange(200) * 0.01, 0.01
    sent = Series(time, np.where(time < 0.3, 0.5, -0.5))

    def trial(late):
        seen = np.where(time < 0.05, 0.49, 0.49 + late)
        return StampedTrial(1.99, {"pendulum": sent}, {"pendulum": Series(time, np.where(time < 0.5, seen, -0.5))})

    given = load_model("pendulum")
    assert axes_at_rest(given, [trial(tick), trial(0.0), trial(0.0), trial(0.0)]).tolist() == [True]
    assert axes_at_rest(given, [trial(tick)] * 4).tolist() == [False]


@pytest.mark.parametrize(
    ("other_moves", "first", "rests"),
    [
        (True, 0.05, True),
        (False, 0.05, False),  # what moves it is its own command
        (True, 0.16, False),  # too far from its goal to rest
    ],
)
def test_an_axis_that_another_one_shakes_at_once_rests_near_its_command(other_moves, first, rests):
    time = np.arange(200) * 0.01
    seen = np.where(time < 0.5, 0.04 + 0.02 * np.sin(20.0 * time), -0.5)
    sent = {
        "motor_x": Series(time, np.where(other_moves & (time > 0.0), 0.1, 0.0)),
        "motor_y": Series(time, np.where(time < 0.4, first, -0.5)),
    }
    trial = StampedTrial(1.99, sent, {"motor_x": Series(time, np.zeros(200)), "motor_y": Series(time, seen)})
    assert axes_at_rest(load_model("labyrinth_manual"), [trial]).tolist() == [False, rests]
