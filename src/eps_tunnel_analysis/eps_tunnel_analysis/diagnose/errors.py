# SPDX-License-Identifier: Apache-2.0
"""How far a model is from recordings, and how far these are from one another: the yardsticks of every verdict."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.alikeness import Span
from eps_tunnel_analysis.compare import Comparison, compare
from eps_tunnel_analysis.diagnose.ball import sees_ball
from eps_tunnel_analysis.diagnose.verdict import Errors, PlayError
from eps_tunnel_analysis.error import mean_error
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import roll_out
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS

SHORTEST = 0.05  # s, of a span outside the tunnel that is listed


@dataclass(frozen=True)
class Distances:
    """How far each of three models is from recordings: as given, with its values refitted, with the effects.

    Attributes:
        near: each model's comparison with each recording that was fitted.
        errors: mean over signals and recordings; `ball` those of the ball, where it was seen.
        plays: of each recording, those held out last.
        where: time outside the tunnels with the values refitted.
        rig_against_itself: from `rig_against_itself`.
    """

    near: tuple[Sequence[Comparison], ...]
    errors: tuple[Errors, ...]
    ball: tuple[Errors, ...]
    plays: tuple[tuple[PlayError, ...], ...]
    where: tuple[Span, ...]
    rig_against_itself: float


def distances(
    models: Sequence[Model], plays: Sequence[Play], held: Sequence[Play], left_out: Sequence[float | None]
) -> Distances:
    """How far models are from recordings.

    Args:
        models: as given, refitted, with the effects.
        held: plays that were never fitted.
        left_out: for each model, as in `errors_of`.
    """
    unit, rolls = models[0].rig.position_unit, sees_ball(models[0], plays)
    near, far = ([compared(m, some) for m in models] for some in (plays, held))
    return Distances(
        tuple(near),
        tuple(errors_of(c, h, left, unit) for c, h, left in zip(near, far, left_out, strict=True)),
        tuple(errors_of(c, h, None, "m") for c, h in zip(near, far, strict=True)) if rolls else (),
        play_errors(plays, held, near, far, unit),
        tuple(s for c in near[1] for s in c.spans if s.end - s.start >= SHORTEST),
        rig_against_itself(near[0]),
    )


def compared(model: Model, plays: Sequence[Play]) -> list[Comparison]:
    """A model compared with each play, positions only, the ball's if it was seen, at the rig's own step."""
    comparisons = []
    for play in plays:
        ball = BALL_SIGNALS if sees_ball(model, [play]) else ()
        names = [name for name in (*model.rig.positions, *ball) if name in play.trials.signals]
        comparisons.append(compare(play.trials.select(names), roll_out(model, play).select(names)))
    return comparisons


def errors_of(
    comparisons: Sequence[Comparison], held: Sequence[Comparison] = (), left_out: float | None = None, unit: str = "rad"
) -> Errors:
    """Means over plays and signals in this unit.

    Args:
        held: plays that were never fitted; the held-out error is computed on them.
        left_out: without such plays, the error on stretches of time left out in turn; None for a model that was not
            fitted, whose held-out error is its error.
    """
    error = _mean_error(comparisons, unit)
    alike = float(np.mean([c.alikeness[0].joint for c in comparisons]))
    kept = _mean_error(held, unit) if held else error if left_out is None else left_out
    return Errors(error, kept, alike)


def _mean_error(comparisons: Sequence[Comparison], unit: str) -> float:
    every = [e for c in comparisons for e in c.errors]
    return mean_error([e.command_error for e in every], [e.unit for e in every], unit)


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
            for group, comparisons, kept in ((plays, a, False), (held, b, True))
            for play, c in zip(group, comparisons, strict=True)
        )
        for a, b in zip(near, far, strict=True)
    )


def rig_against_itself(comparisons: Sequence[Comparison]) -> float:
    """Joint alikeness at k = 1 of one trial in the tunnel of the others: mean over the recordings, NaN if unknown."""
    known = [c.against_itself[0].joint for c in comparisons if c.against_itself]
    return float(np.mean(known)) if known else float("nan")
