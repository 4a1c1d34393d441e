# SPDX-License-Identifier: Apache-2.0
"""The emulated rig behind its serial ports, in real time."""

import fcntl
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from labyrinth_hw import sensor_protocol
from labyrinth_hw.control_tables import MODELS
from labyrinth_hw.errors import PortError
from labyrinth_hw.links import CAMERA, SENSORS, SERVOS
from labyrinth_hw.testbed.rig import LiveRig
from labyrinth_hw.testbed.serial_ports import Line, PseudoSerial, wait
from labyrinth_hw.testbed.servo_emulator import EmulatedBus
from labyrinth_hw.testbed.video_process import VideoProcess
from labyrinth_hw.testbed.video_scene import Scene

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
        video: the camera; its address is written to the file `camera` beside the links.

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
            body = sensor_protocol.unpack(line)
            if body == sensor_protocol.SUPPLY:
                self.rig.supply_ball()
            if body in (sensor_protocol.READ, sensor_protocol.SUPPLY):
                answers.append((sensor_protocol.write_sample(self.rig.sample()), 50e-6))
        return answers


FAULTS = (
    "Known: unplug servos|sensors|camera; plug servos|sensors|camera; noise servos|sensors SHARE; "
    "late servos|sensors SECONDS; alarm x|y BITS; heal x|y; replace x|y MODEL; cover; uncover; piezo."
)
