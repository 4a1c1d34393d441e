# SPDX-License-Identifier: Apache-2.0
"""Effects that are of one kind or another, as a sensor's filter is: each kind is tried, and none is between them."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import TRUTH, made_by, start
from rank_cases import FOLDS, SAMPLES, hypothesis

from eps_tunnel_analysis.diagnose.axis import hypothesis as predicting
from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.base_values import base_refit
from eps_tunnel_analysis.diagnose.rank import rank
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.sets import next_refits
from eps_tunnel_analysis.recorded_play import Play


@pytest.fixture
def search() -> Search:
    """Of sensors that lag, on plays of a rig whose finest sensor is averaged over 80 ms."""
    model = start().with_values(TRUTH)
    signal = model.rig.positions[0]
    rig = model.with_effect("sensor_lag", signal, {"time_constant": 0.04, "averaged": 1.0})
    commands = np.zeros((201, 2))
    commands[1:, 0] = np.radians(np.repeat([3.0, -2.0, 4.0, 0.0, -3.0, 1.0, 2.0, -4.0], 25))
    recorded = [Play("steps", made_by(rig, commands, noise=5e-5))]
    part = next(p for p in axis_parts(model, recorded) if signal in p.signals)
    return axis_search(model, recorded, part, SearchOptions(("sensor_lag",), 1))


def test_the_kind_that_acts_is_found_and_stays_as_it_is(search: Search) -> None:
    (name,) = (c.name for c in search.library.candidates if c.place == search.library.model.rig.positions[0])
    base = base_refit(search)
    found = next_refits(search, [base])[0]
    assert found.effects == (name,)
    late, kind = found.values[search.columns(search.library.find(name))]
    assert kind == 1.0 and late == pytest.approx(0.04, rel=0.05)
    assert found.cost < 2.0
    other = found.values.copy()
    other[search.columns(search.library.find(name))[1]] = 0.0
    (wrong,) = search.refit([(search.library.of(found.effects), other)], 6)
    assert wrong.cost > 1.5 * found.cost and wrong.values[search.columns(search.library.find(name))[1]] == 0.0
    assert predicting(search, found).kinds == 2 and found.free == len(search.fitted(base)) + 1


def test_of_two_that_fit_alike_the_one_of_two_kinds_is_half_as_likely_for_each() -> None:
    noise = np.random.default_rng(0).standard_normal(SAMPLES)
    both = [hypothesis([name], noise) for name in ("a.x", "b.x")]
    both[1] = replace(both[1], kinds=2)
    folds = np.arange(SAMPLES) * FOLDS // SAMPLES
    found = rank(hypothesis([], 10.0 * noise), both, folds, np.zeros(SAMPLES, np.int64), tried=10).probabilities
    assert found["a.x"] / found["b.x"] == pytest.approx(2.0, rel=0.01)
