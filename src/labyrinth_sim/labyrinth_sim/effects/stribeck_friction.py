# SPDX-License-Identifier: Apache-2.0
"""Stribeck friction: MuJoCo's frictionloss, rewritten before every step."""

import math

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state


@law
def step(raw: int) -> None:
    s = state(raw)
    extra, slow = s.values[0], s.qvel[s.dof] / s.values[1]
    s.frictionloss[s.dof] += extra * math.exp(-(slow**2))


EFFECT = Effect(
    name="stribeck_friction",
    title="Stribeck friction",
    physics="Breaking loose takes more torque than keeping on moving: friction falls as a film of grease builds up.",
    equation="F = F_s exp(-(speed / v_s)^2) on top of Coulomb friction; torque = -F sign(speed)",
    parameters=(
        Parameter("extra", "N m", 0.0, 3.0, 0.0, 0.2, "at most as large as Coulomb friction", span=1.0),
        Parameter(
            "speed", "rad/s", 0.01, 20.0, None, 0.1, "0.01 to 1 rad/s for gears as published; far above it is Coulomb's"
        ),
    ),
    stage="force",
    mark="Slow motion goes in jerks (stick-slip); friction is felt near reversals and gone at speed.",
    shows="loop",
    confused_with=(
        "coulomb_friction",
        "dead_band",
        "load_friction",
        "backlash",
        "lugre_friction",
    ),
    contains=(("extra", "coulomb_friction", "torque"), ("speed", "coulomb_friction", 20.0)),
    separated_by="Triangles at several speeds: Stribeck's friction falls with speed, Coulomb's does not.",
    touches=("dof_frictionloss",),
    step=step,
)
