# SPDX-License-Identifier: Apache-2.0
"""Ticks of a command, where what an axis lacks may be a rounding finer than other starts can tell apart.

A tick of which a command spans many fits only to a part of a per cent, and its misfit has no slope beside that. So
every tick is tried, by what a loop answers to a small change of its command: to first order its linear response, which
is seen in roll-outs with a few ticks. Only the best ticks are rolled out.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from eps_tunnel_analysis.diagnose.candidates import COARSEST_TICK, Candidate, is_tick, roundings
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Refit, TrialPoint
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.fit.differences import directions
from labyrinth_sim.rig import Axis, Rig
from labyrinth_sim.site import axis_site
from labyrinth_sim.trials import Array

PART_OF_A_TICK = 0.025  # by which the largest command moves from one of all ticks to the next
MOST_TICKS = 40_000  # of each way to round; the finest are left out
ROLLED_OUT = 24  # ticks, each the best of its valley
SAME_VALLEY = 0.5  # of a tick, in how many a command spans
SHOWN = 8  # ticks in whose roll-outs the response is seen
YOUNGEST, OLDEST, LAGS = 0.01, 1.5, 20  # s, ages of a command that a response tells apart, and how many
LEAST_WEIGHT = 1e-4  # share of the largest part of a response below which it is left out
SAMPLES_COMPARED = 600  # evenly spaced over the recordings
TICKS_AT_ONCE = 512  # ticks


def tick_points(search: Search, on: Sequence[Refit], allowed: float) -> list[TrialPoint]:
    """The best ticks of commands on top of refits, for axes that leave more than `allowed` floors; best first."""
    evidence, rig = search.evidence, search.library.model.rig
    points: list[TrialPoint] = []
    for axis in rig.axes:
        own = [evidence.signals.index(signal) for signal in axis.positions if signal in evidence.signals]
        here = np.isin(search.signal, own)
        ticks = [c for c in search.library.candidates
                 if is_tick(c) and c.effect.stage == "command" and c.place == axis.name]  # fmt: skip
        for (number, refit), candidate in itertools.product(enumerate(on), ticks if here.any() else ()):
            left = worst_floors(refit.residuals[here], search.signal[here])
            if candidate.name in refit.effects or left <= allowed:
                continue
            # The error of rounding is uniform within a tick; one that is below the floor does not show.
            finest = np.sqrt(12.0) * float(np.median(search.scale[here]))
            search.settle_at(refit)
            likely = likely_ticks(search, refit, candidate, axis, here, finest)
            tried = search.trial_points([refit], [candidate], {candidate.name: likely})
            points += [replace(point, on=number) for point in tried]
    return sorted(points, key=lambda point: point.promised)


def likely_ticks(
    search: Search, refit: Refit, candidate: Candidate, axis: Axis, here: NDArray[np.bool_], finest: float
) -> Array:
    """(s, k) values of a candidate: the ticks whose linear response explains most of what a refit leaves.

    Args:
        here: (R,) samples of the axis's positions.
        finest: rad, of the ticks.
    """
    rows = np.flatnonzero(here)
    rows = rows[:: max(1, len(rows) // SAMPLES_COMPARED)]
    commands = np.unique(np.concatenate(_given(search, axis)))
    largest = float(np.abs(commands).max(initial=0.0))
    ticks = every_tick(largest, finest, COARSEST_TICK * candidate.declared[0].high)
    if not len(ticks):
        return np.empty((0, len(candidate.declared)))
    shown = ticks[np.unique(np.geomspace(1, len(ticks), SHOWN).astype(int) - 1)]
    answer = command_response(search, refit, candidate, axis, rows, shown)
    compensated = directions(search.changes(refit)[rows])
    answer -= compensated @ (compensated.T @ answer)
    left = refit.residuals[rows] - compensated @ (compensated.T @ refit.residuals[rows])
    best: list[tuple[float, Array]] = []
    for row in roundings(candidate.declared):
        cost = np.zeros(len(ticks))
        for low in range(0, len(ticks), TICKS_AT_ONCE):
            part = slice(low, low + TICKS_AT_ONCE)
            wrong = _rounded(candidate, axis, search.library.model.rig, ticks[part], row, commands) - commands
            cost[part] = np.mean((left + wrong @ answer.T) ** 2, axis=1)
        best += [(float(cost[i]), np.array([ticks[i], *row[1:]])) for i in _apart(cost, largest / ticks)]
    best.sort(key=lambda pair: pair[0])
    return np.array([row for _, row in best[:ROLLED_OUT]]).reshape(-1, len(candidate.declared))


def every_tick(largest: float, finest: float, coarsest: float) -> Array:
    """(s,) rad: ticks, the coarsest first, evenly spaced in how many of them a command spans.

    Args:
        largest: rad, of the command.
    """
    fewest, most = largest / coarsest, largest / finest
    count = min(int((most - fewest) / PART_OF_A_TICK) + 1, MOST_TICKS) if most > fewest > 0.0 else 0
    return np.asarray(largest / (fewest + PART_OF_A_TICK * np.arange(count, dtype=np.float64)))


def _given(search: Search, axis: Axis) -> list[Array]:
    """For each play (K,) rad, the axis's command during each step; 0 where the drive is off."""
    u = search.library.model.rig.command_channels.index(axis.command)
    return [np.nan_to_num(c[:, u]) for c in search.evidence.commands]


def command_response(
    search: Search, refit: Refit, candidate: Candidate, axis: Axis, rows: NDArray[np.int64], ticks: Array
) -> Array:
    """(n, c) floors by which each of the samples `rows` (n,) moves per rad of each of the c commanded values.

    The response is that of a linear loop: weights of the command by its age, fitted to what ticks (t,) do to the motion
    of the refit, which the search is settled at.
    """
    evidence, rig, given = search.evidence, search.library.model.rig, _given(search, axis)
    values = np.unique(np.concatenate(given))
    row = roundings(candidate.declared)[0]
    points = np.tile(refit.values, (len(ticks), 1))
    points[:, search.columns(candidate)] = [[tick, *row[1:]] for tick in ticks]
    moved = np.nan_to_num(search.residuals(points)[:, rows] - refit.residuals[rows]) * search.scale[rows]
    answer = np.zeros((len(rows), len(values)))
    for block in np.unique(search.blocks[rows]):
        own = np.flatnonzero(search.blocks[rows] == block)
        play = int(block) // len(evidence.signals)
        time, step, command = evidence.time[search.used][rows[own]], evidence.step(play), given[play]
        wrong = _rounded(candidate, axis, rig, ticks, row, command) - command
        seen = np.stack([wrong @ shares.T for shares in _by_age(time, step, len(command))], axis=2)  # (t, own, ages)
        weights = np.linalg.lstsq(seen.reshape(-1, seen.shape[2]), moved[:, own].ravel(), rcond=LEAST_WEIGHT)[0]
        ages = _by_age(time, step, len(command))  # anew, because all at once are large
        response = np.zeros((len(own), len(command)))
        for weight, shares in zip(weights, ages, strict=True):
            response += weight * shares
        which = np.searchsorted(values, command)
        each = sparse.csr_array((np.ones(len(command)), (np.arange(len(command)), which)), (len(command), len(values)))
        answer[own] = np.asarray(response @ each) / search.scale[rows[own], None]
    return answer


def _by_age(time: Array, step: float, count: int) -> Iterator[Array]:
    """For each range of ages (n, K): the share of each step of a command in its mean over these ages before (n,) s.

    Before the first step a command was as in it.
    """

    def until(edge: float) -> Array:
        steps = (time - edge) / step
        held = np.clip(steps[:, None] - np.arange(count), 0.0, 1.0)
        held[:, 0] += np.minimum(steps, 0.0)
        return held

    edges = np.concatenate([[0.0], np.geomspace(YOUNGEST, OLDEST, LAGS)])
    for newer, older in itertools.pairwise(edges):
        yield (until(newer) - until(older)) * step / (older - newer)


def _rounded(candidate: Candidate, axis: Axis, rig: Rig, ticks: Array, row: Sequence[float], commands: Array) -> Array:
    """(t, c) what the effect makes of each command (c,) with each tick (t,) and the other values of a row (k,)."""
    values = {p.name: np.full(len(ticks), value) for p, value in zip(candidate.declared, row, strict=True)}
    values[candidate.declared[0].name] = ticks
    site = axis_site(rig, rig.command_channels.index(axis.command))
    own = np.tile(commands, (len(ticks), 1))
    made = candidate.effect.command
    rounds = made(values, site, 0.0, own[:, 0]) if made else None  # it has no memory, so no time passes
    return own if rounds is None else rounds(own, own[..., None])


def _apart(cost: Array, numbers: Array) -> list[int]:
    """The best ticks, each the best of those that lie within SAME_VALLEY of it in how many a command spans."""
    chosen: list[int] = []
    for i in np.argsort(cost, kind="stable")[: 100 * ROLLED_OUT]:
        if len(chosen) == ROLLED_OUT:
            break
        if all(abs(numbers[i] - numbers[j]) > SAME_VALLEY for j in chosen):
            chosen.append(int(i))
    return chosen
