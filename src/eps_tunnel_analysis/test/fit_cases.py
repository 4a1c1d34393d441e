# SPDX-License-Identifier: Apache-2.0
"""Plays made by a model of known values, on the bare servo horn, which steps fastest."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from bag_files import START, STEP, Header, JointState, Time, write_bag

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import even_timestep, simulate
from labyrinth_sim.trials import Trials

TRUTH = {"drive.x.p": 18.0, "drive.x.i": 0.0, "drive.x.d": 0.95, "drive.x.delay": 0.032}
FREE = tuple(TRUTH)
WHOLE_DELAY = {**TRUTH, "drive.x.delay": 0.03}  # of samples, so that it is the same on any finer grid
SAMPLES = 61


def start() -> Model:
    """The labyrinth with the paper's standard servos."""
    return load_model("labyrinth")


def on_grid(model: Model, commands: np.ndarray, initial: dict[str, float] | None = None) -> Trials:
    """One roll-out in steps of MuJoCo's own, read every 10 ms; each of the commands (T, u) holds that long."""
    every = round(0.01 / even_timestep(0.01, None, model, False))
    time = np.arange((len(commands) - 1) * every + 1) * (0.01 / every)
    run = simulate(model, time, np.repeat(commands, every, axis=0)[: len(time)], initial)
    return replace(run, time=np.arange(len(commands)) * 0.01, values=run.values[:, ::every],
                   commands=run.commands[:, ::every])  # fmt: skip


def made_by(model: Model, commands: np.ndarray, trials: int = 3, noise: float = 2e-4, seed: int = 0) -> Trials:
    """Trials of a model, rad, with white noise on every position."""
    run = on_grid(model, commands)
    positions = [s for s, unit in zip(run.signals, run.units, strict=True) if unit == "rad"]
    run = run.select(positions)
    clean = np.repeat(run.values, trials, axis=0)
    noisy = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    return replace(run, values=noisy, commands=np.repeat(run.commands, trials, axis=0))


def step(degrees: float, axis: int = 0, samples: int = SAMPLES) -> np.ndarray:
    """(T, 2) rad, from 0 to a target at the second sample."""
    commands = np.zeros((samples, 2))
    commands[1:, axis] = np.radians(degrees)
    return commands


def plays(
    degrees=(-4.0, -2.0, 1.0, 3.0, 5.0), truth=TRUTH, axis: int = 0, samples: int = SAMPLES, **options
) -> list[Play]:
    model = start().with_values(truth)
    return [
        Play(f"{d:+g}deg", made_by(model, step(d, axis, samples), seed=i, **options)) for i, d in enumerate(degrees)
    ]


def search_on_x(effects: Sequence[str] = ()) -> Search:
    """Of effects on one axis, for plays that the model itself made."""
    return part_search(start().with_values(TRUTH), plays((3.0, -2.0), TRUTH), effects)


def part_search(model: Model, recorded: Sequence[Play], effects: Sequence[str] = ()) -> Search:
    """Of effects on axis x of a model, for these plays."""
    part = next(p for p in axis_parts(model, recorded) if p.name == "x")
    return axis_search(model, recorded, part, SearchOptions(tuple(effects), 1))


def refit(search: Search, effects: tuple[str, ...], cost: float, **values: float) -> Refit:
    """A refit that leaves this everywhere, at what is stated but for these values, by the ends of their names."""
    at = search.start.copy()
    for name, value in values.items():
        column = next(i for i, full in enumerate(search.library.names) if full.endswith(f".{name}"))
        at[column] = value
    return Refit(effects, at, np.full(len(search.used), np.sqrt(cost)), cost, 3 + len(effects), True)


def bag_of(folder: Path, trials: Trials) -> Path:
    """The first trial as a bag without marks, as a recorder would have written it."""
    joints = [s for s in trials.signals if "_velocity" not in s]

    def message(at: int, names, values):
        header = Header(stamp=Time(sec=at // 10**9, nanosec=at % 10**9), frame_id="")
        return JointState(header=header, name=list(names), position=np.array(values), velocity=np.array([]),
                          effort=np.array([]))  # fmt: skip

    stamps = [START + STEP * i for i in range(len(trials.time))]
    columns = [trials.index(s) for s in joints]
    states = [(at, message(at, joints, trials.values[0, i, columns])) for i, at in enumerate(stamps)]
    commands = [(at, message(at, trials.command_channels, trials.commands[0, i])) for i, at in enumerate(stamps)]
    kind = "sensor_msgs/msg/JointState"
    return write_bag(folder, {"/real/joint_states": (kind, states), "/real/joint_commands": (kind, commands)})
