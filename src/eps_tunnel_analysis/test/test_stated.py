# SPDX-License-Identifier: Apache-2.0
"""How far values may be from what a model states."""

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.stated import residual_of, strain_of, weight_of

OFF = np.array([-30.0, -2.0, -0.3, 0.0, 0.1, 1.0, 4.0, 50.0])


def test_near_what_is_stated_it_is_as_a_gaussian_and_far_away_hardly_more_unlikely() -> None:
    near, far, farther = strain_of(np.array([1.0, 50.0, 100.0]))
    assert near == pytest.approx(1.0, abs=0.2)
    assert farther - far < 8.0 < 2500.0


def test_its_residuals_add_up_to_it_and_point_away_from_what_is_stated() -> None:
    assert residual_of(OFF) ** 2 == pytest.approx(strain_of(OFF))
    assert np.array_equal(np.sign(residual_of(OFF)), np.sign(OFF))


def test_a_value_is_held_as_firmly_as_the_slope_says() -> None:
    slope = (strain_of(OFF + 1e-5) - strain_of(OFF - 1e-5)) / 2e-5
    assert weight_of(OFF) * OFF == pytest.approx(0.5 * slope, rel=1e-5)
