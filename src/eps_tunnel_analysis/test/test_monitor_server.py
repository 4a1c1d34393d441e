# SPDX-License-Identifier: Apache-2.0
"""Who may see the page and who may drive the rig through it; no browser needed."""

import asyncio
import json
import socket
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from eps_tunnel_analysis.monitor.parts import Job
from eps_tunnel_analysis.monitor.requests import (
    AddRequest,
    ArmRequest,
    DiagnoseRequest,
    PlayRequest,
    Request,
    StopRequest,
    WhatIfRequest,
    parse_request,
)
from eps_tunnel_analysis.monitor.server import Access, MonitorServer
from eps_tunnel_analysis.monitor.state import State
from labyrinth_sim.errors import InputError

TOKEN = "a-token-that-is-long"
PATIENCE = 90.0  # s


class Served:
    """A running server, its state, and what was asked of it."""

    def __init__(self, host: str, token: str, folder: Path) -> None:
        self.state, self.asked = State(), list[Request]()
        report = folder / "report.html"
        report.write_text("<p>evidence")
        self.server = MonitorServer(self.state, host, 0, token, self.asked.append, {1: report})
        self.host = f"127.0.0.1:{self.server.port}"

    def get(self, path: str, **headers: str) -> tuple[int, dict[str, str], str]:
        """Status, headers and text of an answer."""
        connection = HTTPConnection("127.0.0.1", self.server.port, timeout=PATIENCE)
        connection.request("GET", path, headers={"Host": self.host, **headers})
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read().decode(errors="replace")

    def live(self, talk: Callable[[Any], Any], path: str = "/live", **headers: str) -> Any:
        """What `talk` makes of an open WebSocket."""

        async def whole() -> Any:
            request = HTTPRequest(f"ws://127.0.0.1:{self.server.port}{path}", headers={"Host": self.host, **headers})
            connection = await asyncio.wait_for(websocket_connect(request), PATIENCE)
            try:
                return await asyncio.wait_for(talk(connection), PATIENCE)
            finally:
                connection.close()

        return asyncio.run(whole())

    def refused(self, path: str = "/live", **headers: str) -> int:
        """The status with which a WebSocket is refused."""
        with pytest.raises(HTTPClientError) as error:
            self.live(first, path, **headers)
        return error.value.code


@pytest.fixture
def local(tmp_path: Path) -> Iterator[Served]:
    served = Served("127.0.0.1", "", tmp_path)
    yield served
    served.server.close()


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Served]:
    """Reachable from other machines."""
    served = Served("0.0.0.0", TOKEN, tmp_path)
    yield served
    served.server.close()


async def first(connection: Any) -> Any:
    return json.loads(await connection.read_message())


def test_the_page_and_all_that_it_needs_come_from_here(local: Served) -> None:
    status, headers, text = local.get("/")
    assert (status, headers["Content-Type"]) == (200, "text/html")
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert "://" not in text
    for path in [part.split('"')[0] for part in text.split('"/static/')[1:]]:
        assert local.get(f"/static/{path}")[0] == 200, path


@pytest.mark.parametrize("path", ["/nothing", "/static/../server.py", "/static/%2e%2e/server.py", "/report/2",
                                  "/static/%00", "/static/page.js%00", f"/report/{'1' * 5000}"])  # fmt: skip
def test_nothing_else_is_served(local: Served, path: str) -> None:
    assert local.get(path)[0] in (403, 404)


def test_a_report_runs_apart_from_the_page(local: Served) -> None:
    status, headers, text = local.get("/report/1")
    assert (status, text) == (200, "<p>evidence")
    assert "sandbox" in headers["Content-Security-Policy"]
    assert "allow-same-origin" not in headers["Content-Security-Policy"]


def test_the_page_served_here_may_ask(local: Served) -> None:
    async def ask(connection: Any) -> Any:
        await connection.write_message('{"do": "play", "sequence": "paper_8s", "trials": 2}')
        await connection.write_message('{"do": "stop"}')
        while len(local.asked) < 2:
            await asyncio.sleep(0.01)

    local.live(ask, Origin=f"http://{local.host}")
    assert local.asked == [PlayRequest("paper_8s", 2), StopRequest()]


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://{host}", "http://{host}.evil.example",
                                    "http://127.0.0.1:1", "http://localhost:{port}", ""])  # fmt: skip
def test_the_page_of_another_site_cannot_drive_the_rig(local: Served, origin: str) -> None:
    assert local.refused(Origin=origin.format(host=local.host, port=local.server.port)) == 403
    assert local.asked == []


def test_who_tells_no_origin_cannot_drive_the_rig(local: Served) -> None:
    assert local.refused() == 403


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "localhost:1", "", "[", "a:b",
                                  "evil.example@127.0.0.1:{port}"])  # fmt: skip
def test_a_foreign_name_that_points_here_gets_nothing(local: Served, host: str) -> None:
    name = host.format(port=local.server.port)
    assert local.get("/", Host=name)[0] in (400, 403)
    assert local.refused(Host=name, Origin=f"http://{name}") in (400, 403)


def test_a_server_for_other_machines_asks_for_the_token(guarded: Served) -> None:
    origin = f"http://{guarded.host}"
    for path in ("/", "/static/page.js", "/report/1", "/what_if", "/?token=wrong", "/static/index.html?token="):
        assert guarded.get(path)[0] == 403, path
    assert guarded.refused(Origin=origin) == 403
    assert guarded.refused("/live?token=wrong", Origin=origin) == 403
    assert guarded.refused("/live", Origin=origin, Cookie=f"monitor_{guarded.server.port}=wrong") == 403
    assert guarded.asked == []


def test_the_token_in_the_address_is_shown_by_a_cookie_from_then_on(guarded: Served) -> None:
    status, headers, _ = guarded.get(f"/?token={TOKEN}")
    assert status == 200
    cookie, *rest = headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict"} <= set(rest)
    assert guarded.get("/static/page.js", Cookie=cookie)[0] == 200
    assert guarded.refused(Cookie=cookie, Origin="http://evil.example") == 403
    guarded.state.put(Job("play", "", 1.0))
    assert guarded.live(first, Cookie=cookie, Origin=f"http://{guarded.host}")["job"]["kind"] == "play"


def test_other_machines_may_use_address_or_own_name_of_this_one() -> None:
    rules = Access("0.0.0.0", 8765, TOKEN)
    assert rules.knows_host("192.0.2.7:8765")
    assert rules.knows_host("[2001:db8::1]:8765")
    assert rules.knows_host(f"{socket.gethostname()}:8765")
    assert not rules.knows_host("evil.example:8765")
    assert not Access("127.0.0.1", 8765, "").knows_host("192.0.2.7:8765")


def test_a_page_is_told_everything_at_first_and_changes_from_then_on(local: Served) -> None:
    local.state.put(Job("play", "", 1.0))
    local.state.note("one")

    async def talk(connection: Any) -> Any:
        everything = json.loads(await connection.read_message())
        local.state.put(Job("play", "", 1.0))  # no change
        local.state.note("two")
        news = {}
        while not news:
            news = json.loads(await connection.read_message())
        return everything, news

    everything, news = local.live(talk, Origin=f"http://{local.host}")
    assert everything["job"] == {"kind": "play", "progress": "", "seconds": 1.0}
    assert [entry[3] for entry in everything["log"]["entries"]] == ["one"]
    assert set(news) == {"log"}
    # One that comes again, after the connection broke say, is told everything again.
    assert [e[3] for e in local.live(first, Origin=f"http://{local.host}")["log"]["entries"]] == ["one", "two"]


def test_a_wrong_request_is_answered_with_what_would_be_right(local: Served) -> None:
    async def talk(connection: Any) -> Any:
        await connection.write_message('{"do": "plaw"}')
        while "refused" not in (news := json.loads(await connection.read_message())):
            pass
        return news["refused"]

    assert "play" in local.live(talk, Origin=f"http://{local.host}")
    assert local.asked == []


def test_a_port_in_use_is_told(local: Served) -> None:
    with pytest.raises(InputError, match="port:="):
        MonitorServer(State(), "127.0.0.1", local.server.port, "", lambda _: None, {})


@pytest.mark.parametrize(
    ("text", "expected"),
    [('{"do": "arm", "on": true}', ArmRequest(True)), ('{"do": "diagnose"}', DiagnoseRequest()),
     ('{"do": "add", "names": ["backlash.x", "gravity_load.y"]}', AddRequest(("backlash.x", "gravity_load.y"))),
     ('{"do": "what_if", "name": "drive.x.p", "value": 12}', WhatIfRequest("drive.x.p", 12.0)),
     ('{"do": "what_if", "name": "belt.x.a.b", "value": null}', WhatIfRequest("belt.x.a.b", None)),
     ('{"do": "what_if", "name": ""}', WhatIfRequest("", None))],
)  # fmt: skip
def test_requests_are_read(text: str, expected: Request) -> None:
    assert parse_request(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "[" * 9000 + "]" * 9000,
        '{"do": ' * 2000,
        json.dumps({"do": "play", "sequence": "a" * 5000}),
        json.dumps({"do": "add", "names": ["gravity_load.y", "--effects", "/dir"]}),
        json.dumps({"do": "add", "names": ["../gravity_load.y"]}),
        json.dumps({"do": "add", "names": ["gravity_load.y"] * 1000}),
        json.dumps({"do": "what_if", "name": "../../etc", "value": 1}),
        json.dumps({"do": "what_if", "name": "drive.x.p\n", "value": 1}),
        json.dumps({"do": "what_if", "name": ["drive.x.p"], "value": 1}),
        json.dumps({"do": "what_if", "value": 1}),
        json.dumps({"do": "what_if", "name": "drive.x.p", "value": True}),
        json.dumps({"do": "what_if", "name": "drive.x.p", "value": "1"}),
        '{"do": "what_if", "name": "drive.x.p", "value": NaN}',
        '{"do": "what_if", "name": "drive.x.p", "value": -Infinity}',
        '{"do": "what_if", "name": "drive.x.p", "value": 1' + "0" * 400 + "}",
    ],
)
def test_a_request_made_to_break_something_is_refused(text: str) -> None:
    with pytest.raises(InputError) as error:
        parse_request(text)
    assert len(str(error.value)) < 1000


def test_a_nested_request_leaves_the_connection_open(local: Served) -> None:
    async def talk(connection: Any) -> Any:
        await connection.write_message("[" * 4000 + "]" * 4000)
        while "refused" not in json.loads(await connection.read_message()):
            pass
        await connection.write_message('{"do": "stop"}')
        while not local.asked:
            await asyncio.sleep(0.01)

    local.live(talk, Origin=f"http://{local.host}")
    assert local.asked == [StopRequest()]


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.sampled_from(["play", "add", "arm", "what_if"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(["do", "sequence", "trials", "names", "on", "name", "value"]), inner, max_size=4),
)  # fmt: skip


@given(JSON | st.text(max_size=30))
def test_whatever_comes_is_a_request_or_bad_input(content: Any) -> None:
    try:
        parsed = parse_request(content if isinstance(content, str) else json.dumps(content))
    except InputError:
        return
    assert isinstance(parsed, Request)
