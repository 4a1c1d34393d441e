# SPDX-License-Identifier: Apache-2.0
"""The ball on the labyrinth: where it is, whether and in which hole it was lost, and how it is put back.

Everything works on plain arrays with any leading shape, so that one simulation (`data.qpos`) and a batch (`batch.qpos`)
are served alike.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array, locked

ON_BOARD = -1
OVER_THE_RIM = 0


@dataclass(frozen=True)
class BallGame:
    """Ball and board of a compiled labyrinth model. Lengths in m, the board frame has its origin at the lower
    left corner of the inner board, on the floor.

    Attributes:
        pivot: (3,) world position of the gimbal's centre.
        origin: (3,) of the board frame, from the pivot.
        size: (2,) of the inner board.
        holes: (n, 2) centres in the board frame; hole number i is row i - 1.
        hole_radius, ball_radius: m.
        start: (2,) where the ball is supplied, board frame.
        tilt: indices of board_x and board_y in qpos.
        ball_qpos, ball_qvel: first index of the ball's free joint in qpos and in qvel.
    """

    pivot: Array
    origin: Array
    size: Array
    holes: Array
    hole_radius: float
    ball_radius: float
    start: Array
    tilt: tuple[int, int]
    ball_qpos: int
    ball_qvel: int

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "BallGame":
        """Reads joints, sites and geoms by name.

        Raises:
            InputError: the model has no labyrinth with a ball; all missing names are listed.
        """
        wanted = [("joint", name) for name in ("ball", "board_x", "board_y")]
        wanted += [("geom", "ball"), ("site", "board_origin"), ("body", "frame"), ("site", "hole_1")]
        missing = [
            f"The model has no {kind} '{name}', which a labyrinth with a ball needs."
            for kind, name in wanted
            if mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name) < 0
        ]
        if missing:
            raise InputError(missing)
        origin = model.site("board_origin").pos
        sites = [model.site(i) for i in range(model.nsite)]
        numbered = {int(site.name[5:]): site for site in sites if site.name.startswith("hole_")}
        pivot = model.body("frame").pos
        ball = model.joint("ball")
        start = model.qpos0[ball.qposadr[0] :][:2] - pivot[:2] - origin[:2]
        return cls(
            pivot=locked(pivot),
            origin=locked(origin),
            size=locked(-2 * origin[:2]),
            holes=locked([numbered[i].pos[:2] - origin[:2] for i in sorted(numbered)]),
            hole_radius=float(numbered[1].size[0]),
            ball_radius=float(model.geom("ball").size[0]),
            start=locked(start),
            tilt=(int(model.joint("board_x").qposadr[0]), int(model.joint("board_y").qposadr[0])),
            ball_qpos=int(ball.qposadr[0]),
            ball_qvel=int(ball.dofadr[0]),
        )

    def position(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 3) m, the ball's centre in the board frame; z is `ball_radius` where it lies on the floor.

        Args:
            qpos: (..., nq) joint positions.
        """
        world = qpos[..., self.ball_qpos : self.ball_qpos + 3] - self.pivot
        return np.asarray(np.einsum("...ji,...j->...i", self._rotation(qpos), world) - self.origin)

    def loss(self, position: NDArray[np.float64]) -> NDArray[np.int_]:
        """(...) where each ball was lost: ON_BOARD, a hole's number, or OVER_THE_RIM.

        A ball is lost once its centre is below the floor's upper side, or beyond the board. Ask at least every 20 ms:
        later the ball has left the hole's neighbourhood and counts as lost over the rim.

        Args:
            position: (..., 3) m in the board frame, from `position`.
        """
        flat = position[..., :2]
        distance = np.linalg.norm(flat[..., None, :] - self.holes, axis=-1)
        nearest = np.where(distance.min(axis=-1) < self.hole_radius + self.ball_radius, distance.argmin(axis=-1) + 1, 0)
        outside = ((flat < -self.ball_radius) | (flat > self.size + self.ball_radius)).any(axis=-1)
        below = position[..., 2] < 0.0
        where = np.where(below & ~outside, nearest, OVER_THE_RIM)
        return np.asarray(np.where(below | outside, where, ON_BOARD))

    def supply(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], at: ArrayLike | None = None) -> None:
        """Puts the ball at rest on the floor, at the present tilt: writes into `qpos` and `qvel`.

        Args:
            qpos: (..., nq), changed.
            qvel: (..., nv), changed.
            at: (..., 2) m in the board frame; the start of the path if omitted.
        """
        flat = np.asarray(self.start if at is None else at, dtype=np.float64)
        place = np.concatenate([flat, np.full((*flat.shape[:-1], 1), self.ball_radius)], axis=-1) + self.origin
        first = self.ball_qpos
        qpos[..., first : first + 3] = self.pivot + np.einsum("...ij,...j->...i", self._rotation(qpos), place)
        qpos[..., first + 3 : first + 7] = (1.0, 0.0, 0.0, 0.0)
        qvel[..., self.ball_qvel : self.ball_qvel + 6] = 0.0

    def _rotation(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 3, 3) board to world: the frame turns about x, the board in it about y."""
        a, b = qpos[..., self.tilt[0]], qpos[..., self.tilt[1]]
        ca, sa, cb, sb = np.cos(a), np.sin(a), np.cos(b), np.sin(b)
        rows = [[cb, 0.0 * a, sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
