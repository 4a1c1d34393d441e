# SPDX-License-Identifier: Apache-2.0
"""A new rig: from a model and recordings to `rig.yaml` and `model.yaml`, with a reason for every value."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from eps_tunnel_analysis.diagnose.noise import resolution
from eps_tunnel_analysis.new_rig.drive import DriveProposal, Proposed, effort_unit, inertia_of, propose_drive
from eps_tunnel_analysis.new_rig.joints import (
    Match,
    Robot,
    Sampled,
    Topics,
    all_of,
    find_topics,
    match_joints,
    name_actuators,
    sample,
)
from eps_tunnel_analysis.new_rig.position import PositionUnit, Ticks, position_unit
from eps_tunnel_analysis.recording import Recording
from labyrinth_sim.asset import compile_spec, read_spec
from labyrinth_sim.effect import slide_unit
from labyrinth_sim.errors import InputError
from labyrinth_sim.quantities import EFFORT, SCALES
from labyrinth_sim.rig import WORD
from labyrinth_sim.whole_file import write_new
from labyrinth_sim.yaml_file import yaml_text

LEAST_ARMATURE = 1e-5  # kg m^2 (kg); a joint with less diverges under any stiff drive
OFF_GROUP = 30  # MuJoCo's last group of actuators, which robot.xml switches off
TARGET_MARGIN = 0.1  # of the recorded range, beyond which the allowed targets lie
GAINS_APART = 0.05  # relative difference of gains that recordings were made with


@dataclass(frozen=True)
class AxisProposal:
    """One axis: its joint's match, units, limits, signals and drive, each with its reason."""

    match: Match
    name: str
    slides: bool
    unit: PositionUnit
    limits: tuple[float, float]
    limits_why: str
    tick: float  # in recorded units; 0 where none is seen
    velocity: bool
    drive: DriveProposal
    armature: Proposed | None
    actuator: str


@dataclass(frozen=True)
class NewRig:
    """The files of a new rig.

    Attributes:
        model: its file.
        notes: one sentence each on how the recordings were interpreted.
        known: rules for --known, where recordings were made with different gains.
    """

    model: Path
    notes: tuple[str, ...]
    known: tuple[str, ...]


def new_rig(
    robot: Robot,
    recordings: Sequence[Recording],
    folder: Path,
    match: Mapping[str, str] | None = None,
    position: str | None = None,
    effort: str | None = None,
    ticks: Ticks | None = None,
) -> NewRig:
    """Writes rig.yaml and model.yaml into a folder, and robot.xml if a joint lacks a named actuator or has
    several.

    Args:
        match: joint of the model -> recorded name.
        position: unit of recorded positions and targets; inferred from their range where None.
        effort: unit of recorded efforts; inferred from the model's inverse dynamics where None.
        ticks: how to convert positions in ticks.

    Raises:
        InputError: nothing matches, or no recording can be read.
    """
    topics = find_topics(recordings[0])
    first = recordings[0]
    commands = first.topics[topics.commands] if topics.commands else None
    matches = match_joints(robot, first.topics[topics.states], commands, match or {})
    illegal = [m.recorded for m in matches if not WORD.fullmatch(m.recorded)]
    if illegal:
        raise InputError(
            [f"The joint '{n}' is not a legal ROS topic word (letters, digits and single underscores); publish it "
             "under another name, or import a table with --csv." for n in illegal]
        )  # fmt: skip
    step = sample_time(recordings, topics)
    axes = []
    for m in matches:
        samples = [sample(r, topics, m, step) for r in recordings]
        axes.append(_axis(robot, m, samples, recordings, topics, position, effort, ticks))
    mjcf, changed = _robot_file(robot, [a.match.joint for a in axes], folder)
    axes = [_with_actuator(a, robot) for a in axes]
    write_new(folder / "rig.yaml", _rig_text(robot, mjcf, axes, step, topics, recordings))
    write_new(folder / "model.yaml", _model_text(robot, axes, recordings))
    notes = [*(note for a in axes for note in _found(a)), *changed]
    undriven = [j for j in robot.joints if j not in [a.match.joint for a in axes]]
    notes += [f"Not driven here, because no recording commands it: {', '.join(undriven)}."] if undriven else []
    return NewRig(folder / "model.yaml", tuple(notes), tuple(_known(axes, recordings)))


def _found(a: AxisProposal) -> list[str]:
    """How an axis was interpreted."""
    effort = f" Its effort is in {a.drive.effort}: {a.drive.effort_why}." if a.drive.effort else ""
    return [
        *([a.unit.doubt] if a.unit.doubt else []),
        f"Joint {a.match.joint} is recorded as {a.match.recorded}: {a.match.why}. Its position is in {a.unit.name}: "
        f"{a.unit.why}.{effort}",
        f"Drive {a.name} is a {a.drive.kind}: {a.drive.why}.",
    ]


def sample_time(recordings: Sequence[Recording], topics: Topics) -> float:
    """s: the usual time between measurements, to two digits."""
    apart = [
        float(np.median(np.diff(r.stamps(topics.states)))) * 1e-9
        for r in recordings
        if len(r.stamps(topics.states)) > 1
    ]
    if not apart:
        raise InputError("The recordings hold fewer than two measurements.")
    return float(np.clip(float(f"{np.median(apart):.2g}"), 1e-4, 1.0))


def _axis(
    robot: Robot, m: Match, samples: Sequence[Sampled], recordings: Sequence[Recording], topics: Topics,
    position: str | None, effort: str | None, ticks: Ticks | None,
) -> AxisProposal:  # fmt: skip
    joint = robot.mj.joint(m.joint)
    slides = int(joint.type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
    seen, sent = all_of(samples, "position"), all_of(samples, "target")
    if not len(seen) or not len(sent):
        raise InputError(f"Joint {m.recorded}: no numbers in its position or command. Leave it out, or record it.")
    bounds = robot.mj.jnt_range[joint.id] if robot.mj.jnt_limited[joint.id] else None
    unit = position_unit(m, slides, bounds, seen, sent, position, ticks)
    scale, zero = unit.scale, unit.zero
    efforts, efforts_why = effort_unit(robot, m.joint, samples, scale, zero)
    if effort and efforts:
        efforts, efforts_why = effort, "as --effort-unit says"
    drive = propose_drive(robot, m.joint, samples, scale, zero, efforts, efforts_why)
    reached = [scale * (value - zero) for part in (seen, sent) for value in (part.min(), part.max())]
    low, high = min(reached), max(reached)
    if robot.mj.jnt_limited[joint.id]:
        limits = tuple(float(v) for v in robot.mj.jnt_range[joint.id])
        limits_why = "the joint's range in the model"
        if low < limits[0] or high > limits[1]:
            limits = (min(limits[0], float(low)), max(limits[1], float(high)))
            limits_why += ", widened to what was recorded"
    else:
        more = TARGET_MARGIN * max(float(high - low), 1e-6)
        limits = (float(f"{low - more:.3g}"), float(f"{high + more:.3g}"))
        limits_why = "a tenth beyond what was recorded; the model has no range"
    topic = recordings[0].topics[topics.states]
    speeds = topic.columns.get(f"{m.recorded}.velocity")
    velocity = speeds is not None and bool(np.isfinite(speeds).any()) and float(np.ptp(speeds[np.isfinite(speeds)])) > 0
    raw = [r.topics[topics.states].columns[f"{m.recorded}.position"] for r in recordings]
    tick = resolution([values[np.isfinite(values)] for values in raw])
    inertia, _ = inertia_of(robot, m.joint)
    armature = float(robot.mj.dof_armature[int(joint.dofadr[0])])
    guess = None
    if armature < LEAST_ARMATURE:
        size = float(f"{max(0.05 * inertia, LEAST_ARMATURE):.2g}")
        guess = Proposed(
            size, "kg" if slides else "kg m^2", "the model has none; a twentieth of what the joint turns, to be fitted"
        )
    name = "".join(c if c.isalnum() else "_" for c in m.joint).strip("_") or "axis"
    while "__" in name:
        name = name.replace("__", "_")
    return AxisProposal(
        m, name if name[0].isalpha() else f"a_{name}", slides, unit, (limits[0], limits[1]), limits_why, tick,
        velocity, drive, guess, robot.actuators.get(m.joint, ""),
    )  # fmt: skip


def _robot_file(robot: Robot, joints: Sequence[str], folder: Path) -> tuple[Path, list[str]]:
    """The file that the rig names: the given one, or robot.xml with one actuator on each driven joint; and sentences
    on what differs from the given one."""
    missing = [joint for joint in joints if joint not in robot.actuators]
    unnamed = [joint for joint in joints if joint in robot.unnamed]
    others = {joint: robot.others[joint] for joint in joints if joint in robot.others}
    if not missing and not unnamed and not others:
        return robot.path.resolve(), []
    spec = read_spec(robot.path)
    name_actuators(spec)
    home = robot.path.resolve().parent
    for place, files in (("meshdir", spec.meshes), ("texturedir", spec.textures)):
        if files:  # the new file lies elsewhere
            setattr(spec, place, str((home / getattr(spec, place)).resolve()))
    for joint in missing:
        spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    for name in (name for names in others.values() for name in names):
        spec.actuator(name).group = OFF_GROUP
        spec.option.disableactuator |= 1 << OFF_GROUP
    if robot.path.suffix == ".urdf":
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    compile_spec(spec, robot.path)
    file = folder / "robot.xml"
    write_new(file, spec.to_xml())
    notes = [
        f"The actuator of joint {joint} has no name in {robot.path.name}; in robot.xml it is called "
        f"{robot.actuators[joint]}."
        for joint in unnamed
    ]
    notes += [
        f"Joint {joint} has more than one actuator. Its drive uses {robot.actuators[joint]}; {', '.join(names)} "
        f"would act in addition and is switched off in robot.xml (group {OFF_GROUP}, which its option "
        "'actuatorgroupdisable' names)."
        for joint, names in others.items()
    ]
    return file, notes


def _with_actuator(axis: AxisProposal, robot: Robot) -> AxisProposal:
    from dataclasses import replace

    return axis if axis.actuator else replace(axis, actuator=axis.match.joint)


def _rig_text(
    robot: Robot, mjcf: Path, axes: Sequence[AxisProposal], step: float, topics: Topics, recordings: Sequence[Recording]
) -> str:
    source = f"from {robot.path.name} and {_count(recordings)}"
    inside = mjcf.name if mjcf.name == "robot.xml" and mjcf != robot.path.resolve() else str(mjcf)
    lines = [
        f"# Made by eps-tunnel new-rig {source}. Change what you know better.",
        f"name: {_yaml(robot.path.stem)}",
        f"mjcf: {_yaml(inside)}"
        + ("" if inside != "robot.xml" else f"  # {robot.path.name} with one actuator on each driven joint"),
        f"sample_time: {step:g}  # s, median time between measurements",
    ]
    if topics.entries:
        lines.append("topics:  # as the recordings name them")
        lines += [f"  {key}: {_yaml(value)}" for key, value in topics.entries.items()]
    lines.append("axes:")
    for a in axes:
        unit = a.unit.entry
        lines += [
            f"  {a.name}:  # {a.match.why}",
            f"    command: {{channel: {_yaml(a.match.command)}{unit}}}  # {a.unit.name}: {a.unit.why}",
            f"    actuator: {_yaml(a.actuator)}",
            f"    joint: {_yaml(a.match.joint)}",
            f"    limits: [{a.limits[0]:.6g}, {a.limits[1]:.6g}]  # {'m' if a.slides else 'rad'}: {a.limits_why}",
            "    measured:",
        ]
        tick = f", resolution: {a.tick:.4g}" if a.tick > 0.0 else ""
        why = "the smallest step in the recordings" if tick else "no ticks are seen"
        signal = a.match.recorded
        lines.append(
            f"      {signal}: {{joint: {_yaml(a.match.joint)}, quantity: position{unit}{tick}}}  # resolution: {why}"
        )
        if a.velocity:
            lines.append(
                f"      {signal}_velocity: {{joint: {_yaml(a.match.joint)}, quantity: velocity{a.unit.speed_entry}}}"
            )
        if a.drive.effort:
            kind = "" if a.drive.effort in ("N m", "N") else f", unit: {a.drive.effort}"
            lines.append(
                f"      {signal}_effort: {{joint: {_yaml(a.match.joint)}, quantity: torque{kind}}}  "
                f"# {a.drive.effort}: {a.drive.effort_why}"
            )
    return "\n".join(lines) + "\n"


def _count(recordings: Sequence[Recording]) -> str:
    return f"{len(recordings)} recording{'s' * (len(recordings) > 1)}"


def _yaml(text: str) -> str:
    """A word as it stands in YAML, quoted where it must be."""
    return yaml_text({"x": text}).splitlines()[-1].removeprefix("x: ")


def _model_text(robot: Robot, axes: Sequence[AxisProposal], recordings: Sequence[Recording]) -> str:
    content: dict[str, object] = {
        "name": robot.path.stem,
        "description": f"Proposed by eps-tunnel new-rig from {_count(recordings)}; calibrate it.",
        "rig": "rig.yaml",
        "drives": {
            a.name: {"kind": a.drive.kind, "values": {name: _entry(number) for name, number in a.drive.values.items()}}
            for a in axes
        },
        "effects": [],
    }
    guessed = {f"joint.{a.match.joint}.armature": _entry(a.armature) for a in axes if a.armature}
    for a in axes:
        if a.drive.factor is not None:
            word, unit, _ = SCALES[a.drive.effort.removeprefix("m")]
            factor = a.drive.factor * (1e3 if a.drive.effort.startswith("m") else 1.0)
            why = "the drive's stiffness over that of the recorded effort; to be fitted"
            number = Proposed(float(f"{factor:.3g}"), slide_unit(unit) if a.slides else unit, why)
            guessed[f"{EFFORT}.{a.match.recorded}_effort.{word}"] = _entry(number)
    if guessed:
        content["quantities"] = guessed
    reasons = "".join(f"# Drive {a.name} is a {a.drive.kind}: {a.drive.why}.\n" for a in axes)
    return reasons + yaml_text(content)


def _entry(number: Proposed) -> dict[str, object]:
    return {"value": number.value, "unit": number.unit, "from": number.why}


def _known(axes: Sequence[AxisProposal], recordings: Sequence[Recording]) -> list[str]:
    """Rules for gains that differ between recordings; by folder where each folder has one gain."""
    rules = []
    for a in axes:
        gains = np.array(a.drive.gains)
        if len(gains) < 2 or gains.min() <= 0.0 or gains.max() <= (1.0 + GAINS_APART) * gains.min():
            continue
        order = np.argsort(gains)
        jumps = gains[order][1:] > (1.0 + GAINS_APART) * gains[order][:-1]
        group = np.empty(len(gains), dtype=int)
        group[order] = np.concatenate([[0], np.cumsum(jumps)])
        folders = [str(r.path.parent) for r in recordings]
        for number in range(int(group.max()) + 1):
            value = float(np.median(gains[group == number]))
            own = {f for f, g in zip(folders, group, strict=True) if g == number}
            whole = not own & {f for f, g in zip(folders, group, strict=True) if g != number}
            patterns = sorted(f"{f}/*" for f in own) if whole else [
                str(r.path) for r, g in zip(recordings, group, strict=True) if g == number
            ]  # fmt: skip
            rules += [f"{pattern}:drive.{a.name}.kp={value:.4g}" for pattern in patterns]
    return rules
