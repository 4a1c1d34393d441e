# SPDX-License-Identifier: Apache-2.0
"""The page to watch in a real browser, on the emulated rig: load, play, diagnose, add, and the gap falls."""

import os
import re
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")

sys.path.insert(0, str(Path(__file__).parent))

from browser import Page, browser, chromium
from nodes_under_test import PATIENCE, Workplace, free_port, workplace
from short_sequence import SHORTER

from eps_tunnel_analysis.nodes.monitor_node import main
from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.processes import Processes

pytestmark = pytest.mark.realtime
TOKEN = "a-token-that-is-long"
FEW = "[gravity_load, return_spring]"
IDLE = "!document.getElementById('diagnose').disabled"
BUSY = "document.getElementById('diagnose').disabled"
MOVED = "document.getElementById('what-if-word').textContent"
JOINT = "parseFloat(document.getElementById('joint').textContent)"


@dataclass
class Watched:
    """The emulated rig with its nodes, the monitor as a program of its own, and a page in a browser."""

    place: Workplace
    page: Page
    port: int
    monitors: int = 0

    @contextmanager
    def monitor(self) -> Iterator[None]:
        """The monitor runs for as long."""
        self.monitors += 1
        logs = self.place.folder / f"monitor_{self.monitors}"
        logs.mkdir()
        given = {"port": self.port, "folder": self.place.folder / "out", "candidates": FEW, "token": TOKEN}
        parameters = [part for key, value in given.items() for part in ("-p", f"{key}:={value}")]
        with Processes(logs, self.place.environment) as processes:
            processes.start("monitor", [executable("eps_tunnel_analysis", "monitor"), "--ros-args", *parameters])
            deadline = time.monotonic() + PATIENCE
            while "Open http" not in (logs / "monitor.log").read_text():
                processes.check()
                assert time.monotonic() < deadline
                time.sleep(0.05)
            yield

    def until(self, script: str) -> object:
        return self.page.until(script, self.place.processes.check)

    def all_there(self) -> None:
        self.until("document.querySelectorAll('.chip.there').length == 4")

    def play(self) -> None:
        """Plays the chosen sequence and waits for its end."""
        self.until("!document.getElementById('play').disabled")
        self.page.click("play")
        self.until(BUSY)
        self.until(IDLE)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Watched]:
    program = chromium()
    if program is None:
        pytest.skip("needs Chromium or Chrome; name it by $CHROMIUM")
    folder = tmp_path_factory.mktemp("monitor")
    (folder / "config" / "sequences").mkdir(parents=True)
    (folder / "config" / "sequences" / "short.yaml").write_text(SHORTER + "trials: 2\n")
    ports = folder / "ports"
    ports.mkdir()
    with workplace(folder / "nodes", module_domain) as place:
        place.environment.update(XDG_RUNTIME_DIR=str(ports), EPS_TUNNEL_CONFIG=str(folder / "config"))
        place.processes = Processes(place.folder / "logs", place.environment)
        testbed = ["--config", "healthy", "--seed", "1", "--effect", "gravity_load.x=strong"]
        place.processes.start("testbed", [executable("labyrinth_hw", "testbed"), *testbed])
        place.until(lambda: len(list(ports.rglob("*"))) >= 3)
        place.start("labyrinth_hw", "hw_node", config="healthy", arm="true", disarm_after=0.0)
        place.start("labyrinth_sim", "sim_node", model="labyrinth_manual")
        place.start("eps_tunnel_analysis", "analysis_node")
        place.start("eps_tunnel_analysis", "player", connect_timeout=40.0, silence_timeout=3.0, stall_timeout=0.3)
        with browser(program, folder) as page:
            yield Watched(place, page, free_port())


def test_the_loop_goes_round_in_a_browser(watched: Watched) -> None:
    page = watched.page
    with watched.monitor():
        page.look(1280, 900, dark=False)
        page.open(f"http://127.0.0.1:{watched.port}/?token={TOKEN}")
        watched.all_there()
        assert page.evaluate("document.getElementById('play').disabled")  # not armed
        page.evaluate("document.getElementById('sequence').value = 'short'")
        page.evaluate("document.getElementById('trials').value = 2")
        page.click("armed")
        watched.play()
        before = page.evaluate(JOINT)
        assert page.evaluate("document.querySelectorAll('#tunnels .uplot').length") == 4
        page.choose("what-if-name", "gravity_load.x.moment", "change")
        watched.until(f"{MOVED}.includes('in the model')")
        page.choose("what-if-value", "-0.0125", "input")
        watched.until(f"{MOVED}.includes('instead of 0:')")
        page.choose("what-if-value", "0.0125", "input")
        watched.until(f"{MOVED}.startsWith('0.0125')")
        assert len(re.findall(r"([0-9.]+) %", str(page.evaluate(MOVED)))) == 2  # with the load, and as it is
        page.choose("what-if-name", "", "change")
        page.click("diagnose")
        watched.until("document.getElementById('adding').hidden == false && " + IDLE)
        assert "gravity load" in page.evaluate("document.getElementById('sentence').textContent")
        assert page.evaluate("document.getElementById('effect').value") == "gravity_load.x"
        page.click("add")
        watched.until("document.querySelectorAll('.step').length == 2 && " + IDLE)
        watched.play()
        watched.until("document.getElementById('joint-before').textContent != ''")
        assert page.evaluate(JOINT) > before
        left = page.evaluate("[...document.querySelectorAll('.step .bar i.error')].map(e => parseFloat(e.style.width))")
        assert left[0] == 100
        assert left[1] < 50
        fit = "document.documentElement.scrollWidth <= innerWidth"
        for width, dark in ((390, False), (390, True), (820, False), (1600, True)):
            page.look(width, 844, dark)
            assert page.until(fit)
    origins = (f"http://127.0.0.1:{watched.port}/", f"ws://127.0.0.1:{watched.port}/")
    assert [url for url in page.fetched if not url.startswith(origins)] == []
    assert [trouble for trouble in page.troubles if "/live" not in trouble] == []  # the connection ended, as it should


def test_the_page_connects_again_by_itself(watched: Watched) -> None:
    page = watched.page
    with watched.monitor():
        page.open(f"http://127.0.0.1:{watched.port}/?token={TOKEN}")
        watched.all_there()
        page.evaluate("window.same = true")
    watched.until("!document.getElementById('away').hidden")
    assert page.evaluate("document.querySelectorAll('.chip.there').length") == 0
    assert page.evaluate("document.getElementById('play').disabled")
    with watched.monitor():
        watched.until("document.getElementById('away').hidden")
        watched.all_there()
        assert page.evaluate("window.same")


def test_the_page_of_another_origin_cannot_drive_the_rig_from_a_browser(watched: Watched) -> None:
    # The same machine under its other name is another origin, as a foreign site is.
    page = watched.page
    with watched.monitor():
        page.open(f"http://localhost:{watched.port}/?token={TOKEN}")
        watched.all_there()
        attempt = f"""new Promise(done => {{ const s = new WebSocket("ws://127.0.0.1:{watched.port}/live");
            s.onopen = () => done("open"); s.onerror = () => done("refused"); }})"""
        assert page.evaluate(attempt) == "refused"


WRONG = {
    "model:=labyrinth_manuel": "labyrinth_manual",
    "candidates:=[backlsh]": "backlash",
    "token:=short": "12",
    "host:=192.0.2.1": "host:=",
    "ask_token:=maybe": "ask_token",
    "port:=99999": "65535",
    "prot:=1": "port",
}


@pytest.mark.parametrize("parameter", WRONG)
def test_wrong_parameters_end_with_code_2(
    parameter: str, domain: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    assert main(["--ros-args", "-p", "port:=0", "-p", parameter]) == 2
    assert WRONG[parameter] in capsys.readouterr().err


def test_a_rig_that_other_machines_reach_is_never_without_a_token(
    domain: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    assert main(["--ros-args", "-p", "host:=0.0.0.0", "-p", "port:=0", "-p", "ask_token:=false"]) == 2
    assert "ask_token" in capsys.readouterr().err


@pytest.mark.parametrize(("parameters", "status"), [((), 403), (("-p", "ask_token:=false"), 200)])
def test_other_programs_of_this_machine_need_the_printed_address(
    parameters: tuple[str, ...], status: int, domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with Processes(tmp_path, dict(os.environ)) as processes:
        program = executable("eps_tunnel_analysis", "monitor")
        processes.start("monitor", [program, "--ros-args", "-p", "port:=0", *parameters])
        deadline = time.monotonic() + PATIENCE
        while not (told := re.search(r"Open (http://127\.0\.0\.1:\d+/)(\S*)", processes.tail("monitor"))):
            processes.check()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        connection = HTTPConnection(told[1].split("/")[2], timeout=PATIENCE)
        for path, expected in (("/", status), (f"/{told[2]}", 200)):
            connection.request("GET", path)
            answer = connection.getresponse()
            answer.read()
            assert answer.status == expected


def test_a_port_in_use_ends_with_code_2(
    domain: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main(["--ros-args", "-p", f"port:={taken.getsockname()[1]}"]) == 2
    assert "port:=" in capsys.readouterr().err


def test_an_emulated_rig_with_an_unknown_model_ends_with_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--emulated", "--sim", "labyrinth_manuel", "--out", str(tmp_path)]) == 2
    assert "labyrinth_manual" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
