# SPDX-License-Identifier: Apache-2.0
"""What a task is, and how a controller's cost is measured: in a model and on the emulated rig, by the same sensors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from labyrinth_hw import config
from labyrinth_hw.testbed.hidden import TestbedConfig
from labyrinth_hw.testbed.offline import Run, Seen, run_controlled
from labyrinth_hw.testbed.scene import Layout, load_layout
from labyrinth_sim.mjcf.geometry import load_geometry
from labyrinth_sim.mjcf.labyrinth import labyrinth_xml
from labyrinth_sim.model import Model
from labyrinth_sim.stepping import BatchStepper

Array = NDArray[np.float64]
Control = Callable[[Seen], Array]
RATE = 100.0  # Hz, of sensors and commands
BOARD_STEP = 0.0025  # s, MuJoCo's without a ball; with one it is the MJCF's
BOARD_NOISE, BALL_NOISE = 3e-4, 4e-4  # rad and m, standard deviation of the sensors at rest
REACH = 0.13  # rad, the largest command
TRIALS = 6  # of each controller on the rig


@dataclass(frozen=True)
class Task:
    """One task.

    Attributes:
        name: of one or two words.
        unit, scale: in which costs are printed, and how many of it are one rad or m.
        duration: s.
        values: names of the v values of its controller.
        low, high, start: (v,) bounds and where tuning starts.
        control: (n, v) values -> what gives (n, 2) rad of commands at each sample from what is seen.
        cost: (n, T, 2) rad of the board and (n, T, 2) m of the ball, NaN once lost, None without one -> (n,) rad or m.
        worst: cost of a simulation that diverged.
        generations: of tuning, after which it hardly gets better.
        starts: (s, 2) m where the ball begins, in turn; None leaves it out.
        near: x0, y0, x1, y1, m, of the part of the maze whose walls and holes models have, for the whole takes twice
            as long; None for an open board.
    """

    name: str
    unit: str
    scale: float
    duration: float
    values: tuple[str, ...]
    low: Array
    high: Array
    start: Array
    control: Callable[[Array], Control]
    cost: Callable[[Array, Array | None], Array]
    worst: float
    generations: int
    starts: tuple[tuple[float, float], ...] | None = None
    near: tuple[float, float, float, float] | None = None

    @cached_property
    def time(self) -> Array:
        """(T,) s."""
        return np.arange(round(self.duration * RATE)) / RATE

    @property
    def repeats(self) -> int:
        """Simulations of each controller in tuning: one for each start of the ball."""
        return len(self.starts or (None,))

    @property
    def begin(self) -> Array:
        """(v,) where tuning starts, as shares of the bounds."""
        return (self.start - self.low) / (self.high - self.low)

    def of_shares(self, z: Array) -> Array:
        """Values (n, v) of shares of the bounds."""
        return self.low + np.clip(z, 0.0, 1.0) * (self.high - self.low)

    def places(self, rows: int) -> Array | None:
        """(rows, 2) m where balls begin."""
        if self.starts is None:
            return None
        return np.array(self.starts)[np.arange(rows) % len(self.starts)]


def in_model(task: Task, model: Model, values: Array, seed: int) -> Array:
    """(n,) cost of controllers (n, v) in a model, mean over the ball's starts."""
    boards, balls, failed = tracks_in_model(task, model, values, seed)
    cost = np.where(failed, task.worst, task.cost(boards, balls))
    return np.asarray(cost.reshape(-1, task.repeats).mean(axis=1))


def tracks_in_model(
    task: Task, model: Model, values: Array, seed: int
) -> tuple[Array, Array | None, NDArray[np.bool_]]:
    """What sensors, with the noise of real ones, see under controllers (n, v) in a model.

    Returns:
        (n * repeats, T, 2) rad of the board; (n * repeats, T, 2) m of the ball, NaN once lost, None without one; which
        diverged.
    """
    rows, ball = len(values) * task.repeats, task.starts is not None
    places = task.places(rows)
    model = on_board(task, model) if ball else model
    initial = {} if places is None else {"ball_x": places[:, 0], "ball_y": places[:, 1]}
    stepper = BatchStepper(model, rows, 1.0 / RATE, ball, None if ball else BOARD_STEP, initial)
    columns = stepper.index("motor_x", "motor_y", "board_x", "board_y", *(("ball_x", "ball_y") if ball else ()))
    control = task.control(np.repeat(values, task.repeats, axis=0))
    noise = np.random.default_rng(seed).standard_normal((len(task.time), task.repeats, 4))
    noise = np.tile(noise, (1, len(values), 1)) * np.repeat([BOARD_NOISE, BALL_NOISE], 2)
    boards, balls = np.empty((2, rows, len(task.time), 2))
    gone = np.zeros(rows, dtype=bool)
    for k, t in enumerate(task.time):
        now = stepper.seen[:, columns]
        boards[:, k] = now[:, 2:4] + noise[k, :, :2]
        if ball:
            gone |= stepper.ball()[:, 2] < 0.0
            balls[:, k] = np.where(gone[:, None], np.nan, now[:, 4:6] + noise[k, :, 2:])
        stepper.advance(control(Seen(k, t, now[:, :2], boards[:, k], balls[:, k] if ball else None)))
    return boards, balls if ball else None, stepper.failed


def play(task: Task, rig: TestbedConfig, values: Array, trials: int, seed: int) -> list[Run]:
    """What the rig does under each of n controllers (n, v)."""
    rows, layout = len(values) * trials, layout_of(task)
    control = task.control(np.repeat(values, trials, axis=0))
    seeds = [seed] * len(values)  # the same noise for all, so that they differ by what they do
    return run_controlled(
        [rig] * len(values), task.time, control, trials, seeds, layout, ball_start=task.places(rows)
    )  # fmt: skip


def on_rig(task: Task, runs: Sequence[Run]) -> Array:
    """(n,) cost of what the rig did, by its own sensors, mean over the trials."""
    return np.array([task.cost(run.board, run.ball).mean() for run in runs])


def layout_of(task: Task) -> Layout | None:
    """The emulated board's; None without a ball."""
    if task.starts is None:
        return None
    maze = load_layout("medium")
    return maze if task.near else replace(maze, walls=(), holes=())


def on_board(task: Task, model: Model) -> Model:
    """The model with the board of a task with a ball; of a maze only what is near where the ball should roll."""
    return replace(model, rig=replace(model.rig, mjcf=_board(task.near)))


@cache
def _board(near: tuple[float, float, float, float] | None) -> Path:
    source = config.find_geometry()
    assert source is not None, "config/labyrinth_geometry.yaml"
    layout = load_geometry(Path(source))["medium"]
    x0, y0, x1, y1 = near or (0.0, 0.0, 0.0, 0.0)
    part = replace(
        layout,
        walls_h=np.array([w for w in layout.walls_h if w[0] < x1 and w[1] > x0 and y0 < w[2] < y1]).reshape(-1, 3),
        walls_v=np.array([w for w in layout.walls_v if w[0] < y1 and w[1] > y0 and x0 < w[2] < x1]).reshape(-1, 3),
        holes=np.array([h for h in layout.holes if x0 < h[0] < x1 and y0 < h[1] < y1]).reshape(-1, 2),
    )
    file = Path(_folder().name) / f"labyrinth_{hash(near)}.xml"
    file.write_text(labyrinth_xml(part), encoding="utf-8")
    return file


@cache
def _folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory()  # removed as the program ends
