# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis could not know from these recordings, in words."""

from collections.abc import Sequence

from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.diagnose.ball import sees_ball
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS


def notes_of(
    model: Model,
    parts: Sequence[AxisPart],
    moved: Sequence[AxisPart],
    plays: Sequence[Play],
    axes: Sequence[AxisDiagnosis],
) -> tuple[str, ...]:
    """One sentence each.

    Args:
        parts: every axis that was measured; `moved` those of them that a command moves.
        axes: what was found on these, without the ball.
    """
    notes = []
    if any(play.trials.count == 1 for play in plays):
        notes.append(
            "One trial only: what the rig repeats is unknown, so effects are weighed against one another, one at a "
            "time, and what is left is held against the sensors' noise alone. Record five trials."
        )
    for part in parts:
        if part not in moved:
            notes.append(f"No command moves axis {part.name}: none of its effects can be seen. Play excite_12s.")
    filmed = any(s in play.trials.signals for s in BALL_SIGNALS for play in plays)
    if model.rig.ball and filmed and not sees_ball(model, plays):
        notes.append("The ball was not seen where each recording begins, so its effects were not considered.")
    notes += [odd.sentence for axis in axes for odd in axis.odd]
    for axis in axes:
        poor = [r.effects for r in axis.refits if r.effects and not r.converged and r.cost < 2.0 * axis.best.cost]
        if poor:
            names = ", ".join(" + ".join(effects) for effects in poor[:3])
            title = axis.part.title
            notes.append(
                f"{title[0].upper()}{title[1:]}: the fit of {names} has not converged; its probability may be too low."
            )
        for own in (model.rig.axis(name) for name in axis.part.axes):
            seen = [m for m in own.measured if m.signal in axis.part.signals]
            if all(m.quantity != "torque" for m in seen):
                notes.append(
                    f"Axis {own.name} has no recorded effort: friction under a stiff drive and dead band look alike."
                )
            joints = [{m.joint for m in some if m.quantity == "position"} for some in (seen, own.measured)]
            if len(joints[0]) < len(joints[1]):
                notes.append(f"Axis {own.name} has one position only: what lies between motor and load is guesswork.")
    return tuple(notes)
