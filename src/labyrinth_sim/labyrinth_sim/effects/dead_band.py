# SPDX-License-Identifier: Apache-2.0
"""Dead band of the position law."""

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state


@law
def error(raw: int) -> None:
    s = state(raw)
    half, error = s.values[0], s.error[s.channel]
    s.error[s.channel] = error - min(max(error, -half), half)


EFFECT = Effect(
    name="dead_band",
    title="Dead band",
    physics="The servo ignores errors below its compliance margin.",
    equation="e' = e - clip(e, -w, w)",
    parameters=(
        Parameter(
            "half_width", "rad", 0.0, 0.4, 0.0, 0.01, "0 to 23 deg; a compliance margin is some ticks", span=0.05
        ),
    ),
    stage="drive",
    mark="The axis stops short of its target by a fixed angle on the side it came from; small commands do nothing.",
    shows="loop",
    confused_with=(
        "coulomb_friction",
        "backlash",
        "command_quantisation",
        "stribeck_friction",
        "load_friction",
        "lugre_friction",
    ),
    separated_by="Hold a target and look at the effort: friction leaves the motor pushing, a dead band leaves it idle.",
    error=error,
)
