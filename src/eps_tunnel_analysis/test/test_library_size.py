# SPDX-License-Identifier: Apache-2.0
"""A descent takes the same path whatever else the library has: candidates that it does not fit weigh nothing."""

import numpy as np
from fit_cases import search_on_x

from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search

FEW = ("load_friction",)
MANY = (*FEW, "directional_load_friction", "sensor_lag", "sensor_gain", "dead_band", "backlash")
STARTED = {"drive.x.p": 15.0, "drive.x.delay": 0.02}


def descended(search: Search) -> Refit:
    """After two rounds, from values that are off."""
    values = dict(zip(search.library.names, search.start, strict=True)) | STARTED
    return search.refit([((), np.array(list(values.values())))], 2)[0]


def test_a_larger_library_does_not_change_the_path_of_a_descent() -> None:
    few, many = search_on_x(FEW), search_on_x(MANY)
    assert len(many.start) > len(few.start) + 5
    one, other = descended(few), descended(many)
    base = len(few.library.base)
    assert one.steps is not None and other.steps is not None
    assert np.array_equal(one.values[:base], other.values[:base])
    assert np.array_equal(one.steps[:base], other.steps[:base])
    assert one.objective == other.objective
