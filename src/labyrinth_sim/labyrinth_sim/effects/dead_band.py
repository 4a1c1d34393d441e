# SPDX-License-Identifier: Apache-2.0
"""Dead band of the position law."""

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state


@law
def error(raw: int) -> None:
    s = state(raw)
    half, jump, error = s.values[0], s.values[1], s.error[s.channel]
    beyond = abs(error) > half or error != error  # no number where the drive is off
    s.error[s.channel] = error - (1.0 - jump) * min(max(error, -half), half) if beyond else 0.0


EFFECT = Effect(
    name="dead_band",
    title="Dead band",
    physics="The servo ignores errors below its compliance margin. Beyond it the error counts from the margin on, or, "
    "where the firmware adds a punch, jumps by a share of it.",
    equation="e' = 0 while |e| <= w, else e - (1 - j) w sign(e)",
    parameters=(
        Parameter(
            "half_width", "rad", 0.0, 0.4, 0.0, 0.01, "0 to 23 deg; a compliance margin is some ticks", span=0.05
        ),
        Parameter(
            "jump", "1", 0.0, 1.0, None, 0.0, "0 where the error counts from the margin on, 1 in full", settled=True
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
