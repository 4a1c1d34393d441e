# SPDX-License-Identifier: Apache-2.0
"""A model for the user's own simulator: an MJCF with everything that MuJoCo can express, a module for the rest."""

import ctypes
import inspect
import os
import pprint
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from labyrinth_sim import filters
from labyrinth_sim.build import Placed, Plan, build_spec
from labyrinth_sim.effect import Drive, Effect
from labyrinth_sim.engine import Engine
from labyrinth_sim.errors import InputError
from labyrinth_sim.export import runtime
from labyrinth_sim.export.bundle import Bundle
from labyrinth_sim.law import Law
from labyrinth_sim.model import Model
from labyrinth_sim.quantities import EFFORT, PLAIN
from labyrinth_sim.rig import Axis
from labyrinth_sim.simulate import numbers_of
from labyrinth_sim.trials import Array

DIGITS = 17  # of numbers in the MJCF; its own 6 would not be the same model
GRID = 1e-6  # samples or steps by which a delay may miss their grid
UNEQUAL = 1e-12  # relative; survives the digits of the MJCF
HOOKS = ("command", "error", "step", "measure")
IN_WORDS = {"command": "its target", "error": "its error", "step": "before every step", "measure": "its measurement"}


@dataclass(frozen=True)
class Placement:
    """Where one value went: `where` is "MJCF", "module", "MJCF and module", "off" or "no"; `how` says by what."""

    name: str
    value: float
    unit: str
    where: str
    how: str


@dataclass(frozen=True)
class Exported:
    """The MJCF's text, the module's ("" where none is needed), and where each value went."""

    mjcf: str
    module: str
    placements: tuple[Placement, ...]


def export(model: Model) -> Exported:
    """A model as files for other programs.

    The module is needed for what MuJoCo's own elements cannot express: a late or rounded target, a law with an
    integral, an effect that acts before each step or on a measurement. Without one, each actuator's control is its
    axis's target.

    Raises:
        InputError: an effect's file uses more than numpy and mujoco.
    """
    plan, values, text, torque = _compiled(model)
    acting = plan.acting(values)
    bundle = Bundle()
    placements = tuple(_placements(model, acting, text, torque))
    placements, delays = _own_delays(model, plan, placements)
    if delays:
        _, _, text, _ = _compiled(model, delays)
    needed = any("module" in p.where for p in placements)
    return Exported(text, _module(model, acting, torque, bundle) if needed else "", placements)


def _compiled(model: Model, delays: Mapping[str, int] | None = None) -> tuple[Plan, dict[str, Array], str, Array]:
    """The plan, all values, the MJCF's text, and the constant torque (nv,) on each degree of freedom.

    Args:
        delays: actuator -> steps by which its control comes late.
    """
    spec, plan = build_spec(model)
    values = numbers_of(model, 1)
    engine = Engine(model, plan, values, 1, model.rig.sample_time, nthread=1)
    target = engine.batch.get_model(0)
    target.opt.timestep = plan.mj.opt.timestep
    home = model.rig.mjcf.resolve().parent
    for folder, files in (("meshdir", spec.meshes), ("texturedir", spec.textures)):
        if files:  # the new file may lie elsewhere
            setattr(spec, folder, str((home / getattr(spec, folder)).resolve()))
    for geom in spec.geoms:  # no number, so it is set before the text is written
        geom.condim = int(target.geom_condim[geom.id])
    for name, steps in (delays or {}).items():
        # Half a step less, or the rounding of time takes the sample before every now and then.
        spec.actuator(name).delay = (steps - 0.5) * target.opt.timestep
        spec.actuator(name).nsample = steps + 1
    for joint in spec.joints:  # MuJoCo does not copy it back
        joint.actfrcrange = target.jnt_actfrcrange[joint.id]
    return plan, values, _mjcf(spec, target), engine.fields.torque[0]


# ---- the MJCF


def _mjcf(spec: mujoco.MjSpec, target: mujoco.MjModel) -> str:
    """The spec's text with the numbers of a compiled model."""
    with tempfile.TemporaryDirectory() as folder, _Precise():
        first, second = os.path.join(folder, "a.xml"), os.path.join(folder, "b.xml")
        Path(first).write_text(spec.to_xml(), encoding="utf-8")
        loaded = mujoco.MjModel.from_xml_path(first)
        for name in _numbers(target):
            getattr(loaded, name)[...] = getattr(target, name)
        _keep_from_ratios(loaded)
        loaded.opt.gravity = target.opt.gravity
        mujoco.mj_saveLastXML(second, loaded)
        text = Path(second).read_text(encoding="utf-8")
        again = mujoco.MjModel.from_xml_path(second)
    lost = [n for n in ESSENTIAL if not np.allclose(getattr(again, n), getattr(target, n), rtol=1e-4, atol=1e-9)]
    lost += [] if np.allclose(again.opt.gravity, target.opt.gravity, rtol=1e-4) else ["opt.gravity"]
    if lost:
        raise InputError(f"MuJoCo does not write {', '.join(lost)} of this model to an MJCF.")
    return text


def _keep_from_ratios(model: mujoco.MjModel) -> None:
    """Sets off the stiffness of a position servo that pushes with speed by less than a rounding error.

    MuJoCo's compiler takes a positive factor of speed for a damping ratio where stiffness and gain are equal.
    """
    gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm
    servo = (bias[:, 2] > 0.0) & (gain == -bias[:, 1])
    bias[servo, 1] *= 1.0 + UNEQUAL


ESSENTIAL = (
    "dof_damping", "dof_frictionloss", "dof_armature", "actuator_gainprm", "actuator_biasprm", "actuator_forcerange",
    "jnt_actfrcrange", "tendon_stiffness", "tendon_damping", "tendon_lengthspring", "body_mass", "geom_condim",
)  # fmt: skip


def _numbers(model: mujoco.MjModel) -> Iterator[str]:
    """Names of the fields of a compiled model that elements of an MJCF state."""
    prefixes = ("dof_damping", "dof_frictionloss", "dof_armature", "actuator_gainprm", "actuator_biasprm",
                "actuator_forcerange", "jnt_actfrcrange", "jnt_stiffness", "qpos_spring", "tendon_", "body_mass",
                "body_inertia", "body_ipos", "body_iquat", "geom_friction", "geom_solref", "geom_solimp", "wrap_prm",
                "dof_solref", "dof_solimp")  # fmt: skip
    for name in dir(model):
        if name.startswith(prefixes):
            value = getattr(model, name)
            if isinstance(value, np.ndarray) and value.dtype == np.float64:
                yield name


class _Precise:
    """All digits in MuJoCo's XML, where its library lets one ask for them."""

    def __enter__(self) -> None:
        self._library = None
        for file in sorted(Path(mujoco.__file__).parent.glob("libmujoco*")):
            library = ctypes.CDLL(str(file))
            if hasattr(library, "_mjPRIVATE__set_xml_precision"):
                self._library = library
                self._before = library._mjPRIVATE__get_xml_precision()
                library._mjPRIVATE__set_xml_precision(DIGITS)
                return

    def __exit__(self, *_: object) -> None:
        if self._library is not None:
            self._library._mjPRIVATE__set_xml_precision(self._before)


# ---- the module


def _module(model: Model, acting: list[Placed], torque: Array, bundle: Bundle) -> str:
    rig, values = model.rig, model.values()
    axes, drives, effects = [], [], []
    for axis in rig.axes:
        axes.append(_axis(axis))
        use = model.drives[axis.name]
        own = {p.name: values[f"drive.{axis.name}.{p.name}"] for p in use.kind.parameters}
        drives.append({"name": use.kind.name, "values": own, **_of_drive(use.kind, bundle)})
    for placed in acting:
        effect = placed.effect
        own = {p.name: values[f"{placed.prefix}{p.name}"] for p in effect.parameters}
        used = _hooks(effect, own)
        if effect.where == "ball" or not used:
            continue
        hooks = {hook: _Code(bundle.add(_plain(placed, hook)) if hook in used else None) for hook in HOOKS}
        signal = placed.site.signal if effect.where == "signal" else None
        effects.append({"name": placed.prefix[:-1], "channel": placed.site.channel, "signal": signal, "values": own,
                        "touches": effect.touches, **hooks})  # fmt: skip
    delay = bundle.name_of(inspect.getsourcefile(filters) or "", "Delay")
    scales = {n.split(".")[1]: v for n, v in values.items() if n.startswith(f"{EFFORT}.")}
    joints = {m: float(torque[int(i)]) for m, i in _joint_dofs(model) if torque[int(i)] != 0.0}
    content = {"SAMPLE_TIME": rig.sample_time, "AXES": axes, "DRIVES": drives, "EFFECTS": effects, "SCALES": scales,
               "TORQUE": joints}  # fmt: skip
    source = inspect.getsource(runtime).split("# mypy: ignore-errors\n", 1)[1]
    head, _, tail = source.partition("# What was exported; a generated module has its own below.")
    body = tail[tail.index("\ndef ndtr") :]
    body = body.rstrip()
    shown = "\n".join(
        f"{name} = {pprint.pformat(value, width=110, sort_dicts=False)}" for name, value in content.items()
    )
    title = f'"""Model {model.name}: {head.lstrip().removeprefix(chr(34) * 3)}'
    return (
        f"{title.rstrip()}\n{body}\n\n\n# What the effects and drives do.\n\n{bundle.text}\n\nDELAY = {delay}\n\n"
        f"# What was exported.\n\n{shown}\n"
    )


def _hooks(effect: Effect, values: Mapping[str, float]) -> list[str]:
    """The hooks that an effect needs at these values of its parameters."""
    idle = () if effect.steps_at(values) else ("step", "error")
    return [hook for hook in HOOKS if getattr(effect, hook) and hook not in idle]


def _plain(placed: Placed, hook: str) -> Any:
    """A hook as the function that its file has."""
    code = getattr(placed.effect, hook)
    if hook == "step" and code is not None and not isinstance(code, Law):
        raise InputError(f"Effect {placed.effect.name}: its step works on whole batches; make it a law to export it.")
    return code.function if isinstance(code, Law) else code


class _Code:
    """A name of the module's, shown as it is."""

    def __init__(self, name: str | None) -> None:
        self.name = name

    def __repr__(self) -> str:
        return str(self.name)


def _of_drive(kind: Drive, bundle: Bundle) -> dict[str, Any]:
    hooks = ("target", "gain", "lead", "controller")
    return {**{hook: _Code(bundle.add(getattr(kind, hook))) for hook in hooks}, "by_duty": kind.by_duty}


def _axis(axis: Axis) -> dict[str, Any]:
    measured = [{"signal": m.signal, "joint": m.joint, "quantity": m.quantity, "resolution": m.resolution}
                for m in axis.measured]  # fmt: skip
    return {"name": axis.name, "command": axis.command, "actuator": axis.actuator, "joint": axis.joint,
            "load": axis.load, "load_joint": axis.load_joint, "belt": axis.belt, "slides": axis.slides,
            "limits": axis.limits, "measured": measured}  # fmt: skip


def _joint_dofs(model: Model) -> Iterator[tuple[str, int]]:
    _, plan = build_spec(model)
    for i in range(plan.mj.njnt):
        joint = plan.mj.joint(i)
        yield joint.name, int(joint.dofadr[0])


# ---- where each value went


def _own_delays(
    model: Model, plan: Plan, placements: tuple[Placement, ...]
) -> tuple[tuple[Placement, ...], dict[str, int]]:
    """The placements where late targets are the only reason for a module, and actuator -> steps of MuJoCo's own delay.

    Ours takes a straight line between two samples where a delay is no whole number of them, and MuJoCo's does not.
    """
    late = {f"drive.{axis.name}.delay": axis for axis in model.rig.axes}
    if any("module" in p.where for p in placements if p.name not in late):
        return placements, {}
    sample, step = model.rig.sample_time, plan.mj.opt.timestep
    whole = abs(sample / step - round(sample / step)) < GRID
    found, delays = [], {}
    for p in placements:
        if p.name in late and p.where == "module":
            samples = p.value / sample
            if whole and abs(samples - round(samples)) < GRID:
                delays[late[p.name].actuator] = round(p.value / step)
                how = f"actuator {late[p.name].actuator}'s delay, {round(samples)} samples less half a step"
                p = replace(p, where="MJCF", how=f"{how}; its controls before the first are 0")
            else:
                fits = f"{sample:g} s" if whole else f"{sample:g} s, of a whole number of steps of {step:g} s"
                p = replace(p, how=f"{p.how}; an actuator's delay would need a whole number of samples of {fits}")
        found.append(p)
    if any("module" in p.where for p in found):  # which does them all
        return tuple(b if b.where == "module" else a for a, b in zip(placements, found, strict=True)), {}
    return tuple(found), delays


def _placements(model: Model, acting: list[Placed], text: str, torque: Array) -> Iterator[Placement]:
    infos = model.parameters()
    for axis in model.rig.axes:
        kind = model.drives[axis.name].kind
        for p in kind.parameters:
            info = infos[f"drive.{axis.name}.{p.name}"]
            late = p.name in ("delay", "goal_tick", "feedback_tick")
            law = kind.gain is not None and p.name in ("p", "i", "d")
            where = "module" if late or (law and p.name == "i") else "MJCF and module" if law else "MJCF"
            where = "off" if not info.value and (late or (law and p.name != "p")) else where
            how = (
                f"drives {axis.name}'s target" if late else "the law's control" if law else f"actuator {axis.actuator}"
            )
            yield Placement(info.name, info.value, info.unit, where, how)
    on = {placed.prefix for placed in acting}
    for use in model.effects:
        prefix = f"{use.effect.name}.{use.place}."
        own = {p.name: infos[prefix + p.name].value for p in use.effect.parameters}
        hooks = [IN_WORDS[hook] for hook in _hooks(use.effect, own)]
        native = pushes = False
        if prefix in on and (use.effect.fields or use.effect.spec):  # what they do depends on the rig
            _, _, other, less = _compiled(model.without_effect(use.effect.name, use.place))
            native, pushes = text != other, not np.array_equal(torque, less)
        for p in use.effect.parameters:
            info = infos[prefix + p.name]
            if not (native or pushes or (prefix in on and hooks)):
                where, how = "off", "changes nothing at these values"
            elif use.effect.where == "ball" and hooks:
                where, how = ("MJCF" if native else "no"), "what a camera does to the ball is not part of the module"
            else:
                where = " and ".join([*(["MJCF"] if native else []), *(["module"] if hooks or pushes else [])])
                words = (["elements of the model"] if native else []) + (["a constant torque"] if pushes else [])
                how = ", ".join([*words, *hooks])
            yield Placement(info.name, info.value, info.unit, where, how)
    for name, value in model.quantities.items():
        if name.split(".")[0] in PLAIN:
            yield Placement(name, value.value, value.unit, "MJCF", "the joint or body itself")
        else:
            yield Placement(name, value.value, value.unit, "module", "what is measured is divided by it")
