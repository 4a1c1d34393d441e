# SPDX-License-Identifier: Apache-2.0
"""Recordings to Trials: the runs of one command sequence, or of each of several, on one even time grid."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.outputs import shown_number
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording.channel_map import ChannelMap, Source, channel_map, guessed_map, namespace_of
from eps_tunnel_analysis.recording.decode import BALL_STATE, read_all
from eps_tunnel_analysis.recording.plausible import Samples, doubts
from eps_tunnel_analysis.recording.recording import Recording, StampedTopic, TimeSource, TrialMark
from eps_tunnel_analysis.stamped import Series, StampedTrial, hold, interpolate, switched_off
from labyrinth_sim.errors import InputError
from labyrinth_sim.rig import Rig
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array, Trials

LENGTH_JITTER = 0.1
"""s; lengths of trials that differ by less are the same length; they differ by a recorder's last messages"""
COMMANDS_ALIKE = 0.05
"""of the commands' range; trials whose commands are further apart half of the time play different sequences"""
RATE = 100.0
"""Hz"""
MAX_GAP = 0.1
"""s; longest span between two measurements that is bridged by a straight line"""
MAX_HOLD = 0.5
"""s; longest pause in a stream of commands through which the last target is held"""
MOST_SAMPLES = 2_000_000
"""of one trial on the grid, five hours at 100 Hz; more comes of a stamp or a length that is wrong"""
LONGEST_TRIAL = 1e6
"""s, of a trial"""
STRAY = 0.05
"""share of the samples in which commands of one sequence may differ, as by jitter around a step"""


@dataclass(frozen=True)
class Window:
    """One trial in a recording: from `start` (ns) on for `seconds`."""

    start: int
    seconds: float
    label: str
    sequence: str = ""
    sequence_hash: str = ""


def windows(recording: Recording, channels: ChannelMap, notes: list[str]) -> list[Window]:
    """The marked trials of a recording, or one that spans it; adds what was left out to `notes`.

    Raises:
        InputError: nothing is measured, or the recording has marks, but no trial that was played to its end.
    """
    topics = {source.topic for source in channels.signals}
    if not topics:
        raise InputError(
            f"{recording.path}: nothing that the rig measures is in it. Say in the rig's file, by `measured`, what is, "
            "or leave --rig out."
        )
    sides = {topic.rpartition("/")[0] for topic in topics}
    marks = [mark for mark in recording.marks if mark.topic.rpartition("/")[0] in sides]
    if marks:
        return _marked(recording, marks, notes)
    commands = [int(recording.stamps(source.topic)[0]) for source in channels.commands]
    start = min(commands or [int(recording.stamps(topic)[0]) for topic in topics])
    end = max(int(recording.stamps(topic)[-1]) for topic in topics)
    if end <= start:
        raise InputError(
            f"{recording.path}: all measurements end before the first command. Expected both at the same time; "
            "were two recorders' clocks mixed? Try the other time source."
        )
    metadata = recording.metadata
    return [
        Window(
            start,
            (end - start) * 1e-9,
            str(recording.path),
            metadata.get("sequence", ""),
            metadata.get("sequence_hash", ""),
        )
    ]


def _marked(recording: Recording, marks: Sequence[TrialMark], notes: list[str]) -> list[Window]:
    windows_: list[Window] = []
    started: TrialMark | None = None
    for mark in [*marks, None]:
        if started is not None and (mark is None or mark.phase != "end"):
            reason = "was aborted" if mark is not None and mark.phase == "aborted" else "has no end mark"
            notes.append(f"{recording.path}: trial {started.trial} {reason} and is left out.")
        elif started is not None and mark is not None:
            # The sequence's own length: end marks come a few milliseconds late, and each by another few.
            seconds = started.duration or (mark.stamp - started.stamp) * 1e-9
            label = f"{recording.path} trial {started.trial}"
            if not 0.0 < seconds <= LONGEST_TRIAL:
                raise InputError(
                    f"{label}: its marks say that it lasts {seconds:g} s; expected 0 to {LONGEST_TRIAL:g} s."
                )
            windows_.append(Window(started.stamp, seconds, label, started.sequence, started.sequence_hash))
        started = mark if mark is not None and mark.phase == "start" else None
    if not windows_:
        raise InputError(f"{recording.path}: it has trial marks, but no trial was played to its end.")
    return windows_


def check_same_sequence(found: Sequence[Window]) -> None:
    """Raises InputError if two windows name different sequences."""
    named = [window for window in found if window.sequence_hash]
    complaints = [
        f"{window.label}: plays sequence '{window.sequence}' ({window.sequence_hash[:12]}), but {named[0].label} plays "
        f"'{named[0].sequence}' ({named[0].sequence_hash[:12]}). Trials must play the same sequence."
        for window in named
        if window.sequence_hash != named[0].sequence_hash
    ]
    if complaints:
        raise InputError(complaints)


def cut(lengths: Sequence[float], labels: Sequence[str], rate: float, to_shortest: bool, notes: list[str]) -> int:
    """T, samples that all trials have. Raises InputError with the lengths if they differ."""
    shortest, longest = min(lengths), max(lengths)
    if longest - shortest > LENGTH_JITTER:
        words = "; ".join(f"{label} {length:.2f} s" for label, length in zip(labels, lengths, strict=True))
        if not to_shortest:
            raise InputError(
                f"Trials of different length: {words}. Expected the same length (within {LENGTH_JITTER} s); cut them "
                "to the shortest, or leave the odd one out."
            )
        notes.append(f"Trials cut to the shortest, {shortest:.2f} s: {words}.")
    return math.floor(shortest * rate + 1e-6) + 1


def visible(topic: StampedTopic) -> NDArray[np.bool_]:
    """(n,) which messages carry a measurement: a ball that is not visible has no position."""
    if topic.type == BALL_STATE:
        return topic.columns["visible"] != 0
    return np.ones(len(topic), dtype=np.bool_)


def usable(topic: StampedTopic, column: str) -> NDArray[np.bool_]:
    """(n,) which messages carry a finite value of a column."""
    return visible(topic) & np.isfinite(topic.columns[column])


def check_channels(recording: Recording, channels: ChannelMap) -> None:
    """Raises InputError unless every named column is there, in every message."""
    complaints: list[str] = []
    for source in (*channels.signals, *channels.commands):
        try:
            topic = recording.topic(source.topic, source.type)
        except InputError as error:
            complaints += error.complaints
            continue
        where = f"{recording.path}: topic '{source.topic}'"
        joint, _, quantity = source.column.rpartition(".")
        if source.column not in topic.columns:
            has = f"joints {', '.join(topic.joints)}" if topic.joints else ", ".join(topic.columns)
            complaints.append(
                f"{where} has no {quantity} of joint '{joint}', needed for '{source.name}'; it has {has}."
            )
        elif topic.absent.get(source.column):
            complaints.append(
                f"{where}: joint '{joint}' has no {quantity} in {topic.absent[source.column]} of {len(topic)} "
                "messages. Expected the same joints in every message; look for a second publisher on the topic."
            )
    if complaints:
        raise InputError(dict.fromkeys(complaints))


def check_finite(recording: Recording, channels: ChannelMap, found: Sequence[Window]) -> None:
    """Raises InputError where a value within a trial is NaN or infinite; values between trials are not used."""
    complaints: list[str] = []
    for source in (*channels.signals, *channels.commands):
        topic, stamps = recording.topics[source.topic], recording.stamps(source.topic)
        inside = np.zeros(len(topic), dtype=np.bool_)
        for window in found:
            inside |= (stamps >= window.start) & (stamps <= window.start + round(window.seconds * 1e9))
        bad = np.flatnonzero(~np.isfinite(topic.columns[source.column]) & visible(topic) & inside)
        if len(bad):
            complaints.append(
                f"{recording.path}: topic '{source.topic}': {source.column} is NaN or infinite in {len(bad)} of "
                f"{len(topic)} messages, first {(stamps[bad[0]] - stamps[0]) * 1e-9:.3f} s after the topic's first. "
                "Expected finite numbers throughout every trial; look for a broken sensor channel, or leave the signal "
                "out."
            )
    if complaints:
        raise InputError(dict.fromkeys(complaints))


def check_same_channels(recordings: Sequence[Recording], maps: Sequence[ChannelMap]) -> None:
    """Raises InputError when two recordings offer different signals or commands."""
    names = [([s.name for s in m.signals], [s.name for s in m.commands]) for m in maps]
    complaints = [
        f"{recording.path}: signals {signals} and commands {commands} differ from those of {recordings[0].path}, "
        f"{names[0][0]} and {names[0][1]}. Trials need the same; name a rig or the signals."
        for recording, (signals, commands) in zip(recordings, names, strict=True)
        if (signals, commands) != names[0]
    ]
    if complaints:
        raise InputError(complaints)


def check_same_commands(commands: Array, labels: Sequence[str], units: Sequence[str]) -> None:
    """Raises InputError when commands are too far apart to be of one sequence, which needs no hash in the bag."""
    spread = np.nanmax(commands[0], axis=0, initial=-np.inf) - np.nanmin(commands[0], axis=0, initial=np.inf)
    complaints = []
    for trial in range(1, len(commands)):
        for channel in range(commands.shape[2]):
            apart = np.abs(commands[trial, :, channel] - commands[0, :, channel])
            if np.isfinite(apart).any() and np.nanmedian(apart) > COMMANDS_ALIKE * max(spread[channel], 1e-6):
                complaints.append(
                    f"{labels[trial]}: its commands are not those of {labels[0]} (they are {np.nanmedian(apart):.4g} "
                    f"{units[channel]} apart half of the time). Trials must play the same sequence; compare these bags "
                    "separately."
                )
                break
    if complaints:
        raise InputError(complaints)


@dataclass(frozen=True)
class ResampleReport:
    """What was lost on the way from the bags to the trials.

    Attributes:
        signals: m names.
        missing: (p, m) samples that are NaN, per trial and signal.
        samples: T, per trial.
        gaps: (trial, signal, start s, length s) of every span that was too long to bridge.
        notes: one sentence each on irregularities that are not fatal.
    """

    signals: tuple[str, ...]
    missing: NDArray[np.int64]
    samples: int
    gaps: tuple[tuple[int, str, float, float], ...]
    notes: tuple[str, ...]


@shown
@dataclass(frozen=True)
class TrialsResult:
    """Trials on a grid and at their own stamps, what was lost on the way, which sequence they played (empty where the
    bags do not say), and the bags that they are from.
    """

    trials: Trials
    report: ResampleReport
    sequence: str
    sequence_hash: str
    stamped: tuple[StampedTrial, ...] = ()
    bags: tuple[Path, ...] = ()


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
        max_hold: s; see `hold`.
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
class RecordedTrial:
    """One trial: where it is in which recording, and what to take from there."""

    recording: Recording
    channels: ChannelMap
    window: Window


def collect(
    recordings: Sequence[Recording],
    rig: Rig | ChannelMap | None,
    signals: Sequence[str] | None,
    namespace: str | None,
) -> tuple[list[RecordedTrial], list[str]]:
    """Every trial of the recordings, whatever it plays, and notes on what was left out. See `to_trials`."""
    if not recordings:
        raise InputError("No recordings; expected at least one.")
    complaints: list[str] = []
    maps: list[ChannelMap] = []
    spans: list[RecordedTrial] = []
    notes: list[str] = [note for recording in recordings for note in recording.notes]
    for recording in recordings:
        try:
            channels = _channels(recording, rig, namespace)
            channels = channels.select(signals) if signals is not None else channels
            check_channels(recording, channels)
            maps.append(channels)
            found = windows(recording, channels, notes)
            check_finite(recording, channels, found)
            spans += [RecordedTrial(recording, channels, window) for window in found]
        except InputError as error:
            complaints += error.complaints
    if complaints:
        raise InputError(complaints)
    check_same_channels(recordings, maps)
    return spans, [*notes, *doubts(samples for span in spans for samples in _samples(span))]


def _samples(span: RecordedTrial) -> Iterator[Samples]:
    """What a trial holds of each position and command."""
    start, seconds = span.window.start, span.window.seconds
    positions = [source for source in span.channels.signals if source.unit in ("rad", "m")]
    for source in (*positions, *span.channels.commands):
        topic = span.recording.topics[source.topic]
        stamps = span.recording.stamps(source.topic)
        inside = usable(topic, source.column) & (stamps >= start) & (stamps <= start + round(seconds * 1e9))
        commanded = source not in positions
        kind = "command" if commanded else "signal"
        time = np.asarray((stamps[inside] - start) * 1e-9, dtype=float)
        yield Samples(
            f"{kind} '{source.name}'", source.unit, span.window.label, time,
            source.to_si(topic.columns[source.column][inside]), source.limits, commanded,
        )  # fmt: skip


def on_grid(
    spans: Sequence[RecordedTrial],
    notes: list[str],
    rate: float,
    max_gap: float,
    max_hold: float | None,
    to_shortest: bool,
) -> TrialsResult:
    """Trials of one sequence on one grid. See `to_trials`."""
    found = [span.window for span in spans]
    check_lengths(found, rate)
    samples = cut([window.seconds for window in found], [window.label for window in found], rate, to_shortest, notes)
    time = np.arange(samples) / rate
    ticks = np.round(time * 1e9).astype(np.int64)
    values = np.stack([_values(span, span.window.start + ticks, max_gap) for span in spans])
    commands = np.stack([commands_on(span, span.window.start + ticks, max_hold) for span in spans])
    first = spans[0].channels
    check_same_commands(commands, [window.label for window in found], [source.unit for source in first.commands])
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
    stamped = tuple(stamped_trial(span, max_hold) for span in spans)
    bags = tuple(dict.fromkeys(span.recording.path for span in spans))
    return TrialsResult(trials, report, found[0].sequence, found[0].sequence_hash, stamped, bags)


def check_lengths(found: Sequence[Window], rate: float) -> None:
    """Raises InputError for trials too long for a grid, before any is made."""
    complaints = [
        f"{window.label}: {shown_number(window.seconds, 6)} s at {rate:g} Hz would be "
        f"{shown_number(window.seconds * rate)} samples; expected at most {MOST_SAMPLES}. "
        "Is one message's stamp, or the length on its trial mark, wrong? Else lower the rate."
        for window in found
        if window.seconds * rate > MOST_SAMPLES
    ]
    if complaints:
        raise InputError(complaints)


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


def _values(span: RecordedTrial, grid: NDArray[np.int64], max_gap: float) -> Array:
    recording, sources = span.recording, span.channels.signals
    out = np.empty((len(grid), len(sources)))
    for i, source in enumerate(sources):
        topic = recording.topics[source.topic]
        there = usable(topic, source.column)
        stamps = recording.stamps(source.topic)
        out[:, i] = interpolate(stamps[there], source.to_si(topic.columns[source.column][there]), grid, max_gap)
    return out


def commands_on(span: RecordedTrial, grid: NDArray[np.int64], max_hold: float | None) -> Array:
    """(T, u) rad or m, the commands of a trial on a grid (T,) ns."""
    recording, sources = span.recording, span.channels.commands
    out = np.empty((len(grid), len(sources)))
    for i, source in enumerate(sources):
        topic = recording.topics[source.topic]
        there = usable(topic, source.column)
        values = source.to_si(topic.columns[source.column][there])
        out[:, i] = hold(recording.stamps(source.topic)[there], values, grid, max_hold)
    return out


def stamped_trial(span: RecordedTrial, max_hold: float | None) -> StampedTrial:
    """A trial at its own stamps, s since its start; commands from before it that still hold included."""
    start, seconds = span.window.start, span.window.seconds

    def series_of(source: Source, earlier: bool) -> Series:
        topic = span.recording.topics[source.topic]
        there = usable(topic, source.column)
        time = np.asarray((span.recording.stamps(source.topic)[there] - start) * 1e-9, dtype=float)
        values = source.to_si(topic.columns[source.column][there])
        first = np.searchsorted(time, 0.0, side="right") - 1 if earlier else np.searchsorted(time, 0.0)
        inside = slice(max(int(first), 0), int(np.searchsorted(time, seconds + 1e-9, side="right")))
        return Series(time[inside], values[inside])

    commands = {
        source.name: switched_off(series_of(source, True), seconds, max_hold) for source in span.channels.commands
    }
    signals = {source.name: series_of(source, False) for source in span.channels.signals}
    return StampedTrial(seconds, commands, signals, str(span.recording.path))


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


@shown
@dataclass(frozen=True)
class PlaysResult:
    """Every command that the recordings hold.

    Attributes:
        plays: one for each command, in the order of its first trial.
        results: what `to_trials` returns for each, in the same order.
        notes: one sentence each on irregularities that are not fatal.
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

    Trials belong together if their marks have the same sequence hash; where a bag has none, if they are equally
    long and their commands differ by more than 5 % of their range in at most 5 % of the samples.

    Raises:
        InputError: all complaints about the bags and about each command's trials at once.
    """
    check_positive(rate=rate, max_gap=max_gap, max_hold=max_hold)
    spans, notes = collect(recordings, rig, signals, namespace)
    check_lengths([span.window for span in spans], rate)
    groups = _grouped(spans, rate, max_hold)
    names = _names(groups)
    plays, results, complaints = [], [], list[str]()
    for name, group in zip(names, groups, strict=True):
        try:
            result = on_grid(group, [], rate, max_gap, max_hold, cut_to_shortest)
        except InputError as error:
            complaints += error.complaints
            continue
        plays.append(Play(name, result.trials, stamped=result.stamped))
        results.append(result)
        notes += result.report.notes
    if complaints:
        raise InputError(dict.fromkeys(complaints))
    return PlaysResult(tuple(plays), tuple(results), tuple(dict.fromkeys(notes)))


def _grouped(spans: Sequence[RecordedTrial], rate: float, max_hold: float | None) -> list[list[RecordedTrial]]:
    by_hash: dict[str, list[RecordedTrial]] = {}
    groups: list[list[RecordedTrial]] = []
    for span in spans:
        digest = span.window.sequence_hash
        home = by_hash.get(digest) if digest else next((g for g in groups if _alike(g[0], span, rate, max_hold)), None)
        if home is None:
            home = []
            groups.append(home)
        if digest:
            by_hash.setdefault(digest, home)
        home.append(span)
    return groups


def _alike(one: RecordedTrial, other: RecordedTrial, rate: float, max_hold: float | None) -> bool:
    if abs(one.window.seconds - other.window.seconds) > LENGTH_JITTER:
        return False
    samples = int(min(one.window.seconds, other.window.seconds) * rate) + 1
    ticks = np.round(np.arange(samples) / rate * 1e9).astype(np.int64)
    first, second = (commands_on(span, span.window.start + ticks, max_hold) for span in (one, other))
    reach = np.nanmax(first, axis=0, initial=-np.inf) - np.nanmin(first, axis=0, initial=np.inf)
    with np.errstate(invalid="ignore"):
        same = np.abs(second - first) <= COMMANDS_ALIKE * np.maximum(reach, 1e-6)
    same |= np.isnan(first) & np.isnan(second)
    return bool(np.all(np.mean(~same, axis=0) <= STRAY))


def _names(groups: Sequence[Sequence[RecordedTrial]]) -> list[str]:
    """The sequences' names; numbered where a bag has none, with the hash where two share one."""
    sequences = [next((s.window.sequence for s in group if s.window.sequence), "") for group in groups]
    names = []
    for number, (name, group) in enumerate(zip(sequences, groups, strict=True), start=1):
        if name and sequences.count(name) == 1:
            names.append(name)
        else:
            digest = group[0].window.sequence_hash[:8]
            names.append(" ".join(part for part in (name or "command", digest or str(number)) if part))
    return names
