# SPDX-License-Identifier: Apache-2.0
"""Load-dependent friction: MuJoCo's frictionloss, set anew before every step."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.site import Site


def step(live: Live, site: Site, values: Values) -> None:
    dof = site.dof
    outside = live.passive[:, dof] - live.bias[:, dof]
    live["dof_frictionloss"][:, dof] += values["share"] * np.abs(live.actuator[:, dof] - outside)


EFFECT = Effect(
    name="load_friction",
    title="Load-dependent friction",
    physics="Teeth and bearings pressed harder rub harder: friction grows with the torque that the gear carries.",
    equation="F = mu |motor torque - load torque|; torque = -F sign(speed)",
    parameters=(
        Parameter("share", "1", 0.0, 0.45, 0.0, 0.15, "0 to just below 0.5, where a gear of this kind locks itself"),
    ),
    stage="force",
    mark="The axis stops short of its target by more where it carries more load; hardly any friction "
    "where it carries none.",
    shows="passing",
    confused_with=("coulomb_friction", "directional_load_friction", "direction_friction", "backlash", "gravity_load"),
    separated_by="Slow triangles about positions with high and with low load: the loop widens with the load.",
    touches=("dof_frictionloss",),
    step=step,
)
