# SPDX-License-Identifier: Apache-2.0
"""Bag: the serialised messages of a rosbag2 recording, by topic, as they lie on disk.

A folder with metadata.yaml was closed by its recorder and must be whole. A folder without it was never closed (the
recorder was killed), and so is a lone .mcap file without a footer: those are read up to their last whole chunk.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.storage_mcap import McapReader

from eps_tunnel_analysis.recording.mcap_file import MAGIC, RawTopic, TwoTypesError, read_mcap
from labyrinth_sim.errors import InputError

SUFFIXES = (".mcap", ".db3")
EXPECTED = "a rosbag2 folder (with metadata.yaml) or a single .mcap or .db3 file of ROS 2 messages"


@dataclass(frozen=True)
class Bag:
    """Everything in one bag, still serialised; messages of each topic in log-time order."""

    path: Path
    topics: Mapping[str, RawTopic]
    metadata: Mapping[str, str]
    recovered: str | None
    """None for a bag that was closed properly, else one sentence on what was recovered"""

    @property
    def count(self) -> int:
        """Messages in the bag."""
        return sum(len(topic.messages) for topic in self.topics.values())


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
    notes = [bag.recovered for bag in bags if bag.recovered]
    metadata = {key: value for bag in bags for key, value in bag.metadata.items()}
    return Bag(path, _merged(path, (bag.topics for bag in bags)), metadata, " ".join(notes) or None)


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
    """A bag that must be whole. rosbags judges index and metadata; it also reads all that is not plain MCAP."""
    try:
        with Reader(source) as reader:
            told: Any = reader.storage.metadata
            storages: Any = getattr(reader.storage, "storages", [reader.storage])
            if told.compression_mode != "message" and all(isinstance(s, McapReader) for s in storages):
                found = [read_mcap(storage.path) for storage in storages]
                if not all(file.complete for file in found):
                    raise ValueError("a chunk is torn")
                topics = _merged(path, (file.topics for file in found))
                metadata = {key: value for file in found for key, value in file.metadata.items()}
            else:
                topics, metadata = _iterated(reader), {}
            for c in reader.connections:  # topics without a message stand in the index alone
                topics.setdefault(c.topic, RawTopic(c.topic, c.msgtype, c.msgdef))
            metadata |= {str(key): str(value) for key, value in (told.custom or {}).items()}
    except InputError:
        raise
    except TwoTypesError as error:
        raise InputError(f"{path}: {error}.") from error
    except Exception as error:  # rosbags, apsw, zstd, lz4 and struct each raise classes of their own
        raise InputError(_damaged(path, error)) from error
    bag = Bag(path, topics, metadata, None)
    if bag.count < told.message_count:
        raise InputError(_damaged(path, f"{bag.count} messages, but its metadata tells {told.message_count}"))
    return bag


def _iterated(reader: Reader) -> dict[str, RawTopic]:
    topics: dict[str, RawTopic] = {}
    for connection in reader.connections:
        topic = topics.setdefault(connection.topic, RawTopic(connection.topic, connection.msgtype, connection.msgdef))
        if topic.type != connection.msgtype:
            raise TwoTypesError(f"topic '{topic.name}' has two types, {topic.type} and {connection.msgtype}")
    for connection, log_time, data in reader.messages():
        topic = topics[connection.topic]
        topic.log_times.append(log_time)
        topic.messages.append(data)
    return topics


def _merged(path: Path, parts: Iterable[Mapping[str, RawTopic]]) -> dict[str, RawTopic]:
    """The topics of a bag's files, each in log-time order: chunks and publishers may overlap."""
    topics: dict[str, RawTopic] = {}
    for part in parts:
        for name, raw in part.items():
            topic = topics.setdefault(name, raw)
            if topic.type != raw.type:
                raise InputError(f"{path}: topic '{name}' has two types, {topic.type} and {raw.type}; expected one.")
            if topic is not raw:
                topic.log_times += raw.log_times
                topic.messages += raw.messages
    for topic in topics.values():
        times = topic.log_times
        if any(later < earlier for earlier, later in pairwise(times)):
            order = sorted(range(len(times)), key=times.__getitem__)
            topic.log_times = [times[i] for i in order]
            topic.messages = [topic.messages[i] for i in order]
    return topics


def _damaged(path: Path, reason: object) -> str:
    return (
        f"{path}: not a whole bag ({reason}). Expected {EXPECTED}. If a recording was cut or damaged, "
        "`eps-tunnel repair BAG --out NEW` may save what is whole into a new bag."
    )


def _lone_file(path: Path, file: Path) -> Bag:
    """A file without metadata.yaml beside it."""
    if file.suffix != ".mcap":
        return _closed(path, file)
    size = file.stat().st_size
    if not size:
        raise InputError(f"{path}: {file.name} is empty (0 bytes). Expected {EXPECTED}.")
    with file.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise InputError(f"{path}: {file.name} is not an MCAP file. Expected {EXPECTED}.")
        stream.seek(max(len(MAGIC), size - len(MAGIC)))
        closed = stream.read() == MAGIC
    return _closed(path, file) if closed else recovered(path, file)


def recovered(path: Path, file: Path) -> Bag:
    """What is whole in an MCAP file that was never closed or was damaged.

    Raises:
        InputError: nothing is.
    """
    try:
        found = read_mcap(file)
    except TwoTypesError as error:
        raise InputError(f"{path}: {error}.") from error
    bag = Bag(path, _merged(path, [found.topics]), found.metadata, None)
    times = [time for raw in bag.topics.values() if raw.log_times for time in (raw.log_times[0], raw.log_times[-1])]
    if not times:
        raise InputError(f"{path}: {file.name} was not closed properly and holds no whole chunk of messages.")
    note = (
        f"{file.name} was not closed properly; recovered {bag.count} messages "
        f"up to {(max(times) - min(times)) * 1e-9:.2f} s after its first."
    )
    return Bag(path, bag.topics, bag.metadata, note)
