# SPDX-License-Identifier: Apache-2.0
"""Every node ends soon after a signal, also where what it waits for never comes: /clock, or who records."""

import asyncio
import json
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from nodes_under_test import PATIENCE, Workplace, free_port, workplace
from rcl_interfaces.srv import GetParameters
from reference_page import nodes

from eps_tunnel_analysis.nodes.answers import Repeated

pytestmark = pytest.mark.realtime
SOON = 2.0  # s from the signal to the end of the process, as docs/howto/namespaces_and_clocks.md promises
WAITING: dict[str, object] = {"sequence": "paper_8s", "connect_timeout": 600.0}
STARTED: dict[tuple[str, str], dict[str, object]] = {
    ("labyrinth_hw", "controller_forwarder"): {"rate": 1.0},  # the slowest: it looks for signals once in a period
    ("labyrinth_hw", "hw_node"): {"autostart": "false"},
    ("labyrinth_sim", "sim_node"): {},
    ("eps_tunnel_analysis", "analysis_node"): {},
    ("eps_tunnel_analysis", "calibrate_node"): {},
    ("eps_tunnel_analysis", "monitor"): {"port": 0},
    ("eps_tunnel_analysis", "player"): WAITING,
}


@pytest.fixture
def place(tmp_path: Path, domain: int) -> Iterator[Workplace]:
    with workplace(tmp_path, domain) as it:
        yield it


def ends(place: Workplace, name: str, how: signal.Signals) -> None:
    """Sends a signal, and waits for a clean end."""
    process = place.processes._running.pop(name)
    process.send_signal(how)
    try:
        code = process.wait(timeout=SOON)
    finally:
        process.kill()
        process.wait()
    assert code == 0, (place.folder / "logs" / f"{name}.log").read_text(encoding="utf-8")


def until_it_answers(place: Workplace, name: str) -> None:
    """Waits until a node was made and serves callbacks.

    It is asked again and again: an answer to a client that the node has not discovered yet is lost for good.
    """
    client = place.node.create_client(GetParameters, f"/{name}/get_parameters")
    place.until(client.service_is_ready)
    place.until(Repeated(client, GetParameters.Request()).done)


def test_no_node_is_forgotten() -> None:
    files = {(package, name): file for package in nodes.PACKAGES for name, file in nodes.executables(package).items()}
    assert set(STARTED) == {node for node, file in files.items() if nodes.parameters(file)}


@pytest.mark.parametrize("how", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.study)])
@pytest.mark.parametrize(("package", "name"), STARTED)
def test_a_node_ends_soon_after_a_signal_where_no_clock_runs(
    place: Workplace, package: str, name: str, how: signal.Signals
) -> None:
    place.start(package, name, use_sim_time="true", **STARTED[package, name])
    until_it_answers(place, name)
    ends(place, name, how)


def test_a_player_ends_while_it_waits_for_who_records(place: Workplace) -> None:
    place.start("labyrinth_sim", "sim_node")
    place.start("eps_tunnel_analysis", "player", sides="[sim]", record="true", silence_timeout=20.0, **WAITING)
    for topic in ("/sim/joint_states", "/sim/joint_commands"):
        place.until(lambda topic=topic: place.node.count_publishers(topic) and place.node.count_subscribers(topic))
    later = time.monotonic() + 2.0  # by then it has heard the simulation, and nothing tells of that
    place.until(lambda: time.monotonic() > later)
    ends(place, "player", signal.SIGTERM)


def test_the_page_works_where_no_clock_runs_and_its_run_is_called_off_at_the_end(place: Workplace) -> None:
    port = free_port()
    place.start("eps_tunnel_analysis", "player", use_sim_time="true", connect_timeout=600.0)
    place.start(
        "eps_tunnel_analysis", "monitor", use_sim_time="true", port=port, ask_token="false", folder=place.folder / "out"
    )
    place.until(lambda: "Open http" in (place.folder / "logs" / "monitor.log").read_text(encoding="utf-8"))

    async def play() -> None:
        address = f"127.0.0.1:{port}"
        page = await websocket_connect(HTTPRequest(f"ws://{address}/live", headers={"Origin": f"http://{address}"}))

        async def told(part: str, field: str, value: object) -> None:
            """Reads on until a part of the page has this value."""
            content: dict[str, Any] = {}
            while content.get(part, {}).get(field) != value:
                content = json.loads(str(await page.read_message()))

        await told("connections", "player", True)
        await page.write_message('{"do": "arm", "on": true}')
        await page.write_message('{"do": "play", "sequence": "paper_8s", "trials": 1}')
        await told("job", "kind", "play")
        page.close()

    asyncio.run(asyncio.wait_for(play(), PATIENCE))
    ends(place, "monitor", signal.SIGINT)
    place.processes.check()
