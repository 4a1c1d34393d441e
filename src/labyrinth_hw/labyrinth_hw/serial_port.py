# SPDX-License-Identifier: Apache-2.0
"""A serial port for the Dynamixel SDK: held by one program only, sleeping while it waits, timed by a steady clock."""

import fcntl
import os
import select
import termios
import time

import serial
from dynamixel_sdk import PortHandler

from labyrinth_hw.errors import PortError

# What a port raises that vanished while it was open.
GONE = (OSError, serial.SerialException, termios.error, TypeError)


def open_exclusively(path: str, baud: int) -> serial.Serial:
    """An open serial port that no other program of ours can open at the same time.

    Raises:
        PortError: missing, no rights, or in use.
    """
    if not os.path.exists(path):
        raise PortError(f"Serial port {path} does not exist. Plug the adapter in, or start the emulated testbed first.")
    try:
        port = serial.Serial(path, baudrate=baud, timeout=0)
    except (OSError, serial.SerialException) as error:
        raise PortError(f"Serial port {path} cannot be opened: {error}.") from error
    try:
        fcntl.flock(port.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        port.close()
        raise PortError(f"Serial port {path} is in use by another program. Stop that one first.") from error
    port.reset_input_buffer()
    return port


class Port(PortHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's port, with its busy waiting, its wall clock and its 34 ms of patience replaced.

    Args:
        path: of the device.
        baud: bits per second.
        patience: seconds beyond the time the bytes need before an answer counts as lost.
    """

    def __init__(self, path: str, baud: int, patience: float) -> None:
        super().__init__(path)
        self.baudrate = baud
        self.patience = patience

    def openPort(self) -> bool:
        """Open and lock; what a try that failed halfway left open is closed first. Raises PortError."""
        self.closePort()
        self.ser = open_exclusively(self.port_name, self.baudrate)
        self.is_open = True
        self.tx_time_per_byte = 10_000.0 / self.baudrate
        return True

    def closePort(self) -> None:
        """Close; harmless when closed."""
        if self.ser is not None:
            self.ser.close()
        self.is_open = False
        self.is_using = False

    def getCurrentTime(self) -> float:
        """Milliseconds of a clock that never steps."""
        return time.monotonic() * 1e3

    def setPacketTimeout(self, packet_length: int) -> None:
        """Start waiting for this many bytes. The request itself may still be on the wire."""
        self.packet_start_time = self.getCurrentTime()
        self.packet_timeout = self.tx_time_per_byte * (packet_length + 30) + self.patience * 1e3

    def readPort(self, length: int) -> bytes:
        """What has come, after at most 1 ms of sleep."""
        if length > 0:
            select.select([self.ser.fileno()], [], [], 1e-3)
        return bytes(self.ser.read(length))
