# SPDX-License-Identifier: Apache-2.0
"""Trial marks: where each trial starts and ends, read from the messages on `NS/trial`."""

from pathlib import Path
from typing import Any

from rosbags.typesys.store import Typestore

from eps_tunnel_analysis.recording.mcap_file import RawTopic
from eps_tunnel_analysis.recording.recording import Phase, TimeSource, TrialMark
from labyrinth_sim.errors import InputError


def trial_marks(raw: RawTopic, store: Typestore, source: TimeSource, path: Path) -> list[TrialMark]:
    """The marks of one topic in time order.

    Raises:
        InputError: a message cannot be read as labyrinth_msgs/msg/Trial.
    """
    marks = []
    for i, (log_time, data) in enumerate(zip(raw.log_times, raw.messages, strict=True)):
        try:
            message: Any = store.deserialize_cdr(data, raw.type)
            stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            phases: dict[int, Phase] = {message.START: "start", message.END: "end", message.ABORTED: "aborted"}
            mark = TrialMark(
                stamp=stamp if source == "header" else log_time,
                topic=raw.name,
                phase=phases[message.phase],
                trial=int(message.trial),
                sequence=message.sequence,
                sequence_hash=message.sequence_hash,
                duration=float(message.duration),
            )
            marks.append(mark)
        except Exception as error:  # rosbags' generated code raises struct.error, AssertionError and more
            raise InputError(f"{path}: topic '{raw.name}', message {i} is not a {raw.type} ({error}).") from error
    return sorted(marks, key=lambda mark: mark.stamp)
