# SPDX-License-Identifier: Apache-2.0
"""LuGre friction: bristles that bend before they slide, stepped implicitly in addition to MuJoCo's own joint
damping."""

import math

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.friction import TORQUE
from labyrinth_sim.law import law, state

BRISTLE_TIME = 1e-3  # s, damping over stiffness of the bristles


@law
def step(raw: int) -> None:
    """Implicit in the step to come, so that any stiffness is stable.

    With z' = (z + h v') / (1 + h |v| / z_s) after a step h the torque F' = s z' + d (z' - z) / h is linear in the
    coming speed v'. Its slope is joint damping, which MuJoCo takes at v', too; the rest is applied as it is.
    """
    s = state(raw)
    torque, bend, extra, slow = s.values[0], s.values[1], s.values[2], s.values[3]
    h, speed = s.step, s.qvel[s.dof]
    reach = bend * (1.0 + extra * math.exp(-((speed / slow) ** 2)))  # z_s, where the bristles slide at this speed
    slides = 1.0 + h * abs(speed) / reach
    bent = (s.memory[0] + h * speed) / s.memory[1] if s.memory[1] > 0.0 else 0.0
    s.memory[0], s.memory[1] = bent, slides
    stiffness = torque / bend
    damping = stiffness * BRISTLE_TIME
    whole = stiffness + damping / h
    s.damping[s.dof] += whole * h / slides
    s.applied[s.dof] -= (whole / slides - damping / h) * bent


EFFECT = Effect(
    name="lugre_friction",
    title="LuGre friction",
    physics="The surfaces touch by bristles that bend like springs before they slide, so that friction builds up over "
    "a small angle after each reversal and lets the axis creep where it should stick.",
    equation="dz/dt = speed - |speed| z / z_s, z_s = b (1 + e exp(-(speed / v_s)^2)); torque = -F/b (z + 1 ms dz/dt)",
    parameters=(
        TORQUE,
        Parameter(
            "bend", "rad", 1e-4, 0.5, None, 0.01, "angle over which friction builds up; gears take degrees, hoses more"
        ),
        Parameter("extra", "1", 0.0, 1.0, None, 0.0, "more at rest than in motion; 0 is Dahl's friction"),
        Parameter("speed", "rad/s", 0.01, 2.0, None, 0.1, "v_s; published values lie between 0.01 and 1 rad/s"),
    ),
    stage="force",
    mark="After each reversal the axis lags by an error that grows over a small angle, then stays; it creeps at rest.",
    shows="loop",
    confused_with=(
        "coulomb_friction",
        "stribeck_friction",
        "dead_band",
        "backlash",
        "load_friction",
        "direction_friction",
    ),
    contains=(
        ("torque", "coulomb_friction", "torque"),
        ("bend", "coulomb_friction", 1e-4),
        ("extra", "coulomb_friction", 0.0),
    ),
    separated_by="Slow triangles of small amplitude: bristles give soft loops that grow with the amplitude, Coulomb "
    "friction holds the axis altogether.",
    touches=("dof_damping",),
    step=step,
)
