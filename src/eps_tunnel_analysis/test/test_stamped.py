# SPDX-License-Identifier: Apache-2.0
"""Commands and measurements at their own stamps: nothing is moved to a grid, so jitter of stamps costs nothing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tunnel_cases import make_trials

from eps_tunnel_analysis.stamped import (
    ALIGNED,
    Series,
    StampedTrial,
    aligned,
    readings,
    setpoints,
    stamped_from_grid,
)

STEP, SECONDS, WIDTH = 0.005, 2.0, 0.01
COUNT = round(SECONDS / STEP) + 1
GRID = STEP * np.arange(COUNT)


def commanded(time: np.ndarray, values: np.ndarray) -> StampedTrial:
    return StampedTrial(SECONDS, {"a": Series(np.asarray(time), np.asarray(values))}, {})


def area(time: np.ndarray, values: np.ndarray, end: float) -> float:
    """Of values each of which holds until the next, from 0 to `end`."""
    edges = np.clip(np.append(time, end), 0.0, end)
    return float(np.sum(values * np.diff(edges)))


def jittered(seed: int, trials: int = 4, rate: float = 100.0, jitter: float = 1e-3) -> list[np.ndarray]:
    """Stamps, s, of each trial."""
    rng = np.random.default_rng(seed)
    even = np.arange(0.02, SECONDS - 0.02, 1.0 / rate)
    return [even + jitter * rng.uniform(-1.0, 1.0, len(even)) for _ in range(trials)]


def measured(stamps: list[np.ndarray], motion) -> list[Series]:
    return [Series(time, motion(time)) for time in stamps]


@given(
    st.lists(st.floats(0.001, SECONDS - 0.001), min_size=1, max_size=8, unique=True),
    st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9),
)
def test_setpoints_keep_the_area_under_a_command(changes: list[float], levels: list[float]) -> None:
    time = np.array([-0.1, *sorted(changes)])
    values = np.array(levels[: len(time)])
    found = setpoints([commanded(time, values)], "a", STEP, COUNT)
    assert STEP * found.sum() == pytest.approx(area(time, values, STEP * COUNT), abs=1e-9)
    assert found.min() >= values.min() - 1e-9 and found.max() <= values.max() + 1e-9


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.93])
def test_a_step_within_a_step_of_the_grid_counts_for_what_is_left_of_it(part: float) -> None:
    found = setpoints([commanded([0.0, (100 + part) * STEP], [1.0, 3.0])], "a", STEP, COUNT)
    assert found[:100] == pytest.approx(1.0)
    assert found[100] == pytest.approx(part * 1.0 + (1.0 - part) * 3.0)
    assert found[101:] == pytest.approx(3.0)


@pytest.mark.parametrize("rate", [1000.0, 100.0])
def test_commands_as_frequent_as_a_drive_computes_go_straight_and_others_are_held(rate: float) -> None:
    time = np.arange(round(SECONDS * rate) + 1) / rate
    short = 0.0003
    found = setpoints([commanded(time, 0.2 * time)], "a", short, round(SECONDS / short))
    middle = short * (np.arange(len(found)) + 0.5)
    late = 0.2 * (middle - 0.5 / rate)  # a held command is, in the mean
    inside = (middle > 0.1) & (middle < SECONDS - 0.1)
    assert np.mean((found - late)[inside]) == pytest.approx(0.0, abs=1e-7)
    wave = np.ptp((found - late)[inside]) * rate / 0.2  # of the way between two commands
    assert wave < 0.1 if rate == 1000.0 else wave > 0.9


def test_setpoints_of_trials_are_the_mean_of_each_one_s() -> None:
    trials = [commanded([0.0, 0.5 + late], [0.2, -0.4]) for late in (-0.007, 0.0, 0.0021, 0.013)]
    alone = [setpoints([trial], "a", STEP, COUNT) for trial in trials]
    assert setpoints(trials, "a", STEP, COUNT) == pytest.approx(np.mean(alone, axis=0))


def test_where_most_trials_are_off_the_drive_is_off() -> None:
    off = commanded([0.0, 1.0], [0.3, np.nan])
    on = commanded([0.0, 1.0], [0.3, 0.5])
    half = COUNT // 2 + 1
    found = setpoints([off, off, on], "a", STEP, COUNT)
    assert found[: half - 2] == pytest.approx(0.3)
    assert np.isnan(found[half:]).all()
    assert setpoints([off, on, on], "a", STEP, COUNT)[half:] == pytest.approx(0.5)
    assert np.isnan(setpoints([commanded([1.0], [0.3])], "a", STEP, COUNT)[: half - 2]).all()


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4), st.integers(0, 50))
def test_a_reading_is_exact_on_cubics(powers: tuple[float, ...], seed: int) -> None:
    def motion(time: np.ndarray) -> np.ndarray:
        return np.polyval(powers, time - 0.7)

    bins = readings(measured(jittered(seed), motion), SECONDS, STEP, COUNT, WIDTH)
    assert bins.reading @ motion(GRID) == pytest.approx(bins.mean, abs=1e-10)


def test_jittering_stamps_of_a_known_motion_leave_no_residual() -> None:
    def motion(time: np.ndarray) -> np.ndarray:
        return 0.05 * np.sin(10.0 * time)

    bins = readings(measured(jittered(3), motion), SECONDS, STEP, COUNT, WIDTH)
    assert np.abs(bins.reading @ motion(GRID) - bins.mean).max() < 1e-7
    late = np.interp(bins.time + 5e-4, GRID, motion(GRID))
    assert np.abs(late - bins.mean).max() > 1e-4  # half a millisecond would show


def test_each_trial_is_brought_to_the_bin_s_mean_stamp() -> None:
    stamps = jittered(4)
    bins = readings(measured(stamps, lambda time: 0.1 + 0.8 * time), SECONDS, STEP, COUNT, WIDTH)
    seen = np.isfinite(bins.single)  # by its jitter a sample falls into the bin beside now and then
    assert seen.mean() > 0.5
    assert np.abs(bins.single - bins.mean)[seen].max() < 1e-12
    assert np.nanmax(np.abs(bins.stamps - bins.time)) > 5e-4


def test_samples_that_a_trial_lacks_are_not_made_up() -> None:
    time = np.arange(0.0, SECONDS, 0.01) + 0.002
    gap = (time > 0.5) & (time < 1.0)
    bins = readings([Series(time[~gap], np.zeros((~gap).sum())), Series(time, np.ones(len(time)))],
                    SECONDS, STEP, COUNT, WIDTH)  # fmt: skip
    inside = (bins.time > 0.51) & (bins.time < 0.99)
    assert np.isnan(bins.single[0, inside]).all()
    assert bins.mean[inside] == pytest.approx(1.0)
    assert bins.mean[bins.time < 0.49] == pytest.approx(0.5)


def with_clock(late: float, size: float = 1.0) -> StampedTrial:
    """A trial whose clock began `late` s early, so that all of it seems late."""
    time = np.array([0.0, 0.3, 0.9]) + late
    seen = np.arange(0.0, 1.5, 0.01) + late
    return StampedTrial(SECONDS, {"a": Series(time, size * np.array([0.1, 0.4, np.nan]))},
                        {"s": Series(seen, np.sin(seen - late))})  # fmt: skip


def test_trials_are_aligned_by_their_commands_and_the_measurements_go_with_them() -> None:
    late = np.array([0.004, -0.011, 0.0, 0.002])
    found = aligned([with_clock(by) for by in late])
    first = [trial.commands["a"].time[0] for trial in found]
    assert first == pytest.approx([late.mean()] * 4)
    assert [trial.signals["s"].time[0] for trial in found] == pytest.approx(first)


def test_a_last_message_that_one_trial_lacks_keeps_none_from_being_aligned() -> None:
    whole, late = with_clock(0.0), with_clock(0.004)
    sent = late.commands["a"]
    shorter = replace(late, commands={"a": Series(sent.time[:-1], sent.values[:-1])})
    assert [trial.commands["a"].time[0] for trial in aligned([whole, shorter])] == pytest.approx([0.002] * 2)


@pytest.mark.parametrize("other", [with_clock(0.004, size=1.1), with_clock(2.0 * ALIGNED)])
def test_trials_with_other_commands_are_left_alone(other: StampedTrial) -> None:
    given = [with_clock(0.0), with_clock(0.003), other]
    assert aligned(given) == tuple(given)


def test_of_a_grid_its_times_are_the_stamps_and_unseen_samples_are_left_out() -> None:
    values = np.arange(12.0).reshape(2, 6, 1)
    values[0, 2] = np.nan
    first, second = stamped_from_grid(make_trials(values, commands=np.ones((2, 6, 1))))
    assert first.signals["a"].time == pytest.approx([0.0, 0.01, 0.03, 0.04, 0.05])
    assert first.signals["a"].values == pytest.approx([0.0, 1.0, 3.0, 4.0, 5.0])
    assert second.commands["a"].values == pytest.approx(np.ones(6))
    assert second.seconds == pytest.approx(0.05)
