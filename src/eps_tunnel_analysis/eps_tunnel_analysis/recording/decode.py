# SPDX-License-Identifier: Apache-2.0
"""From a bag on disk to a Recording: serialised messages to columns of numbers, trial marks, stamps that are checked.

Lengths of strings and sequences shift everything after them. In a topic of a running rig they never change, so the
layout of the first message applies to all, and all messages together are one numpy array of records. Whether the
lengths and strings are indeed the same in every message is checked; if not, it is decoded message by message.

Encoding: OMG Common Data Representation as ROS 2 uses it (XCDR1): a header of 4 bytes, then each primitive aligned to
its own size, counted from behind the header; a string is its length with the closing zero (uint32) and its bytes; a
sequence is its length (uint32) and its elements.
"""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from eps_tunnel_analysis.recording.bag import Bag, RawTopic, read_bag
from eps_tunnel_analysis.recording.recording import (
    TIME_SOURCES,
    Column,
    Nanoseconds,
    Phase,
    Recording,
    StampedTopic,
    TimeSource,
    TrialMark,
)
from labyrinth_sim.errors import Complaints, InputError, unknown_name

JOINT_STATE = "sensor_msgs/msg/JointState"
BALL_STATE = "labyrinth_msgs/msg/BallState"
BALL_EVENT = "labyrinth_msgs/msg/BallEvent"
TRIAL = "labyrinth_msgs/msg/Trial"
READABLE = (JOINT_STATE, BALL_STATE, BALL_EVENT, TRIAL)
SAMPLED = (JOINT_STATE, BALL_STATE)
"""Measured or sent in a steady rhythm, so no two messages share a stamp; events may"""
CDR_HEADER = 4
LITTLE_ENDIAN = b"\x00\x01"
CDR_FORMATS = {
    **{name: "<" + code for name, code in (("float64", "f8"), ("float32", "f4"), ("bool", "u1"), ("byte", "u1"))},
    **{f"{sign}int{8 * size}": f"<{code}{size}" for sign, code in (("", "i"), ("u", "u")) for size in (1, 2, 4, 8)},
    "char": "<u1",
    "octet": "<u1",
}
JOINT_FIELDS = ("position", "velocity", "effort")
LONGEST_DEFINITION = 1 << 17
"""characters of a message definition with all that it uses"""
MOST_LINES = 5000
"""of one; rosbags' parser takes time with their square"""
MOST_FIELDS = 2000
"""of a message, those of the messages in it included"""
LONGEST_SEQUENCE = 1_000_000
"""elements in a field of a message"""


def labyrinth_definitions() -> Iterator[tuple[str, str]]:
    """(type name, definition) of labyrinth_msgs, from the sourced workspace or, failing that, this source tree."""
    prefixes = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for root in (*prefixes, *Path(__file__).resolve().parents[3:5]):
        files = sorted((root / "labyrinth_msgs" / "msg").glob("*.msg"))
        if files:
            yield from ((f"labyrinth_msgs/msg/{file.stem}", file.read_text(encoding="utf-8")) for file in files)
            return


def typestore(definitions: Iterable[tuple[str, MessageDefinition]] = ()) -> Typestore:
    """ROS 2's own types, then those that a bag defines itself, then those of labyrinth_msgs where still unknown.

    Raises:
        TypesysError: a definition cannot be read.
    """
    store = get_typestore(Stores.ROS2_KILTED)
    store.max_sequence_length = LONGEST_SEQUENCE
    own = [(name, MessageDefinition(MessageDefinitionFormat.MSG, text)) for name, text in labyrinth_definitions()]
    for name, definition in (*definitions, *own):
        if name not in store.fielddefs and definition.format != MessageDefinitionFormat.NONE:
            register(store, name, definition)
    return store


@lru_cache(maxsize=16)
def _shared(definitions: tuple[tuple[str, MessageDefinition], ...]) -> Typestore:
    """The typestore of all bags with these definitions, for whoever only reads."""
    return typestore(definitions)


def register(store: Typestore, name: str, definition: MessageDefinition) -> None:
    """Adds a type and those it uses, unless the store has them.

    Raises:
        TypesysError: the definition cannot be read, lacks a type, is recursive or much too large.
    """
    length, lines = len(definition.data), definition.data.count("\n")
    if length > LONGEST_DEFINITION or lines > MOST_LINES:
        raise TypesysError(
            f"{name}: {length} characters in {lines} lines; expected at most {LONGEST_DEFINITION} in {MOST_LINES}"
        )
    try:
        if definition.format == MessageDefinitionFormat.MSG:
            types = get_types_from_msg(definition.data, name)
        else:
            types = get_types_from_idl(definition.data)
        new = {key: value for key, value in types.items() if key not in store.fielddefs}
        _check_nesting(name, {**store.fielddefs, **new})
        store.register(new)
    except TypesysError:
        raise
    except Exception as error:  # of rosbags' parser, and of the code that it makes of a definition
        raise TypesysError(f"{name}: {error or type(error).__name__}") from error


def _check_nesting(name: str, types: Mapping[str, Any]) -> None:
    """Raises TypesysError for a type that contains itself, or has more fields than any recorder writes."""
    sizes: dict[str, int] = {}

    def size(typename: str, outer: tuple[str, ...]) -> int:
        if typename in outer:
            raise TypesysError(f"{typename} contains itself")
        if typename not in types:
            raise TypesysError(f"the type {typename}, used in {outer[-1] if outer else 'a topic'}, is not defined")
        if typename not in sizes:
            sizes[typename] = sum(field_size(detail, (*outer, typename)) for _, detail in types[typename][1])
            if sizes[typename] > MOST_FIELDS:
                raise TypesysError(f"{typename} has {sizes[typename]} fields; expected at most {MOST_FIELDS}")
        return sizes[typename]

    def field_size(described: Any, outer: tuple[str, ...]) -> int:
        kind, detail = described
        if kind == Nodetype.NAME:
            return size(detail, outer)
        if kind == Nodetype.BASE or detail[0][0] != Nodetype.NAME:
            return 1
        count = detail[1] if kind == Nodetype.ARRAY else 1
        return count * size(detail[0][1], outer)

    size(name, ())


@dataclass
class Layout:
    """Where the fields are in every message of a topic.

    Attributes:
        length: bytes of a message.
        numbers: field path -> (numpy format, shape, offset in bytes).
        strings: field path -> the string, or the list of strings.
        fixed: (length,) True for the bytes that hold lengths and strings.
    """

    length: int
    numbers: dict[str, tuple[str, tuple[int, ...], int]] = field(default_factory=dict)
    strings: dict[str, Any] = field(default_factory=dict)
    fixed: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))


class _Walk:
    """Reads one message along its definition and notes where each field is."""

    def __init__(self, raw: bytes, store: Typestore) -> None:
        self.raw, self.store, self.at = raw, store, CDR_HEADER
        self.layout = Layout(len(raw), fixed=np.zeros(len(raw), dtype=np.bool_))
        self.layout.fixed[:CDR_HEADER] = True

    def message(self, typename: str, prefix: str = "") -> None:
        for name, (kind, detail) in self.store.get_msgdef(typename).fields:
            self.field(prefix + name, kind, detail)

    def field(self, path: str, kind: Nodetype, detail: Any) -> None:
        if kind == Nodetype.NAME:
            self.message(detail, path + ".")
        elif kind == Nodetype.BASE:
            self.base(path, detail[0])
        else:
            (element_kind, element), count = detail
            if kind == Nodetype.SEQUENCE:
                count = self.number()
            if element_kind == Nodetype.NAME:
                raise _NoLayoutError
            if element[0] == "string":
                self.layout.strings[path] = [self.string() for _ in range(count)]
            else:
                self.primitive(path, element[0], (count,))

    def base(self, path: str, name: str) -> None:
        if name == "string":
            self.layout.strings[path] = self.string()
        else:
            self.primitive(path, name, ())

    def primitive(self, path: str, name: str, shape: tuple[int, ...]) -> None:
        if name not in CDR_FORMATS:
            raise _NoLayoutError
        size, count = np.dtype(CDR_FORMATS[name]).itemsize, int(np.prod(shape))
        if count:
            self.align(size)
        self.layout.numbers[path] = (CDR_FORMATS[name], shape, self.at)
        self.at += size * count

    def align(self, size: int) -> None:
        self.at += -(self.at - CDR_HEADER) % size

    def number(self) -> int:
        self.align(4)
        return int.from_bytes(self.take(4), "little")

    def string(self) -> str:
        return self.take(self.number())[:-1].decode()

    def take(self, size: int) -> bytes:
        if self.at + size > len(self.raw):
            raise _NoLayoutError
        self.layout.fixed[self.at : self.at + size] = True
        self.at += size
        return self.raw[self.at - size : self.at]


class _NoLayoutError(Exception):
    """This type or message cannot be described by one constant layout."""


def layout_of(raw: bytes, typename: str, store: Typestore) -> Layout | None:
    """The layout of one message; None if this file cannot describe it."""
    walk = _Walk(raw, store)
    try:
        if raw[:2] != LITTLE_ENDIAN:
            return None
        walk.message(typename)
    except (_NoLayoutError, UnicodeDecodeError):
        return None
    # Some writers pad the end to a multiple of 4; anything beyond that is not the message that the type describes.
    return walk.layout if 0 <= len(raw) - walk.at < 4 else None


def decode_constant(
    raws: Sequence[bytes], typename: str, store: Typestore
) -> tuple[Mapping[str, NDArray[Any]], Mapping[str, Any]] | None:
    """All messages at once: numbers by field path, (n,) or (n, k), and the strings that they all share.

    None when lengths or strings differ between messages, or the type has no constant layout.
    """
    layout = layout_of(raws[0], typename, store)
    if layout is None:
        return None
    joined = b"".join(raws)
    if len(joined) != len(raws) * layout.length or set(map(len, raws)) != {layout.length}:
        return None
    matrix = np.frombuffer(joined, dtype=np.uint8).reshape(len(raws), layout.length)
    fixed = np.flatnonzero(layout.fixed)
    if (matrix[:, fixed] != matrix[0, fixed]).any():
        return None
    records = np.frombuffer(
        joined,
        dtype=np.dtype(
            {
                "names": list(layout.numbers),
                "formats": [(code, shape) for code, shape, _ in layout.numbers.values()],
                "offsets": [offset for _, _, offset in layout.numbers.values()],
                "itemsize": layout.length,
            }
        ),
    )
    return {name: records[name] for name in layout.numbers}, layout.strings


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
    if raw.type == BALL_STATE and (stamps is None or not {"visible", "x", "y"} <= columns.keys()):
        raise InputError(
            f"{path}: topic '{raw.name}': the bag's own definition of {raw.type} lacks a field; expected a header, "
            "visible, x and y."
        )
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


def read(path: Path | str, time_source: TimeSource = "header") -> Recording:
    """One bag: a rosbag2 folder, or a single .mcap, .db3 or .bag file; only read, never changed.

    Args:
        path: the bag. One whose recorder was killed is read up to its last complete chunk.
        time_source: "header", the stamp set where the value was measured, or "log", when the recorder received it.

    Raises:
        InputError: no bag, an empty, truncated or foreign one, messages that do not match their type, stamps
            that are missing or run backwards or come twice. All complaints at once.
    """
    path = Path(path)
    if time_source not in TIME_SOURCES:
        raise InputError(unknown_name("time source", time_source, TIME_SOURCES))
    bag = read_bag(path)
    if not any(raw.messages for raw in bag.topics.values()):
        raise InputError(f"{path}: the bag holds no messages. Expected a recording of a rig or a simulation.")
    try:
        store = _shared(tuple((raw.type, raw.definition) for raw in bag.topics.values() if raw.type in READABLE))
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
    """`read` each of several bags. Raises InputError if none is named, or with all complaints at once."""
    if not paths:
        raise InputError("No bags named; expected at least one rosbag2 folder, .mcap, .db3 or .bag file.")
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
