# SPDX-License-Identifier: Apache-2.0
"""The emulated camera's way out: motion JPEG over HTTP, as network cameras speak it, or a video file."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.video import Frame

BOUNDARY = "frame"


class VideoStream:
    """Serves the newest pushed frame to any number of viewers at `url`.

    A viewer slower than the source misses frames; it never slows the source. Closing it is what a camera unplugged
    looks like; a new one on the same `port` is the camera plugged in again.

    Args:
        port: 0 takes a free one. host: this machine only unless told otherwise.
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


class VideoFile:
    """Writes frames of one size to a new motion JPEG file (.avi). Raises InputError where it exists or cannot be."""

    def __init__(self, path: Path | str, size: tuple[int, int] = (640, 360), rate: float = 60.0) -> None:
        self.path, self.size = Path(path), size
        if self.path.exists():
            raise InputError(f"{self.path} exists and is not overwritten. Give another name.")
        self._writer = cv2.VideoWriter(str(self.path), cv2.VideoWriter.fourcc(*"MJPG"), rate, size)
        if not self._writer.isOpened():
            raise InputError(f"Cannot write video to {self.path}. The name must end in .avi and its folder exist.")

    def push(self, frame: Frame) -> None:
        """Appends (height, width, 3) BGR."""
        if frame.shape != (self.size[1], self.size[0], 3):
            raise InputError(f"Expected a frame of shape {(self.size[1], self.size[0], 3)}, got {frame.shape}.")
        self._writer.write(frame)

    def close(self) -> None:
        self._writer.release()

    def __enter__(self) -> "VideoFile":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
