# SPDX-License-Identifier: Apache-2.0
"""Terms tried by themselves in roll-outs."""

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.law.depends import Dependence, Depends
from eps_tunnel_analysis.law.design import Design
from eps_tunnel_analysis.law.formula import Dictionary, dictionaries
from eps_tunnel_analysis.law.missing_force import missing_force
from eps_tunnel_analysis.law.single_terms import single_terms
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Trials

MORE = 0.03  # N m of dry friction, that the rig has and the model does not
SECONDS = 3.0
PERIOD = 0.13  # rad, of waves that the rig has and the model does not
PART = AxisPart(("pendulum",), ("pendulum",), ("viscous_friction.pendulum.damping",))


@pytest.fixture(scope="module")
def model() -> Model:
    """One whose viscous friction makes up for a part of what is missing."""
    return load_model("pendulum").with_values({"viscous_friction.pendulum.damping": 0.03}, "refitted")


def recorded(rig: Model) -> Play:
    """Three trials of two sines."""
    t = np.arange(round(SECONDS / 0.01) + 1) * 0.01
    command = (np.sin(2 * np.pi * 0.4 * t) + 0.4 * np.sin(2 * np.pi * 1.1 * t))[:, None]
    clean = simulate(rig, t, command)
    values = clean.values + 1e-3 * np.random.default_rng(1).normal(size=(3, *clean.values.shape[1:]))
    block = np.repeat(command[None], 3, axis=0)
    return Play("sines", Trials(clean.time, clean.signals, clean.units, values, clean.command_channels, block))


@pytest.fixture(scope="module")
def play() -> Play:
    return recorded(load_model("pendulum").with_values({"coulomb_friction.pendulum.torque": 0.02 + MORE}, "its own"))


def waves(live: Live, site: Site, values: Values) -> None:
    live.applied[:, site.dof] += values["size"] * np.sin(2 * np.pi * live.qpos[:, site.qpos] / PERIOD)


WAVES = Effect(
    "waves", "Waves", "Hidden in the rig.", "torque = A sin(2 pi angle / L)",
    (Parameter("size", "N m", 0.0, 1.0, 0.0, 0.05, "0 to what holds the pendulum"),),
    stage="force", mark="The axis rests at even distances.", shows="by_angle", confused_with=(), separated_by="",
    step=waves,
)  # fmt: skip


def some(design: Design, *names: str) -> list[Dictionary]:
    """Few terms of a force: each is compiled by itself."""
    force, *_ = dictionaries(design, ["pendulum"])
    return [(force[0], force[1], [term for term in force[2] if term.name in names])]


def over(variable: str, curve: str, chance: float) -> Dependence:
    """What the linear problem does not name."""
    return Dependence(variable, curve, "pendulum", 0.0, (0.0, 0.0), chance, named=False)


def test_the_term_that_is_missing_is_named_where_the_linear_problem_does_not_name_it(model: Model, play: Play) -> None:
    """Of the angle nothing is said: it must explain more than chance, which explains everything here."""
    design = Design.of(missing_force(model, [play], PART, 1))
    unnamed = Depends((over("angle", "curve_angle", 1.0), over("speed", "curve_speed", 0.5)))
    words = some(design, "spring", "friction", "stribeck", "load")
    (way, law), *others = single_terms(design, unnamed, model, [play], PART, words, nthread=1)
    assert (way.variable, way.acts, way.named) == ("speed", ("pendulum", "force"), True)
    assert way.share == law.share > 0.9 and law.interval[0] > 0.8
    assert law.terms[0].term.name in ("friction", "stribeck")
    assert law.terms[0].values["size"] == pytest.approx(MORE, rel=0.1)
    assert {other.variable for other, _ in others} <= {"speed"}


@pytest.mark.study
def test_waves_are_found_though_the_linear_problem_finds_no_period(model: Model) -> None:
    rig = load_model("pendulum").with_effect(WAVES, "pendulum", {"size": 0.06})
    play = recorded(rig)
    design = Design.of(missing_force(model, [play], PART, 1))
    unnamed = Depends((over("angle", "curve_angle", 0.5), over("speed", "curve_speed", 1.0)))
    words = some(design, "spring", "wave", "friction", "tight")
    (way, law), *_ = single_terms(design, unnamed, model, [play], PART, words, nthread=1)
    assert (way.variable, way.acts, law.share > 0.9) == ("angle", ("pendulum", "force"), True)
    assert law.terms[0].term.name == "wave"
    assert abs(law.terms[0].values["period"]) == pytest.approx(PERIOD, rel=0.01)
    assert abs(law.terms[0].values["size"]) == pytest.approx(0.06, rel=0.1)
