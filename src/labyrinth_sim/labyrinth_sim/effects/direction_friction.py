# SPDX-License-Identifier: Apache-2.0
"""Direction-dependent friction: a symmetric part by MuJoCo's frictionloss and a constant torque where it is
sharp, joint damping rewritten before every step where not."""

import numpy as np

from labyrinth_sim.effect import Effect, Values
from labyrinth_sim.friction import EITHER_WAY, SLOW, gradual_damping, sharp
from labyrinth_sim.law import law, state
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    half = sharp(values) / 2
    fields["dof_frictionloss"][:, site.dof] += np.abs(half)
    fields.torque[:, site.dof] -= half


@law
def step(raw: int) -> None:
    s = state(raw)
    if s.qvel[s.dof] * s.values[0] > 0.0:
        s.damping[s.dof] += gradual_damping(abs(s.values[0]), s.qvel[s.dof], s.values[1])


EFFECT = Effect(
    name="direction_friction",
    title="Direction-dependent friction",
    physics="Teeth and bearings rub more in one direction of turning than in the other.",
    equation="F = T for speed > 0 and 0 for speed < 0 if T > 0; the other way round if T < 0; "
    "T tanh(|speed| / v_c) if it sets in gradually",
    parameters=(
        EITHER_WAY,
        SLOW,
    ),
    stage="mjcf",
    mark="The axis stops short of its target coming from one side only.",
    shows="one_sided",
    confused_with=(
        "coulomb_friction",
        "gravity_load",
        "load_friction",
        "sensor_bias",
        "directional_load_friction",
        "constant_torque",
        "direction_viscous_friction",
        "lugre_friction",
        "backlash",
    ),
    separated_by="Slow triangles about several positions: the difference between up and down stays, that of a "
    "gravity load "
    "changes.",
    touches=("dof_damping",),
    fields=fields,
    step=step,
    steps_with="slow",
)
