# SPDX-License-Identifier: Apache-2.0
"""The emulated rig without serial ports and without real time: many rigs and trials at once.

Commands are known beforehand (`run_offline`, `run_many`), or a controller chooses them from what is measured
(`run_controlled`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.ball import Ball
from labyrinth_hw.testbed.hidden import TestbedConfig
from labyrinth_hw.testbed.plant import CONTROL_PERIOD, Plant
from labyrinth_hw.testbed.quantities import Array, stack
from labyrinth_hw.testbed.scene import Layout
from labyrinth_hw.testbed.servo import quantised

STAMP_JITTER = 0.0003  # s, standard deviation of the sampling instants
NEXT_TRIAL = 3.0  # s between the end of a trial and the start of the next
START_SPREAD = 0.002  # rad, from where a trial's start pose is approached


@dataclass(frozen=True)
class Seen:
    """What a controller knows at one sample of n trials side by side; the trials of one rig follow each other.

    Attributes:
        sample: its number, from 0.
        time: s.
        motor, board: (n, 2) rad, encoders and potentiometers.
        ball: (n, 2) m in the board frame as the camera sees it, NaN while lost; None without a ball.
    """

    sample: int
    time: float
    motor: Array
    board: Array
    ball: Array | None


Control = Callable[[Seen], Array]  # to (n, 2) rad, sent at once


@dataclass(frozen=True)
class Run:
    """p trials of one rig, T samples each, times from each trial's start.

    Attributes:
        stamps: (p, T) s, when encoders and potentiometers were read; uneven.
        motor, motor_speed, effort: (p, T, 2) rad, rad/s, N m; axes x and y.
        board: (p, T, 2) rad.
        command_stamps: (T,) s.
        commands: (T, 2) rad, as sent; (p, T, 2) where a controller chose them.
        ball: (p, T, 2) m in the board frame as the camera sees it, NaN while lost; None without a ball.
        hole: (p,) number of the hole the ball fell into, -1 if it did not.
        tilt_stamps, tilt: (p, C) s and (p, C, 2) rad, the board as the camera sees it, C pictures; None where
            potentiometers measure it.
    """

    stamps: Array
    motor: Array
    motor_speed: Array
    effort: Array
    board: Array
    command_stamps: Array
    commands: Array
    ball: Array | None
    hole: NDArray[np.int_]
    tilt_stamps: Array | None = None
    tilt: Array | None = None


def run_offline(
    config: TestbedConfig,
    time: Array,
    commands: Array,
    trials: int,
    seed: int,
    layout: Layout | None = None,
    lead: float = 1.0,
) -> Run:
    """Play commands on one rig. See `run_many`."""
    return run_many([config], time, commands, trials, [seed], layout, lead)[0]


def run_many(
    configs: Sequence[TestbedConfig], time: Array, commands: Array, trials: int, seeds: Sequence[int],
    layout: Layout | None = None, lead: float = 1.0,
) -> list[Run]:  # fmt: skip
    """Play the same commands on many rigs, several trials each, all at once.

    Args:
        configs: n rigs.
        time: (T,) s in even steps that are whole milliseconds, e.g. 10 ms.
        commands: (T, 2) rad for x and y, each sent at its time.
        trials: p of each rig.
        seeds: n, of each rig's noise; the same seed gives the same trials whatever else runs in the batch.
        layout: walls and holes, for a ball; None leaves it out.
        lead: s that the first command is held before time zero.

    Returns:
        n runs.

    Raises:
        InputError: wrong shapes, steps or numbers.
    """
    every = _check(configs, time, commands, trials, seeds)
    rows = len(configs) * trials
    return _play(configs, time, lambda seen: np.broadcast_to(commands[seen.sample], (rows, 2)), commands[0], every,
                 trials, seeds, layout, lead, None)[0]  # fmt: skip


def run_controlled(
    configs: Sequence[TestbedConfig], time: Array, control: Control, trials: int, seeds: Sequence[int],
    layout: Layout | None = None, lead: float = 1.0, first: Array | None = None, ball_start: Array | None = None,
) -> list[Run]:  # fmt: skip
    """Let a controller choose the commands sample by sample, on many rigs and trials at once.

    Args:
        configs: n rigs; name one several times to try several controllers on it at once.
        time: (T,) s in even steps that are whole milliseconds.
        control: gives (n * trials, 2) rad at each sample from what is measured then.
        trials: p of each rig.
        seeds: n, of each rig's noise.
        layout: walls and holes, for a ball; None leaves it out.
        lead: s that the first command is held before time zero; the ball rests meanwhile.
        first: (2,) rad held during the lead; level if None.
        ball_start: (2,) or (n * trials, 2) m where balls are at time zero; the start of the layout's path if None.

    Returns:
        n runs; their commands are (p, T, 2).

    Raises:
        InputError: wrong shapes, steps or numbers; commands of another shape than was asked for.
    """
    held = np.zeros(2) if first is None else np.asarray(first, dtype=float)
    every = _check(configs, time, np.broadcast_to(held, (len(time), 2)), trials, seeds)
    runs, sent = _play(configs, time, control, held, every, trials, seeds, layout, lead, ball_start)
    rows = (slice(i * trials, (i + 1) * trials) for i in range(len(configs)))
    return [replace(run, commands=np.ascontiguousarray(np.swapaxes(sent[:, r], 0, 1)))
            for run, r in zip(runs, rows, strict=True)]  # fmt: skip


def _play(
    configs: Sequence[TestbedConfig], time: Array, control: Control, first: Array, every: int, trials: int,
    seeds: Sequence[int], layout: Layout | None, lead: float, ball_start: Array | None,
) -> tuple[list[Run], Array]:  # fmt: skip
    """n runs and (T, n * trials, 2) the commands sent."""
    count, rows = len(time), len(configs) * trials
    q = stack([config.reality for config in configs], trials)
    noises = [np.random.default_rng([seed, trial]) for seed in seeds for trial in range(trials)]
    start = first + START_SPREAD * np.array([rng.standard_normal(2) for rng in noises])
    ages = np.tile(np.arange(trials) * (count * every * CONTROL_PERIOD + NEXT_TRIAL), len(configs))
    plant = Plant(q, start, ages)
    noise = np.stack([rng.standard_normal((count, 11)) for rng in noises], axis=1)  # (T, rows, 11)
    lost = np.stack([rng.random((count, 2)) for rng in noises], axis=1) < q.command_loss
    ball = None
    if layout is not None:
        begin = np.asarray(layout.path[0] if ball_start is None else ball_start, dtype=float)
        ball = Ball(q, layout, np.broadcast_to(begin, (rows, 2)))
    latency = max(1, int(np.ceil(q.camera_latency.max() / (every * CONTROL_PERIOD)))) + 1
    trail: list[Array] = []

    plant.command(np.tile(first, (rows, 1)))
    plant.advance(round(lead / CONTROL_PERIOD))
    out = {name: np.empty((count, rows, 2)) for name in ("motor", "motor_speed", "effort", "board", "ball")}
    stamps, tilts, sent = np.empty((count, rows)), np.empty((count, rows, 2)), np.empty((count, rows, 2))
    phase = np.array([rng.uniform(0.0, every * CONTROL_PERIOD) for rng in noises])  # of the camera's pictures
    for k in range(count):
        age = np.abs(STAMP_JITTER * noise[k, :, 10:])
        stamps[k] = time[k] - age[:, 0]
        angle, speed = plant.encoder(np.broadcast_to(age, (rows, 2)))
        angle = q.encoder_gain * angle + q.encoder_bias + q.encoder_noise * noise[k, :, 0:2]
        out["motor"][k] = quantised(angle, q.encoder_tick)
        out["motor_speed"][k] = speed
        out["effort"][k] = plant.motor.kt * plant.motor.current
        pot = q.pot_gain * plant.pots(np.broadcast_to(age, (rows, 2))) + q.pot_bias + q.pot_noise * noise[k, :, 2:4]
        out["board"][k] = quantised(pot, q.pot_tick)
        tilts[k] = q.pot_gain * plant.pots(np.broadcast_to(phase[:, None], (rows, 2))) + q.pot_bias
        tilts[k] += q.pot_noise * noise[k, :, 2:4]
        if ball is not None and layout is not None:
            trail = [*trail[-latency:], np.where(ball.lost[:, None], np.nan, ball.position)]
            out["ball"][k] = _seen(trail, q.camera_latency[:, 0] / (every * CONTROL_PERIOD))
            centre = 0.5 * np.array(layout.board)
            out["ball"][k] = centre + q.camera_scale * (out["ball"][k] - centre) + q.camera_noise * noise[k, :, 8:10]
        chosen = control(Seen(k, float(time[k]), out["motor"][k], out["board"][k], out["ball"][k] if ball else None))
        if chosen.shape != (rows, 2):
            raise InputError(f"A controller must give commands of shape {(rows, 2)}, got {chosen.shape}.")
        sent[k] = chosen
        goal = np.where(lost[k], np.nan, chosen)
        plant.command(goal, q.command_jitter * noise[k, :, 4:6])
        plant.push = q.torque_noise * noise[k, :, 6:8]
        if ball is None:
            plant.advance(every)
        else:
            for _ in range(every):
                plant.advance(1)
                ball.step(plant.board, CONTROL_PERIOD)
    runs = [
        _run(out, stamps, ball, slice(i * trials, (i + 1) * trials), time, sent[:, i * trials])
        for i in range(len(configs))
    ]
    seen = time[:, None] - phase
    filmed = [
        _filmed(run, config, seen[:, i * trials : (i + 1) * trials], tilts[:, i * trials : (i + 1) * trials])
        for i, (run, config) in enumerate(zip(runs, configs, strict=True))
    ]
    return filmed, sent


def _check(configs: Sequence[TestbedConfig], time: Array, commands: Array, trials: int, seeds: Sequence[int]) -> int:
    complaints = []
    if len(configs) < 1 or trials < 1 or len(seeds) != len(configs):
        complaints.append(
            f"Expected at least one rig, one trial and a seed for each rig, got {len(configs)}, {trials}, {len(seeds)}."
        )
    if time.ndim != 1 or len(time) < 2 or commands.shape != (len(time), 2):
        complaints.append(f"Expected time (T,) with T >= 2 and commands (T, 2), got {time.shape} and {commands.shape}.")
    elif not np.isfinite(commands).all():
        complaints.append("Commands must be finite angles in rad.")
    every = round(float(np.diff(time).mean()) / CONTROL_PERIOD) if time.ndim == 1 and len(time) > 1 else 1
    if not complaints and (every < 1 or not np.allclose(np.diff(time), every * CONTROL_PERIOD, atol=1e-6)):
        complaints.append(
            f"Time must go in even steps of whole milliseconds, got {np.ptp(np.diff(time)):g} s of unevenness."
        )
    if complaints:
        raise InputError(complaints)
    return every


def _seen(trail: list[Array], delay: Array) -> Array:
    """Positions `delay` (rows,) samples ago, interpolated."""
    whole = np.floor(delay).astype(int)
    part = (delay - whole)[:, None]
    past = np.stack(trail)
    rows = np.arange(len(delay))
    newer, older = (past[np.maximum(len(trail) - 1 - whole - i, 0), rows] for i in (0, 1))
    return np.where(part > 0, newer + part * (older - newer), newer)


def _filmed(run: Run, config: TestbedConfig, stamps: Array, tilts: Array) -> Run:
    """The run with the tilt that a camera sees, stamps (T, p), tilts (T, p, 2), if it has no potentiometers."""
    if config.tilt_rate is None:
        return run
    step = run.command_stamps[1] - run.command_stamps[0]
    pictures = slice(1, None, max(1, round(1.0 / (config.tilt_rate * step))))  # exposed within the trial
    tilt = np.ascontiguousarray(np.swapaxes(tilts[pictures], 0, 1))
    return replace(run, tilt_stamps=np.ascontiguousarray(stamps[pictures].T), tilt=tilt)


def _run(out: dict[str, Array], stamps: Array, ball: Ball | None, rows: slice, time: Array, commands: Array) -> Run:
    part = {name: np.ascontiguousarray(np.swapaxes(values[:, rows], 0, 1)) for name, values in out.items()}
    return Run(
        stamps=np.ascontiguousarray(stamps[:, rows].T),
        motor=part["motor"],
        motor_speed=part["motor_speed"],
        effort=part["effort"],
        board=part["board"],
        command_stamps=np.array(time, dtype=float),
        commands=np.array(commands, dtype=float),
        ball=part["ball"] if ball is not None else None,
        hole=ball.hole[rows].copy() if ball is not None else np.full(rows.stop - rows.start, -1),
    )
