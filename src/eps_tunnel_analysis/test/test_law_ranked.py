# SPDX-License-Identifier: Apache-2.0
"""How a formula is chosen among sets of terms, what it is ranked with, and what else is missing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.added_force import Forces
from eps_tunnel_analysis.diagnose.axis import diagnose_axis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law import proposal
from eps_tunnel_analysis.law.depends import Depends, depends
from eps_tunnel_analysis.law.formula import Formula
from eps_tunnel_analysis.law.missing_force import missing_force, missing_offset
from eps_tunnel_analysis.law.proposal import NAME, Proposal, also_missing, propose
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.report.law_section import law
from eps_tunnel_analysis.report.page import render
from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Trials

STEP, NOISE = 0.01, 1e-3
PART = AxisPart(("pendulum",), ("pendulum",), ())
SIGNALS = {"x": ("motor_x", "board_x"), "y": ("motor_y", "board_y")}
PARTS = {name: AxisPart((name,), signals, ()) for name, signals in SIGNALS.items()}


def played(model: Model, command: np.ndarray, seed: int, noise: float = NOISE) -> Play:
    """Three trials of a command (T, u), with the noise of an encoder."""
    clean = simulate(model, np.arange(len(command)) * STEP, command)
    drawn = np.random.default_rng(seed).normal(size=(3, *clean.values.shape[1:]))
    values, commands = clean.values + noise * drawn, np.repeat(command[None], 3, axis=0)
    return Play("sines", Trials(clean.time, clean.signals, clean.units, values, clean.command_channels, commands))


def sines(seconds: float = 4.0) -> np.ndarray:
    t = np.arange(round(seconds / STEP) + 1) * STEP
    return (np.sin(2 * np.pi * 0.4 * t) + 0.4 * np.sin(2 * np.pi * 1.1 * t))[:, None]


def two_forces(live: Live, site: Site, values: Values) -> None:
    angle, speed = live.qpos[:, site.qpos], live.qvel[:, site.dof]
    live.applied[:, site.dof] += values["size"] * (np.sin(2 * np.pi * angle / 0.35) - 0.05 * speed * np.abs(speed))


TWO = Effect(
    "two_forces", "", "", "", (Parameter("size", "N m", 0.0, 1.0, 0.0, 0.03, ""),), "force", "", "by_angle", (), "",
    step=two_forces,
)  # fmt: skip


@pytest.mark.study
def test_sets_of_one_and_more_terms_are_refitted_and_the_best_is_ranked_beside_known_effects() -> None:
    model = load_model("pendulum")
    plays = [played(model.with_effect(TWO, "pendulum"), sines(), 1)]
    beside = diagnose_axis(model, plays, PART, SearchOptions(("return_spring.pendulum",), 1))
    found = propose(model, plays, PART, nthread=1, beside=beside)
    assert found.refit is not None and {e.count(" + ") for e in found.tried if "phase" in e} >= {1, 2}
    # Longer ones leave less by chance, less than half a floor less.
    assert found.refit.held_out <= min(found.tried.values()) + SETTINGS.material
    assert [c.term.name for c in found.formula.terms] == ["wave", "drag"]
    assert found.ranked["return_spring.pendulum"] < 0.05 < 0.9 < found.probability
    assert found.probability == found.ranked[f"{NAME}.pendulum"]
    assert "Ranked with 1 set" in found.sentence and found.to_json()["probability"] == found.probability
    assert found.to_json()["terms"][0]["units"] == {"size": "N m", "period": "rad", "phase": "rad"}


@pytest.fixture(scope="module")
def labyrinth() -> Model:
    return load_model("labyrinth_manual")


@pytest.fixture(scope="module")
def sticking(labyrinth: Model) -> Model:
    return labyrinth.with_effect("coulomb_friction", "x", {"torque": 0.4})


def alone(axis: str, rate: float) -> np.ndarray:
    """(T, 2) rad: 4 s of a sine on one axis, in Hz, while the other rests."""
    t = np.arange(0.0, 4.0 + STEP / 2, STEP)
    command = np.zeros((len(t), 2))
    command[:, list(PARTS).index(axis)] = 0.05 * np.sin(2 * np.pi * rate * t)
    return command


@pytest.mark.study
def test_between_a_force_and_the_error_of_a_sensor_roll_outs_decide(
    labyrinth: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tied(*args: Any, **options: Any) -> Depends:
        found = depends(*args, **options)
        force = next(d for d in found.dependences if d.acts == ("y", "force") and d.curve == "curve_angle")
        assert found.first is not None and found.first.acts == ("board_y", "sensor")
        return replace(found, first=force, ties=(found.first,))

    wrong = labyrinth.with_effect("sensor_gain", "board_y", {"gain": 1.04})
    monkeypatch.setattr(proposal, "depends", tied)
    found = propose(labyrinth, [played(wrong, alone("y", 0.25), 3, 2e-4)], PARTS["y"], nthread=1)
    assert found.place == "board_y" and found.equation == "g angle" and found.effect == f"{NAME}.board_y"
    assert found.depends.first is not None and found.depends.first.of_sensor and not found.depends.ties
    assert "g angle, read by board_y" in found.tried and len(found.tried) > 1
    assert found.curve_units == ("rad", "rad")


def both(seconds: float = 2.0) -> np.ndarray:
    t = np.arange(round(seconds / STEP) + 1) * STEP
    return np.stack([0.06 * np.sin(2 * np.pi * t), 0.05 * np.sin(2 * np.pi * 1.7 * t)], axis=1)


def pushed(model: Model, axis: str, at_load: bool, torque: float) -> Play:
    """What is recorded while a constant torque acts on one side of an axis."""
    forces = Forces(axis, at_load)
    forces.tables.rows = [np.full(1, torque)]
    return played(forces.into(model).with_values({forces.name: 1.0}), both(), 1, 1e-4)


@pytest.mark.study
def test_a_force_behind_a_belt_is_found_on_the_load_and_on_every_axis_that_lacks_one(labyrinth: Model) -> None:
    plays = [pushed(labyrinth, "x", True, 0.05)]
    behind = missing_force(labyrinth, plays, PARTS["x"], nthread=1, passes=2, at_load=True)
    assert behind.side == "load"
    assert np.median(behind.plays[0].force) == pytest.approx(0.05, rel=0.05)
    assert behind.floors[1] < 0.1 * behind.floors[0]
    also = also_missing(labyrinth, plays, PARTS, "x", {"x": behind.worst, "y": 0.9}, nthread=1)
    assert [(m.axis, m.side) for m in also] == [("x", "load")]
    also = also_missing(labyrinth, plays, PARTS, "x", {"x": behind.worst, "y": 9.0}, nthread=1)
    assert [(m.axis, m.side) for m in also] == [("x", "load"), ("y", "motor"), ("y", "load")]
    nothing = Formula((), 0.0, (0.0, 0.0))
    told = Proposal("x", "x", behind, Depends(()), nothing, also=also, offsets=(missing_offset(behind, 1),))
    page = render("title", "subtitle", [law(told)])
    assert "force on axis y, load&#39;s side" in page and "offset of board_x, if it alone were wrong" in page
    assert [m["side"] for m in told.to_json()["also"]] == ["load", "motor", "load"]


@pytest.mark.study
def test_the_force_that_a_sticking_joint_lacks_closes_the_gap(sticking: Model) -> None:
    """Where a joint sticks, a force that follows from slopes may be far too large, and the next one larger still."""
    more = sticking.with_effect("stribeck_friction", "x", {"extra": 0.3})
    plays = [played(more, alone("x", 0.3), 1, 1e-4)]
    missing = missing_force(sticking, plays, PARTS["x"], nthread=1)
    assert missing.floors[0] > 1000.0 and missing.floors[1] < 3.0
    assert missing.worst == pytest.approx(missing_force(sticking, plays, PARTS["x"], nthread=1, passes=1).worst)
    assert missing.size < 1.0


def test_the_offset_that_a_sensor_lacks_is_found(labyrinth: Model) -> None:
    off = labyrinth.with_effect("sensor_bias", "board_x", {"bias": 0.01})
    missing = missing_force(labyrinth, [played(off, both(), 1, 1e-4)], PARTS["x"], nthread=1, passes=1)
    motor, board = missing_offset(missing, 0), missing_offset(missing, 1)
    assert board.signal == "board_x" and np.median(board.offset[0]) == pytest.approx(0.01, abs=5e-4)
    assert abs(np.median(motor.offset[0])) < 1e-3 and board.floors[1] < 0.1 * board.floors[0]
    assert board.to_json()["unit"] == "rad"


@pytest.mark.study
def test_the_offset_of_a_sensor_is_added_to_the_models_own_motion(sticking: Model) -> None:
    """With dry friction, the motion with the force that would explain the misfit as well is another one."""
    wrong = sticking.with_effect("sensor_gain", "board_x", {"gain": 1.1})
    missing = missing_force(sticking, [played(wrong, alone("x", 0.3), 1, 1e-4)], PARTS["x"], nthread=1)
    motor, board = missing_offset(missing, 0), missing_offset(missing, 1)
    assert motor.floors[0] < 2.0 and board.floors[0] > 1000.0 and board.floors[1] < 2.0
