# SPDX-License-Identifier: Apache-2.0
"""Restitution of the ball."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site

# A contact is a spring with a damper that does not pull, so it ends when its force is zero and not its depth: at a
# damping ratio cos(a) the ball keeps exp(-2 a / tan(a)) of its speed (Schwager and Poeschel, 2007). The MJCF's own
# contact is damped critically and leaves exp(-2).
ANGLE = np.linspace(1e-6, np.pi / 2, 2001)
BOUNCE = np.exp(-2.0 * ANGLE / np.tan(ANGLE))


def fields(fields: Fields, site: Site, values: Values) -> None:
    damping = np.cos(np.interp(values["coefficient"], BOUNCE, ANGLE, left=0.0))
    # The same stiffness at any damping: the time constant of solref grows as the damping ratio falls.
    fields["geom_solref"][:, site.ball_geom, 0] /= damping
    fields["geom_solref"][:, site.ball_geom, 1] *= damping


EFFECT = Effect(
    name="restitution",
    title="Restitution",
    physics="The ball bounces off walls with part of its speed.",
    equation="speed after = -max(e, 0.135) speed before, across the contact, before the ball's spin brakes it",
    parameters=(Parameter("coefficient", "1", 0.0, 0.9, 0.0, 0.5, "steel on wood bounces with 0.3 to 0.7"),),
    stage="mjcf",
    mark="The ball comes back from walls instead of staying at them.",
    shows="passing",
    confused_with=("rolling_friction",),
    separated_by="Roll the ball straight at a wall at two tilts and compare the speeds before and after.",
    where="ball",
    fields=fields,
)
