# SPDX-License-Identifier: Apache-2.0
"""Lenses of OCamCalib: their file, their rays, and pictures made straight for the trackers."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_views import CLOSE, intrinsics, layout

from labyrinth_hw.errors import InputError
from labyrinth_hw.landmarks import DotPlan, LandmarkTracker
from labyrinth_hw.ocam import OCamLens
from labyrinth_hw.settings import CameraSettings
from labyrinth_hw.testbed.renderer import Renderer
from labyrinth_hw.testbed.scene import Scene
from labyrinth_hw.vision import lens_of

SIZE = (900, 560)  # px of the made-up wide camera
FOCAL = 260.0
CENTRE = (281.0, 452.0)  # row, column


def bend(distance: np.ndarray) -> np.ndarray:
    """f(rho) of a barrel lens, px."""
    return np.asarray(-FOCAL + 6e-4 * distance**2)


def written(path: Path, direct: str = "", rows: str = "560 900") -> Path:
    """The lens's file."""
    distance = np.linspace(0, 560, 400)
    elevation = np.arctan2(bend(distance), distance)
    inverse = np.polynomial.Polynomial.fit(elevation, distance, 9).convert().coef
    text = [
        "#polynomial coefficients", direct or f"3 {-FOCAL} 0 6e-4", "#inverse",
        f"{len(inverse)} " + " ".join(f"{c:.12g}" for c in inverse), "#centre", f"{CENTRE[0]} {CENTRE[1]}",
        "#affine", "1.001 0.0004 -0.0002", "#size", rows,
    ]  # fmt: skip
    path.write_text("\n\n".join(text) + "\n")
    return path


def test_a_ray_goes_through_its_pixel_and_back(tmp_path: Path) -> None:
    lens = OCamLens.load(written(tmp_path / "lens.txt"))
    pixels = np.array([[452.0, 281.0], [452.0 + 100.0, 281.0], [30.0, 500.0]])
    rays = lens.rays(pixels)
    assert rays[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    assert rays[1, 0] / rays[1, 2] == pytest.approx(100.0 / (FOCAL - 6.0), rel=2e-3), "to the right is +x"
    assert rays[2, 0] < 0.0 < rays[2, 1], "down is +y"
    assert lens.project(rays) == pytest.approx(pixels, abs=0.5)


def test_the_board_is_found_in_a_picture_made_straight(tmp_path: Path) -> None:
    settings = CameraSettings(
        source="0", ocam=str(written(tmp_path / "lens.txt")), size=CLOSE.size, field_of_view_deg=95.6, latency=0.02
    )
    lens, pinhole, truth = OCamLens.load(settings.ocam or ""), lens_of(settings), intrinsics(CLOSE)
    assert pinhole.latency == 0.02
    tilt = (0.05, -0.07)
    straight = Renderer(layout("hard"), CLOSE).render(Scene(tilt=tilt))
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = lens.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    at = rays[:, :2] / rays[:, 2:] * truth.fx + (truth.cx, truth.cy)  # what the wide lens sees of the straight picture
    bent = cv2.remap(straight, at.astype(np.float32).reshape(*SIZE[::-1], 2), None, cv2.INTER_LINEAR)
    pose = LandmarkTracker(DotPlan.from_sizes(), pinhole).update(lens.straight(bent, pinhole))
    assert pose is not None
    assert pose.tilt == pytest.approx(tilt, abs=4e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"direct": "4 -260 0 6e-4"}, "expected 4 coefficients, got 3"),
        ({"direct": "3 -200 0 6e-4"}, "miss each other"),
        ({"rows": "560"}, "five lines of numbers"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, change: dict[str, str], words: str) -> None:
    with pytest.raises(InputError, match=words):
        OCamLens.load(written(tmp_path / "lens.txt", **change))


def test_a_picture_of_another_size_is_refused(tmp_path: Path) -> None:
    lens = OCamLens.load(written(tmp_path / "lens.txt"))
    with pytest.raises(InputError, match="file is for 900 x 560"):
        lens.straight(np.zeros((560, 640, 3), np.uint8), lens.pinhole(640, 360, 90.0))
