# SPDX-License-Identifier: Apache-2.0
"""Figures that may tell beforehand how well a controller transfers from a model to the rig. All rise as it gets worse.

On a recording that no fit has seen, the same for all tasks:

    alikeness k=1 ... k=5   share of samples alike in all signals, with its sign turned
    k half, k 90 %          factor k at which half, and nine tenths, of the samples are alike in all signals
    rmse, board rmse        root mean square error of all signals; of the board alone
    band rmse               of the board between 0.5 and 5 Hz, where feedback acts; a constant error is no part of it
    error                   equation 10, mean over the signals
    floors, remaining       mean square over the noise floor; that of the worst signal

On the recording by which models were calibrated: rmse fitted, floors fitted.

Without the rig: the cost that the tuned controller has in the model, own cost.

From probes, which are controllers of the task drawn at random and played on the rig once:

    probes' track           root mean square distance between the model's and the rig's board, or ball where there is
                            one, each with its own feedback; median over the probes
    probes' rmse            error of the board where the model gets the commands that the rig got
    probes' cost            root mean square of the logarithm of the cost in the model over that on the rig
    probes' promise         mean of that logarithm where the model promises less cost than the rig has, turned positive
    probes' order           1 less Spearman's correlation of the costs in the model with those on the rig
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import rankdata
from transfer_tasks.task import BOARD_STEP, RATE, Array, Task, on_rig, play, tracks_in_model

from eps_tunnel_analysis.alikeness import KS, alikeness_over_k
from eps_tunnel_analysis.compare import Comparison, compare
from eps_tunnel_analysis.diagnose.evidence import Evidence, play_evidence
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import roll_out
from labyrinth_hw.testbed.hidden import TestbedConfig
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import simulate_batch

SIGNALS = ("motor_x", "board_x")
BAND = (0.5, 5.0)  # Hz
FACTORS = np.geomspace(0.1, 1e4, 251)
AROUND = 0.35  # share of the bounds, about where tuning starts, from which probes are drawn
DRAWS = 1000


@dataclass(frozen=True)
class Probes:
    """Controllers of a task and what the rig did with them.

    Attributes:
        task: which.
        values: (n, v).
        costs: (n,) on the rig.
        commands, board: (n, T, 2) rad, of one trial each.
        tracks: (n, T, 2) rad of the board, or m of the ball where there is one, of the same trial.
        seed: of the noise in the model.
    """

    task: Task
    values: Array
    costs: Array
    commands: Array
    board: Array
    tracks: Array
    seed: int


def probes_of(task: Task, rig: TestbedConfig, count: int, seed: int) -> Probes:
    """Draws `count` controllers and plays them."""
    drawn = np.random.default_rng(seed).uniform(-AROUND, AROUND, (count, len(task.begin)))
    values = task.of_shares(task.begin + drawn)
    runs = play(task, rig, values, 2, seed)
    commands, board = (np.stack([getattr(run, name)[0] for run in runs]) for name in ("commands", "board"))
    tracks = board if task.starts is None else np.stack([run.ball[0] for run in runs if run.ball is not None])
    return Probes(task, values, on_rig(task, runs), commands, board, tracks, seed)


def figures_of_probes(model: Model, probes: Probes) -> dict[str, float]:
    """What probes say of a model."""
    task = probes.task
    boards, balls, failed = tracks_in_model(task, model, probes.values, probes.seed)
    costs = np.where(failed, task.worst, task.cost(boards, balls)).reshape(-1, task.repeats).mean(axis=1)
    tracks = (boards if balls is None else balls)[:: task.repeats]
    apart = np.nan_to_num(np.linalg.norm(tracks - probes.tracks, axis=2), nan=task.worst)
    apart[np.isnan(tracks).any(axis=2) & np.isnan(probes.tracks).any(axis=2)] = 0.0  # lost on both sides
    replayed = simulate_batch(model, (), np.empty((1, 0)), task.time, probes.commands, {}, nthread=1,
                              signals=("board_x", "board_y"), with_ball=False, timestep=BOARD_STEP)  # fmt: skip
    return {
        "probes' track": float(np.median(np.sqrt(np.mean(apart**2, axis=1)))),
        "probes' rmse": float(np.sqrt(np.mean((replayed.values[0] - probes.board) ** 2))),
        "probes' cost": float(np.sqrt(np.mean(np.log(costs / probes.costs) ** 2))),
        "probes' promise": float(np.mean(np.maximum(np.log(probes.costs / costs), 0.0))),
        "probes' order": 1.0 - float(ranked(costs[None], probes.costs[None])[0]),
    }


def figures_of_recordings(model: Model, fitted: Play, held: Play) -> dict[str, float]:
    """Figures of a model on a recording that was not fitted, and RMSE and floors on the one that was beside them."""
    seen = _figures(model, fitted)
    return _figures(model, held) | {f"{name} fitted": seen[name] for name in ("rmse", "floors")}


def _figures(model: Model, recorded: Play) -> dict[str, float]:
    shown = compare(recorded.trials, roll_out(model, recorded), KS, signals=SIGNALS)
    board = SIGNALS.index("board_x")
    rms = np.array([e.rms for e in shown.errors])
    evidence = Evidence(model, (), [play_evidence(model, recorded, SIGNALS)], SIGNALS, BOARD_STEP, 1)
    squares = (evidence(np.empty((1, 0)))[0] / evidence.floor) ** 2
    return {
        **{f"alikeness k={a.k_real:g}": -a.joint for a in shown.alikeness},
        "k half": factor_at(shown, 0.5),
        "k 90 %": factor_at(shown, 0.9),
        "rmse": float(np.sqrt(np.mean(rms**2))),
        "board rmse": float(rms[board]),
        "band rmse": in_band(recorded.trials.values[:, :, board] - shown.sim.values[:, :, board]),
        "error": float(np.mean([e.command_error for e in shown.errors])),
        "floors": float(np.mean(squares)),
        "remaining": max(float(np.mean(squares[evidence.blocks == i])) for i in range(len(SIGNALS))),
    }


def factor_at(shown: Comparison, share: float) -> float:
    """The factor k at which this share of samples is alike in all signals; the largest tried where it never is."""
    joint = np.array([a.joint for a in alikeness_over_k(shown.real_tunnel, shown.sim_tunnel, FACTORS)])
    return float(np.exp(np.interp(share, np.maximum.accumulate(joint), np.log(FACTORS))))


def in_band(errors: Array) -> float:
    """Root mean square of errors (p, T) within BAND."""
    parts = np.fft.rfft(errors, axis=1)
    hertz = np.fft.rfftfreq(errors.shape[1], 1.0 / RATE)
    parts[:, (hertz < BAND[0]) | (hertz > BAND[1])] = 0.0
    return float(np.sqrt(np.mean(np.fft.irfft(parts, errors.shape[1], axis=1) ** 2)))


def ranked(a: Array, b: Array) -> Array:
    """(n,) Spearman's rank correlation of rows (n, m); NaN where a row holds one value only."""
    x, y = (rankdata(rows, axis=1) for rows in (a, b))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    size = np.sqrt((x**2).sum(axis=1) * (y**2).sum(axis=1))
    return np.asarray(np.where(size > 0.0, (x * y).sum(axis=1) / np.where(size > 0.0, size, 1.0), np.nan))


def correlation(x: Sequence[Array], y: Sequence[Array]) -> list[float]:
    """Spearman's rank correlation of x with y over the models, and its 95 % interval by bootstrap over the models.

    Args:
        x, y: for each of t tasks (m,) of m models; of several tasks it is their mean.
    """
    return _interval(*_drawn(x, y))


def difference(x: Sequence[Array], other: Sequence[Array], y: Sequence[Array]) -> list[float]:
    """By how much x correlates better with y than another figure does, and the 95 % interval over the same draws."""
    (value, draws), (less, drawn) = _drawn(x, y), _drawn(other, y)
    return _interval(value - less, draws - drawn)


def _drawn(x: Sequence[Array], y: Sequence[Array]) -> tuple[float, Array]:
    """The mean correlation, and (DRAWS,) those of models drawn anew."""
    models = len(x[0])
    drawn = np.random.default_rng(0).integers(models, size=(DRAWS, models))
    value = float(np.mean([ranked(a[None], b[None])[0] for a, b in zip(x, y, strict=True)]))
    return value, np.mean([ranked(a[drawn], b[drawn]) for a, b in zip(x, y, strict=True)], axis=0)


def _interval(value: float, draws: Array) -> list[float]:
    if not np.isfinite(draws).any():
        return [value, float("nan"), float("nan")]
    low, high = np.nanquantile(draws, (0.025, 0.975))
    return [value, float(low), float(high)]


def repeatability(costs: Array) -> float:
    """Spearman's correlation over the models between tunings of costs (m, n), mean over pairs; NaN with one tuning.

    Figures of a model are the same in every tuning: what one tuning's costs say of another's, no figure can exceed by
    much.
    """
    pairs = list(combinations(costs.T, 2))
    return float(np.mean([ranked(a[None], b[None])[0] for a, b in pairs])) if pairs else float("nan")
