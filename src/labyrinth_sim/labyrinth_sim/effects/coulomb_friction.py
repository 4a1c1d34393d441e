# SPDX-License-Identifier: Apache-2.0
"""Coulomb friction: MuJoCo's frictionloss where it is sharp, joint damping rewritten before every step where not."""

from labyrinth_sim.effect import Effect, Values
from labyrinth_sim.friction import SLOW, TORQUE, gradual_damping, sharp
from labyrinth_sim.law import law, state
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields["dof_frictionloss"][:, site.dof] += sharp(values)


@law
def step(raw: int) -> None:
    s = state(raw)
    s.damping[s.dof] += gradual_damping(s.values[0], s.qvel[s.dof], s.values[1])


EFFECT = Effect(
    name="coulomb_friction",
    title="Coulomb friction",
    physics="A torque of constant size opposes motion and holds the axis still when less than it acts.",
    equation="torque = -F sign(speed); at rest |torque| <= F; -F tanh(speed / v_c) if it sets in gradually",
    parameters=(
        TORQUE,
        SLOW,
    ),
    stage="mjcf",
    mark="The axis stops short of its target by the same angle from either side; flat tops after slow reversals.",
    shows="loop",
    confused_with=(
        "dead_band",
        "stribeck_friction",
        "load_friction",
        "backlash",
        "direction_friction",
        "lugre_friction",
        "command_quantisation",
        "directional_load_friction",
        "positioning_error",
    ),
    separated_by="Triangles at several speeds: Coulomb's error does not change with speed, Stribeck's does.",
    touches=("dof_damping",),
    fields=fields,
    step=step,
    steps_with="slow",
)
