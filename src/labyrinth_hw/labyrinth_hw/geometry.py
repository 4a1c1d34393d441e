# SPDX-License-Identifier: Apache-2.0
"""Walls and holes of the labyrinth's boards: config/labyrinth_geometry.yaml."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ConfigDict

from labyrinth_hw import config
from labyrinth_hw.config import Number, Positive, Section
from labyrinth_hw.errors import InputError, unknown_name

Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]


class BoardLayout(Section):
    """One layout, m: `walls_h` (x0, x1, y), `walls_v` (y0, y1, x) along their centre lines; holes and path (x, y)."""

    walls_h: tuple[Triple, ...]
    walls_v: tuple[Triple, ...]
    holes: tuple[Pair, ...]
    path: tuple[Pair, ...]


class Geometry(Section):
    """What all layouts share, m, and the layouts by name. The file may hold more, for the simulation."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    board_size: tuple[Positive, Positive]
    ball_radius: Positive
    hole_radius: Positive
    wall_width: Positive
    wall_height: Positive
    landmark_spacing: tuple[Positive, Positive]
    landmark_diameter: Positive
    layouts: Mapping[str, BoardLayout]

    def layout(self, name: str) -> BoardLayout:
        """A layout by name. Raises InputError that lists the valid names."""
        if name not in self.layouts:
            raise InputError(unknown_name("layout", name, self.layouts))
        return self.layouts[name]


def load_geometry(path: Path | str | None = None) -> Geometry | None:
    """The geometry in a file, by default in the one that `config.find_geometry` finds; None where there is none.

    Raises:
        InputError: all complaints about the file.
    """
    found: Any = path or config.find_geometry()
    return None if found is None else config.read(found).checked(Geometry)
