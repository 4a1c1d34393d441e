# SPDX-License-Identifier: Apache-2.0
"""A rig: which MJCF, which axes, what is measured and in which units. Read from config/rigs/NAME.yaml."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from labyrinth_sim.config import find
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array
from labyrinth_sim.yaml_file import Document, Entry, Text, Where, read_yaml

QUANTITIES = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "torque": ("N m", "N")}
"""Quantity of a joint -> SI unit of a hinge, of a slide joint. The torque of a slide joint is its force."""

TOPICS = {"commands": "joint_commands", "states": "joint_states", "ball": "ball", "ball_event": "ball_event"}
BALL_SIGNALS = ("ball_x", "ball_y")

WORD = re.compile(r"[A-Za-z](_?[A-Za-z0-9])*_?")
"""A legal ROS topic word, as signals and axes are named."""
_LEGAL = "letters, digits and single underscores, a letter first"
_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Unit:
    """How a channel is recorded: SI value = scale * (recorded - zero).

    Attributes:
        name: of the recorded unit.
        si: unit of the SI value; of what was recorded where the factor to SI is not known.
        scale: in si per recorded unit.
        zero: recorded value that stands for 0.
        free: whether the factor from `si` to the quantity's own unit is not known, as for a current without its torque
            constant; the model has it as a value, `effort.SIGNAL.torque_constant`, that can be fitted.
    """

    name: str
    si: str
    scale: float = 1.0
    zero: float = 0.0
    free: bool = False

    def to_si(self, recorded: ArrayLike) -> Array:
        """Recorded values in the unit `si`."""
        return np.asarray(self.scale * (np.asarray(recorded, float) - self.zero))


@dataclass(frozen=True)
class Measured:
    """One measured signal: `quantity` ("position", "velocity", "torque") of a joint of the MJCF.

    `resolution` is the coarsest tick that its sensor is known to have, in SI; 0 where that is not known. `slides` says
    whether the joint is a slide joint. `topic` is where the real rig publishes it, where that is not the rig's topic of
    joint states: a sensor with a clock of its own.
    """

    signal: str
    joint: str
    quantity: str
    recorded: Unit
    resolution: float = 0.0
    slides: bool = False
    topic: str = ""

    @property
    def unit(self) -> str:
        """Of the signal's values: SI."""
        return self.recorded.si


@shown
@dataclass(frozen=True)
class Axis:
    """One driven axis, a hinge (rad, N m) or a slide joint (m, N).

    Attributes:
        name: short name, as in `drive.x.p`.
        command: command channel, the joint's name in NS/joint_commands.
        actuator, joint: of the MJCF; the drive's feedback is the joint's position.
        measured: the signals of this axis.
        recorded: how recordings hold the command.
        load_joint, belt: joint behind a belt and the fixed tendon that is the belt, or None.
        limits: rad or m, allowed targets.
        slides: whether the driven joint is a slide joint.
        turns: part, as "motor" or "belt wheel" -> its turns for one turn of the driven joint.
    """

    name: str
    command: str
    actuator: str
    joint: str
    measured: tuple[Measured, ...]
    recorded: Unit = Unit("rad", "rad")
    load_joint: str | None = None
    belt: str | None = None
    limits: tuple[float, float] = (-3.2, 3.2)
    slides: bool = False
    turns: Mapping[str, float] = field(default_factory=dict)

    @property
    def load(self) -> str:
        """The joint that carries the load."""
        return self.load_joint or self.joint

    @property
    def positions(self) -> tuple[str, ...]:
        """The signals that are positions of its joints."""
        return tuple(m.signal for m in self.measured if m.quantity == "position")

    @property
    def finest_first(self) -> tuple[Measured, ...]:
        """What is measured, what is read in the finest ticks first."""
        return tuple(sorted(self.measured, key=lambda m: m.resolution))


@dataclass(frozen=True)
class Ball:
    """A ball: its free joint, and the site that is origin and frame of `ball_x`, `ball_y` (m)."""

    joint: str
    site: str


@shown
@dataclass(frozen=True)
class Rig:
    """A rig. `sample_time` in s; `mjcf_without_ball` serves questions about the drives alone."""

    name: str
    mjcf: Path
    axes: tuple[Axis, ...]
    description: str = ""
    sample_time: float = 0.01
    ball: Ball | None = None
    mjcf_without_ball: Path | None = None
    topics: Mapping[str, str] = field(default_factory=lambda: dict(TOPICS))
    path: Path | None = None

    @property
    def rate(self) -> float:
        """Hz, at which the rig is commanded and measured."""
        return 1.0 / self.sample_time

    @property
    def command_channels(self) -> tuple[str, ...]:
        return tuple(axis.command for axis in self.axes)

    @property
    def measured(self) -> tuple[Measured, ...]:
        return tuple(m for axis in self.axes for m in axis.measured)

    @property
    def positions(self) -> tuple[str, ...]:
        """The signals that are positions of joints."""
        return tuple(signal for axis in self.axes for signal in axis.positions)

    @property
    def efforts(self) -> dict[str, int]:
        """Of the signals that are efforts of drives, each one's -> the number of its axis."""
        driven = {axis.joint: number for number, axis in enumerate(self.axes)}
        return {m.signal: driven[m.joint] for m in self.measured if m.quantity == "torque" and m.joint in driven}

    @property
    def signals(self) -> tuple[str, ...]:
        """Every signal of the rig, the ball's last."""
        return tuple(m.signal for m in self.measured) + (BALL_SIGNALS if self.ball else ())

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(m.unit for m in self.measured) + (("m", "m") if self.ball else ())

    @property
    def position_unit(self) -> str:
        """Unit of errors of the rig's positions: rad, or m if every axis slides."""
        return "m" if all(axis.slides for axis in self.axes) else "rad"

    def axis(self, name: str) -> Axis:
        """An axis by its short name. Raises InputError that lists the valid ones."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise InputError(unknown_name("axis", name, [a.name for a in self.axes]))


# The file


def _ordered(limits: list[float]) -> list[float]:
    if not limits[0] < limits[1]:
        raise ValueError(f"expected [low, high] with low < high, got {limits}.")
    return limits


def _turning(turns: float) -> float:
    if not (math.isfinite(turns) and turns != 0.0):
        raise ValueError(f"expected how often it turns while the joint turns once, and not 0; got {turns}.")
    return turns


class _RigFile(Entry):
    name: Text
    mjcf: Text
    axes: dict[str, Any] = Field(min_length=1)
    description: Text = ""
    sample_time: float = Field(0.01, ge=1e-4, le=1.0, json_schema_extra={"unit": "s"})
    ball: dict[str, Any] | None = None
    mjcf_without_ball: Text | None = None
    topics: dict[str, Any] | None = None


class _BallEntry(Entry):
    joint: Text
    site: Text


class _TopicsEntry(Entry):
    noun = "topic"
    commands: Text = TOPICS["commands"]
    states: Text = TOPICS["states"]
    ball: Text = TOPICS["ball"]
    ball_event: Text = TOPICS["ball_event"]


class _UnitEntry(Entry):
    """What a channel may say of its unit."""

    unit: Text | None = None
    zero: float = 0.0
    ticks_per_turn: float | None = None
    ticks_per_m: float | None = None
    torque_constant: float | None = None
    stall_torque: float | None = None


class _CommandEntry(_UnitEntry):
    channel: Text


class _SignalEntry(_UnitEntry):
    joint: Text
    quantity: Literal["position", "velocity", "torque"]
    resolution: float | None = Field(None, ge=0.0)
    topic: Text | None = None


class _AxisEntry(Entry):
    command: Text | dict[str, Any]
    actuator: Text
    joint: Text
    measured: dict[str, Any]
    load_joint: Text | None = None
    belt: Text | None = None
    limits: Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(_ordered)] | None = None
    turns: dict[Text, Annotated[float, AfterValidator(_turning)]] | None = None


def load_rig(name: str | Path) -> Rig:
    """Reads config/rigs/NAME.yaml, or a file by path.

    Raises:
        InputError: all that is wrong with the file.
    """
    path = find("rigs", name)
    document = read_yaml(path)
    entry = document.read(_RigFile)
    files = {key: document.file((key,), "mjcf", path) for key in ("mjcf", "mjcf_without_ball")}
    sliding = _slide_joints(document, files["mjcf"])
    axes = [_read_axis(document, key, sliding) for key in document.mapping(("axes",))]
    signals = [(m.signal, axis.name) for axis in axes if axis for m in axis.measured]
    for i, (signal, axis) in enumerate(signals):
        if signal in [earlier for earlier, _ in signals[:i]]:
            document.complain(("axes", axis, "measured", signal), f"the signal '{signal}' occurs in two axes.")
    topics = document.read(_TopicsEntry, ("topics",)) if document.mapping(("topics",)) else None
    ball = document.read(_BallEntry, ("ball",)) if document.mapping(("ball",)) else None
    document.check()
    assert entry is not None
    assert files["mjcf"] is not None
    return Rig(
        name=entry.name,
        mjcf=files["mjcf"],
        axes=tuple(a for a in axes if a),
        description=entry.description,
        sample_time=entry.sample_time,
        ball=Ball(ball.joint, ball.site) if ball else None,
        mjcf_without_ball=files["mjcf_without_ball"],
        topics=topics.model_dump() if topics else dict(TOPICS),
        path=path,
    )


def _slide_joints(document: Document, mjcf: Path | None) -> frozenset[str]:
    from labyrinth_sim.asset import slide_joints  # MuJoCo takes 0.2 s, which who only records does without

    try:
        return slide_joints(mjcf) if mjcf else frozenset()
    except InputError as error:
        document.complain(("mjcf",), str(error))
        return frozenset()


def _read_axis(document: Document, name: str, sliding: frozenset[str]) -> Axis | None:
    where: Where = ("axes", name)
    if not WORD.fullmatch(name):
        document.complain(where, f"the axis's name '{name:.60}' must be {_LEGAL}.")
    entry = document.read(_AxisEntry, where)
    measured = [
        _read_signal(document, (*where, "measured"), s, sliding) for s in document.mapping((*where, "measured"))
    ]
    slides = str(document.value((*where, "joint"))) in sliding
    command, recorded = _read_command(document, (*where, "command"), slides)
    if entry is None:
        return None
    if bool(entry.belt) != bool(entry.load_joint):
        document.complain(where, "belt and load_joint come together or not at all.")
    if entry.limits is None and slides:
        document.complain(where, "a slide joint needs 'limits: [low, high]', the allowed targets in m.")
    return Axis(
        name=name,
        command=command,
        actuator=entry.actuator,
        joint=entry.joint,
        measured=tuple(m for m in measured if m),
        recorded=recorded,
        load_joint=entry.load_joint or None,
        belt=entry.belt or None,
        limits=(entry.limits[0], entry.limits[1]) if entry.limits else Axis.limits,
        slides=slides,
        turns=entry.turns or {},
    )


def _read_command(document: Document, where: Where, slides: bool) -> tuple[str, Unit]:
    value = document.value(where)
    if not isinstance(value, dict):  # a channel's name alone; what else it may be, the axis's schema has refused
        si = QUANTITIES["position"][slides]
        return str(value), Unit(si, si)
    entry = document.read(_CommandEntry, where)
    if entry is None:
        return "", Axis.recorded
    return entry.channel, _read_unit(document, where, entry, "position", slides)


def _read_signal(document: Document, where: Where, signal: str, sliding: frozenset[str]) -> Measured | None:
    if not WORD.fullmatch(signal):
        document.complain((*where, signal), f"signal '{signal:.60}' must be a legal ROS topic word: {_LEGAL}.")
    entry = document.read(_SignalEntry, (*where, signal))
    if entry is None:
        return None
    unit = _read_unit(document, (*where, signal), entry, entry.quantity, entry.joint in sliding)
    tick = entry.resolution if entry.resolution is not None else 1.0 if unit.name.startswith("ticks") else 0.0
    resolution, slides = tick * abs(unit.scale), entry.joint in sliding
    return Measured(signal, entry.joint, entry.quantity, unit, resolution, slides, entry.topic or "")


# quantity -> recorded unit -> factor to SI, the entry that the factor is multiplied with or divided by, and its power.
_TICKS = {False: (_TURN, "ticks_per_turn", -1), True: (1.0, "ticks_per_m", -1)}
_LOADS: dict[str, tuple[float, str, int]] = {
    "A": (1.0, "torque_constant", 1),  # N m/A, or N/A
    "mA": (1e-3, "torque_constant", 1),
    "duty": (1.0, "stall_torque", 1),  # -1 to 1; N m, or N, at full duty
    "raw": (1.0, "", 0),
}
_UNITS: dict[bool, dict[str, dict[str, tuple[float, str, int]]]] = {
    False: {
        "position": {"rad": (1.0, "", 0), "deg": (_TURN / 360, "", 0), "ticks": _TICKS[False]},
        "velocity": {
            "rad/s": (1.0, "", 0),
            "deg/s": (_TURN / 360, "", 0),
            "rpm": (_TURN / 60, "", 0),
            "ticks/s": _TICKS[False],
        },
        "torque": {"N m": (1.0, "", 0), **_LOADS},
    },
    True: {
        "position": {"m": (1.0, "", 0), "mm": (1e-3, "", 0), "ticks": _TICKS[True]},
        "velocity": {"m/s": (1.0, "", 0), "mm/s": (1e-3, "", 0), "ticks/s": _TICKS[True]},
        "torque": {"N": (1.0, "", 0), **_LOADS},
    },
}
_CONSTANTS = ("ticks_per_turn", "ticks_per_m", "torque_constant", "stall_torque")


def _read_unit(document: Document, where: Where, entry: _UnitEntry, quantity: str, slides: bool) -> Unit:
    """A channel's unit. What its factor needs and lacks, or does not need and has, is complained about."""
    si, known = QUANTITIES[quantity][slides], _UNITS[slides][quantity]
    name = entry.unit or si
    if name not in known:
        document.complain((*where, "unit"), unknown_name(f"{quantity} unit", name, known))
        return Unit(name, si)
    factor, constant, power = known[name]
    given = {key: value for key in _CONSTANTS if (value := getattr(entry, key)) is not None}
    for key in given:
        if key != constant:
            users = [unit for unit, (_, needed, _) in known.items() if needed == key]
            hint = f"it belongs to the unit {' or '.join(users)}" if users else f"no {quantity} of this joint has it"
            document.complain((*where, key), f"the unit here is {name}; {hint}.")
        elif given[key] == 0.0:
            document.complain((*where, key), "must not be 0.")
            return Unit(name, si)
    if constant in given:
        return Unit(name, si, factor * given[constant] ** power, entry.zero)
    if constant.startswith("ticks"):
        document.complain(where, f"the unit {name} needs '{constant}', as '{constant}: 4096'.")
    if name in _LOADS:
        return Unit(name, "A" if constant == "torque_constant" else "1", factor, entry.zero, free=True)
    return Unit(name, si, factor, entry.zero)
