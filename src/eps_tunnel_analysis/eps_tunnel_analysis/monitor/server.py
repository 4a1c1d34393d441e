# SPDX-License-Identifier: Apache-2.0
"""Serves the page, sends every open one what changed, and takes their requests.

Only the WebSocket takes requests, and it opens only for the page served here. Access depends on the
address under which the page was requested, the requesting page, and the token.
"""

import asyncio
import hmac
import ipaddress
import json
import re
import secrets
import socket
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tornado.httpserver
import tornado.ioloop
import tornado.netutil
import tornado.web
import tornado.websocket

from eps_tunnel_analysis.monitor.requests import Request, parse_request
from eps_tunnel_analysis.monitor.state import State
from labyrinth_sim.errors import InputError

STATIC = Path(__file__).parent / "static"
POLICY = "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
REPORT_POLICY = "default-src 'unsafe-inline' data: blob:; sandbox allow-scripts allow-popups; frame-ancestors 'none'"
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
SEND_PERIOD = 0.1  # s between two looks for changes
ALIVE = 20  # polls after which a page is sent that there was no change
PING = 10.0  # s
LONGEST_MESSAGE = 65536  # bytes from a page
GOODBYE = 0.05  # s
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
TOKEN_BYTES = 18
SHORTEST_TOKEN = 12  # characters
_HOST = re.compile(r"(?P<name>[a-z0-9.-]+|\[[0-9a-f:.]+\])(:(?P<port>\d{1,5}))?")


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach this address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def new_token() -> str:
    """A token that cannot be guessed."""
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Attributes:
        host: address it listens on.
        port: its port.
        token: must be shown with every request; "" asks for none.
    """

    host: str
    port: int
    token: str

    def knows_host(self, header: str) -> bool:
        """Whether a Host header names this server.

        A name that someone else made to point at this machine (DNS rebinding) is not accepted, so that its pages
        cannot read this one.
        """
        parts = _HOST.fullmatch(header.lower())
        if parts is None or int(parts["port"] or 80) != self.port:
            return False
        name = parts["name"].strip("[]")
        if is_loopback(self.host):
            return name in LOOPBACK_NAMES or name == self.host.strip("[]")
        return name in LOOPBACK_NAMES or _is_address(name) or name in _own_names()

    def knows_origin(self, origin: str | None, host: str) -> bool:
        """Whether the page that opens a connection is the one served here; a browser always names it."""
        return origin is not None and self.knows_host(host) and origin.lower() == f"http://{host}".lower()

    def knows_token(self, *shown: str | None) -> bool:
        """Whether one of the tokens shown, in address or cookie, is the right one."""
        return not self.token or any(hmac.compare_digest(one.encode(), self.token.encode()) for one in shown if one)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
        return True
    except ValueError:
        return False


def _own_names() -> set[str]:
    name = socket.gethostname().lower()
    return {name, name.partition(".")[0], f"{name.partition('.')[0]}.local", socket.getfqdn().lower()}


class Guarded(tornado.web.RequestHandler):
    """Answers only requests that name this server and show its token."""

    @property
    def access(self) -> Access:
        """The rules of this server."""
        rules: Access = self.settings["access"]
        return rules

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        # Some browsers do not count a WebSocket of the same host as 'self'.
        live = f" ws://{self.request.host}" if self.access.knows_host(self.request.host) else ""
        self.set_header("Content-Security-Policy", f"{POLICY}; connect-src 'self'{live}")
        self.clear_header("Server")

    def prepare(self) -> None:
        if not self.access.knows_host(self.request.host):
            raise tornado.web.HTTPError(403, reason="This server is not known by that name")
        if not self.access.knows_token(self.get_query_argument("token", None), self.get_cookie(self.cookie)):
            raise tornado.web.HTTPError(403, reason="Open the address that the monitor printed, with its token")

    @property
    def cookie(self) -> str:
        """Name of the cookie that shows the token; cookies do not distinguish ports."""
        return f"monitor_{self.access.port}"

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}.\n")


class Nothing(Guarded):
    """Any other address."""

    def prepare(self) -> None:
        super().prepare()
        raise tornado.web.HTTPError(404)


class File(Guarded, tornado.web.StaticFileHandler):
    """The page and what belongs to it."""

    def prepare(self) -> None:
        super().prepare()
        if any("\0" in path for path in self.path_args if path):
            raise tornado.web.HTTPError(404)

    def set_extra_headers(self, path: str) -> None:
        shown = self.get_query_argument("token", None)
        if shown:  # from now on the cookie shows it
            self.set_cookie(self.cookie, shown, httponly=True, samesite="Strict")


class Report(Guarded):
    """A report of a diagnosis: a self-contained page, isolated from ours."""

    def initialize(self, reports: Mapping[int, Path]) -> None:
        self._reports = reports

    def get(self, number: str) -> None:
        path = self._reports.get(int(number))
        if path is None or not path.is_file():
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Security-Policy", REPORT_POLICY)
        self.finish(path.read_bytes())


class PastTrial(Guarded):
    """The tunnel table as it was at the end of a trial."""

    def initialize(self, past: Callable[[int], dict[str, Any] | None]) -> None:
        self._past = past

    def get(self, number: str) -> None:
        _tell_table(self, self._past(int(number)))


class WhatIfTable(Guarded):
    """The trajectories for the value that was changed last."""

    def initialize(self, table: Callable[[], dict[str, Any] | None]) -> None:
        self._table = table

    def get(self) -> None:
        _tell_table(self, self._table())


def _tell_table(handler: Guarded, table: dict[str, Any] | None) -> None:
    if table is None:
        raise tornado.web.HTTPError(404)
    handler.set_header("Content-Type", "application/json")
    handler.finish(json.dumps(table, allow_nan=False))


class Live(Guarded, tornado.websocket.WebSocketHandler):
    """One open page.

    Attributes:
        seen: the last revision of the state that it was sent.
    """

    def initialize(self, asked: Callable[[Request], None], pages: "set[Live]") -> None:
        self._asked, self._pages = asked, pages
        self.seen = -1
        self._sending: Any = None

    def check_origin(self, origin: str) -> bool:
        return self.access.knows_origin(origin, self.request.host)

    async def get(self, *args: Any, **kwargs: Any) -> None:
        # Not left to `check_origin`: tornado asks it only where it takes a request to be of another site.
        if not self.access.knows_origin(self.request.headers.get("Origin"), self.request.host):
            raise tornado.web.HTTPError(403, reason="Only the page served here may connect")
        await super().get(*args, **kwargs)

    def open(self, *_: str, **__: str) -> None:
        self._pages.add(self)

    def on_close(self) -> None:
        self._pages.discard(self)

    @property
    def idle(self) -> bool:
        """Whether its last message has been sent; a slow page gets fewer messages, each of them complete."""
        return self._sending is None or self._sending.done()

    def send(self, message: str, revision: int) -> None:
        """Sends what changed up to a revision; "" where nothing did."""
        self.seen = revision
        if message:
            try:
                self._sending = self.write_message(message)
                self._sending.add_done_callback(lambda future: future.cancelled() or future.exception())
            except tornado.websocket.WebSocketClosedError:
                self._pages.discard(self)

    def on_message(self, message: str | bytes) -> None:
        try:
            self._asked(parse_request(message))
        except InputError as error:
            self.write_message(json.dumps({"refused": str(error)}))


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
        """The address to open in a browser."""
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
                (r"/trial/([0-9]{1,9})", PastTrial, {"past": self._state.past}),
                (r"/what_if", WhatIfTable, {"table": self._state.what_if}),
                (r"/report/([0-9]{1,9})", Report, {"reports": self._reports}),
                (r"/()", File, {"path": str(STATIC), "default_filename": "index.html"}),
                (r"/static/(.*)", File, {"path": str(STATIC)}),
            ],
            default_handler_class=Nothing, websocket_ping_interval=PING, websocket_max_message_size=LONGEST_MESSAGE,
            log_function=lambda _: None, access=self.access,
        )  # fmt: skip
        server = tornado.httpserver.HTTPServer(application)
        server.add_sockets(self._sockets)
        sender = tornado.ioloop.PeriodicCallback(self._send, SEND_PERIOD * 1000)
        sender.start()
        self._loop.call_soon(self._ready.set)
        try:
            self._loop.run_forever()
        finally:
            sender.stop()
            server.stop()
            for page in list(self._pages):
                page.close(1001, "The monitor ends.")
            self._loop.run_until_complete(asyncio.sleep(GOODBYE))
            self._loop.close()

    def _send(self) -> None:
        self._looks += 1
        nothing = "{}" if self._looks % ALIVE == 0 else ""
        encoded: dict[int, tuple[str, int]] = {}  # pages that saw the same get the same
        for page in [page for page in self._pages if page.idle]:
            if page.seen not in encoded:
                changes, revision = self._state.changes(page.seen)
                encoded[page.seen] = (json.dumps(changes, allow_nan=False) if changes else nothing, revision)
            page.send(*encoded[page.seen])
