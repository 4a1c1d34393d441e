# SPDX-License-Identifier: Apache-2.0
"""From a model to a compiled MuJoCo model and the places its effects act on."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.effect import Drive, Effect, Values
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.parts import PLAIN
from labyrinth_sim.rig import Rig
from labyrinth_sim.site import Site, axis_site, ball_site
from labyrinth_sim.trials import Array

if TYPE_CHECKING:
    from labyrinth_sim.model import Model

# MuJoCo's friction is a soft constraint: at the default impedance a joint held by friction creeps.
FRICTION_IMPEDANCE = [0.9999, 0.9999, 0.001, 0.5, 2.0]


@dataclass(frozen=True)
class Placed:
    """An effect at its place, with the prefix of its parameters' full names, as `backlash.x.`."""

    effect: Effect
    prefix: str
    site: Site

    def acts(self, values: Values) -> NDArray[np.bool_]:
        """(nsim,) whether any value, full parameter name -> (nsim,), is not the one at which it vanishes."""
        switches = [p for p in self.effect.parameters if p.off is not None]
        return np.any([values[self.prefix + p.name] != p.off for p in switches], axis=0)


def local_values(values: Values, prefix: str) -> dict[str, Array]:
    """Of values by full name those under a prefix, as `backlash.x.`, by the rest of their names."""
    return {name.removeprefix(prefix): numbers for name, numbers in values.items() if name.startswith(prefix)}


@dataclass(frozen=True)
class Plan:
    """All of a model but its values: what is compiled once and shared by every parameter set."""

    mj: mujoco.MjModel
    drives: tuple[tuple[Drive, str, Site], ...]
    effects: tuple[Placed, ...]
    with_ball: bool

    def acting(self, values: Values) -> list[Placed]:
        """The effects that change anything in some simulation; without the others every bit is the same."""
        return [placed for placed in self.effects if placed.acts(values).any()]


def compiled(model: "Model", with_ball: bool, timestep: float | None = None) -> Plan:
    """Compiles a model's structure.

    Args:
        with_ball: False uses the rig's MJCF without the ball where there is one.
        timestep: s; the MJCF's own if None.

    Raises:
        InputError: an MJCF that does not compile, or lacks what the rig names; all at once.
    """
    rig = model.rig
    kinds = tuple(model.drives[axis.name].kind for axis in rig.axes)
    uses = tuple((use.effect, use.place) for use in model.effects)
    ordered = tuple(sorted(uses, key=lambda use: use[0].order))
    source = rig.mjcf if with_ball or rig.mjcf_without_ball is None else rig.mjcf_without_ball
    key = _RigKey(rig)
    return _compiled(
        key, kinds, ordered, source, source.stat().st_mtime_ns, with_ball and rig.ball is not None, timestep
    )


class _RigKey:
    """A rig as a dictionary key; rigs read from the same file at different times are equal if their content is."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._text = repr(rig)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _RigKey) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)


@lru_cache(maxsize=256)
def _compiled(
    key: _RigKey,
    kinds: tuple[Drive, ...],
    uses: tuple[tuple[Effect, str], ...],
    source: Path,
    _version: int,
    with_ball: bool,
    timestep: float | None,
) -> Plan:
    rig = key.rig
    spec = read_spec(source)
    bare = compile_spec(spec, source)
    missing = list(_missing(rig, bare, with_ball))
    if missing:
        raise InputError([f"{source}: {text}" for text in missing])
    if timestep is not None:
        spec.option.timestep = timestep
    # Without it MuJoCo would restart a simulation that diverged, as if nothing had happened.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for name in dict.fromkeys(name for axis in rig.axes for name in (axis.joint, axis.load)):
        spec.joint(name).solimp_friction = FRICTION_IMPEDANCE
    for channel, kind in enumerate(kinds):
        site = axis_site(rig, channel)
        spec.actuator(site.the_axis.actuator).group = site.group
        kind.spec(spec, site)
    for effect, place in uses:
        if effect.spec and (with_ball or effect.where != "ball"):
            effect.spec(spec, _site(rig, effect, place))
    mj = compile_spec(spec, source)
    mj.opt.disableflags |= _idle(mj)
    return Plan(
        mj,
        tuple((kind, f"drive.{rig.axes[i].name}.", axis_site(rig, i, mj)) for i, kind in enumerate(kinds)),
        tuple(
            Placed(effect, f"{effect.name}.{place}.", _site(rig, effect, place, mj))
            for effect, place in uses
            if with_ball or effect.where != "ball"
        ),
        with_ball,
    )


def _idle(mj: mujoco.MjModel) -> int:
    """Flags of the stages that no roll-out needs; they are a third of a step of a rig without its ball."""
    flags = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)  # roll-outs measure joints by themselves
    touching = mj.geom_contype[:, None] & mj.geom_conaffinity[None, :]
    if not touching.any() and mj.npair == 0:
        flags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return flags


def _site(rig: Rig, effect: Effect, place: str, mj: mujoco.MjModel | None = None) -> Site:
    if effect.where == "ball":
        return ball_site(rig, mj)
    if effect.where == "signal":
        channel = next(i for i, axis in enumerate(rig.axes) if any(m.signal == place for m in axis.measured))
        return axis_site(rig, channel, mj, signal=place)
    channel = next(i for i, axis in enumerate(rig.axes) if axis.name == place)
    return axis_site(rig, channel, mj)


def read_spec(source: Path) -> mujoco.MjSpec:
    """Parses an MJCF file. Raises InputError."""
    try:
        return mujoco.MjSpec.from_file(str(source))
    except (ValueError, OSError) as error:
        raise InputError(f"{source} is no valid MJCF: {error}") from error


def compile_spec(spec: mujoco.MjSpec, source: Path) -> mujoco.MjModel:
    """Compiles. Raises InputError with MuJoCo's reason."""
    try:
        return spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"{source} does not compile: {error}") from error


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
        for name in {axis.joint, axis.load, *(m.joint for m in axis.measured)} & set(have["joint"]):
            if mj.joint(name).type[0] != mujoco.mjtJoint.mjJNT_HINGE:
                yield f"joint '{name}' must be a hinge: axes of a rig turn."


def _names(mj: mujoco.MjModel, kind: str) -> list[str]:
    count = {"joint": mj.njnt, "actuator": mj.nu, "tendon": mj.ntendon, "site": mj.nsite, "body": mj.nbody}[kind]
    return [getattr(mj, kind)(i).name for i in range(count)]


def mjcf_quantities(rig: Rig) -> tuple[tuple[str, int, float], ...]:
    """Full name, index into PLAIN and the MJCF's value of every plain quantity of a rig."""
    source = rig.mjcf_without_ball or rig.mjcf
    return _quantities(_RigKey(rig), source, source.stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _quantities(key: _RigKey, source: Path, _version: int) -> tuple[tuple[str, int, float], ...]:
    mj = compile_spec(read_spec(source), source)
    missing = list(_missing(key.rig, mj, with_ball=False))
    if missing:
        raise InputError([f"{source}: {text}" for text in missing])
    found = []
    bodies: dict[str, float] = {}
    for name in dict.fromkeys(name for axis in key.rig.axes for name in (axis.joint, axis.load)):
        joint = mj.joint(name)
        numbers = (joint.armature[0], joint.damping[0], joint.frictionloss[0])
        found += [
            (f"joint.{name}.{p.name}", i, float(v))
            for i, (p, v) in enumerate(zip(PLAIN["joint"], numbers, strict=True))
        ]
        body = mj.body(int(joint.bodyid[0]))
        bodies[body.name] = float(body.mass[0])
    found += [(f"body.{name}.mass", 0, mass) for name, mass in bodies.items() if name]
    return tuple(found)
