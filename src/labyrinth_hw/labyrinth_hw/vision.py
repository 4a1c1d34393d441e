# SPDX-License-Identifier: Apache-2.0
"""Camera to ball in a process of its own, so that looking at pictures never holds up the servos."""

import multiprocessing
import os
import signal
import time
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labyrinth_hw.devices import camera_source, ordinary_priority
from labyrinth_hw.errors import InputError
from labyrinth_hw.settings import CameraSettings

if TYPE_CHECKING:
    from labyrinth_hw.ball_tracker import BallObservation
    from labyrinth_hw.camera import Array, Frame, Intrinsics
    from labyrinth_hw.landmarks import BoardPose

BLUE, RED, GREEN, YELLOW, WHITE = (255, 150, 0), (60, 60, 255), (60, 220, 60), (0, 230, 255), (255, 255, 255)
SUBPIXEL_BITS = 4  # fractional bits of coordinates


@dataclass(frozen=True)
class Sight:
    """What one picture showed.

    Attributes:
        stamp: s of `time.monotonic()`, middle of the exposure.
        board: whether the landmarks were found.
        visible, x, y: the ball, m in the board frame.
        tilt: of the board about x and y, rad; None where it was not found.
        frames, losses: pictures so far, and how often the camera was gone.
        picture, raw: (height, width, bytes) BGR, with what was found drawn in and as it came, only while asked for.
    """

    stamp: float
    board: bool
    visible: bool
    x: float
    y: float
    frames: int
    losses: int
    picture: tuple[int, int, bytes] | None = None
    raw: tuple[int, int, bytes] | None = None
    tilt: tuple[float, float] | None = None


def lens_of(settings: CameraSettings) -> "Intrinsics":
    """The calibrated lens, or a plain one of the stated field of view."""
    from labyrinth_hw.camera import Intrinsics  # OpenCV takes a while, which who has no camera does without
    from labyrinth_hw.ocam import OCamLens

    if settings.intrinsics is not None:
        return Intrinsics.load(settings.intrinsics)
    if settings.ocam is not None:
        return OCamLens.load(settings.ocam).pinhole(*settings.size, settings.field_of_view_deg, settings.latency)
    lens = Intrinsics.from_field_of_view(*settings.size, settings.field_of_view_deg)
    return replace(lens, latency=settings.latency)


class Vision:
    """A camera and its trackers.

    Args:
        settings: of the camera.
    """

    def __init__(self, settings: CameraSettings) -> None:
        if settings.intrinsics is not None and not Path(settings.intrinsics).is_file():
            raise InputError(f"Camera file {settings.intrinsics} does not exist. Make it with calibrate_camera.")
        if settings.ocam is not None:
            from labyrinth_hw.ocam import OCamLens

            OCamLens.load(settings.ocam)
        if settings.marble is not None and not Path(settings.marble).is_file():
            raise InputError(f"Marble file {settings.marble} does not exist. Make it with calibrate_camera marble.")
        context = multiprocessing.get_context("spawn")
        self._sights, other = context.Pipe(duplex=False)
        self.pictures, self.raw = context.Event(), context.Event()
        self._process = context.Process(
            target=_watch, args=(settings, other, self.pictures, self.raw, os.getpid()), daemon=True
        )
        with ordinary_priority():
            self._process.start()
        other.close()

    def next(self, timeout: float) -> Sight | None:
        """The next sight, or None where none came within `timeout` s."""
        try:
            return self._sights.recv() if self._sights.poll(timeout) else None
        except (EOFError, OSError):
            time.sleep(timeout)
            return None

    def close(self) -> None:
        """End the process."""
        self._sights.close()
        self._process.terminate()
        self._process.join(timeout=3.0)


def _watch(settings: CameraSettings, sights: Connection, pictures: Event, raw: Event, parent: int) -> None:
    from labyrinth_hw.ball_tracker import BallTracker
    from labyrinth_hw.camera import Camera
    from labyrinth_hw.landmarks import DotPlan, LandmarkTracker
    from labyrinth_hw.marble import Marble
    from labyrinth_hw.ocam import OCamLens

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    lens = lens_of(settings)
    wide = OCamLens.load(settings.ocam) if settings.ocam is not None else None
    landmarks = LandmarkTracker(DotPlan.from_sizes(), lens, quarter_turns=settings.quarter_turns)
    ball = BallTracker(marble=Marble.load(settings.marble) if settings.marble is not None else None)
    while os.getppid() == parent:
        source = camera_source(settings.source)
        if source is None:
            time.sleep(0.5)
            continue
        size = (wide or lens).width, (wide or lens).height
        with Camera(
            source, latency=lens.latency, clock=time.monotonic, size=size if source.isdigit() else None
        ) as camera:
            number = 0
            while os.getppid() == parent and camera_source(settings.source) == source:
                shot = camera.newest(number, timeout=0.5)
                if shot is None:
                    continue
                number = shot.number
                if wide is not None:
                    shot = replace(shot, image=wide.straight(shot.image, lens))
                if shot.image.shape[:2] != (lens.height, lens.width):
                    raise InputError(
                        f"The camera's pictures are {shot.image.shape[1]} x {shot.image.shape[0]}, not {lens}."
                    )
                pose = landmarks.update(shot.image)
                seen = ball.update(shot.image, pose, shot.stamp)
                picture = _bytes(annotated(shot.image, pose, seen)) if pictures.is_set() else None
                plain = _bytes(shot.image) if raw.is_set() else None
                state = camera.state
                sight = Sight(
                    shot.stamp,
                    pose is not None,
                    seen.visible,
                    seen.x,
                    seen.y,
                    state.frames,
                    state.losses,
                    picture,
                    plain,
                    None if pose is None else (float(pose.tilt[0]), float(pose.tilt[1])),
                )
                try:
                    sights.send(sight)
                except OSError:
                    return


def _bytes(image: "Frame") -> tuple[int, int, bytes]:
    return image.shape[0], image.shape[1], image.tobytes()


def annotated(
    frame: "Frame",
    pose: "BoardPose | None",
    ball: "BallObservation | None" = None,
    board: tuple[float, float] = (0.276, 0.231),
    radius: float = 0.00635,
) -> "Frame":
    """A copy of a BGR frame with dots, board outline, axes (x red, y green, z blue, 4 cm) and ball.

    Args:
        board: size, m. radius: of the ball, m.
    """
    import cv2

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


def _fixed(points: "Array") -> np.ndarray:
    return np.round(np.asarray(points) * 2**SUBPIXEL_BITS).astype(np.int32)


def _whole(point: "Array") -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _write(picture: "Frame", text: str, row: int, colour: tuple[int, int, int]) -> None:
    import cv2

    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.42, 1)
    x, y = 6, 14 + 17 * row
    cv2.rectangle(picture, (x - 3, y - height - 3), (x + width + 3, y + 4), (25, 25, 25), -1)
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
