# SPDX-License-Identifier: Apache-2.0
"""What the page shows, part by part. SI units; the page turns angles into degrees and lengths into mm."""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from eps_tunnel_analysis.values.sweep import Adjustable
from labyrinth_sim.build import compiled
from labyrinth_sim.model import Model

Point = tuple[float, float]
HOLE = "hole_"


@dataclass(frozen=True)
class Floor:
    """The board seen from above, in the ball's frame.

    Attributes:
        size: (x, y) m of the inner board.
        walls: x_min, x_max, y_min, y_max in m each.
        holes: centres in m; their radius in m.
        ball_radius: m.
    """

    size: Point
    walls: tuple[tuple[float, float, float, float], ...]
    holes: tuple[Point, ...]
    hole_radius: float
    ball_radius: float


@dataclass(frozen=True)
class RigPart:
    """What is constant for one rig.

    Attributes:
        name: of the rig.
        axes: signals of measured positions.
        reach: rad, or m where it slides, the largest target of any axis.
        tilt: signals of the board's turn about its x and its y axis; None without a floor.
        floor: None without a ball.
        unit: unit in which errors of the rig's positions are given, rad or m.
        units: SI unit of each signal.
    """

    name: str
    axes: tuple[str, ...]
    reach: float
    tilt: tuple[str, str] | None
    floor: Floor | None
    unit: str = "rad"
    units: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Choices:
    """What the page offers: sequences as (name, description, trials, duration in s), names of all effects."""

    sequences: tuple[tuple[str, str, int, float], ...]
    effects: tuple[str, ...]


@dataclass(frozen=True)
class Connections:
    """Which nodes run. model: what the simulation runs, as it reports; file: its path, "" if it reports none."""

    real: bool
    sim: bool
    player: bool
    analysis: bool
    model: str
    file: str
    armed: bool


@dataclass(frozen=True)
class RunPart:
    """The current run or the last one: trial from 0; phase as the player says; share 0..1; time_left, duration s."""

    sequence: str
    trial: int
    trials: int
    phase: str
    share: float
    time_left: float
    duration: float


@dataclass(frozen=True)
class GapPart:
    """Alikeness of the command last played: shares (m, n) and joint (n,) over n factors ks; None where not known.

    rig, rig_shares: (n,) and (m, n) what the rig reaches against itself, jointly and by signal; empty, or m empty
        rows, with too few trials.
    """

    model: str
    signals: tuple[str, ...]
    ks: tuple[float, ...]
    shares: tuple[tuple[float | None, ...], ...]
    joint: tuple[float | None, ...]
    rig: tuple[float | None, ...]
    samples: int
    trials: int
    rig_shares: tuple[tuple[float | None, ...], ...] = ()


@dataclass(frozen=True)
class Before:
    """The gap's joint alikeness over k as it was when the model was last replaced."""

    model: str
    ks: tuple[float, ...]
    joint: tuple[float | None, ...]


@dataclass(frozen=True)
class Pose:
    """One side now: position of each joint in rad or m, the ball in m, None where it is not seen or not measured."""

    angles: dict[str, float]
    ball: Point | None


@dataclass(frozen=True)
class Scene:
    """Both sides now; None for one that is silent."""

    real: Pose | None
    sim: Pose | None


@dataclass(frozen=True)
class VerdictPart:
    """What a diagnosis said. hypotheses: (name, probability, whether in the stated set); where: spans outside the
    tunnel as (signal, start, end) in s; held_out: errors on held-out samples, in the rig's unit, of the
    model as given, with its values refitted, with the effects added; report: address, next_experiment: name or path, ""
    where none."""

    verdict: str
    sentence: str
    effects: tuple[str, ...]
    hypotheses: tuple[tuple[str, float, bool], ...]
    where: tuple[tuple[str, float, float], ...]
    coverage: float
    held_out: tuple[float | None, float | None, float | None]
    model: str
    next_experiment: str
    report: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class StaircaseStep:
    """One step of the staircase: a model and its error.

    Attributes:
        model: its name.
        change: what was done to get it, in words.
        held_out: mean error on held-out samples, in the rig's unit; None if it was not diagnosed.
        live: joint alikeness at the smallest k at the end of its last run; None before.
    """

    model: str
    change: str
    held_out: float | None = None
    live: float | None = None


@dataclass(frozen=True)
class Staircase:
    """Every model in the order it was tried."""

    steps: tuple[StaircaseStep, ...] = ()


@dataclass(frozen=True)
class Job:
    """The current job: kind "play", "diagnose" or "add", "" for none; progress in words; seconds since it began."""

    kind: str
    progress: str
    seconds: float


@dataclass(frozen=True)
class Health:
    """Samples received on all topics, and those that went wrong on their way, since the analysis started.

    troubled: share of the latest samples that came late or not at all.
    """

    received: int
    late: int
    lost: int
    reordered: int
    duplicated: int
    restarts: int
    clock_jumps: int
    troubled: float = 0.0


@dataclass(frozen=True)
class Adjustables:
    """Values of the running model that can be varied on the last run's recordings; none before there are any."""

    values: tuple[Adjustable, ...]


@dataclass(frozen=True)
class WhatIfPart:
    """The last command of the last run, simulated with another value of the model.

    Attributes:
        name, unit: of the value; "" if none is varied.
        value, given: as requested, and as the model has it.
        command: the recorded one.
        gap: with the value; None if none is varied.
        before: of the unchanged model.
        number: of the trajectories that belong to it, see `State.show_what_if`.
    """

    name: str = ""
    unit: str = ""
    value: float = 0.0
    given: float = 0.0
    command: str = ""
    gap: GapPart | None = None
    before: Before | None = None
    number: int = 0


@dataclass(frozen=True)
class Past:
    """Trials that can be looked at again: number, and when the next one began, seconds since 1970; oldest first."""

    trials: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class Log:
    """What happened last, oldest first: number, seconds since 1970, "info" or "error", text."""

    entries: tuple[tuple[int, float, str, str], ...] = ()


Part = (
    RigPart
    | Choices
    | Connections
    | RunPart
    | GapPart
    | Before
    | Scene
    | VerdictPart
    | Staircase
    | Job
    | Health
    | Adjustables
    | WhatIfPart
    | Past
    | Log
)


def rig_of(model: Model) -> RigPart:
    """The rig as the page shows it."""
    axes = model.rig.positions
    reach = max(max(map(abs, a.limits)) for a in model.rig.axes)
    floor = floor_of(model)
    loads = [m.signal for a in model.rig.axes for m in a.measured if (m.joint, m.quantity) == (a.load, "position")]
    tilt = (loads[0], loads[1]) if floor is not None and len(loads) == 2 else None
    units = dict(zip(model.rig.signals, model.rig.units, strict=True))
    return RigPart(model.rig.name, axes, reach, tilt, floor, model.rig.position_unit, units)


def floor_of(model: Model) -> Floor | None:
    """Walls are the boxes of the body that carries the ball's frame, holes its sites `hole_*`; None without a ball."""
    if model.rig.ball is None:
        return None
    mj = compiled(model, with_ball=True).mj
    frame = mj.site(model.rig.ball.site)
    origin, body = frame.pos[:2], int(frame.bodyid[0])
    boxes = []
    for i in np.flatnonzero((mj.geom_bodyid == body) & (mj.geom_type == mujoco.mjtGeom.mjGEOM_BOX)):
        middle, half = mj.geom_pos[i][:2] - origin, mj.geom_size[i][:2]
        boxes.append((middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1]))
    holes = [mj.site(i) for i in range(mj.nsite) if mj.site(i).name.startswith(HOLE) and mj.site_bodyid[i] == body]
    ball = mj.joint(model.rig.ball.joint)
    radius = float(mj.geom_size[mj.body(int(ball.bodyid[0])).geomadr[0]][0])
    # The frame's origin is the board's corner, and the body turns about the board's centre.
    size = tuple(float(v) for v in -2 * origin) if (origin < 0).all() else _reach(boxes)
    return Floor(
        size=(size[0], size[1]),
        walls=tuple(tuple(round(float(v), 5) for v in box) for box in boxes),  # type: ignore[misc]
        holes=tuple((round(float(h.pos[0] - origin[0]), 5), round(float(h.pos[1] - origin[1]), 5)) for h in holes),
        hole_radius=float(holes[0].size[0]) if holes else 0.0,
        ball_radius=radius,
    )


def _reach(boxes: list[tuple[float, float, float, float]]) -> tuple[float, float]:
    return (max((b[1] for b in boxes), default=0.3), max((b[3] for b in boxes), default=0.3))
