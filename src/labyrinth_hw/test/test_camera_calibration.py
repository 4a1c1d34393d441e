# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_views import FAR, intrinsics, layout

from labyrinth_hw.camera import Camera, Intrinsics
from labyrinth_hw.camera_calibration import calibrate_from_frames, measure_latency, with_latency
from labyrinth_hw.errors import InputError
from labyrinth_hw.landmarks import DotPlan, LandmarkTracker
from labyrinth_hw.nodes import calibrate_camera
from labyrinth_hw.testbed.renderer import Renderer
from labyrinth_hw.testbed.scene import Scene

TRUE = Intrinsics(640, 360, 410.0, 412.0, 322.0, 176.0, (-0.15, 0.03, 0.001, -0.0005, 0.0))
INNER, SQUARE = (8, 5), 0.02


def chessboard(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> np.ndarray:
    """A picture of a chessboard through `TRUE`, edges bent as the lens bends them, drawn at 4 times the size."""
    canvas = np.full((4 * 360, 4 * 640), 190, np.uint8)
    side = np.linspace(0, 1, 9)[:-1]
    one, none = np.ones(8), np.zeros(8)
    edge = np.column_stack([np.r_[side, one, 1 - side, none], np.r_[none, side, one, 1 - side]])
    for row in range(-1, INNER[1]):
        for column in range(-1, INNER[0]):
            if (row + column) % 2:
                continue
            corners = np.column_stack([(edge + np.array([column, row])) * SQUARE, np.zeros(len(edge))])
            image = cv2.projectPoints(corners, np.array(turn), np.array(shift), *TRUE.arrays())[0].reshape(-1, 2)
            cv2.fillPoly(canvas, [np.round(((image + 0.5) * 4 - 0.5) * 16).astype(np.int32)], 40, cv2.LINE_AA, 4)
    small = cv2.resize(canvas, (640, 360), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(len(turn)).normal(0, 2, small.shape)
    return cv2.cvtColor(np.clip(small + noise, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)


VIEWS = [
    ((0.4 * np.cos(a), 0.4 * np.sin(a), 0.05 * k), (-0.07 + 0.05 * np.cos(2 * a), -0.04 + 0.03 * np.sin(2 * a), 0.24))
    for k, a in enumerate(np.linspace(0, 2 * np.pi, 13)[:-1])
]


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return [chessboard(*view) for view in VIEWS]


def test_a_known_lens_is_recovered_from_chessboards(pictures: list[np.ndarray]) -> None:
    blank = np.full((360, 640, 3), 128, np.uint8)
    counts = []
    lens = calibrate_from_frames([*pictures, blank], INNER, SQUARE, lambda seen, used: counts.append((seen, used)))
    assert counts[-1][0] == 13
    assert counts[-1][1] >= 8
    assert lens.fx == pytest.approx(TRUE.fx, rel=0.01)
    assert lens.fy == pytest.approx(TRUE.fy, rel=0.01)
    assert (lens.cx, lens.cy) == pytest.approx((TRUE.cx, TRUE.cy), abs=4)
    assert lens.residual < 0.3
    covered = np.array([(x, y) for x in (120.0, 320.0, 520.0) for y in (80.0, 180.0, 280.0)])  # by chessboards
    assert np.abs(lens.rays(covered) - TRUE.rays(covered)).max() < 0.01


def test_too_few_chessboards_are_refused(pictures: list[np.ndarray]) -> None:
    with pytest.raises(InputError, match="at least 5"):
        calibrate_from_frames(pictures[:3], INNER, SQUARE)


def test_pictures_of_two_sizes_are_refused(pictures: list[np.ndarray]) -> None:
    with pytest.raises(InputError, match="differ in size"):
        calibrate_from_frames([pictures[0], pictures[0][:200]], INNER, SQUARE)


@pytest.mark.parametrize("latency", [-0.03, 0.0, 0.0417, 0.12])
def test_a_known_latency_is_recovered_within_two_milliseconds(latency: float) -> None:
    rng = np.random.default_rng()
    encoder_time = np.arange(0, 12, 0.01) + rng.uniform(-5e-4, 5e-4, 1200)

    def angle(t: np.ndarray) -> np.ndarray:
        return 0.06 * np.sin(2 * np.pi * 0.7 * t) + 0.03 * np.sin(2 * np.pi * 1.9 * t + 1)

    exposed = np.arange(0.4, 11.4, 1 / 60)
    tilt = 0.8 * angle(exposed) + 0.01 + rng.normal(0, 1e-3, len(exposed))
    tilt[rng.random(len(tilt)) < 0.1] = np.nan
    found = measure_latency(exposed + latency, tilt, encoder_time, angle(encoder_time))
    assert found.seconds == pytest.approx(latency, abs=2e-3)
    assert found.correlation > 0.99
    assert with_latency(TRUE, found).latency == found.seconds


def test_latency_comes_out_of_pictures_of_a_moving_board() -> None:
    renderer = Renderer(layout("easy"), FAR)
    marks = LandmarkTracker(DotPlan.from_sizes(), intrinsics(FAR))
    exposed = np.arange(0.3, 3.3, 1 / 30)
    poses = [marks.update(renderer.render(Scene(tilt=(0.08 * np.sin(6 * t), 0.0)))) for t in exposed]
    tilt = np.array([np.nan if pose is None else pose.tilt[0] for pose in poses])
    encoder_time = np.arange(0, 3.6, 0.01)
    found = measure_latency(exposed + 0.035, tilt, encoder_time, 0.08 * np.sin(6 * encoder_time))
    assert found.seconds == pytest.approx(0.035, abs=3e-3)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda t, a, e, b: (t, a[:-1], e, b), "pair up"),
        (lambda t, a, e, b: (t, a, e[::-1], b), "increase"),
        (lambda t, a, e, b: (t + 100, a, e, b), "at least 50"),
        (lambda t, a, e, b: (t, a, e, 0 * b), "hardly moved"),
        (lambda t, a, e, b: (t, np.random.default_rng(0).normal(size=len(t)), e, b), "correlate|end of"),
    ],
)
def test_what_tells_no_latency_is_refused(spoil: object, told: str) -> None:
    encoder_time, t = np.arange(0, 6, 0.01), np.arange(0.5, 5.5, 1 / 60)
    arguments = (t, 0.05 * np.sin(5 * t), encoder_time, 0.05 * np.sin(5 * encoder_time))
    with pytest.raises(InputError, match=told):
        measure_latency(*spoil(*arguments))  # type: ignore[operator]


def test_a_camera_file_reads_back_and_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    lens = with_latency(TRUE, measure_latency(*_wave()))
    lens.save(path)
    again = Intrinsics.load(path)
    assert again.arrays()[0].tolist() == lens.arrays()[0].tolist()
    assert again.latency == lens.latency
    with pytest.raises(InputError, match="exists"):
        lens.save(path)
    path.write_text("width: 3\nfocus: 2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"(?s)cx is missing.*'focus'"):
        Intrinsics.load(path)


def _wave() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    encoder_time, t = np.arange(0, 6, 0.01), np.arange(0.5, 5.5, 1 / 60)
    return t + 0.02, 0.05 * np.sin(5 * t), encoder_time, 0.05 * np.sin(5 * encoder_time)


def test_the_command_calibrates_from_picture_files(
    pictures: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for index, picture in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"view{index:02d}.png"), picture)
    out = tmp_path / "camera.yaml"
    command = ["lens", "--pictures", str(tmp_path), "--corners", "8x5", "--square-mm", "20", "--out", str(out)]
    assert calibrate_camera.main(command) == 0
    assert Intrinsics.load(out).fx == pytest.approx(TRUE.fx, rel=0.01)
    assert calibrate_camera.main(command) == 2
    assert "exists" in capsys.readouterr().err
    assert calibrate_camera.main([*command[:3], "--corners", "8", "--square-mm", "20", "--out", "x.yaml"]) == 2


def test_a_missing_source_is_told(tmp_path: Path) -> None:
    with Camera(str(tmp_path / "none.avi"), retry=0.05) as camera:
        assert camera.newest(timeout=0.3) is None
        assert not camera.state.connected
        assert "does not open" in camera.state.message
