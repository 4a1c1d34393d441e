# SPDX-License-Identifier: Apache-2.0
"""What a loop answers to small changes of its command: to first order its linear response.

It is seen in roll-outs with a few changes. Any number of others, such as every tick or every period of an uneven
servo, can then be compared with what a refit leaves, without rolling them out.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from eps_tunnel_analysis.diagnose.candidates import Candidate
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.fit.differences import directions
from labyrinth_sim.rig import Axis
from labyrinth_sim.site import axis_site
from labyrinth_sim.trials import Array

YOUNGEST, OLDEST, LAGS = 0.01, 1.5, 20  # s, ages of a command that a response tells apart, and how many
LEAST_WEIGHT = 1e-4  # share of the largest part of a response below which it is left out
SAMPLES_COMPARED = 600  # evenly spaced over the recordings


@dataclass(frozen=True)
class OnCommand:
    """An effect on the commands of an axis whose positions are measured.

    Attributes:
        here: (R,) which of a search's samples are of these positions.
    """

    candidate: Candidate
    axis: Axis
    here: NDArray[np.bool_]

    def given(self, search: Search) -> list[Array]:
        """For each play (K,) rad, the axis's command during each step; 0 where the drive is off."""
        u = search.library.model.rig.command_channels.index(self.axis.command)
        return [np.nan_to_num(c[:, u]) for c in search.evidence.commands]

    def changes(self, search: Search, rows: Array, commands: Array) -> Array:
        """(s, c) rad by which the effect changes each of commands (c,) with each of its values `rows` (s, k).

        It must have no memory.
        """
        values = dict(zip((p.name for p in self.candidate.declared), rows.T, strict=True))
        rig = search.library.model.rig
        site = axis_site(rig, rig.command_channels.index(self.axis.command))
        own = np.tile(commands, (len(rows), 1))
        made = self.candidate.effect.command
        changed = made(values, site, 0.0, own[:, 0]) if made else None  # no time passes
        return np.zeros_like(own) if changed is None else np.asarray(changed(own, own[..., None]) - own)


@dataclass(frozen=True)
class CommandResponse:
    """What changes of an axis's commands do to some of its samples, but for what the refitted values make up for.

    Attributes:
        commands: (c,) rad, all that were given.
        moves: (n, c) floors by which each sample moves per rad of each command.
        left: (n,) floors that the refit leaves.
    """

    commands: Array
    moves: Array
    left: Array

    def costs(self, changes: Array) -> Array:
        """(s,) floors that are left with changes (s, c) rad of the commands."""
        return np.asarray(np.mean((self.left + changes @ self.moves.T) ** 2, axis=1))


def on_commands(search: Search, refit: Refit, candidates: Sequence[Candidate], allowed: float = 0.0) -> list[OnCommand]:
    """Candidates that act on commands and are not in a refit, of axes where it leaves more than `allowed` floors."""
    found = []
    for axis in search.library.model.rig.axes:
        own = [search.evidence.signals.index(name) for name in axis.positions if name in search.evidence.signals]
        here = np.isin(search.signal, own)
        if here.any() and worst_floors(refit.residuals[here], search.signal[here]) > allowed:
            acting = (c for c in candidates if c.effect.stage == "command" and c.name not in refit.effects)
            found += [OnCommand(c, axis, here) for c in acting if c.place == axis.name]
    return found


def compensated_response(search: Search, refit: Refit, effect: OnCommand, shown: Array) -> CommandResponse:
    """The response on top of a refit, as roll-outs with values `shown` (t, k) of an effect show it."""
    samples = np.flatnonzero(effect.here)
    samples = samples[:: max(1, len(samples) // SAMPLES_COMPARED)]
    moves = command_response(search, refit, effect, samples, shown)
    basis = directions(search.changes(refit)[samples])
    left = refit.residuals[samples]
    commands = np.unique(np.concatenate(effect.given(search)))
    return CommandResponse(commands, moves - basis @ (basis.T @ moves), left - basis @ (basis.T @ left))


def command_response(
    search: Search, refit: Refit, effect: OnCommand, samples: NDArray[np.int64], shown: Array
) -> Array:
    """(n, c) floors by which each of the samples (n,) moves per rad of each of the c commanded values.

    The response is that of a linear loop: weights of the command by its age, fitted to what values `shown` (t, k) of an
    effect do to the motion of the refit, whose residuals are coarse roll-outs'.
    """
    evidence, given = search.evidence, effect.given(search)
    commands = np.unique(np.concatenate(given))
    points = np.tile(refit.values, (len(shown), 1))
    points[:, search.columns(effect.candidate)] = shown
    moved = np.nan_to_num(search.residuals(points)[:, samples] - refit.residuals[samples]) * search.scale[samples]
    answer = np.zeros((len(samples), len(commands)))
    for block in np.unique(search.blocks[samples]):
        own = np.flatnonzero(search.blocks[samples] == block)
        play = int(block) // len(evidence.signals)
        time, step, command = evidence.time[search.used][samples[own]], evidence.step(play), given[play]
        wrong = effect.changes(search, shown, command)
        seen = np.stack([wrong @ shares.T for shares in _by_age(time, step, len(command))], axis=2)  # (t, own, ages)
        weights = np.linalg.lstsq(seen.reshape(-1, seen.shape[2]), moved[:, own].ravel(), rcond=LEAST_WEIGHT)[0]
        ages = _by_age(time, step, len(command))  # anew, because all at once are large
        response = np.zeros((len(own), len(command)))
        for weight, shares in zip(weights, ages, strict=True):
            response += weight * shares
        which, steps = np.searchsorted(commands, command), np.arange(len(command))
        each = sparse.csr_array((np.ones(len(command)), (steps, which)), (len(command), len(commands)))
        answer[own] = np.asarray(response @ each) / search.scale[samples[own], None]
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
    newer = until(edges[0])
    for young, old in itertools.pairwise(edges):
        older = until(old)
        yield (newer - older) * step / (old - young)
        newer = older


def apart(costs: Array, numbers: Array, distance: float, most: int) -> list[int]:
    """At most so many of the lowest costs (s,), lowest first, each the lowest of those whose numbers (s,) lie within a
    distance of its own.
    """
    chosen: list[int] = []
    for i in np.argsort(costs, kind="stable")[: 100 * most]:
        if len(chosen) == most:
            break
        if all(abs(numbers[i] - numbers[j]) > distance for j in chosen):
            chosen.append(int(i))
    return chosen
