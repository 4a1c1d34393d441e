# SPDX-License-Identifier: Apache-2.0
"""From what the rig told to ROS messages."""

import time
from collections.abc import Callable, Iterable
from math import nan

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import Image, JointState

from labyrinth_hw.hardware import Measurement
from labyrinth_hw.health import Health
from labyrinth_hw.vision import Sight
from labyrinth_msgs.msg import BallState

LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}
STEP = 0.05  # s; a change of the clock by more is a step, not drift
TIGHT = 0.5e-3  # s; two clock readings further apart were interrupted


def to_time(seconds: float) -> Time:
    """Seconds as a stamp."""
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


class Stamps:
    """From the steady clock, by which the rig is run, to the clock that stamps messages.

    The offset is taken anew with every stamp, unless the process was interrupted between the two readings; so a step of
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


def ball_state(sight: Sight, stamp: Time) -> BallState:
    """Where the ball was seen, or that it was not."""
    message = BallState(visible=sight.visible, x=sight.x, y=sight.y)
    message.header.stamp, message.header.frame_id = stamp, "board"
    return message


def annotated_image(sight: Sight, stamp: Time) -> Image | None:
    """The picture with what was found drawn in, None where none was asked for."""
    if sight.picture is None:
        return None
    height, width, data = sight.picture
    image = Image(height=height, width=width, encoding="bgr8", step=3 * width, data=data)
    image.header.stamp, image.header.frame_id = stamp, "board"
    return image


def diagnostics(health: Health, name: str, hardware: str, stamp: Time) -> DiagnosticArray:
    """The rig's health as one status."""
    status = DiagnosticStatus(
        level=LEVELS[health.level], name=name, message=health.message, hardware_id=hardware,
        values=[KeyValue(key=key, value=value) for key, value in health.values.items()],
    )  # fmt: skip
    message = DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
