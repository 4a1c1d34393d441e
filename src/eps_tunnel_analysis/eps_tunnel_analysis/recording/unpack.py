# SPDX-License-Identifier: Apache-2.0
"""Decompression within bounds: what a few bytes claim to expand to is checked before any memory is allocated."""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard
from lz4.frame import LZ4FrameDecompressor

MOST_UNPACKED = 256 << 20  # bytes that the files of a bag, however small, may become
MOST_RATIO = 100  # and beyond that, times their size; streams of joint states reach 20
BLOCK_BYTES = 1 << 20  # bytes


class TooLargeError(ValueError):
    """More than a recording of this size can expand to."""


@dataclass
class Allowance:
    """Bytes that a bag may still expand to."""

    left: int

    @classmethod
    def of(cls, files: Iterable[Path]) -> "Allowance":
        return cls(max(MOST_UNPACKED, MOST_RATIO * sum(file.stat().st_size for file in files)))

    def take(self, size: int, what: str) -> None:
        """Raises TooLargeError where `size` bytes are more than is left."""
        if size > self.left:
            raise TooLargeError(f"{what} declares {size} bytes; {self.left} are left of what such a file may become")
        self.left -= size


def chunk_records(chunk: Any, allowance: Allowance) -> bytes:
    """The records in an MCAP chunk.

    Raises:
        TooLargeError: it declares more than is allowed.
        ValueError: it does not match its header, or fails its checksum.
        zstandard.ZstdError, RuntimeError: zstd's or lz4's complaint about torn data.
    """
    size = chunk.uncompressed_size
    allowance.take(size, "a chunk")
    if chunk.compression == "zstd":
        data = _zstd(chunk.data, size)
    elif chunk.compression == "lz4":
        lz4 = LZ4FrameDecompressor()
        data = lz4.decompress(chunk.data, max_length=size + 1)
        if not lz4.eof or lz4.unused_data:
            raise ValueError("a chunk is not the lz4 frame that it declares")
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"the compression '{chunk.compression}' of a chunk is not zstd, lz4 or none")
    if len(data) != size:
        raise ValueError(f"a chunk declares {size} bytes and holds {len(data)}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk fails its checksum")
    return bytes(data)


def message_data(data: bytes, allowance: Allowance) -> bytes:
    """What a message that was compressed by itself holds; raises as `chunk_records` does."""
    size = zstandard.frame_content_size(data)
    if size < 0:
        raise ValueError("a compressed message does not declare its size")
    allowance.take(size, "a message")
    return _zstd(data, size)


def _zstd(data: bytes, size: int) -> bytes:
    declared = zstandard.frame_content_size(data)
    if declared not in (-1, size):  # -1: the frame does not say
        raise TooLargeError(f"a zstd frame declares {declared} bytes where {size} are expected")
    # Frames behind the first would be read by others as more of the same.
    return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size, allow_extra_data=False))


def check_file(file: Path, allowance: Allowance) -> None:
    """Raises TooLargeError where a file that was compressed as a whole expands to more than is allowed."""
    with file.open("rb") as stream, zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True) as rest:
        while block := rest.read(BLOCK_BYTES):
            allowance.take(len(block), f"{file.name} becomes more: a part that")
