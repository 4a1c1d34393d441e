# SPDX-License-Identifier: Apache-2.0
"""A free curve: torque over the time since the start."""

from labyrinth_sim.curve import bounds_of_range, from_zero, knots, rising
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    s.applied[s.dof] += from_zero(s.values, s.memory[0])
    s.memory[0] += s.step


EFFECT = Effect(
    name="curve_time",
    title="Free curve: torque over time",
    physics="Some torque changes during a trial, whatever the joint does; a table says how much, not why.",
    equation="torque = F(time), F through 10 values over 0 to end",
    parameters=(
        *knots("N m", -1.0, 1.0, rising(0.2), "at most as large as Coulomb friction, of either sign"),
        bounds_of_range("end", "s", 0.01, 1e5, 5.0),
    ),
    stage="force",
    mark="The axis is off to one side by an amount that changes steadily through each trial.",
    shows="offset",
    confused_with=("curve_time_friction",),
    separated_by="Play the same motion early and late: what differs depends on the time.",
    nameless=True,
    step=step,
)
