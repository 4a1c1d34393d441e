# SPDX-License-Identifier: Apache-2.0
"""Potentiometers, piezo and ball depot behind the sensor line: ASCII sentences with a checksum, as in NMEA 0183.

Host to microcontroller, microcontroller to host:

    $R*52           $S,<seq>,<micros>,<pot_x>,<pot_y>,<piezo>,<depot>*<checksum>
    $B*42           the same, after the depot was asked to release a ball

Counts are decimal; the checksum is the XOR of the bytes between `$` and `*`, in two hexadecimal digits; a sentence ends
with a line feed. The potentiometers are sampled when the request's line feed arrives.
"""

import select
import time
from collections import deque
from dataclasses import dataclass
from math import nan

import numpy as np
import serial

from labyrinth_hw.errors import SensorError
from labyrinth_hw.serial_port import GONE, open_exclusively

READ_REQUEST, SUPPLY_REQUEST = "R", "B"


@dataclass(frozen=True)
class SensorSample:
    """One answer of the sensor line.

    Attributes:
        sequence: 0..65535, grows by one per answer.
        micros: microseconds of the microcontroller's clock when the potentiometers were sampled, modulo 2^32.
        pot_x, pot_y: counts of the potentiometers' converters.
        piezo: hits since power-up, modulo 65536.
        depot: balls released since power-up, modulo 65536.
    """

    sequence: int
    micros: int
    pot_x: int
    pot_y: int
    piezo: int
    depot: int


def sentence(body: str) -> bytes:
    """A body with frame and checksum."""
    value = 0
    for byte in body.encode("ascii"):
        value ^= byte
    return f"${body}*{value:02X}\n".encode("ascii")


def unpack(line: bytes) -> str | None:
    """The body of a sentence, or None where frame or checksum are wrong."""
    text = line.strip()
    if len(text) < 4 or text[:1] != b"$" or text[-3:-2] != b"*" or not text.isascii():
        return None
    body = text[1:-3].decode("ascii")
    return body if sentence(body).strip().upper() == text.upper() else None


def write_sample(sample: SensorSample) -> bytes:
    """A sample as a sentence."""
    s = sample
    return sentence(f"S,{s.sequence},{s.micros},{s.pot_x},{s.pot_y},{s.piezo},{s.depot}")


def read_sample(line: bytes) -> SensorSample | None:
    """The sample in a line, or None where the line holds none."""
    body = unpack(line)
    if body is None:
        return None
    fields = body.split(",")
    if len(fields) != 7 or fields[0] != "S":
        return None
    try:
        return SensorSample(*(int(field) for field in fields[1:]))
    except ValueError:
        return None


@dataclass(frozen=True)
class Potentiometer:
    """How counts become an angle: `sign * (count - zero) * scale`.

    Attributes:
        zero: count at board angle 0.
        scale: rad per count.
        sign: +1 or -1.
    """

    zero: float
    scale: float
    sign: int = 1

    def angle(self, count: int) -> float:
        """rad."""
        return self.sign * (count - self.zero) * self.scale


@dataclass(frozen=True)
class BoardState:
    """What the sensor line measured.

    Attributes:
        stamp: s, `time.monotonic()` of the request.
        x, y: rad.
        speed: of x and y, rad/s; NaN before there are enough samples.
        piezo: hits so far.
    """

    stamp: float
    x: float
    y: float
    speed: tuple[float, float]
    piezo: int


class Slope:
    """Speed from angles: the end slope of a parabola through the newest samples, by least squares.

    A parabola, because a line's slope would be that of the window's middle, 30 ms ago at 100 Hz. White noise of the
    angle comes out 0.68 / period times as large (seven samples): 0.3 mrad at 100 Hz give 20 mrad/s.

    Args:
        samples: in the window.
        longest: s; samples older than this are forgotten.
    """

    def __init__(self, samples: int = 7, longest: float = 0.15) -> None:
        self._kept: deque[tuple[float, float, float]] = deque(maxlen=samples)
        self._longest = longest

    def add(self, stamp: float, x: float, y: float) -> tuple[float, float]:
        """Take a sample, s, rad; returns both speeds, rad/s, NaN while the window is not full."""
        self._kept.append((stamp, x, y))
        while self._kept[-1][0] - self._kept[0][0] > self._longest:
            self._kept.popleft()
        if len(self._kept) < (self._kept.maxlen or 0):
            return nan, nan
        rows = np.array(self._kept)
        since = rows[:, 0] - stamp
        fit = np.linalg.lstsq(np.column_stack((np.ones_like(since), since, since**2)), rows[:, 1:], rcond=None)[0]
        return float(fit[1, 0]), float(fit[1, 1])


class SensorLine:
    """The microcontroller on its serial port: request first, collect later, so that the answer can travel in the
    meantime.

    Args:
        path: serial device.
        baud: bits per second.
        x, y: potentiometers.
        patience: s to wait for an answer.
    """

    def __init__(self, path: str, baud: int, x: Potentiometer, y: Potentiometer, patience: float = 0.02) -> None:
        self.path, self.baud, self.x, self.y, self.patience = path, baud, x, y, patience
        self.asked = self.lost = self.damaged = 0
        self._port: serial.Serial | None = None
        self._buffer = bytearray()
        self._stamp = 0.0
        self._slope = Slope()

    def open(self) -> None:
        """Open the port without waiting for an answer: opening restarts some microcontrollers. Raises PortError."""
        self._port = open_exclusively(self.path, self.baud)

    def connect(self) -> None:
        """Open the port and wait for a first answer. Raises PortError, SensorError."""
        self.open()
        for _ in range(5):
            self.ask()
            if self.collect(0.1) is not None:
                return
        self.close()
        raise SensorError(
            f"No valid answer on {self.path} at {self.baud} baud. Expected a line like "
            f"{sentence('S,0,0,0,0,0,0').decode().strip()} to each request; check baud and firmware."
        )

    def close(self) -> None:
        """Close; harmless when closed."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def ask(self, *, supply: bool = False) -> None:
        """Request a sample now, or that the depot releases a ball."""
        port = self._open_port()
        try:
            port.reset_input_buffer()
            self._buffer.clear()
            self._stamp = time.monotonic()
            port.write(sentence(SUPPLY_REQUEST if supply else READ_REQUEST))
        except GONE as error:
            raise SensorError(f"Sensor line {self.path} is gone: {error}.") from error
        self.asked += 1

    def collect(self, patience: float | None = None) -> BoardState | None:
        """The answer to the last request, or None where none came in time."""
        port = self._open_port()
        deadline = time.monotonic() + (self.patience if patience is None else patience)
        while (remaining := deadline - time.monotonic()) > 0 or b"\n" in self._buffer:
            line, newline, rest = bytes(self._buffer).partition(b"\n")
            if newline:
                self._buffer[:] = rest
                sample = read_sample(line)
                if sample is not None:
                    return self._state(sample)
                self.damaged += 1
                continue
            try:
                select.select([port.fileno()], [], [], remaining)
                self._buffer += port.read(256)
            except GONE as error:
                raise SensorError(f"Sensor line {self.path} is gone: {error}.") from error
        self.lost += 1
        return None

    def _open_port(self) -> serial.Serial:
        if self._port is None:
            raise SensorError(f"Sensor line {self.path} is not open; call connect() first.")
        return self._port

    def _state(self, sample: SensorSample) -> BoardState:
        x, y = self.x.angle(sample.pot_x), self.y.angle(sample.pot_y)
        return BoardState(self._stamp, x, y, self._slope.add(self._stamp, x, y), sample.piezo)
