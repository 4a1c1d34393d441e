# SPDX-License-Identifier: Apache-2.0
"""Dry friction of the model that sets in gradually on the rig."""

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search, rough_values
from eps_tunnel_analysis.diagnose.base_values import GRADUAL, base_refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Trials

STEP, NOISE, SLOW = 0.01, 2e-4, "coulomb_friction.pendulum.slow"


@pytest.fixture(params=[0.0, 2e-3])
def slow(request: pytest.FixtureRequest) -> float:
    return float(request.param)


@pytest.fixture
def search(slow: float) -> Search:
    """The base alone of a pendulum whose friction sets in over this speed, in rad/s."""
    model = load_model("pendulum")
    time = np.arange(501) * STEP
    command = 0.3 * np.round(1.5 * np.sin(2 * np.pi * 0.35 * time))[:, None]
    clean = simulate(model.with_values({SLOW: slow}), time, command)
    values = clean.values + NOISE * np.random.default_rng(1).normal(size=(3, *clean.values.shape[1:]))
    commands = np.repeat(command[None], 3, axis=0)
    play = Play("steps", Trials(clean.time, clean.signals, clean.units, values, clean.command_channels, commands))
    (part,) = axis_parts(model, [play])
    return axis_search(model, [play], part, SearchOptions((), 1))


@pytest.mark.study
def test_how_gradually_the_models_friction_sets_in_is_refitted_where_it_shows(search: Search, slow: float) -> None:
    column = search.library.names.index(SLOW)
    base = base_refit(search)
    assert base.values[column] == pytest.approx(slow, rel=0.5, abs=1e-9)
    assert (column in search.fitted(base)) == (slow > 0.0)


@pytest.mark.parametrize("slow", [2e-3], indirect=True)
def test_where_longer_steps_mislead_a_descent_takes_those_that_judge(search: Search, slow: float) -> None:
    search.levels["exact"] = search.levels["exact"].finer()
    sharp = search.judged([((), search.start)], 8)[0]
    search.sharp = np.zeros_like(search.sharp)
    begun = sharp.values.copy()
    begun[search.library.names.index(SLOW)] = GRADUAL
    (found,) = search.judged([((), begun)], 8)
    (alone,) = search.refit([((), begun)], 8, "exact")
    assert np.allclose(found.residuals, search.residuals(found.values[None], "exact")[0])
    assert found.cost == alone.cost < 0.6 * sharp.cost


def test_every_dry_friction_of_a_model_may_set_in_gradually() -> None:
    model = load_model("pendulum").with_effect("direction_friction", "pendulum")
    (axis,) = model.rig.axes
    dry = [name for name in rough_values(model, axis) if name.endswith(".slow")]
    assert dry == [SLOW, SLOW.replace("coulomb", "direction")]
