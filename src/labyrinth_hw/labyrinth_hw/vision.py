# SPDX-License-Identifier: Apache-2.0
"""Camera to ball in a process of its own, so that looking at pictures never holds up the servos."""

import multiprocessing
import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from labyrinth_hw.errors import InputError, unknown_name
from labyrinth_hw.links import camera_source
from labyrinth_hw.priority import ordinary_priority

KEYS = {"source", "intrinsics", "field_of_view_deg", "size", "latency", "quarter_turns"}


@dataclass(frozen=True)
class CameraSettings:
    """Of `camera:` in config/hw/*.yaml.

    Attributes:
        source: device number or path, file, stream address, or "testbed".
        intrinsics: file of calibrate_camera, or None.
        field_of_view_deg: from left to right, where there is no such file.
        size: width, height, px, where there is no such file.
        latency: s from exposure to arrival, where there is no such file.
        quarter_turns: of the camera about its axis.
    """

    source: str
    intrinsics: str | None = None
    field_of_view_deg: float = 70.0
    size: tuple[int, int] = (640, 360)
    latency: float = 0.0
    quarter_turns: int = 0


@dataclass(frozen=True)
class Sight:
    """What one picture showed.

    Attributes:
        stamp: s of `time.monotonic()`, middle of the exposure.
        board: whether the landmarks were found.
        visible, x, y: the ball, m in the board frame.
        frames, losses: pictures so far, and how often the camera was gone.
        picture: (height, width, bytes) BGR with what was found drawn in, only while asked for.
    """

    stamp: float
    board: bool
    visible: bool
    x: float
    y: float
    frames: int
    losses: int
    picture: tuple[int, int, bytes] | None = None


def camera_settings(entry: Mapping[str, Any]) -> CameraSettings | None:
    """From a configuration; None where it names no camera. Raises InputError."""
    if not entry:
        return None
    complaints = [unknown_name("camera key", key, KEYS) for key in entry if key not in KEYS]
    if "source" not in entry:
        complaints.append("camera: source is missing: a device number or path, a file, a stream address, or testbed.")
    if complaints:
        raise InputError(complaints)
    values = {**entry, "source": str(entry["source"])}
    if "size" in values:
        values["size"] = (int(values["size"][0]), int(values["size"][1]))
    return CameraSettings(**values)


class Vision:
    """A camera and its trackers.

    Args:
        settings: of the camera.
    """

    def __init__(self, settings: CameraSettings) -> None:
        if settings.intrinsics is not None and not Path(settings.intrinsics).is_file():
            raise InputError(f"Camera file {settings.intrinsics} does not exist. Make it with calibrate_camera.")
        context = multiprocessing.get_context("spawn")
        self._sights, other = context.Pipe(duplex=False)
        self.pictures = context.Event()
        self._process = context.Process(target=_watch, args=(settings, other, self.pictures, os.getpid()), daemon=True)
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


def _watch(settings: CameraSettings, sights: Connection, pictures: Event, parent: int) -> None:
    from labyrinth_hw.annotate import annotated
    from labyrinth_hw.ball_tracker import BallTracker
    from labyrinth_hw.camera import Camera, Intrinsics
    from labyrinth_hw.dots import DotPlan
    from labyrinth_hw.landmarks import LandmarkTracker

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if settings.intrinsics is not None:
        lens = Intrinsics.load(settings.intrinsics)
        latency = lens.latency
    else:
        lens = Intrinsics.from_field_of_view(*settings.size, settings.field_of_view_deg)
        latency = settings.latency
    landmarks = LandmarkTracker(DotPlan.from_sizes(), lens, quarter_turns=settings.quarter_turns)
    ball = BallTracker()
    while os.getppid() == parent:
        source = camera_source(settings.source)
        if source is None:
            time.sleep(0.5)
            continue
        size = (lens.width, lens.height) if source.isdigit() else None
        with Camera(source, latency=latency, clock=time.monotonic, size=size) as camera:
            number = 0
            while os.getppid() == parent and camera_source(settings.source) == source:
                shot = camera.newest(number, timeout=0.5)
                if shot is None:
                    continue
                number = shot.number
                if shot.image.shape[:2] != (lens.height, lens.width):
                    raise InputError(
                        f"The camera's pictures are {shot.image.shape[1]} x {shot.image.shape[0]}, not {lens}."
                    )
                pose = landmarks.update(shot.image)
                seen = ball.update(shot.image, pose, shot.stamp)
                picture = None
                if pictures.is_set():
                    drawn = annotated(shot.image, pose, seen)
                    picture = (drawn.shape[0], drawn.shape[1], drawn.tobytes())
                state = camera.state
                sight = Sight(
                    shot.stamp, pose is not None, seen.visible, seen.x, seen.y, state.frames, state.losses, picture
                )
                try:
                    sights.send(sight)
                except OSError:
                    return
