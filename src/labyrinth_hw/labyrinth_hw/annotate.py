# SPDX-License-Identifier: Apache-2.0
"""What was found, drawn into the picture it was found in."""

import cv2
import numpy as np

from labyrinth_hw.ball_tracker import BallObservation
from labyrinth_hw.camera import Array, Frame
from labyrinth_hw.landmarks import BoardPose

BLUE, RED, GREEN, YELLOW, WHITE = (255, 150, 0), (60, 60, 255), (60, 220, 60), (0, 230, 255), (255, 255, 255)
SUBPIXEL_BITS = 4  # fractional bits of coordinates


def annotated(
    frame: Frame,
    pose: BoardPose | None,
    ball: BallObservation | None = None,
    board: tuple[float, float] = (0.276, 0.231),
    radius: float = 0.00635,
) -> Frame:
    """A copy of a BGR frame with dots, board outline, axes (x red, y green, z blue, 4 cm) and ball.

    Args:
        board: size, m. radius: of the ball, m.
    """
    picture = frame.copy()
    if pose is None:
        _write(picture, "board not found", 0, RED)
        return picture
    width, depth = board
    outline = pose.to_image(np.array([(0, 0, 0), (width, 0, 0), (width, depth, 0), (0, depth, 0)]))
    cv2.polylines(picture, [_fixed(outline)], True, YELLOW, 1, cv2.LINE_AA, SUBPIXEL_BITS)
    axes = pose.to_image(np.vstack([np.zeros(3), 0.04 * np.eye(3)]))
    for end, colour in zip(axes[1:], (RED, GREEN, BLUE), strict=True):
        cv2.line(picture, _fixed(axes[0]), _fixed(end), colour, 2, cv2.LINE_AA, SUBPIXEL_BITS)
    for dot in pose.dots[np.isfinite(pose.dots[:, 0])]:
        cv2.circle(picture, _fixed(dot), 8 << SUBPIXEL_BITS, WHITE, 1, cv2.LINE_AA, SUBPIXEL_BITS)
    tilt = np.degrees(pose.tilt)
    _write(picture, f"tilt {tilt[0]:+.2f} {tilt[1]:+.2f} deg   residual {pose.residual:.2f} px", 0, WHITE)
    if ball is not None and ball.visible:
        centre = np.array([ball.x, ball.y, radius])
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = centre + radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        cv2.polylines(picture, [_fixed(pose.to_image(ring))], True, GREEN, 1, cv2.LINE_AA, SUBPIXEL_BITS)
        cv2.drawMarker(picture, _whole(pose.to_image(centre[None])[0]), RED, cv2.MARKER_CROSS, 7)
        text = f"ball {1e3 * ball.x:.1f} {1e3 * ball.y:.1f} mm   quality {ball.quality:.2f}"
        _write(picture, text, 1, GREEN)
    elif ball is not None:
        _write(picture, "no ball", 1, RED)
    return picture


def _fixed(points: Array) -> np.ndarray:
    return np.round(np.asarray(points) * 2**SUBPIXEL_BITS).astype(np.int32)


def _whole(point: Array) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _write(picture: Frame, text: str, row: int, colour: tuple[int, int, int]) -> None:
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)
    x, y = 6, 14 + 17 * row
    cv2.rectangle(picture, (x - 3, y - height - 3), (x + width + 3, y + 4), (25, 25, 25), -1)
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
