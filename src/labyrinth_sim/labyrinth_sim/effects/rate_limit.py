# SPDX-License-Identifier: Apache-2.0
"""Rate limit of the command."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import RateLimit
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

FREE = 200.0  # rad/s


def command(values: Values, site: Site, step: float, start: Array) -> RateLimit:
    return RateLimit(values["rate"], values["rate"] >= FREE, step, start)


EFFECT = Effect(
    name="rate_limit",
    title="Rate limit",
    physics="The servo's profile generator lets the target move no faster than a set speed.",
    equation="|du'/dt| <= r",
    parameters=(
        Parameter(
            "rate",
            "rad/s",
            0.05,
            FREE,
            FREE,
            0.5,
            "crawling to what hardly shows: a step of 1 rad takes 5 ms",
            fixed="bounds",
            span=20.0,
        ),
    ),
    stage="command",
    mark="Steps become ramps of the same slope whatever their size; small steps look undisturbed.",
    shows="passing",
    confused_with=(
        "torque_saturation",
        "supply_sag",
        "viscous_friction",
        "command_delay",
        "motion_profile",
        "duty_cut_back",
    ),
    separated_by="Steps of several sizes: a rate limit gives the same slope for all, saturation the same acceleration.",
    order=10,
    exact=True,
    command=command,
)
