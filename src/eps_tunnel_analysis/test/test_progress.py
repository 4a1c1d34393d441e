# SPDX-License-Identifier: Apache-2.0
"""How far a diagnosis is, in a terminal, in a file, and for programs."""

import io
import json
import subprocess
import sys

import pytest
from command_line import eps_tunnel

from eps_tunnel_analysis import terminal
from eps_tunnel_analysis.diagnose.progress import RolloutCount, expected_rollouts
from eps_tunnel_analysis.terminal import rollout_line, rollout_progress


def test_searches_that_follow_one_another_add_up_and_never_go_back() -> None:
    seen: list[tuple[str, int, int]] = []
    count = RolloutCount(lambda what, made, of=0: seen.append((what, made, of)), 100)
    for what, made in (("axis x", 10), ("axis x", 30), ("axis y", 5), ("axis x", 20), ("axis x", 3), ("axis x", 90)):
        count(what, made)
    assert [made for _, made, _ in seen] == [10, 30, 35, 55, 58, 145]
    assert [of for _, _, of in seen] == [100, 100, 100, 100, 100, 160]  # more than expected: a little still to go
    assert all(made < of for _, made, of in seen)


def test_what_leads_so_far_is_said_with_its_search() -> None:
    said: list[str] = []
    count = RolloutCount(lambda what, made, of=0: said.append(f"{what} {made} {of}"))
    count("axis x", 10)
    count("axis y", 5, ("gravity_load.y", "backlash.y"))
    count("axis x", 30)
    assert said == ["axis x 10 0", "axis y, backlash.y + gravity_load.y so far 15 0", "axis x 35 0"]


def test_more_candidates_and_more_axes_take_longer() -> None:
    one = expected_rollouts([(5, 3)])
    assert expected_rollouts([(5, 30)]) > one
    assert expected_rollouts([(5, 3), (5, 3)]) > 2 * one  # the axes' base values are fitted in turn before


def test_a_line_tells_how_far_and_how_long() -> None:
    assert rollout_line("axis x", 500, 2000, 30.0) == "axis x: 500 of about 2,000 roll-outs in 30 s, about 90 s to go"
    assert rollout_line("check", 500, 0, 30.0) == "check: 500 roll-outs in 30 s"
    assert rollout_line("axis x", 0, 2000, 0.0) == "axis x: 0 of about 2,000 roll-outs in 0 s"


def test_without_a_terminal_a_line_comes_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: clock)
    monkeypatch.setattr(sys, "stderr", err := io.StringIO())
    with rollout_progress() as progress:
        assert progress is not None
        for second in range(65):
            clock = float(second)
            progress("axis x", 10 * second, 1000)
    lines = err.getvalue().splitlines()
    assert [line.split(":")[0] for line in lines] == ["axis x"] * 4  # at 15, 30, 45, 60 s
    assert "600 of about 1,000 roll-outs in 60 s, about 40 s to go" in lines[-1]


def test_programs_are_told_in_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", err := io.StringIO())
    with rollout_progress("lines") as progress:
        assert progress is not None
        progress("axis x", 10, 100)
    assert json.loads(err.getvalue()) == {"doing": "axis x", "rollouts": 10, "of": 100}


def test_compare_ends_with_the_next_command(bags) -> None:  # type: ignore[no-untyped-def]
    out = eps_tunnel("compare", "--real", bags / "real", "--sim", bags / "sim").stdout.splitlines()
    assert out[-2].startswith("Next: ")
    assert out[-1] == f"  eps-tunnel diagnose --real {bags / 'real'} --model MODEL --out why"


def test_the_monitor_says_that_it_starts_before_its_libraries_are_loaded() -> None:
    script = """
import subprocess
import sys
from eps_tunnel_analysis.nodes import monitor_start

class Seen(Exception): pass

class Told:
    def write(self, text):
        assert not {"rclpy", "mujoco", "tornado"} & set(sys.modules), "told late"
        raise Seen(text)
    def flush(self): pass

sys.stderr = Told()
try:
    monitor_start.main(["--emulated"])
except Seen as seen:
    print(seen)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.startswith("Starting an emulated rig"), done.stderr
