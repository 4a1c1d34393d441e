# SPDX-License-Identifier: Apache-2.0
"""Serves the page, tells every open one what changed, and takes what they ask for."""

import asyncio
import json
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import tornado.httpserver
import tornado.ioloop
import tornado.netutil
import tornado.web

from eps_tunnel_analysis.monitor.access import Access
from eps_tunnel_analysis.monitor.handlers import STATIC, File, Live, Nothing, Report
from eps_tunnel_analysis.monitor.requests import Request
from eps_tunnel_analysis.monitor.state import State
from labyrinth_sim.errors import InputError

PERIOD = 0.1  # s between two looks for changes
ALIVE = 20  # looks after which a page is told that there was no change
PING = 10.0  # s
LONGEST_MESSAGE = 65536  # bytes from a page
GOODBYE = 0.05  # s


class MonitorServer:
    """A server in a thread of its own.

    Args:
        state: what the page shows.
        host, port: where to listen; port 0 takes a free one.
        token: to be shown by every page, "" for none.
        asked: called from the server's thread with every request.
        reports: HTML files that are served as /report/NUMBER.

    Raises:
        InputError: the address cannot be listened on.
    """

    def __init__(
        self, state: State, host: str, port: int, token: str, asked: Callable[[Request], None],
        reports: Mapping[int, Path],
    ) -> None:  # fmt: skip
        try:
            self._sockets = tornado.netutil.bind_sockets(port, host)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"Cannot listen on {host} port {port}: {getattr(error, 'strerror', None) or error}. Is another monitor "
                "running? Choose a free port by `-p port:=...` (0 takes any), or an address of this machine by "
                "`-p host:=...`."
            ) from error
        self.port = int(self._sockets[0].getsockname()[1])
        self.access = Access(host, self.port, token)
        self._state, self._asked, self._reports = state, asked, reports
        self._pages: set[Live] = set()
        self._looks = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="server", daemon=True)
        self._thread.start()
        self._ready.wait()

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host = "localhost" if self.access.host in ("0.0.0.0", "::", "") else self.access.host
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.port}/" + (f"?token={self.access.token}" if self.access.token else "")

    @property
    def pages(self) -> int:
        """How many pages are open."""
        return len(self._pages)

    def close(self) -> None:
        """Closes every page's connection and stops."""
        if self._loop is not None and self._loop.is_running():
            self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _serve(self) -> None:
        self._loop = asyncio.new_event_loop()
        asyncio.set_event_loop(self._loop)
        application = tornado.web.Application(
            [
                (r"/live", Live, {"asked": self._asked, "pages": self._pages}),
                (r"/report/(\d+)", Report, {"reports": self._reports}),
                (r"/()", File, {"path": str(STATIC), "default_filename": "index.html"}),
                (r"/static/(.*)", File, {"path": str(STATIC)}),
            ],
            default_handler_class=Nothing, websocket_ping_interval=PING, websocket_max_message_size=LONGEST_MESSAGE,
            log_function=lambda _: None, access=self.access,
        )  # fmt: skip
        server = tornado.httpserver.HTTPServer(application)
        server.add_sockets(self._sockets)
        tell = tornado.ioloop.PeriodicCallback(self._tell, PERIOD * 1000)
        tell.start()
        self._loop.call_soon(self._ready.set)
        try:
            self._loop.run_forever()
        finally:
            tell.stop()
            server.stop()
            for page in list(self._pages):
                page.close(1001, "The monitor ends.")
            self._loop.run_until_complete(asyncio.sleep(GOODBYE))
            self._loop.close()

    def _tell(self) -> None:
        self._looks += 1
        nothing = "{}" if self._looks % ALIVE == 0 else ""
        encoded: dict[int, tuple[str, int]] = {}  # pages that saw the same get the same
        for page in [page for page in self._pages if page.idle]:
            if page.seen not in encoded:
                changes, revision = self._state.changes(page.seen)
                encoded[page.seen] = (json.dumps(changes, allow_nan=False) if changes else nothing, revision)
            page.tell(*encoded[page.seen])
