# SPDX-License-Identifier: Apache-2.0
"""A trial while it runs: stamped samples in, values on the grid out."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from eps_tunnel_analysis.recording.recording import TrialMark
from eps_tunnel_analysis.recording.resample import interpolate
from labyrinth_sim.trials import Array

SECOND = 1_000_000_000  # ns
MEMORY = 2.0
"""s of samples kept, for a start mark that comes after the samples it begins with"""


@dataclass
class Stream:
    """Samples that come with one stamp: the joint states, or the ball."""

    names: tuple[str, ...]
    recent: deque[tuple[int, Array]] = field(default_factory=deque)

    @property
    def newest(self) -> int:
        return self.recent[-1][0] if self.recent else -1

    def add(self, stamp: int, values: Array) -> bool:
        """False for a sample that is not after its predecessor; it is dropped."""
        if stamp <= self.newest:
            return False
        self.recent.append((stamp, values))
        while len(self.recent) > 2 and self.recent[1][0] < stamp - MEMORY * SECOND:
            self.recent.popleft()
        return True


class RunningTrial:
    """One running trial of one side on its grid."""

    def __init__(
        self, mark: TrialMark, signals: tuple[str, ...], streams: Mapping[str, Stream], rate: float, max_gap: float
    ) -> None:
        self.mark, self.signals, self._max_gap = mark, signals, max_gap
        self.time = np.arange(math.floor(mark.duration * rate + 1e-6) + 1) / rate
        self.grid = mark.stamp + np.round(self.time * 1e9).astype(np.int64)
        self.values = np.full((len(self.time), len(signals)), np.nan)
        self.ended = False
        # Only streams that were there at the start are waited for.
        self._streams = {key: stream for key, stream in streams.items() if stream.newest > mark.stamp - SECOND}
        for stream in streams.values():
            samples = list(stream.recent)
            for before, now in zip([None, *samples], samples, strict=False):
                self.add(stream.names, before, now)

    def add(self, names: Sequence[str], before: tuple[int, Array] | None, now: tuple[int, Array]) -> None:
        """Fills the grid points after the sample `before` up to the sample `now`."""
        known = [before, now] if before is not None else [now]
        first = int(np.searchsorted(self.grid, before[0], side="right")) if before is not None else 0
        last = int(np.searchsorted(self.grid, now[0], side="right"))
        if first >= last:
            return
        stamps = np.array([sample[0] for sample in known], dtype=np.int64)
        for column, name in enumerate(self.signals):
            if name in names:
                values = np.array([sample[1][names.index(name)] for sample in known])
                self.values[first:last, column] = interpolate(stamps, values, self.grid[first:last], self._max_gap)

    def ready(self) -> int:
        """How many grid points are known for good: every stream is past them, or silent for longer than a gap."""
        newest = [stream.newest for stream in self._streams.values()]
        if not newest:
            return 0
        known = max(min(newest), max(newest) - round(self._max_gap * 1e9))
        return int(np.searchsorted(self.grid, known, side="right"))
