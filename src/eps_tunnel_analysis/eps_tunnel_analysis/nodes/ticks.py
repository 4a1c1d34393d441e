# SPDX-License-Identifier: Apache-2.0
"""Even ticks that the monotonic clock keeps and another clock stamps."""

import time
from collections.abc import Callable
from dataclasses import dataclass

TOGETHER = 1e-4  # s within which two clocks are read, if this process is let
TRIES = 20


@dataclass(frozen=True)
class Grid:
    """Even ticks on two clocks: tick 0 is at `begin` (monotonic, s) and at `begin_ns` (the node's, ns)."""

    begin: float
    begin_ns: int
    rate: float

    def moment(self, tick: int) -> float:
        """Monotonic s."""
        return self.begin + tick / self.rate

    def stamp(self, tick: int) -> int:
        """ns of the node's clock."""
        return self.begin_ns + round(tick / self.rate * 1e9)

    def newest(self, now: float) -> int:
        """The last tick up to `now`, monotonic s."""
        return int((now - self.begin) * self.rate)


def both_clocks(nanoseconds: Callable[[], int]) -> tuple[float, int]:
    """The monotonic clock (s) and another (ns) at one moment; a pair that something came between is read again."""
    for _ in range(TRIES):
        before = time.monotonic()
        other = nanoseconds()
        if (after := time.monotonic()) - before < TOGETHER:
            break
    return 0.5 * (before + after), other
