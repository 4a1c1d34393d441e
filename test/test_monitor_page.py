# SPDX-License-Identifier: Apache-2.0
"""What the page does with what it is told, in a real browser; the state is filled by hand, no rig and no ROS."""

import json
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from browser import Page, browser, chromium
from short_sequence import SHORT

from eps_tunnel_analysis.monitor.parts import (
    Connections,
    GapPart,
    Health,
    Job,
    Pose,
    RigPart,
    RunPart,
    Scene,
    Staircase,
    StaircaseStep,
    VerdictPart,
)
from eps_tunnel_analysis.monitor.requests import Request, WhatIfRequest
from eps_tunnel_analysis.monitor.server import MonitorServer
from eps_tunnel_analysis.monitor.session import Reruns
from eps_tunnel_analysis.monitor.state import State
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline

SIGNALS = ("motor_x", "board_x")
DURATION = 2.0  # s
HEALTHY = Health(received=1000, late=0, lost=0, reordered=0, duplicated=0, restarts=0, clock_jumps=0)
CHARTS = "document.querySelectorAll('#tunnels .uplot').length"


@dataclass
class Shown:
    """A page on a state."""

    state: State
    page: Page

    def play(self, trials: int, offset: float = 0.0) -> None:
        """One more trial, 0.5 s of it: the simulation is off by `offset` rad, outside from 0.25 s on."""
        self.state.trial("abc", DURATION)
        with self.state.tunnel() as table:
            table.trials = trials
            for i in range(50):
                mean = np.full(2, np.sin(i / 10))
                table.add(i / 100, SIGNALS, mean, np.full(2, -0.01), np.full(2, 0.01), mean + offset, [i < 25, i < 25])
        share = (0.5,) * 5
        ks = (1.0, 2.0, 3.0, 4.0, 5.0)
        rig = (0.2, 0.4, 0.6, 0.8, 0.9) if trials > 2 else ()
        self.state.put(GapPart("m", SIGNALS, ks, (share, share), share, rig, 50, trials, (rig, rig)))

    def until(self, script: str) -> object:
        return self.page.until(script)

    def red(self) -> int:
        """Pixels of the stripes that are red."""
        return int(self.page.evaluate("""(() => {
            const c = document.getElementById("where");
            const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
            let n = 0; for (let i = 0; i < d.length; i += 4) if (d[i] > 180 && d[i + 1] < 120 && d[i + 2] < 140) n++;
            return n; })()"""))  # fmt: skip


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    program = chromium()
    if program is None:
        pytest.skip("needs Chromium or Chrome; name it by $CHROMIUM")
    with browser(program, tmp_path_factory.mktemp("browser")) as page:
        yield page


@pytest.fixture
def shown(opened: Page) -> Iterator[Shown]:
    state = State()
    server = MonitorServer(state, "127.0.0.1", 0, "", lambda _: None, {})
    opened.look(1280, 900, dark=False)
    opened.troubles.clear()
    opened.open(server.address)
    opened.until("document.getElementById('away')?.hidden")
    yield Shown(state, opened)
    server.close()
    # The connection ends, and one test asks for what is not there.
    assert [trouble for trouble in opened.troubles if "/live" not in trouble and "/trial/9" not in trouble] == []


def test_with_one_trial_the_page_collects_and_nothing_is_red(shown: Shown) -> None:
    shown.play(1, offset=0.1)
    shown.until(f"{CHARTS} == 2")
    shown.until("document.getElementById('joint').textContent == 'collecting'")
    assert "Collecting" in str(shown.until("document.getElementById('tunnel-what').textContent"))
    assert shown.red() == 0
    shown.play(2, offset=0.1)
    shown.until("document.getElementById('joint').textContent == '50.0 %'")
    shown.until("!document.getElementById('tunnel-what').textContent.includes('Collecting')")
    assert shown.red() > 0
    assert "three trials" in shown.page.evaluate("document.getElementById('joint-rig').textContent")
    above = "document.querySelector('#tunnels .name span').textContent"
    assert shown.until(above) == "50.0 % alike"
    shown.play(3)
    shown.until("document.getElementById('joint-rig').textContent == 'the rig against itself: 20.0 %'")
    shown.until(f"{above} == '50.0 % alike, the rig against itself 20.0 %'")


def test_every_part_reaches_its_panel(shown: Shown) -> None:
    verdict = VerdictPart("effect", "The model lacks it.", ("backlash.x",), (("backlash.x", 0.97, True),), (), 0.9,
                          (0.01, 0.008, 0.001), "m", "", "", ())  # fmt: skip
    run = RunPart("excite_12s", 1, 3, "playing", 0.5, 6.0, 12.0)
    there = Connections(True, True, True, True, "labyrinth", "", True)
    rig = RigPart("arm", ("motor_x",), 1.0, None, None)
    scene = Scene(Pose({"motor_x": 0.5}, None), None)
    for part in (there, Job("play", "", 1.0), run, verdict, rig, scene):
        shown.state.put(part)
    shown.play(2)
    shown.until("document.getElementById('sentence').textContent == 'The model lacks it.'")
    shown.until("document.getElementById('job').textContent.includes('Trial 2 of 3')")
    shown.until("document.getElementById('joint').textContent == '50.0 %'")
    shown.until("document.getElementById('angles').textContent.includes('28.6')")


def test_on_a_rig_that_slides_the_page_tells_lengths(shown: Shown) -> None:
    verdict = VerdictPart("effect", "The model lacks it.", ("backlash.a",), (("backlash.a", 0.97, True),), (), 0.9,
                          (0.01, 0.008, 0.001), "m", "", "", ())  # fmt: skip
    shown.state.put(verdict)
    shown.state.put(Staircase((StaircaseStep("m", "as given", 0.01),)))
    shown.until("document.getElementById('verdict-more').textContent.includes('0.573 deg as given')")
    shown.state.put(RigPart("sledge", SIGNALS, 0.5, None, None, "m", dict.fromkeys(SIGNALS, "m")))
    shown.state.put(Scene(Pose({"motor_x": 0.1}, None), None))
    shown.until("document.getElementById('verdict-more').textContent.includes('10.000 mm as given')")
    shown.until("document.getElementById('stairs').textContent.includes('10.000 mm')")
    shown.until("document.getElementById('angles').textContent.includes('100.0 / – mm')")
    shown.play(2)
    shown.until("document.querySelector('#tunnels .name b')?.textContent == 'motor_x, mm'")


def test_late_and_lost_samples_beyond_two_percent_are_a_banner(shown: Shown) -> None:
    banner = "document.getElementById('troubled').hidden"
    shown.state.put(Health(1000, 10, 9, 0, 0, 0, 0, troubled=0.019))
    shown.until("document.getElementById('health').textContent.includes('10 late')")
    assert shown.page.evaluate(banner)
    shown.state.put(Health(1000, 20, 9, 0, 0, 0, 0, troubled=0.029))
    shown.until(f"!{banner}")
    assert "2.9 %" in shown.page.evaluate("document.getElementById('troubled').textContent")
    shown.state.put(Health(2000, 20, 9, 0, 0, 0, 0, troubled=0.0))
    shown.until(banner)


def test_dragging_zooms_every_chart_and_a_button_shows_the_whole_time_again(shown: Shown) -> None:
    shown.play(2)
    shown.until(f"{CHARTS} == 2")
    box = "document.querySelector('#tunnels .u-over').getBoundingClientRect()"
    shown.page.evaluate("document.getElementById('tunnels').scrollIntoView({block: 'center'})")
    left, top, width = shown.page.evaluate(f"[{box}.left, {box}.top + 40, {box}.width]")
    mouse = {"button": "left", "clickCount": 1, "y": top}
    for kind, x, buttons in (("mouseMoved", 0.1, 0), ("mousePressed", 0.1, 1), ("mouseMoved", 0.2, 1),
                             ("mouseReleased", 0.2, 0)):  # fmt: skip
        shown.page.command("Input.dispatchMouseEvent", type=kind, x=left + x * width, buttons=buttons, **mouse)
    shown.until("!document.getElementById('whole').hidden")
    # Values at the cursor stand above every chart.
    values = (
        "[...document.querySelectorAll('#tunnels .name span')].filter(e => e.textContent.includes('simulated')).length"
    )
    assert shown.until(f"{values} == 2")
    shown.page.click("whole")
    shown.until("document.getElementById('whole').hidden")


def test_signals_are_chosen(shown: Shown) -> None:
    shown.play(2)
    shown.until(f"{CHARTS} == 2")
    shown.page.evaluate("document.querySelector('#signals button').click()")
    shown.until(f"{CHARTS} == 1")
    assert shown.page.evaluate("document.querySelector('#tunnels .name b').textContent").startswith("board_x")
    shown.page.evaluate("document.querySelectorAll('#signals button')[1].click()")  # the last one stays
    assert shown.page.evaluate(CHARTS) == 1
    shown.page.evaluate("document.querySelector('#signals button').click()")
    shown.until(f"{CHARTS} == 2")


def test_trials_gone_by_can_be_looked_at_again_and_saved(shown: Shown, tmp_path: Path) -> None:
    shown.page.command("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path), eventsEnabled=False)
    shown.play(2, offset=0.3)
    shown.until(f"{CHARTS} == 2")
    shown.play(3, offset=0.0)
    shown.until("document.getElementById('past').max == 1")
    assert shown.page.evaluate("document.getElementById('past-word').textContent") == "now"
    for place, word, offset in ((0, "-1", 0.3), (1, "now", 0.0)):
        shown.page.evaluate(f"""(() => {{ const e = document.getElementById("past"); e.value = {place};
            e.dispatchEvent(new Event("input")); }})()""")
        shown.until(f"document.getElementById('past-word').textContent.startsWith('{word}')")
        shown.page.click("save-table")
        shown.page.click("save-picture")
        table = saved(tmp_path, "csv")
        rows = [line.split(",") for line in table.decode().splitlines()]
        assert rows[0][:6] == ["time_s", *(f"motor_x_{w}_rad" for w in ("mean", "lower", "upper", "simulated")),
                               "motor_x_model_before_rad"]  # fmt: skip
        time_s, mean, lower, _, simulated = (float(v) for v in rows[11][:5])
        assert (time_s, mean, lower) == pytest.approx((0.1, np.sin(1), np.sin(1) - 0.01), abs=1e-5)
        assert simulated - mean == pytest.approx(offset, abs=1e-5)
        assert saved(tmp_path, "png").startswith(b"\x89PNG")


def saved(folder: Path, ending: str) -> bytes:
    """The file that was downloaded, once it is whole."""
    deadline = time.monotonic() + 60
    while not (found := [f for f in folder.glob(f"*.{ending}") if f.stat().st_size]):
        assert time.monotonic() < deadline, [f.name for f in folder.iterdir()]
        time.sleep(0.05)
    time.sleep(0.2)
    content = found[0].read_bytes()
    found[0].unlink()
    return content


def test_it_fits_a_phone_and_fetches_nothing_from_elsewhere(shown: Shown) -> None:
    shown.play(3)
    shown.state.put(HEALTHY)
    shown.until(f"{CHARTS} == 2")
    for width in (360, 820, 1600):
        shown.page.look(width, 800, dark=width == 820)
        assert shown.page.until("document.documentElement.scrollWidth <= innerWidth"), width
        edge = "Math.max(...[...document.querySelectorAll('.card *')].map(e => e.getBoundingClientRect().right))"
        assert shown.page.until(f"{edge} <= {width}"), width  # charts follow the window after a moment
    own = shown.page.evaluate("location.host")
    assert [url for url in shown.page.fetched if own not in url and "127.0.0.1" not in url and "blob:" not in url] == []


def test_a_trial_that_is_not_kept_is_not_found(shown: Shown) -> None:
    shown.play(2)
    shown.until(f"{CHARTS} == 2")
    assert json.loads(shown.page.evaluate("fetch('/trial/9').then(a => JSON.stringify(a.status))")) == 404


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of the emulated rig: three trials of two seconds."""
    folder = tmp_path_factory.mktemp("played")
    (folder / "short.yaml").write_text(SHORT + "trials: 3\n")
    (command,) = find_sequence(str(folder / "short.yaml")).commands
    times, steps = command.sample(100.0)
    run = run_offline(load_testbed("healthy"), times, steps, 3, 1)
    return Path(write_bag(folder / "bag_real", run, command.name, command.hash))


def test_a_slider_moves_a_value_and_the_simulation_follows(opened: Page, played: Path) -> None:
    state = State()
    reruns = Reruns(state)

    def asked(request: Request) -> None:
        assert isinstance(request, WhatIfRequest)
        reruns.ask(request.name, request.value) if request.name else reruns.end()

    server = MonitorServer(state, "127.0.0.1", 0, "", asked, {})
    shown = Shown(state, opened)
    word, joint = "document.getElementById('what-if-word').textContent", "document.getElementById('joint').textContent"
    try:
        opened.look(1280, 900, dark=False)
        opened.troubles.clear()
        opened.open(server.address)
        opened.until("document.getElementById('away')?.hidden")
        assert opened.evaluate("document.getElementById('what-if-card').hidden")
        shown.play(3)
        opened.until(f"{CHARTS} == 2")
        reruns.use([played], "labyrinth_mx64")
        opened.until("!document.getElementById('what-if-card').hidden")
        opened.choose("what-if-name", "drive.x.p", "change")
        opened.until(f"{word}.startsWith('20 1/s in the model')")
        opened.until(f"{CHARTS} == 4")  # the four signals of the bag, instead of the two that were live
        as_it_is, red = percent(opened.evaluate(joint)), shown.red()
        assert percent(opened.evaluate(word)) == as_it_is
        assert re.search(r"; the rig against itself [0-9.]+ %$", opened.evaluate(word))
        opened.choose("what-if-value", "10", "input")
        opened.until(f"{word}.startsWith('10 1/s instead of 20')")
        opened.until("document.getElementById('joint-before').textContent.includes('labyrinth_mx64')")
        assert percent(opened.evaluate(joint)) < as_it_is - 5
        assert percent(opened.evaluate("document.getElementById('joint-before').textContent")) == as_it_is
        opened.until("document.getElementById('tunnel-what').textContent.startsWith('Simulated with')")
        deadline = time.monotonic() + 10
        while shown.red() <= red and time.monotonic() < deadline:
            time.sleep(0.05)  # the trajectories come after the words
        assert shown.red() > red
        for width in (360, 1600):
            opened.look(width, 800, dark=False)
            assert opened.until("document.documentElement.scrollWidth <= innerWidth"), width
        shown.play(3)  # what comes meanwhile does not take the picture away
        opened.choose("what-if-name", "", "change")
        opened.until(f"{CHARTS} == 2")
        opened.until(f"{joint} == '50.0 %'")
        assert opened.evaluate(word) == ""
    finally:
        server.close()
        reruns.close()
    assert [trouble for trouble in opened.troubles if "/live" not in trouble] == []


def percent(text: str) -> float:
    """The first share in a text, in %."""
    found = re.search(r"([0-9.]+) %", text)
    assert found, text
    return float(found[1])
