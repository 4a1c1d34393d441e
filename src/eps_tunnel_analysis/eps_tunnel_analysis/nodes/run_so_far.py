# SPDX-License-Identifier: Apache-2.0
"""A run so far."""

import time
from collections.abc import Callable

from eps_tunnel_analysis.nodes.progress import Progress
from eps_tunnel_analysis.sequence import Sequence

FEEDBACK = 0.2  # s between two reports of progress


class Ended(Exception):
    """The run cannot go on; the text says why."""


class Run:
    """Where a run is: its clock, its progress, whether it was told to stop."""

    def __init__(
        self, sequence: Sequence, trials: int, tell: Callable[[Progress], None], stopped: Callable[[], bool]
    ) -> None:
        self._tell, self._stopped = tell, stopped
        # A first guess of 2.5 s between trials; later the run's own pace counts.
        self._work = [command.duration + 2.5 for command in sequence.commands for _ in range(trials)]
        self.trial, self.trials, self.phase = 0, len(self._work), "returning"
        self.lateness: list[float] = []
        self._began = self._trial_began = self.awake = time.monotonic()
        self.next_tick = 0.0
        self._next_report = 0.0

    def check(self) -> None:
        if self._stopped():
            raise Ended("it was cancelled.")

    def wait(self, tick: float) -> None:
        """Sleeps until a tick, monotonic time in s."""
        self.check()
        time.sleep(max(0.0, tick - time.monotonic()))
        self.lateness.append(time.monotonic() - tick)

    def trial_done(self) -> None:
        self.trial += 1
        self._trial_began = time.monotonic()

    def report(self, now: float) -> None:
        if now < self._next_report:
            return
        self._next_report = now + FEEDBACK
        total, done = sum(self._work), sum(self._work[: self.trial])
        spent = now - self._began
        within = min(now - self._trial_began, self._work[min(self.trial, self.trials - 1)])
        share = min(1.0, (done + within) / total) if self.trial < self.trials else 1.0
        pace = spent / (done + within) if self.trial and done + within > 0 else 1.0
        self._tell(
            Progress(min(self.trial, self.trials - 1), self.trials, self.phase, share, (1 - share) * total * pace)
        )
