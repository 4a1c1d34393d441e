# SPDX-License-Identifier: Apache-2.0
"""A free curve: torque over the joint's own angle."""

from labyrinth_sim.curve import bounds_of_range, falling, knots, over_angle
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    s.applied[s.dof] += over_angle(s.values, s.qpos[s.angle])


EFFECT = Effect(
    name="curve_angle",
    title="Free curve: torque over angle",
    physics="Some torque depends on where the joint stands; a table says how much, not why.",
    equation="torque = F(angle), F through 10 values over centre +- half",
    parameters=(
        *knots("N m", -1.0, 1.0, falling(0.2), "at most as large as Coulomb friction, of either sign"),
        bounds_of_range("centre", "rad", -100.0, 100.0, 0.0),
        bounds_of_range("half", "rad", 0.001, 100.0, 0.06),
    ),
    stage="force",
    mark="The axis misses each angle by a different amount, from either side and at any speed.",
    shows="by_angle",
    confused_with=("curve_sensor",),
    separated_by="It may be any torque that depends on the angle; the shape of its table says which.",
    nameless=True,
    step=step,
)
