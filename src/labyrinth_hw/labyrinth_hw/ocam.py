# SPDX-License-Identifier: Apache-2.0
"""Lenses calibrated by OCamCalib: read from its file, and pictures made straight, as a pinhole would show them.

The model (Scaramuzza, Martinelli, Siegwart 2006): the ray through a pixel (u, v) about the centre, after a stretch, is
(u, v, f(rho)) with a polynomial f of the distance rho; u runs down the rows, v along the columns. Its inverse is a
polynomial of the ray's elevation.
"""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from labyrinth_hw.camera import Array, Frame, Intrinsics, locked
from labyrinth_hw.errors import InputError

PARTS = ("direct polynomial", "inverse polynomial", "centre", "affine parameters", "picture size")
MATCH = 2.0  # px by which the inverse polynomial may miss


@dataclass(frozen=True)
class OCamLens:
    """A lens of OCamCalib.

    Attributes:
        width, height: of the picture, px.
        direct: (k,) coefficients of f, lowest power first; inverse: (m,) those of rho over the elevation, rad.
        centre: (2,) row and column, px.
        stretch: (2, 2) sensor to picture.
    """

    width: int
    height: int
    direct: Array
    inverse: Array
    centre: Array
    stretch: Array
    _maps: dict[Intrinsics, tuple[NDArray[np.int16], NDArray[np.uint16]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @staticmethod
    def load(path: Path | str) -> "OCamLens":
        """From the text file that OCamCalib exports (calib_results.txt).

        Raises:
            InputError: unreadable, a part missing, or polynomials that do not undo each other.
        """
        try:
            lines = Path(path).read_text(encoding="utf-8").splitlines()
            rows = [
                [float(word) for word in line.split()] for line in lines if line.strip() and not line.startswith("#")
            ]
        except (OSError, UnicodeDecodeError, ValueError) as error:
            raise InputError(f"{path} is no file of OCamCalib: {error}.") from error
        expected = "; ".join(PARTS)
        if [len(row) for row in rows[2:5]] != [2, 3, 2] or len(rows) != 5:
            raise InputError(f"{path}: expected five lines of numbers ({expected}), got {len(rows)}.")
        for name, row in zip(PARTS, rows[:2], strict=False):
            if len(row) != round(row[0]) + 1 or len(row) < 3:
                raise InputError(f"{path}, {name}: expected {row[0]:g} coefficients, got {len(row) - 1}.")
        c, d, e = rows[3]
        height, width = (round(n) for n in rows[4])
        lens = OCamLens(
            width, height, locked(rows[0][1:]), locked(rows[1][1:]), locked(rows[2]), locked([[c, d], [e, 1.0]])
        )
        pixels = np.stack(np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9)), -1).reshape(-1, 2)
        off = float(np.abs(lens.project(lens.rays(pixels)) - pixels).max())
        if not off < MATCH:
            raise InputError(
                f"{path}: the two polynomials miss each other by {off:.3g} px; expected {MATCH:g} at most."
            )
        return lens

    def rays(self, pixels: Array) -> Array:
        """(n, 2) px (column, row) -> (n, 3) unit directions: x along columns, y down rows, z away from the camera."""
        across = np.linalg.solve(self.stretch, (np.asarray(pixels, float)[:, ::-1] - self.centre).T).T
        along = polyval(np.hypot(*across.T), self.direct)
        rays = np.column_stack([across[:, 1], across[:, 0], -along])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(self, points: Array) -> Array:
        """(n, 3) directions, as `rays` has them -> (n, 2) px (column, row)."""
        across = np.asarray(points, float)[:, 1::-1]
        far = np.hypot(*across.T)
        distance = polyval(np.arctan2(-np.asarray(points, float)[:, 2], far), self.inverse)
        unit = across / np.where(far > 0, far, 1.0)[:, None]
        return np.asarray((unit * distance[:, None] @ self.stretch.T + self.centre)[:, ::-1])

    def pinhole(self, width: int, height: int, across_deg: float, latency: float = 0.0) -> Intrinsics:
        """The pinhole of this size and field of view that `straight` makes pictures for."""
        focal = width / 2 / np.tan(np.radians(across_deg) / 2)
        return Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, latency=latency)

    def straight(self, frame: Frame, pinhole: Intrinsics) -> Frame:
        """A picture of this lens as the pinhole would have taken it. Raises InputError for one of another size."""
        if frame.shape[:2] != (self.height, self.width):
            raise InputError(
                f"The camera's pictures are {frame.shape[1]} x {frame.shape[0]}, the OCamCalib file is for "
                f"{self.width} x {self.height}."
            )
        if pinhole not in self._maps:
            columns, rows = np.meshgrid(np.arange(pinhole.width), np.arange(pinhole.height))
            rays = pinhole.rays(np.column_stack([columns.ravel(), rows.ravel()]))
            at = self.project(rays).astype(np.float32).reshape(pinhole.height, pinhole.width, 2)
            self._maps[pinhole] = cv2.convertMaps(at[..., 0], at[..., 1], cv2.CV_16SC2)
        return np.asarray(cv2.remap(frame, *self._maps[pinhole], cv2.INTER_LINEAR), np.uint8)
