# SPDX-License-Identifier: Apache-2.0
"""Recording: the raw stamped channels of one bag, as recorded."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown

TimeSource = Literal["header", "log"]
Phase = Literal["start", "end", "aborted"]
TIME_SOURCES: tuple[TimeSource, ...] = ("header", "log")

Nanoseconds = NDArray[np.int64]
Column = NDArray[np.float64]


@shown
@dataclass(frozen=True)
class StampedTopic:
    """All n messages of one topic as columns, in the order of their log time.

    Attributes:
        name: the topic, with its namespace.
        type: ROS type, e.g. `sensor_msgs/msg/JointState`.
        header_stamps: (n,) ns; None where the type has no header.
        log_times: (n,) ns, when the recorder received each message.
        columns: name -> (n,) SI units, NaN where a message lacks the value. A JointState gives `JOINT.position`,
            `JOINT.velocity`, `JOINT.effort`; other types give their numeric fields by name.
        absent: column -> how many messages lack it although others have it.
    """

    name: str
    type: str
    header_stamps: Nanoseconds | None
    log_times: Nanoseconds
    columns: Mapping[str, Column]
    absent: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for stamps in (self.header_stamps, self.log_times):
            if stamps is not None:
                stamps.setflags(write=False)
        for column in self.columns.values():
            column.setflags(write=False)
        object.__setattr__(self, "columns", MappingProxyType(dict(self.columns)))
        object.__setattr__(self, "absent", MappingProxyType(dict(self.absent)))

    def __len__(self) -> int:
        return len(self.log_times)

    def stamps(self, source: TimeSource) -> Nanoseconds:
        """(n,) ns by the chosen clock; log times where the type has no header."""
        return self.log_times if source == "log" or self.header_stamps is None else self.header_stamps

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that have a position here; empty for other types."""
        return tuple(name.removesuffix(".position") for name in self.columns if name.endswith(".position"))


@dataclass(frozen=True)
class TrialMark:
    """Start or end of a trial, or that it was aborted, as published on `NS/trial`."""

    stamp: int
    """ns by the recording's time source"""
    topic: str
    phase: Phase
    trial: int
    sequence: str
    sequence_hash: str
    duration: float
    """s, length of the sequence; 0 where unknown"""


@shown
@dataclass(frozen=True)
class Recording:
    """One bag as recorded: nothing resampled, nothing dropped.

    Attributes:
        path: the bag.
        time_source: the clock that `stamps` and `marks` follow, "header" or "log".
        topics: what could be decoded, by topic name.
        others: topic -> type of the other topics in the bag.
        marks: trial starts and ends in time order.
        metadata: what the recorder noted (sequence, hash, model, versions).
        notes: irregularities that are not fatal, one sentence each.
        closed: False when the recorder was killed and the bag was recovered up to its last complete chunk.
    """

    path: Path
    time_source: TimeSource
    topics: Mapping[str, StampedTopic]
    others: Mapping[str, str] = field(default_factory=dict)
    marks: tuple[TrialMark, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    closed: bool = True

    def __post_init__(self) -> None:
        for name in ("topics", "others", "metadata"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def topic(self, name: str, type_: str | None = None) -> StampedTopic:
        """The topic `name`. Raises InputError when it is missing, empty or of another type than `type_`."""
        if name in self.others:
            expected = type_ or "one of the types that can be read: JointState, BallState, BallEvent, Trial"
            raise InputError(f"{self.path}: topic '{name}' is of type {self.others[name]}, expected {expected}.")
        if name not in self.topics:
            raise InputError(f"{self.path}: {unknown_name('topic', name, [*self.topics, *self.others])}")
        topic = self.topics[name]
        if type_ is not None and topic.type != type_:
            raise InputError(f"{self.path}: topic '{name}' is of type {topic.type}, expected {type_}.")
        if not len(topic):
            raise InputError(f"{self.path}: topic '{name}' has no messages; record it while its publisher runs.")
        return topic

    def stamps(self, name: str) -> Nanoseconds:
        """(n,) ns of one topic by the recording's time source."""
        return self.topics[name].stamps(self.time_source)
