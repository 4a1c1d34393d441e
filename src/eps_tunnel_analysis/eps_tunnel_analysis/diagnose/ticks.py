# SPDX-License-Identifier: Apache-2.0
"""Ticks of a command, where what an axis lacks may be a rounding finer than other starts can tell apart.

A tick of which a command spans many fits only to a part of a per cent, and its misfit has no slope beside that. So
every tick is tried by the loop's linear response, and only the best are rolled out.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.diagnose.candidates import COARSEST_TICK, Candidate, is_tick, roundings, starts
from eps_tunnel_analysis.diagnose.command_response import OnCommand, apart, compensated_response, on_commands
from eps_tunnel_analysis.diagnose.refits import Refit, TrialPoint
from eps_tunnel_analysis.diagnose.search import Search
from labyrinth_sim.trials import Array

PART_OF_A_TICK = 0.1  # by which the largest command moves from one of all ticks to the next
MOST_TICKS = 10_000  # of each way to round; the finest are left out
FEW_TICKS = 10.0  # ticks; where a command spans no more, a ladder of ticks misses none, and a response may be far off
ROLLED_OUT = 24  # ticks, each the best of its valley
SAME_VALLEY = 0.5  # of a tick, in how many a command spans
TICKS_AT_ONCE = 512
SHOWN = 8  # ticks in whose roll-outs the response is seen


def tick_points(search: Search, on: Sequence[Refit], allowed: float) -> list[TrialPoint]:
    """The best ticks of commands on top of refits, for axes that leave more than `allowed` floors; best first."""
    points: list[TrialPoint] = []
    for number, refit in enumerate(on):
        if ticks := _ticks(search, refit, search.library.candidates, allowed):
            search.settle_at(refit)
            likely = {tick.candidate.name: likely_ticks(search, refit, tick) for tick in ticks}
            tried = search.trial_points([refit], search.library.of(likely), likely)
            points += [replace(point, on=number) for point in tried]
    return sorted(points, key=lambda point: point.promised)


def tick_starts(search: Search, refit: Refit, candidates: Sequence[Candidate]) -> dict[str, Array]:
    """Each tick of a command among candidates -> values (s, k) to begin from on top of a refit, whose residuals are
    coarse roll-outs': the likeliest, and coarse ones.
    """
    found = {}
    for tick in _ticks(search, refit, candidates):
        coarse = [row for row in starts(tick.candidate) if _largest(search, tick) <= FEW_TICKS * row[0]]
        found[tick.candidate.name] = np.vstack([*coarse, likely_ticks(search, refit, tick)])
    return found


def _ticks(search: Search, refit: Refit, candidates: Sequence[Candidate], allowed: float = 0.0) -> list[OnCommand]:
    return on_commands(search, refit, [c for c in candidates if is_tick(c)], allowed)


def _largest(search: Search, tick: OnCommand) -> float:
    """rad, of the commands that it rounds."""
    return max(float(np.abs(given).max(initial=0.0)) for given in tick.given(search))


def likely_ticks(search: Search, refit: Refit, tick: OnCommand) -> Array:
    """(s, k) values of a candidate: the ticks whose linear response explains most of what a refit leaves."""
    declared, largest = tick.candidate.declared, _largest(search, tick)
    # The error of rounding is uniform within a tick; one that is below the floor does not show.
    finest = np.sqrt(12.0) * float(np.median(search.scale[tick.here]))
    ticks = every_tick(largest, finest, COARSEST_TICK * declared[0].high)
    if not len(ticks):
        return np.empty((0, len(declared)))
    ways = roundings(declared)
    shown = ticks[np.unique(np.geomspace(1, len(ticks), SHOWN).astype(int) - 1)]
    response = compensated_response(search, refit, tick, _rows(ways[0], shown))
    best: list[tuple[float, Array]] = []
    for way in ways:
        rows = _rows(way, ticks)
        parts = np.array_split(rows, -(-len(rows) // TICKS_AT_ONCE))  # all at once are large
        costs = np.concatenate([response.costs(tick.changes(search, part, response.commands)) for part in parts])
        best += [(float(costs[i]), rows[i]) for i in apart(costs, largest / ticks, SAME_VALLEY, ROLLED_OUT)]
    best.sort(key=lambda pair: pair[0])
    return np.array([row for _, row in best[:ROLLED_OUT]]).reshape(-1, len(declared))


def _rows(way: Sequence[float], ticks: Array) -> Array:
    """(s, k) a way to round, its values (k,) typical ones, with each of ticks (s,)."""
    rows = np.tile(np.asarray(way, dtype=np.float64), (len(ticks), 1))
    rows[:, 0] = ticks
    return rows


def every_tick(largest: float, finest: float, coarsest: float) -> Array:
    """(s,) rad: ticks, the coarsest first, evenly spaced in how many of them a command spans.

    Args:
        largest: rad, of the command.
    """
    fewest, most = largest / coarsest, largest / finest
    count = min(int((most - fewest) / PART_OF_A_TICK) + 1, MOST_TICKS) if most > fewest > 0.0 else 0
    return np.asarray(largest / (fewest + PART_OF_A_TICK * np.arange(count, dtype=np.float64)))
