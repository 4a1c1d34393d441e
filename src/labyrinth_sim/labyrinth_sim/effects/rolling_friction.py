# SPDX-License-Identifier: Apache-2.0
"""Rolling friction of the ball."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.site import Site

CREEP = 0.3  # rad/s; below, the torque fades, so that a ball at rest stays without chatter


def step(live: Live, site: Site, values: Values) -> None:
    mj, dofs = live.model, slice(site.ball_dof + 3, site.ball_dof + 6)
    spin = live.qvel[:, dofs]
    speed = np.sqrt(spin[:, 0] ** 2 + spin[:, 1] ** 2 + spin[:, 2] ** 2)
    weight = float(mj.body_mass[site.ball_body]) * float(np.linalg.norm(mj.opt.gravity))
    torque = values["coefficient"] * weight * float(mj.geom_size[site.ball_geom, 0])
    live.applied[:, dofs] -= (torque / np.maximum(speed, CREEP))[:, None] * spin


EFFECT = Effect(
    name="rolling_friction",
    title="Rolling friction",
    physics="Ball and floor yield where they touch, which slows the rolling ball by a constant force.",
    equation="torque = c m g r against the spin; the ball slows by c g 5/7",
    parameters=(Parameter("coefficient", "1", 0.0, 0.05, 0.0, 0.01, "steel on wood rolls with 0.002 to 0.02"),),
    stage="force",
    mark="The ball does not start below a certain tilt and loses the same speed every second.",
    shows="calmer",
    confused_with=("board_not_level", "camera_latency", "camera_scale"),
    separated_by="Let it roll to and fro at one tilt: friction slows both ways, a board that is not level helps one of "
    "them.",
    where="ball",
    step=step,
)
