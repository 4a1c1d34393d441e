# SPDX-License-Identifier: Apache-2.0
"""ROS messages of what the rig measured."""

import time
from collections.abc import Callable, Iterable
from math import nan

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import CameraInfo, Image, JointState

from labyrinth_hw.camera import Intrinsics
from labyrinth_hw.hardware import Health, Measurement
from labyrinth_hw.vision import Sight
from labyrinth_msgs.msg import BallState

LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}
OPTICAL_FRAME = "camera_optical_frame"  # x to the right of the picture, y down, z away from the camera
STEP = 0.05  # s; a change of the clock by more is a step, not drift
TIGHT = 0.5e-3  # s; two clock readings further apart were interrupted


def to_time(seconds: float) -> Time:
    """Seconds as a stamp; zero, "no time", for what lies before the clock's beginning."""
    nanoseconds = max(0, round(seconds * 1e9))
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


class Stamps:
    """From the steady clock, by which the rig is run, to the clock that stamps messages.

    The offset is measured for every stamp, unless the process was interrupted between the two readings; so a step of
    the other clock is followed, and counted, and a busy machine does not make stamps jitter.

    Args:
        wall: the stamping clock's reading, ns.
        steady: s.
    """

    def __init__(self, wall: Callable[[], int], steady: Callable[[], float] = time.monotonic) -> None:
        self._wall, self._steady = wall, steady
        self.steps = 0
        self._offset: float | None = None

    def at(self, steady: float) -> Time:
        """The stamp of something that happened at `steady` s."""
        before = self._steady()
        wall = self._wall() * 1e-9
        after = self._steady()
        offset = wall - 0.5 * (before + after)
        if self._offset is None or after - before < TIGHT:
            self.steps += self._offset is not None and abs(offset - self._offset) > STEP
            self._offset = offset
        return to_time(steady + self._offset)


def joint_state(measured: Measurement, potentiometers: Iterable[str], stamp: Time) -> JointState:
    """Motors first, then the board where the rig has potentiometers."""
    message = JointState()
    message.header.stamp = stamp
    for name, motor in measured.motors.items():
        message.name.append(name)
        message.position.append(motor.position)
        message.velocity.append(nan if motor.speed is None else motor.speed)
        message.effort.append(nan if motor.effort is None else motor.effort)
    if measured.board is not None:
        angles = (measured.board.x, measured.board.y)
        for name, angle, speed in zip(potentiometers, angles, measured.board.speed, strict=False):
            message.name.append(name)
            message.position.append(angle)
            message.velocity.append(speed)
            message.effort.append(nan)
    return message


def board_state(tilt: tuple[float, float], stamp: Time) -> JointState:
    """The board's tilt as the camera saw it, rad."""
    message = JointState(name=["board_x", "board_y"], position=list(tilt), velocity=[nan, nan], effort=[nan, nan])
    message.header.stamp = stamp
    return message


def ball_state(sight: Sight, stamp: Time) -> BallState:
    """Where the ball was seen, or that it was not."""
    message = BallState(visible=sight.visible, x=sight.x, y=sight.y)
    message.header.stamp, message.header.frame_id = stamp, "board_origin"
    return message


def image(picture: tuple[int, int, bytes], stamp: Time) -> Image:
    """A picture (height, width, BGR bytes), in the camera's optical frame."""
    height, width, data = picture
    message = Image(height=height, width=width, encoding="bgr8", step=3 * width, data=data)
    message.header.stamp, message.header.frame_id = stamp, OPTICAL_FRAME
    return message


def camera_info(lens: Intrinsics, stamp: Time) -> CameraInfo:
    """The lens, for one picture; pixels are not rectified."""
    fx, fy, cx, cy = lens.fx, lens.fy, lens.cx, lens.cy
    message = CameraInfo(
        width=lens.width, height=lens.height, distortion_model="plumb_bob", d=list(lens.distortion),
        k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )  # fmt: skip
    message.header.stamp, message.header.frame_id = stamp, OPTICAL_FRAME
    return message


def diagnostics(health: Health, name: str, hardware: str, stamp: Time) -> DiagnosticArray:
    """The rig's health as one status."""
    status = DiagnosticStatus(
        level=LEVELS[health.level], name=name, message=health.message, hardware_id=hardware,
        values=[KeyValue(key=key, value=value) for key, value in health.values.items()],
    )  # fmt: skip
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
