# SPDX-License-Identifier: Apache-2.0
"""Load-dependent friction: MuJoCo's frictionloss, rewritten before every step."""

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    outside = s.passive[s.dof] - s.bias[s.dof]
    s.frictionloss[s.dof] += s.values[0] * abs(s.actuator[s.dof] - outside) + s.values[1] * abs(outside)


EFFECT = Effect(
    name="load_friction",
    title="Load-dependent friction",
    physics="Teeth and bearings pressed harder rub harder: friction grows with the torque that the gear carries, or "
    "with that of the load alone.",
    equation="F = mu |motor torque - load torque| + nu |load torque|; torque = -F sign(speed)",
    parameters=(
        Parameter("share", "1", 0.0, 0.45, 0.0, 0.15, "0 to just below 0.5, where a gear of this kind locks itself"),
        Parameter("bearings", "1", 0.0, 0.9, 0.0, 0.0, "0 to just below 1, where the load alone would hold itself"),
    ),
    stage="force",
    mark="The axis stops short of its target by more where it carries more load; hardly any friction "
    "where it carries none.",
    shows="passing",
    confused_with=(
        "coulomb_friction",
        "directional_load_friction",
        "direction_friction",
        "backlash",
        "gravity_load",
        "lugre_friction",
        "dead_band",
        "stribeck_friction",
        "duty_cut_back",
        "direction_viscous_friction",
    ),
    separated_by="Slow triangles about positions with high and with low load: the loop widens with the load.",
    touches=("dof_frictionloss",),
    step=step,
)
