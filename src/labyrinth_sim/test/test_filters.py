# SPDX-License-Identifier: Apache-2.0
"""Filters between simulation and signals, where the equations of the effects that use them do not say all."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lsim

from labyrinth_sim.filters import Delay, Filter, Lag, Mean, Swing, dithered, rounded
from labyrinth_sim.trials import Array

STEP = 0.01  # s


@pytest.mark.parametrize("filter_", [lambda late: Lag(late, STEP), lambda late: Mean(2.0 * late, STEP, np.ones(3))])
def test_a_lag_in_parts_is_the_lag_of_the_whole(filter_: Callable[[Array], Filter]) -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(size=(3, 50))
    constants = np.array([0.0, 0.004, 0.03])
    whole = filter_(constants)(values, values)
    parts = filter_(constants)
    block = np.empty((3, 10))
    for k in range(0, 50, 10):
        block[...] = values[:, k : k + 10]  # as a live stepper does, which fills one block anew
        assert np.array_equal(parts(block, block), whole[:, k : k + 10])


@pytest.mark.parametrize("late", [0.0, 0.003, 0.0085, 0.02, 0.026])
def test_a_measurement_filtered_or_late_is_that_of_a_parabola(late: float) -> None:
    time = np.arange(60) * STEP
    value = 40.0 * time**2 - 3.0 * time  # rad, bending as a quick step does
    filtered = Lag(np.array([late]), STEP)(value[None], value[None])[0]
    steady = value - late * (80.0 * time - 3.0) + late**2 * 80.0
    assert np.abs(filtered - steady)[50:].max() < 1e-6  # of the radian; what is left of the start dies away
    averaged = Mean(np.array([2.0 * late]), STEP, value[:1])(value[None], value[None])[0]
    mean = value - late * (80.0 * time - 3.0) + 4.0 / 3.0 * late**2 * 40.0
    assert averaged[10:] == pytest.approx(mean[10:], abs=1e-12)
    delayed = Delay(np.array([late]), STEP, np.zeros(1), smooth=True)(value[None], value[None])[0]
    assert delayed[10:] == pytest.approx((40.0 * (time - late) ** 2 - 3.0 * (time - late))[10:], abs=1e-12)


def test_a_lost_sample_is_bridged_by_its_neighbour() -> None:
    values = np.sin(np.arange(20.0))[None]
    values[0, 9] = np.nan
    late = Delay(np.array([0.004]), STEP, np.zeros(1), smooth=True)(values, values)[0]
    assert np.isfinite(np.delete(late, 9)).all()
    lagged = Lag(np.array([0.004]), STEP)(values, values)[0]
    assert np.isfinite(np.delete(lagged, 9)).all()
    assert np.isnan(lagged[9])
    averaged = Mean(np.array([0.02]), STEP, np.zeros(1))(values, values)[0]
    assert np.isnan(averaged[9])
    assert np.nanmax(np.abs(averaged[9:] - np.sin(np.arange(9.0, 20.0) - 1.0))) < 0.6  # at a step of a radian


def test_a_smooth_delay_in_parts_is_the_delay_of_the_whole() -> None:
    values = np.random.default_rng(6).normal(size=(3, 40))
    late = np.array([0.0, 0.004, 0.023])
    whole = Delay(late, STEP, values[:, 0], smooth=True)(values, values)
    parts = Delay(late, STEP, values[:, 0], smooth=True)
    assert np.array_equal(
        np.concatenate([parts(values[:, k : k + 10], values) for k in range(0, 40, 10)], axis=1), whole
    )


def test_rounding_without_noise_is_rounding_and_without_ticks_nothing() -> None:
    angles = np.random.default_rng(8).normal(size=(3, 40))
    ticks = np.array([0.0, 0.1, 0.3])
    assert np.array_equal(dithered(angles, ticks, np.zeros(3)), rounded(angles, ticks))
    soft = dithered(angles, ticks, np.full(3, 0.05))
    assert np.array_equal(soft[0], angles[0])
    assert np.abs(soft - angles).max() < 0.15 + 1e-12


def test_a_far_end_swings_as_its_equation_says_in_parts_as_in_the_whole() -> None:
    frequency, damping, step = np.array([20.0, 35.0, 35.0]), np.array([0.05, 0.3, 0.3]), 0.005
    share = np.array([1.0, 1.0, 0.0])
    time = np.arange(400) * step
    near = np.tile(0.2 * np.sin(3.0 * time) ** 3, (3, 1))
    seen = Swing(share, frequency, damping, step)(near, near)
    for row in (0, 1):
        w, d = frequency[row], damping[row]
        system = ([2.0 * d * w, w**2], [1.0, 2.0 * d * w, w**2])
        far = lsim(system, near[row], time)[1]
        assert np.abs(far - near[row]).max() > 0.004
        assert seen[row] == pytest.approx(far, abs=2e-4)
    assert np.array_equal(seen[2], near[2])
    parts = Swing(share, frequency, damping, step)
    pieces = [parts(near[:, k : k + 50], near[:, k : k + 50]) for k in range(0, 400, 50)]
    assert np.array_equal(np.hstack(pieces), seen)
