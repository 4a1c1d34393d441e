# SPDX-License-Identifier: Apache-2.0
"""The newest frame of any source that OpenCV can open, stamped at exposure, and the lens parameters."""

import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field

from labyrinth_hw import config
from labyrinth_hw.config import Number, Positive, Section, Whole, write_new
from labyrinth_hw.errors import InputError

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]


def locked(values: object) -> Array:
    """A read-only float64 copy."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


class IntrinsicsFile(Section):
    """A camera file as it stands; see `Intrinsics`."""

    width: Annotated[Whole, Field(gt=0)]
    height: Annotated[Whole, Field(gt=0)]
    fx: Positive
    fy: Positive
    cx: Number
    cy: Number
    distortion: tuple[Number, Number, Number, Number, Number] = (0.0, 0.0, 0.0, 0.0, 0.0)
    latency: Number = 0.0
    residual: float = float("nan")


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole with Brown-Conrady distortion.

    Attributes:
        width, height: picture size, px.
        fx, fy, cx, cy: focal lengths and principal point, px; pixel centres are at whole numbers.
        distortion: k1, k2, p1, p2, k3.
        latency: s from the middle of the exposure to the frame's arrival.
        residual: root mean square error of the calibration, px; NaN where none was made.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    latency: float = 0.0
    residual: float = float("nan")

    @staticmethod
    def from_field_of_view(width: int, height: int, across_deg: float) -> "Intrinsics":
        """A plain lens that sees `across_deg` degrees from left to right: a start where nothing was calibrated."""
        focal = width / 2 / np.tan(np.radians(across_deg) / 2)
        return Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @staticmethod
    def load(path: Path | str) -> "Intrinsics":
        """From a YAML file as `save` writes it. Raises InputError with all complaints."""
        try:
            figures = config.read(path).checked(IntrinsicsFile)
        except InputError as error:
            raise InputError([*error.complaints, "Run calibrate_camera to make a camera file."]) from error
        return Intrinsics(**figures.model_dump())

    def save(self, path: Path | str) -> None:
        """To a new YAML file. Raises InputError if it exists, because nothing is overwritten, or cannot be written."""
        figures = {**asdict(self), "distortion": list(self.distortion)}
        write_new(Path(path), yaml.safe_dump(figures, sort_keys=False))

    def arrays(self) -> tuple[Array, Array]:
        """Camera matrix (3, 3) and distortion (5,) as OpenCV takes them."""
        matrix = np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])
        return matrix, np.array(self.distortion)

    def rays(self, pixels: Array) -> Array:
        """(n, 2) px -> (n, 3) directions in the camera frame with z = 1."""
        points = np.asarray(pixels, float).reshape(-1, 1, 2)
        return np.column_stack([cv2.undistortPoints(points, *self.arrays()).reshape(-1, 2), np.ones(len(points))])


@dataclass(frozen=True)
class Shot:
    """One frame.

    Attributes:
        image: (height, width, 3) BGR.
        stamp: middle of the exposure, s, on the clock given to the camera.
        number: counts every frame that arrived, taken or not, from 1.
    """

    image: Frame
    stamp: float
    number: int


@dataclass(frozen=True)
class CameraState:
    """For diagnostics: connected or not, frames arrived, times lost, latency s, and a sentence."""

    connected: bool
    frames: int
    losses: int
    latency: float
    message: str


class Camera:
    """Reads a source in a thread of its own and keeps the newest frame only.

    Args:
        source: device number or path, file, or stream address.
        latency: s from exposure to arrival, subtracted from the arrival's time.
        clock: time of arrival, s.
        size: (width, height) to ask a device for; rate: frames per second to ask for.
        retry: s between attempts to open a source that is gone.
        loop: start a file again at its end; a file's frames come at the file's own rate.
        on_change: called with a sentence whenever the source is lost or comes back.
    """

    def __init__(
        self,
        source: int | str,
        latency: float = 0.0,
        clock: Callable[[], float] = time.time,
        size: tuple[int, int] | None = None,
        rate: float | None = None,
        retry: float = 0.5,
        loop: bool = False,
        on_change: Callable[[str], None] = lambda message: None,
    ) -> None:
        self.source = int(source) if isinstance(source, str) and source.isdigit() else source
        self.latency, self._clock, self._size, self._rate = latency, clock, size, rate
        self._retry, self._loop, self._on_change = retry, loop, on_change
        self._fresh = threading.Condition()
        self._shot: Shot | None = None
        self._frames = self._losses = 0
        self._connected, self._message = False, f"Opening {source}."
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    @property
    def state(self) -> CameraState:
        with self._fresh:
            return CameraState(self._connected, self._frames, self._losses, self.latency, self._message)

    def newest(self, after: int = 0, timeout: float = 1.0) -> Shot | None:
        """The newest frame whose number is above `after`; waits `timeout` s for it, then None."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._over.is_set() or self._ahead(after), timeout)
            return self._shot if self._ahead(after) else None

    def close(self) -> None:
        """Ends the thread and frees the device."""
        self._over.set()
        with self._fresh:
            self._fresh.notify_all()
        self._thread.join(timeout=10.0)

    def __enter__(self) -> "Camera":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _ahead(self, after: int) -> bool:
        return self._shot is not None and self._shot.number > after

    def _run(self) -> None:
        while not self._over.is_set():
            capture = self._open()
            if capture is None:
                self._say(False, f"{self.source} does not open; trying again every {self._retry:g} s.")
            else:
                self._say(True, f"{self.source} delivers frames.")
                self._read(capture)
                capture.release()
                if self._over.is_set():
                    return
                self._say(False, f"{self.source} stopped delivering frames; opening it again.")
                if self._is_file() and not self._loop:
                    return
            self._over.wait(self._retry if not self._is_file() else 0.0)

    def _open(self) -> cv2.VideoCapture | None:
        options = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 3000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 2000]
        stream = isinstance(self.source, str) and "://" in self.source
        extra = (cv2.CAP_FFMPEG, options) if stream else ()
        try:
            capture = cv2.VideoCapture(self.source, *extra)
        except cv2.error:
            return None
        if not capture.isOpened():
            capture.release()
            return None
        if not stream and not self._is_file():
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
            if self._size is not None:
                capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._size[0])
                capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._size[1])
            if self._rate is not None:
                capture.set(cv2.CAP_PROP_FPS, self._rate)
        return capture

    def _is_file(self) -> bool:
        return isinstance(self.source, str) and "://" not in self.source and Path(self.source).is_file()

    def _read(self, capture: cv2.VideoCapture) -> None:
        rate = capture.get(cv2.CAP_PROP_FPS) if self._is_file() else 0.0
        due = time.monotonic()
        while not self._over.is_set():
            ok, image = capture.read()
            arrival = self._clock()
            if not ok:
                return
            with self._fresh:
                self._frames += 1
                self._shot = Shot(np.asarray(image, np.uint8), arrival - self.latency, self._frames)
                self._fresh.notify_all()
            if rate > 0:
                due += 1 / rate
                self._over.wait(max(0.0, due - time.monotonic()))

    def _say(self, connected: bool, message: str) -> None:
        with self._fresh:
            changed = connected != self._connected or self._message.startswith("Opening")
            self._losses += self._connected and not connected
            self._connected, self._message = connected, message
        if changed:
            self._on_change(message)
