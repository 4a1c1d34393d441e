# SPDX-License-Identifier: Apache-2.0
"""What is connected where: config/hw/*.yaml, with degrees where a key says so; `HardwareConfig` has SI units."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, hypot, radians
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from labyrinth_hw import config
from labyrinth_hw.compensation import Compensation
from labyrinth_hw.config import Number, Positive, Section, Whole
from labyrinth_hw.control_tables import servo_model
from labyrinth_hw.devices import device
from labyrinth_hw.errors import InputError
from labyrinth_hw.geometry import load_geometry
from labyrinth_hw.motors import OPERATING_MODES, CurrentLaw, Motor
from labyrinth_hw.safety import Limits
from labyrinth_hw.sensors import Potentiometer

NEAR_HOLE = 0.03  # m
Sign = Literal[-1, 1]
Name = Annotated[str, BeforeValidator(str)]  # a device number is a name too


class PortSection(Section):
    """A serial line: device, or the bare name of a link of the emulated testbed; bits per second."""

    path: str
    baud: Annotated[Whole, Field(gt=0)]


class CurrentLawSection(Section):
    """How a servo in current mode is driven; see `CurrentLaw`. N m/rad and N m s/rad at its shaft."""

    stiffness: Positive
    damping: Annotated[Number, Field(ge=0)] = 0.0


class MotorSection(Section):
    """A servo on the bus; see `Motor`. With a `current_law` it is driven by currents, else by positions."""

    id: Annotated[Whole, Field(ge=0, le=252)]
    model: str
    sign: Sign = 1
    zero_deg: Number = 0.0
    operating_mode: Literal["current", "position", "extended_position", "current_based_position"] | None = None
    current_law: CurrentLawSection | None = None

    @field_validator("model")
    @classmethod
    def _known(cls, name: str) -> str:
        return servo_model(name).name

    @model_validator(mode="after")
    def _possible(self) -> "MotorSection":
        registers = servo_model(self.model).registers
        if self.operating_mode is not None and "operating_mode" not in registers:
            raise ValueError(f"operating_mode: {self.model} has none (protocol 1.0); leave the key out")
        if self.operating_mode == "current_based_position" and "goal_current" not in registers:
            raise ValueError(f"operating_mode: {self.model} measures no current; use position")
        if self.current_law is not None and "goal_current" not in registers:
            raise ValueError(f"current_law: {self.model} follows no currents; leave the key out")
        if self.operating_mode is not None and (self.operating_mode == "current") != (self.current_law is not None):
            raise ValueError("operating_mode: current and current_law come together or not at all")
        return self

    def motor(self, name: str) -> Motor:
        """In SI units."""
        mode = None if self.operating_mode is None else OPERATING_MODES[self.operating_mode]
        law = None if self.current_law is None else CurrentLaw(self.current_law.stiffness, self.current_law.damping)
        return Motor(name, self.id, servo_model(self.model), self.sign, radians(self.zero_deg), mode, law)


class PotentiometerSection(Section):
    """How counts become an angle; see `Potentiometer`."""

    zero: Number
    rad_per_count: Number
    sign: Sign = 1


class LimitsSection(Section):
    """What a motor may do; see `Limits`. Voltages left out are those of the servo's own registers."""

    angle_deg: Positive = 6.0
    speed_deg_s: Positive = 400.0
    temperature_c: Number = 70.0
    min_voltage: Number | None = None
    max_voltage: Number | None = None

    def limits(self, motor: Motor) -> Limits:
        """In SI units."""
        low, high = (motor.model.registers[name] for name in ("min_voltage", "max_voltage"))
        return Limits(
            angle=radians(self.angle_deg),
            speed=radians(self.speed_deg_s),
            temperature=self.temperature_c,
            voltage=(
                low.to_si(low.initial) if self.min_voltage is None else self.min_voltage,
                high.to_si(high.initial) if self.max_voltage is None else self.max_voltage,
            ),
        )


class CompensationSection(Section):
    """What calibrate_motors measured; see `Compensation`."""

    angles_deg: tuple[Number, ...] = ()
    errors_deg: tuple[Number, ...] = ()
    slack_deg: Number = 0.0

    @model_validator(mode="after")
    def _usable(self) -> "CompensationSection":
        self.compensation()
        return self

    def compensation(self) -> Compensation:
        """In SI units. Raises InputError where the map is none."""
        angles, errors = (tuple(radians(v) for v in values) for values in (self.angles_deg, self.errors_deg))
        return Compensation(angles, errors, radians(self.slack_deg))

    @staticmethod
    def of(entry: Compensation) -> "CompensationSection":
        """As it stands in a file: degrees to 0.1 millidegrees."""
        angles, errors, (slack,) = (
            tuple(round(degrees(v), 4) for v in values) for values in (entry.angles, entry.errors, (entry.slack,))
        )
        return CompensationSection(angles_deg=angles, errors_deg=errors, slack_deg=slack)


class CameraSettings(Section):
    """The camera.

    Attributes:
        source: device number or path, file, stream address, or "testbed".
        intrinsics: file of calibrate_camera, or None.
        field_of_view_deg: from left to right, where there is no such file.
        size: width, height, px, where there is no such file.
        latency: s from exposure to arrival, where there is no such file.
        quarter_turns: of the camera about its axis.
        tilt: publish the board's tilt as NS/board_states, where no potentiometers measure it.
        marble: a name in config/marbles, or a file of `calibrate_camera marble`, of a painted one; None for steel.
        ocam: file of OCamCalib, in place of `intrinsics`; its pictures are made straight, `size` and
            `field_of_view_deg` say how large.
    """

    source: Name
    intrinsics: str | None = None
    field_of_view_deg: Annotated[Number, Field(gt=0, lt=180)] = 70.0
    size: tuple[Annotated[Whole, Field(gt=0)], Annotated[Whole, Field(gt=0)]] = (640, 360)
    latency: Number = 0.0
    quarter_turns: Whole = 0
    tilt: bool = False
    marble: str | None = None
    ocam: str | None = None

    @model_validator(mode="after")
    def _one_lens(self) -> "CameraSettings":
        if self.ocam is not None and self.intrinsics is not None:
            raise ValueError("ocam and intrinsics: expected one of them")
        return self


class HardwareFile(Section):
    """config/hw/*.yaml as it stands."""

    servo_port: PortSection
    sensor_port: PortSection | None = None
    motors: Annotated[Mapping[str, MotorSection], Field(min_length=1)]
    potentiometers: Mapping[str, PotentiometerSection] = {}
    limits: Mapping[str, LimitsSection] = {}
    compensation: Mapping[str, CompensationSection] = {}
    torque_share: Annotated[Number, Field(gt=0, le=1)] | None = None
    camera: CameraSettings | None = None
    layout: str = "medium"

    @field_validator("motors")
    @classmethod
    def _different_ids(cls, motors: Mapping[str, MotorSection]) -> Mapping[str, MotorSection]:
        ids = [motor.id for motor in motors.values()]
        if len(set(ids)) < len(ids):
            raise ValueError(f"every servo needs an id of its own, got {sorted(ids)}")
        return motors

    @model_validator(mode="after")
    def _consistent(self) -> "HardwareFile":
        complaints = [
            f"{part}: '{name}' is no motor of this file; its motors: {', '.join(self.motors)}"
            for part in ("limits", "compensation")
            for name in getattr(self, part)
            if name not in self.motors
        ]
        if self.sensor_port is not None and len(self.potentiometers) != 2:
            complaints.append(
                f"potentiometers: the sensor line has two, got {len(self.potentiometers)}: {list(self.potentiometers)}"
            )
        if len({motor.current_law is None for motor in self.motors.values()}) > 1:
            complaints.append("motors: on one bus all have a current_law, or none")
        if complaints:
            raise ValueError("; ".join(complaints))
        return self


@dataclass(frozen=True)
class HardwareConfig:
    """What is connected where, in SI units; see config/hw/*.yaml.

    Attributes:
        torque_share: largest torque over the maximum, (0, 1]; None leaves it.
        holes: (x, y) m of the layout's holes, by number from 1.
    """

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
        """Number of the hole nearest to a place (m), -1 if none is near or the place is unknown."""
        if place is None or not self.holes:
            return -1
        away = [hypot(x - place[0], y - place[1]) for x, y in self.holes]
        nearest = min(range(len(away)), key=away.__getitem__)
        return nearest + 1 if away[nearest] < NEAR_HOLE else -1


def _with_marble(camera: CameraSettings | None, path: Path) -> CameraSettings | None:
    """The camera with its marble's file as a path. Raises InputError where there is no such file."""
    if camera is None or camera.marble is None:
        return camera
    try:
        return camera.model_copy(update={"marble": str(config.find("marbles", camera.marble))})
    except InputError as error:
        raise InputError(f"{path}, camera, marble: {error} Make it with calibrate_camera marble.") from error


def load_hardware(name: str | Path) -> HardwareConfig:
    """The configuration of a rig. Raises InputError with all complaints, each with its place in the file."""
    path = config.find("hw", name)
    given = config.read(path).checked(HardwareFile)
    motors = tuple(section.motor(key) for key, section in given.motors.items())
    geometry = load_geometry()
    try:
        holes = geometry.layout(given.layout).holes if geometry is not None else ()
    except InputError as error:
        raise InputError(f"{path}, layout: {error}") from error
    return HardwareConfig(
        servo_port=device(given.servo_port.path),
        baud=given.servo_port.baud,
        sensor_port=device(given.sensor_port.path) if given.sensor_port else None,
        sensor_baud=given.sensor_port.baud if given.sensor_port else 0,
        motors=motors,
        potentiometers={
            key: Potentiometer(pot.zero, pot.rad_per_count, pot.sign) for key, pot in given.potentiometers.items()
        },
        limits={motor.name: given.limits.get(motor.name, LimitsSection()).limits(motor) for motor in motors},
        compensation={key: section.compensation() for key, section in given.compensation.items()},
        torque_share=given.torque_share,
        camera=_with_marble(given.camera, path),
        holes=holes,
    )
