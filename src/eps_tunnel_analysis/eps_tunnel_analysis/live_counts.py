# SPDX-License-Identifier: Apache-2.0
"""What went wrong with the samples on their way: late, lost, reordered, duplicated; clocks that jumped."""

from dataclasses import dataclass

import numpy as np

RELEARN = 50  # samples; the usual step between stamps is learned from that many


@dataclass
class StampCounts:
    """Counts over one topic.

    Attributes:
        late_after: s between measurement and arrival beyond which a message counts as late.
        jump: s between two stamps, or back, beyond which the clock has jumped rather than messages were lost.
    """

    late_after: float = 0.1
    jump: float = 5.0
    received: int = 0
    late: int = 0
    lost: int = 0
    reordered: int = 0
    duplicated: int = 0
    clock_jumps: int = 0

    def __post_init__(self) -> None:
        self._newest: int | None = None
        self._steps: list[int] = []
        self._period = 0

    @property
    def troubled(self) -> bool:
        """Whether samples went missing or astray; late ones are all there."""
        return bool(self.lost or self.reordered or self.duplicated or self.clock_jumps)

    def __str__(self) -> str:
        return (
            f"{self.received} received, {self.late} late, {self.lost} lost, {self.reordered} reordered, "
            f"{self.duplicated} duplicated"
        )

    def add(self, stamp: int, arrival: int) -> bool:
        """Counts one message (ns both). False for one that is not after its predecessor and must not be judged."""
        self.received += 1
        if arrival - stamp > self.late_after * 1e9:
            self.late += 1
        if self._newest is None:
            self._newest = stamp
            return True
        step = stamp - self._newest
        if abs(step) > self.jump * 1e9:
            self.clock_jumps += 1
            self._newest, self._steps = stamp, []
            return True
        if step <= 0:
            if step == 0:
                self.duplicated += 1
            else:
                self.reordered += 1
            return False
        if self._period and step > 1.5 * self._period:
            self.lost += round(step / self._period) - 1
        self._steps.append(step)
        if len(self._steps) >= RELEARN:
            self._period, self._steps = int(np.median(self._steps)), []
        self._newest = stamp
        return True
