# SPDX-License-Identifier: Apache-2.0
"""What every node answers to words that it does not understand, to --help, and to a wrong goal: one clear line."""

import os
import subprocess
from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")

from eps_tunnel_analysis.nodes import analysis_node
from eps_tunnel_analysis.nodes.rig_processes import executable

NODES = {
    "sim_node": ("labyrinth_sim", "sim_node"),
    "hw_node": ("labyrinth_hw", "hw_node"),
    "controller_forwarder": ("labyrinth_hw", "controller_forwarder"),
    "player": ("eps_tunnel_analysis", "player"),
    "analysis_node": ("eps_tunnel_analysis", "analysis_node"),
    "calibrate_node": ("eps_tunnel_analysis", "calibrate_node"),
    "monitor": ("eps_tunnel_analysis", "monitor_node"),
}


def ended(name: str, *words: str) -> int:
    package, module = NODES[name]
    with pytest.raises(SystemExit) as ending:
        raise SystemExit(import_module(f"{package}.nodes.{module}").main(list(words)))
    return int(ending.value.code or 0)


@pytest.mark.parametrize("name", NODES)
def test_help_says_what_the_node_is_for(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(name, "--help") == 0
    out = capsys.readouterr().out
    assert name in out
    assert "--ros-args" in out


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--ros-args", "-p", "model"], "parameter override rule: '-p model'"),
        (["--ros-args", "--params-file", "/no/such/file"], "'--params-file /no/such/file'"),
        (["--ros-args", "--modle"], "--modle"),
        (["modle:=labyrinth"], "modle:=labyrinth"),
    ],
)
def test_words_that_nobody_understands_are_refused_in_one_line(
    name: str, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(name, *words) == 2
    error = capsys.readouterr().err
    assert told in error.splitlines()[-1]
    assert "Traceback" not in error
    assert ".c:" not in error.splitlines()[-1]


@pytest.mark.parametrize("name", NODES)
def test_a_misspelt_parameter_is_refused(name: str, domain: int) -> None:
    package = NODES[name][0]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    command = [str(executable(package, name)), "--ros-args", "-p", "no_such_parameter:=1"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2, done.stderr
    assert "no_such_parameter" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_goal_that_is_no_task_is_refused_with_what_is_wrong_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    works: list[Callable[[Any], None]] = []
    told: list[tuple[bool, str]] = []
    goals = SimpleNamespace(settle=lambda handle, success: None)
    monkeypatch.setattr(analysis_node, "OneGoal", lambda *given: works.append(given[-1]) or goals)
    node = SimpleNamespace(create_publisher=lambda *_: None, say=lambda *said: told.append(said))
    analysis_node.DiagnoseServer(cast(Any, node))
    goal = SimpleNamespace(bags=[], model=7, out="out", seed=0, candidates=[])
    works[0](SimpleNamespace(request=goal, execute=lambda finish: finish(None)))
    assert told == [(False, "model: Input should be a valid string, got 7.")]
