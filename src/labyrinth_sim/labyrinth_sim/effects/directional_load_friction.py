# SPDX-License-Identifier: Apache-2.0
"""Load-dependent friction with the direction of power: MuJoCo's frictionloss, rewritten before every step."""

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    driving, driven = s.values[0], s.values[1]
    motor, outside = s.actuator[s.dof], s.passive[s.dof] - s.bias[s.dof]
    share = driving if abs(motor) >= abs(outside) else driven
    s.frictionloss[s.dof] += share * abs(motor - outside) + s.values[2] * abs(outside)


EFFECT = Effect(
    name="directional_load_friction",
    title="Load friction by direction of power",
    physics="A gear loses a different share of the torque when the motor drives the load than when the load drives the "
    "motor; bearings that carry the load rub as much either way.",
    equation="F = mu |motor torque - load torque| + nu |load torque|, mu = mu_1 where the motor is the stronger, "
    "else mu_2; torque = -F sign(speed)",
    parameters=(
        Parameter("driving", "1", 0.0, 0.45, 0.0, 0.1, "0 to just below 0.5, where the gear locks itself"),
        Parameter("driven", "1", 0.0, 0.45, 0.0, 0.2, "0 to just below 0.5, where the gear locks itself"),
        Parameter("bearings", "1", 0.0, 0.9, 0.0, 0.0, "0 to just below 1, where the load alone would hold itself"),
    ),
    stage="force",
    mark="The axis sticks more where it lowers a load than where it lifts the same one, or the other way round.",
    shows="passing",
    confused_with=("load_friction", "coulomb_friction", "direction_friction"),
    separated_by="Lift and lower the same load slowly: with plain load friction both lose the same share.",
    contains=(
        ("driving", "load_friction", "share"),
        ("driven", "load_friction", "share"),
        ("bearings", "load_friction", "bearings"),
    ),
    touches=("dof_frictionloss",),
    step=step,
)
