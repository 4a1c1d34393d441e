# SPDX-License-Identifier: Apache-2.0
"""Plain quantities of a rig's MJCF, which a model may set, and what a rig needs to find in its MJCF."""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np

from labyrinth_sim.asset import compile_spec, read_spec
from labyrinth_sim.effect import Parameter, slide_unit
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.rig import Rig

PLAIN = {
    "joint": (
        Parameter("armature", "kg m^2", 1e-6, 0.2, None, 0.01, "rotor and gear of servos up to 10 N m"),
        Parameter("damping", "N m s/rad", 0.0, 5.0, None, 0.01, "hobby servos stay below"),
        Parameter("frictionloss", "N m", 0.0, 2.0, None, 0.01, "hobby servos stay below"),
    ),
    "body": (
        Parameter("mass", "kg", 1e-4, 10.0, None, 0.1, "what such rigs carry; the inertia scales with it"),
        Parameter("inertia", "1", 0.1, 10.0, None, 1.0, "factor of the MJCF's, about the centre of mass"),
    ),
    "belt": (
        Parameter("stiffness", "N m/rad", 0.01, 1e4, None, 100.0, "from a rubber band to a toothed belt of steel"),
        Parameter("damping", "N m s/rad", 0.0, 10.0, None, 0.1, "such belts stay below"),
    ),
}
"""Plain MJCF quantities that can be set and fitted, as `joint.motor_x.armature`."""

EFFORT = "effort"
SCALES = {
    "A": ("torque_constant", "N m/A", "of the motor behind its gear, with the sign of its direction"),
    "duty": ("stall_torque", "N m", "torque at full duty, with the sign of the motor's direction"),
    "raw": ("factor", "N m", "torque that one of the recorded unit stands for"),
}
"""Recorded unit of an effort -> name, unit and meaning of the factor to N m, where the rig leaves it open."""
WITHIN = 10.0  # times, either way, in which a factor is sought

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


class RigKey:
    """A rig as a dictionary key; rigs read from the same file at different times are equal if their content is."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RigKey) and self.rig == other.rig

    def __hash__(self) -> int:
        return hash((self.rig.name, self.rig.mjcf))


Quantities = Mapping[str, tuple[Parameter, float]]
"""Full name -> the declaration, as for a joint that turns, and the MJCF's value."""


def mjcf_quantities(rig: Rig) -> Quantities:
    """Every plain quantity of a rig by full name.

    Raises:
        InputError: as `check_mjcf` does.
    """
    source = rig.mjcf_without_ball or rig.mjcf
    return _quantities(RigKey(rig), source, source.stat().st_mtime_ns)


def effort_scales(rig: Rig, stated: Mapping[str, float]) -> Quantities:
    """Factors of the efforts whose unit the rig leaves open, as `effort.motor_x_effort.torque_constant`; 1 by default.

    Args:
        stated: full name -> the model's value, about which bounds are set.
    """
    chosen: dict[str, tuple[Parameter, float]] = {}
    for measured in rig.measured:
        if not measured.recorded.free:
            continue
        word, unit, why = SCALES[measured.recorded.name.removeprefix("m")]
        name = f"{EFFORT}.{measured.signal}.{word}"
        about = stated.get(name, 1.0)
        low, high = sorted((about / WITHIN, about * WITHIN))
        unit = slide_unit(unit) if measured.slides else unit
        chosen[name] = (Parameter(word, unit, low, high, None, about, why, fixed="unit"), 1.0)
    return MappingProxyType(chosen)


def check_mjcf(rig: Rig) -> None:
    """Raises InputError where a file of the rig does not compile, or lacks what the rig names."""
    mjcf_quantities(rig)
    if rig.ball:
        _bare(RigKey(rig), rig.mjcf, rig.mjcf.stat().st_mtime_ns, True)


@lru_cache(maxsize=64)
def _bare(key: RigKey, source: Path, _version: int, with_ball: bool) -> mujoco.MjModel:
    mj = compile_spec(read_spec(source), source)
    check_names(key.rig, mj, source, with_ball)
    return mj


@lru_cache(maxsize=64)
def _quantities(key: RigKey, source: Path, version: int) -> Quantities:
    mj = _bare(key, source, version, False)
    quantities: dict[str, tuple[Parameter, float]] = {}
    bodies: dict[str, float] = {}
    for name in dict.fromkeys(name for axis in key.rig.axes for name in (axis.joint, axis.load)):
        joint = mj.joint(name)
        numbers = (joint.armature[0], joint.damping[0], joint.frictionloss[0])
        for p, number in zip(PLAIN["joint"], numbers, strict=True):
            quantities[f"joint.{name}.{p.name}"] = (p, float(number))
        body = mj.body(int(joint.bodyid[0]))
        bodies[body.name] = float(body.mass[0])
    for axis in key.rig.axes:
        if axis.belt:
            number = mj.tendon(axis.belt).id
            for p, array in zip(PLAIN["belt"], (mj.tendon_stiffness, mj.tendon_damping), strict=True):
                quantities[f"belt.{axis.belt}.{p.name}"] = (p, float(np.ravel(array[number])[0]))
    mass, inertia = PLAIN["body"]
    for name, number in bodies.items():
        if name:
            quantities |= {f"body.{name}.{mass.name}": (mass, number), f"body.{name}.{inertia.name}": (inertia, 1.0)}
    return MappingProxyType(quantities)


def check_names(rig: Rig, mj: mujoco.MjModel, source: Path, with_ball: bool) -> None:
    """Raises InputError with every name of the rig that its MJCF lacks, and every joint of a type that no axis has."""
    missing = list(_missing(rig, mj, with_ball))
    if missing:
        raise InputError([f"{source}: {text}" for text in missing])


def _missing(rig: Rig, mj: mujoco.MjModel, with_ball: bool) -> Iterator[str]:
    have = {kind: _names(mj, kind) for kind in ("joint", "actuator", "tendon", "site")}
    wanted = []
    for axis in rig.axes:
        wanted += [("actuator", axis.actuator), ("joint", axis.joint)]
        wanted += [("joint", axis.load_joint)] if axis.load_joint else []
        wanted += [("tendon", axis.belt)] if axis.belt else []
        wanted += [("joint", m.joint) for m in axis.measured]
    if with_ball and rig.ball:
        wanted += [("joint", rig.ball.joint), ("site", rig.ball.site)]
    for kind, name in dict.fromkeys(wanted):
        if name not in have[kind]:
            yield f"rig '{rig.name}' needs it. {unknown_name(kind, name, have[kind])}"
    for axis in rig.axes:
        for name in dict.fromkeys((axis.joint, axis.load, *(m.joint for m in axis.measured))):
            if name in have["joint"] and int(mj.joint(name).type[0]) not in (HINGE, SLIDE):
                yield f"joint '{name}' must be a hinge or a slide joint: an axis has one degree of freedom."


def _names(mj: mujoco.MjModel, kind: str) -> list[str]:
    count = {"joint": mj.njnt, "actuator": mj.nu, "tendon": mj.ntendon, "site": mj.nsite}[kind]
    return [getattr(mj, kind)(i).name for i in range(count)]
