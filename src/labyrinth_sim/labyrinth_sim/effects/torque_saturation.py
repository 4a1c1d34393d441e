# SPDX-License-Identifier: Apache-2.0
"""Torque (duty) saturation."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields["actuator_forcerange"][:, site.actuator] *= values["share"][:, None]


EFFECT = Effect(
    name="torque_saturation",
    title="Torque (duty) saturation",
    physics="The drive's torque or duty is limited below what the motor could give.",
    equation="|torque| <= s torque_max",
    parameters=(Parameter("share", "1", 0.005, 1.0, 1.0, 0.02, "a hundredth to all of the full torque"),),
    stage="mjcf",
    mark="Large steps accelerate and brake at a constant rate, small ones look undisturbed.",
    shows="passing",
    confused_with=(
        "rate_limit",
        "supply_sag",
        "viscous_friction",
        "motion_profile",
        "duty_cut_back",
    ),
    separated_by="Steps of several sizes: saturation gives them the same acceleration, a rate limit the same slope.",
    order=10,
    fields=fields,
)
