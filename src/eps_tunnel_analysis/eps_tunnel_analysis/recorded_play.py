# SPDX-License-Identifier: Apache-2.0
"""A play: one command sequence and the trials in which a rig played it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from eps_tunnel_analysis.stamped import StampedTrial, stamped_from_grid
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Trials


@shown
@dataclass(frozen=True)
class Play:
    """One command sequence C and the trials in which it was played.

    Attributes:
        trials: on an even grid, for tunnels.
        stamped: the same trials at their own stamps, for models; empty where only the grid is known.
        known: full parameter name -> value, of what is known to have been set for these trials, as a firmware's gain.
        timing: s, uneven timing within trials that the rig is known to have; more of it counts as something missing.
    """

    name: str
    trials: Trials
    known: Mapping[str, float] = field(default_factory=dict)
    timing: float = 0.0
    stamped: tuple[StampedTrial, ...] = ()

    @property
    def at_stamps(self) -> tuple[StampedTrial, ...]:
        """The trials at their own stamps; at the grid's where only that is known."""
        return self.stamped or stamped_from_grid(self.trials)
