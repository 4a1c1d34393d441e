# SPDX-License-Identifier: Apache-2.0
"""Rolling friction, by MuJoCo's contacts with six dimensions."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    radius = float(fields.model.geom_size[site.ball_geom, 0])
    # MuJoCo raises a coefficient of 0 to 1e-5 m, so only contacts without that dimension have none.
    fields["geom_condim"][:, site.ball_geom] = np.where(values["coefficient"] > 0, 6, 3)
    fields["geom_friction"][:, site.ball_geom, 2] = values["coefficient"] * radius


EFFECT = Effect(
    name="rolling_friction",
    title="Rolling friction",
    physics="Ball and floor yield where they touch, which slows the rolling ball by a constant force.",
    equation="torque <= c r times the force on the contact, against the spin; the ball slows by c g 5/7",
    parameters=(
        Parameter(
            "coefficient", "1", 0.0, 0.05, 0.0, 0.01, "steel on wood rolls with 0.002 to 0.02; MuJoCo's least is 0.0016"
        ),
    ),
    stage="mjcf",
    mark="The ball does not start below a certain tilt and loses the same speed every second.",
    shows="calmer",
    confused_with=(
        "board_not_level",
        "camera_latency",
        "camera_scale",
        "restitution",
    ),
    separated_by="Let it roll back and forth at one tilt: friction slows both ways, a board that is not level helps "
    "one of them.",
    where="ball",
    fields=fields,
)
