# SPDX-License-Identifier: Apache-2.0
"""A painted marble's colour, learned from one click: how its tint differs from that of the wood next to it.

Tints are logarithms of the ratios blue/red and green/red, so that the light's level cancels; differences to the wood in
the same picture, so that its warmth does, too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field

from labyrinth_hw import config
from labyrinth_hw.camera import Array, Frame
from labyrinth_hw.config import Number, Section, write_new
from labyrinth_hw.errors import InputError

DARK = 6.0  # grey levels added to every channel, below which a tint is noise
LEAST = 0.3  # difference of the tints, below which marble and wood cannot be distinguished
REACH = 3  # px around the click that are looked at
DIM, LIT = 0.35, 0.65  # of the marble's brightness: below is a hole or a shadow, above its lit side


class MarbleFile(Section):
    """A marble file as it stands; see `Marble`."""

    tint: tuple[Number, Number]
    brightness: Annotated[Number, Field(gt=0)]


@dataclass(frozen=True)
class Marble:
    """A painted marble on wood.

    Attributes:
        tint: log blue/red and log green/red of the marble less those of the wood in the same light.
        brightness: sum of its channels over that of the wood.
    """

    tint: tuple[float, float]
    brightness: float

    @staticmethod
    def clicked(frame: Frame, at: tuple[int, int]) -> "Marble":
        """From a BGR picture that is mostly wood in its middle, and a click (x, y) px on the marble.

        Raises:
            InputError: a click outside the picture, or a colour that is too close to the wood's.
        """
        height, width = frame.shape[:2]
        x, y = at
        if not (REACH <= x < width - REACH and REACH <= y < height - REACH):
            raise InputError(f"The click ({x}, {y}) lies outside the picture of {width} x {height} px.")
        wood = wood_of(frame[height // 4 : -height // 4, width // 4 : -width // 4])
        patch = frame[y - REACH : y + REACH + 1, x - REACH : x + REACH + 1].reshape(-1, 3).astype(float)
        colour = np.median(patch, axis=0)
        blue_green = _tint(colour) - _tint(wood)
        if float(np.hypot(*blue_green)) < LEAST:
            b, g, r = (round(v) for v in colour)
            raise InputError(
                f"At ({x}, {y}) the picture is red {r}, green {g}, blue {b}: too near the wood's colour. Click on the "
                "marble's middle, or take one of another colour."
            )
        return Marble((float(blue_green[0]), float(blue_green[1])), float(colour.sum() / wood.sum()))

    @staticmethod
    def load(path: Path | str) -> "Marble":
        """From a YAML file as `save` writes it. Raises InputError with all complaints."""
        given = config.read(path).checked(MarbleFile)
        return Marble(given.tint, given.brightness)

    def save(self, path: Path | str) -> None:
        """To a new YAML file. Raises InputError if it exists, because nothing is overwritten."""
        figures = {"tint": [round(t, 4) for t in self.tint], "brightness": round(self.brightness, 4)}
        write_new(Path(path), yaml.safe_dump(figures, sort_keys=False))

    def share(self, picture: NDArray[np.float32], wood: Array) -> NDArray[np.float32]:
        """(h, w) how much of the marble each pixel of a BGR picture (h, w, 3) shows, 0 to 1."""
        way = np.array(self.tint)
        off = _tint(picture) - _tint(wood)
        along = off @ way / (way @ way)
        beside = np.abs(off @ np.array([-way[1], way[0]])) / (way @ way)
        bright = picture.sum(axis=-1) / (wood.sum() * self.brightness)
        coloured = np.clip(1.5 * along - 0.25, 0, 1) * np.clip(1.5 - beside, 0, 1)
        return np.asarray(coloured * np.clip((bright - DIM) / (LIT - DIM), 0, 1), np.float32)


def wood_of(crop: Frame) -> Array:
    """(3,) BGR of the wood, which most of a picture's part is."""
    sample = crop[::6, ::6].reshape(-1, 3).astype(np.float64)
    red = sample[:, 2]
    lit = sample[(red > 0.6 * np.median(red)) & (red < 250)]
    return np.asarray(np.median(lit if len(lit) > 50 else sample, axis=0))


def _tint(colour: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., 3) BGR -> (..., 2)."""
    logs = cv2.log(np.asarray(colour, np.float32).reshape(-1, 3) + np.float32(DARK)).reshape(np.shape(colour))
    return np.asarray(logs[..., :2] - logs[..., 2:])
