# SPDX-License-Identifier: Apache-2.0
"""Windows: where in a recording each trial begins and how long it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from eps_tunnel_analysis.recording.channel_map import ChannelMap
from eps_tunnel_analysis.recording.recording import Recording, TrialMark
from labyrinth_sim.errors import InputError

JITTER = 0.1
"""s; lengths of trials that differ by less are the same length, told by a recorder's last messages"""


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
        InputError: the recording has marks, but no trial that was played to its end.
    """
    topics = {source.topic for source in channels.signals}
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
    found: list[Window] = []
    started: TrialMark | None = None
    for mark in [*marks, None]:
        if started is not None and (mark is None or mark.phase != "end"):
            reason = "was given up" if mark is not None and mark.phase == "aborted" else "has no end mark"
            notes.append(f"{recording.path}: trial {started.trial} {reason} and is left out.")
        elif started is not None and mark is not None:
            # The sequence's own length: end marks come a few milliseconds late, and each by another few.
            seconds = started.duration or (mark.stamp - started.stamp) * 1e-9
            label = f"{recording.path} trial {started.trial}"
            found.append(Window(started.stamp, seconds, label, started.sequence, started.sequence_hash))
        started = mark if mark is not None and mark.phase == "start" else None
    if not found:
        raise InputError(f"{recording.path}: it has trial marks, but no trial was played to its end.")
    return found


def check_same_sequence(found: Sequence[Window]) -> None:
    """Raises InputError when two windows tell different sequences."""
    told = [window for window in found if window.sequence_hash]
    complaints = [
        f"{window.label}: plays sequence '{window.sequence}' ({window.sequence_hash[:12]}), but {told[0].label} plays "
        f"'{told[0].sequence}' ({told[0].sequence_hash[:12]}). Trials must play the same sequence."
        for window in told
        if window.sequence_hash != told[0].sequence_hash
    ]
    if complaints:
        raise InputError(complaints)


def cut(lengths: Sequence[float], labels: Sequence[str], rate: float, to_shortest: bool, notes: list[str]) -> int:
    """T, samples that all trials have. Raises InputError that tells the lengths where they differ."""
    shortest, longest = min(lengths), max(lengths)
    if longest - shortest > JITTER:
        told = "; ".join(f"{label} {length:.2f} s" for label, length in zip(labels, lengths, strict=True))
        if not to_shortest:
            raise InputError(
                f"Trials of different length: {told}. Expected the same length (within {JITTER} s); cut them to the "
                "shortest, or leave the odd one out."
            )
        notes.append(f"Trials cut to the shortest, {shortest:.2f} s: {told}.")
    return math.floor(shortest * rate + 1e-6) + 1
