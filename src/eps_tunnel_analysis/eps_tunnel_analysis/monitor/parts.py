# SPDX-License-Identifier: Apache-2.0
"""What the page shows, part by part. SI units; the page turns angles into degrees and lengths into mm."""

from dataclasses import dataclass

Point = tuple[float, float]


@dataclass(frozen=True)
class Floor:
    """The board from above, in the ball's frame.

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
class Rig:
    """What is fixed while the model's rig is.

    Attributes:
        name: of the rig.
        axes: signals of measured positions.
        reach: rad, the largest target angle of any axis.
        tilt: signals of the board's turn about its x and its y axis; None without a floor.
        floor: None without a ball.
    """

    name: str
    axes: tuple[str, ...]
    reach: float
    tilt: tuple[str, str] | None
    floor: Floor | None


@dataclass(frozen=True)
class Choices:
    """What the page offers: sequences as (name, description, trials, duration in s), names of all effects."""

    sequences: tuple[tuple[str, str, int, float], ...]
    effects: tuple[str, ...]


@dataclass(frozen=True)
class Connections:
    """Who is there. model: what the simulation runs, as it says; file: its path, "" where it tells none."""

    real: bool
    sim: bool
    player: bool
    analysis: bool
    model: str
    file: str
    armed: bool


@dataclass(frozen=True)
class Run:
    """The run under way or the last one: trial from 0; phase as the player says; share 0..1; time_left, duration s."""

    sequence: str
    trial: int
    trials: int
    phase: str
    share: float
    time_left: float
    duration: float


@dataclass(frozen=True)
class Gap:
    """Alikeness of the command last played: shares (m, n) and joint (n,) over n factors ks; None where not known."""

    model: str
    signals: tuple[str, ...]
    ks: tuple[float, ...]
    shares: tuple[tuple[float | None, ...], ...]
    joint: tuple[float | None, ...]
    samples: int
    trials: int


@dataclass(frozen=True)
class Before:
    """The gap's joint alikeness over k as it was when the model was last replaced."""

    model: str
    ks: tuple[float, ...]
    joint: tuple[float | None, ...]


@dataclass(frozen=True)
class Pose:
    """One side now: position of each joint in rad, the ball in m, None where it is not seen or not measured."""

    angles: dict[str, float]
    ball: Point | None


@dataclass(frozen=True)
class Scene:
    """Both sides now; None for one that is silent."""

    real: Pose | None
    sim: Pose | None


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis said. hypotheses: (name, probability, whether in the stated set); where: spans outside the
    tunnel as (signal, start, end) in s; held_out: errors on samples kept from the fit, rad, of the model as given, with
    its values refitted, with the effects added; report: address, next_experiment: name or path, "" where none."""

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
class Step:
    """One step of the staircase: a model and what it left.

    Attributes:
        model: its name.
        change: what was done to get it, in words.
        held_out: mean error on samples kept from the fit, rad; None where it was not diagnosed.
        live: joint alikeness at the smallest k at the end of its last run; None before.
    """

    model: str
    change: str
    held_out: float | None = None
    live: float | None = None


@dataclass(frozen=True)
class Staircase:
    """Every model in the order it was tried."""

    steps: tuple[Step, ...] = ()


@dataclass(frozen=True)
class Job:
    """Work under way: kind "play", "diagnose" or "add", "" for none; told in words; seconds since it began."""

    kind: str
    told: str
    seconds: float


@dataclass(frozen=True)
class Health:
    """Samples received on all topics, and those that went wrong on their way, since the analysis started."""

    received: int
    late: int
    lost: int
    reordered: int
    duplicated: int
    restarts: int
    clock_jumps: int


@dataclass(frozen=True)
class Log:
    """What happened last, oldest first: number, seconds since 1970, "info" or "error", text."""

    entries: tuple[tuple[int, float, str, str], ...] = ()


Part = Rig | Choices | Connections | Run | Gap | Before | Scene | Verdict | Staircase | Job | Health | Log
