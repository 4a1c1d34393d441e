# SPDX-License-Identifier: Apache-2.0
"""A free curve: torque over the joint's own speed."""

from labyrinth_sim.curve import bounds_of_range, falling, knots, over_speed
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    """Where the curve falls its slope is joint damping, which MuJoCo takes at the speed to come."""
    s = state(raw)
    speed = s.qvel[s.dof]
    torque, slope = over_speed(s.values, speed)
    damping = max(-slope, 0.0)
    s.damping[s.dof] += damping
    s.applied[s.dof] += torque + damping * speed


EFFECT = Effect(
    name="curve_speed",
    title="Free curve: torque over speed",
    physics="Some torque depends on how fast the joint moves and which way; a table says how much, not why.",
    equation="torque = F(speed), F through 10 values over -most to most",
    parameters=(
        *knots("N m", -1.0, 1.0, falling(0.2), "at most as large as Coulomb friction, of either sign"),
        bounds_of_range("most", "rad/s", 0.001, 1000.0, 1.0),
    ),
    stage="force",
    mark="The axis trails by an amount that depends on its speed and direction alone.",
    shows="passing",
    confused_with=("curve_reversal", "curve_sensor_speed"),
    separated_by="It may be any torque that depends on the speed; the shape of its table says which.",
    nameless=True,
    touches=("dof_damping",),
    step=step,
)
