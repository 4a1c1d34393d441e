# SPDX-License-Identifier: Apache-2.0
"""The layer between an optimiser and the simulator: counts evaluations, keeps a journal, remembers the best.

A method is a deterministic function of its seed and of the answers it gets. So an interrupted run is resumed by
running it again and answering from the journal until that is used up: the result is that of an uninterrupted run, for
every method.
"""

import hashlib
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np

from eps_tunnel_analysis.fit.differences import jacobian, moved
from eps_tunnel_analysis.fit.problem import Problem
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

_MAGIC = b"epsfit02"
_HEAD = struct.Struct("<16sqq")  # digest of the question, rows and columns of the answer
_SUM = struct.Struct("<I")  # CRC-32 of a record's head and data, behind them


def _digest(question: Array) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(question).tobytes(), digest_size=16).digest()


class Journal:
    """Checkpoint of a fit: an append-only file of the simulator's answers, in the order asked.

    A record cut short or torn by a crash is dropped at the next opening, with everything after it.

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
        raw = path.read_bytes() if path.exists() else b""
        if not head.startswith(raw):  # a shorter one was interrupted before its first answer
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
        while at + _HEAD.size + _SUM.size <= len(raw):
            digest, rows, columns = _HEAD.unpack_from(raw, at)
            end = at + _HEAD.size + 8 * rows * columns
            if rows < 1 or columns < 1 or end + _SUM.size > len(raw):
                break
            if _SUM.unpack_from(raw, end)[0] != zlib.crc32(raw[at:end]):
                break
            answer = np.frombuffer(raw, dtype="<f8", count=rows * columns, offset=at + _HEAD.size).astype(np.float64)
            self._answers.append((digest, answer.reshape(rows, columns)))
            at = end + _SUM.size
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
        record = _HEAD.pack(_digest(question), *data.shape) + data.tobytes()
        self._file.write(record + _SUM.pack(zlib.crc32(record)))
        self._file.flush()

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


#: Called after each batch with (evaluations so far, best fitness so far). May raise KeyboardInterrupt to stop the fit.
FitProgress = Callable[[int, float], None]


class BudgetSpent(Exception):
    """No more evaluations are allowed; the best so far is the answer."""


@dataclass(frozen=True)
class Improvement:
    """Best fitness after so many evaluations."""

    evaluations: int
    fitness: float


class Evaluations:
    """Evaluates batches of normalised values, and keeps the records that every method needs.

    Attributes:
        count: roll-out sets evaluated so far (one per parameter set; all commands count as one, as in the paper).
        best: (k,) normalised values of the best so far; the start until something was evaluated.
        best_fitness: its fitness.
        history: where the best improved.
        journal: remembers answers from run to run.
        progress: called after each batch.
        limit: evaluations after which the next batch raises BudgetSpent; None for no limit.
    """

    def __init__(
        self,
        problem: Problem,
        journal: Journal | None = None,
        progress: FitProgress | None = None,
        limit: int | None = None,
    ) -> None:
        self.problem = problem
        self.limit = limit
        self.count = 0
        self.best: Array = problem.to_unit(problem.start)
        self.best_fitness = float("inf")
        self.history: list[Improvement] = []
        self.journal = journal
        self.progress = progress

    def residuals(self, z: Array) -> Array:
        """(n, k) normalised values to (n, R) residuals; diverged roll-outs are rows of NaN."""
        question = np.clip(np.atleast_2d(z), 0.0, 1.0)

        def answer() -> Array:
            return self.problem.residuals(self.problem.from_unit(question))

        return self._ask(question, answer, self.problem.fitness)

    def fitness(self, z: Array) -> Array:
        """(n, k) normalised values to (n,) fitness. Journals one number per row instead of R."""
        question = np.clip(np.atleast_2d(z), 0.0, 1.0)

        def answer() -> Array:
            values = self.problem.residuals(self.problem.from_unit(question))
            return np.asarray(self.problem.fitness(values))[:, None]

        return self._ask(question, answer, lambda column: column[:, 0])[:, 0]

    def around(self, z: Array, step: float) -> tuple[Array, Array]:
        """Residuals (R,) at z (k,) and their slopes (R, k) by finite differences, in the fitness's scaling."""
        points, steps = moved(z, step)
        answers = self.problem.fitness.scaled(self.residuals(np.vstack([z, points])))
        here = np.nan_to_num(answers[0])
        return here, jacobian(here, answers[1:], steps)

    def _ask(self, question: Array, answer: Callable[[], Array], fitness: Callable[[Array], Array]) -> Array:
        if self.limit is not None and self.count >= self.limit:
            raise BudgetSpent
        result = self.journal.recall(question) if self.journal else None
        if result is None:
            # In the memory order of a recalled one: sums in another order differ in the last bit.
            result = np.ascontiguousarray(answer(), dtype=np.float64)
            if self.journal:
                self.journal.add(question, result)
        self._note(question, fitness(result))
        return result

    def _note(self, question: Array, fitness: Array) -> None:
        self.count += len(question)
        winner = int(np.argmin(fitness))
        if fitness[winner] < self.best_fitness:
            self.best_fitness = float(fitness[winner])
            self.best = question[winner].copy()
            self.history.append(Improvement(self.count, self.best_fitness))
        if self.progress:
            self.progress(self.count, self.best_fitness)
