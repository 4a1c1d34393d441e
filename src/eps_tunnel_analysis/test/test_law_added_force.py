# SPDX-License-Identifier: Apache-2.0
"""Forces over time, what an axis goes through, and free curves as candidates."""

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.added_force import Playing, visited
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, search_of
from eps_tunnel_analysis.diagnose.candidates import Library, library, with_curves
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Trials

STEP = 0.01
SIGNALS = ("motor_x", "board_x")


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("labyrinth_manual")


def played(model: Model, noise: float = 1e-4) -> Play:
    """Two seconds of a slow and a quick motion of both axes, three trials."""
    t = np.arange(201) * STEP
    x = 0.06 * np.sin(2 * np.pi * 1.0 * t)
    commands = np.stack([x, 0.05 * np.sin(2 * np.pi * 1.7 * t)], axis=1)
    clean = simulate(model, t, commands)
    rng = np.random.default_rng(3)
    values = np.repeat(clean.values, 3, axis=0)
    values = values + noise * rng.normal(size=values.shape)
    trials = Trials(clean.time, clean.signals, clean.units, values, clean.command_channels,
                    np.repeat(commands[None], 3, axis=0))  # fmt: skip
    return Play("sines", trials)


def test_a_constant_force_over_time_is_a_constant_torque(model: Model) -> None:
    play = played(model)
    playing = Playing(model, [play], "x", SIGNALS)
    table = np.zeros((2, playing.count(0)))
    table[1] = 0.05
    nothing, pushed = playing.residuals(0, table)
    same = Playing(model.with_effect("constant_torque", "x", {"torque": 0.05}), [play], "x", SIGNALS)
    assert np.array_equal(pushed, same.residuals(0, table[:1])[0])
    assert np.sqrt(np.mean(nothing**2)) < 2e-4 < np.abs(pushed).max()


@pytest.mark.parametrize("at_load", [False, True])
def test_each_simulation_gets_its_own_row_step_by_step(model: Model, at_load: bool) -> None:
    playing = Playing(model, [played(model)], "x", SIGNALS, at_load=at_load)
    count = playing.count(0)
    table = np.zeros((3, count))
    table[1, count // 2 :] = table[2] = 0.05
    nothing, later, always = playing.residuals(0, table)
    time = playing.evidence[0].time
    before = time < playing.evidence[0].times(0)[count // 2] - 2 * STEP  # samples are read between steps
    assert np.array_equal(later[before], nothing[before]) and not np.array_equal(always[before], nothing[before])
    assert np.abs(later - nothing)[~before].max() > 1e-3
    assert np.array_equal(playing.residuals(0, table[1:2])[0], later)
    assert playing.motion(0, table[1]).angle[count // 2 - 1] == playing.motion(0).angle[count // 2 - 1]


def test_the_motion_is_that_of_the_roll_out(model: Model) -> None:
    playing = Playing(model, [played(model)], "x", SIGNALS)
    motion = playing.motion(0)
    assert np.gradient(motion.angle, motion.time)[10:-10] == pytest.approx(motion.speed[10:-10], abs=0.02)
    turns = np.flatnonzero(np.diff(motion.direction[100:]) != 0) + 101  # sines reverse twice a period
    assert np.diff(motion.time[turns]) == pytest.approx(0.5, abs=0.02)
    assert motion.since[turns] == pytest.approx(0.0)
    assert motion.since.max() < 0.55


def test_free_curves_are_candidates_only_when_asked_for(model: Model) -> None:
    play = played(model.with_effect("return_spring", "x", {"stiffness": 2.0}))
    assert not any(c.effect.nameless for c in library(model, ()).candidates)
    spans = visited([Playing(model, [play], "x", SIGNALS).motion(0)])
    assert set(spans) >= {"curve_angle", "curve_other"}
    assert spans["curve_angle"]["half"] == pytest.approx(0.06, rel=0.1)
    lib = with_curves(Library(model, (), ()), {("curve_angle", "x"): spans["curve_angle"]})
    search = search_of(lib, [play], AxisPart(("x",), SIGNALS, ()), SearchOptions())
    curve = lib.find("curve_angle.x")
    assert set(lib.names) == {f"curve_angle.x.k{i + 1}" for i in range(10)}
    refit = search.refit([((curve,), search.start)], 4)[0]
    before = search.refit([((), search.start)], 1)[0]
    assert refit.cost < 0.1 * before.cost
    knots = dict(zip(lib.names, refit.values, strict=True))
    # A spring on the load is nearly one on the motor; what is left is how it stretches the belt.
    assert knots["curve_angle.x.k3"] - knots["curve_angle.x.k8"] == pytest.approx(
        2.0 * spans["curve_angle"]["half"] * 10 / 9, rel=0.3
    )
