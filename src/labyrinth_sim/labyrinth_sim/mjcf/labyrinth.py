# SPDX-License-Identifier: Apache-2.0
"""MJCF of the labyrinth, made from its geometry.

World: x to the right, y away from the player, z up, the gimbal's centre at height PIVOT_HEIGHT. The outer frame turns
about x (`board_x`), the inner board in it about y (`board_y`). Positive `board_y` makes the ball roll towards +x,
positive `board_x` towards -y. Servo and board are joined by the tendons `belt_x`, `belt_y`: springs on
ratio * motor - board.

The floor with its round holes is made of convex pieces, since MuJoCo subtracts no shapes. Every hole sits in a square
patch of wedges around a regular polygon; the rest of the floor is tiled by rectangles. All tops are coplanar. Where
pieces meet, each reaches BEVEL_WIDTH under its neighbour, sloping down by BEVEL_SLOPE: a ball pressed into one piece
would otherwise catch the edge of the next (docs/decisions/labyrinth_mjcf.md).
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from labyrinth_sim.errors import InputError
from labyrinth_sim.mjcf.geometry import Layout
from labyrinth_sim.trials import Array, runs

TIMESTEP = 0.002  # s; see docs/decisions/labyrinth_mjcf.md
PIVOT_HEIGHT = 0.08  # m, estimate
FLOOR_THICKNESS = 0.005  # m, estimate
RIM_WIDTH, RIM_HEIGHT = 0.008, 0.015  # m, estimate
FRAME_GAP, FRAME_WIDTH, FRAME_HEIGHT = 0.006, 0.010, 0.020  # m, estimate
BOX_GAP, BOX_WALL = 0.012, 0.010  # m, estimate

BOARD_MASS = 0.30  # kg, estimate: 5 mm plywood at 600 kg/m^3, walls and rim
FRAME_MASS = 0.15  # kg, estimate
HORN_MASS = 0.02  # kg, estimate
ARMATURE = 0.01  # kg m^2 behind the gear, estimate; fitted figures of such servos lie between 0.002 and 0.045
STALL_TORQUE = 2.8  # N m, estimate for a DX-117 at 12 V; not checked against its manual

BELT_RATIO = 1.0  # board angle per motor angle: the paper's motor angles are board angles
BELT_STIFFNESS = 100.0  # N m/rad: 1.6 deg at stall torque, hardly more than rigid; resonance at 45 Hz
BELT_DAMPING = 0.3  # N m s/rad

POLYGON_SIDES = 12
PATCH_MARGIN = 0.004  # m from the polygon to the edge of its patch
BEVEL_WIDTH = 0.0035  # m, less than PATCH_MARGIN
BEVEL_SLOPE = 0.0005


@dataclass(frozen=True)
class Piece:
    """A convex piece of floor, its top at z = 0.

    Attributes:
        top: (n, 2) m, corners of the flat top, counter-clockwise.
        foot: (m, 2) m, corners at the end of the bevel, where the vertical sides begin.
    """

    top: Array
    foot: Array

    def vertices(self, thickness: float) -> Array:
        """(n + 2 m, 3) m: top, end of the bevel, underside at z = -thickness."""
        levels = ((self.top, 0.0), (self.foot, -BEVEL_SLOPE * BEVEL_WIDTH), (self.foot, -thickness))
        return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for flat, z in levels])


def polygon_inradius(radius: float, sides: int = POLYGON_SIDES) -> float:
    """Inner radius of the regular polygon whose edge deviates from the circle as much inwards as outwards, m.

    The deviation is `radius - polygon_inradius(radius)`: 0.12 mm for a 7 mm hole with 12 sides, half of the 0.25 mm to
    which the centres of the holes are known.
    """
    return 2 * radius / (1 + 1 / math.cos(math.pi / sides))


def floor_tiles(low: Array, high: Array, holes: Array, radius: float) -> list[Piece]:
    """Tiles that cover the rectangle from `low` to `high`, (2,) m each, but for the patches of `holes`, (n, 2) m.

    Raises:
        InputError: holes so close to one another that their patches overlap.
    """
    half = polygon_inradius(radius) + PATCH_MARGIN
    apart = np.abs(holes[:, None] - holes[None, :]).max(axis=-1) + np.eye(len(holes))
    if len(holes) and apart.min() < 2 * half:
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        needed = f"at least {2e3 * half:.1f} mm along x or y are needed"
        raise InputError(f"Holes {i + 1} and {j + 1} are {1e3 * apart.min():.1f} mm apart; {needed}.")
    pieces = []
    for x0, x1, y0, y1 in _rectangles(low, high, holes, half):
        top = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        pieces.append(Piece(top, _outset(top, [BEVEL_WIDTH] * 4)))
    return pieces


def hole_wedges(radius: float, sides: int = POLYGON_SIDES) -> list[Piece]:
    """The pieces of one patch, around a hole at the origin.

    Args:
        radius: of the hole, m.
        sides: of the polygon; 12, 20, 28, ... so that the patch's corners are corners of wedges.
    """
    inner = polygon_inradius(radius, sides)
    half = inner + PATCH_MARGIN
    outer_radius = inner / math.cos(math.pi / sides)
    angles = (np.arange(sides + 1) - 0.5) * 2 * math.pi / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    square = ring * half / np.abs(ring).max(axis=1, keepdims=True)
    pieces = []
    for i in range(sides):
        top = np.array([ring[i] * outer_radius, square[i], square[i + 1], ring[i + 1] * outer_radius])
        # The last side is the hole's edge: sharp. Acute corners must not reach into the next hole.
        foot = _outset(top, [BEVEL_WIDTH] * 3 + [0.0])
        for normal in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            foot = _cut(foot, np.array(normal), half + BEVEL_WIDTH)
        pieces.append(Piece(top, foot))
    return pieces


def _outset(polygon: Array, by: list[float]) -> Array:
    """(n, 2) corners of a convex polygon whose sides were moved outwards; side i starts at corner i."""
    sides = np.roll(polygon, -1, axis=0) - polygon
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1, keepdims=True)
    offsets = (normals * polygon).sum(axis=1) + np.array(by)
    corners = [np.linalg.solve(normals[[i - 1, i]], offsets[[i - 1, i]]) for i in range(len(polygon))]
    return np.array(corners)


def _cut(polygon: Array, normal: Array, limit: float) -> Array:
    """(m, 2) corners of the part of a convex polygon where normal . x <= limit (Sutherland and Hodgman's clipping)."""
    corners = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        over_a, over_b = float(normal @ a) - limit, float(normal @ b) - limit
        if over_a <= 0:
            corners.append(a)
        if over_a * over_b < 0:
            corners.append(a + over_a / (over_a - over_b) * (b - a))
    return np.array(corners)


def _rectangles(low: Array, high: Array, holes: Array, half: float) -> list[tuple[float, float, float, float]]:
    """Partition of a rectangle minus squares into x0, x1, y0, y1, the largest free one first."""
    lines = []
    for axis in (0, 1):
        cuts = np.concatenate([[low[axis], high[axis]], holes[:, axis] - half, holes[:, axis] + half])
        lines.append(np.unique(np.round(cuts, 9)))
    xs, ys = lines
    mid_x, mid_y = (xs[:-1] + xs[1:]) / 2, (ys[:-1] + ys[1:]) / 2
    free = np.ones((len(mid_x), len(mid_y)), dtype=bool)
    for hx, hy in holes:
        free &= ~((np.abs(mid_x - hx) < half)[:, None] & (np.abs(mid_y - hy) < half)[None, :])
    rectangles = []
    while free.any():
        i0, i1, j0, j1 = _largest(free, xs, ys)
        free[i0:i1, j0:j1] = False
        rectangles.append((float(xs[i0]), float(xs[i1]), float(ys[j0]), float(ys[j1])))
    return rectangles


def _largest(free: np.ndarray, xs: Array, ys: Array) -> tuple[int, int, int, int]:
    """Index bounds i0, i1, j0, j1 of the free rectangle of largest area."""
    best, bounds = 0.0, (0, 0, 0, 0)
    for i0 in range(free.shape[0]):
        columns = np.ones(free.shape[1], dtype=bool)
        for i1 in range(i0 + 1, free.shape[0] + 1):
            columns &= free[i1 - 1]
            if not columns.any():
                break
            for j0, j1 in runs(columns):
                area = float((xs[i1] - xs[i0]) * (ys[j1] - ys[j0]))
                if area > best * (1 + 1e-9):
                    best, bounds = area, (i0, i1, j0, j1)
    return bounds


@dataclass(frozen=True)
class DriveTrain:
    """What turns the board.

    Attributes:
        ratio: of axes x and y, board angle over motor angle.
        armature: kg m^2 of the motor at its shaft. torque: N m, at stall.
        stiffness, damping: of the belt or string, at the board, N m/rad, N m s/rad.
    """

    ratio: tuple[float, float] = (BELT_RATIO, BELT_RATIO)
    armature: float = ARMATURE
    torque: float = STALL_TORQUE
    stiffness: float = BELT_STIFFNESS
    damping: float = BELT_DAMPING


BELTS = DriveTrain()
CYBERRUNNER = DriveTrain(  # small servos turn the knobs of the toy, whose strings turn the board
    ratio=(0.073, 0.115), armature=1.5e-4, torque=0.215
)

# Ball contact, the same with everything it touches: as stiff as the time step allows, 2 um deep at rest.
FRICTION = "0.6 0.005 0.0001"  # steel on painted wood, estimate; only the first acts (condim 3)
SOLREF, SOLIMP = "0.004 1", "0.99 0.999 0.0001"

AXES = {"x": "1 0 0", "y": "0 1 0"}


def labyrinth_xml(layout: Layout, plain: bool = False, train: DriveTrain = BELTS, name: str = "") -> str:
    """MJCF text of one layout.

    Args:
        layout: the geometry.
        plain: leave out walls, holes and ball, with the same inertia: for questions about the servos only.
        train: what turns the board.
        name: of the model; that of the layout by default.
    """
    root = ET.Element("mujoco", model=name or f"labyrinth_{'plain' if plain else layout.name}")
    root.append(ET.Comment(" Made by labyrinth_sim.mjcf from config/labyrinth_geometry.yaml; do not edit. SI units. "))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = ET.SubElement(root, "option", timestep=_n(TIMESTEP), integrator="implicitfast")
    if not plain:
        option.set("cone", "elliptic")
        option.set("impratio", "10")
    asset = _looks(root)
    world = ET.SubElement(root, "worldbody")
    _surroundings(world, layout)
    frame = _frame(world, layout)
    _board(frame, asset, layout, plain)
    _motors(world, layout, train)
    if not plain:
        _ball(world, layout)
    _drive_train(root, train)
    _sensors(root, plain)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _looks(root: ET.Element) -> ET.Element:
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", ambient="0.32 0.32 0.32", diffuse="0.20 0.20 0.20", specular="0.1 0.1 0.1")
    ET.SubElement(visual, "quality", shadowsize="4096", offsamples="8")
    ET.SubElement(visual, "global", offwidth="1920", offheight="1280")
    ET.SubElement(visual, "map", znear="0.02", zfar="20")
    default = ET.SubElement(root, "default")
    # Only the ball collides (contype), and with everything that carries the ball's bit (conaffinity).
    ET.SubElement(default, "geom", type="box", contype="0", conaffinity="1", condim="3")
    asset = ET.SubElement(root, "asset")
    sky = {"type": "skybox", "builtin": "gradient", "rgb1": "0.93 0.95 0.98", "rgb2": "0.70 0.76 0.84"}
    ET.SubElement(asset, "texture", sky, width="256", height="256")
    for name, rgba, specular, shininess in (
        ("table", "0.36 0.41 0.46 1", "0.1", "0.1"),
        ("case", "0.55 0.33 0.18 1", "0.3", "0.4"),
        ("frame", "0.66 0.43 0.25 1", "0.3", "0.4"),
        ("floor", "0.90 0.80 0.62 1", "0.2", "0.2"),
        ("wall", "0.72 0.47 0.26 1", "0.3", "0.4"),
        ("steel", "0.80 0.82 0.85 1", "1", "0.9"),
        ("servo", "0.13 0.14 0.16 1", "0.5", "0.5"),
    ):
        ET.SubElement(asset, "material", name=name, rgba=rgba, specular=specular, shininess=shininess)
    return asset


def _surroundings(world: ET.Element, layout: Layout) -> None:
    lights = (
        ("-0.45 -0.25 1.0", "0.45 0.25 -0.95", "0.6", "true"),
        ("0.6 0.1 0.9", "-0.6 -0.1 -0.9", "0.18", "false"),
    )
    for pos, direction, diffuse, shadow in lights:
        spot = {"pos": pos, "dir": direction, "diffuse": " ".join([diffuse] * 3), "castshadow": shadow}
        ET.SubElement(world, "light", spot, cutoff="60", specular="0.3 0.3 0.3")
    ET.SubElement(world, "camera", name="overview", pos="0 -0.46 0.60", xyaxes="1 0 0 0 0.785 0.62", fovy="35")
    ET.SubElement(world, "camera", name="above", pos=f"0 0 {_n(PIVOT_HEIGHT + 1.0)}", fovy="22")
    # Below the board the table catches lost balls, the case keeps them together.
    ET.SubElement(world, "geom", name="table", type="plane", size="2 2 0.1", material="table")
    inner = layout.board_size / 2 + RIM_WIDTH + FRAME_GAP + FRAME_WIDTH + BOX_GAP
    _ring(world, "case", inner, BOX_WALL, 0.0, PIVOT_HEIGHT + 0.012, "case")


def _frame(world: ET.Element, layout: Layout) -> ET.Element:
    frame = ET.SubElement(world, "body", name="frame", pos=f"0 0 {_n(PIVOT_HEIGHT)}")
    inner = layout.board_size / 2 + RIM_WIDTH + FRAME_GAP
    width, depth = 2 * (inner + FRAME_WIDTH / 2)
    # A thin rectangular hoop of even line density, balanced on its axis.
    line = FRAME_MASS / (2 * (width + depth))
    about_x = line * (width * depth**2 / 2 + depth**3 / 6)
    about_y = line * (depth * width**2 / 2 + width**3 / 6)
    _inertial(frame, FRAME_MASS, (about_x, about_y, about_x + about_y))
    _hinge(frame, "board_x", layout)
    _ring(frame, "frame", inner, FRAME_WIDTH, -FRAME_HEIGHT + 0.01, 0.01, "frame")
    return frame


def _board(frame: ET.Element, asset: ET.Element, layout: Layout, plain: bool) -> None:
    board = ET.SubElement(frame, "body", name="board")
    width, depth = layout.board_size + 2 * RIM_WIDTH
    plate = [BOARD_MASS * side**2 / 12 for side in (depth, width)]
    _inertial(board, BOARD_MASS, (plate[0], plate[1], plate[0] + plate[1]))
    _hinge(board, "board_y", layout)
    half = layout.board_size / 2
    ET.SubElement(board, "site", name="board_origin", pos=_v([*-half, 0]), size="0.002", group="4")
    _ring(board, "rim", half, RIM_WIDTH, 0.0, RIM_HEIGHT, "wall")
    if plain:
        slab = {"pos": _v([0, 0, -FLOOR_THICKNESS / 2]), "size": _v([*(half + RIM_WIDTH), FLOOR_THICKNESS / 2])}
        ET.SubElement(board, "geom", {"name": "floor"} | slab, material="floor")
        return
    _floor(board, asset, layout)
    for number, (x0, x1, y0, y1) in enumerate(layout.walls(), 1):
        size = ((x1 - x0) / 2, (y1 - y0) / 2, layout.wall_height / 2)
        pos = ((x0 + x1) / 2 - half[0], (y0 + y1) / 2 - half[1], layout.wall_height / 2)
        ET.SubElement(board, "geom", name=f"wall_{number}", pos=_v(pos), size=_v(size), material="wall")


def _floor(board: ET.Element, asset: ET.Element, layout: Layout) -> None:
    half = layout.board_size / 2
    holes = layout.holes - half
    attributes = {"type": "mesh", "material": "floor"}
    for number, tile in enumerate(floor_tiles(-half - RIM_WIDTH, half + RIM_WIDTH, holes, layout.hole_radius), 1):
        _mesh(asset, f"floor_{number}", tile)
        ET.SubElement(board, "geom", {"name": f"floor_{number}", "mesh": f"floor_{number}"} | attributes)
    wedges = hole_wedges(layout.hole_radius)
    for i, wedge in enumerate(wedges, 1):
        _mesh(asset, f"wedge_{i}", wedge)
    for number, (x, y) in enumerate(holes, 1):
        place = {"pos": _v([x, y, 0])}
        size = {"size": _n(layout.hole_radius), "rgba": "0 0 0 0", "group": "4"}
        ET.SubElement(board, "site", {"name": f"hole_{number}"} | place | size)
        for i in range(1, len(wedges) + 1):
            ET.SubElement(board, "geom", {"name": f"hole_{number}_{i}", "mesh": f"wedge_{i}"} | place | attributes)


def _motors(world: ET.Element, layout: Layout, train: DriveTrain) -> None:
    reach = layout.board_size / 2 + RIM_WIDTH + FRAME_GAP + FRAME_WIDTH + BOX_GAP + BOX_WALL
    places = {"x": (reach[0] + 0.004, 0.0, PIVOT_HEIGHT), "y": (0.0, -reach[1] - 0.004, PIVOT_HEIGHT)}
    for axis, place in places.items():
        motor = ET.SubElement(world, "body", name=f"motor_{axis}", pos=_v(place))
        _inertial(motor, HORN_MASS, (1e-6, 1e-6, 1e-6))
        ET.SubElement(motor, "joint", name=f"motor_{axis}", axis=AXES[axis], armature=_n(train.armature))
        ends = "-0.004 0 0 0.004 0 0" if axis == "x" else "0 -0.004 0 0 0.004 0"
        attributes = {"contype": "0", "conaffinity": "0", "material": "servo"}
        ET.SubElement(motor, "geom", attributes, name=f"horn_{axis}", type="cylinder", fromto=ends, size="0.014")


def _ball(world: ET.Element, layout: Layout) -> None:
    start = layout.start - layout.board_size / 2
    ball = ET.SubElement(world, "body", name="ball", pos=_v([*start, PIVOT_HEIGHT + layout.ball_radius]))
    ET.SubElement(ball, "freejoint", name="ball")
    contact = {"contype": "1", "conaffinity": "0", "priority": "1", "friction": FRICTION}
    contact |= {"solref": SOLREF, "solimp": SOLIMP}
    size = {"type": "sphere", "size": _n(layout.ball_radius), "mass": _n(layout.ball_mass), "material": "steel"}
    ET.SubElement(ball, "geom", {"name": "ball"} | size | contact)


def _drive_train(root: ET.Element, train: DriveTrain) -> None:
    tendons = ET.SubElement(root, "tendon")
    actuators = ET.SubElement(root, "actuator")
    for axis, ratio in zip(AXES, train.ratio, strict=True):
        spring = {"stiffness": _n(train.stiffness), "damping": _n(train.damping), "springlength": "0 0"}
        belt = ET.SubElement(tendons, "fixed", {"name": f"belt_{axis}"} | spring)
        ET.SubElement(belt, "joint", joint=f"motor_{axis}", coef=_n(ratio))
        ET.SubElement(belt, "joint", joint=f"board_{axis}", coef="-1")
        limit = f"{-train.torque} {train.torque}"
        name = f"motor_{axis}"
        ET.SubElement(actuators, "motor", name=name, joint=name, ctrlrange=limit, forcerange=limit)


def _sensors(root: ET.Element, plain: bool) -> None:
    sensors = ET.SubElement(root, "sensor")
    for kind, suffix in (("jointpos", ""), ("jointvel", "_velocity")):
        for joint in ("motor_x", "motor_y", "board_x", "board_y"):
            ET.SubElement(sensors, kind, name=joint + suffix, joint=joint)
    for joint in ("motor_x", "motor_y"):
        ET.SubElement(sensors, "jointactuatorfrc", name=f"{joint}_effort", joint=joint)
    if not plain:
        reference = {"reftype": "site", "refname": "board_origin"}
        ET.SubElement(sensors, "framepos", {"name": "ball", "objtype": "body", "objname": "ball"} | reference)


def _mesh(asset: ET.Element, name: str, piece: Piece) -> None:
    ET.SubElement(asset, "mesh", name=name, vertex=_v(piece.vertices(FLOOR_THICKNESS).ravel()))


def _ring(
    parent: ET.Element, name: str, inner: np.ndarray, width: float, bottom: float, top: float, material: str
) -> None:
    """Four boxes around a rectangle of half sizes `inner` (2,) m."""
    z, half_z = (bottom + top) / 2, (top - bottom) / 2
    x, y = inner + width / 2
    for side, pos, size in (
        ("left", (-x, 0.0, z), (width / 2, inner[1], half_z)),
        ("right", (x, 0.0, z), (width / 2, inner[1], half_z)),
        ("front", (0.0, -y, z), (inner[0] + width, width / 2, half_z)),
        ("back", (0.0, y, z), (inner[0] + width, width / 2, half_z)),
    ):
        ET.SubElement(parent, "geom", name=f"{name}_{side}", pos=_v(pos), size=_v(size), material=material)


def _hinge(body: ET.Element, name: str, layout: Layout) -> None:
    stop = float(np.radians(layout.tilt_limit_deg))
    ET.SubElement(body, "joint", name=name, axis=AXES[name[-1]], range=_v([-stop, stop]))


def _inertial(body: ET.Element, mass: float, diagonal: Iterable[float]) -> None:
    ET.SubElement(body, "inertial", pos="0 0 0", mass=_n(mass), diaginertia=_v(diagonal))


def _n(value: float) -> str:
    return f"{value:.7g}"


def _v(values: Iterable[float]) -> str:
    return " ".join(_n(round(float(value), 9) + 0.0) for value in values)
