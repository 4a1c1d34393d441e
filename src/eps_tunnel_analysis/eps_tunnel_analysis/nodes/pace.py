# SPDX-License-Identifier: Apache-2.0
"""The clock that a run follows: the machine's steady one, or with use_sim_time the one on /clock."""

import threading
import time
from collections.abc import Callable

from rclpy.clock import Clock, JumpThreshold
from rclpy.duration import Duration

TOGETHER = 1e-4  # s within which two clocks are read, if this process is let
TRIES = 20
STOP_PERIOD = 0.1  # s between two looks at whether to stop
JUMP = 1.0  # s; a clock that goes back or ahead by more while playing was set


class ClockJumped(Exception):
    """The clock was set while a run followed it."""


def both_clocks(nanoseconds: Callable[[], int]) -> tuple[float, int]:
    """The monotonic clock (s) and another (ns) at one moment; a pair that was interrupted is read again."""
    for _ in range(TRIES):
        before = time.monotonic()
        other = nanoseconds()
        if (after := time.monotonic()) - before < TOGETHER:
            break
    return 0.5 * (before + after), other


class Pace:
    """Seconds that a run counts, together with the node's clock.

    Args:
        clock: of the node, whose time stamps what is sent.
        simulated: whether it follows /clock. A run then follows that clock, and pauses with it.
    """

    def __init__(self, clock: Clock, simulated: bool) -> None:
        self._clock, self.simulated = clock, simulated
        self._ticked = threading.Event()
        if simulated:  # called on every message on /clock
            any_change = JumpThreshold(
                min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
            )
            self._jumps = clock.create_jump_callback(any_change, post_callback=lambda _: self._ticked.set())

    def nanoseconds(self) -> int:
        """ns, of the node's clock."""
        return int(self._clock.now().nanoseconds)

    def now(self) -> float:
        """s, of the run's clock."""
        return self.nanoseconds() * 1e-9 if self.simulated else time.monotonic()

    def both(self) -> tuple[float, int]:
        """The run's clock (s) and the node's (ns) at one moment."""
        if not self.simulated:
            return both_clocks(self.nanoseconds)
        now = self.nanoseconds()
        return now * 1e-9, now

    def wait(self, moment: float, check: Callable[[], None]) -> None:
        """Sleeps until a moment of the run's clock, s.

        Args:
            check: called repeatedly while waiting for a simulated clock; raises to give up.

        Raises:
            ClockJumped: the simulated clock went back.
        """
        if not self.simulated:
            time.sleep(max(0.0, moment - time.monotonic()))
            return
        newest = self.now()
        while True:
            self._ticked.clear()
            if (now := self.now()) >= moment:
                return
            if now < newest - JUMP:
                raise ClockJumped(f"the clock jumped by {now - newest:+.1f} s while playing.")
            newest = max(newest, now)
            if not self._ticked.wait(STOP_PERIOD):
                check()
