# SPDX-License-Identifier: Apache-2.0
"""Recordings become trials on one grid: exact where measured, NaN where not, and refused where they do not belong."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_cases import SECOND, START, ball, command, joints, mark, measured, write_bag

from eps_tunnel_analysis.recording import BagWriter, ChannelMap, Source, channel_map, read, read_trials, to_trials
from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE, TRIAL
from eps_tunnel_analysis.stamped import hold, interpolate
from labyrinth_sim.errors import InputError
from labyrinth_sim.rig import load_rig

stamps_s = st.lists(st.integers(0, 400), min_size=2, max_size=30, unique=True).map(sorted)
GRID = np.arange(0, 401) * 10_000_000


@given(stamps_s, st.floats(-3, 3), st.floats(-3, 3))
def test_a_straight_line_is_resampled_exactly(ticks: list[int], slope: float, offset: float) -> None:
    stamps = np.array(ticks) * 10_000_000
    out = interpolate(stamps, offset + slope * stamps * 1e-9, GRID, max_gap=10.0)
    inside = (stamps[0] <= GRID) & (stamps[-1] >= GRID)
    assert np.allclose(out[inside], offset + slope * GRID[inside] * 1e-9, atol=1e-9)
    assert np.isnan(out[~inside]).all()


@given(stamps_s, st.floats(0.005, 1.0))
def test_a_sample_is_nan_exactly_where_no_short_enough_span_holds_it(ticks: list[int], max_gap: float) -> None:
    stamps = np.array(ticks) * 10_000_000
    out = interpolate(stamps, np.zeros(len(stamps)), GRID, max_gap)
    for at, value in zip(GRID, out, strict=True):
        before, after = stamps[stamps <= at], stamps[stamps >= at]
        bridged = len(before) > 0 and len(after) > 0 and after[0] - before[-1] <= round(max_gap * 1e9)
        assert np.isnan(value) == (not bridged)


@given(stamps_s)
def test_a_command_is_held_until_the_next(ticks: list[int]) -> None:
    stamps = np.array(ticks) * 10_000_000
    out = hold(stamps, np.arange(len(stamps), dtype=float), GRID, max_hold=None)
    for at, value in zip(GRID, out, strict=True):
        sent = np.count_nonzero(stamps <= at)
        assert np.isnan(value) if sent == 0 else value == sent - 1


def test_a_stream_of_commands_that_stops_leaves_no_target_behind() -> None:
    stamps = np.concatenate([np.arange(0, 100), np.arange(130, 200), np.arange(300, 320)]) * 10_000_000
    out = hold(stamps, np.ones(len(stamps)), GRID, max_hold=0.5)
    off = np.isnan(out)
    assert not off[:200].any(), "a pause of 0.3 s is bridged"
    assert off[201:300].all(), "a pause of 1 s is not"
    assert not off[300:320].any()
    assert off[321:].all(), "nor is the silence after the last command"


def test_commands_that_are_sent_only_when_they_change_are_held_for_ever() -> None:
    stamps = np.array([0, 100, 200, 300]) * 10_000_000
    assert not np.isnan(hold(stamps, np.ones(4), GRID, max_hold=0.5)).any()


def test_bags_become_trials_in_their_order(tmp_path: Path) -> None:
    time = np.arange(201) / 100
    bags = [write_bag(tmp_path / f"bag{i}", positions=measured(time) + 0.001 * i) for i in range(3)]
    result = read_trials(bags)
    trials = result.trials
    assert trials.signals == ("motor_x",)
    assert trials.units == ("rad",)
    assert trials.command_channels == ("motor_x",)
    assert np.allclose(trials.time, time)
    for i in range(3):
        assert np.allclose(trials.values[i, :, 0], measured(time) + 0.001 * i)
        assert np.allclose(trials.commands[i, :, 0], command(time))
    assert result.report.missing.tolist() == [[0]] * 3
    assert result.report.gaps == ()


def test_a_gap_becomes_nan_and_is_counted(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with BagWriter(bag) as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        for i in [*range(100), *range(150, 201)]:
            at = START + i * SECOND // 100
            writer.write("/real/joint_states", at, joints(at, ["motor_x"], [i]))
    report = read_trials([bag]).report
    assert report.missing.tolist() == [[50]]
    ((trial, signal, start, length),) = report.gaps
    assert (trial, signal) == (0, "motor_x")
    assert (start, length) == pytest.approx((0.99, 0.51))
    assert "motor_x 50" in report.notes[0]
    assert read_trials([bag], max_gap=0.6).report.missing.tolist() == [[0]]


def test_an_unseen_ball_is_nan_whatever_its_coordinates_say(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/ball", BALL_STATE)
        for i in range(101):
            at = START + i * SECOND // 100
            visible = not 30 <= i < 60
            writer.write("/real/ball", at, ball(at, visible, i if visible else np.nan, 0.0))
    result = read_trials([tmp_path / "bag"])
    assert result.trials.signals == ("ball_x", "ball_y")
    assert np.flatnonzero(np.isnan(result.trials.values[0, :, 0])).tolist() == list(range(30, 60))


def marked_bag(
    folder: Path,
    trials: list[tuple[int, str]],
    metadata: dict[str, str] | None = None,
    commanded: range = range(-20, 121),
    late: Sequence[int] | None = None,
) -> Path:
    """Trials of one second each, 2 s apart, each ended by its phase (1 end, 2 aborted, 0 never).

    Args:
        commanded: hundredths of a second after a trial's start at which a command is sent, `late` ns in each trial.
    """
    with BagWriter(folder, metadata) as writer:
        for topic, type_ in (
            ("/real/joint_commands", JOINT_STATE),
            ("/real/joint_states", JOINT_STATE),
            ("/real/trial", TRIAL),
        ):
            writer.add_topic(topic, type_)
        for trial, (phase, sequence_hash) in enumerate(trials):
            start = START + 2 * trial * SECOND
            writer.write("/real/trial", start, mark(start, 0, trial, 1.0, sequence_hash))
            for i in range(-20, 121):
                at = start + i * SECOND // 100
                if i in commanded:
                    sent = at + (late[trial] if late else 0)
                    writer.write("/real/joint_commands", sent, joints(sent, ["motor_x"], [command(np.array(i / 100))]))
                writer.write("/real/joint_states", at, joints(at, ["motor_x"], [i / 100 + trial]))
            if phase:
                end = start + SECOND + 3_000_000 * (trial + 1)
                writer.write("/real/trial", end, mark(end, phase, trial, 1.0, sequence_hash))
    return folder


def test_trial_marks_cut_one_bag_into_trials(tmp_path: Path) -> None:
    result = read_trials([marked_bag(tmp_path / "bag", [(1, "a"), (2, "a"), (1, "a"), (0, "a")])])
    trials = result.trials
    assert trials.count == 2
    assert np.allclose(trials.time, np.arange(101) / 100)
    assert np.allclose(trials.values[:, :, 0], trials.time + np.array([[0], [2]]))
    assert (result.sequence, result.sequence_hash) == ("eight_seconds", "a")
    assert "trial 1 was aborted" in result.report.notes[0]
    assert "trial 3 has no end mark" in result.report.notes[1]


def test_whether_a_first_command_comes_just_before_a_mark_or_after_it_makes_no_difference(tmp_path: Path) -> None:
    late = [-400_000, 300_000, 0, 300_000]
    bag = marked_bag(tmp_path / "bag", [(1, "a")] * 4, commanded=range(101), late=late)
    sent = [trial.commands["motor_x"] for trial in read_trials([bag]).stamped]
    assert [one.time[0] for one in sent] == pytest.approx([late_ns * 1e-9 for late_ns in late], abs=1e-8)
    for one in sent:
        assert one.values[:99] == pytest.approx(command(np.arange(99) / 100))


def test_a_drive_that_is_switched_on_within_a_trial_was_off_before(tmp_path: Path) -> None:
    bag = marked_bag(tmp_path / "bag", [(1, "a")] * 2, commanded=range(30, 101))
    sent = read_trials([bag]).stamped[1].commands["motor_x"]
    assert sent.time[:3] == pytest.approx([-1.0, -0.99, 0.3])
    assert np.isnan(sent.values[:3]).tolist() == [False, True, False]


def test_marked_bags_without_a_finished_trial_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no trial was played to its end"):
        read_trials([marked_bag(tmp_path / "bag", [(2, "a")])])


def test_different_sequences_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Trials must play the same sequence") as caught:
        read_trials([marked_bag(tmp_path / "bag", [(1, "a" * 64), (1, "b" * 64)])])
    assert "trial 1" in str(caught.value)
    bags = [write_bag(tmp_path / h, metadata={"sequence": h, "sequence_hash": h * 64}) for h in "cd"]
    with pytest.raises(InputError, match=r"plays sequence 'd'.*plays 'c'"):
        read_trials(bags)


def test_different_lengths_are_told_and_cut_only_when_asked(tmp_path: Path) -> None:
    bags = [write_bag(tmp_path / "long", seconds=2.0), write_bag(tmp_path / "short", seconds=1.5)]
    with pytest.raises(InputError, match=r"long 2\.00 s.*short 1\.50 s"):
        read_trials(bags)
    result = read_trials(bags, cut_to_shortest=True)
    assert result.trials.time[-1] == pytest.approx(1.5)
    assert "cut to the shortest" in result.report.notes[0]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path: Path, bad: float) -> None:
    positions = measured(np.arange(201) / 100)
    positions[50] = bad
    bag = write_bag(tmp_path / "bag", positions=positions)
    with pytest.raises(
        InputError, match=r"'/real/joint_states': motor_x.position is NaN or infinite in 1 of 201.*0\.500"
    ):
        read_trials([bag])


def test_what_is_not_finite_before_the_first_command_is_no_part_of_the_trial(tmp_path: Path) -> None:
    time = np.arange(201) / 100
    stamps = START - SECOND // 2 + np.round(time * SECOND).astype(np.int64)
    positions = measured(time)
    positions[:3] = np.nan
    trials = read_trials([write_bag(tmp_path / "bag", positions=positions, stamps=stamps)]).trials
    assert np.isfinite(trials.values).all()


def test_a_joint_missing_in_some_messages_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        for i in range(10):
            at = START + i * SECOND // 100
            writer.write("/real/joint_states", at, joints(at, ["a", "b"][: 1 + (i > 3)], [1.0, 2.0][: 1 + (i > 3)]))
    with pytest.raises(InputError, match="joint 'b' has no position in 4 of 10"):
        read_trials([tmp_path / "bag"])
    assert read_trials([tmp_path / "bag"], signals=["a"]).trials.signals == ("a",)


def test_missing_and_mistyped_topics_are_told_together(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    channels = ChannelMap(
        (
            Source("motor_y", "/real/joint_states", JOINT_STATE, "motor_y.position", "rad"),
            Source("ball_x", "/real/joint_states", BALL_STATE, "x", "m"),
            Source("ball_y", "/real/bal", BALL_STATE, "y", "m"),
        ),
        (),
    )
    with pytest.raises(InputError) as caught:
        to_trials([read(bag)], channels)
    assert len(caught.value.complaints) == 3
    assert "no position of joint 'motor_y'" in caught.value.complaints[0]
    assert f"is of type {JOINT_STATE}, expected {BALL_STATE}" in caught.value.complaints[1]
    assert "Unknown topic '/real/bal'" in caught.value.complaints[2]
    with pytest.raises(InputError, match="Did you mean 'motor_x'"):
        read_trials([bag], signals=["motor_z"])


def test_a_rig_that_measures_nothing_is_told(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", names=["joint"])
    rig = replace(load_rig("horn"), axes=tuple(replace(axis, measured=()) for axis in load_rig("horn").axes))
    with pytest.raises(InputError, match="bag: nothing that the rig measures is in it"):
        read_trials([bag], rig)


def test_a_rig_names_the_channels_of_either_side() -> None:
    rig = load_rig("labyrinth")
    for namespace in ("/real", "/sim"):
        channels = channel_map(rig, namespace)
        assert tuple(source.name for source in channels.signals) == rig.signals
        assert tuple(source.unit for source in channels.signals) == rig.units
        assert {source.topic for source in channels.commands} == {f"{namespace}/joint_commands"}
