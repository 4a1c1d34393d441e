# SPDX-License-Identifier: Apache-2.0
"""Draws docs/pictures/monitor.png: once round the loop on the page, in a real browser.

    python test/monitor_picture.py [FILE]

It needs Chromium or Chrome and takes some minutes. The text below the picture in docs/monitor.md says what was played.
"""

import os
import re
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from browser import PATIENCE, Page, browser, chromium
from domain_coordinator import domain_id

from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.processes import Processes

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "monitor.png"
RIG = ("--emulated", "--hide", "gravity_load.x=strong", "--seed", "3")
WIDTH, HEIGHT = 1280, 900  # px
IDLE = "!document.getElementById('diagnose').disabled"
LONGEST = 1200.0  # s of a play or a diagnosis


def address_of(log: Path, processes: Processes) -> str:
    """Where the monitor serves its page, once it says so."""
    deadline = time.monotonic() + PATIENCE
    while not (found := re.search(r"Open (http\S+)", log.read_text(encoding="utf-8"))):
        processes.check()
        if time.monotonic() > deadline:
            raise SystemExit(f"The monitor has not started:\n{log.read_text(encoding='utf-8')}")
        time.sleep(0.1)
    return found[1]


def once_round(page: Page) -> None:
    """Arms, plays three trials, diagnoses, adds what is named, and plays again."""

    def do(button: str) -> None:
        page.until(f"!document.getElementById('{button}').disabled")
        page.click(button)
        print(button, flush=True)
        page.until("document.getElementById('diagnose').disabled")
        page.until(IDLE, patience=LONGEST)

    page.until("document.querySelectorAll('.chip.there').length == 4")
    page.evaluate("document.getElementById('sequence').value = 'excite_12s'")
    page.evaluate("document.getElementById('trials').value = 3")
    page.click("armed")
    do("play")
    do("diagnose")
    page.until("!document.getElementById('adding').hidden")
    do("add")
    do("play")
    page.until("document.getElementById('joint-before').textContent != ''")


def main() -> None:
    program = chromium()
    if program is None:
        raise SystemExit("Chromium or Chrome is needed; name it by $CHROMIUM.")
    picture = Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE
    with domain_id() as domain, tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("logs", "ports"):
            (folder / part).mkdir()
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "XDG_RUNTIME_DIR": str(folder / "ports"),
                       "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONUNBUFFERED": "1"}  # fmt: skip
        given = ["--ros-args", "-p", "port:=0", "-p", f"folder:={folder / 'out'}"]
        with Processes(folder / "logs", environment) as processes, browser(program, folder) as page:
            command = [executable("eps_tunnel_analysis", "monitor"), *RIG, "--out", str(folder / "out"), *given]
            processes.start("monitor", command)
            page.look(WIDTH, HEIGHT, dark=False)
            page.open(address_of(folder / "logs" / "monitor.log", processes))
            once_round(page)
            page.picture(picture)
    print(picture)


if __name__ == "__main__":
    main()
