# SPDX-License-Identifier: Apache-2.0
"""What a robot's model and its recordings have in common: joints by name, actuators, topics, limits, units."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.recording import Recording, StampedTopic
from eps_tunnel_analysis.recording.channel_map import namespace_of
from eps_tunnel_analysis.recording.decode import JOINT_STATE
from labyrinth_sim.asset import compile_spec, read_spec
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

COMMAND_TOPICS = re.compile(r"(command|cmd|goal|target|desired|reference|action|setpoint)s?$")
ONE_DEGREE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
ON_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


@dataclass(frozen=True)
class Robot:
    """A compiled MJCF or URDF.

    Attributes:
        joints: hinge and slide joints by name.
        actuators: joint -> the actuator that drives it, for joints that have one.
        unnamed: joints whose actuator has no name in the file and gets one here.
        others: joint -> further actuators on it, which would act in addition to the drive.
    """

    path: Path
    mj: mujoco.MjModel
    joints: tuple[str, ...]
    actuators: Mapping[str, str]
    unnamed: frozenset[str] = frozenset()
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def read_robot(path: Path) -> Robot:
    """Compiles a model. Raises InputError with MuJoCo's reason."""
    if not path.is_file():
        raise InputError(f"{path}: no such file. Name an MJCF (.xml) or a URDF (.urdf).")
    spec = read_spec(path)
    given = name_actuators(spec)
    mj = compile_spec(spec, path)
    joints = tuple(mj.joint(i).name for i in range(mj.njnt) if int(mj.jnt_type[i]) in ONE_DEGREE and mj.joint(i).name)
    on: dict[str, list[str]] = {}
    for actuator in sorted(spec.actuators, key=lambda one: one.name in given):  # names of the file's own count first
        if actuator.trntype in ON_JOINT:
            on.setdefault(actuator.target, []).append(actuator.name)
    if not joints:
        raise InputError(f"{path}: it has no named hinge or slide joint, so there is nothing to drive.")
    return Robot(
        path, mj, joints, {joint: names[0] for joint, names in on.items()},
        frozenset(joint for joint, names in on.items() if names[0] in given),
        {joint: tuple(names[1:]) for joint, names in on.items() if len(names) > 1},
    )  # fmt: skip


def name_actuators(spec: mujoco.MjSpec) -> frozenset[str]:
    """Names unnamed actuators after their joint; returns the new names."""
    taken = {actuator.name for actuator in spec.actuators}
    given = set()
    for actuator in spec.actuators:
        if actuator.trntype in ON_JOINT and not actuator.name:
            names = (actuator.target if i == 1 else f"{actuator.target}_{i}" for i in count(1))
            actuator.name = next(name for name in names if name not in taken)
            taken.add(actuator.name)
            given.add(actuator.name)
    return frozenset(given)


@dataclass(frozen=True)
class Topics:
    """Where joint states and commands are in recordings, and the rig file's `topics` entries if they are not the
    default."""

    states: str
    commands: str | None
    entries: Mapping[str, str] = field(default_factory=dict)


def find_topics(recording: Recording) -> Topics:
    """The topics of JointState messages. Raises InputError where no joint is measured."""
    held = {name: topic for name, topic in recording.topics.items() if topic.type == JOINT_STATE and len(topic)}
    commands = [name for name in held if COMMAND_TOPICS.search(name.lower())]
    states = sorted((n for n in held if n not in commands), key=lambda n: (not n.endswith("joint_states"), n))
    if not states:
        others = ", ".join(f"{n} ({t.type})" for n, t in recording.topics.items())
        raise InputError(
            f"{recording.path}: no topic of joint states ({JOINT_STATE}); it holds {others or 'nothing readable'}."
        )
    sent = next((n for n in commands if set(held[n].joints) & set(held[states[0]].joints)), None) or next(
        iter(commands), None
    )
    space = namespace_of(recording)
    entries = {}
    for key, name, usual in (("states", states[0], "joint_states"), ("commands", sent, "joint_commands")):
        own = (name or "").removeprefix(space).strip("/")
        if name and own != usual:
            entries[key] = own
    return Topics(states[0], sent, entries)


@dataclass(frozen=True)
class Match:
    """One joint of the model and the name that recordings have for it; `why` they are considered the same."""

    joint: str
    recorded: str
    command: str
    why: str


def match_joints(
    robot: Robot, states: StampedTopic, commands: StampedTopic | None, given: Mapping[str, str]
) -> list[Match]:
    """Joints of the model that recordings measure and command.

    Args:
        given: joint of the model -> recorded name, as stated by the user.

    Raises:
        InputError: none match, or a given name does not exist; lists both sides.
    """
    recorded, sent = states.joints, commands.joints if commands else ()
    inventory = f"The model has {', '.join(robot.joints)}; the recordings measure {', '.join(recorded)}"
    wrong = [
        f"--match {j}={r}: no such pair. {inventory}."
        for j, r in given.items()
        if j not in robot.joints or r not in recorded
    ]
    if wrong:
        raise InputError(wrong)
    if not sent:
        raise InputError(
            "The recordings hold no commands. Expected a topic of JointState targets whose name ends in "
            "'joint_commands', 'command', 'goal' or the like; record what is sent to the drives."
        )
    pairs = {j: (r, "as --match says") for j, r in given.items()}
    for name in recorded:
        if name in [r for r, _ in pairs.values()]:
            continue
        alike = [j for j in robot.joints if j not in pairs and _plain(j) == _plain(name)]
        if name in robot.joints and name not in pairs:
            pairs[name] = (name, "the same name")
        elif len(alike) == 1:
            pairs[alike[0]] = (name, f"the same name, spelled differently ({name})")
    if not pairs and len(robot.joints) == len(recorded) == 1:
        pairs[robot.joints[0]] = (recorded[0], "the only joint on either side")
    if not pairs:
        raise InputError(f"No joint matches by name. {inventory}. Say which is which by --match JOINT=RECORDED.")
    matches = []
    for joint in robot.joints:
        if joint in pairs:
            name, why = pairs[joint]
            command = name if name in sent else next((s for s in sent if _plain(s) == _plain(name)), None)
            command = sent[0] if command is None and len(sent) == len(recorded) == 1 else command
            if command is not None:
                matches.append(Match(joint, name, command, why))
    if not matches:
        raise InputError(f"No measured joint is commanded. Commands are for {', '.join(sent)}. {inventory}.")
    return matches


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower()).removesuffix("joint")


@dataclass(frozen=True)
class Sampled:
    """One joint in one recording on an even grid: times (T,) s, and target, position, effort (T,) as recorded.

    NaN where the drive was off, and where there is no effort.
    """

    time: Array
    target: Array
    position: Array
    effort: Array


def sample(recording: Recording, topics: Topics, match: Match, step: float) -> Sampled:
    """A joint's channels: commands held, measurements interpolated, from the first command on."""
    from eps_tunnel_analysis.stamped import hold, interpolate

    states = recording.topics[topics.states]
    commands = recording.topics[topics.commands or ""]
    at, sent = recording.stamps(states.name), recording.stamps(commands.name)
    first, last = max(int(at[0]), int(sent[0])), int(at[-1])
    grid = np.arange(first, last, max(round(step * 1e9), 1), dtype=np.int64)

    def read(topic: StampedTopic, stamps: NDArray[np.int64], column: str, held: bool) -> Array:
        values = topic.columns.get(column)
        if values is None:
            return np.full(len(grid), np.nan)
        good = np.isfinite(values)
        if held:
            return hold(stamps[good], values[good], grid, 0.5)
        return interpolate(stamps[good], values[good], grid, 1.0)

    return Sampled(
        np.asarray((grid - first) * 1e-9, dtype=np.float64),
        read(commands, sent, f"{match.command}.position", True),
        read(states, at, f"{match.recorded}.position", False),
        read(states, at, f"{match.recorded}.effort", False),
    )


def all_of(samples: Sequence[Sampled], name: str) -> Array:
    """(n,) of all recordings, finite."""
    values = np.concatenate([getattr(s, name) for s in samples])
    return np.asarray(values[np.isfinite(values)])
