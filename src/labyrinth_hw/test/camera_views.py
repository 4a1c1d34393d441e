# SPDX-License-Identifier: Apache-2.0
"""Views of the emulated rig to test trackers on: lenses, layouts, places where a ball can lie."""

import numpy as np
import pytest
from numpy.typing import NDArray

from labyrinth_hw.camera import Intrinsics
from labyrinth_hw.geometry import load_geometry
from labyrinth_hw.testbed.scene import Layout, Lens

PLAIN = Layout(
    board=(0.276, 0.231),
    walls=((0.05, 0.04, 0.15, 0.045), (0.1, 0.1, 0.105, 0.2), (0.18, 0.15, 0.276, 0.155)),
    holes=((0.06, 0.08), (0.2, 0.06), (0.14, 0.17)),
    path=((0.02, 0.02), (0.2, 0.1), (0.25, 0.2)),
)
CLOSE = Lens.at_height(0.25)  # wide lens, strong perspective
FAR = Lens.at_height(1.0)
CROOKED = Lens(
    focal=300, distortion=(-0.12, 0.02, 0.001, 0.0, 0.0), position=(0.01, 0.01, 0.26), turn=(0.03, -0.04, 0.1)
)  # fmt: skip
LENSES = [
    pytest.param(CLOSE, id="close"),
    pytest.param(FAR, id="far", marks=pytest.mark.study),
    pytest.param(CROOKED, id="crooked"),
]


def layout(name: str) -> Layout:
    """A BRIO layout where its figures are at hand, else a plain one."""
    geometry = load_geometry()
    return Layout.of(geometry, name) if geometry else PLAIN


def intrinsics(lens: Lens) -> Intrinsics:
    """The lens as a perfect calibration would find it."""
    (width, height), focal = lens.size, lens.focal
    return Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, lens.distortion)


def free_place(board: Layout, rng: np.random.Generator) -> NDArray[np.float64]:
    """(2,) m: where a ball can lie: clear of the walls and not over a hole."""
    walls, holes = np.array(board.walls), np.array(board.holes)
    while True:
        place = rng.uniform(board.ball_radius, np.array(board.board) - board.ball_radius)
        to_wall = np.linalg.norm(np.clip(place, walls[:, :2], walls[:, 2:]) - place, axis=1).min()
        to_hole = np.linalg.norm(holes - place, axis=1).min()
        if to_wall > board.ball_radius and to_hole > board.hole_radius:
            return place
