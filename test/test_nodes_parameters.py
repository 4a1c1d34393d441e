# SPDX-License-Identifier: Apache-2.0
"""What player and analysis node say to the parameters that they are started with."""

import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")

from eps_tunnel_analysis.nodes import analysis_node, player  # noqa: E402
from eps_tunnel_analysis.nodes.rig_processes import executable  # noqa: E402


def started(domain: int, name: str, *options: str) -> subprocess.CompletedProcess[str]:
    """A node with ROS options, alone on its domain, until it ends."""
    command = [str(executable("eps_tunnel_analysis", name)), "--ros-args", *options]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)


def test_without_a_rig_the_player_says_who_is_missing(domain: int) -> None:
    done = started(domain, "player", "-p", "sequence:=paper_8s", "-p", "sides:=[real]", "-p", "connect_timeout:=0.5")
    assert done.returncode == 1
    assert "Nothing subscribes to /real/joint_commands" in done.stderr


@pytest.mark.parametrize(
    ("node", "parameter", "told"),
    [
        (player, "rate:=0.1", "Parameter 'rate': expected double from 1 to 1000 [Hz], got 0.1"),
        (player, "sequense:=paper_8s", "Did you mean 'sequence'?"),
        (player, "sides:=[left]", "Unknown side 'left'"),
        (player, "sequence:=nothing", "Unknown sequence 'nothing'"),
        (analysis_node, "ks:=[1.0, 1.0]", "Parameter 'ks': expected different numbers"),
        (analysis_node, "max_gap:=text", "Parameter 'max_gap': expected double"),
    ],
)
def test_a_wrong_parameter_is_refused_with_exit_code_2(
    domain: int,
    node: ModuleType,
    parameter: str,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    before = sys.getswitchinterval()
    try:
        assert node.main(["--ros-args", "-p", parameter]) == 2
    finally:
        sys.setswitchinterval(before)
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("namespace", ["", "/rig1"])
def test_a_parameter_file_and_remapping_are_taken(domain: int, tmp_path: Path, namespace: str) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("/**/player: {ros__parameters: {sequence: paper_8s, connect_timeout: 0.5, sides: [real]}}\n")
    space = ["-r", f"__ns:={namespace}"] if namespace else []
    remapped = ["-r", f"{namespace}/real/joint_commands:=/other/targets"]
    done = started(domain, "player", "--params-file", str(file), *space, *remapped)
    assert done.returncode == 1
    assert "Nothing subscribes to /other/targets" in done.stderr
