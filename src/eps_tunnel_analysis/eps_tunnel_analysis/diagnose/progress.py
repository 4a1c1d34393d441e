# SPDX-License-Identifier: Apache-2.0
"""Progress of a diagnosis: the roll-outs so far, and about how many there will be."""

import math
from collections.abc import Sequence
from threading import Lock
from typing import Protocol

from eps_tunnel_analysis.diagnose.rank import name_of

PER_BASE_VALUE = 95  # roll-outs for each base value of an axis: fitted first, and again with the best effects
PER_CANDIDATE = 30  # for each effect at each place: trial points, and its share of descents
AND_THEN = 600  # for each axis: descents of the best, their rivals, judging
MORE_TO_COME = 1.1  # times the roll-outs so far, once there are more than expected


class RolloutProgress(Protocol):
    """Called with the current step, the roll-outs so far, and about how many there will be; 0 if unknown."""

    def __call__(self, what: str, count: int, of: int = 0, /) -> None: ...


class SearchProgress(Protocol):
    """Called with what is searched, its roll-outs so far, and the effects that explain most so far."""

    def __call__(self, what: str, count: int, leading: Sequence[str] = (), /) -> None: ...


def expected_rollouts(axes: Sequence[tuple[int, int]]) -> int:
    """About how many roll-outs a diagnosis takes, from the base values and the candidates of each axis."""
    sweeps = sum(PER_BASE_VALUE * base for base, _ in axes) if len(axes) > 1 else 0
    return sweeps + sum(PER_BASE_VALUE * base + PER_CANDIDATE * candidates + AND_THEN for base, candidates in axes)


class RolloutCount:
    """Adds up searches, each of which counts from 0. Those of one name run in sequence; others may run meanwhile.

    What leads so far is said with the current step.

    Args:
        expected: about how many roll-outs there will be; 0 if unknown.
    """

    def __init__(self, report: RolloutProgress, expected: int = 0) -> None:
        self._report, self._expected = report, expected
        self._before, self._now = 0, dict[str, int]()
        self._lock = Lock()

    def __call__(self, what: str, count: int, leading: Sequence[str] = (), /) -> None:
        said = f"{what}, {name_of(leading)} so far" if leading else what
        with self._lock:
            if count < self._now.get(what, 0):
                self._before += self._now[what]
            self._now[what] = count
            made = self._before + sum(self._now.values())
            of = max(self._expected, math.ceil(MORE_TO_COME * made)) if self._expected else 0
            self._report(said, made, of)
