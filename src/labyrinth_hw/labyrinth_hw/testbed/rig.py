# SPDX-License-Identifier: Apache-2.0
"""The emulated rig in real time: physics kept up with a clock, servo registers and sensor samples on demand."""

import numpy as np

from labyrinth_hw.registers import ServoModel
from labyrinth_hw.sensor_protocol import SensorSample
from labyrinth_hw.testbed.ball import Ball
from labyrinth_hw.testbed.parameters import Reality, stack
from labyrinth_hw.testbed.plant import PERIOD, Plant
from labyrinth_hw.testbed.servo import quantised
from labyrinth_hw.testbed.servo_emulator import EmulatedServo
from labyrinth_hw.testbed.video_scene import Layout, Scene

POT_ZERO = 32768
POT_SCALE = 2.0e-5  # rad per count
LONGEST_GAP = 0.05  # s of physics made up for at once
OVERLOAD_SHARE, OVERLOAD_TIME = 0.95, 1.0  # of the largest current, s
BROWNOUT_TIME = 0.3  # s


class LiveRig:
    """One emulated rig.

    Args:
        reality: its physics.
        model: both servos' control table; ids 1 (x) and 2 (y).
        seed: of its noise.
        now: s, the clock's reading at the start.
        layout: walls and holes; None is a rig without a ball.
    """

    def __init__(
        self, reality: Reality, model: ServoModel, seed: int, now: float, layout: Layout | None = None
    ) -> None:
        self.q = stack([reality])
        self.plant = Plant(self.q, np.zeros((1, 2)))
        self.servos = [EmulatedServo(model, 1), EmulatedServo(model, 2)]
        self.rng = np.random.default_rng(seed)
        self.skipped = 0.0
        self.layout = layout
        self.ball = Ball(self.q, layout, np.array([layout.path[0]])) if layout is not None else None
        self.piezo = self.depot = self._sequence = 0
        self._start, self._goals = now, [servo.raw("goal_position") for servo in self.servos]
        self._overload, self._brownout = np.zeros(2), np.zeros(2)
        self._noise_due = 0.0

    def catch_up(self, now: float) -> None:
        """Advance the physics to `now`; what the machine was too slow for is skipped and counted."""
        behind = now - self._start - self.plant.time
        if behind > LONGEST_GAP:
            self.skipped += behind - LONGEST_GAP
            self._start += behind - LONGEST_GAP
            behind = LONGEST_GAP
        while behind >= PERIOD:
            periods = min(int(behind / PERIOD), 10)
            if self.plant.time >= self._noise_due:
                self.plant.push = self.q.torque_noise * self.rng.standard_normal((1, 2))
                self._noise_due = self.plant.time + 0.01
            self._take_goals()
            self.plant.advance(periods)
            self._roll(periods)
            self._watch(periods * PERIOD)
            behind -= periods * PERIOD

    def _take_goals(self) -> None:
        raw = [servo.raw("goal_position") for servo in self.servos]
        self.plant.torque_on[0] = [servo.torque_on for servo in self.servos]
        if raw != self._goals:
            self._goals = raw
            jitter = self.q.command_jitter * self.rng.standard_normal((1, 2))
            self.plant.command(np.array([[servo.get("goal_position") for servo in self.servos]]), jitter)

    def _watch(self, dt: float) -> None:
        """Hardware alarms: overload, overheating, voltage."""
        for a, servo in enumerate(self.servos):
            strained = abs(self.plant.motor.current[0, a]) > OVERLOAD_SHARE * self.q.current_limit[0, a]
            self._overload[a] = self._overload[a] + dt if strained else 0.0
            bits = 0x20 if self._overload[a] > OVERLOAD_TIME else 0
            bits |= 0x04 if self.plant.motor.temperature[0, a] > servo.get("temperature_limit") else 0
            volts = self.plant.motor.supply[0, a]
            outside = not servo.get("min_voltage") <= volts <= servo.get("max_voltage")
            self._brownout[a] = self._brownout[a] + dt if outside else 0.0
            bits |= 0x01 if self._brownout[a] > BROWNOUT_TIME else 0
            if bits & ~servo.alarm:
                servo.raise_alarm(bits)

    def _roll(self, periods: int) -> None:
        if self.ball is None:
            return
        for _ in range(-(-periods // 2)):
            before = bool(self.ball.lost[0])
            self.ball.step(self.plant.board, 2 * PERIOD if periods > 1 else PERIOD)
            self.piezo += bool(self.ball.lost[0]) and not before

    def supply_ball(self) -> None:
        """The depot releases a ball, which comes to rest at the start."""
        self.depot += 1
        if self.ball is not None and self.layout is not None:
            self.ball.place(0, np.array(self.layout.path[0]))

    def scene(self, covered: bool) -> Scene:
        """What the camera sees now."""
        tilt = (float(self.plant.board[0, 0]), float(self.plant.board[0, 1]))
        if self.ball is None or self.layout is None or self.ball.lost[0]:
            return Scene(tilt=tilt, lens_covered=covered)
        centre = 0.5 * np.array(self.layout.board)
        x, y = centre + self.q.camera_scale[0, 0] * (self.ball.position[0] - centre)
        vx, vy = self.ball.speed[0]
        return Scene((float(x), float(y)), (float(vx), float(vy)), tilt, lens_covered=covered)

    def refresh(self) -> None:
        """Write what the servos measure now into their registers."""
        zero = np.zeros((1, 2))
        angle, speed = self.plant.encoder(zero)
        noise = self.rng.standard_normal((1, 2))
        angle = self.q.encoder_gain * angle + self.q.encoder_bias + self.q.encoder_noise * noise
        for a, servo in enumerate(self.servos):
            model = servo.model
            servo.set("present_position", float(angle[0, a]))
            servo.set("present_speed", float(speed[0, a]))
            torque = float(self.plant.motor.kt[0, a] * self.plant.motor.current[0, a])
            if "present_load" in model.registers:
                servo.set("present_load", float(np.clip(torque / model.stall_torque, -1.0, 1.0)))
            if "present_current" in model.registers:
                servo.set("present_current", torque / model.torque_constant)
            servo.set("present_voltage", float(self.plant.motor.supply[0, a]))
            servo.set("present_temperature", float(self.plant.motor.temperature[0, a]))
            servo.set("moving", float(abs(speed[0, a]) > 0.02))

    def sample(self) -> SensorSample:
        """What the microcontroller measures now."""
        noise = self.rng.standard_normal((1, 2))
        angle = self.q.pot_gain * self.plant.pots(np.zeros((1, 2))) + self.q.pot_bias + self.q.pot_noise * noise
        x, y = np.rint(quantised(angle, self.q.pot_tick)[0] / POT_SCALE).astype(int) + POT_ZERO
        self._sequence = (self._sequence + 1) % 65536
        micros = int(self.plant.time * 1e6) % 2**32
        limit = 65535
        return SensorSample(
            self._sequence,
            micros,
            int(np.clip(x, 0, limit)),
            int(np.clip(y, 0, limit)),
            self.piezo % 65536,
            self.depot % 65536,
        )
