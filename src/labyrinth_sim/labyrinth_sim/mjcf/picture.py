# SPDX-License-Identifier: Apache-2.0
"""Renders the labyrinth: the model, with the marked path, the landmarks and the belts drawn in."""

import argparse
import os
import sys
from itertools import pairwise
from pathlib import Path

# MuJoCo chooses its renderer while it is imported; EGL works without a screen.
os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.ball import BallGame
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.mjcf.geometry import Layout, load_geometry
from labyrinth_sim.mjcf.labyrinth import labyrinth_xml

PATH_COLOUR = (0.10, 0.10, 0.12, 1.0)
LANDMARK_COLOUR = (0.10, 0.35, 0.85, 1.0)
BELT_COLOUR = (0.08, 0.08, 0.09, 1.0)
SERVO_COLOUR = (0.22, 0.23, 0.26, 1.0)


def render(layout: Layout, tilt_deg: tuple[float, float], ball: int, width: int, height: int) -> NDArray[np.uint8]:
    """(height, width, 3) picture of the tilted board with the ball on point number `ball` of the path.

    Raises:
        InputError: nothing on this machine can render.
    """
    model = mujoco.MjModel.from_xml_string(labyrinth_xml(layout))
    data = mujoco.MjData(model)
    for axis, degrees in zip("xy", tilt_deg, strict=True):
        data.joint(f"board_{axis}").qpos = data.joint(f"motor_{axis}").qpos = np.radians(degrees)
    BallGame.of(model).supply(data.qpos, data.qvel, at=layout.path[ball])
    mujoco.mj_forward(model, data)
    try:
        with mujoco.Renderer(model, height, width, max_geom=5000) as renderer:
            renderer.update_scene(data, camera="overview")
            _decorate(renderer.scene, model, data, layout)
            return np.asarray(renderer.render())
    except Exception as error:  # each OpenGL binding fails in its own way
        raise InputError(
            f"Nothing here can render ({type(error).__name__}: {error}). "
            "Install EGL, or set MUJOCO_GL to egl, osmesa or glfw."
        ) from error


def _decorate(scene: mujoco.MjvScene, model: mujoco.MjModel, data: mujoco.MjData, layout: Layout) -> None:
    board, frame = data.body("board"), data.body("frame")

    def on_board(x: float, y: float, z: float) -> NDArray[np.float64]:
        flat = np.array([x, y]) - layout.board_size / 2
        return np.asarray(board.xpos + board.xmat.reshape(3, 3) @ np.array([*flat, z]))

    path = [on_board(x, y, 0.0) for x, y in layout.path]
    for a, b in pairwise(path):
        _connect(scene, a, b, 0.0007, PATH_COLOUR)
    half = layout.landmark_spacing / 2
    for sx in (-1, 1):
        for sy in (-1, 1):
            _dot(scene, board, np.array([sx * half[0], sy * half[1], 0.015]), layout.landmark_diameter / 2)
            outer = half + 0.016
            _dot(scene, frame, np.array([sx * outer[0], sy * outer[1], 0.010]), layout.landmark_diameter / 2)
    for axis in "xy":
        _belt(scene, data.body(f"motor_{axis}").xpos, axis)
    felt = np.array([*(layout.board_size / 2 + 0.035), 0.0005])
    _box(scene, np.array([0.0, 0.0, 0.0005]), felt, (0.10, 0.16, 0.13, 1.0))


def _dot(scene: mujoco.MjvScene, body: object, place: NDArray[np.float64], radius: float) -> None:
    rotation = np.asarray(body.xmat).reshape(3, 3)  # type: ignore[attr-defined]
    centre = np.asarray(body.xpos) + rotation @ place  # type: ignore[attr-defined]
    geom = _next(scene)
    size = np.array([radius, 0.0004, 0.0])
    colour = np.array(LANDMARK_COLOUR, dtype=np.float32)
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_CYLINDER, size, centre, rotation.ravel(), colour)


def _belt(scene: mujoco.MjvScene, horn: NDArray[np.float64], axis: str) -> None:
    """Servo below the horn, and two runs of belt between them."""
    along = np.array([1.0, 0.0, 0.0]) if axis == "x" else np.array([0.0, -1.0, 0.0])
    side = np.array([0.0, 1.0, 0.0]) if axis == "x" else np.array([1.0, 0.0, 0.0])
    servo = horn + 0.004 * along - np.array([0.0, 0.0, 0.05])
    for sign in (-1, 1):
        _connect(scene, horn + 0.004 * along + sign * 0.0135 * side, servo + sign * 0.0135 * side, 0.0016, BELT_COLOUR)
    _connect(scene, servo - 0.004 * along, servo + 0.004 * along, 0.0135, BELT_COLOUR, "cylinder")
    size = np.abs(0.012 * along) + 0.022 * side + np.array([0.0, 0.0, 0.016])
    _box(scene, servo + 0.016 * along - np.array([0.0, 0.0, 0.010]), size, SERVO_COLOUR)


def _box(
    scene: mujoco.MjvScene,
    centre: NDArray[np.float64],
    half: NDArray[np.float64],
    colour: tuple[float, float, float, float],
) -> None:
    rgba = np.array(colour, dtype=np.float32)
    mujoco.mjv_initGeom(_next(scene), mujoco.mjtGeom.mjGEOM_BOX, half, centre, np.eye(3).ravel(), rgba)


def _connect(
    scene: mujoco.MjvScene,
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    radius: float,
    colour: tuple[float, float, float, float],
    shape: str = "capsule",
) -> None:
    geom = _next(scene)
    kind = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.upper()}")
    rgba = np.array(colour, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
    mujoco.mjv_connector(geom, kind, radius, a, b)


def _next(scene: mujoco.MjvScene) -> mujoco.MjvGeom:
    scene.ngeom += 1
    return scene.geoms[scene.ngeom - 1]


def main(arguments: list[str] | None = None) -> int:
    """Command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m labyrinth_sim.mjcf.picture", description=__doc__)
    parser.add_argument("geometry", type=Path, help="YAML file of the geometry")
    parser.add_argument("out", type=Path, help="PNG file; replaced if it exists")
    parser.add_argument("--layout", default="hard", help="layout (default: %(default)s)")
    parser.add_argument("--tilt-deg", type=float, nargs=2, default=(-3.0, 4.0), metavar=("X", "Y"), help="of the board")
    parser.add_argument(
        "--ball", type=int, default=27, help="point of the path to put the ball on (default: %(default)s)"
    )
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 900), metavar=("WIDTH", "HEIGHT"), help="pixels")
    options = parser.parse_args(arguments)
    try:
        import cv2
    except ImportError:
        print("Left out the picture: writing it needs opencv-python-headless.", file=sys.stderr)
        return 0
    try:
        layouts = load_geometry(options.geometry)
        if options.layout not in layouts:
            raise InputError(unknown_name("layout", options.layout, layouts))
        layout = layouts[options.layout]
        if not 0 <= options.ball < len(layout.path):
            raise InputError(f"--ball {options.ball}: the path has points 0 to {len(layout.path) - 1}.")
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    try:
        image = render(layout, tuple(options.tilt_deg), options.ball, *options.size)
    except InputError as error:
        print(f"Left out the picture. {error}", file=sys.stderr)
        return 0
    options.out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(options.out), image[..., ::-1])
    print(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
