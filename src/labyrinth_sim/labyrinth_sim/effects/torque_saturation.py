# SPDX-License-Identifier: Apache-2.0
"""Torque (duty) saturation."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    current, duty = fields["jnt_actfrcrange"][:, site.joint], fields["actuator_forcerange"][:, site.actuator]
    share = values["share"][:, None]
    # Of a drive that knows no current the duty is limited, and back-EMF takes its part of what that leaves.
    knows = current[:, 1:] > 0.0
    least = np.where(current[:, 1:] < duty[:, 1:], current, duty)
    current[...] = np.where(knows & (share < 1.0), share * least, current)
    duty *= np.where(knows, 1.0, share)


EFFECT = Effect(
    name="torque_saturation",
    title="Torque (duty) saturation",
    physics="The drive's current, and with it its torque, is limited below what the motor could give; in a drive "
    "modelled without a current, the duty is limited.",
    equation="|torque| <= s torque_max; of a drive that knows no current, |duty| <= s",
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
