# SPDX-License-Identifier: Apache-2.0
"""What the emulated camera looks at: the labyrinth's layout, the light, the lens, and one moment's state.

Board frame: origin at the lower left corner of the inner board's floor, x right, y up in the picture, z to the camera.
Box frame: the same when the board is level. The board turns about its centre, R = Rx(tilt_x) Ry(tilt_y), right-handed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labyrinth_hw.errors import InputError
from labyrinth_hw.geometry import Geometry, load_geometry
from labyrinth_hw.testbed.quantities import Array

Point = tuple[float, float]


@dataclass(frozen=True)
class Layout:
    """Board figures in m.

    Attributes:
        board: width and depth of the inner board.
        walls: (x0, y0, x1, y1) of each wall's footprint.
        holes, path: points; the path is a line through them.
        inner_dots, outer_dots: sizes of the rectangles whose corners carry the blue dots, about the board's centre.
    """

    board: Point
    walls: tuple[tuple[float, float, float, float], ...]
    holes: tuple[Point, ...]
    path: tuple[Point, ...]
    ball_radius: float = 0.00635
    hole_radius: float = 0.007
    wall_height: float = 0.0065
    inner_dots: Point = (0.2835, 0.2385)
    outer_dots: Point = (0.325, 0.280)
    dot_diameter: float = 0.008
    dot_height: float = 0.0065

    @staticmethod
    def of(geometry: Geometry, name: str = "easy") -> "Layout":
        """One of a geometry's layouts. Raises InputError that lists the layouts there are."""
        chosen, half = geometry.layout(name), geometry.wall_width / 2
        walls = [(x0, y - half, x1, y + half) for x0, x1, y in chosen.walls_h]
        walls += [(x - half, y0, x + half, y1) for y0, y1, x in chosen.walls_v]
        return Layout(
            board=geometry.board_size,
            walls=tuple(walls),
            holes=chosen.holes,
            path=chosen.path,
            ball_radius=geometry.ball_radius,
            hole_radius=geometry.hole_radius,
            wall_height=geometry.wall_height,
            inner_dots=geometry.landmark_spacing,
            dot_diameter=geometry.landmark_diameter,
        )

    def rim(self) -> tuple[tuple[float, float, float, float], ...]:
        """(x0, y0, x1, y1) of the four sides of the board's frame, as high as the walls."""
        (w, d), t = self.board, 0.0075
        return (-t, -t, w + t, 0), (-t, d, w + t, d + t), (-t, 0, 0, d), (w, 0, w + t, d)

    def dots(self, size: Point) -> Array:
        """(4, 3) m: lower left, lower right, upper right, upper left dot of a rectangle about the board's centre."""
        centre = np.array(self.board) / 2
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.array(size) / 2 + centre
        return np.column_stack([corners, np.full(4, self.dot_height)])


@dataclass(frozen=True)
class Lens:
    """A camera looking down at the box.

    Attributes:
        size: picture width and height, px.
        focal: focal length, px.
        distortion: k1, k2, p1, p2, k3 of the Brown-Conrady model.
        position: m, box frame, relative to the board's centre.
        turn: rotation vector, rad, that turns the camera out of looking straight down with its right along +x.
    """

    size: tuple[int, int] = (640, 360)
    focal: float = 285.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    position: tuple[float, float, float] = (0.0, 0.0, 0.25)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @staticmethod
    def at_height(height: float) -> "Lens":
        """A lens `height` m above the board whose picture the box just fills (0.31 m from top to bottom)."""
        return Lens(focal=360 * height / 0.31, position=(0.0, 0.0, height))


@dataclass(frozen=True)
class Lighting:
    """How the scene is lit and how the sensor answers.

    Attributes:
        level: brightness; 1 is well exposed.
        lamp: direction towards the lamp, box frame (any length; z > 0).
        lamp_strength: brightness of the lamp's mirror image on the ball.
        gradient: relative change of the light from left to right and from bottom to top of the picture.
        room_gradient: relative change of the room's brightness, as the ball mirrors it, along x and y.
        warmth: colour temperature; 0 neutral, 0.3 a warm bulb, negative bluish.
        shadow: darkness of shadows, 0 to 1.
        glare: brightness (0 to 1) of the varnish's mirror image of a window, at `glare_at` (fractions of the board).
        glare_size: its extent, m.
        blur: optical blur, standard deviation in px.
        noise: read noise, standard deviation in grey levels; shot noise of the same size at grey 128 is added.
    """

    level: float = 1.0
    lamp: tuple[float, float, float] = (0.3, 0.4, 1.0)
    lamp_strength: float = 1.0
    gradient: Point = (0.0, 0.0)
    room_gradient: Point = (0.0, 0.0)
    warmth: float = 0.1
    shadow: float = 0.45
    glare: float = 0.0
    glare_at: Point = (0.4, 0.4)
    glare_size: float = 0.03
    blur: float = 0.5
    noise: float = 2.0

    @staticmethod
    def drawn(rng: np.random.Generator) -> "Lighting":
        """A random, plausible room: dim to bright, any lamp, glare half of the time."""
        around, down = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.9)
        return Lighting(
            level=float(rng.uniform(0.55, 1.25)),
            lamp=(float(down * np.cos(around)), float(down * np.sin(around)), 1.0),
            lamp_strength=float(rng.uniform(0.3, 1.5)),
            gradient=_pair(rng.uniform(-0.35, 0.35, 2)),
            room_gradient=_pair(rng.uniform(-0.5, 0.5, 2)),
            warmth=float(rng.uniform(-0.05, 0.3)),
            shadow=float(rng.uniform(0.2, 0.7)),
            glare=float(rng.uniform(0.2, 0.6)) if rng.random() < 0.5 else 0.0,
            glare_at=_pair(rng.uniform(0.25, 0.75, 2)),
            glare_size=float(rng.uniform(0.012, 0.045)),
            blur=float(rng.uniform(0.3, 1.0)),
            noise=float(rng.uniform(0.5, 4.0)),
        )


@dataclass(frozen=True)
class Scene:
    """One moment: the middle of one exposure.

    Attributes:
        ball: m, board frame; None when there is none on the board.
        velocity: of the ball, m/s, board frame; smears it over the exposure.
        tilt: tilt_x, tilt_y, rad.
        exposure: s.
        covers: (x, y, width, height) px of dark things between camera and board, such as a hand.
        lens_covered: nothing but the dark is seen.
    """

    ball: Point | None = None
    velocity: Point = (0.0, 0.0)
    tilt: Point = (0.0, 0.0)
    exposure: float = 0.006
    covers: tuple[tuple[int, int, int, int], ...] = ()
    lens_covered: bool = False


def _pair(values: Sequence[float] | Array) -> Point:
    x, y = values
    return float(x), float(y)


def turn_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turn_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def load_layout(name: str) -> Layout:
    """A layout of config/labyrinth_geometry.yaml. Raises InputError where the file or the layout is missing."""
    geometry = load_geometry()
    if geometry is None:
        raise InputError("config/labyrinth_geometry.yaml was not found; name its folder in $EPS_TUNNEL_CONFIG.")
    return Layout.of(geometry, name)
