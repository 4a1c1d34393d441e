# SPDX-License-Identifier: Apache-2.0
"""The staircase as it is climbed: which model came when, what it left, and how the next one is told from it."""

from collections.abc import Sequence
from dataclasses import replace

from eps_tunnel_analysis.monitor.parts import Before, Gap, Staircase, Step
from eps_tunnel_analysis.monitor.state import State

FIRST = "as given"
BY_HAND = "loaded by hand"


class Steps:
    """Follows the simulation's model and its gap.

    Attributes:
        model, file: of the model that runs, as the simulation tells them; "" before.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self._steps: list[Step] = []
        self._seen: tuple[str, ...] | None = None
        self._next: tuple[str, float | None] = (BY_HAND, None)
        self._gap: Gap | None = None
        self._fresh = False
        self.model = self.file = ""

    def announce(self, change: str, held_out: float | None) -> None:
        """What the model that will be loaded next was changed by, and what it left on samples held out, rad."""
        self._next = (change, held_out)

    def runs(self, model: str, file: str, loads: str) -> bool:
        """The simulation tells its model and how many it loaded so far; returns whether it is another than before."""
        if (model, file, loads) == self._seen:
            return False
        first, self._seen = self._seen is None, (model, file, loads)
        self.model, self.file, self._fresh = model, file, first
        change, held_out = (FIRST, None) if first else self._next
        self._next = (BY_HAND, None)
        self._steps.append(Step(model, change, held_out))
        if self._gap is not None:
            self._state.put(Before(self._gap.model, self._gap.ks, self._gap.joint))
        if not first:
            with self._state.tunnel() as table:
                table.new_model()
        self._told()
        return True

    def trial_started(self) -> None:
        """Figures that come from now on are those of the model that runs."""
        self._fresh = True

    def gap(
        self, signals: Sequence[str], ks: Sequence[float], shares: Sequence[float], joint: Sequence[float],
        samples: int, trials: int,
    ) -> None:  # fmt: skip
        """Figures of the live analysis: shares row by row, all k of the first signal first."""
        if not self._fresh:
            return
        n = len(ks)
        rows = tuple(tuple(map(_known, shares[i * n : (i + 1) * n])) for i in range(len(signals)))
        self._gap = Gap(self.model, tuple(signals), tuple(ks), rows, tuple(map(_known, joint)), samples, trials)
        self._state.put(self._gap)
        if self._steps and n:
            smallest = min(range(n), key=lambda i: ks[i])
            self._steps[-1] = replace(self._steps[-1], live=self._gap.joint[smallest])
            self._told()

    def diagnosed(self, held_out: float | None) -> None:
        """The running model's error on samples held out, rad."""
        if self._steps:
            self._steps[-1] = replace(self._steps[-1], held_out=held_out)
            self._told()

    def _told(self) -> None:
        self._state.put(Staircase(tuple(self._steps)))


def _known(value: float) -> float | None:
    return float(value) if value == value else None
