# SPDX-License-Identifier: Apache-2.0
"""A free curve: friction over the time since the joint last reversed."""

import math

from labyrinth_sim.curve import bounds_of_range, from_zero, knots, rising
from labyrinth_sim.effect import Effect
from labyrinth_sim.law import law, state

STANDS = 1e-3  # rad/s, m/s; below it a joint keeps its direction


@law
def step(raw: int) -> None:
    s = state(raw)
    speed, direction = s.qvel[s.dof], s.memory[1]
    now = math.copysign(1.0, speed) if abs(speed) > STANDS else direction
    s.memory[0] = 0.0 if now != direction else s.memory[0] + s.step
    s.memory[1] = now
    s.applied[s.dof] -= now * from_zero(s.values, s.memory[0])


EFFECT = Effect(
    name="curve_reversal",
    title="Free curve: torque over time since reversal",
    physics="Some torque against the motion grows or decays after each reversal; a table says how much, not why.",
    equation="torque = -F(time since reversal) sign(last speed), F through 10 values over 0 to end",
    parameters=(
        *knots("N m", -1.0, 1.0, rising(0.2), "at most as large as Coulomb friction, of either sign"),
        bounds_of_range("end", "s", 0.001, 1000.0, 0.3),
    ),
    stage="force",
    mark="After each reversal the axis trails by an amount that changes with the time since then.",
    shows="loop",
    confused_with=("curve_speed",),
    separated_by="Triangles of several periods: what depends on the time since reversal looks alike in all.",
    nameless=True,
    step=step,
)
