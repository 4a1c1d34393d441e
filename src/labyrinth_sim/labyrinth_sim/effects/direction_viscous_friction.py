# SPDX-License-Identifier: Apache-2.0
"""Viscous friction that differs by direction: MuJoCo's joint damping, rewritten before every step."""

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    damping = s.values[0]
    if damping * s.qvel[s.dof] > 0.0:
        s.damping[s.dof] += abs(damping)


EFFECT = Effect(
    name="direction_viscous_friction",
    title="Direction-dependent viscous friction",
    physics="A damper, a seal or a screw resists motion more in one direction than in the other, and the more so the "
    "faster it is.",
    equation="torque = -B speed for speed > 0 and 0 for speed < 0 if B > 0; -|B| speed for speed < 0 if B < 0",
    parameters=(
        Parameter("damping", "N m s/rad", -3.0, 3.0, 0.0, 0.5, "at most as large as viscous friction, of either sign"),
    ),
    stage="force",
    mark="The lag behind a ramp grows with its speed in one direction and not in the other.",
    shows="passing",
    confused_with=(
        "viscous_friction",
        "direction_friction",
        "supply_sag",
        "load_friction",
    ),
    separated_by="Ramps of several speeds, up and down: plain viscous friction treats both alike, and "
    "direction-dependent dry friction does not grow with the speed.",
    touches=("dof_damping",),
    step=step,
)
