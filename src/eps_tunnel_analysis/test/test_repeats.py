# SPDX-License-Identifier: Apache-2.0
"""Laws of what trials differ by: drift and uneven timing are told, noise, offsets and stuck places are not."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from eps_tunnel_analysis.diagnose.repeats import repeats
from labyrinth_sim.trials import Trials

STEP = 0.01
TIME = np.arange(0, 12, STEP)
MOTION = 0.05 * np.sin(2 * TIME) * np.sin(0.3 * TIME)


def found(values: np.ndarray) -> tuple[float, float]:
    trials = Trials(TIME, ("a",), ("rad",), values[:, :, None], (), np.empty((*values.shape, 0)))
    (one,) = repeats(trials, ["a"])
    assert bool(one.sentence) == bool(one.drift or one.jitter)
    return one.drift, one.jitter


def noise(seed: int, p: int = 5) -> np.ndarray:
    return 3e-4 * np.random.default_rng(seed).standard_normal((p, len(TIME)))


@pytest.mark.parametrize("seed", range(20))
def test_noise_is_neither_drift_nor_uneven_timing(seed: int) -> None:
    assert found(MOTION + noise(seed)) == (0.0, 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_trials_that_rest_at_places_of_their_own_do_not_drift(seed: int) -> None:
    places = 0.002 * np.random.default_rng([seed, 1]).standard_normal((5, 1))
    assert found(MOTION + noise(seed) + places)[1] == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_trials_that_differ_slowly_do_not_drift_though_their_means_go_one_way(seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    slow = uniform_filter1d(rng.standard_normal((4, len(TIME))), 100, axis=1)
    means = slow.mean(axis=1, keepdims=True)
    slow += means.mean() + means.std() * np.array([[-1.0], [-0.3], [0.4], [1.1]]) - means
    assert found(MOTION + 0.1 * noise(seed, 4) + 0.002 * slow)[0] == 0.0


def test_a_warming_rig_drifts() -> None:
    warm = 0.003 * (1 - np.exp(-np.arange(5) / 4.0))[:, None]
    drift, jitter = found(MOTION + noise(0) - warm)
    assert drift == pytest.approx(-warm[-1, 0], rel=0.2)
    assert jitter == 0.0


def test_uneven_timing_shows_where_it_moves() -> None:
    rng = np.random.default_rng(3)
    late = np.repeat(rng.normal(0.0, 0.01, (5, len(TIME) // 10)), 10, axis=1)
    values = np.array([np.interp(TIME - row, TIME, MOTION) for row in late]) + noise(3)
    drift, jitter = found(values)
    assert drift == 0.0
    assert jitter == pytest.approx(0.01, rel=0.3)


@pytest.mark.parametrize(("apart", "told"), [(0.004, False), (0.03, True)])
def test_trials_that_are_early_or_late_as_a_whole_are_even_while_it_is_less_than_half_a_sample(
    apart: float, told: bool
) -> None:
    late = apart * np.array([-1.0, -0.4, 0.1, 0.5, 0.8])
    values = np.array([np.interp(TIME - by, TIME, MOTION) for by in late]) + noise(5)
    assert bool(found(values)[1]) == told


def test_three_trials_do_not_show_a_drift() -> None:
    assert found(MOTION + noise(0, 3) + 0.01 * np.arange(3)[:, None]) == (0.0, 0.0)
