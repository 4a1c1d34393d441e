# SPDX-License-Identifier: Apache-2.0
"""A free curve: dry friction over load."""

from labyrinth_sim.curve import bounds_of_range, from_zero, knots, rising
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    carried = abs(s.actuator[s.dof] - s.passive[s.dof] + s.bias[s.dof])
    s.frictionloss[s.dof] += max(from_zero(s.values, carried), 0.0)


EFFECT = Effect(
    name="curve_load_friction",
    title="Free curve: friction over load",
    physics="The joint turns harder the more torque its gear carries, or the less; a table says how much, not why.",
    equation="torque = -max(F(|motor torque - load torque|), 0) sign(speed), F through 10 values over 0 to most",
    parameters=(
        *knots("N m", 0.0, 1.0, rising(0.2), "0 to a third of the stall torque of a servo of this class"),
        bounds_of_range("most", "N m", 0.0001, 100.0, 0.5),
    ),
    stage="force",
    mark="The axis stops short of its target by an amount that depends on the load that it carries.",
    shows="loop",
    confused_with=("curve_angle_friction",),
    separated_by="Slow triangles about positions with high and with low load: the loop differs.",
    nameless=True,
    touches=("dof_frictionloss",),
    step=step,
)
