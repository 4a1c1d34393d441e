# SPDX-License-Identifier: Apache-2.0
import sys
import threading

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eps_tunnel_analysis.motion import RestWatch, smooth_path

poses = st.lists(st.floats(-1, 1), min_size=2, max_size=2).map(np.array)


@given(poses, poses, st.floats(0.01, 5.0))
def test_a_path_arrives_and_never_exceeds_its_speed(start: np.ndarray, end: np.ndarray, speed: float) -> None:
    path = smooth_path(start, end, speed, 100.0)
    assert np.array_equal(path[-1], end)
    steps = np.diff(np.vstack([start, path]), axis=0)
    if len(path) > 1:
        assert np.abs(steps).max() <= speed / 100 * (1 + 1e-9)
    assert np.all(steps * np.sign(end - start) >= -1e-12)


def watched(positions: np.ndarray, watch: RestWatch) -> list[bool]:
    rests = []
    for i, position in enumerate(positions):
        watch.add(100.0 + i / 100, np.atleast_1d(position))
        rests.append(watch.at_rest)
    return rests


def test_flicker_between_two_counts_is_rest() -> None:
    random = np.random.default_rng(0)
    flicker = np.radians(0.29) * random.integers(0, 2, size=400)
    assert watched(flicker, RestWatch(1.0, np.radians(0.5)))[-1]


def test_what_creeps_is_not_at_rest_until_it_has_stopped_for_the_whole_time() -> None:
    time = np.arange(800) / 100
    creep = np.where(time < 3.0, np.radians(2.0) * time, np.radians(6.0))
    rests = watched(creep, RestWatch(0.5, np.radians(0.3)))
    assert not any(rests[:350])
    assert rests[-1]


def test_a_swing_about_one_place_is_not_rest() -> None:
    time = np.arange(1000) / 100
    for frequency in (0.3, 1.0, 1.7):
        swing = np.radians(1.0) * np.sin(2 * np.pi * frequency * time)
        assert not any(watched(swing, RestWatch(0.5, np.radians(0.3)))), frequency


def test_an_unmeasured_joint_is_not_waited_for_and_nothing_is_known_without_samples() -> None:
    watch = RestWatch(0.5, 0.01)
    assert not watch.at_rest
    rests = watched(np.column_stack([np.zeros(300), np.full(300, np.nan)]), watch)
    assert rests[-1]
    watch.reset()
    assert not watch.at_rest


def test_one_thread_may_reset_and_ask_while_another_adds() -> None:
    watch = RestWatch(0.5, 0.01)
    ends, errors = threading.Event(), []

    def measure() -> None:
        try:
            for i in range(3000):
                watch.add(i / 500, np.zeros(2))
        except (RuntimeError, IndexError) as error:
            errors.append(error)
        ends.set()

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        thread = threading.Thread(target=measure)
        thread.start()
        while not ends.is_set():
            for _ in range(20):
                watch.at_rest  # noqa: B018
            watch.reset()
        thread.join()
    finally:
        sys.setswitchinterval(before)
    assert not errors
