# SPDX-License-Identifier: Apache-2.0
"""Paths through the points of a trajectory."""

import numpy as np
import pytest

from labyrinth_hw.errors import InputError
from labyrinth_hw.trajectory import path_through

START = np.array([0.0, 1.0])


def test_without_speeds_the_path_is_straight_between_points() -> None:
    path = path_through(START, [1.0, 3.0], [[0.2, 1.0], [0.6, 0.0]], [[], []])
    assert path.at(-1.0) == pytest.approx(START)
    assert path.at(0.5) == pytest.approx([0.1, 1.0])
    assert path.at(2.0) == pytest.approx([0.4, 0.5])
    assert path.at(9.0) == pytest.approx([0.6, 0.0])
    assert path.duration == 3.0


def test_with_speeds_the_path_meets_points_and_speeds() -> None:
    path = path_through(START, [2.0, 3.0], [[0.4, 1.0], [0.9, 1.0]], [[0.5, 0.0], [0.0, 0.0]])
    small = 1e-6
    for time, angle, speed in ((0.0, 0.0, 0.0), (2.0, 0.4, 0.5), (3.0, 0.9, 0.0)):
        assert path.at(time)[0] == pytest.approx(angle)
        inside = time + small if time < 3.0 else time - small
        assert (path.at(inside)[0] - angle) / (inside - time) == pytest.approx(speed, abs=1e-4)
    # The cubic from 0 to 0.4 rad with end speeds 0 and 0.5 rad/s over 2 s: 0.4 (3 s^2 - 2 s^3) + 1.0 (s^3 - s^2).
    assert path.at(1.0)[0] == pytest.approx(0.4 * 0.5 - 0.125)
    assert path.at(1.0)[1] == pytest.approx(1.0)


def test_a_first_point_at_zero_is_where_the_path_begins() -> None:
    path = path_through(START, [0.0, 1.0], [[0.5, 0.5], [0.7, 0.7]], [[], []])
    assert path.at(0.0) == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize(
    ("times", "positions", "told"),
    [
        ([], [], "without points"),
        ([1.0], [[0.1]], "needs 2 positions"),
        ([1.0, 1.0], [[0.1, 0.1], [0.2, 0.2]], "must rise"),
        ([-1.0], [[0.1, 0.1]], "must rise"),
        ([1.0], [[float("nan"), 0.1]], "finite"),
    ],
)
def test_points_that_cannot_be_followed_are_refused(
    times: list[float], positions: list[list[float]], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        path_through(START, times, positions, [[] for _ in times])
