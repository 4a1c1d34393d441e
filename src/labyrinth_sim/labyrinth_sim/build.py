# SPDX-License-Identifier: Apache-2.0
"""From a model to a compiled MuJoCo model and the places its effects act on."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.asset import compile_spec, read_spec
from labyrinth_sim.effect import Drive, Effect, Values
from labyrinth_sim.lean import make_lean
from labyrinth_sim.model import Model
from labyrinth_sim.quantities import RigKey, check_names
from labyrinth_sim.rig import Rig
from labyrinth_sim.site import Site, axis_site, ball_site
from labyrinth_sim.trials import Array

# MuJoCo's friction is a soft constraint: at the default impedance a joint held by friction creeps.
FRICTION_IMPEDANCE = [0.9999, 0.9999, 0.001, 0.5, 2.0]
# s and damping ratio. MuJoCo raises the time to two steps, so that friction stops a joint within one; at its default of
# 20 ms a joint slides on for as long, and effort trails.
FRICTION_TIME = [1e-9, 1.0]
COUPLED = 0.01
"""Inertia that two joints share, over the root of the product of their own, beyond which they are simulated together:
the joints of `two_link_arm` share 0.44 to 0.59; Rotation and Jaw of an SO-100 0.002 at most with its other joints."""


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

    def steps(self, values: Values) -> NDArray[np.bool_]:
        """(nsim,) whether its step or error has something to do; values as for `acts`."""
        return self.acts(values) & self.effect.steps_at(local_values(values, self.prefix))


def local_values(values: Values, prefix: str) -> dict[str, Array]:
    """From values by full name, those with a prefix such as `backlash.x.`, by the rest of their names."""
    return {name.removeprefix(prefix): numbers for name, numbers in values.items() if name.startswith(prefix)}


@dataclass(frozen=True)
class Plan:
    """A model without its values: compiled once and shared by every parameter set."""

    mj: mujoco.MjModel
    drives: tuple[tuple[Drive, str, Site], ...]
    effects: tuple[Placed, ...]
    with_ball: bool

    def acting(self, values: Values) -> list[Placed]:
        """The effects that change anything in some simulation; without the others every bit is the same."""
        return [placed for placed in self.effects if placed.acts(values).any()]


def compiled(model: Model, with_ball: bool, timestep: float | None = None) -> Plan:
    """Compiles a model's structure.

    Args:
        with_ball: False uses the rig's MJCF without the ball if there is one.
        timestep: s; the MJCF's own if None.

    Raises:
        InputError: an MJCF that does not compile, or lacks what the rig names; all at once.
    """
    rig = model.rig
    kinds = tuple(model.drives[axis.name].kind for axis in rig.axes)
    uses = tuple((use.effect, use.place) for use in model.effects)
    ordered = tuple(sorted(uses, key=lambda use: use[0].order))
    source = rig.mjcf if with_ball or rig.mjcf_without_ball is None else rig.mjcf_without_ball
    key = RigKey(rig)
    return _compiled(
        key, kinds, ordered, source, source.stat().st_mtime_ns, with_ball and rig.ball is not None, timestep
    )


def coupled_axes(model: Model) -> list[tuple[str, ...]]:
    """The axes, grouped by coupling of their inertia above COUPLED, as in an arm."""
    plan = compiled(model, with_ball=False)
    own = [{site.dof, site.load_dof} for _, _, site in plan.drives]
    felt = np.zeros((len(own), len(own)), dtype=bool)
    for whole in _inertias(plan.mj):
        scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
        share = np.abs(whole) / np.maximum(scale, 1e-300)
        felt |= [[any(share[i, j] > COUPLED for i in a for j in b) for b in own] for a in own]
    from scipy.sparse.csgraph import connected_components  # takes long to import, and a node needs it not

    _, groups = connected_components(felt, directed=False)
    return [tuple(a.name for a, g in zip(model.rig.axes, groups, strict=True) if g == number)
            for number in range(max(groups, default=-1) + 1)]  # fmt: skip


def axes_couple(model: Model) -> bool:
    """Whether any axes are coupled by inertia."""
    return any(len(group) > 1 for group in coupled_axes(model))


def own_inertia(model: Model, axis: str) -> float:
    """kg m^2 (kg where it slides) of an axis's driven joint, the others being free: the least of a few poses."""
    plan = compiled(model, with_ball=False)
    dof = next(site.dof for _, _, site in plan.drives if site.the_axis.name == axis)
    return min(float(1.0 / np.linalg.inv(whole)[dof, dof]) for whole in _inertias(plan.mj))


def inertia_at_rest(mj: mujoco.MjModel, joint: str) -> float:
    """kg m^2 (kg where it slides) that a joint turns in the model's pose, with what it carries, armature included."""
    dof = int(mj.joint(joint).dofadr[0])
    return float(next(_inertias(mj))[dof, dof])


def _inertias(mj: mujoco.MjModel) -> Iterator[Array]:
    """(nv, nv) inertia in a few poses."""
    data = mujoco.MjData(mj)
    for angle in (0.0, 0.3, 1.0):
        data.qpos[:] = mj.qpos0 + angle if mj.nq == mj.nv else mj.qpos0
        mujoco.mj_forward(mj, data)
        whole = np.zeros((mj.nv, mj.nv))
        mujoco.mj_fullM(mj, data, whole)
        yield whole


def build_spec(model: Model) -> tuple[mujoco.MjSpec, Plan]:
    """A model's structure as a specification that can be written to a file, and compiled; the ball's included."""
    rig = model.rig
    kinds = tuple(model.drives[axis.name].kind for axis in rig.axes)
    uses = tuple(sorted(((u.effect, u.place) for u in model.effects), key=lambda use: use[0].order))
    with_ball = rig.ball is not None
    spec = _with_effects(_checked(rig, rig.mjcf, with_ball)[0], rig, kinds, uses, with_ball)
    mj = compile_spec(spec, rig.mjcf)
    return spec, _plan(rig, kinds, uses, mj, with_ball)


@lru_cache(maxsize=32)
def _compiled(
    key: RigKey,
    kinds: tuple[Drive, ...],
    uses: tuple[tuple[Effect, str], ...],
    source: Path,
    version: int,
    with_ball: bool,
    timestep: float | None,
) -> Plan:
    rig = key.rig
    spec = _with_effects(_lean(key, source, version, with_ball).copy(), rig, kinds, uses, with_ball)
    if timestep is not None:
        spec.option.timestep = timestep
    # Without it MuJoCo would restart a simulation that diverged, as if nothing had happened.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    mj = compile_spec(spec, source)
    mj.opt.disableflags |= _idle(mj)
    return _plan(rig, kinds, uses, mj, with_ball)


@lru_cache(maxsize=8)
def _lean(key: RigKey, source: Path, _version: int, with_ball: bool) -> mujoco.MjSpec:
    """A rig's structure as it is read, checked, without what no roll-out needs."""
    spec, mj = _checked(key.rig, source, with_ball)
    if mj.nmesh:
        make_lean(spec, mj)
    return spec


def _checked(rig: Rig, source: Path, with_ball: bool) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    spec = read_spec(source)
    mj = compile_spec(spec, source)
    check_names(rig, mj, source, with_ball)
    return spec, mj


def _with_effects(
    spec: mujoco.MjSpec, rig: Rig, kinds: tuple[Drive, ...], uses: tuple[tuple[Effect, str], ...], with_ball: bool
) -> mujoco.MjSpec:
    for name in dict.fromkeys(name for axis in rig.axes for name in (axis.joint, axis.load)):
        spec.joint(name).solimp_friction = FRICTION_IMPEDANCE
        spec.joint(name).solref_friction = FRICTION_TIME
    for channel, kind in enumerate(kinds):
        site = axis_site(rig, channel)
        spec.actuator(site.the_axis.actuator).group = site.group
        kind.spec(spec, site)
    for effect, place in uses:
        if effect.spec and (with_ball or effect.where != "ball"):
            effect.spec(spec, _site(rig, effect, place))
    return spec


def _plan(
    rig: Rig, kinds: tuple[Drive, ...], uses: tuple[tuple[Effect, str], ...], mj: mujoco.MjModel, with_ball: bool
) -> Plan:
    return Plan(
        mj,
        tuple((kind, f"drive.{rig.axes[i].name}.", axis_site(rig, i, mj)) for i, kind in enumerate(kinds)),
        tuple(
            Placed(effect, f"{effect.name}.{place}.", _site(rig, effect, acts_at, mj))
            for effect, place in uses
            if with_ball or effect.where != "ball"
            for acts_at in _acts_at(rig, uses, effect, place)
        ),
        with_ball,
    )


def _acts_at(rig: Rig, uses: Sequence[tuple[Effect, str]], effect: Effect, place: str) -> list[str]:
    """The places where an effect acts that is stated at one: there, or on all axes that have none of their own."""
    stated = [where for other, where in uses if other.name == effect.name]
    if not effect.everywhere or place != stated[0]:
        return [place]
    return [place, *(axis.name for axis in rig.axes if axis.name not in stated)]


def _idle(mj: mujoco.MjModel) -> int:
    """Flags of the stages that no roll-out needs; they take a third of the time of a step without the ball."""
    flags = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)  # roll-outs measure joints by themselves
    touching = mj.geom_contype[:, None] & mj.geom_conaffinity[None, :]
    if not touching.any() and mj.npair == 0:
        # A few joints' friction and limits are solved sooner at once than after a search for islands among them.
        flags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    return flags


def _site(rig: Rig, effect: Effect, place: str, mj: mujoco.MjModel | None = None) -> Site:
    if effect.where == "ball":
        return ball_site(rig, mj)
    if effect.where == "signal":
        channel = next(i for i, axis in enumerate(rig.axes) if any(m.signal == place for m in axis.measured))
        return axis_site(rig, channel, mj, signal=place)
    channel = next(i for i, axis in enumerate(rig.axes) if axis.name == place)
    return axis_site(rig, channel, mj)
