# SPDX-License-Identifier: Apache-2.0
"""Supply sag."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.site import Site

LEAST = 0.02  # of the full voltage


def step(live: Live, site: Site, values: Values) -> None:
    load = np.zeros_like(values["sag"])
    for _, other in live.drives:
        full = live.base["actuator_forcerange"][:, other.actuator, 1]
        load = load + np.abs(live.force[:, other.actuator]) / full
    drive, place = live.drives[site.channel]
    drive.supply(live, place, np.maximum(1.0 - values["sag"] * load, LEAST))


EFFECT = Effect(
    name="supply_sag",
    title="Supply sag",
    physics="The supply's voltage falls with the current that all motors draw, and with it the torque they can give.",
    equation="V' = V (1 - s sum_i |torque_i| / torque_max,i)",
    parameters=(
        Parameter(
            "sag", "1", 0.0, 0.98, 0.0, 0.8, "0 to a supply that nearly breaks down at the stall torque of one motor"
        ),
    ),
    stage="force",
    mark="Both axes moving at once are slower than either alone; large steps lose their top speed.",
    shows="passing",
    confused_with=("torque_saturation", "rate_limit", "viscous_friction"),
    separated_by="Step one axis alone, then both together: only sag makes the first slower because of the second.",
    touches=("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
    step=step,
)
