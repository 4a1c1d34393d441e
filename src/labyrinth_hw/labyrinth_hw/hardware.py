# SPDX-License-Identifier: Apache-2.0
"""The rig as one thing: servos, sensor line, safety and compensation, one control period at a time. Independent of
ROS."""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count

from labyrinth_hw.bus import ServoBus
from labyrinth_hw.compensation import Compensator
from labyrinth_hw.errors import BusError, HardwareError, PortError, SensorError
from labyrinth_hw.motors import MotorState
from labyrinth_hw.safety import Goal, Order, Safety, State
from labyrinth_hw.sensors import BoardState, SensorLine
from labyrinth_hw.settings import HardwareConfig
from labyrinth_hw.vision import Sight

RECONNECT_EVERY = 0.1  # s
TRIES = 4  # to connect
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
        disarm_after: s without a command after which the rig disarms itself; None never does.
        dry_run: read everything, but neither switch torque on nor send goals.
        position_error, slack: compensations that are on.
    """

    def __init__(
        self, settings: HardwareConfig, *, period: float = 0.01, timeout: float = 0.2,
        disarm_after: float | None = None, dry_run: bool = False, position_error: bool = False, slack: bool = False,
    ) -> None:  # fmt: skip
        self.settings, self.dry_run = settings, dry_run
        self.bus = ServoBus(settings.servo_port, settings.baud, list(settings.motors), period)
        self.safety = Safety(
            settings.limits, timeout, disarm_after, {motor.name: motor.model.shutdown for motor in settings.motors}
        )
        self.compensator = Compensator(settings.compensation, position_error=position_error, slack=slack)
        self.sensors: SensorLine | None = None
        if settings.sensor_port:
            x, y = settings.potentiometers.values()
            self.sensors = SensorLine(settings.sensor_port, settings.sensor_baud, x, y)
        self.connected = self.sensors_connected = False
        self.trouble = ""
        self.reconnects = self.clipped = 0
        self.slow: dict[str, MotorState] = {}
        self.watchdog = 0  # times that the servos' own watchdog may have stopped them
        self._judging = threading.Lock()  # arming comes from another thread
        self._torque = False
        self._heard = 0.0
        self._failures = 0
        self._supply = False
        self._retry_at = {"servos": 0.0, "sensors": 0.0}

    def connect(self, waits: Callable[[BusError], bool] = lambda error: False) -> None:
        """Open both lines; servos that just got power, or a busy machine, may need some tries.

        Args:
            waits: whether to try once more; asked with what was wrong, after each try from the fourth on.

        Raises:
            HardwareError: a port is missing or in use, or the last try found no servos or others than expected.
        """
        for number in count(1):
            try:
                self._connect_servos()
                break
            except BusError as error:
                if number >= TRIES and not waits(error):
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
                    self.bus.prepare(name, self.settings.torque_share)
        except HardwareError:
            self.bus.close()
            raise
        self.connected, self._torque, self._failures, self.trouble = True, False, 0, ""

    def cycle(self, goals: Mapping[str, Goal]) -> Measurement | None:
        """One control period: measure, judge, send. None where the servos did not answer."""
        self._reconnect()
        if not self.connected:
            return None
        self._ask_sensors()
        try:
            motors = self.bus.read_states()
            for name, state in motors.items():
                if state.temperature is not None:
                    self.slow[name] = state
            with self._judging:
                order = self.safety.step(time.monotonic(), motors, goals)
            self.clipped += bool(order.clipped)
            sent = self._obey(order, motors)
            self._failures = 0
        except (BusError, PortError) as error:
            self._failed(error)
            self._collect_sensors()
            return None
        stamp = sum(m.stamp for m in motors.values()) / len(motors)
        return Measurement(stamp, motors, self._collect_sensors(), sent)

    def _obey(self, order: Order, motors: Mapping[str, MotorState]) -> Mapping[str, float] | None:
        if self.dry_run:
            return None
        now = time.monotonic()
        if order.torque and self._torque and now - self._heard > 0.8 * self.safety.timeout:
            # A servo whose watchdog fired ignores goals and does not say so.
            self.watchdog += self.bus.arm_watchdog(self.safety.timeout)
        self._heard = now
        if order.torque and not self._torque:
            self.bus.arm_watchdog(self.safety.timeout)
            self._send({name: state.position for name, state in motors.items()}, motors)
            self.bus.set_torque(True)
        elif not order.torque and self._torque:
            self.bus.set_torque(False)
        self._torque = order.torque
        if not order.torque or order.goals is None:
            return None
        # What a motor holds is measured at the motor, so there is nothing to compensate.
        sent = {**order.goals, **self.compensator.goals({name: order.goals[name] for name in order.commanded})}
        self._send(sent, motors)
        return sent

    def _send(self, goals: Mapping[str, float], motors: Mapping[str, MotorState]) -> None:
        if self.settings.motors[0].law is not None:
            self.bus.write_currents(goals, motors, self.settings.torque_share or 1.0)
        else:
            self.bus.write_goals(goals)

    def arm(self) -> None:
        """Execute commands from now on. Raises InputError while stopped, HardwareError without servos."""
        if not self.connected:
            raise HardwareError(f"The servos do not answer: {self.trouble or 'not connected'}")
        with self._judging:
            self.safety.arm(time.monotonic())

    def disarm(self, reason: str = "") -> None:
        """Torque off with the next period, and no command is executed."""
        with self._judging:
            self.safety.disarm(reason)

    def reset(self) -> str:
        """Clear alarms and the stop; returns what was cleared. Raises HardwareError where a servo does not confirm."""
        reasons = "; ".join(self.safety.reasons) or "nothing to reset"
        for motor in self.settings.motors:
            if motor.model.protocol == 2 and self.bus.read(motor.name, "hardware_error"):
                self.bus.reboot(motor.name)
        with self._judging:
            self.safety.reset()
        return reasons

    def supply_ball(self) -> None:
        """Let the depot release a ball with the next request. Raises SensorError without a sensor line."""
        if self.sensors is None or not self.sensors_connected:
            raise SensorError("The ball depot is on the sensor line, which is not connected.")
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


@dataclass(frozen=True)
class Health:
    """level: "ok", "warn" or "error"; message: one sentence; values: names and texts, units in the names."""

    level: str
    message: str
    values: Mapping[str, str]


BLIND_AFTER = 1.0  # s without a picture


def hardware_health(hw: Hardware, counts: Mapping[str, int], camera: bool, sight: Sight | None) -> Health:
    """The state of servos, sensor line and camera.

    Args:
        hw: the rig.
        counts: "cycles", "late", "silent" and "unseen" periods, "refused" commands, "clock steps".
        camera: whether there is to be one.
        sight: the newest one; None before the first picture.
    """
    blind = camera and (sight is None or time.monotonic() - sight.stamp > BLIND_AFTER)
    level = "ok"
    if not hw.connected or hw.safety.state is State.STOPPED:
        level = "error"
    elif blind or (hw.sensors is not None and not hw.sensors_connected):
        level = "warn"
    if hw.connected:
        message = "; ".join(hw.safety.reasons) or hw.safety.state.value
        if hw.safety.state is State.DISARMED and hw.safety.reasons:
            message = f"disarmed, torque off: {message}"
    else:
        message = f"disconnected: {hw.trouble}"
    if hw.sensors is not None and not hw.sensors_connected:
        message += "; no potentiometers, so no joint states: the sensor line is gone"
    if blind:
        message += "; no pictures from the camera"
    elif sight is not None and not sight.board:
        message += "; the camera does not see the board"
    counters = hw.bus.counters
    values: dict[str, object] = {
        "state": hw.safety.state.name.lower(),
        "packets sent": counters.sent,
        "packets lost": counters.lost,
        "packets damaged": counters.corrupt,
        "retries": counters.retried,
        "failures": counters.failed,
        "reconnects": hw.reconnects,
        "bus time of a cycle [ms]": f"{hw.bus.cycle * 1e3:.2f}",
        "cycles": counts["cycles"],
        "cycles late": counts["late"],
        "cycles without servos": counts["silent"],
        "cycles without potentiometers": counts["unseen"],
        "commands refused": counts["refused"],
        "periods with clipped goals": hw.clipped,
        "clock steps": counts["clock steps"],
        "watchdog armed again": hw.watchdog,
        "last trouble": hw.trouble,
    }
    for name, motor in list(hw.slow.items()):
        meanings = hw.safety.meanings.get(name, {})
        values[f"{name} voltage [V]"] = f"{motor.voltage:.1f}"
        values[f"{name} temperature [degC]"] = f"{motor.temperature:.0f}"
        values[f"{name} alarm"] = "; ".join(text for bit, text in meanings.items() if motor.alarm & bit) or "none"
    if hw.sensors is not None:
        values["sensor requests"] = hw.sensors.asked
        values["sensor answers lost"] = hw.sensors.lost
        values["sensor lines damaged"] = hw.sensors.damaged
    if camera:
        values["camera"] = "no pictures" if blind else "delivers pictures"
    if sight is not None:
        values["camera frames"] = sight.frames
        values["camera losses"] = sight.losses
        values["board seen"] = sight.board and not blind
        values["ball seen"] = sight.visible and not blind
    return Health(level, message, {name: str(value) for name, value in values.items()})
