# SPDX-License-Identifier: Apache-2.0
"""Stribeck friction: MuJoCo's frictionloss, set anew before every step."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.site import Site


def step(live: Live, site: Site, values: Values) -> None:
    slow = np.exp(-((live.qvel[:, site.dof] / values["speed"]) ** 2))
    live["dof_frictionloss"][:, site.dof] += values["extra"] * slow


EFFECT = Effect(
    name="stribeck_friction",
    title="Stribeck friction",
    physics="Breaking loose takes more torque than keeping on moving: friction falls as a film of grease builds up.",
    equation="F = F_s exp(-(speed / v_s)^2) on top of Coulomb friction; torque = -F sign(speed)",
    parameters=(
        Parameter("extra", "N m", 0.0, 1.0, 0.0, 0.2, "as large as Coulomb friction at most"),
        Parameter("speed", "rad/s", 0.01, 2.0, None, 0.1, "published values for gears lie between 0.01 and 1 rad/s"),
    ),
    stage="force",
    mark="Slow motion goes in jerks (stick-slip); friction is felt near reversals and gone at speed.",
    shows="loop",
    confused_with=("coulomb_friction", "dead_band", "load_friction", "backlash"),
    separated_by="Triangles at several speeds: Stribeck's friction falls with speed, Coulomb's does not.",
    touches=("dof_frictionloss",),
    step=step,
)
