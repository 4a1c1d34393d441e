# SPDX-License-Identifier: Apache-2.0
"""A free curve: dry friction over angle."""

from labyrinth_sim.curve import bounds_of_range, knots, over_angle, rising
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    s.frictionloss[s.dof] += max(over_angle(s.values, s.qpos[s.angle]), 0.0)


EFFECT = Effect(
    name="curve_angle_friction",
    title="Free curve: friction over angle",
    physics="The joint turns harder at some angles than at others; a table says how much, not why.",
    equation="torque = -max(F(angle), 0) sign(speed), F through 10 values over centre +- half",
    parameters=(
        *knots("N m", 0.0, 1.0, rising(0.2), "0 to a third of the stall torque of a servo of this class"),
        bounds_of_range("centre", "rad", -100.0, 100.0, 0.0),
        bounds_of_range("half", "rad", 0.001, 100.0, 0.06),
    ),
    stage="force",
    mark="The axis stops short of its target by an amount that depends on the angle, on the side from which it came.",
    shows="loop",
    confused_with=("curve_load_friction",),
    separated_by="A slow staircase up and down: the loop is wider at some angles than at others.",
    nameless=True,
    touches=("dof_frictionloss",),
    step=step,
)
