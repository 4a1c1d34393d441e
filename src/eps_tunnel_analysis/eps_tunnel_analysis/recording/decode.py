# SPDX-License-Identifier: Apache-2.0
"""Serialised messages of one topic to columns of numbers."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore

from eps_tunnel_analysis.recording.cdr import decode_constant
from eps_tunnel_analysis.recording.mcap_file import RawTopic
from eps_tunnel_analysis.recording.message_types import JOINT_STATE
from eps_tunnel_analysis.recording.recording import Column, Nanoseconds, StampedTopic
from labyrinth_sim.errors import InputError

JOINT_FIELDS = ("position", "velocity", "effort")


def decode_topic(raw: RawTopic, store: Typestore, path: Path) -> StampedTopic:
    """Columns of one topic.

    Raises:
        InputError: a message cannot be read as the type that the bag claims, or has fewer values than joints.
    """
    log_times = np.array(raw.log_times, dtype=np.int64)
    if not raw.messages:
        return StampedTopic(raw.name, raw.type, None, log_times, {})
    absent: Mapping[str, int] = {}
    constant = decode_constant(raw.messages, raw.type, store)
    if constant is None:
        messages = _deserialised(raw, store, path)
        stamps = _header_stamps(messages)
        if raw.type == JOINT_STATE:
            columns, absent = _joint_columns(messages, raw, path)
        else:
            columns = _number_columns(messages)
    else:
        numbers, strings = constant
        stamps = None
        if "header.stamp.sec" in numbers:
            stamps = numbers["header.stamp.sec"].astype(np.int64) * 1_000_000_000 + numbers["header.stamp.nanosec"]
        if raw.type == JOINT_STATE:
            columns = _constant_joint_columns(numbers, strings["name"], raw, path)
        else:
            columns = {
                name: c.astype(np.float64) for name, c in numbers.items() if c.ndim == 1 and "header" not in name
            }
    return StampedTopic(raw.name, raw.type, stamps, log_times, columns, absent)


def _constant_joint_columns(
    numbers: Mapping[str, NDArray[Any]], names: Sequence[str], raw: RawTopic, path: Path
) -> dict[str, Column]:
    columns = {}
    _check_names(names, raw, path)
    for name in JOINT_FIELDS:
        values = numbers[name]
        _check_count(values.shape[1], names, name, 0, raw, path)
        for column, joint in enumerate(names if values.shape[1] else ()):
            columns[f"{joint}.{name}"] = np.ascontiguousarray(values[:, column])
    return columns


def _joint_columns(messages: Sequence[Any], raw: RawTopic, path: Path) -> tuple[dict[str, Column], dict[str, int]]:
    """Joints matched by name, message by message; names may come and go, and change their order."""
    columns: dict[str, Column] = {}
    present: dict[str, int] = {}
    for i, message in enumerate(messages):
        _check_names(message.name, raw, path)
        for name in JOINT_FIELDS:
            values = getattr(message, name)
            _check_count(len(values), message.name, name, i, raw, path)
            for joint, value in zip(message.name, values, strict=False):
                key = f"{joint}.{name}"
                if key not in columns:
                    columns[key] = np.full(len(messages), np.nan)
                    present[key] = 0
                columns[key][i] = value
                present[key] += 1
    return columns, {key: len(messages) - n for key, n in present.items() if n < len(messages)}


def _check_names(names: Sequence[str], raw: RawTopic, path: Path) -> None:
    if len(set(names)) != len(names):
        raise InputError(f"{path}: topic '{raw.name}' names a joint twice in one message: {', '.join(names)}.")


def _check_count(count: int, names: Sequence[str], name: str, message: int, raw: RawTopic, path: Path) -> None:
    if count not in (0, len(names)):
        raise InputError(
            f"{path}: topic '{raw.name}', message {message}: {count} values of {name} for {len(names)} joints "
            f"({', '.join(names)}); expected one per joint, or none."
        )


def _deserialised(raw: RawTopic, store: Typestore, path: Path) -> list[Any]:
    messages = []
    for i, data in enumerate(raw.messages):
        try:
            messages.append(store.deserialize_cdr(data, raw.type))
        except Exception as error:  # rosbags' generated code raises struct.error, AssertionError and more
            raise InputError(f"{path}: topic '{raw.name}', message {i} is not a {raw.type} ({error}).") from error
    return messages


def _header_stamps(messages: Sequence[Any]) -> Nanoseconds | None:
    if not hasattr(messages[0], "header"):
        return None
    stamps = (message.header.stamp for message in messages)
    return np.array([stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in stamps], dtype=np.int64)


def _number_columns(messages: Sequence[Any]) -> dict[str, Column]:
    fields = [name for name, value in vars(messages[0]).items() if isinstance(value, (bool, int, float, np.number))]
    return {name: np.array([getattr(message, name) for message in messages], dtype=np.float64) for name in fields}
