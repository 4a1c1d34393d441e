# SPDX-License-Identifier: Apache-2.0
"""Potentiometers, piezo and ball depot behind the sensor line."""

import select
import time
from dataclasses import dataclass

import serial

from labyrinth_hw import sensor_protocol
from labyrinth_hw.errors import SensorError
from labyrinth_hw.sensor_protocol import SensorSample
from labyrinth_hw.serial_line import GONE, open_exclusively


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
    """stamp: s, `time.monotonic()` of the request; x, y: rad; piezo: hits so far."""

    stamp: float
    x: float
    y: float
    piezo: int


class SensorLine:
    """The microcontroller on its serial port: ask first, collect later, so that the answer travels meanwhile.

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

    def connect(self) -> None:
        """Open the port and wait for a first answer. Raises PortError, SensorError."""
        self._port = open_exclusively(self.path, self.baud)
        for _ in range(5):
            self.ask()
            if self.collect(0.1) is not None:
                return
        self.close()
        raise SensorError(
            f"No valid answer on {self.path} at {self.baud} baud. Expected a line like "
            f"{sensor_protocol.sentence('S,0,0,0,0,0,0').decode().strip()} to each request; check baud and firmware."
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
            port.write(sensor_protocol.sentence(sensor_protocol.SUPPLY if supply else sensor_protocol.READ))
        except GONE as error:
            raise SensorError(f"Sensor line {self.path} is gone: {error}.") from error
        self.asked += 1

    def collect(self, patience: float | None = None) -> BoardState | None:
        """The answer to the last request, or None where none came in time."""
        port = self._open_port()
        deadline = time.monotonic() + (self.patience if patience is None else patience)
        while (left := deadline - time.monotonic()) > 0 or b"\n" in self._buffer:
            line, newline, rest = bytes(self._buffer).partition(b"\n")
            if newline:
                self._buffer[:] = rest
                sample = sensor_protocol.read_sample(line)
                if sample is not None:
                    return self._state(sample)
                self.damaged += 1
                continue
            try:
                select.select([port.fileno()], [], [], left)
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
        return BoardState(self._stamp, self.x.angle(sample.pot_x), self.y.angle(sample.pot_y), sample.piezo)
