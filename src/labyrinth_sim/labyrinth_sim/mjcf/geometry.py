# SPDX-License-Identifier: Apache-2.0
"""The labyrinth's measured geometry as values."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field

from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array, locked
from labyrinth_sim.yaml_file import Document, Entry, read_yaml


@dataclass(frozen=True)
class Layout:
    """One labyrinth board. Lengths in m, origin at the lower left corner of the inner board, z up.

    Attributes:
        name: of the layout.
        board_size: (2,) width along x and depth along y.
        walls_h: (n, 3) rows x_start, x_end, y of the walls along x.
        walls_v: (n, 3) rows y_start, y_end, x of the walls along y.
        holes: (n, 2) centres; hole number i is row i - 1.
        path: (n, 2) the marked way; the ball starts at its first point.
        ball_radius, hole_radius, wall_width, wall_height: m.
        ball_mass: kg.
        tilt_limit_deg: the board's stops, about either axis.
        landmark_spacing: (2,) between the centres of the dots on the inner frame, along x and y.
        landmark_diameter: m.
    """

    name: str
    board_size: Array
    walls_h: Array
    walls_v: Array
    holes: Array
    path: Array
    ball_radius: float
    ball_mass: float
    hole_radius: float
    wall_width: float
    wall_height: float
    tilt_limit_deg: float
    landmark_spacing: Array
    landmark_diameter: float

    def __post_init__(self) -> None:
        complaints = []
        for field, shape in _ARRAYS.items():
            array = locked(getattr(self, field))
            object.__setattr__(self, field, array)
            if array.ndim != len(shape) or array.shape[-1] != shape[-1] or not np.isfinite(array).all():
                complaints.append(f"{self.name}: {field} must be finite numbers of shape {shape}, got {array.shape}.")
        for field in _LENGTHS:
            if not getattr(self, field) > 0:
                complaints.append(f"{self.name}: {field} must be positive, got {getattr(self, field)!r}.")
        if not complaints:
            for number, hole in enumerate(self.holes, 1):
                if (hole < self.hole_radius).any() or (hole > self.board_size - self.hole_radius).any():
                    complaints.append(f"{self.name}: hole {number} at {hole.tolist()} reaches beyond the board.")
        if complaints:
            raise InputError(complaints)

    @property
    def start(self) -> Array:
        """(2,) m, where the ball is supplied."""
        return locked(self.path[0])

    def walls(self) -> list[tuple[float, float, float, float]]:
        """Every wall as x_min, x_max, y_min, y_max in m."""
        half = self.wall_width / 2
        along_x = [(x0, x1, y - half, y + half) for x0, x1, y in self.walls_h.tolist()]
        along_y = [(x - half, x + half, y0, y1) for y0, y1, x in self.walls_v.tolist()]
        return along_x + along_y


_ARRAYS = {
    "board_size": (2,),
    "walls_h": ("n", 3),
    "walls_v": ("n", 3),
    "holes": ("n", 2),
    "path": ("n", 2),
    "landmark_spacing": (2,),
}
_LENGTHS = (
    "ball_radius",
    "ball_mass",
    "hole_radius",
    "wall_width",
    "wall_height",
    "tilt_limit_deg",
    "landmark_diameter",
)


_Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
_Wall = Annotated[list[float], Field(min_length=3, max_length=3)]


class _GeometryFile(Entry):
    model_config = ConfigDict(extra="allow")  # what all layouts have in common
    layouts: dict[str, Any]


class _LayoutEntry(Entry):
    noun = "geometry"
    board_size: _Pair
    walls_h: list[_Wall]
    walls_v: list[_Wall]
    holes: list[_Pair]
    path: list[_Pair]
    ball_radius: float
    ball_mass: float
    hole_radius: float
    wall_width: float
    wall_height: float
    tilt_limit_deg: float
    landmark_spacing: _Pair
    landmark_diameter: float


def load_geometry(path: Path) -> dict[str, Layout]:
    """The layouts of a geometry file, by name.

    Raises:
        InputError: the file is missing, is no YAML, or lacks or misspells an entry.
    """
    document = read_yaml(path)
    document.read(_GeometryFile)
    common = {name: value for name, value in document.data.items() if name != "layouts"}
    layouts = {}
    for name in document.mapping(("layouts",)):
        own = document.mapping(("layouts", name))
        whole = Document(f"{path}: layout {name}", {**common, **own})
        entry = whole.read(_LayoutEntry)
        document.found += whole.found
        if entry is None:
            continue
        try:
            layouts[name] = Layout(name=name, **entry.model_dump())
        except InputError as error:
            document.complain(("layouts", name), str(error))
    document.check()
    return layouts
