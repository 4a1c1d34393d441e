# SPDX-License-Identifier: Apache-2.0
"""Filters between simulation and signals, against what they stand for."""

import numpy as np
import pytest

from labyrinth_sim.filters import Lag

STEP = 0.01  # s


@pytest.mark.parametrize("constant", [0.002, 0.008, 0.05])
def test_a_lag_follows_a_ramp_as_its_equation_says_however_fast_it_is(constant: float) -> None:
    time = np.arange(40) * STEP
    ramp = 0.3 * time[None]
    seen = Lag(np.array([constant]), STEP)(ramp, ramp)
    assert seen[0] == pytest.approx(0.3 * (time - constant * -np.expm1(-time / constant)), abs=1e-12)


@pytest.mark.parametrize("constant", [0.002, 0.008, 0.05])
def test_a_lag_passes_a_slow_sine_as_its_equation_says(constant: float) -> None:
    time = np.arange(400) * STEP
    omega = 2 * np.pi * 3.0
    sine = np.sin(omega * time)[None]
    seen = Lag(np.array([constant]), STEP)(sine, sine)[0]
    phase = np.arctan(omega * constant)
    steady = np.cos(phase) * np.sin(omega * time - phase)
    late = time > 1.0
    assert np.abs(seen - steady)[late].max() < 0.005


def test_a_lag_in_parts_is_the_lag_of_the_whole() -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(size=(3, 50))
    constants = np.array([0.0, 0.004, 0.03])
    whole = Lag(constants, STEP)(values, values)
    parts = Lag(constants, STEP)
    block = np.empty((3, 10))
    for k in range(0, 50, 10):
        block[...] = values[:, k : k + 10]  # as a live stepper does, which fills one block anew
        assert np.array_equal(parts(block, block), whole[:, k : k + 10])
