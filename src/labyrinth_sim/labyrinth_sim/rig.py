# SPDX-License-Identifier: Apache-2.0
"""A rig: which MJCF, which axes, what is measured. Read from config/rigs/NAME.yaml."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from labyrinth_sim.config import find
from labyrinth_sim.errors import InputError, unknown_name

WORD = re.compile(r"^[a-z][a-z0-9_]*$")
QUANTITIES = {"position": "rad", "velocity": "rad/s", "torque": "N m"}
TOPICS = {"commands": "joint_commands", "states": "joint_states", "ball": "ball", "ball_event": "ball_event"}
BALL_SIGNALS = ("ball_x", "ball_y")


@dataclass(frozen=True)
class Measured:
    """One measured signal: `quantity` ("position", "velocity", "torque") of a joint of the MJCF.

    `resolution` is the coarsest tick that its sensor is known to have, in the signal's unit; 0 where that is not known.
    """

    signal: str
    joint: str
    quantity: str
    resolution: float = 0.0

    @property
    def unit(self) -> str:
        return QUANTITIES[self.quantity]


@dataclass(frozen=True)
class Axis:
    """One driven axis.

    Attributes:
        name: short name, as in `drive.x.p`.
        command: command channel, the joint's name in NS/joint_commands (rad).
        actuator, joint: of the MJCF; the drive's feedback is the joint's position.
        measured: the signals of this axis.
        load_joint, belt: joint behind a belt and the fixed tendon that is the belt, or None.
        limits: rad, allowed targets.
    """

    name: str
    command: str
    actuator: str
    joint: str
    measured: tuple[Measured, ...]
    load_joint: str | None = None
    belt: str | None = None
    limits: tuple[float, float] = (-3.2, 3.2)

    @property
    def load(self) -> str:
        """The joint that carries the load."""
        return self.load_joint or self.joint


@dataclass(frozen=True)
class Ball:
    """A ball: its free joint, and the site that is origin and frame of `ball_x`, `ball_y` (m)."""

    joint: str
    site: str


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
    def command_channels(self) -> tuple[str, ...]:
        return tuple(axis.command for axis in self.axes)

    @property
    def measured(self) -> tuple[Measured, ...]:
        return tuple(m for axis in self.axes for m in axis.measured)

    @property
    def signals(self) -> tuple[str, ...]:
        """Every signal of the rig, the ball's last."""
        return tuple(m.signal for m in self.measured) + (BALL_SIGNALS if self.ball else ())

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(m.unit for m in self.measured) + (("m", "m") if self.ball else ())

    def axis(self, name: str) -> Axis:
        """An axis by its short name. Raises InputError that lists the valid ones."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise InputError(unknown_name("axis", name, [a.name for a in self.axes]))


def load_rig(name: str | Path) -> Rig:
    """Reads config/rigs/NAME.yaml, or a file by path.

    Raises:
        InputError: all that is wrong with the file.
    """
    path = find("rigs", name)
    data = read_yaml(path)
    complaints: list[str] = []
    known = set(Rig.__dataclass_fields__) - {"path"}
    complaints += [f"{path}: {unknown_name('entry', key, known)}" for key in data if key not in known]
    missing = [f"{path}: '{key}' is missing." for key in ("name", "mjcf", "axes") if key not in data]
    if missing:
        raise InputError(complaints + missing)
    axes = [
        _axis(path, key, entry, complaints) for key, entry in _mapping(path, "axes", data["axes"], complaints).items()
    ]
    if not axes:
        complaints.append(f"{path}: 'axes' must name at least one axis.")
    files: dict[str, Path | None] = {}
    for key in ("mjcf", "mjcf_without_ball"):
        try:
            files[key] = find_beside(path, "mjcf", str(data[key])) if data.get(key) else None
        except InputError as error:
            complaints += error.complaints
    step = data.get("sample_time", 0.01)
    if not is_number(step) or not 1e-4 <= step <= 1:
        complaints.append(f"{path}: sample_time must be a number from 0.0001 to 1 s, got {step!r}.")
    topics = dict(TOPICS)
    for key, value in _mapping(path, "topics", data.get("topics") or {}, complaints).items():
        if key not in TOPICS:
            complaints.append(f"{path}: {unknown_name('topic', key, TOPICS)}")
        topics[key] = str(value)
    ball = None
    if data.get("ball"):
        entry = _mapping(path, "ball", data["ball"], complaints)
        if set(entry) != {"joint", "site"}:
            complaints.append(f"{path}: 'ball' needs exactly joint and site, got {sorted(entry)}.")
        else:
            ball = Ball(str(entry["joint"]), str(entry["site"]))
    names = [m.signal for a in axes if a for m in a.measured]
    complaints += [f"{path}: signal '{n}' occurs twice." for n in sorted({n for n in names if names.count(n) > 1})]
    if complaints:
        raise InputError(complaints)
    return Rig(
        name=str(data["name"]),
        mjcf=files["mjcf"] or path,
        axes=tuple(a for a in axes if a),
        description=str(data.get("description", "")),
        sample_time=float(step),
        ball=ball,
        mjcf_without_ball=files.get("mjcf_without_ball"),
        topics=topics,
        path=path,
    )


def _axis(path: Path, name: str, entry: Any, complaints: list[str]) -> Axis | None:
    where = f"{path}: axis {name}"
    entry = _mapping(path, f"axes.{name}", entry, complaints)
    known = set(Axis.__dataclass_fields__) - {"name"}
    found = [f"{where}: {unknown_name('entry', key, known)}" for key in entry if key not in known]
    found += [f"{where}: '{k}' is missing." for k in ("command", "actuator", "joint", "measured") if k not in entry]
    if not WORD.match(str(name)):
        found.append(f"{where}: the name must be lower-case letters, digits and underscores.")
    if bool(entry.get("belt")) != bool(entry.get("load_joint")):
        found.append(f"{where}: belt and load_joint come together or not at all.")
    limits = entry.get("limits", [-3.2, 3.2])
    if not (isinstance(limits, list) and len(limits) == 2 and all(map(is_number, limits)) and limits[0] < limits[1]):
        found.append(f"{where}: limits must be [low, high] in rad, got {limits!r}.")
    measured = []
    for signal, spec in _mapping(path, f"axes.{name}.measured", entry.get("measured") or {}, found).items():
        if not WORD.match(str(signal)):
            found.append(f"{where}: signal '{signal}' must be a legal ROS topic word.")
        if not isinstance(spec, dict) or set(spec) - {"resolution"} != {"joint", "quantity"}:
            found.append(f"{where}: signal '{signal}' needs joint and quantity, and may have resolution, got {spec!r}.")
        elif not is_number(tick := spec.get("resolution", 0.0)) or tick < 0.0:
            found.append(f"{where}: signal '{signal}': resolution must be a number, at least 0, got {tick!r}.")
        elif spec["quantity"] not in QUANTITIES:
            found.append(f"{where}: signal '{signal}': {unknown_name('quantity', str(spec['quantity']), QUANTITIES)}")
        else:
            measured.append(Measured(str(signal), str(spec["joint"]), str(spec["quantity"]), float(tick)))
    complaints += found
    if found:
        return None
    return Axis(
        name=str(name),
        measured=tuple(measured),
        limits=(float(limits[0]), float(limits[1])),
        **{k: str(entry[k]) for k in ("command", "actuator", "joint", "load_joint", "belt") if entry.get(k)},
    )


def is_number(value: object) -> bool:
    """Whether YAML gave a number; its booleans are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping. Raises InputError for anything else."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"Cannot read {path}: {error}") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a YAML mapping, got {type(data).__name__}.")
    return data


def find_beside(path: Path, kind: str, name: str) -> Path:
    """A file named in another file: relative to that file first, then by name in config/KIND."""
    beside = path.parent / name
    return beside.resolve() if beside.is_file() else find(kind, name)


def _mapping(path: Path, key: str, value: Any, complaints: list[str]) -> dict[str, Any]:
    if isinstance(value, dict):
        return value
    complaints.append(f"{path}: '{key}' must be a mapping, got {value!r}.")
    return {}
