# SPDX-License-Identifier: Apache-2.0
"""The emulated camera: a process of its own draws, so that drawing never holds up the serial lines.

The pictures go out as motion JPEG over HTTP, as network cameras send them.
"""

import multiprocessing
import queue
import signal
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing.connection import Connection

import cv2

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.renderer import Frame, Renderer
from labyrinth_hw.testbed.scene import Scene, load_layout

BOUNDARY = "frame"
CAMERA_LATENCY = 0.1
"""s from the scene to the picture on the wire, whatever the machine has to do meanwhile."""
TOO_LATE = 0.01  # s after it; such a picture is dropped, as cameras drop frames


class VideoStream:
    """Serves the newest pushed frame to any number of viewers at `url`.

    A viewer slower than the source misses frames; it never slows the source. Closing it is what a camera unplugged
    looks like; a new one on the same `port` is the camera plugged in again.

    Args:
        port: 0 takes a free one. host: this machine only by default.
        quality: of the JPEG pictures, 1 to 100.
    """

    def __init__(self, port: int = 0, host: str = "127.0.0.1", quality: int = 95) -> None:
        self._quality = quality
        self._news = threading.Condition()
        self._jpeg, self._number, self._over = b"", 0, False
        stream = self

        class Viewer(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                stream._serve(self)

            def log_message(self, format: str, *args: object) -> None:
                pass

        try:
            self._server = ThreadingHTTPServer((host, port), Viewer)
        except OSError as error:
            raise InputError(f"Cannot serve video on {host}:{port}: {error}. Give another port, or 0.") from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        return int(self._server.server_address[1])

    @property
    def url(self) -> str:
        """What to give to a camera as its source."""
        return f"http://{self._server.server_address[0]!s}:{self.port}/video.mjpg"

    def push(self, frame: Frame) -> None:
        """Shows (height, width, 3) BGR to all viewers."""
        ok, jpeg = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, self._quality])
        if not ok:
            raise InputError(f"A frame of shape {frame.shape} and type {frame.dtype} is no picture.")
        with self._news:
            self._jpeg, self._number = jpeg.tobytes(), self._number + 1
            self._news.notify_all()

    def close(self) -> None:
        """Ends all connections and frees the port."""
        with self._news:
            self._over = True
            self._news.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=5.0)

    def __enter__(self) -> "VideoStream":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _serve(self, viewer: BaseHTTPRequestHandler) -> None:
        viewer.send_response(200)
        viewer.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        viewer.send_header("Cache-Control", "no-store")
        viewer.end_headers()
        shown = 0
        try:
            while True:
                with self._news:
                    while not self._over and self._number == shown:
                        self._news.wait()
                    if self._over:
                        return
                    jpeg, shown = self._jpeg, self._number
                head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                viewer.wfile.write(head.encode() + jpeg + b"\r\n")
        except (BrokenPipeError, ConnectionResetError):
            return


class Outgoing:
    """Pictures on their way: each leaves `CAMERA_LATENCY` after its scene, so that a camera's latency is one number.

    Args:
        stream: where they go.
    """

    def __init__(self, stream: VideoStream) -> None:
        self._stream = stream
        self._drawn: queue.SimpleQueue[tuple[float, Frame] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def put(self, taken: float, frame: Frame) -> None:
        """A picture of the scene at `taken`, s of the steady clock."""
        self._drawn.put((taken, frame))

    def close(self) -> None:
        """Ends the stream, too."""
        self._drawn.put(None)
        self._thread.join(timeout=5.0)
        self._stream.close()

    def _send(self) -> None:
        while (drawn := self._drawn.get()) is not None:
            due = drawn[0] + CAMERA_LATENCY
            time.sleep(max(0.0, due - time.monotonic()))
            if time.monotonic() < due + TOO_LATE:
                self._stream.push(drawn[1])


def _serve(scenes: Connection, layout: str, port: int, seed: int, marble: tuple[int, int, int] | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        stream = VideoStream(port)
    except InputError as error:
        scenes.send(str(error))
        return
    scenes.send(stream.url.encode())
    renderer = Renderer(load_layout(layout), seed=seed, marble=marble)
    port, outgoing = stream.port, Outgoing(stream)
    plugged = True
    try:
        while True:
            order = scenes.recv()
            while not isinstance(order, bool) and scenes.poll():
                order = scenes.recv()
            if not isinstance(order, bool) and plugged:
                taken, scene = order
                outgoing.put(taken, renderer.render(scene))
            elif order is False and plugged:
                outgoing.close()
                plugged = False
            elif order is True and not plugged:
                outgoing, plugged = Outgoing(VideoStream(port)), True
    except (EOFError, OSError):
        outgoing.close()


class VideoProcess:
    """Draws the scenes it is shown and streams them; scenes that come faster than it draws are skipped.

    Args:
        layout: of the board.
        port: TCP port on this machine; 0 takes a free one.
        rate: pictures per second at most.
        seed: of the pictures' noise.
        marble: BGR colour of a painted marble; None for a steel ball.

    Raises:
        InputError: the port is taken.
    """

    def __init__(
        self, layout: str, port: int, rate: float, seed: int, marble: tuple[int, int, int] | None = None
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._scenes, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, layout, port, seed, marble), daemon=True)
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
        """Draw what is seen now."""
        now = time.monotonic()
        self._due = now + self._period
        try:
            self._scenes.send((now, scene))
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
