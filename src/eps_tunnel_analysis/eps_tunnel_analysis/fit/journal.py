# SPDX-License-Identifier: Apache-2.0
"""Checkpoint of a fit: every answer of the simulator, in the order asked.

A method is a deterministic function of its seed and of the answers it gets. So a run that broke off is resumed by
running it anew and answering from the journal until that is used up: the same answer as an unbroken run, for every
method alike.
"""

import hashlib
import struct
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np

from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

_MAGIC = b"epsfit01"
_HEAD = struct.Struct("<16sqq")  # digest of the question, rows and columns of the answer


def _digest(question: Array) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(question).tobytes(), digest_size=16).digest()


class Journal:
    """Append-only file of answers. A record cut short by a crash is dropped at the next opening.

    Args:
        path: the file; made if absent.
        identity: what the run is (method, seed, problem); a journal of another run is refused.
    """

    def __init__(self, path: Path, identity: str) -> None:
        self.path = path
        head = _MAGIC + hashlib.blake2b(identity.encode(), digest_size=16).digest()
        self._answers: list[tuple[bytes, Array]] = []
        self._next = 0
        whole = len(head)
        if path.exists():
            raw = path.read_bytes()
            if raw[: len(head)] != head:
                raise InputError(
                    f"{path} is a checkpoint of another run (other data, model, method or seed). "
                    "Name another file, or call with the same arguments as the run to resume."
                )
            whole = self._load(raw, len(head))
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(head)
        self._file: BinaryIO = path.open("r+b")
        self._file.truncate(whole)
        self._file.seek(whole)

    def _load(self, raw: bytes, at: int) -> int:
        while at + _HEAD.size <= len(raw):
            digest, rows, columns = _HEAD.unpack_from(raw, at)
            end = at + _HEAD.size + 8 * rows * columns
            if end > len(raw):
                break
            answer = np.frombuffer(raw, dtype="<f8", count=rows * columns, offset=at + _HEAD.size)
            self._answers.append((digest, answer.reshape(rows, columns)))
            at = end
        return at

    def recall(self, question: Array) -> Array | None:
        """The recorded answer to the next question, or None when the journal is used up."""
        if self._next >= len(self._answers):
            return None
        digest, answer = self._answers[self._next]
        if digest != _digest(question):
            raise InputError(f"{self.path} does not match this run from evaluation {self._next} on; start without it.")
        self._next += 1
        return answer

    def add(self, question: Array, answer: Array) -> None:
        """Append an answer (n, R) and hand it to the operating system."""
        data = np.ascontiguousarray(answer, dtype="<f8")
        self._file.write(_HEAD.pack(_digest(question), *data.shape) + data.tobytes())
        self._file.flush()

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
