# SPDX-License-Identifier: Apache-2.0
"""Bag: the serialised messages of a rosbag2 recording, by topic, as they lie on disk.

A folder with metadata.yaml was closed by its recorder and must be whole. A folder without it was never closed (the
recorder was killed), and so is a lone .mcap file without a footer: those are read up to their last whole chunk.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from rosbags.interfaces import MessageDefinition
from rosbags.rosbag2 import Reader

from eps_tunnel_analysis.recording.recovery import MCAP_MAGIC, head_metadata, scan
from labyrinth_sim.errors import InputError

SUFFIXES = (".mcap", ".db3")
EXPECTED = "a rosbag2 folder (with metadata.yaml) or a single .mcap or .db3 file of ROS 2 messages"


@dataclass
class RawTopic:
    """Messages of one topic in log-time order; grows while the bag is read."""

    name: str
    type: str
    definition: MessageDefinition
    log_times: list[int] = field(default_factory=list)
    """ns"""
    messages: list[bytes] = field(default_factory=list)
    """CDR"""


@dataclass(frozen=True)
class Bag:
    """Everything in one bag, still serialised."""

    path: Path
    topics: Mapping[str, RawTopic]
    metadata: Mapping[str, str]
    recovered: str | None
    """None for a bag that was closed properly, else one sentence on what was recovered"""


def read_bag(path: Path) -> Bag:
    """All messages of a bag. The files are only read, never touched.

    Raises:
        InputError: there is no bag, or it is empty, truncated, damaged or of another kind.
    """
    path = Path(path)
    files = _files(path)
    if (path / "metadata.yaml").exists():
        return _closed(path, path)
    bags = [_lone_file(path, file) for file in files]
    if len(bags) == 1:
        return bags[0]
    topics: dict[str, RawTopic] = {}
    for bag in bags:
        for name, topic in bag.topics.items():
            merged = topics.setdefault(name, RawTopic(name, topic.type, topic.definition))
            merged.log_times += topic.log_times
            merged.messages += topic.messages
    notes = [bag.recovered for bag in bags if bag.recovered]
    metadata = {key: value for bag in bags for key, value in bag.metadata.items()}
    return Bag(path, topics, metadata, " ".join(notes) or None)


def _files(path: Path) -> list[Path]:
    if not path.exists():
        raise InputError(f"{path}: no such bag. Expected {EXPECTED}.")
    if path.is_file():
        if path.name == "metadata.yaml":
            raise InputError(f"{path}: name the bag's folder, {path.parent}, not its metadata.yaml.")
        if path.suffix not in SUFFIXES:
            raise InputError(f"{path}: not a bag. Expected {EXPECTED}.")
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix in SUFFIXES)
    if not files and not (path / "metadata.yaml").exists():
        inside = sorted(file.parent.name for file in path.glob("*/metadata.yaml"))
        hint = f" It holds bags, name them one by one: {', '.join(inside)}." if inside else ""
        raise InputError(f"{path}: no bag in this folder. Expected {EXPECTED}.{hint}")
    return files


def _closed(path: Path, source: Path) -> Bag:
    try:
        with Reader(source) as reader:
            raws = {c.id: RawTopic(c.topic, c.msgtype, c.msgdef) for c in reader.connections}
            appends = {key: (raw.log_times.append, raw.messages.append) for key, raw in raws.items()}
            for connection, time, data in reader.messages():
                note_time, note_data = appends[connection.id]
                note_time(time)
                note_data(data)
            metadata = reader.storage.metadata
    except Exception as error:  # rosbags, apsw, zstd, lz4 and struct each raise classes of their own
        raise InputError(_damaged(path, error)) from error
    topics: dict[str, RawTopic] = {}
    for raw in raws.values():
        other = topics.setdefault(raw.name, raw)
        if other.type != raw.type:
            raise InputError(f"{path}: topic '{raw.name}' has two types, {other.type} and {raw.type}; expected one.")
        if other is not raw:
            topics[raw.name] = _merged(other, raw)
    if metadata.message_count and sum(len(raw.messages) for raw in topics.values()) < metadata.message_count:
        raise InputError(_damaged(path, f"metadata.yaml tells {metadata.message_count} messages, fewer are there"))
    return Bag(path, topics, {str(k): str(v) for k, v in (metadata.custom or {}).items()}, None)


def _merged(one: RawTopic, two: RawTopic) -> RawTopic:
    """Two publishers' messages on one topic, by log time."""
    pairs = sorted(
        zip(one.log_times + two.log_times, one.messages + two.messages, strict=True), key=lambda pair: pair[0]
    )
    return RawTopic(one.name, one.type, one.definition, [t for t, _ in pairs], [m for _, m in pairs])


def _damaged(path: Path, reason: object) -> str:
    return (
        f"{path}: not a whole bag ({reason}). Expected {EXPECTED}. If a recording was cut or damaged, "
        "`repair` may save what is whole into a new bag."
    )


def _lone_file(path: Path, file: Path) -> Bag:
    """A file without metadata.yaml beside it."""
    if file.suffix != ".mcap":
        return _closed(path, file)
    with file.open("rb") as stream:
        start = stream.read(len(MCAP_MAGIC))
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(MCAP_MAGIC)))
        closed = stream.read() == MCAP_MAGIC and size > 2 * len(MCAP_MAGIC)
    if not size:
        raise InputError(f"{path}: {file.name} is empty (0 bytes). Expected {EXPECTED}.")
    if start != MCAP_MAGIC:
        raise InputError(f"{path}: {file.name} is not an MCAP file. Expected {EXPECTED}.")
    if closed:
        return replace(_closed(path, file), metadata=head_metadata(file))
    return recovered(path, file)


def recovered(path: Path, file: Path) -> Bag:
    """What is whole in an MCAP file that was never closed or was damaged."""
    topics: dict[str, RawTopic] = {}
    metadata: dict[str, str] = {}
    for record in scan(file, metadata):
        raw = topics.setdefault(record.topic, RawTopic(record.topic, record.type, record.definition))
        raw.log_times.append(record.log_time)
        raw.messages.append(record.data)
    count = sum(len(raw.messages) for raw in topics.values())
    if not count:
        raise InputError(f"{path}: {file.name} was not closed properly and holds no whole chunk of messages.")
    topics = {name: _merged(raw, RawTopic(name, raw.type, raw.definition)) for name, raw in topics.items()}
    times = [time for raw in topics.values() for time in (raw.log_times[0], raw.log_times[-1])]
    note = (
        f"{file.name} was not closed properly; recovered {count} messages "
        f"up to {(max(times) - min(times)) * 1e-9:.2f} s after its first."
    )
    return Bag(path, topics, metadata, note)
