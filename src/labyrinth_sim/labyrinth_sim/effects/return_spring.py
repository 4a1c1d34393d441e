# SPDX-License-Identifier: Apache-2.0
"""Return spring, by the stiffness of MuJoCo's joint."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields["jnt_stiffness"][:, site.load_joint] += values["stiffness"]


EFFECT = Effect(
    name="return_spring",
    title="Return spring",
    physics="A spring, a cable or the belt itself pulls the load back to its zero position.",
    equation="torque = -k angle",
    parameters=(
        Parameter(
            "stiffness",
            "N m/rad",
            0.0,
            20.0,
            0.0,
            2.0,
            "0 to what holds a servo of this class back by a third of its torque at 3 deg",
        ),
    ),
    stage="mjcf",
    mark="The axis falls short of its target in proportion to the target, and returns faster than it leaves.",
    shows="scaled",
    confused_with=("gain_error", "sensor_gain", "gravity_load", "belt_compliance"),
    separated_by="Step away from zero and back to it: a spring makes the way out slower than the way back, a "
    "gain error "
    "does not.",
    fields=fields,
)
