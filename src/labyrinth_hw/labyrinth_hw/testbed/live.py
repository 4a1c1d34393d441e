# SPDX-License-Identifier: Apache-2.0
"""The emulated rig behind its serial ports, in real time: physics kept up with a clock, answers on demand."""

import fcntl
import heapq
import os
import select
import struct
import termios
import time
import tty
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import numpy as np

from labyrinth_hw.control_tables import MODELS, ServoModel
from labyrinth_hw.devices import CAMERA, SENSORS, SERVOS
from labyrinth_hw.errors import PortError
from labyrinth_hw.sensors import READ_REQUEST, SUPPLY_REQUEST, SensorSample, unpack, write_sample
from labyrinth_hw.testbed.ball import Ball
from labyrinth_hw.testbed.plant import CONTROL_PERIOD, Plant
from labyrinth_hw.testbed.quantities import Reality, stack
from labyrinth_hw.testbed.scene import Layout, Scene
from labyrinth_hw.testbed.servo import quantised
from labyrinth_hw.testbed.servo_emulator import EmulatedBus, EmulatedServo
from labyrinth_hw.testbed.video import VideoProcess

POT_ZERO = 32768
POT_SCALE = 2.0e-5  # rad per count
LONGEST_GAP = 0.05  # s of physics made up for at once
OVERLOAD_SHARE, OVERLOAD_TIME = 0.95, 1.0  # of the largest current, s
BROWNOUT_TIME = 0.3  # s


class PseudoSerial:
    """A pseudo-terminal behind a symbolic link.

    Args:
        link: path of the link that the other side opens.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.master = self._slave = -1
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether the device is there."""
        return self.master >= 0

    def plug(self) -> None:
        """Make the device appear. Raises PortError where something else lies at the link's place."""
        if self.link.exists() and not self.link.is_symlink():
            raise PortError(f"{self.link} exists and is no link; choose another folder with --link-dir.")
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self.master, False)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(self._slave))
        os.replace(fresh, self.link)

    def unplug(self) -> None:
        """Make the device vanish; whoever has it open gets errors."""
        if self.plugged:
            if self.link.is_symlink() and os.readlink(self.link) == os.ttyname(self._slave):
                self.link.unlink()
            os.close(self.master)
            os.close(self._slave)
            self.master = self._slave = -1

    def read(self) -> bytes:
        """What has come."""
        try:
            return os.read(self.master, 4096)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send; what the other side does not collect is dropped, as on a wire."""
        waiting = struct.unpack("i", fcntl.ioctl(self._slave, termios.TIOCINQ, b"\0\0\0\0"))[0]
        if waiting < 2048:
            try:
                os.write(self.master, data)
            except (BlockingIOError, OSError):
                return


class Line:
    """Bytes in, answers out, at the speed of the wire.

    Args:
        port: pseudo-terminal.
        baud: bits per second; sets when an answer has arrived.
        answer: called with the bytes that came; returns answers with the delay before each, s.
        seed: of the noise.
    """

    def __init__(
        self, port: PseudoSerial, baud: int, answer: Callable[[bytes], list[tuple[bytes, float]]], seed: int
    ) -> None:
        self.port, self.byte_time, self.answer = port, 10.0 / baud, answer
        self.rng = np.random.default_rng(seed)
        self.bad_share = 0.0
        self.extra_delay = 0.0
        self.sent = self.damaged = 0
        self._free = 0.0
        self._due: list[tuple[float, int, bytes]] = []

    def due(self) -> float:
        """Clock reading at which something is to be sent; infinite when nothing is."""
        return self._due[0][0] if self._due else float("inf")

    def receive(self, now: float) -> None:
        """Take what came and plan the answers."""
        data = self.port.read()
        if not data:
            return
        # The bytes appear at once on a pseudo-terminal; on a wire they would have taken their time.
        at = max(now, self._free) + len(data) * self.byte_time
        for reply, delay in self.answer(data):
            at += delay + self.extra_delay + len(reply) * self.byte_time
            heapq.heappush(self._due, (at, self.sent, self._spoiled(reply)))
            self.sent += 1
        self._free = at

    def send(self, now: float) -> None:
        """Send what is due."""
        while self._due and self._due[0][0] <= now:
            data = heapq.heappop(self._due)[2]
            if self.port.plugged:
                self.port.write(data)

    def _spoiled(self, data: bytes) -> bytes:
        if self.rng.random() >= self.bad_share:
            return data
        self.damaged += 1
        spoiled = bytearray(data)
        spoiled[int(self.rng.integers(len(data)))] ^= 1 << int(self.rng.integers(8))
        return bytes(spoiled)


def wait(lines: list[Line], until: float, now: float) -> None:
    """Sleep until bytes come or `until`, s."""
    watched = [line.port.master for line in lines if line.port.plugged]
    select.select(watched, [], [], max(0.0, until - now))


class LiveRig:
    """One emulated rig.

    Args:
        reality: its physics.
        model: both servos' control table; ids 1 (x) and 2 (y).
        seed: of its noise.
        now: s, the clock's reading at the start.
        layout: walls and holes; None is a rig without a ball.
        mode: operating mode in the servos' EEPROM; None for the factory's.
    """

    def __init__(
        self, reality: Reality, model: ServoModel, seed: int, now: float, layout: Layout | None = None,
        mode: int | None = None,
    ) -> None:  # fmt: skip
        self.q = stack([reality])
        self.plant = Plant(self.q, np.zeros((1, 2)))
        self.servos = [EmulatedServo(model, 1), EmulatedServo(model, 2)]
        if mode is not None:
            for servo in self.servos:
                servo.set("operating_mode", mode)
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
        while behind >= CONTROL_PERIOD:
            periods = min(int(behind / CONTROL_PERIOD), 10)
            if self.plant.time >= self._noise_due:
                self.plant.push = self.q.torque_noise * self.rng.standard_normal((1, 2))
                self._noise_due = self.plant.time + 0.01
            self._take_goals()
            self.plant.advance(periods)
            self._roll(periods)
            self._watch(periods * CONTROL_PERIOD)
            behind -= periods * CONTROL_PERIOD

    def _take_goals(self) -> None:
        raw = [servo.raw("goal_position") for servo in self.servos]
        self.plant.torque_on[0] = [servo.torque_on for servo in self.servos]
        asked = [servo.get("goal_current") if servo.follows_current else np.nan for servo in self.servos]
        self.plant.firmware.asked[0] = np.array(asked) * self.servos[0].model.torque_constant
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
            self.ball.step(self.plant.board, 2 * CONTROL_PERIOD if periods > 1 else CONTROL_PERIOD)
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


TICK = 0.002  # s between looks at the physics while nothing else happens


def _hold(folder: Path) -> TextIO:
    """Take the folder for this testbed alone, until the process ends."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = (folder / ".lock").open("w", encoding="utf-8")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        lock.close()
        raise PortError(f"Another testbed uses {folder}. Stop it, or choose another folder with --link-dir.") from error
    return lock


class LiveTestbed:
    """Two serial lines in front of one rig.

    Args:
        rig: the rig.
        link_dir: folder of the links `servos` and `sensors`.
        baud, sensor_baud: speeds that the wires imitate.
        seed: of the line noise.
        video: the camera; its address is written to the file `camera` next to the links.

    Raises:
        PortError: another testbed uses the folder.
    """

    def __init__(
        self, rig: LiveRig, link_dir: Path, baud: int, sensor_baud: int, seed: int, video: VideoProcess | None = None
    ) -> None:
        self._lock = _hold(link_dir)
        self.rig = rig
        self.bus = EmulatedBus(rig.servos)
        self._buffer = bytearray()
        self.servo_line = Line(PseudoSerial(link_dir / SERVOS), baud, self._servo_answers, seed + 1)
        self.sensor_line = Line(PseudoSerial(link_dir / SENSORS), sensor_baud, self._sensor_answers, seed + 2)
        self.camera_file = link_dir / CAMERA
        self.video = video
        if video is not None:
            self.camera_file.write_text(video.url + "\n", encoding="utf-8")
        self._scenes: deque[tuple[float, Scene]] = deque()
        self.covered = False
        self._heard = time.monotonic()
        self.lines = {SERVOS: self.servo_line, SENSORS: self.sensor_line}

    def spin(self, stopped: Callable[[], bool], each: Callable[[float], None] = lambda now: None) -> None:
        """Run until `stopped`; `each` is called at every look at the physics."""
        lines = list(self.lines.values())
        while not stopped():
            now = time.monotonic()
            self.rig.catch_up(now)
            each(now)
            self._film(now)
            for line in lines:
                if line.port.plugged:
                    line.receive(now)
                line.send(now)
            self._watch_silence(now)
            wait(lines, min(now + TICK, *(line.due() for line in lines)), time.monotonic())

    def _watch_silence(self, now: float) -> None:
        silence = now - self._heard
        if silence > 5 * TICK:
            self.rig.refresh()
            for servo in self.rig.servos:
                servo.watch(silence)

    def _film(self, now: float) -> None:
        if self.video is None or not self.video.due():
            return
        self._scenes.append((now, self.rig.scene(self.covered)))
        latency = float(self.rig.q.camera_latency[0, 0])
        while len(self._scenes) > 1 and self._scenes[1][0] <= now - latency:
            self._scenes.popleft()
        self.video.show(self._scenes[0][1])

    def close(self) -> None:
        """Take the devices and their links away."""
        if self.video is not None:
            self.camera_file.unlink(missing_ok=True)
            self.video.close()
        self._lock.close()
        for line in self.lines.values():
            line.port.unplug()

    def fault(self, words: list[str]) -> str:
        """Do to the rig what a line of standard input says; returns what was done or why not."""
        match words:
            case ["unplug" | "plug", "camera"] if self.video is not None:
                self.video.plug(words[0] == "plug")
            case ["unplug", name] if name in self.lines:
                self.lines[name].port.unplug()
            case ["plug", name] if name in self.lines:
                if not self.lines[name].port.plugged:
                    self.lines[name].port.plug()
            case ["noise", name, share] if name in self.lines:
                self.lines[name].bad_share = float(share)
            case ["late", name, seconds] if name in self.lines:
                self.lines[name].extra_delay = float(seconds)
            case ["alarm", axis, bits] if axis in ("x", "y"):
                self.rig.servos["xy".index(axis)].raise_alarm(int(bits, 0))
            case ["heal", axis] if axis in ("x", "y"):
                self.rig.servos["xy".index(axis)].clear_alarm()
            case ["replace", axis, model] if axis in ("x", "y") and model in MODELS:
                self.rig.servos["xy".index(axis)].set("model_number", MODELS[model].number)
            case ["cover"] | ["uncover"]:
                self.covered = words[0] == "cover"
            case ["piezo"]:
                self.rig.piezo += 1
            case _:
                return f"not understood: {' '.join(words)}. {FAULTS}"
        return "done: " + " ".join(words)

    def _servo_answers(self, data: bytes) -> list[tuple[bytes, float]]:
        self._heard = time.monotonic()
        self.rig.refresh()
        return [(answer.data, answer.delay) for answer in self.bus.feed(data)]

    def _sensor_answers(self, data: bytes) -> list[tuple[bytes, float]]:
        self._buffer += data
        answers = []
        while b"\n" in self._buffer:
            line, _, rest = bytes(self._buffer).partition(b"\n")
            self._buffer[:] = rest
            body = unpack(line)
            if body == SUPPLY_REQUEST:
                self.rig.supply_ball()
            if body in (READ_REQUEST, SUPPLY_REQUEST):
                answers.append((write_sample(self.rig.sample()), 50e-6))
        return answers


FAULTS = (
    "Known: unplug servos|sensors|camera; plug servos|sensors|camera; noise servos|sensors SHARE; "
    "late servos|sensors SECONDS; alarm x|y BITS; heal x|y; replace x|y MODEL; cover; uncover; piezo."
)
