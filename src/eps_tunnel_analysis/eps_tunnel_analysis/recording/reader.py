# SPDX-License-Identifier: Apache-2.0
"""Reader: a bag on disk to a Recording."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rosbags.typesys import TypesysError

from eps_tunnel_analysis.recording.bag import Bag, read_bag
from eps_tunnel_analysis.recording.decode import decode_topic
from eps_tunnel_analysis.recording.marks import trial_marks
from eps_tunnel_analysis.recording.message_types import READABLE, SAMPLED, TRIAL, typestore
from eps_tunnel_analysis.recording.recording import (
    TIME_SOURCES,
    Recording,
    StampedTopic,
    TimeSource,
)
from labyrinth_sim.errors import Complaints, InputError, unknown_name


def read(path: Path | str, time_source: TimeSource = "header") -> Recording:
    """One bag: a rosbag2 folder, or a single .mcap or .db3 file; only read, never changed.

    Args:
        path: the bag. One whose recorder was killed is read up to its last whole chunk.
        time_source: "header", the stamp set where the value was measured, or "log", when the recorder received it.

    Raises:
        InputError: no bag, an empty, truncated or foreign one, messages that are not what their type says, stamps
            that are missing or run backwards or come twice. All complaints at once.
    """
    path = Path(path)
    if time_source not in TIME_SOURCES:
        raise InputError(unknown_name("time source", time_source, TIME_SOURCES))
    bag = read_bag(path)
    if not any(raw.messages for raw in bag.topics.values()):
        raise InputError(f"{path}: the bag holds no messages. Expected a recording of a rig or a simulation.")
    try:
        store = typestore((raw.type, raw.definition) for raw in bag.topics.values() if raw.type in READABLE)
    except TypesysError as error:
        raise InputError(f"{path}: a message definition in the bag cannot be read ({error}).") from error
    readable = {name: raw for name, raw in bag.topics.items() if raw.type in READABLE}
    topics = {name: decode_topic(raw, store, path) for name, raw in readable.items() if raw.type in store.fielddefs}
    sampled = [topic for topic in topics.values() if topic.type in SAMPLED]
    complaints = [text for topic in sampled for text in _stamp_complaints(topic, time_source, path)]
    if complaints:
        raise InputError(complaints)
    marks = [
        mark
        for name, raw in readable.items()
        if raw.type == TRIAL and name in topics
        for mark in trial_marks(raw, store, time_source, path)
    ]
    return Recording(
        path=path,
        time_source=time_source,
        topics=topics,
        others={name: raw.type for name, raw in bag.topics.items() if name not in topics},
        marks=tuple(marks),
        metadata=bag.metadata,
        notes=tuple(_notes(bag)),
        closed=bag.recovered is None,
    )


def read_all(paths: Sequence[Path | str], time_source: TimeSource = "header") -> list[Recording]:
    """`read` each of several bags. Raises InputError where none is named, else with all complaints at once."""
    if not paths:
        raise InputError("No bags named; expected at least one rosbag2 folder, .mcap or .db3 file.")
    complaints = Complaints()
    recordings = [complaints.attempt(partial(read, path, time_source)) for path in paths]
    complaints.check()
    return [recording for recording in recordings if recording is not None]


def _notes(bag: Bag) -> list[str]:
    return [f"{bag.path}: {bag.recovered}"] if bag.recovered else []


def _stamp_complaints(topic: StampedTopic, source: TimeSource, path: Path) -> list[str]:
    """What is wrong with a topic's clock: interpolation and delays need stamps that strictly increase."""
    if len(topic) < 2:
        return []
    stamps = topic.stamps(source)
    where = f"{path}: topic '{topic.name}'"
    other = "log" if source == "header" and topic.header_stamps is not None else "header"
    if not stamps.any():
        return [f"{where}: all {source} stamps are zero; expected times of measurement. Try the time source '{other}'."]
    steps = np.diff(stamps)
    complaints = []
    for bad, what in ((steps < 0, "runs backwards"), (steps == 0, "stands still (duplicate stamps)")):
        if bad.any():
            first = int(np.flatnonzero(bad)[0])
            complaints.append(
                f"{where}: the {source} time {what} at {np.count_nonzero(bad)} of {len(steps)} steps, first at message "
                f"{first + 1} ({stamps[first] * 1e-9:.6f} s, then {stamps[first + 1] * 1e-9:.6f} s). Expected stamps "
                f"that increase. Look for two publishers or a clock that was set; or try the time source '{other}'."
            )
    return complaints
