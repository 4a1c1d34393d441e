# SPDX-License-Identifier: Apache-2.0
"""Play: one command and all the trials in which it was played."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from labyrinth_sim.trials import Trials


@dataclass(frozen=True)
class Play:
    """One command sequence C and the trials in which it was played.

    Attributes:
        known: full parameter name -> value, of what is known to have been set for these trials, as a firmware's gain.
        timing: s, uneven timing within trials that the rig is known to have; more of it counts as something missing.
    """

    name: str
    trials: Trials
    known: Mapping[str, float] = field(default_factory=dict)
    timing: float = 0.0
