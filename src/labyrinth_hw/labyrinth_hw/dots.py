# SPDX-License-Identifier: Apache-2.0
"""The blue dots: where they are on the rig, and where a picture shows blue ones."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labyrinth_hw.camera import Array, Frame, locked
from labyrinth_hw.errors import InputError

SLOTS = ("inner lower left", "inner lower right", "inner upper right", "inner upper left",
         "outer lower left", "outer lower right", "outer upper right", "outer upper left")  # fmt: skip


@dataclass(frozen=True)
class DotPlan:
    """Where the dots are, m, in the board's frame (origin: lower left corner of the inner board) when it is level.

    Attributes:
        board: (2,) size of the inner board; it turns about its centre.
        inner: (4, 3) dots on the board; outer: (4, 3) dots on the box; both from lower left counter-clockwise.
        diameter: of a dot.
    """

    board: Array
    inner: Array
    outer: Array
    diameter: float = 0.008

    def __post_init__(self) -> None:
        for name, shape in (("board", (2,)), ("inner", (4, 3)), ("outer", (4, 3))):
            value = locked(getattr(self, name))
            if value.shape != shape:
                raise InputError(f"DotPlan.{name} must have shape {shape}, got {value.shape}.")
            object.__setattr__(self, name, value)

    @staticmethod
    def from_sizes(
        board: tuple[float, float] = (0.276, 0.231),
        inner: tuple[float, float] = (0.2835, 0.2385),
        outer: tuple[float, float] = (0.325, 0.280),
        height: float = 0.0065,
    ) -> "DotPlan":
        """Two rectangles of dots about the board's centre, `height` above its floor."""
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2
        rows = [np.column_stack([corners * size + np.array(board) / 2, np.full(4, height)]) for size in (inner, outer)]
        return DotPlan(np.array(board), rows[0], rows[1])

    @property
    def pivot(self) -> Array:
        """(3,) the point that both axes run through."""
        return np.array([*self.board / 2, 0.0])


@dataclass(frozen=True)
class DotFinder:
    """Finds blue blobs. Blue means that the blue channel stands out over both others, whatever the light's level.

    Attributes:
        contrast: share of the bluest dots' excess of blue at which a blob's rim is drawn.
        least: excess of blue over red and green, grey levels, below which nothing is a dot.
        area: smallest and largest blob, px.
    """

    contrast: float = 0.4
    least: int = 18
    area: tuple[int, int] = (8, 900)

    def find(self, frame: Frame) -> tuple[Array, Array]:
        """Centres of blue blobs in a BGR picture, by blueness: (n, 2) px of whole dots, (k, 2) px of doubtful ones.

        Doubtful are blobs cut by the picture's edge and those much larger or smaller than most: two dots in one, or
        a slice of one. At most 12 of either kind, largest first.
        """
        blue, green, red = cv2.split(frame)
        excess = cv2.subtract(blue, cv2.max(green, red))
        excess = cv2.blur(excess, (3, 3))
        threshold = max(self.least, self.contrast * float(cv2.minMaxLoc(excess)[1]))
        mask = cv2.threshold(excess, threshold, 255, cv2.THRESH_BINARY)[1]
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        x, y, width, height, areas = stats[1:].T
        inside = (x > 0) & (y > 0) & (x + width < frame.shape[1]) & (y + height < frame.shape[0])
        blobs = (areas >= self.area[0]) & (areas <= self.area[1])
        whole = blobs & inside
        if whole.any():
            typical = np.median(areas[whole])
            whole &= (areas > 0.5 * typical) & (areas < 1.6 * typical)
        kinds = []
        for kind in (whole, blobs & ~whole):
            chosen = sorted((int(i) for i in np.flatnonzero(kind)), key=lambda i: -int(areas[i]))[:12]
            kinds.append(np.array([self._centre(excess, labels, stats[i + 1], i + 1) for i in chosen]).reshape(-1, 2))
        return kinds[0], kinds[1]

    @staticmethod
    def _centre(excess: Frame, labels: NDArray[np.int32], box: NDArray[np.int32], label: int) -> tuple[float, float]:
        x, y, width, height = (int(n) for n in box[:4])
        x0, y0 = max(x - 2, 0), max(y - 2, 0)  # the soft rim belongs to the dot
        part = (slice(y0, y + height + 2), slice(x0, x + width + 2))
        own = (labels[part] == 0) | (labels[part] == label)
        moments = cv2.moments(np.where(own, excess[part], 0).astype(np.float32))
        return x0 + moments["m10"] / moments["m00"], y0 + moments["m01"] / moments["m00"]


def counter_clockwise(points: Array) -> Array | None:
    """(4, 2) in the order lower left, lower right, upper right, upper left of the picture; None if not convex."""
    centre = points.mean(0)
    angle = np.arctan2(-(points[:, 1] - centre[1]), points[:, 0] - centre[0])  # picture y runs down
    ordered = points[np.argsort(angle)]  # from -pi: lower left first
    edges = np.roll(ordered, -1, 0) - ordered
    turn = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
    return ordered if (turn < 0).all() else None
