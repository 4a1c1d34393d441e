# SPDX-License-Identifier: Apache-2.0
import secrets
from dataclasses import replace

import cv2
import numpy as np
import pytest
from camera_views import CLOSE, FAR, LENSES, intrinsics, layout

from labyrinth_hw.errors import InputError
from labyrinth_hw.landmarks import DotPlan, LandmarkTracker
from labyrinth_hw.testbed.renderer import Renderer
from labyrinth_hw.testbed.scene import Lens, Lighting, Scene

PLAN = DotPlan.from_sizes()


def true_pixels(renderer: Renderer, tilt: tuple[float, float], points: np.ndarray) -> np.ndarray:
    rotation, translation = renderer.board_pose(tilt)
    turn = cv2.Rodrigues(rotation)[0]
    return cv2.projectPoints(points, turn, translation, *intrinsics(renderer.lens).arrays())[0].reshape(-1, 2)


GRID = np.array([(x, y, 0.00635) for x in (0.0, 0.138, 0.276) for y in (0.0, 0.1155, 0.231)])


FRESH = secrets.randbits(32)


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(FRESH, id="fresh"),
        pytest.param(10, id="a jump beyond the gate, dots mistaken for their neighbours"),
        pytest.param(1004, id="a jump that leaves two board dots on one diagonal"),
        pytest.param(1005, id="the same in another light", marks=pytest.mark.study),
    ],
)
@pytest.mark.parametrize("lens", LENSES)
def test_the_board_is_followed_within_a_third_of_a_millimetre(lens: Lens, seed: int) -> None:
    rng = np.random.default_rng(seed)
    off, tilt_error = [], []
    for room in range(3):
        renderer = Renderer(layout("medium"), lens, Lighting.drawn(rng), seed=room)
        tracker = LandmarkTracker(PLAN, intrinsics(lens))
        for _ in range(6):
            tilt = (float(rng.uniform(-0.11, 0.11)), float(rng.uniform(-0.11, 0.11)))
            pose = tracker.update(renderer.render(Scene(tilt=tilt)))
            assert pose is not None, f"seed {seed}"
            pixels = true_pixels(renderer, tilt, GRID)
            off.append(pose.to_board(pixels, 0.00635) - GRID[:, :2])
            tilt_error.append(pose.tilt - tilt)
            assert np.allclose(pose.to_board(pose.to_image(GRID), 0.00635), GRID[:, :2], atol=1e-6), f"seed {seed}"
    assert np.sqrt(np.mean(np.sum(np.square(off), -1))) < 0.33e-3, f"seed {seed}"
    assert np.sqrt(np.mean(np.square(tilt_error))) < 3e-3, f"seed {seed}"


def test_two_board_dots_on_one_diagonal_do_not_tell_the_tilt() -> None:
    renderer = Renderer(layout("easy"), CLOSE)
    tracker = LandmarkTracker(PLAN, intrinsics(CLOSE))
    first = tracker.update(renderer.render(Scene()))
    assert first is not None
    covers = tuple((int(x) - 9, int(y) - 9, 18, 18) for x, y in first.dots[[0, 2]])
    assert tracker.update(renderer.render(Scene(tilt=(0.02, -0.015), covers=covers))) is None
    assert tracker.lost == 1


def test_the_homography_maps_the_floor() -> None:
    pose = LandmarkTracker(PLAN, intrinsics(CLOSE)).update(Renderer(layout("easy"), CLOSE).render(Scene(tilt=(0.1, 0))))
    assert pose is not None
    floor = np.array([(0.0, 0.0), (0.276, 0.0), (0.1, 0.2)])
    image = np.column_stack([floor, np.ones(3)]) @ pose.homography.T
    expected = pose.to_image(np.column_stack([floor, np.zeros(3)]))
    assert np.allclose(image[:, :2] / image[:, 2:], expected, atol=1e-6)


@pytest.mark.parametrize("hidden", [(0, 6), (4, 5), (4, 7, 2), (4, 5, 6)])
def test_hidden_dots_leave_the_board_found(hidden: tuple[int, ...]) -> None:
    """Four or more of the rest, spread over the corners, are enough for a camera that stood still."""
    renderer = Renderer(layout("easy"), CLOSE)
    tracker = LandmarkTracker(PLAN, intrinsics(CLOSE))
    first = tracker.update(renderer.render(Scene()))
    assert first is not None
    tilt = (0.02, -0.015)
    covers = tuple((int(x) - 9, int(y) - 9, 18, 18) for x, y in first.dots[list(hidden)])
    pose = tracker.update(renderer.render(Scene(tilt=tilt, covers=covers)))
    assert pose is not None
    assert len(pose.seen) <= 8 - len(hidden)
    off = pose.to_board(true_pixels(renderer, tilt, GRID), 0.00635) - GRID[:, :2]
    assert np.sqrt(np.mean(np.sum(off**2, -1))) < 0.6e-3


def test_a_half_hidden_dot_does_not_drag_the_board_along() -> None:
    renderer = Renderer(layout("easy"), CLOSE)
    tracker = LandmarkTracker(PLAN, intrinsics(CLOSE))
    first = tracker.update(renderer.render(Scene()))
    assert first is not None
    x, y = (int(v) for v in first.dots[2])
    pose = tracker.update(renderer.render(Scene(covers=((x + 1, y - 10, 14, 20),))))
    assert pose is not None
    off = pose.to_board(true_pixels(renderer, (0.0, 0.0), GRID), 0.00635) - GRID[:, :2]
    assert np.linalg.norm(off, axis=1).max() < 1e-3


def test_a_covered_lens_shows_no_board_and_the_board_is_found_again() -> None:
    renderer = Renderer(layout("easy"), CLOSE)
    tracker = LandmarkTracker(PLAN, intrinsics(CLOSE))
    assert tracker.update(renderer.render(Scene(tilt=(0.1, 0.0)))) is not None
    assert tracker.update(renderer.render(Scene(lens_covered=True))) is None
    pose = tracker.update(renderer.render(Scene(tilt=(-0.1, 0.08))))
    assert pose is not None
    assert np.allclose(pose.tilt, (-0.1, 0.08), atol=4e-3)


def test_a_board_without_dots_is_not_found() -> None:
    bare = replace(layout("easy"), dot_diameter=1e-4)
    assert LandmarkTracker(PLAN, intrinsics(CLOSE)).update(Renderer(bare, CLOSE).render(Scene())) is None


def test_a_frame_of_another_size_is_told() -> None:
    with pytest.raises(InputError, match="640"):
        LandmarkTracker(PLAN, intrinsics(CLOSE)).update(np.zeros((480, 640, 3), np.uint8))


def test_a_camera_turned_by_a_quarter_is_followed_when_told() -> None:
    renderer = Renderer(layout("easy"), replace(FAR, turn=(0.0, 0.0, np.pi)))
    frame = renderer.render(Scene(tilt=(0.05, 0.02)))
    tracker = LandmarkTracker(PLAN, intrinsics(FAR), quarter_turns=2)
    pose = tracker.update(frame)
    assert pose is not None
    assert np.allclose(pose.tilt, (0.05, 0.02), atol=4e-3)
