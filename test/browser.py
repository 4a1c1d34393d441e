# SPDX-License-Identifier: Apache-2.0
"""A real Chromium without a screen, driven by the Chrome DevTools protocol."""

import asyncio
import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from tornado.websocket import WebSocketClientConnection, websocket_connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE = 90.0  # s; only what hangs takes so long
BIG = 64 * 1024 * 1024  # bytes; pictures come as one message


def chromium() -> str | None:
    """The program, by $CHROMIUM or by its usual names; None where there is none."""
    named = os.environ.get("CHROMIUM")
    return named or next((found for name in NAMES if (found := shutil.which(name))), None)


class Page:
    """One page.

    Attributes:
        troubles: what the page threw or printed as an error.
        fetched: address of everything it asked for.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, socket: WebSocketClientConnection) -> None:
        self._loop, self._socket, self._number = loop, socket, 0
        self.troubles: list[str] = []
        self.fetched: list[str] = []
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.command(f"{domain}.enable")

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Sends a command and returns its result."""
        self._number += 1
        number = self._number
        sent = json.dumps({"id": number, "method": method, "params": parameters})
        self._run(lambda: self._socket.write_message(sent))
        while True:
            message = json.loads(self._run(self._socket.read_message))
            if message.get("id") == number:
                assert "error" not in message, message
                result: dict[str, Any] = message["result"]
                return result
            self._note(message)

    def open(self, address: str) -> None:
        """Goes to an address."""
        self.command("Page.navigate", url=address)

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        told = self.command("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in told, (script, told["exceptionDetails"])
        return told["result"].get("value")

    def until(self, script: str, meanwhile: Callable[[], None] = lambda: None, patience: float = PATIENCE) -> Any:
        """Waits, at most `patience` s, until an expression is true, and returns its value; `meanwhile` may raise."""
        deadline = time.monotonic() + patience
        while not (value := self.evaluate(script)):
            meanwhile()
            if time.monotonic() > deadline:
                shown = self.evaluate("document.body ? document.body.innerText.slice(0, 3000) : ''")
                raise AssertionError(f"waited too long for {script}; the page shows:\n{shown}")
            time.sleep(0.1)
        return value

    def click(self, element: str) -> None:
        """Clicks an element by its id, as a mouse does: not where it is disabled or covered."""
        script = f"""(() => {{ const e = document.getElementById("{element}"); e.scrollIntoView({{block: "center"}});
            const box = (e.offsetWidth > 4 ? e : e.parentElement).getBoundingClientRect();
            return [box.left + box.width / 2, box.top + box.height / 2, Boolean(e.disabled)]; }})()"""
        x, y, disabled = self.evaluate(script)
        assert not disabled, f"{element} is disabled"
        for kind in ("mousePressed", "mouseReleased"):
            self.command("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def look(self, width: int, height: int, dark: bool) -> None:
        """A screen of this size in px, with dark or light colours."""
        self.command(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.command("Emulation.setEmulatedMedia", features=scheme)

    def picture(self, path: Path) -> None:
        """The whole page as a PNG file."""
        told = self.command("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(told["data"]))

    def choose(self, element: str, value: str, event: str) -> None:
        """Sets a field by its id, and tells the page as a person's choice would: by "change" or "input"."""
        field = f"document.getElementById({element!r})"
        self.evaluate(f"{field}.value = {value!r}; {field}.dispatchEvent(new Event({event!r}))")

    def _note(self, message: dict[str, Any]) -> None:
        told = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.troubles.append(json.dumps(told["exceptionDetails"])[:500])
        elif message.get("method") == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.troubles.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
        elif message.get("method") in ("Network.requestWillBeSent", "Network.webSocketCreated"):
            self.fetched.append(told["request"]["url"] if "request" in told else told["url"])

    def _run(self, begin: Callable[[], Any]) -> Any:
        async def limited() -> Any:
            return await asyncio.wait_for(begin(), PATIENCE)

        return self._loop.run_until_complete(limited())


@contextmanager
def browser(program: str, folder: Path) -> Iterator[Page]:
    """Starts Chromium with a profile of its own in `folder`, and ends it."""
    options = ["--headless=new", "--remote-debugging-port=0", f"--user-data-dir={folder / 'profile'}", "--no-sandbox",
               "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run", "--disable-background-networking",
               "--disable-component-update", "--disable-sync", "--hide-scrollbars", "about:blank"]  # fmt: skip
    told = folder / "profile" / "DevToolsActivePort"
    told.unlink(missing_ok=True)  # of an earlier browser
    with (folder / "chromium.log").open("wb") as log:
        process = subprocess.Popen([program, *options], stdout=log, stderr=log, start_new_session=True)
    loop = asyncio.new_event_loop()
    try:
        deadline = time.monotonic() + PATIENCE
        while not (told.exists() and len(told.read_text().split()) == 2):
            assert process.poll() is None, (folder / "chromium.log").read_text()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        with urlopen(f"http://127.0.0.1:{told.read_text().split()[0]}/json/list") as answer:
            target = next(t for t in json.load(answer) if t["type"] == "page")
        address = target["webSocketDebuggerUrl"]

        async def connect() -> WebSocketClientConnection:
            return await websocket_connect(address, max_message_size=BIG)

        socket = loop.run_until_complete(connect())
        yield Page(loop, socket)

        async def close() -> None:
            socket.close()

        loop.run_until_complete(close())  # closing waits on the loop that runs
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        loop.close()
