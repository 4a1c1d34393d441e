# SPDX-License-Identifier: Apache-2.0
"""Bags of several commands fall apart into plays."""

from pathlib import Path

import numpy as np
import pytest
from bag_files import joint_states, response, servo_bag
from recording_cases import SECOND, START, joints, mark

from eps_tunnel_analysis.recording import BagWriter, read, to_plays
from eps_tunnel_analysis.recording.channel_map import held_by_all
from eps_tunnel_analysis.recording.decode import JOINT_STATE, TRIAL
from labyrinth_sim.errors import InputError
from labyrinth_sim.rig import load_rig


def marked(folder: Path, hashes: list[str]) -> Path:
    """One second a trial, 2 s apart; a trial's target is 0.01 rad times the number in its hash."""
    with BagWriter(folder) as writer:
        for topic, kind in (("commands", JOINT_STATE), ("states", JOINT_STATE)):
            writer.add_topic(f"/real/joint_{topic}", kind)
        writer.add_topic("/real/trial", TRIAL)
        for trial, told in enumerate(hashes):
            start = START + 2 * trial * SECOND
            writer.write("/real/trial", start, mark(start, 0, trial, 1.0, told))
            for i in range(101):
                at = start + i * SECOND // 100
                for topic in ("commands", "states"):
                    writer.write(f"/real/joint_{topic}", at, joints(at, ["motor_x"], [0.01 * int(told)]))
            end = start + SECOND
            writer.write("/real/trial", end, mark(end, 1, trial, 1.0, told))
    return folder


def test_marked_trials_fall_into_one_play_for_each_sequence(tmp_path: Path) -> None:
    first, second = marked(tmp_path / "a", ["1", "2", "1"]), marked(tmp_path / "b", ["3", "2"])
    result = to_plays([read(first), read(second)])
    assert [play.trials.count for play in result.plays] == [2, 2, 1]
    assert [float(play.trials.commands[0, 50, 0]) for play in result.plays] == [0.01, 0.02, 0.03]
    assert [r.sequence_hash for r in result.results] == ["1", "2", "3"]
    assert len({play.name for play in result.plays}) == 3


def test_without_marks_the_commands_tell_what_belongs_together(tmp_path: Path) -> None:
    time = np.arange(201) / 100
    other = joint_states(np.where(time > 1.0, -0.1, 0.0))
    late = joint_states(np.where((time >= 0.51) & (time < 1.21), 0.1, 0.0))
    recordings = [
        read(servo_bag(tmp_path / "a")),
        read(servo_bag(tmp_path / "b", commands=other)),
        read(servo_bag(tmp_path / "c", commands=late)),
    ]
    result = to_plays(recordings)
    assert [play.trials.count for play in result.plays] == [2, 1]
    assert [play.name for play in result.plays] == ["command 1", "command 2"]


def test_what_is_wrong_with_two_commands_is_told_at_once(tmp_path: Path) -> None:
    short = response(np.arange(101) / 100)
    bags = [
        servo_bag(tmp_path / "a"),
        servo_bag(tmp_path / "b", states=joint_states(short), commands=joint_states(short)),
    ]
    assert len(to_plays([read(bag) for bag in bags]).plays) == 2, "another length is another command"
    with pytest.raises(InputError, match="No recordings"):
        to_plays([])


NAMES = ("motor_x", "motor_y", "board_x", "board_y")


def with_efforts(folder: Path, efforts: dict[str, float]) -> Path:
    """Joint states of the labyrinth whose efforts rise from 0 to these, N m; NaN elsewhere."""
    with BagWriter(folder) as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        for i in range(10):
            at = START + i * SECOND // 100
            rising = [i * efforts.get(name, np.nan) for name in NAMES]
            writer.write("/real/joint_states", at, joints(at, NAMES, [0.0] * 4, [np.nan] * 4, rising))
    return folder


def test_efforts_are_read_where_every_bag_measured_them(tmp_path: Path) -> None:
    rig = load_rig("labyrinth")
    both = read(with_efforts(tmp_path / "both", {"motor_x": 0.1, "motor_y": 0.1}))
    one = read(with_efforts(tmp_path / "one", {"motor_x": 0.1}))
    zeros = read(with_efforts(tmp_path / "zeros", {"motor_x": 0.0, "motor_y": 0.1}))
    positions = {"motor_x", "motor_y", "board_x", "board_y"}
    assert set(held_by_all(rig, [both])) == positions | {"motor_x_effort", "motor_y_effort"}
    assert set(held_by_all(rig, [both, one])) == positions | {"motor_x_effort"}
    assert set(held_by_all(rig, [one, zeros])) == positions
