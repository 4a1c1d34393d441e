# SPDX-License-Identifier: Apache-2.0
"""Prescribed joints: they follow the motion that they are told, and the others feel it as they feel a driven one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from labyrinth_sim.model import Model, load_model
from labyrinth_sim.prescribed import command, prescribed, with_prescribed
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Array

STEP = 5e-4  # s
TIME = np.arange(4001) * STEP
HALF = 0.5 * STEP  # a command acts for a step: what it tells is meant for the middle of it


@pytest.fixture(scope="module")
def arm() -> Model:
    return load_model("two_link_arm")


def run(model: Model, commands: Array) -> dict[str, Array]:
    """Signal -> (T,), extrapolated to steps of no length, because the error of MuJoCo's is of first order."""
    full, half = (simulate(model, TIME, commands, timestep=step) for step in (STEP, STEP / 2.0))
    values = 2.0 * half.values[0] - full.values[0]
    return {signal: values[:, i] for i, signal in enumerate(full.signals)}


def commanded() -> Array:
    """(T, 2) rad: both joints at once, from rest."""
    begun = 1.0 - np.exp(-((TIME / 0.3) ** 2))
    return np.column_stack([0.4 * begun * np.sin(5.0 * TIME), -0.6 * begun * np.sin(3.0 * TIME + 0.4)])


def test_a_prescribed_joint_moves_as_it_is_told_whatever_acts_on_it(arm: Model) -> None:
    """Its drive is far too weak for such a motion, and friction would hold it."""
    at = TIME + HALF
    rate, size = 7.0, 0.5
    envelope = np.exp(-((at / 0.4) ** 2))
    position = size * np.sin(rate * at) * (1.0 - envelope)
    curve = CubicSpline(at, position)
    told = command(position, curve(at, 1), curve(at, 2))
    weak = arm.with_values({"drive.shoulder.torque": 0.01}).with_effect("coulomb_friction", "shoulder")
    alone = with_prescribed(weak, ["shoulder"])
    assert prescribed(alone) == ("shoulder",)
    assert prescribed(weak) == ()
    moved = run(alone, np.column_stack([told, np.zeros_like(told)]))
    assert np.abs(moved["shoulder"] - curve(TIME)).max() < 1e-4


def test_the_other_joints_feel_a_prescribed_one_as_they_feel_a_driven_one(arm: Model) -> None:
    whole = run(arm, commanded())
    curve = CubicSpline(TIME, whole["shoulder"])
    at = np.minimum(TIME + HALF, TIME[-1])
    told = np.column_stack([command(*(curve(at, order) for order in range(3))), commanded()[:, 1]])
    alone = run(with_prescribed(arm, ["shoulder"]), told)
    still = run(with_prescribed(arm, ["shoulder"]), told * [0.0, 1.0])
    elbow = [moved["elbow"] for moved in (whole, alone, still)]
    assert np.abs(elbow[1] - elbow[0]).max() < 1e-4
    assert np.abs(elbow[2] - elbow[0]).max() > 5e-3


def test_what_belongs_to_a_prescribed_joint_is_left_out_and_the_rest_kept(arm: Model) -> None:
    model = arm.with_effect("coulomb_friction", "shoulder").with_effect("viscous_friction", "elbow")
    model = replace(model, valid=None)
    alone = with_prescribed(model, ["shoulder"])
    assert [(use.effect.name, use.place) for use in alone.effects] == [("viscous_friction", "elbow")]
    assert not [name for name in alone.parameters() if name.startswith("drive.shoulder")]
    assert [name for name in alone.parameters() if "elbow" in name] == [n for n in model.parameters() if "elbow" in n]
