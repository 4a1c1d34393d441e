# SPDX-License-Identifier: Apache-2.0
"""A free curve: dry friction over the angle of another axis, the first one that there is."""

from labyrinth_sim.curve import bounds_of_range, knots, other_angle, over_angle, rising
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    s.frictionloss[s.dof] += max(over_angle(s.values, other_angle(s)), 0.0)


EFFECT = Effect(
    name="curve_other_friction",
    title="Free curve: friction over the other axis's angle",
    physics="The joint turns harder where another axis stands at some angles; a table says how much, not why.",
    equation="torque = -max(F(other angle), 0) sign(speed), F through 10 values over centre +- half",
    parameters=(
        *knots("N m", 0.0, 1.0, rising(0.2), "0 to a third of the stall torque of a servo of this class"),
        bounds_of_range("centre", "rad", -100.0, 100.0, 0.0),
        bounds_of_range("half", "rad", 0.001, 100.0, 0.06),
    ),
    stage="force",
    mark="The axis stops short of its target by an amount that depends on where the other one stands.",
    shows="loop",
    confused_with=("curve_other",),
    separated_by="The same slow triangles with the other axis at several angles.",
    needs=("other_axis",),
    couples=True,
    nameless=True,
    touches=("dof_frictionloss",),
    step=step,
)
