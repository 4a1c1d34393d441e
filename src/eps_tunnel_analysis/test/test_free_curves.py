# SPDX-License-Identifier: Apache-2.0
"""Free curves as rivals of sums of named effects."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose import axis as axis_module
from eps_tunnel_analysis.diagnose.axis import diagnose_axis, hypothesis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_search
from eps_tunnel_analysis.diagnose.base_values import base_refit
from eps_tunnel_analysis.diagnose.doubts import notes_of
from eps_tunnel_analysis.diagnose.free_curves import free_curves, imitated
from eps_tunnel_analysis.diagnose.rank import UNKNOWN
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Trials

PART = AxisPart(("pendulum",), ("pendulum",), ("drive.pendulum.kp",))
NAMED = SearchOptions(("coulomb_friction", "viscous_friction"), 1)
Force = Callable[[Live, Site], np.ndarray]


def bare() -> Model:
    """A pendulum without friction."""
    model = load_model("pendulum")
    return model.without_effect("coulomb_friction", "pendulum").without_effect("viscous_friction", "pendulum")


def hiding(force: Force) -> Model:
    """A pendulum with a force that no effect of the library has."""

    def step(live: Live, site: Site, values: Values) -> None:
        live.applied[:, site.dof] += values["size"] * force(live, site)

    size = Parameter("size", "N m", 0.0, 10.0, 0.0, 1.0, "")
    effect = Effect("hidden_force", "", "", "", (size,), "force", "", "offset", (), "", step=step)
    return bare().with_effect(effect, "pendulum")


def drag(live: Live, site: Site) -> np.ndarray:
    speed = live.qvel[:, site.dof]
    return np.asarray(-0.004 * speed * np.abs(speed))


def waves(live: Live, site: Site) -> np.ndarray:
    return np.asarray(0.01 * np.sin(3.0 * live.qpos[:, site.qpos]))


def played(model: Model) -> Play:
    t = np.arange(401) * 0.01
    command = (np.sin(2 * np.pi * 0.4 * t) + 0.4 * np.sin(2 * np.pi * 1.1 * t))[:, None]
    clean = simulate(model, t, command)
    noise = np.random.default_rng(1).normal(size=(3, *clean.values.shape[1:]))
    block = np.repeat(command[None], 3, axis=0)
    values = clean.values + 1e-3 * noise
    return Play("sines", Trials(clean.time, clean.signals, clean.units, values, clean.command_channels, block))


def searched(play: Play) -> tuple[Search, Refit]:
    search = axis_search(bare(), [play], PART, NAMED)
    return search, base_refit(search)


@pytest.mark.parametrize(
    ("force", "curve"),
    [pytest.param(drag, "curve_speed.pendulum", marks=pytest.mark.study), (waves, "curve_angle.pendulum")],
)
def test_the_curve_over_what_a_force_depends_on_leaves_little(force: Force, curve: str) -> None:
    play = played(hiding(force))
    search, base = searched(play)
    before = search.evaluations
    over, refits = free_curves(search, base, bare(), [play], PART)
    assert refits[0].effects == (curve,)
    assert base.cost > 50.0 and refits[0].cost < 0.05 * base.cost
    assert search.evaluations > before
    judged = hypothesis(over, refits[0])
    assert judged.cost < 0.1 * base.cost and len(judged.left_out) == len(base.residuals)


def test_the_search_over_curves_leaves_of_the_base_what_the_search_of_names_leaves() -> None:
    play = played(hiding(drag))
    search, base = searched(play)
    over, refits = free_curves(search, base, bare(), [play], PART)
    start = np.concatenate([base.values[:1], over.start[1:]])
    for level in ("coarse", "fine", "exact"):
        there = over.residuals(start[None], level)[0]
        assert there == pytest.approx(search.residuals(base.values[None], level)[0], abs=1e-9)
    assert np.array_equal(over.folds, search.folds) and np.array_equal(over.signal, search.signal)
    assert refits[0].free == 1 + 10


def test_only_a_sum_that_leaves_more_than_noise_may_be_an_imitation() -> None:
    search, base = searched(played(hiding(drag)))
    one, two = replace(base, effects=("a.x",)), replace(base, effects=("a.x", "b.x"))
    assert [imitated(r, search) for r in (base, one, two)] == [False, False, True]
    assert not imitated(replace(two, residuals=0.01 * two.residuals), search)


@pytest.mark.study
def test_what_a_curve_explains_where_names_only_imitate_it_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(axis_module, "imitated", lambda refit, search: True)
    play = played(hiding(drag))
    found = diagnose_axis(bare(), [play], PART, SearchOptions(("constant_torque",), 1))
    assert found.ranking.probabilities[UNKNOWN] > 0.9
    assert found.ranking.unknown_but == "curve_speed.pendulum"
    notes = notes_of(bare(), [PART], [PART], [play], [found])
    assert sum(note.startswith("One torque over speed on pendulum, as a free curve") for note in notes) == 1
    monkeypatch.setattr(axis_module, "imitated", lambda refit, search: False)
    assert diagnose_axis(bare(), [play], PART, SearchOptions(("constant_torque",), 1)).ranking.unknown_but is None
