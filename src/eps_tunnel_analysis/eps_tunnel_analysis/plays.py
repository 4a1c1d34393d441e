# SPDX-License-Identifier: Apache-2.0
"""Play: one command and all the trials in which it was played."""

from dataclasses import dataclass

from labyrinth_sim.trials import Trials


@dataclass(frozen=True)
class Play:
    """One command sequence C and the trials in which it was played."""

    name: str
    trials: Trials
