# SPDX-License-Identifier: Apache-2.0
"""What a model is made of: values with unit and source, drives and effects in use, and the rules for both."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from labyrinth_sim.effect import Drive, Effect, Parameter
from labyrinth_sim.errors import unknown_name
from labyrinth_sim.rig import Rig

PLAIN = {
    "joint": (
        Parameter("armature", "kg m^2", 1e-6, 0.2, None, 0.01, "rotor and gear of servos up to 10 N m"),
        Parameter("damping", "N m s/rad", 0.0, 5.0, None, 0.01, "hobby servos stay below"),
        Parameter("frictionloss", "N m", 0.0, 2.0, None, 0.01, "hobby servos stay below"),
    ),
    "body": (Parameter("mass", "kg", 1e-4, 10.0, None, 0.1, "what such rigs carry; the inertia scales with it"),),
}
"""Plain MJCF quantities that can be set and fitted, as `joint.motor_x.armature`."""


@dataclass(frozen=True)
class Value:
    """A number, its unit, and where it came from."""

    value: float
    unit: str
    source: str


@dataclass(frozen=True)
class ParameterInfo:
    """One number of a model that can be set or fitted.

    `off` is the value at which its effect vanishes, None where there is no such value; `default` what holds where the
    model says nothing.
    """

    name: str
    unit: str
    low: float
    high: float
    off: float | None
    default: float
    value: float
    source: str
    why: str


@dataclass(frozen=True)
class DriveUse:
    """The drive of one axis, with values by parameter name."""

    kind: Drive
    values: Mapping[str, Value]


@dataclass(frozen=True)
class EffectUse:
    """An effect at one place: an axis, a measured position, or "ball"."""

    effect: Effect
    place: str
    values: Mapping[str, Value]


def places(rig: Rig, effect: Effect) -> tuple[str, ...]:
    """Where an effect can act on a rig."""
    if effect.where == "ball":
        return ("ball",) if rig.ball else ()
    if effect.where == "signal":
        return tuple(m.signal for m in rig.measured if m.quantity == "position")
    if "ball" in effect.needs and rig.ball is None:
        return ()
    if "other_axis" in effect.needs and len(rig.axes) < 2:
        return ()
    return tuple(axis.name for axis in rig.axes if axis.belt or "belt" not in effect.needs)


def effect_complaints(rig: Rig, effect: Effect, place: str) -> list[str]:
    """Why an effect cannot act at a place of a rig; empty if it can."""
    valid = places(rig, effect)
    if place in valid:
        return []
    if not valid:
        lacks = (
            "no ball"
            if effect.where == "ball" or "ball" in effect.needs
            else f"nothing for it to act on (it needs {', '.join(effect.needs)})"
        )
        return [f"{effect.name} cannot act on rig '{rig.name}': the rig has {lacks}."]
    return [f"{effect.name} acts on each {effect.where}. {unknown_name(effect.where, place, valid)}"]


def check_bounds(name: str, p: Parameter | ParameterInfo, number: float) -> list[str]:
    """A complaint where a number is out of bounds."""
    if math.isfinite(number) and p.low <= number <= p.high:
        return []
    return [f"{name} must lie within [{p.low:g}, {p.high:g}] {p.unit} ({p.why}), got {number:g}."]
