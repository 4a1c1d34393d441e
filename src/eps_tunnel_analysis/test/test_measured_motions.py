# SPDX-License-Identifier: Apache-2.0
"""Joints that move as they were measured while another one is looked at."""

from dataclasses import replace

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.base_values import Bases, base_refit
from eps_tunnel_analysis.diagnose.experiment import menu, was_played
from eps_tunnel_analysis.diagnose.prescribed import coupled_with, measured_motions, smooth
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.prescribed import prescribed
from labyrinth_sim.simulate import simulate

NOISE = 2e-4  # rad


@pytest.fixture(scope="module")
def arm() -> Model:
    return load_model("two_link_arm")


@pytest.fixture(scope="module")
def rubbing(arm: Model) -> Play:
    """Both joints at once, with friction in the shoulder, of which the model knows nothing."""
    time = np.arange(301) * 0.01
    commands = np.column_stack([0.4 * np.sin(4.0 * time), -0.5 * np.sin(6.0 * time) + 0.2 * (time % 1.0 > 0.5)])
    commands[time < 0.2] = 0.0
    run = simulate(arm.with_effect("coulomb_friction", "shoulder"), time, commands, timestep=2.5e-4)
    run = run.select([s for s, unit in zip(run.signals, run.units, strict=True) if unit == "rad"])
    noise = NOISE * np.random.default_rng(3).standard_normal((3, *run.values.shape[1:]))
    commands = np.repeat(run.commands, 3, axis=0)
    return Play("both", replace(run, values=np.repeat(run.values, 3, axis=0) + noise, commands=commands))


def left(model: Model, play: Play, part: AxisPart, bases: Bases) -> float:
    """Floors that refitted base values leave on a part."""
    search = axis_search(*bases.among(model, [play], part), part, SearchOptions((), 1))
    return base_refit(search, roughly=True).cost


@pytest.fixture
def elbow(arm: Model, rubbing: Play) -> AxisPart:
    return axis_parts(arm, [rubbing])[1]


@pytest.mark.study
def test_a_joint_is_not_disturbed_by_a_model_that_is_far_off_about_the_next(
    arm: Model, rubbing: Play, elbow: AxisPart
) -> None:
    """The shoulder gives way four times as far as it does on the rig, and has friction besides."""
    weak = arm.with_values({"drive.shoulder.stiffness": 30.0})
    assert left(weak, rubbing, elbow, Bases()) > 5.0
    assert left(weak, rubbing, elbow, Bases(motions=measured_motions(weak, [rubbing]))) < 1.0


def test_effects_between_joints_are_no_candidates_where_one_of_them_is_prescribed(
    arm: Model, rubbing: Play, elbow: AxisPart
) -> None:
    run = SearchOptions(None, 1)
    for bases, between in ((Bases(), True), (Bases(motions=measured_motions(arm, [rubbing])), False)):
        model, plays = bases.among(arm, [rubbing], elbow)
        assert bool(prescribed(model)) != between
        names = {c.effect.name for c in axis_search(model, plays, elbow, run).library.candidates}
        assert ("cross_coupling" in names) == between
        assert "coulomb_friction" in names


def test_a_command_counts_as_played_by_what_the_joint_itself_was_told(arm: Model, elbow: AxisPart) -> None:
    command = next(c for name, c in menu(arm, "elbow").items() if name.startswith("steps_together_elbow"))
    time, targets = command.sample(100.0)
    run = simulate(arm, time, targets)
    run = run.select([s for s, unit in zip(run.signals, run.units, strict=True) if unit == "rad"])
    play = Play("steps", replace(run, values=np.repeat(run.values, 2, axis=0), commands=np.repeat(run.commands, 2, 0)))
    model, plays = Bases(motions=measured_motions(arm, [play])).among(arm, [play], elbow)
    evidence = axis_search(model, plays, elbow, SearchOptions((), 1)).evidence
    assert prescribed(model) == ("shoulder",)
    assert [name for name, other in menu(arm, "elbow").items() if was_played(evidence, other)] == [command.name]


def test_axes_that_do_not_feel_one_another_are_not_prescribed() -> None:
    model = load_model("labyrinth")
    assert coupled_with(model, ["x"]) == ()
    assert coupled_with(load_model("two_link_arm"), ["elbow"]) == ("shoulder",)


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_a_smooth_curve_keeps_the_motion_and_drops_the_noise(noise: float) -> None:
    time = np.arange(400) * 0.01
    truth = 0.02 * np.sin(15.0 * time) + 0.01 * np.tanh(np.sin(4.0 * time) / 0.2)
    seen = truth + noise * np.random.default_rng(1).standard_normal(len(time))
    off = smooth(time, seen)(time) - truth
    assert np.sqrt(np.mean(off**2)) < 0.8 * noise + 2e-4


def test_of_a_few_measurements_only_their_mean_is_told() -> None:
    time = np.arange(5) * 0.1
    assert smooth(time, np.array([1.0, 2.0, 3.0, 4.0, 5.0]))(time) == pytest.approx(3.0)
