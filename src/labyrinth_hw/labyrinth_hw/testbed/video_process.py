# SPDX-License-Identifier: Apache-2.0
"""The emulated camera in a process of its own, so that drawing never holds up the serial lines."""

import multiprocessing
import signal
import time
from multiprocessing.connection import Connection

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.layouts import load_layout
from labyrinth_hw.testbed.video import Renderer
from labyrinth_hw.testbed.video_scene import Scene
from labyrinth_hw.testbed.video_stream import VideoStream


def _serve(scenes: Connection, layout: str, port: int, seed: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        stream = VideoStream(port)
    except InputError as error:
        scenes.send(str(error))
        return
    scenes.send(stream.url.encode())
    renderer = Renderer(load_layout(layout), seed=seed)
    port, plugged = stream.port, True
    try:
        while True:
            order = scenes.recv()
            while isinstance(order, Scene) and scenes.poll():
                order = scenes.recv()
            if isinstance(order, Scene) and plugged:
                stream.push(renderer.render(order))
            elif order is False and plugged:
                stream.close()
                plugged = False
            elif order is True and not plugged:
                stream, plugged = VideoStream(port), True
    except (EOFError, OSError):
        stream.close()


class VideoProcess:
    """Draws the scenes it is shown and streams them; scenes that come faster than it draws are skipped.

    Args:
        layout: of the board.
        port: TCP port on this machine; 0 takes a free one.
        rate: pictures per second at most.
        seed: of the pictures' noise.

    Raises:
        InputError: the port is taken.
    """

    def __init__(self, layout: str, port: int, rate: float, seed: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._scenes, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, layout, port, seed), daemon=True)
        self._process.start()
        other.close()
        answer = self._scenes.recv() if self._scenes.poll(30.0) else "The video process did not start in 30 s."
        if isinstance(answer, str):
            self.close()
            raise InputError(answer)
        self.url = answer.decode()
        self._period, self._due = 1.0 / rate, 0.0

    def due(self) -> bool:
        """Whether it is time for the next picture."""
        return time.monotonic() >= self._due

    def show(self, scene: Scene) -> None:
        """Draw a scene."""
        self._due = time.monotonic() + self._period
        try:
            self._scenes.send(scene)
        except OSError:
            self._due = float("inf")

    def plug(self, plugged: bool) -> None:
        """Let the camera vanish, or come back at the same address."""
        self._scenes.send(plugged)

    def close(self) -> None:
        """End the process."""
        self._scenes.close()
        self._process.join(timeout=3.0)
        if self._process.is_alive():
            self._process.terminate()
