# SPDX-License-Identifier: Apache-2.0
"""Everything that the page shows, with its changes; written by one thread, read by another."""

import math
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.monitor.parts import (
    Before,
    GapPart,
    Health,
    Log,
    Part,
    Past,
    Staircase,
    StaircaseStep,
    WhatIfPart,
)
from eps_tunnel_analysis.outputs import plain
from labyrinth_sim.trials import Array

ROW_STEP = 0.01  # s between two rows
BRIDGED = 10  # rows; a longer gap between two samples stays as it was
LONGEST_SHOWN = 600.0  # s of a command that is shown
MEAN, LOWER, UPPER, SIMULATED, BEFORE = range(5)
NOT_SEEN, OUTSIDE, INSIDE, COLLECTING = -1, 0, 1, 2
TUNNEL_TRIALS = 2  # real trials from which a tunnel has a width
PAST = 20  # trials that can be looked at again
WINDOW = 10.0  # s over which samples that came late or were lost are counted
DIGITS = 6  # decimals that are sent; a microradian is finer than any screen
LOG_LENGTH = 30  # entries of the log
FIRST = "as given"
BY_HAND = "loaded by hand"


class TunnelTable:
    """One row per ROW_STEP of the command.

    A row holds mean, lower and upper limit of reality, the simulation, that of the previous model, and whether the
    simulation is inside; COLLECTING while there is only one real trial, whose tunnel has no width.

    Attributes:
        revision: number that rows written from now on get.
        trials: how many real trials form the tunnel, as far as it is known.
    """

    def __init__(self) -> None:
        self.revision = 0
        self.trials = 0
        self._written = False
        self._began = 0
        self._key, self._signals, self._duration = "", tuple[str, ...](), 0.0
        self._values: Array = np.empty((0, 0, 5))
        self._alike: NDArray[np.int8] = np.empty((0, 0), dtype=np.int8)
        self._changed: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._last = -1

    def start(self, key: str, duration: float) -> None:
        """A trial of a command begins: `key` identifies the command, `duration` in s, 0 if it is not valid."""
        self._last, self._written = -1, False
        duration = duration if 0 < duration <= LONGEST_SHOWN else 0.0
        if key != self._key:
            self._key, self._duration, self.trials = key, duration, 0
            self._clear(())

    def add(
        self, time: float, signals: Sequence[str], mean: Array, lower: Array, upper: Array, simulated: Array,
        alike: Sequence[bool],
    ) -> None:  # fmt: skip
        """One sample at `time` s into the trial; lower and upper are deviations from the mean."""
        if not 0 <= time <= LONGEST_SHOWN:
            return
        if tuple(signals) != self._signals:
            self._clear(tuple(signals))
        self._written = True
        row = round(time / ROW_STEP)
        self._grow(row + 1)
        new = self._values[row].copy()
        new[:, MEAN], new[:, LOWER], new[:, UPPER], new[:, SIMULATED] = mean, mean + lower, mean + upper, simulated
        judged = np.asarray(alike, dtype=np.int8) if self.trials >= TUNNEL_TRIALS else COLLECTING
        inside = np.where(np.isfinite(new[:, :BEFORE]).all(axis=1), judged, NOT_SEEN)
        first = self._last + 1 if 0 <= self._last < row <= self._last + BRIDGED else row
        if first < row:  # rows between this sample and the one before
            share = (np.arange(first, row) - self._last) / (row - self._last)
            old = self._values[self._last]
            between = old + share[:, None, None] * (new - old)
            self._values[first:row, :, :BEFORE] = between[:, :, :BEFORE]
            self._alike[first:row] = inside
        self._values[row, :, :BEFORE] = new[:, :BEFORE]
        self._alike[row] = inside
        self._changed[first : row + 1] = self.revision
        self._last = row

    def new_model(self) -> None:
        """The simulation runs another model: its results so far are kept for comparison."""
        self._values[:, :, BEFORE] = self._values[:, :, SIMULATED]
        self._values[:, :, SIMULATED] = np.nan
        self._alike[:] = NOT_SEEN
        self._changed[:] = self.revision

    @property
    def written(self) -> bool:
        """Whether the latest trial has written rows."""
        return self._written

    def changes(self, seen: int) -> dict[str, Any] | None:
        """Rows written after revision `seen`; None where there are none.

        rows: [row, [mean, lower, upper, simulated, before, inside] of each signal], None where unknown; inside is -1
        where a value is missing, 2 where one trial alone was there. `whole` says that all earlier rows are gone.
        """
        rows = np.flatnonzero(self._changed > seen)
        whole = self._began > seen
        if not len(rows) and not whole:
            return None
        rows_now = table_rows(rows, self._values, self._alike)
        return {
            "key": self._key, "signals": list(self._signals), "step": ROW_STEP, "duration": self._duration,
            "whole": whole, "rows": rows_now,
        }  # fmt: skip

    def _clear(self, signals: tuple[str, ...]) -> None:
        self._signals, self._began, self._last = signals, self.revision, -1
        self._values = np.empty((0, len(signals), 5))
        self._alike = np.empty((0, len(signals)), dtype=np.int8)
        self._changed = np.empty(0, dtype=np.int64)
        self._grow(round(self._duration / ROW_STEP) + 1)

    def _grow(self, rows: int) -> None:
        more = rows - len(self._changed)
        if more > 0:
            shape = (more, len(self._signals))
            self._values = np.concatenate([self._values, np.full((*shape, 5), np.nan)])
            self._alike = np.concatenate([self._alike, np.full(shape, NOT_SEEN, dtype=np.int8)])
            self._changed = np.concatenate([self._changed, np.full(more, -1, dtype=np.int64)])


def table_rows(rows: Iterable[int], values: Array, inside: NDArray[np.int8]) -> list[list[Any]]:
    """[row, [mean, lower, upper, simulated, before, inside] of each signal] of some rows.

    Args:
        values: (T, m, 5) in the order above, SI units; NaN becomes None.
        inside: (T, m), NOT_SEEN, OUTSIDE, INSIDE or COLLECTING.
    """
    signals = range(values.shape[1])
    return [[int(row), *([*_rounded(values[row, s]), int(inside[row, s])] for s in signals)] for row in rows]


def _rounded(values: Array) -> list[float | None]:
    return [round(value, DIGITS) if math.isfinite(value) else None for value in values.tolist()]


class State:
    """The newest part of each kind, and the tunnel table; every change gets a number greater than all before."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._parts: dict[str, tuple[int, Part]] = {}
        self._table = TunnelTable()
        self._revision = 0
        self._past: dict[int, dict[str, Any]] = {}
        self._what_if: dict[str, Any] | None = None

    def put(self, part: Part) -> None:
        """Replaces the part of this kind; an equal one is no change."""
        with self._lock:
            self._put(part)

    def note(self, text: str, level: str = "info") -> None:
        """Adds an entry to the log; level "error" is for what the user should see at once."""
        with self._lock:
            known = self._parts.get("log")
            entries = known[1].entries if known is not None and isinstance(known[1], Log) else ()
            number = entries[-1][0] + 1 if entries else 0
            self._put(Log((*entries, (number, time.time(), level, text))[-LOG_LENGTH:]))

    def trial(self, key: str, duration: float) -> None:
        """A trial of a command begins, as `TunnelTable.start`; the previous one can be looked at again."""
        with self.tunnel() as table:
            whole = table.changes(-1) if table.written else None
            if whole and whole["rows"]:
                known = self._parts.get("past")
                kept = known[1].trials if known is not None and isinstance(known[1], Past) else ()
                number = kept[-1][0] + 1 if kept else 1
                self._past[number] = whole
                kept = (*kept, (number, time.time()))[-PAST:]
                self._past = {n: self._past[n] for n, _ in kept}
                self._put(Past(kept))
            table.start(key, duration)

    def past(self, number: int) -> dict[str, Any] | None:
        """The tunnel table as it was at the end of a trial; None where it is not kept."""
        with self._lock:
            return self._past.get(number)

    def show_what_if(self, part: WhatIfPart, table: dict[str, Any] | None) -> None:
        """Shows an answer; `table` holds its trajectories in the format of `TunnelTable.changes`, and its "number"."""
        with self._lock:
            self._what_if = table
            self._put(part)

    def what_if(self) -> dict[str, Any] | None:
        """The trajectories of the answer that is shown; None where there is none."""
        with self._lock:
            return self._what_if

    def tunnel(self) -> "_Locked":
        """The tunnel table, to be used in a `with` statement."""
        return _Locked(self)

    def changes(self, seen: int) -> tuple[dict[str, Any], int]:
        """What changed after revision `seen` as plain values, NaN as None, and the revision now. All, from -1."""
        with self._lock:
            content: dict[str, Any] = {
                key: plain(asdict(part)) for key, (revision, part) in self._parts.items() if revision > seen
            }
            table = self._table.changes(seen)
            if table:
                content["tunnel"] = table
            return content, self._revision

    def _put(self, part: Part) -> None:
        key = type(part).__name__.removesuffix("Part").lower()
        known = self._parts.get(key)
        if known is None or known[1] != part:
            self._revision += 1
            self._parts[key] = (self._revision, part)


class _Locked:
    """Gives exclusive access to the table, and numbers the change."""

    def __init__(self, state: State) -> None:
        self._state = state

    def __enter__(self) -> TunnelTable:
        self._state._lock.acquire()
        self._state._revision += 1
        self._state._table.revision = self._state._revision
        return self._state._table

    def __exit__(self, *_: object) -> None:
        self._state._lock.release()


class RecentHealth:
    """Recent problems with the samples; a bad start does not count later."""

    def __init__(self) -> None:
        self._counts: deque[tuple[float, int, int, int]] = deque()

    def at(self, seconds: float, health: Health) -> Health:
        """The counts with `troubled`: share of the samples of the last WINDOW that came late or not at all.

        Args:
            seconds: when they were counted, on a clock that only goes on.
            health: counts since the analysis started.
        """
        counts = self._counts
        if counts and health.received < counts[-1][1]:
            counts.clear()  # another analysis, which counts from 0
        counts.append((seconds, health.received, health.late, health.lost))
        while len(counts) > 2 and counts[1][0] <= seconds - WINDOW:
            counts.popleft()
        received, late, lost = (now - then for now, then in zip(counts[-1][1:], counts[0][1:], strict=True))
        sent = received + lost
        return replace(health, troubled=(late + lost) / sent if sent > 0 else 0.0)


class Steps:
    """Follows the simulation's model and its gap.

    Attributes:
        model, file: of the running model, as the simulation reports them; "" before.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self._steps: list[StaircaseStep] = []
        self._seen: tuple[str, ...] | None = None
        self._next: tuple[str, float | None] = (BY_HAND, None)
        self._gap: GapPart | None = None
        self._fresh = False
        self.model = self.file = ""

    def announce(self, change: str, held_out: float | None) -> None:
        """How the model that will be loaded next was changed, and its error on held-out samples, in the rig's unit."""
        self._next = (change, held_out)

    def runs(self, model: str, file: str, loads: str) -> bool:
        """The simulation reports its model and how many it has loaded; returns whether the model is a new one."""
        if (model, file, loads) == self._seen:
            return False
        first, self._seen = self._seen is None, (model, file, loads)
        self.model, self.file, self._fresh = model, file, first
        change, held_out = (FIRST, None) if first else self._next
        self._next = (BY_HAND, None)
        self._steps.append(StaircaseStep(model, change, held_out))
        if self._gap is not None:
            self._state.put(Before(self._gap.model, self._gap.ks, self._gap.joint))
        if not first:
            with self._state.tunnel() as table:
                table.new_model()
        self._publish()
        return True

    def trial_started(self) -> None:
        """Figures from now on belong to the running model."""
        self._fresh = True

    def gap(
        self, signals: Sequence[str], ks: Sequence[float], shares: Sequence[float], joint: Sequence[float],
        samples: int, trials: int, rig: Sequence[float] = (), rig_shares: Sequence[float] = (),
    ) -> None:  # fmt: skip
        """Figures of the live analysis: shares row by row, all k of the first signal first; `rig` is what it reaches
        against itself, jointly, `rig_shares` the same by signal; both are empty where that is not known."""
        if not self._fresh:
            return
        n = len(ks)
        rows, of_rig = (
            tuple(tuple(map(_known, each[i * n : (i + 1) * n])) for i in range(len(signals)))
            for each in (shares, rig_shares)
        )
        jointly, itself = (tuple(map(_known, values)) for values in (joint, rig))
        self._gap = GapPart(self.model, tuple(signals), tuple(ks), rows, jointly, itself, samples, trials, of_rig)
        self._state.put(self._gap)
        if self._steps and n and trials >= TUNNEL_TRIALS:
            smallest = min(range(n), key=lambda i: ks[i])
            self._steps[-1] = replace(self._steps[-1], live=self._gap.joint[smallest])
            self._publish()

    def diagnosed(self, held_out: float | None) -> None:
        """The running model's error on held-out samples, in the rig's unit."""
        if self._steps:
            self._steps[-1] = replace(self._steps[-1], held_out=held_out)
            self._publish()

    def _publish(self) -> None:
        self._state.put(Staircase(tuple(self._steps)))


def _known(value: float) -> float | None:
    return float(value) if value == value else None
