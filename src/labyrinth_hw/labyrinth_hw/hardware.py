# SPDX-License-Identifier: Apache-2.0
"""The rig as one thing: servos, sensor line, safety and compensation, one control period at a time. Knows no ROS."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from pathlib import Path

import yaml

from labyrinth_hw import config
from labyrinth_hw.compensation import Compensation, Compensator, compensation_from
from labyrinth_hw.errors import BusError, HardwareError, InputError, PortError, SensorError, unknown_name
from labyrinth_hw.links import device
from labyrinth_hw.motors import Motor, MotorState, motors_from
from labyrinth_hw.safety import Command, Limits, Safety, State
from labyrinth_hw.sensors import BoardState, Potentiometer, SensorLine
from labyrinth_hw.servo_bus import ServoBus
from labyrinth_hw.vision import CameraSettings, camera_settings

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
RECONNECT_EVERY = 0.5  # s
FAILURES_TO_DISCONNECT = 5


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


@dataclass(frozen=True)
class Measurement:
    """One control period's measurements.

    Attributes:
        stamp: s of `time.monotonic()`, mean over the motors.
        motors: state of each.
        board: potentiometers, or None where the sensor line was silent.
        sent: goals sent, rad, after clipping and compensation; None where nothing was.
    """

    stamp: float
    motors: Mapping[str, MotorState]
    board: BoardState | None
    sent: Mapping[str, float] | None


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


class Hardware:
    """The rig behind its serial lines.

    Args:
        settings: what is connected where.
        period: s.
        timeout: s after which a command is old.
        dry_run: read everything, but neither switch torque on nor send goals.
        position_error, slack: compensations that are on.
    """

    def __init__(
        self, settings: HardwareConfig, *, period: float = 0.01, timeout: float = 0.2, dry_run: bool = False,
        position_error: bool = False, slack: bool = False,
    ) -> None:  # fmt: skip
        self.settings, self.dry_run = settings, dry_run
        self.bus = ServoBus(settings.servo_port, settings.baud, list(settings.motors), period)
        self.safety = Safety(settings.limits, timeout, {m.name: m.model.shutdown for m in settings.motors})
        self.compensator = Compensator(settings.compensation, position_error=position_error, slack=slack)
        self.sensors: SensorLine | None = None
        if settings.sensor_port:
            x, y = settings.potentiometers.values()
            self.sensors = SensorLine(settings.sensor_port, settings.sensor_baud, x, y)
        self.connected = self.sensors_connected = False
        self.trouble = ""
        self.reconnects = 0
        self.slow: dict[str, MotorState] = {}
        self._torque = False
        self._failures = 0
        self._supply = False
        self._retry_at = {"servos": 0.0, "sensors": 0.0}

    def connect(self) -> None:
        """Open both lines. Raises HardwareError."""
        self._connect_servos()
        if self.sensors is not None:
            self.sensors.connect()
            self.sensors_connected = True

    def _connect_servos(self) -> None:
        self.bus.connect()
        try:
            if not self.dry_run:
                self.bus.set_torque(False)
                for name in self.bus.motors:
                    self.bus.set_mode(name, torque_share=self.settings.torque_share)
        except HardwareError:
            self.bus.close()
            raise
        self.connected, self._torque, self._failures, self.trouble = True, False, 0, ""

    def cycle(self, command: Command | None) -> Measurement | None:
        """One control period: measure, judge, send. None where the servos were not heard."""
        self._reconnect()
        if not self.connected:
            return None
        self._ask_sensors()
        try:
            motors = self.bus.read_states()
            for name, state in motors.items():
                if state.temperature is not None:
                    self.slow[name] = state
            order = self.safety.step(time.monotonic(), motors, command)
            sent = self._obey(order.torque, order.goals, motors)
            self._failures = 0
        except (BusError, PortError) as error:
            self._failed(error)
            self._collect_sensors()
            return None
        stamp = sum(m.stamp for m in motors.values()) / len(motors)
        return Measurement(stamp, motors, self._collect_sensors(), sent)

    def _obey(
        self, torque: bool, goals: Mapping[str, float] | None, motors: Mapping[str, MotorState]
    ) -> Mapping[str, float] | None:
        if self.dry_run:
            return None
        if torque and not self._torque:
            self.bus.write_goals({name: state.position for name, state in motors.items()})
            self.bus.set_torque(True)
        elif not torque and self._torque:
            self.bus.set_torque(False)
        self._torque = torque
        if not torque or goals is None:
            return None
        sent = self.compensator.goals(goals) if self.safety.state is State.ACTIVE else goals
        self.bus.write_goals(sent)
        return sent

    def reset(self) -> str:
        """Clear alarms and the stop; returns what was cleared. Raises HardwareError where a servo does not confirm."""
        reasons = "; ".join(self.safety.reasons) or "nothing to reset"
        for motor in self.settings.motors:
            if motor.model.protocol == 2 and self.bus.read(motor.name, "hardware_error"):
                self.bus.reboot(motor.name)
        self.safety.reset()
        return reasons

    def supply_ball(self) -> None:
        """Let the depot release a ball with the next request. Raises SensorError without a sensor line."""
        if self.sensors is None or not self.sensors_connected:
            raise SensorError("The ball depot hangs on the sensor line, and that is not connected.")
        self._supply = True

    def close(self) -> None:
        """Torque off and ports closed, whatever state they are in."""
        if self.connected and not self.dry_run:
            try:
                self.bus.set_torque(False)
            except (HardwareError, OSError):
                self.trouble = "Torque could not be switched off at the end: the bus did not answer."
        self.connected = False
        self.bus.close()
        if self.sensors is not None:
            self.sensors.close()

    def _failed(self, error: HardwareError) -> None:
        self._failures += 1
        self.trouble = str(error)
        if isinstance(error, PortError) or self._failures >= FAILURES_TO_DISCONNECT:
            self.bus.close()
            self.connected = self._torque = False
            self.safety.lost_contact()
            self._retry_at["servos"] = time.monotonic() + RECONNECT_EVERY

    def _reconnect(self) -> None:
        now = time.monotonic()
        if not self.connected and now >= self._retry_at["servos"]:
            self._retry_at["servos"] = now + RECONNECT_EVERY
            try:
                self._connect_servos()
                self.reconnects += 1
            except HardwareError as error:
                self.trouble = str(error)
        if self.sensors is not None and not self.sensors_connected and now >= self._retry_at["sensors"]:
            self._retry_at["sensors"] = now + RECONNECT_EVERY
            try:
                self.sensors.connect()
                self.sensors_connected = True
            except HardwareError as error:
                self.trouble = str(error)

    def _ask_sensors(self) -> None:
        if self.sensors is not None and self.sensors_connected:
            try:
                self.sensors.ask(supply=self._supply)
                self._supply = False
            except SensorError as error:
                self._lost_sensors(error)

    def _collect_sensors(self) -> BoardState | None:
        if self.sensors is None or not self.sensors_connected:
            return None
        try:
            return self.sensors.collect()
        except SensorError as error:
            self._lost_sensors(error)
            return None

    def _lost_sensors(self, error: SensorError) -> None:
        assert self.sensors is not None
        self.trouble = str(error)
        self.sensors.close()
        self.sensors_connected = False
