# SPDX-License-Identifier: Apache-2.0
"""Recordings to Trials: every run of one command sequence on one even time grid."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.recording.channel_map import (
    ChannelMap,
    Source,
    channel_map,
    guessed_map,
    namespace_of,
)
from eps_tunnel_analysis.recording.checks import (
    check_channels,
    check_finite,
    check_same_channels,
    check_same_commands,
    usable,
)
from eps_tunnel_analysis.recording.reader import read_all
from eps_tunnel_analysis.recording.recording import Recording, TimeSource
from eps_tunnel_analysis.recording.resample import hold, interpolate
from eps_tunnel_analysis.recording.windows import (
    Window,
    check_same_sequence,
    cut,
    windows,
)
from labyrinth_sim.errors import InputError
from labyrinth_sim.rig import Rig
from labyrinth_sim.trials import Array, Trials

RATE = 100.0
"""Hz"""
MAX_GAP = 0.1
"""s; longest span between two measurements that is bridged by a straight line"""
MAX_HOLD = 0.5
"""s; longest pause in a stream of commands through which the last target is held"""


@dataclass(frozen=True)
class ResampleReport:
    """What was lost between the bags and the trials.

    Attributes:
        signals: m names.
        missing: (p, m) samples that are NaN, per trial and signal.
        samples: T, per trial.
        gaps: (trial, signal, start s, length s) of every span that was too long to bridge.
        notes: one sentence each on what is odd but usable.
    """

    signals: tuple[str, ...]
    missing: NDArray[np.int64]
    samples: int
    gaps: tuple[tuple[int, str, float, float], ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class TrialsResult:
    """Trials, what was lost on the way, and which sequence they played (empty where the bags do not tell)."""

    trials: Trials
    report: ResampleReport
    sequence: str
    sequence_hash: str


def read_trials(
    paths: Sequence[Path | str],
    rig: Rig | ChannelMap | None = None,
    *,
    time_source: TimeSource = "header",
    **options: object,
) -> TrialsResult:
    """`read_all`, then `to_trials`, whose options these are."""
    return to_trials(read_all(paths, time_source), rig, **options)  # type: ignore[arg-type]


def to_trials(
    recordings: Sequence[Recording],
    rig: Rig | ChannelMap | None = None,
    *,
    signals: Sequence[str] | None = None,
    namespace: str | None = None,
    rate: float = RATE,
    max_gap: float = MAX_GAP,
    max_hold: float | None = MAX_HOLD,
    cut_to_shortest: bool = False,
) -> TrialsResult:
    """Several bags as trials, or the marked trials of each bag, on one grid that starts with each trial.

    Args:
        recordings: the bags of one side. A bag with marks on `NS/trial` gives one trial per start that was played to
            its end; a bag without gives one, from its first command to its last measurement.
        rig: what is measured and commanded, and on which topics; None takes all that the bags offer.
        signals: names to take, in this order; all of them by default.
        namespace: `/real` or `/sim`; found in the bag by default.
        rate: Hz of the grid.
        max_gap: s; measurements further apart than this are not bridged, the samples between them are NaN and counted.
        max_hold: s; see `resample.hold`.
        cut_to_shortest: cuts trials of different length instead of refusing them.

    Raises:
        InputError: all complaints at once: missing topics, joints or signals, NaN or infinite values, trials of
            different length or sequence.
    """
    check_positive(rate=rate, max_gap=max_gap, max_hold=max_hold)
    spans, notes = collect(recordings, rig, signals, namespace)
    check_same_sequence([span.window for span in spans])
    return on_grid(spans, notes, rate, max_gap, max_hold, cut_to_shortest)


@dataclass(frozen=True)
class Span:
    """One trial: where it lies in which recording, and what to take from there."""

    recording: Recording
    channels: ChannelMap
    window: Window


def collect(
    recordings: Sequence[Recording],
    rig: Rig | ChannelMap | None,
    signals: Sequence[str] | None,
    namespace: str | None,
) -> tuple[list[Span], list[str]]:
    """Every trial of the recordings, whatever it plays, and notes on what was left out. See `to_trials`."""
    if not recordings:
        raise InputError("No recordings; expected at least one.")
    complaints: list[str] = []
    maps: list[ChannelMap] = []
    spans: list[Span] = []
    notes: list[str] = [note for recording in recordings for note in recording.notes]
    for recording in recordings:
        try:
            channels = _channels(recording, rig, namespace)
            channels = channels.select(signals) if signals is not None else channels
            check_channels(recording, channels)
            maps.append(channels)
            found = windows(recording, channels, notes)
            check_finite(recording, channels, found)
            spans += [Span(recording, channels, window) for window in found]
        except InputError as error:
            complaints += error.complaints
    if complaints:
        raise InputError(complaints)
    check_same_channels(recordings, maps)
    return spans, notes


def on_grid(
    spans: Sequence[Span], notes: list[str], rate: float, max_gap: float, max_hold: float | None, to_shortest: bool
) -> TrialsResult:
    """Trials of one sequence on one grid. See `to_trials`."""
    found = [span.window for span in spans]
    samples = cut([window.seconds for window in found], [window.label for window in found], rate, to_shortest, notes)
    time = np.arange(samples) / rate
    ticks = np.round(time * 1e9).astype(np.int64)
    values = np.stack([_values(span, span.window.start + ticks, max_gap) for span in spans])
    commands = np.stack([commands_on(span, span.window.start + ticks, max_hold) for span in spans])
    check_same_commands(commands, [window.label for window in found])
    first = spans[0].channels
    names = tuple(source.name for source in first.signals)
    trials = Trials(
        time=time,
        signals=names,
        units=tuple(source.unit for source in first.signals),
        values=values,
        command_channels=tuple(source.name for source in first.commands),
        commands=commands,
    )
    gaps = tuple(
        (trial, source.name, start, length)
        for trial, span in enumerate(spans)
        for source in span.channels.signals
        for start, length in _gaps(span.recording, source, span.window, max_gap)
    )
    missing = np.isnan(values).sum(axis=1)
    notes += _loss_notes(names, missing, samples, [window.label for window in found])
    report = ResampleReport(names, missing, samples, gaps, tuple(notes))
    return TrialsResult(trials, report, found[0].sequence, found[0].sequence_hash)


def check_positive(**values: float | None) -> None:
    complaints = [
        f"{name} must be a positive number, got {value}."
        for name, value in values.items()
        if value is not None and not value > 0
    ]
    if complaints:
        raise InputError(complaints)


def _channels(recording: Recording, rig: Rig | ChannelMap | None, namespace: str | None) -> ChannelMap:
    if isinstance(rig, ChannelMap):
        return rig
    if rig is None:
        return guessed_map(recording, namespace)
    return channel_map(rig, namespace_of(recording) if namespace is None else namespace)


def _values(span: Span, grid: NDArray[np.int64], max_gap: float) -> Array:
    recording, sources = span.recording, span.channels.signals
    out = np.empty((len(grid), len(sources)))
    for i, source in enumerate(sources):
        topic = recording.topics[source.topic]
        there = usable(topic, source.column)
        stamps = recording.stamps(source.topic)
        out[:, i] = interpolate(stamps[there], topic.columns[source.column][there], grid, max_gap)
    return out


def commands_on(span: Span, grid: NDArray[np.int64], max_hold: float | None) -> Array:
    """(T, u) rad, the commands of a trial on a grid (T,) ns."""
    recording, sources = span.recording, span.channels.commands
    out = np.empty((len(grid), len(sources)))
    for i, source in enumerate(sources):
        topic = recording.topics[source.topic]
        there = usable(topic, source.column)
        out[:, i] = hold(recording.stamps(source.topic)[there], topic.columns[source.column][there], grid, max_hold)
    return out


def _gaps(recording: Recording, source: Source, window: Window, max_gap: float) -> Iterator[tuple[float, float]]:
    topic = recording.topics[source.topic]
    stamps = recording.stamps(source.topic)[usable(topic, source.column)]
    for i in np.flatnonzero(np.diff(stamps) > round(max_gap * 1e9)):
        start, length = (stamps[i] - window.start) * 1e-9, (stamps[i + 1] - stamps[i]) * 1e-9
        if start + length > 0 and start < window.seconds:
            yield float(start), float(length)


def _loss_notes(names: Sequence[str], missing: NDArray[np.int64], samples: int, labels: Sequence[str]) -> Iterator[str]:
    for trial, label in enumerate(labels):
        lost = [f"{name} {count}" for name, count in zip(names, missing[trial], strict=True) if count > samples * 0.01]
        if lost:
            yield f"{label}: of {samples} samples unseen: {', '.join(lost)}."
