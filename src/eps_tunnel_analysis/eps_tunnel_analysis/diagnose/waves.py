# SPDX-License-Identifier: Apache-2.0
"""Waves over a command, as of a servo whose targets are uneven: where their descents begin.

A descent finds a period only from one that is less than half a wave off over the whole command. So all periods are
tried by the loop's linear response, each with the size and phase that explain most of what is left.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from eps_tunnel_analysis.diagnose.candidates import Candidate
from eps_tunnel_analysis.diagnose.command_response import OnCommand, apart, compensated_response, on_commands
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from labyrinth_sim.trials import Array

PART_OF_A_WAVE = 0.25  # by how much of one the waves over a command's range differ from one period to the next
MOST_PERIODS = 1000  # the shortest are left out
PERIODS_TRIED = 12  # periods, each the best of its valley
SAME_VALLEY = 0.5  # of a wave, over the command's range
SHOWN = 8  # periods in whose roll-outs the response is seen


def is_wave(candidate: Candidate) -> bool:
    """Whether its values begin with the amplitude, period and phase of a sine."""
    return [p.name for p in candidate.declared[:3]] == ["amplitude", "period", "phase"]


def wave_starts(search: Search, refit: Refit, candidates: Sequence[Candidate]) -> dict[str, Array]:
    """Each wave over a command among candidates -> the likeliest values (s, k) to begin from on top of a refit, whose
    residuals are coarse roll-outs'.
    """
    waves = on_commands(search, refit, [c for c in candidates if is_wave(c)])
    return {wave.candidate.name: likely_waves(search, refit, wave) for wave in waves}


def likely_waves(search: Search, refit: Refit, wave: OnCommand) -> Array:
    """(s, k) values of a candidate, each period with the amplitude and phase that its linear response asks for."""
    amplitude, period, phase, *others = wave.candidate.declared
    span = float(np.ptp(np.concatenate(wave.given(search))))
    periods = every_period(span, period.low, period.high)
    typical = np.array([amplitude.typical, period.typical, phase.typical, *(p.typical for p in others)])

    def rows(of: Array, at: float) -> Array:
        made = np.tile(typical, (len(of), 1))
        made[:, 1], made[:, 2] = of, at
        return made

    shown = periods[np.unique(np.geomspace(1, len(periods), SHOWN).astype(int) - 1)]
    response = compensated_response(search, refit, wave, rows(shown, 0.0))
    sine, cosine = (wave.changes(search, rows(periods, at), response.commands) @ response.moves.T
                    for at in (0.0, 0.5 * np.pi))  # fmt: skip
    found, costs = np.zeros((len(periods), 2)), np.zeros(len(periods))
    for i, columns in enumerate(np.stack([sine, cosine], axis=2)):
        found[i] = np.linalg.lstsq(columns, -response.left, rcond=None)[0]
        costs[i] = np.mean((response.left + columns @ found[i]) ** 2)
    best = apart(costs, span / periods, SAME_VALLEY, PERIODS_TRIED)
    begun = rows(periods[best], 0.0)
    begun[:, 0] = np.clip(typical[0] * np.hypot(*found[best].T), amplitude.low, amplitude.high)
    begun[:, 2] = np.arctan2(found[best, 1], found[best, 0])
    ends = [np.array(end) for end in itertools.product(*((p.low, p.high) for p in others))]
    return np.vstack([np.column_stack([begun[:, :3], np.tile(end, (len(begun), 1))]) for end in ends])


def every_period(span: float, shortest: float, longest: float) -> Array:
    """(s,) rad: periods, the longest first, evenly spaced in how many of them a command spans."""
    fewest, most = span / longest, span / shortest
    count = min(int((most - fewest) / PART_OF_A_WAVE) + 1, MOST_PERIODS)
    return np.clip(span / (fewest + PART_OF_A_WAVE * np.arange(count, dtype=np.float64)), shortest, longest)
