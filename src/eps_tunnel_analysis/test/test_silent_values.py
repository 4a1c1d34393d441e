# SPDX-License-Identifier: Apache-2.0
"""Values of an effect that lie at a bound or show nothing where a descent left them: a limit that is not reached."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from fit_cases import TRUTH, made_by, part_search, start

from eps_tunnel_analysis.diagnose.contained import with_fewer_again
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.recorded_play import Play

PROFILE, LIMIT = "motion_profile.x", "rate_limit.x"  # the first contains the second
REAL = {"acceleration": 6.0, "speed": 0.15}  # rad/s^2, rad/s; only the larger steps reach that speed


@pytest.fixture(scope="module")
def search() -> Search:
    model = start().with_values(TRUTH)
    commands = np.zeros((241, 2))
    commands[1:, 0] = np.radians(np.repeat([3.0, -2.0, 4.0, 0.0, -4.0, 4.0], 40))
    recorded = [Play("steps", made_by(model.with_effect("motion_profile", "x", REAL), commands))]
    return part_search(model, recorded, ("motion_profile", "rate_limit"))


def profiled(search: Search, **given: float) -> Refit:
    """The best refit of the profile from these of its values."""
    candidate = search.library.find(PROFILE)
    values = search.start.copy()
    values[search.columns(candidate)] = [given[name] for name in REAL]
    return search.refit([((candidate,), values)], 8)[0]


def own_values(search: Search, refits: Sequence[Refit]) -> list[float]:
    return [float(v) for r in refits for v in r.values[search.columns(search.library.find(PROFILE))]]


def test_a_limit_that_a_descent_never_reached_is_looked_for_over_its_whole_range(search: Search) -> None:
    stuck = profiled(search, acceleration=4.0, speed=200.0)
    assert own_values(search, [stuck])[1] == 200.0 and stuck.cost > 5.0  # it has no slope there
    found = search.best_of([(search.library.of([PROFILE]), stuck.values)], 8)
    assert own_values(search, found)[1] == pytest.approx(REAL["speed"], rel=0.05)
    assert found[0].cost < 2.0  # delay and damping make up for some of the acceleration


def test_where_only_noise_is_left_or_every_value_shows_nothing_is_looked_for(search: Search) -> None:
    right = profiled(search, **REAL)
    before = search.evaluations
    assert search._awakened([right], 8) == []
    assert search.evaluations == before
    assert search._awakened([replace(right, cost=10.0)], 8) == []
    assert search.evaluations == before + 2  # one roll-out for each of its values


def test_a_general_form_takes_over_what_it_had_left_to_a_simple_one(search: Search) -> None:
    base, stuck = search.refit([((), search.start)], 3)[0], profiled(search, acceleration=4.0, speed=200.0)
    values = profiled(search, **REAL).values.copy()
    values[search.columns(search.library.find(PROFILE))[1]] = 200.0
    values[search.columns(search.library.find(LIMIT))] = REAL["speed"]
    (both,) = search.refit([(search.library.of([PROFILE, LIMIT]), values)], 12)
    assert both.cost < 0.5 * stuck.cost
    found = {r.effects: r for r in with_fewer_again(search, base, [both, stuck])[1]}[(PROFILE,)]
    assert own_values(search, [found])[1] == pytest.approx(REAL["speed"], rel=0.05)
    assert found.cost < 0.5 * stuck.cost
