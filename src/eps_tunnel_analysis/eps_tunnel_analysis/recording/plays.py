# SPDX-License-Identifier: Apache-2.0
"""Recordings of several commands: which trials played the same one, and each command's trials on one grid."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.plays import Play
from eps_tunnel_analysis.recording.channel_map import ChannelMap
from eps_tunnel_analysis.recording.checks import COMMANDS_ALIKE
from eps_tunnel_analysis.recording.recording import Recording
from eps_tunnel_analysis.recording.trials_from_bags import (
    MAX_GAP,
    MAX_HOLD,
    RATE,
    Span,
    TrialsResult,
    check_positive,
    collect,
    commands_on,
    on_grid,
)
from eps_tunnel_analysis.recording.windows import JITTER
from labyrinth_sim.errors import InputError
from labyrinth_sim.rig import Rig

STRAY = 0.05
"""share of the samples in which commands of one sequence may differ, as by jitter around a step"""


@dataclass(frozen=True)
class PlaysResult:
    """Every command that the recordings hold.

    Attributes:
        plays: one for each command, in the order of its first trial.
        results: what `to_trials` tells of each, in the same order.
        notes: one sentence each on what is odd but usable.
    """

    plays: tuple[Play, ...]
    results: tuple[TrialsResult, ...]
    notes: tuple[str, ...]


def to_plays(
    recordings: Sequence[Recording],
    rig: Rig | ChannelMap | None = None,
    *,
    signals: Sequence[str] | None = None,
    namespace: str | None = None,
    rate: float = RATE,
    max_gap: float = MAX_GAP,
    max_hold: float | None = MAX_HOLD,
    cut_to_shortest: bool = False,
) -> PlaysResult:
    """The trials of all bags, sorted by the command that they play; the arguments are those of `to_trials`.

    Trials belong together when their marks tell the same sequence hash; where a bag tells none, when they are equally
    long and their commands differ by more than 5 % of their range in at most 5 % of the samples.

    Raises:
        InputError: all complaints about the bags and about each command's trials at once.
    """
    check_positive(rate=rate, max_gap=max_gap, max_hold=max_hold)
    spans, notes = collect(recordings, rig, signals, namespace)
    groups = _grouped(spans, rate, max_hold)
    names = _names(groups)
    plays, results, complaints = [], [], list[str]()
    for name, group in zip(names, groups, strict=True):
        try:
            result = on_grid(group, [], rate, max_gap, max_hold, cut_to_shortest)
        except InputError as error:
            complaints += error.complaints
            continue
        plays.append(Play(name, result.trials))
        results.append(result)
        notes += result.report.notes
    if complaints:
        raise InputError(dict.fromkeys(complaints))
    return PlaysResult(tuple(plays), tuple(results), tuple(dict.fromkeys(notes)))


def _grouped(spans: Sequence[Span], rate: float, max_hold: float | None) -> list[list[Span]]:
    by_hash: dict[str, list[Span]] = {}
    groups: list[list[Span]] = []
    for span in spans:
        told = span.window.sequence_hash
        home = by_hash.get(told) if told else next((g for g in groups if _alike(g[0], span, rate, max_hold)), None)
        if home is None:
            home = []
            groups.append(home)
        if told:
            by_hash.setdefault(told, home)
        home.append(span)
    return groups


def _alike(one: Span, other: Span, rate: float, max_hold: float | None) -> bool:
    if abs(one.window.seconds - other.window.seconds) > JITTER:
        return False
    samples = int(min(one.window.seconds, other.window.seconds) * rate) + 1
    ticks = np.round(np.arange(samples) / rate * 1e9).astype(np.int64)
    first, second = (commands_on(span, span.window.start + ticks, max_hold) for span in (one, other))
    reach = np.nanmax(first, axis=0, initial=-np.inf) - np.nanmin(first, axis=0, initial=np.inf)
    with np.errstate(invalid="ignore"):
        same = np.abs(second - first) <= COMMANDS_ALIKE * np.maximum(reach, 1e-6)
    same |= np.isnan(first) & np.isnan(second)
    return bool(np.all(np.mean(~same, axis=0) <= STRAY))


def _names(groups: Sequence[Sequence[Span]]) -> list[str]:
    """The sequences' names; numbered where a bag tells none, with the hash where two share one."""
    told = [next((s.window.sequence for s in group if s.window.sequence), "") for group in groups]
    names = []
    for number, (name, group) in enumerate(zip(told, groups, strict=True), start=1):
        if name and told.count(name) == 1:
            names.append(name)
        else:
            digest = group[0].window.sequence_hash[:8]
            names.append(" ".join(part for part in (name or "command", digest or str(number)) if part))
    return names
