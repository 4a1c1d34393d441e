# SPDX-License-Identifier: Apache-2.0
"""What the page is told: the tunnel table, the staircase, the course of a session. No ROS, no browser."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fit_cases import bag_of, plays
from hypothesis import given
from hypothesis import strategies as st

from eps_tunnel_analysis.monitor.parts import Health, floor_of, rig_of
from eps_tunnel_analysis.monitor.requests import (
    AddRequest,
    ArmRequest,
    DiagnoseRequest,
    PlayRequest,
    StopRequest,
    WhatIfRequest,
)
from eps_tunnel_analysis.monitor.session import Session
from eps_tunnel_analysis.monitor.state import (
    BRIDGED,
    COLLECTING,
    PAST,
    ROW_STEP,
    RecentHealth,
    State,
    Steps,
    TunnelTable,
    plain,
)
from eps_tunnel_analysis.tasks import AddTask, run_task
from labyrinth_sim.ball import BallGame
from labyrinth_sim.build import compiled
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model

PATIENCE = 90.0  # s
SIGNALS = ("a", "b")


def add(table: TunnelTable, time: float, value: float, simulated: float = 0.0, alike: bool = True) -> None:
    two = np.array([value, -value])
    table.trials = 2
    table.add(time, SIGNALS, two, np.array([-0.1, -0.1]), np.array([0.2, 0.2]), np.full(2, simulated), [alike, True])


def rows(table: TunnelTable, seen: int = -1) -> dict[int, list[list[float | None]]]:
    changes = table.changes(seen)
    return {row: cells for row, *cells in changes["rows"]} if changes else {}


def test_a_sample_is_told_with_its_limits() -> None:
    table = TunnelTable()
    table.start("key", 1.0)
    table.revision = 1
    add(table, 0.5, 1.0, 1.5, alike=False)
    assert rows(table) == {50: [[1.0, 0.9, 1.2, 1.5, None, 0], [-1.0, -1.1, -0.8, 1.5, None, 1]]}


@given(st.lists(st.integers(0, 99), min_size=1, max_size=60), st.integers(0, 59))
def test_who_saw_some_revisions_is_told_the_others_only_and_misses_none(order: list[int], cut: int) -> None:
    table, known, seen = TunnelTable(), dict[int, Any](), -1
    table.start("key", 1.0)
    for number, row in enumerate(order, 1):
        table.revision = number
        add(table, row * ROW_STEP, float(number))
        if number == cut:
            known.update(rows(table, seen))
            seen = number
    news = rows(table, seen)
    if cut == len(order):
        assert news == {}
    known.update(news)
    assert known == rows(table)


def test_short_gaps_between_samples_are_bridged_and_long_ones_left() -> None:
    table = TunnelTable()
    table.start("key", 1.0)
    table.revision = 1
    add(table, 0.10, 0.0)
    add(table, 0.14, 4.0)
    add(table, 0.14 + (BRIDGED + 1) * ROW_STEP, 9.0)
    told = rows(table)
    assert sorted(told) == [10, 11, 12, 13, 14, 14 + BRIDGED + 1]
    assert [told[i][0][0] for i in range(10, 15)] == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_another_command_clears_the_table_and_another_trial_does_not() -> None:
    table = TunnelTable()
    table.start("one", 1.0)
    table.revision = 1
    add(table, 0.1, 1.0)
    table.revision = 2
    table.start("one", 1.0)
    assert sorted(rows(table)) == [10]
    table.start("two", 1.0)
    changes = table.changes(1)
    assert changes is not None
    assert changes["whole"]
    assert changes["rows"] == []


def test_a_new_model_leaves_what_the_old_one_did_for_comparison() -> None:
    table = TunnelTable()
    table.start("one", 1.0)
    add(table, 0.1, 1.0, simulated=7.0)
    table.revision = 3
    table.new_model()
    assert rows(table, 2)[10][0] == [1.0, 0.9, 1.2, None, 7.0, -1]


def test_a_time_far_outside_is_left_out() -> None:
    table = TunnelTable()
    table.start("one", 1.0)
    for wrong in (-1.0, 1e9, float("nan")):
        add(table, wrong, 1.0)
    assert rows(table) == {}


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -5.0, 1e300])
def test_what_makes_no_sense_is_told_as_json_all_the_same(wrong: float) -> None:
    state = State()
    state.trial("one", wrong)
    with state.tunnel() as table:
        add(table, 0.1, wrong, simulated=wrong)
    told = json.loads(json.dumps(state.changes(-1)[0], allow_nan=False))["tunnel"]
    assert told["duration"] == 0.0
    assert [row for row, *_ in told["rows"]] == [10]


def test_what_one_trial_shows_is_not_judged() -> None:
    table = TunnelTable()
    table.start("one", 1.0)
    table.trials = 1
    table.add(0.1, SIGNALS, np.zeros(2), np.zeros(2), np.zeros(2), np.ones(2), [False, False])
    assert [cell[-1] for cell in rows(table)[10]] == [COLLECTING, COLLECTING]
    add(table, 0.1, 0.0, 1.0, alike=False)
    assert [cell[-1] for cell in rows(table)[10]] == [0, 1]
    table.start("two", 1.0)
    assert table.trials == 0


def test_trials_gone_by_are_kept_as_they_were() -> None:
    state = State()
    for number in range(PAST + 3):
        state.trial("one", 1.0)  # both sides tell that it begins
        state.trial("one", 1.0)
        with state.tunnel() as table:
            add(table, 0.1, float(number))
    kept = [number for number, _ in state.changes(-1)[0]["past"]["trials"]]
    assert len(kept) == PAST
    last = state.past(kept[-1])
    assert last is not None
    assert last["rows"][0][1][0] == float(PAST + 1)  # the one before the running trial
    assert state.past(kept[0] - 1) is None


def test_samples_that_went_wrong_long_ago_trouble_nobody() -> None:
    recent = RecentHealth()

    def at(seconds: float, received: int, late: int, lost: int) -> float:
        return recent.at(seconds, Health(received, late, lost, 0, 0, 0, 0)).troubled

    assert at(0.0, 100, 50, 0) == 0.0  # nothing to compare with yet
    assert at(1.0, 196, 52, 4) == pytest.approx(0.06)
    for second in range(2, 30):
        last = at(float(second), 196 + 100 * second, 52, 4)
    assert last == 0.0
    assert at(30.0, 10, 0, 0) == 0.0  # another analysis, which counts anew


@given(
    st.recursive(st.none() | st.floats() | st.text(), lambda inner: st.lists(inner) | st.tuples(inner), max_leaves=9)
)
def test_all_that_is_told_is_json(content: Any) -> None:
    json.dumps(plain({"x": content}), allow_nan=False)


def gap(steps: Steps, share: float, samples: int = 100) -> None:
    steps.gap(["a"], [1.0, 2.0], [share, 1.0], [share, 1.0], samples, 2)


def stairs(state: State) -> list[tuple[str, str, float | None, float | None]]:
    told = state.changes(-1)[0]["staircase"]["steps"]
    return [(s["model"], s["change"], s["held_out"], s["live"]) for s in told]


def test_each_model_is_a_step_with_what_it_left() -> None:
    state = State()
    steps = Steps(state)
    assert steps.runs("m", "m.yaml", "0")
    gap(steps, 0.2)
    steps.diagnosed(0.004)
    assert not steps.runs("m", "m.yaml", "0")
    steps.announce("+ backlash.x", 0.001)
    assert steps.runs("m_1", "m_1.yaml", "1")
    gap(steps, 0.2)  # a late figure of the model before
    assert stairs(state) == [("m", "as given", 0.004, 0.2), ("m_1", "+ backlash.x", 0.001, None)]
    assert state.changes(-1)[0]["before"] == {"model": "m", "ks": [1.0, 2.0], "joint": [0.2, 1.0]}
    steps.trial_started()
    gap(steps, 0.9)
    assert steps.runs("other", "", "2")
    assert stairs(state)[1:] == [("m_1", "+ backlash.x", 0.001, 0.9), ("other", "loaded by hand", None, None)]


class Bench:
    """A session whose rig notes what it is told. What works on bags is the real thing."""

    def __init__(self, folder: Path) -> None:
        self.ready, self.playing, self.analysed = True, False, True
        self.told: list[Any] = []
        self.state = State()
        self.steps = Steps(self.state)
        self.session = Session(self.state, self.steps, self, folder, "labyrinth_manual", ("gravity_load",))

    def alive(self, side: str) -> bool:
        return True

    def play(self, sequence: str, trials: int, folder: Path) -> None:
        self.playing = True
        self.told.append(("play", sequence, trials, folder))

    def stop(self) -> None:
        self.told.append("stop")

    def load(self, model: Path) -> None:
        self.told.append(("load", model))

    def publish(self, verdict: dict[str, Any], report: str) -> None:
        self.told.append(("publish", verdict["verdict"], report))

    def do(self, request: Any) -> str:
        """Asks, looks, and returns the last entry of the log."""
        self.session.ask(request)
        self.session.look(1)
        entries = self.state.changes(-1)[0].get("log", {"entries": [[0, 0, "", ""]]})["entries"]
        return str(entries[-1][3])

    def until(self, done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < deadline
            time.sleep(0.02)
            self.session.look(1)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path / "out")


def test_nothing_moves_before_the_rig_is_armed(bench: Bench) -> None:
    assert "Arm" in bench.do(PlayRequest("paper_8s", 2))
    bench.do(ArmRequest(True))
    bench.do(PlayRequest("paper_8s", 2))
    assert [entry[:3] for entry in bench.told] == [("play", "paper_8s", 2)]
    bench.playing = False
    bench.do(ArmRequest(False))
    assert "Arm" in bench.do(PlayRequest("paper_8s", 2))


def test_one_thing_at_a_time_and_each_run_gets_a_folder_of_its_own(bench: Bench) -> None:
    bench.do(ArmRequest(True))
    bench.do(PlayRequest("paper_8s", 2))
    assert "Wait" in bench.do(PlayRequest("paper_8s", 2))
    assert "Wait" in bench.do(DiagnoseRequest())
    bench.do(StopRequest())
    bench.playing = False
    bench.do(PlayRequest("excite_12s", 0))
    folders = [entry[3] for entry in bench.told if entry != "stop"]
    assert len(set(folders)) == 2
    assert all("monitor-1" in folder.parts for folder in folders)


def test_what_cannot_be_done_is_told_with_what_to_try(bench: Bench) -> None:
    assert "Play a sequence first" in bench.do(DiagnoseRequest())
    assert "Play a sequence first" in bench.do(AddRequest(("backlash.x",)))
    bench.do(ArmRequest(True))
    assert "paper_8s" in bench.do(PlayRequest("paper_9s", 2))
    bench.ready = False
    assert "player" in bench.do(PlayRequest("paper_8s", 2))
    assert bench.told == []


def test_work_that_fails_is_told_in_the_words_of_the_command(bench: Bench, tmp_path: Path) -> None:
    bench.session.played(True, "Played.", [str(tmp_path / "no_bag_real"), str(tmp_path / "no_bag_sim")])
    bench.do(DiagnoseRequest())
    assert bench.state.changes(-1)[0]["job"]["kind"] == "diagnose"
    bench.until(lambda: bench.state.changes(-1)[0]["job"]["kind"] == "")
    _, _, level, text = bench.state.changes(-1)[0]["log"]["entries"][-1]
    assert level == "error"
    assert "no_bag_real" in text
    assert bench.told == []


@pytest.mark.parametrize("name", ["a" * 5000, "~nobody-of-this-name/x", "a\0b", "/etc/hostname"])
def test_only_what_is_offered_is_played(bench: Bench, name: str) -> None:
    bench.do(ArmRequest(True))
    assert "Unknown sequence" in bench.do(PlayRequest(name, 1))
    assert bench.told == []


def test_effects_that_are_added_are_those_of_the_library_only(bench: Bench, tmp_path: Path) -> None:
    """And no word that comes over the wire is taken for an option."""
    ran = tmp_path / "ran"
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "evil.py").write_text(f"open({str(ran)!r}, 'w')\n")
    bench.session.played(True, "Played.", [str(tmp_path / "bag_real")])
    words = ("gravity_load.y", "--effects", str(tmp_path / "mine"))
    assert "Unknown effect '--effects'" in bench.do(AddRequest(words))
    assert bench.state.changes(-1)[0]["job"]["kind"] == ""
    task = AddTask(bags=(tmp_path / "bag_real",), model="labyrinth_manual", out=tmp_path / "m.yaml", names=words)
    assert "Unknown effect '--effects'" in run_task(task, lambda _: None, lambda: False).complaint
    bags = ("--effects", str(tmp_path / "mine"))
    task = AddTask(bags=tuple(map(Path, bags)), model="labyrinth_manual", out=tmp_path / "m.yaml", names=words[:1])
    assert run_task(task, lambda _: None, lambda: False).content is None
    assert not ran.exists()


def test_a_value_is_moved_over_the_bags_of_the_last_run(bench: Bench, tmp_path: Path) -> None:
    def answer() -> dict[str, Any]:
        return dict(bench.state.changes(-1)[0]["whatif"])

    with pytest.raises(InputError, match="Play a sequence first"):
        bench.session.ask(WhatIfRequest("drive.x.p", 10.0))
    bags = [str(bag_of(tmp_path / f"{i}_real", plays((3.0,), noise=1e-3 * (i + 1))[0].trials)) for i in range(2)]
    bench.session.played(True, "Played.", bags)
    offered = {a["name"]: a for a in bench.state.changes(-1)[0]["adjustables"]["values"]}
    assert offered["drive.x.p"]["given"] == 20.0
    with pytest.raises(InputError, match="Unknown parameter"):
        bench.session.ask(WhatIfRequest("drive.x.q", 10.0))
    bench.do(WhatIfRequest("drive.x.p", None))
    bench.until(lambda: answer()["number"] == 1)
    assert (answer()["value"], answer()["before"], answer()["gap"]["trials"]) == (20.0, None, 2)
    assert answer()["gap"]["model"] == "labyrinth_manual"
    bench.do(WhatIfRequest("drive.x.p", 1.0))
    bench.until(lambda: answer()["number"] == 2)
    told, table = answer(), bench.state.what_if()
    assert table is not None
    assert told["before"]["joint"][-1] > told["gap"]["joint"][-1] + 0.2
    assert (table["number"], table["signals"], len(table["rows"])) == (2, list(told["gap"]["signals"]), 61)
    motor = table["rows"][60][1 + table["signals"].index("motor_x")]
    assert motor[3] < motor[1] - 0.005 and motor[4] == pytest.approx(motor[0], abs=0.005) and motor[5] == 0
    assert "must lie within" in complaint_after(bench, WhatIfRequest("drive.x.p", 1000.0))
    bench.do(WhatIfRequest("", None))
    assert answer()["gap"] is None and bench.state.what_if() is None
    bench.playing = True
    with pytest.raises(InputError, match="disturb"):
        bench.session.ask(WhatIfRequest("drive.x.p", 10.0))


def complaint_after(bench: Bench, request: Any) -> str:
    """The first error in the log after a request whose answer comes from another thread, soon or late."""

    def errors() -> list[list[Any]]:
        return [list(entry) for entry in bench.state.changes(-1)[0]["log"]["entries"] if entry[2] == "error"]

    before = len(errors())
    bench.do(request)
    bench.until(lambda: len(errors()) > before)
    return str(errors()[before][3])


def test_the_floor_is_that_of_the_ball_game() -> None:
    model = load_model("labyrinth")
    floor, game = floor_of(model), BallGame.of(compiled(model, with_ball=True).mj)
    assert floor is not None
    np.testing.assert_allclose(floor.holes, game.holes, atol=1e-5)
    np.testing.assert_allclose(floor.size, game.size, atol=1e-9)
    assert (floor.hole_radius, floor.ball_radius) == pytest.approx((game.hole_radius, game.ball_radius))
    assert len(floor.walls) > 40
    assert rig_of(model).tilt == ("board_x", "board_y")


@pytest.mark.parametrize("name", ["pendulum", "horn", "two_link_arm"])
def test_a_rig_without_a_ball_is_shown_by_its_axes(name: str) -> None:
    rig = rig_of(load_model(name))
    assert asdict(rig)["floor"] is None
    assert rig.axes
