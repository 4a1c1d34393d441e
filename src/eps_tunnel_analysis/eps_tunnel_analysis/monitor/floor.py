# SPDX-License-Identifier: Apache-2.0
"""The board from above, read off the compiled model."""

import mujoco
import numpy as np

from eps_tunnel_analysis.monitor.parts import Floor, Rig
from labyrinth_sim.build import compiled
from labyrinth_sim.model import Model

HOLE = "hole_"


def rig_of(model: Model) -> Rig:
    """The rig as the page shows it."""
    axes = tuple(m.signal for a in model.rig.axes for m in a.measured if m.quantity == "position")
    reach = max(max(map(abs, a.limits)) for a in model.rig.axes)
    floor = floor_of(model)
    loads = [m.signal for a in model.rig.axes for m in a.measured if (m.joint, m.quantity) == (a.load, "position")]
    tilt = (loads[0], loads[1]) if floor is not None and len(loads) == 2 else None
    return Rig(model.rig.name, axes, reach, tilt, floor)


def floor_of(model: Model) -> Floor | None:
    """Walls are the boxes of the body that carries the ball's frame, holes its sites `hole_*`; None without a ball."""
    if model.rig.ball is None:
        return None
    mj = compiled(model, with_ball=True).mj
    frame = mj.site(model.rig.ball.site)
    origin, body = frame.pos[:2], int(frame.bodyid[0])
    boxes = []
    for i in np.flatnonzero((mj.geom_bodyid == body) & (mj.geom_type == mujoco.mjtGeom.mjGEOM_BOX)):
        middle, half = mj.geom_pos[i][:2] - origin, mj.geom_size[i][:2]
        boxes.append((middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1]))
    holes = [mj.site(i) for i in range(mj.nsite) if mj.site(i).name.startswith(HOLE) and mj.site_bodyid[i] == body]
    ball = mj.joint(model.rig.ball.joint)
    radius = float(mj.geom_size[mj.body(int(ball.bodyid[0])).geomadr[0]][0])
    # The frame's origin is the board's corner, and the body turns about the board's centre.
    size = tuple(float(v) for v in -2 * origin) if (origin < 0).all() else _reach(boxes)
    return Floor(
        size=(size[0], size[1]),
        walls=tuple(tuple(round(float(v), 5) for v in box) for box in boxes),  # type: ignore[misc]
        holes=tuple((round(float(h.pos[0] - origin[0]), 5), round(float(h.pos[1] - origin[1]), 5)) for h in holes),
        hole_radius=float(holes[0].size[0]) if holes else 0.0,
        ball_radius=radius,
    )


def _reach(boxes: list[tuple[float, float, float, float]]) -> tuple[float, float]:
    return (max((b[1] for b in boxes), default=0.3), max((b[3] for b in boxes), default=0.3))
