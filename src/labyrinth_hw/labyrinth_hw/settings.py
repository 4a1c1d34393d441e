# SPDX-License-Identifier: Apache-2.0
"""What is connected where: config/hw/*.yaml."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot, radians
from pathlib import Path

import yaml

from labyrinth_hw import config
from labyrinth_hw.compensation import Compensation, compensation_from
from labyrinth_hw.errors import InputError, unknown_name
from labyrinth_hw.links import device
from labyrinth_hw.motors import Motor, motors_from
from labyrinth_hw.safety import Limits
from labyrinth_hw.sensors import Potentiometer
from labyrinth_hw.vision import CameraSettings, camera_settings

NEAR_HOLE = 0.03  # m
KEYS = {
    "servo_port",
    "sensor_port",
    "motors",
    "potentiometers",
    "limits",
    "compensation",
    "torque_share",
    "camera",
    "layout",
}


@dataclass(frozen=True)
class HardwareConfig:
    """What is connected where; see config/hw/*.yaml."""

    servo_port: str
    baud: int
    sensor_port: str | None
    sensor_baud: int
    motors: tuple[Motor, ...]
    potentiometers: Mapping[str, Potentiometer]
    limits: Mapping[str, Limits]
    compensation: Mapping[str, Compensation]
    torque_share: float | None
    camera: CameraSettings | None
    holes: tuple[tuple[float, float], ...]

    def nearest_hole(self, place: tuple[float, float] | None) -> int:
        """Number of the hole beside a place (m), -1 where none is near or the place is unknown."""
        if place is None or not self.holes:
            return -1
        away = [hypot(x - place[0], y - place[1]) for x, y in self.holes]
        nearest = min(range(len(away)), key=away.__getitem__)
        return nearest + 1 if away[nearest] < NEAR_HOLE else -1


def load_hardware(name: str | Path) -> HardwareConfig:
    """The configuration of a rig. Raises InputError with all complaints."""
    content = config.load("hw", name)
    complaints = [unknown_name(f"key in {name}", key, KEYS) for key in content if key not in KEYS]
    motors: list[Motor] = []
    compensations: dict[str, Compensation] = {}
    for build in (
        lambda: motors.extend(motors_from(content.get("motors") or {})),
        lambda: compensations.update(
            {k: compensation_from(k, v) for k, v in (content.get("compensation") or {}).items()}
        ),
    ):
        try:
            build()
        except InputError as error:
            complaints += error.complaints
    limits, pots = {}, {}
    try:
        for motor in motors:
            entry = (content.get("limits") or {}).get(motor.name, {})
            low, high = (motor.model.registers[r] for r in ("min_voltage", "max_voltage"))
            limits[motor.name] = Limits(
                angle=radians(float(entry.get("angle_deg", 6.0))),
                speed=radians(float(entry.get("speed_deg_s", 400.0))),
                temperature=float(entry.get("temperature_c", 70.0)),
                voltage=(
                    float(entry.get("min_voltage", low.to_si(low.initial))),
                    float(entry.get("max_voltage", high.to_si(high.initial))),
                ),
            )
        for joint, entry in (content.get("potentiometers") or {}).items():
            pots[joint] = Potentiometer(float(entry["zero"]), float(entry["rad_per_count"]), int(entry.get("sign", 1)))
        servo_port, sensor_port = dict(content["servo_port"]), content.get("sensor_port")
        if complaints:
            raise InputError(complaints)
        if len(pots) != 2 and sensor_port:
            raise InputError(f"{name}: the sensor line has two potentiometers, got {len(pots)}: {sorted(pots)}.")
        return HardwareConfig(
            servo_port=device(str(servo_port["path"])),
            baud=int(servo_port["baud"]),
            sensor_port=device(str(sensor_port["path"])) if sensor_port else None,
            sensor_baud=int(sensor_port["baud"]) if sensor_port else 0,
            motors=tuple(motors),
            potentiometers=pots,
            limits=limits,
            compensation=compensations,
            torque_share=float(content["torque_share"]) if content.get("torque_share") is not None else None,
            camera=camera_settings(content.get("camera") or {}),
            holes=_holes(str(content.get("layout", "medium"))),
        )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        complaints.append(f"{name}: {type(error).__name__}: {error}. Compare with config/hw/paper.yaml.")
        raise InputError(complaints) from error


def _holes(layout: str) -> tuple[tuple[float, float], ...]:
    """Centres of the holes, m, in the order of their numbers from 1; none where the geometry is not at hand."""
    path = config.find_geometry()
    if path is None:
        return ()
    layouts = yaml.safe_load(path.read_text(encoding="utf-8"))["layouts"]
    if layout not in layouts:
        raise InputError(unknown_name("layout", layout, layouts))
    return tuple((float(x), float(y)) for x, y in layouts[layout]["holes"])
