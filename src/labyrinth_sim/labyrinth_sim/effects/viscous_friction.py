# SPDX-License-Identifier: Apache-2.0
"""Viscous friction, by MuJoCo's joint damping."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields["dof_damping"][:, site.dof] += values["damping"]


EFFECT = Effect(
    name="viscous_friction",
    title="Viscous friction",
    physics="A torque proportional to speed opposes motion: grease, air, eddy currents.",
    equation="torque = -B speed",
    parameters=(
        Parameter("damping", "N m s/rad", 0.0, 3.0, 0.0, 0.5, "0 to what halves a small servo's speed at stall torque"),
    ),
    stage="mjcf",
    mark="The lag behind a ramp grows with its speed; it vanishes at rest.",
    shows="passing",
    confused_with=(
        "torque_saturation",
        "sensor_lag",
        "supply_sag",
        "direction_viscous_friction",
        "rate_limit",
        "motion_profile",
    ),
    separated_by="Ramps of several speeds: viscous lag grows in proportion, saturation sets in at once.",
    fields=fields,
)
