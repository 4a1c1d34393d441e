# SPDX-License-Identifier: Apache-2.0
"""`ros2 run labyrinth_hw calibrate_camera`: lens from a chessboard, latency from the moving board, a marble's colour.

`lens` and `marble` need no ROS. `latency` listens to NS/joint_states while it watches the board through the camera; let
a sequence play meanwhile. All write a new YAML file and overwrite none.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tqdm import tqdm

from labyrinth_hw.camera import Camera, Frame, Intrinsics
from labyrinth_hw.camera_calibration import calibrate_from_frames, measure_latency, with_latency
from labyrinth_hw.errors import InputError
from labyrinth_hw.landmarks import DotPlan, LandmarkTracker
from labyrinth_hw.marble import Marble

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
BOARD_JOINTS = ("board_x", "board_y")


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="calibrate_camera", description=__doc__.split("\n")[0].split(": ", 1)[1])
    commands = top.add_subparsers(dest="command", required=True)
    lens = commands.add_parser("lens", help="intrinsics from a chessboard, in front of the camera or in pictures")
    where = lens.add_mutually_exclusive_group(required=True)
    where.add_argument("--source", help="device number or path, video file, or stream address")
    where.add_argument("--pictures", type=Path, help="folder of pictures")
    lens.add_argument("--corners", required=True, help="inner corners per row and column, e.g. 9x6")
    lens.add_argument("--square-mm", type=float, required=True, help="side of a square, mm")
    lens.add_argument("--views", type=int, default=25, help="views to take from a source, one every 0.5 s (default 25)")
    latency = commands.add_parser("latency", help="latency from the board's tilt seen against NS/joint_states")
    latency.add_argument("--source", required=True, help="device number or path, or stream address")
    latency.add_argument("--camera", type=Path, required=True, help="file that `lens` wrote")
    latency.add_argument("--ns", default="real", help="namespace of joint_states (default real)")
    latency.add_argument(
        "--axis", default="board_x", choices=BOARD_JOINTS, help="joint to compare with (default %(default)s)"
    )
    latency.add_argument("--seconds", type=float, default=15.0, help="how long to watch (default 15)")
    marble = commands.add_parser("marble", help="a painted marble's colour from one click on it")
    marble.add_argument("--source", required=True, help="device number or path, picture, video file, or stream address")
    marble.add_argument(
        "--at", nargs=2, type=int, metavar=("X", "Y"), help="px of the click; without it a window opens to click in"
    )
    for command in (lens, latency, marble):
        command.add_argument("--out", type=Path, required=True, help="new YAML file")
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    given, rest = parser().parse_known_args(arguments)
    try:
        if rest and "--ros-args" not in rest:
            raise InputError(f"Unknown arguments: {' '.join(rest)}. See calibrate_camera {given.command} --help.")
        if given.out.exists():
            raise InputError(f"{given.out} exists and is not overwritten. Give another name.")
        calibration: Intrinsics | Marble
        if given.command == "marble":
            calibration = _marble(given)
        else:
            calibration = _lens(given) if given.command == "lens" else _latency(given, rest)
        calibration.save(given.out)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("Stopped; nothing was written.", file=sys.stderr)
        return 130
    print(f"{given.out} written.")
    return 0


def _lens(given: argparse.Namespace) -> Intrinsics:
    try:
        across, down = (int(n) for n in given.corners.lower().split("x"))
    except ValueError:
        raise InputError(f"--corners must look like 9x6, got '{given.corners}'.") from None
    if min(across, down) < 3 or given.square_mm <= 0:
        raise InputError("A chessboard needs 3x3 inner corners or more and squares of a positive size.")
    frames = _pictures(given.pictures) if given.pictures else _views(given.source, given.views)
    with tqdm(frames, desc="views", unit="view") as bar:
        lens = calibrate_from_frames(
            bar, (across, down), given.square_mm / 1e3, lambda seen, used: bar.set_postfix(used=used)
        )
    print(
        f"focal length {lens.fx:.1f} {lens.fy:.1f} px, principal point {lens.cx:.1f} {lens.cy:.1f} px, "
        f"distortion {' '.join(f'{k:.4f}' for k in lens.distortion)}, residual {lens.residual:.2f} px"
    )
    if lens.residual > 1.0:
        print("Residual above 1 px: is the board flat, the corner count right, the focus fixed?", file=sys.stderr)
    return lens


def _marble(given: argparse.Namespace) -> Marble:
    frame = next(_views(given.source, 1), None)
    if frame is None:
        raise InputError(f"{given.source} delivered no picture.")
    marble = Marble.clicked(frame, tuple(given.at) if given.at else _click(frame))
    print(f"tint {marble.tint[0]:.2f} {marble.tint[1]:.2f}, brightness {marble.brightness:.2f} of the wood's")
    return marble


def _click(frame: Frame) -> tuple[int, int]:
    """Where a person clicks in a window."""
    clicks: list[tuple[int, int]] = []
    title = "Click on the marble's middle"
    try:
        cv2.imshow(title, frame)
        cv2.setMouseCallback(title, lambda event, x, y, *_: clicks.append((x, y)) if event == 1 else None)
        while not clicks:
            if cv2.waitKey(50) == 27:
                raise KeyboardInterrupt
        cv2.destroyAllWindows()
    except cv2.error as error:
        raise InputError(
            "No window can be opened here; give the click by --at X Y, as any picture viewer shows it."
        ) from error
    return clicks[0]


def _pictures(folder: Path) -> list[Frame]:
    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in PICTURES)
    if not paths:
        raise InputError(f"No pictures in {folder}. Known endings: {', '.join(PICTURES)}.")
    frames = {path.name: cv2.imread(str(path)) for path in paths}
    broken = [name for name, frame in frames.items() if frame is None]
    if broken:
        raise InputError(f"Not readable as pictures: {', '.join(broken)}.")
    return [np.asarray(frame, np.uint8) for frame in frames.values()]


def _views(source: str, count: int) -> Iterator[Frame]:
    with Camera(source) as camera:
        number = 0
        for _ in range(count):
            shot = camera.newest(number, timeout=5.0)
            if shot is None:
                if number == 0:
                    raise InputError(f"No frame in 5 s. {camera.state.message}")
                return
            number = shot.number
            yield shot.image
            time.sleep(0.5)


def _latency(given: argparse.Namespace, ros: Sequence[str]) -> Intrinsics:
    import rclpy
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    lens = Intrinsics.load(given.camera)
    encoder: list[tuple[float, float]] = []

    def take(message: Any) -> None:
        if given.axis in message.name:
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            encoder.append((stamp, message.position[message.name.index(given.axis)]))

    rclpy.init(args=list(ros))
    node = rclpy.create_node("calibrate_camera")
    try:
        node.create_subscription(JointState, f"{given.ns.rstrip('/')}/joint_states", take, QoSProfile(depth=1000))
        seen = _watch(given, lens, lambda: rclpy.spin_once(node, timeout_sec=0.0))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    if len(encoder) < 2:
        raise InputError(f"{len(encoder)} positions of {given.axis} on {given.ns}/joint_states. Is the node running?")
    angles = np.array(encoder)
    found = measure_latency(seen[:, 0], seen[:, 1 + BOARD_JOINTS.index(given.axis)], angles[:, 0], angles[:, 1])
    print(f"latency {1e3 * found.seconds:.1f} +- {1e3 * found.spread:.1f} ms, correlation {found.correlation:.3f}")
    return with_latency(lens, found)


def _watch(given: argparse.Namespace, lens: Intrinsics, spin: Any) -> np.ndarray:
    """(n, 3): stamp s, tilt about x and y rad, NaN where the board was not found."""
    marks, rows, number = LandmarkTracker(DotPlan.from_sizes(), lens), [], 0
    over = time.monotonic() + given.seconds
    with Camera(given.source) as camera, tqdm(desc="frames", unit="frame") as bar:
        while time.monotonic() < over:
            for _ in range(20):
                spin()
            shot = camera.newest(number, timeout=0.02)
            if shot is None:
                continue
            number = shot.number
            pose = marks.update(shot.image)
            rows.append((shot.stamp, *(pose.tilt if pose is not None else (np.nan, np.nan))))
            bar.update()
        if not rows:
            raise InputError(f"No frame in {given.seconds:g} s. {camera.state.message}")
    return np.array(rows)


if __name__ == "__main__":
    sys.exit(main())
