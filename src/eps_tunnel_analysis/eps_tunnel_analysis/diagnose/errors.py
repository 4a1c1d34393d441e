# SPDX-License-Identifier: Apache-2.0
"""How far a model is from recordings, and how far these are from one another: the yardsticks of every verdict."""

from collections.abc import Sequence

import numpy as np

from eps_tunnel_analysis.compare import Comparison, compare
from eps_tunnel_analysis.diagnose.ball import sees_ball
from eps_tunnel_analysis.diagnose.verdict import Errors, PlayError
from eps_tunnel_analysis.simulated import Play, roll_out
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS

KS = (1.0, 2.0, 3.0, 5.0)


def compared(model: Model, plays: Sequence[Play]) -> list[Comparison]:
    """A model against each play, positions only, the ball's where it was seen, at the rig's own step."""
    found = []
    for play in plays:
        positions = [m.signal for m in model.rig.measured if m.quantity == "position"]
        positions += BALL_SIGNALS if sees_ball(model, [play]) else ()
        names = [name for name in positions if name in play.trials.signals]
        found.append(compare(play.trials.select(names), roll_out(model, play).select(names), KS))
    return found


def errors_of(
    comparisons: Sequence[Comparison], held: Sequence[Comparison] = (), left_out: float | None = None, unit: str = "rad"
) -> Errors:
    """Means over plays and signals in this unit.

    Args:
        held: plays that were never fitted; the held-out error is theirs.
        left_out: without such plays, the error of stretches of time left out in turn; None of a model that was not
            fitted, whose error on them is its error.
    """
    error = _mean_error(comparisons, unit)
    alike = float(np.mean([c.alikeness[0].joint for c in comparisons]))
    kept = _mean_error(held, unit) if held else error if left_out is None else left_out
    return Errors(error, kept, alike)


def _mean_error(comparisons: Sequence[Comparison], unit: str) -> float:
    return float(np.nanmean([e.command_error for c in comparisons for e in c.errors if e.unit == unit]))


def play_errors(
    plays: Sequence[Play],
    held: Sequence[Play],
    near: Sequence[Sequence[Comparison]],
    far: Sequence[Sequence[Comparison]],
    unit: str = "rad",
) -> tuple[tuple[PlayError, ...], ...]:
    """For each model the error of each recording, those held out last."""
    return tuple(
        tuple(
            PlayError(play.name, kept, _mean_error([c], unit))
            for group, found, kept in ((plays, a, False), (held, b, True))
            for play, c in zip(group, found, strict=True)
        )
        for a, b in zip(near, far, strict=True)
    )


def rig_against_itself(comparisons: Sequence[Comparison]) -> float:
    """Joint alikeness at k = 1 of one trial in the tunnel of the others: mean over the recordings, NaN if unknown."""
    known = [c.against_itself[0].joint for c in comparisons if c.against_itself]
    return float(np.mean(known)) if known else float("nan")
