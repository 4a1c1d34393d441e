# SPDX-License-Identifier: Apache-2.0
"""ChannelMap: which column of which topic is which signal or command."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE
from eps_tunnel_analysis.recording.recording import Recording
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.rig import BALL_SIGNALS, Rig, Unit
from labyrinth_sim.trials import Array

FIELDS = {"position": ("position", ""), "velocity": ("velocity", "_velocity"), "torque": ("effort", "_effort")}
UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N m"}


@dataclass(frozen=True)
class Source:
    """One signal or command channel: `name`, found in `column` of `topic`, in `unit` (SI) after conversion.

    `limits` are the lowest and highest target that the rig allows a command; None where that is not known. `recorded`
    says how the recording holds the channel; in `unit` if that is None.
    """

    name: str
    topic: str
    type: str
    column: str
    unit: str
    limits: tuple[float, float] | None = None
    recorded: Unit | None = None

    def to_si(self, values: Array) -> Array:
        """Recorded values in `unit`."""
        return values if self.recorded is None else self.recorded.to_si(values)


@dataclass(frozen=True)
class ChannelMap:
    """The measured signals and the command channels of one side (`/real` or `/sim`)."""

    signals: tuple[Source, ...]
    commands: tuple[Source, ...]

    def select(self, names: Iterable[str]) -> "ChannelMap":
        """The same with these signals only. Raises InputError that lists the valid names."""
        known = {source.name: source for source in self.signals}
        names = tuple(names)
        complaints = [unknown_name("signal", name, known) for name in names if name not in known]
        if complaints:
            raise InputError(complaints)
        return ChannelMap(tuple(known[name] for name in names), self.commands)


def channel_map(rig: Rig, namespace: str) -> ChannelMap:
    """What a rig says, under `/real` or `/sim`.

    A signal is found by its own name: `motor_x` is the position of joint `motor_x` in the rig's topic of joint states,
    `motor_x_velocity` its velocity, `motor_x_effort` its effort. The units that a rig states are those of the real
    side; a simulation's own topics, under `/sim`, are SI, and hold all joints in one.
    """
    states_units = namespace.strip("/") != "sim"

    def topic(key: str, own: str = "") -> str:
        return "/".join(("", *f"{namespace}/{own or rig.topics[key]}".strip("/").split("/")))

    signals = []
    for measured in rig.measured:
        column, suffix = FIELDS[measured.quantity]
        joint = measured.signal.removesuffix(suffix)
        recorded = measured.recorded if states_units else None
        at = topic("states", measured.topic if states_units else ""), JOINT_STATE, f"{joint}.{column}"
        signals.append(Source(measured.signal, *at, measured.unit, recorded=recorded))
    if rig.ball:
        signals += [Source(f"ball_{axis}", topic("ball"), BALL_STATE, axis, "m") for axis in "xy"]
    commands = [
        Source(a.command, topic("commands"), JOINT_STATE, f"{a.command}.position", a.recorded.si, a.limits,
               a.recorded if states_units else None)
        for a in rig.axes
    ]  # fmt: skip
    return ChannelMap(tuple(signals), tuple(commands))


def guessed_map(recording: Recording, namespace: str | None = None) -> ChannelMap:
    """What a bag itself contains: every joint's position, velocity and effort, every command, and the ball.

    Raises:
        InputError: nothing is measured, or a name is in two topics.
    """
    prefix = namespace_of(recording) if namespace is None else namespace
    signals: list[Source] = []
    commands: list[Source] = []
    for name, topic in recording.topics.items():
        if not name.startswith(prefix):
            continue
        if topic.type == JOINT_STATE and name.endswith("commands"):
            commands += [Source(j, name, topic.type, f"{j}.position", "rad") for j in topic.joints]
        elif topic.type == JOINT_STATE:
            for column, values in topic.columns.items():
                if np.isnan(values).all():  # how some drivers say that they do not measure it
                    continue
                joint, _, quantity = column.rpartition(".")
                signal = joint if quantity == "position" else f"{joint}_{quantity}"
                signals.append(Source(signal, name, topic.type, column, UNITS[quantity]))
        elif topic.type == BALL_STATE:
            signals += [Source(f"ball_{axis}", name, topic.type, axis, "m") for axis in "xy"]
    names = [source.name for source in signals]
    for name in {name for name in names if names.count(name) > 1}:
        topics = ", ".join(sorted({source.topic for source in signals if source.name == name}))
        raise InputError(
            f"{recording.path}: signal '{name}' is in several topics ({topics}). Name the rig, or one side."
        )
    if not signals:
        raise InputError(
            f"{recording.path}: no measured signals. Expected joint states ({JOINT_STATE}) or a ball ({BALL_STATE}); "
            f"it holds {', '.join(f'{n} ({t.type})' for n, t in recording.topics.items()) or 'neither'}."
        )
    return ChannelMap(tuple(signals), tuple(commands))


def held_by_all(rig: Rig, recordings: Sequence[Recording]) -> list[str]:
    """A rig's joint positions, and those of its efforts and of its ball that have numbers in every recording."""
    holding = []
    for recording in recordings:
        sources = channel_map(rig, namespace_of(recording)).signals
        holding.append({source.name for source in sources if _holds(recording, source)})
    optional = {*BALL_SIGNALS, *(m.signal for m in rig.measured if m.quantity == "torque")}
    wanted = set(rig.positions) | optional.intersection(*holding)
    return [name for name in rig.signals if name in wanted]


def _holds(recording: Recording, source: Source) -> bool:
    topic = recording.topics.get(source.topic)
    column = topic.columns.get(source.column) if topic else None
    if column is None or not (seen := column[np.isfinite(column)]).size:
        return False
    return not source.column.endswith(".effort") or bool(np.ptp(seen) > 0.0)  # some drivers fill in zeros


def namespace_of(recording: Recording) -> str:
    """`/real` for a bag that holds `/real/joint_states`; the first one if a bag holds several."""
    for name in (*recording.topics, *recording.others):
        for ending in ("/joint_states", "/joint_commands", "/ball"):
            if name.endswith(ending):
                return name.removesuffix(ending)
    return ""
