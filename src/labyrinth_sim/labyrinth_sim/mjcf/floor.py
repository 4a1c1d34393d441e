# SPDX-License-Identifier: Apache-2.0
"""A floor with round holes out of convex pieces, since MuJoCo subtracts no shapes.

Every hole sits in a square patch of wedges around a regular polygon; the rest of the floor is tiled by rectangles. All
tops are coplanar. Where pieces meet, each reaches BEVEL_WIDTH under its neighbour, sloping down by BEVEL_SLOPE: a ball
pressed into one piece would otherwise catch the edge of the next (docs/decisions/labyrinth_mjcf.md).
"""

import math
from dataclasses import dataclass

import numpy as np

from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

POLYGON_SIDES = 12
PATCH_MARGIN = 0.004  # m from the polygon to the edge of its patch
BEVEL_WIDTH = 0.0035  # m, less than PATCH_MARGIN
BEVEL_SLOPE = 0.0005


@dataclass(frozen=True)
class Piece:
    """A convex piece of floor, its top at z = 0.

    Attributes:
        top: (n, 2) m, corners of the flat top, counter-clockwise.
        foot: (m, 2) m, corners at the end of the bevel, where the vertical sides begin.
    """

    top: Array
    foot: Array

    def vertices(self, thickness: float) -> Array:
        """(n + 2 m, 3) m: top, end of the bevel, underside at z = -thickness."""
        levels = ((self.top, 0.0), (self.foot, -BEVEL_SLOPE * BEVEL_WIDTH), (self.foot, -thickness))
        return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for flat, z in levels])


def polygon_inradius(radius: float, sides: int = POLYGON_SIDES) -> float:
    """Inner radius of the regular polygon whose edge deviates from the circle as much inwards as outwards, m.

    The deviation is `radius - polygon_inradius(radius)`: 0.12 mm for a 7 mm hole with 12 sides, half of the 0.25 mm to
    which the centres of the holes are known.
    """
    return 2 * radius / (1 + 1 / math.cos(math.pi / sides))


def floor_tiles(low: Array, high: Array, holes: Array, radius: float) -> list[Piece]:
    """Tiles that cover the rectangle from `low` to `high`, (2,) m each, but for the patches of `holes`, (n, 2) m.

    Raises:
        InputError: holes so close to one another that their patches overlap.
    """
    half = polygon_inradius(radius) + PATCH_MARGIN
    apart = np.abs(holes[:, None] - holes[None, :]).max(axis=-1) + np.eye(len(holes))
    if len(holes) and apart.min() < 2 * half:
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        needed = f"at least {2e3 * half:.1f} mm along x or y are needed"
        raise InputError(f"Holes {i + 1} and {j + 1} are {1e3 * apart.min():.1f} mm apart; {needed}.")
    pieces = []
    for x0, x1, y0, y1 in _rectangles(low, high, holes, half):
        top = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        pieces.append(Piece(top, _outset(top, [BEVEL_WIDTH] * 4)))
    return pieces


def hole_wedges(radius: float, sides: int = POLYGON_SIDES) -> list[Piece]:
    """The pieces of one patch, around a hole at the origin.

    Args:
        radius: of the hole, m.
        sides: of the polygon; 12, 20, 28, ... so that the patch's corners are corners of wedges.
    """
    inner = polygon_inradius(radius, sides)
    half = inner + PATCH_MARGIN
    outer_radius = inner / math.cos(math.pi / sides)
    angles = (np.arange(sides + 1) - 0.5) * 2 * math.pi / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    square = ring * half / np.abs(ring).max(axis=1, keepdims=True)
    pieces = []
    for i in range(sides):
        top = np.array([ring[i] * outer_radius, square[i], square[i + 1], ring[i + 1] * outer_radius])
        # The last side is the hole's edge: sharp. Acute corners must not reach into the next hole.
        foot = _outset(top, [BEVEL_WIDTH] * 3 + [0.0])
        for normal in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            foot = _cut(foot, np.array(normal), half + BEVEL_WIDTH)
        pieces.append(Piece(top, foot))
    return pieces


def _outset(polygon: Array, by: list[float]) -> Array:
    """(n, 2) corners of a convex polygon whose sides were moved outwards; side i starts at corner i."""
    sides = np.roll(polygon, -1, axis=0) - polygon
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1, keepdims=True)
    offsets = (normals * polygon).sum(axis=1) + np.array(by)
    corners = [np.linalg.solve(normals[[i - 1, i]], offsets[[i - 1, i]]) for i in range(len(polygon))]
    return np.array(corners)


def _cut(polygon: Array, normal: Array, limit: float) -> Array:
    """(m, 2) corners of the part of a convex polygon where normal . x <= limit (Sutherland and Hodgman's clipping)."""
    corners = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        over_a, over_b = float(normal @ a) - limit, float(normal @ b) - limit
        if over_a <= 0:
            corners.append(a)
        if over_a * over_b < 0:
            corners.append(a + over_a / (over_a - over_b) * (b - a))
    return np.array(corners)


def _rectangles(low: Array, high: Array, holes: Array, half: float) -> list[tuple[float, float, float, float]]:
    """Partition of a rectangle minus squares into x0, x1, y0, y1, the largest free one first."""
    lines = []
    for axis in (0, 1):
        cuts = np.concatenate([[low[axis], high[axis]], holes[:, axis] - half, holes[:, axis] + half])
        lines.append(np.unique(np.round(cuts, 9)))
    xs, ys = lines
    mid_x, mid_y = (xs[:-1] + xs[1:]) / 2, (ys[:-1] + ys[1:]) / 2
    free = np.ones((len(mid_x), len(mid_y)), dtype=bool)
    for hx, hy in holes:
        free &= ~((np.abs(mid_x - hx) < half)[:, None] & (np.abs(mid_y - hy) < half)[None, :])
    rectangles = []
    while free.any():
        i0, i1, j0, j1 = _largest(free, xs, ys)
        free[i0:i1, j0:j1] = False
        rectangles.append((float(xs[i0]), float(xs[i1]), float(ys[j0]), float(ys[j1])))
    return rectangles


def _largest(free: np.ndarray, xs: Array, ys: Array) -> tuple[int, int, int, int]:
    """Index bounds i0, i1, j0, j1 of the free rectangle of largest area."""
    best, bounds = 0.0, (0, 0, 0, 0)
    for i0 in range(free.shape[0]):
        columns = np.ones(free.shape[1], dtype=bool)
        for i1 in range(i0 + 1, free.shape[0] + 1):
            columns &= free[i1 - 1]
            if not columns.any():
                break
            steps = np.flatnonzero(np.diff(np.concatenate([[False], columns, [False]]).astype(int)))
            for j0, j1 in zip(steps[::2], steps[1::2], strict=True):
                area = float((xs[i1] - xs[i0]) * (ys[j1] - ys[j0]))
                if area > best * (1 + 1e-9):
                    best, bounds = area, (i0, i1, int(j0), int(j1))
    return bounds
