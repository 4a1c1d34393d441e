# SPDX-License-Identifier: Apache-2.0
"""What the server answers, and to whom.

Only the WebSocket takes requests, and it opens to none but the page served here.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import tornado.web
import tornado.websocket

from eps_tunnel_analysis.monitor.access import Access
from eps_tunnel_analysis.monitor.requests import Request, parse_request
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


class Guarded(tornado.web.RequestHandler):
    """Answers only who names this server and shows its token."""

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
        """Name of the cookie that shows the token; cookies do not tell ports apart."""
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

    def set_extra_headers(self, path: str) -> None:
        shown = self.get_query_argument("token", None)
        if shown:  # from now on the cookie shows it
            self.set_cookie(self.cookie, shown, httponly=True, samesite="Strict")


class Report(Guarded):
    """A report that a diagnosis wrote: a page with everything inside, kept apart from ours."""

    def initialize(self, reports: Mapping[int, Path]) -> None:
        self._reports = reports

    def get(self, number: str) -> None:
        path = self._reports.get(int(number))
        if path is None or not path.is_file():
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Security-Policy", REPORT_POLICY)
        self.finish(path.read_bytes())


class Live(Guarded, tornado.websocket.WebSocketHandler):
    """One open page.

    Attributes:
        seen: the last revision of the state that it was told.
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
        """Whether what it was told last has left; a slow page gets fewer messages, each of them whole."""
        return self._sending is None or self._sending.done()

    def tell(self, message: str, revision: int) -> None:
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
