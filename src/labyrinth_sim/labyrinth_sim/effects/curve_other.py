# SPDX-License-Identifier: Apache-2.0
"""A free curve: torque over the angle of another axis, the first one that there is."""

from labyrinth_sim.curve import bounds_of_range, falling, knots, other_angle, over_angle
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    s.applied[s.dof] += over_angle(s.values, other_angle(s))


EFFECT = Effect(
    name="curve_other",
    title="Free curve: torque over the other axis's angle",
    physics="Some torque depends on where another axis stands; a table says how much, not why.",
    equation="torque = F(other angle), F through 10 values over centre +- half",
    parameters=(
        *knots("N m", -1.0, 1.0, falling(0.2), "at most as large as Coulomb friction, of either sign"),
        bounds_of_range("centre", "rad", -100.0, 100.0, 0.0),
        bounds_of_range("half", "rad", 0.001, 100.0, 0.06),
    ),
    stage="force",
    mark="This axis is pulled aside wherever the other one stands away from its middle.",
    shows="coupled",
    confused_with=("curve_other_friction", "curve_sensor_other"),
    separated_by="Move the axes one after the other: what this axis does while only the other moves is coupling.",
    needs=("other_axis",),
    couples=True,
    nameless=True,
    step=step,
)
