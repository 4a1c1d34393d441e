# SPDX-License-Identifier: Apache-2.0
"""Effects that act by events, in roll-outs that are held near the measured motion."""

from collections.abc import Mapping

import numpy as np
import pytest
from distributed.protocol.pickle import dumps, loads
from fit_cases import TRUTH, made_by, start, step

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.guided import HOLDS, event_refits, firmly, held_near
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.recorded_play import Play

CUT = {"share": 0.1, "bound": 0.15, "time": 0.03}


def searched(effect: str, values: Mapping[str, float] | None, *only: str) -> Search:
    """For what a rig with an effect on x leaves to a model that lacks it."""
    model = start().with_values(TRUTH)
    rig = model.with_effect(effect, "x", values)
    commands = np.concatenate([step(8.0), step(-6.0), step(1.0), step(-9.0)])
    plays = [Play("steps", made_by(rig, commands))]
    part = next(p for p in axis_parts(model, plays) if p.name == "x")
    return axis_search(model, plays, part, SearchOptions(only, 1))


@pytest.fixture(scope="module")
def search() -> Search:
    return searched("duty_cut_back", CUT, "duty_cut_back.x")


def bare(search: Search) -> Refit:
    """The model as it is, with the values of its drive as they are on the rig."""
    residuals = search.residuals(search.start[None])[0]
    return Refit((), search.start, residuals, float(np.mean(residuals**2)), 0, True)


def test_the_firmer_it_is_held_the_nearer_it_stays_to_the_measured_motion(search: Search) -> None:
    refit = bare(search)
    held = held_near(search, refit)

    def off(rate: float) -> float:
        seen = firmly(held, rate)(refit.values[None])[0, search.used]
        return float(np.sqrt(np.mean((seen / search.scale) ** 2)))

    free = np.sqrt(refit.cost)
    left = [off(rate) for rate in (0.0, *sorted(set(HOLDS)))]
    assert left[0] == pytest.approx(free, rel=0.05)
    assert (np.diff(left) < 0.0).all()
    assert left[-1] < 0.8 * free


def test_what_is_sent_elsewhere_is_held_near_the_same_motion(search: Search) -> None:
    held = held_near(search, bare(search))
    values = search.start[None]
    assert np.array_equal(loads(dumps(held))(values), held(values))


@pytest.mark.study
def test_a_cut_back_is_found_with_its_values(search: Search) -> None:
    (candidate,) = search.library.candidates
    refit = bare(search)
    (without,) = search.refit([((), refit.values)], 12, "exact")
    found = min(event_refits(search, [refit], 1.6), key=lambda r: r.cost)
    assert found.effects == ("duty_cut_back.x",)
    assert found.cost < 0.1 * without.cost
    share, _, time = found.values[search.columns(candidate)]
    assert share == pytest.approx(CUT["share"], abs=0.02)
    assert time == pytest.approx(CUT["time"], abs=0.01)


@pytest.mark.study
def test_what_is_no_event_is_given_up_under_the_firmest_hold() -> None:
    search = searched("constant_torque", None, "duty_cut_back.x")
    refit = bare(search)
    assert refit.cost > 20.0
    before = search.evaluations
    assert event_refits(search, [refit], 1.6) == []
    assert 0 < search.evaluations - before < 1000
    assert event_refits(search, [refit], 1.1 * refit.cost) == [], "little enough is left"
