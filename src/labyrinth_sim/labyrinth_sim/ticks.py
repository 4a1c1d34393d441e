# SPDX-License-Identifier: Apache-2.0
"""What effects that round to ticks declare in common."""

from labyrinth_sim.effect import Parameter


def cut(what: str) -> Parameter:
    """By which part of a tick less is rounded: whether `what` is rounded or cut off."""
    why = f"0 where {what} are rounded, 0.5 where the fraction is cut off"
    return Parameter("cut", "1", 0.0, 0.5, None, 0.0, why, settled=True, choices=(0.0, 0.5))
