# SPDX-License-Identifier: Apache-2.0
"""A descent takes the same path whatever else the library has: candidates that it does not fit weigh nothing."""

import numpy as np
import pytest
from fit_cases import TRUTH, plays, start

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.recorded_play import Play

FEW = ("load_friction",)
MANY = (*FEW, "directional_load_friction", "sensor_lag", "sensor_gain", "dead_band", "backlash")
STARTED = {"drive.x.p": 15.0, "drive.x.delay": 0.02}


@pytest.fixture(scope="module")
def recorded() -> list[Play]:
    return plays((3.0, -2.0), TRUTH)


def searched(recorded: list[Play], effects: tuple[str, ...]) -> Search:
    model = start().with_values(TRUTH)
    part = next(p for p in axis_parts(model, recorded) if p.name == "x")
    return axis_search(model, recorded, part, SearchOptions(effects, 1))


def descended(search: Search) -> Refit:
    """After two rounds, from values that are off."""
    values = dict(zip(search.library.names, search.start, strict=True)) | STARTED
    return search.refit([((), np.array(list(values.values())))], 2)[0]


def test_a_larger_library_does_not_change_the_path_of_a_descent(recorded: list[Play]) -> None:
    few, many = (searched(recorded, effects) for effects in (FEW, MANY))
    assert len(many.start) > len(few.start) + 5
    one, other = descended(few), descended(many)
    base = len(few.library.base)
    assert one.steps is not None and other.steps is not None
    assert np.array_equal(one.values[:base], other.values[:base])
    assert np.array_equal(one.steps[:base], other.steps[:base])
    assert one.objective == other.objective
