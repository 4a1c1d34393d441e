# SPDX-License-Identifier: Apache-2.0
"""Serialised messages (CDR) of one constant layout, decoded as one array.

Lengths of strings and sequences move everything behind them. In a topic of a running rig they never change, so the
layout of the first message holds for all, and all messages together are one numpy array of records. Whether the
lengths and strings are indeed the same in every message is checked; if not, the caller decodes message by message.

Encoding: OMG Common Data Representation as ROS 2 uses it (XCDR1): a header of 4 bytes, then each primitive aligned to
its own size, counted from behind the header; a string is its length with the closing zero (uint32) and its bytes; a
sequence is its length (uint32) and its elements.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

HEADER = 4
LITTLE_ENDIAN = b"\x00\x01"
FORMATS = {
    **{name: "<" + code for name, code in (("float64", "f8"), ("float32", "f4"), ("bool", "u1"), ("byte", "u1"))},
    **{f"{sign}int{8 * size}": f"<{code}{size}" for sign, code in (("", "i"), ("u", "u")) for size in (1, 2, 4, 8)},
    "char": "<u1",
    "octet": "<u1",
}


@dataclass
class Layout:
    """Where things lie in every message of a topic.

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
    """Reads one message along its definition and notes where each field lies."""

    def __init__(self, raw: bytes, store: Typestore) -> None:
        self.raw, self.store, self.at = raw, store, HEADER
        self.layout = Layout(len(raw), fixed=np.zeros(len(raw), dtype=np.bool_))
        self.layout.fixed[:HEADER] = True

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
        if name not in FORMATS:
            raise _NoLayoutError
        size, count = np.dtype(FORMATS[name]).itemsize, int(np.prod(shape))
        if count:
            self.align(size)
        self.layout.numbers[path] = (FORMATS[name], shape, self.at)
        self.at += size * count

    def align(self, size: int) -> None:
        self.at += -(self.at - HEADER) % size

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
    """The layout of one message; None where it has none that this file can describe."""
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

    None when lengths or strings differ between messages, or the type holds what has no constant layout.
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
