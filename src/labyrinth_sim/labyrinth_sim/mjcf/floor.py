# SPDX-License-Identifier: Apache-2.0
"""A floor with round holes out of boxes, since MuJoCo subtracts no shapes.

Every hole gets a square cut-out, the rest of the floor is tiled by rectangles, and turned boxes fill the corners of each
square up to a regular polygon. All tops are coplanar.
"""

import math
from dataclasses import dataclass

import numpy as np

from labyrinth_sim.trials import Array

POLYGON_SIDES = 12


@dataclass(frozen=True)
class Tile:
    """A rectangle of floor: centre and half sizes in m, turned by `angle` rad about z."""

    x: float
    y: float
    half_x: float
    half_y: float
    angle: float = 0.0


def polygon_inradius(radius: float, sides: int = POLYGON_SIDES) -> float:
    """Inner radius of the regular polygon whose edge deviates from the circle as much inwards as outwards, m.

    The deviation is `radius - polygon_inradius(radius)`: 0.12 mm for a 7 mm hole with 12 sides, half of the 0.25 mm to
    which the centres of the holes are known.
    """
    return 2 * radius / (1 + 1 / math.cos(math.pi / sides))


def floor_tiles(low: Array, high: Array, holes: Array, radius: float, sides: int = POLYGON_SIDES) -> list[Tile]:
    """Tiles that cover the rectangle from `low` to `high`, (2,) m each, but for holes at `holes`, (n, 2) m.

    Args:
        radius: of the holes, m.
        sides: of the polygons; a multiple of 4.
    """
    inner = polygon_inradius(radius, sides)
    tiles = _rectangles(low, high, holes, inner)
    for centre in holes:
        tiles += _corners(float(centre[0]), float(centre[1]), inner, sides)
    return tiles


def _corners(x: float, y: float, inner: float, sides: int) -> list[Tile]:
    """Boxes tangent to the inner circle, between the four sides that the square itself gives."""
    pitch = 2 * math.pi / sides
    tiles = []
    for i in range(sides):
        if i % (sides // 4) == 0:
            continue
        angle = i * pitch
        # From the tangent out to the corner of the square, and as wide as to reach it from the polygon's far vertex.
        corner = (math.floor(angle / (math.pi / 2)) + 0.5) * math.pi / 2 - angle
        reach = [(inner, inner * math.tan(s * pitch / 2)) for s in (-1, 1)]
        reach.append((math.sqrt(2) * inner * math.cos(corner), math.sqrt(2) * inner * math.sin(corner)))
        u0, u1 = inner, max(u for u, _ in reach)
        v0, v1 = min(v for _, v in reach), max(v for _, v in reach)
        u, v = (u0 + u1) / 2, (v0 + v1) / 2
        cos, sin = math.cos(angle), math.sin(angle)
        tiles.append(Tile(x + u * cos - v * sin, y + u * sin + v * cos, (u1 - u0) / 2, (v1 - v0) / 2, angle))
    return tiles


def _rectangles(low: Array, high: Array, holes: Array, half: float) -> list[Tile]:
    """Partition of a rectangle minus squares: again and again the largest rectangle of free cells."""
    edges = []
    for axis in (0, 1):
        lines = np.concatenate([[low[axis], high[axis]], holes[:, axis] - half, holes[:, axis] + half])
        edges.append(np.unique(np.round(lines, 9)))
    xs, ys = edges
    mid_x, mid_y = (xs[:-1] + xs[1:]) / 2, (ys[:-1] + ys[1:]) / 2
    free = np.ones((len(mid_x), len(mid_y)), dtype=bool)
    for hx, hy in holes:
        free &= ~((np.abs(mid_x - hx) < half)[:, None] & (np.abs(mid_y - hy) < half)[None, :])
    tiles = []
    while free.any():
        i0, i1, j0, j1 = _largest(free, xs, ys)
        free[i0:i1, j0:j1] = False
        x0, x1, y0, y1 = xs[i0], xs[i1], ys[j0], ys[j1]
        tiles.append(Tile(*(float(v) for v in ((x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2))))
    return tiles


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
