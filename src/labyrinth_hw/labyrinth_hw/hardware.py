# SPDX-License-Identifier: Apache-2.0
"""The rig as one thing: servos, sensor line, safety and compensation, one control period at a time. Knows no ROS."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

from labyrinth_hw.compensation import Compensator
from labyrinth_hw.errors import BusError, HardwareError, PortError, SensorError
from labyrinth_hw.motors import MotorState
from labyrinth_hw.safety import Command, Safety, State
from labyrinth_hw.sensors import BoardState, SensorLine
from labyrinth_hw.servo_bus import ServoBus
from labyrinth_hw.settings import HardwareConfig

RECONNECT_EVERY = 0.1  # s
FAILURES_TO_DISCONNECT = 5
TOGETHER = 0.025  # s


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

    @property
    def whole(self) -> bool:
        """Whether board and motors were measured together, so that one stamp does for both."""
        return self.board is not None and abs(self.board.stamp - self.stamp) <= TOGETHER


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
        self.watchdog = 0  # times that the servos' own watchdog may have stopped them
        self._torque = False
        self._heard = 0.0
        self._failures = 0
        self._supply = False
        self._retry_at = {"servos": 0.0, "sensors": 0.0}

    def connect(self, tries: int = 4) -> None:
        """Open both lines; servos that just got power, or a busy machine, may need some tries. Raises HardwareError."""
        for left in reversed(range(tries)):
            try:
                self._connect_servos()
                break
            except BusError:
                if not left:
                    raise
                time.sleep(RECONNECT_EVERY)
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
        now = time.monotonic()
        if torque and self._torque and now - self._heard > 0.8 * self.safety.timeout:
            # A servo whose watchdog fired ignores goals and does not say so.
            self.watchdog += self.bus.arm_watchdog(self.safety.timeout)
        self._heard = now
        if torque and not self._torque:
            self.bus.arm_watchdog(self.safety.timeout)
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
                self.sensors.open()
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
