# SPDX-License-Identifier: Apache-2.0
"""A free curve: dry friction over time."""

from labyrinth_sim.curve import bounds_of_range, from_zero, knots, rising
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    s.frictionloss[s.dof] += max(from_zero(s.values, s.memory[0]), 0.0)
    s.memory[0] += s.step


EFFECT = Effect(
    name="curve_time_friction",
    title="Free curve: friction over time",
    physics="Friction changes during a trial, for example because grease warms up; a table says how much, not why.",
    equation="torque = -max(F(time), 0) sign(speed), F through 10 values over 0 to end",
    parameters=(
        *knots("N m", 0.0, 1.0, rising(0.2), "0 to a third of the stall torque of a servo of this class"),
        bounds_of_range("end", "s", 0.01, 1e5, 5.0),
    ),
    stage="force",
    mark="The axis stops short of its target by an amount that changes steadily through each trial.",
    shows="loop",
    confused_with=("curve_time",),
    separated_by="Play the same slow triangles early and late: the loop differs.",
    nameless=True,
    touches=("dof_frictionloss",),
    step=step,
)
