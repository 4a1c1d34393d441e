# SPDX-License-Identifier: Apache-2.0
"""improve --live against the emulated rig over ROS; test_experimenter.py tests the loop itself without a clock."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from short_sequence import SHORTER

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.recording.decode import read

pytestmark = pytest.mark.realtime


def started(folder: Path, *options: str) -> subprocess.Popen[str]:
    (folder / "short.yaml").write_text(SHORTER)
    command = [
        sys.executable, "-m", "eps_tunnel_analysis.cli", "improve", "--live", "--emulated", "--hide",
        "gravity_load.x=strong", "--model", "labyrinth_manual", "--sequence", str(folder / "short.yaml"), "--trials",
        "2", "--candidates", "gravity_load", "return_spring", "--out", str(folder / "notebook"), *options,
    ]  # fmt: skip
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.study
def test_the_loop_adds_what_the_rig_hides_and_writes_its_notebook(tmp_path: Path) -> None:
    process = started(tmp_path, "--json")
    try:
        printed, told = process.communicate(timeout=400)
    finally:
        process.kill()
    assert process.returncode == 0, told
    staircase = json.loads(printed)
    assert "gravity_load.x" in staircase["effects"]
    errors = [step["error"] for step in staircase["steps"]]
    assert errors[-1] < 0.5 * errors[0]
    text = (tmp_path / "notebook" / "notebook.md").read_text()
    for words in ("Played short", "Diagnosis: effect", "Added gravity load", "The end:", "What was hidden"):
        assert words in text
    assert "Simulates 'model_1' now" in (tmp_path / "notebook" / "logs" / "sim_node.log").read_text()


@pytest.mark.study
def test_ctrl_c_stops_the_rig_and_leaves_notebook_and_bags_whole(tmp_path: Path) -> None:
    process = started(tmp_path)
    log = tmp_path / "notebook" / "logs" / "analysis_node.log"
    try:
        deadline = time.monotonic() + 300
        while not (log.exists() and "Recording" in log.read_text()):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130, told
    assert "Interrupted" in (tmp_path / "notebook" / "notebook.md").read_text()
    for side in ("real", "sim"):
        assert read(tmp_path / "notebook" / "play_1" / f"short_{side}").closed


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--live"], "--arm"),
        (["--live", "--hide", "backlash"], "--hide needs --emulated"),
        (["--live", "--emulated", "--real", "some"], "--real"),
        (["--live", "--emulated", "--sequence", "nothing"], "Unknown sequence 'nothing'"),
        (["--live", "--emulated", "--candidates", "nothing"], "Unknown effect 'nothing'"),
        (["--live", "--emulated", "--hide", "friktion"], "Unknown hidden effect 'friktion'"),
        ([], "--real is missing"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, options: list[str], told: str
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")  # and given back, where the emulated rig takes one of its own
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    assert main(["improve", "--model", "labyrinth_manual", "--out", str(tmp_path / "out"), *options]) == 2
    assert told in capsys.readouterr().err
