# SPDX-License-Identifier: Apache-2.0
"""Pseudo-terminals with predictable names, and lines on them that take the time a real wire takes."""

import fcntl
import heapq
import os
import select
import struct
import termios
import tty
from collections.abc import Callable
from pathlib import Path

import numpy as np

from labyrinth_hw.errors import PortError


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
