# SPDX-License-Identifier: Apache-2.0
"""The demo from end to end. The longest test of all; alone: pytest test/test_demo.py"""

import json
import os
import signal
import subprocess
import time
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")

from eps_tunnel_analysis.nodes.processes import executable
from eps_tunnel_analysis.recording.reader import read
from eps_tunnel_analysis.sequence_file import find_sequence

pytestmark = pytest.mark.realtime
BELOW = ("testbed", "hw_node", "sim_node", "analysis_node", "player")


def demo(folder: Path, *options: str) -> subprocess.Popen[str]:
    command = [str(executable("eps_tunnel_analysis", "demo")), "--out", str(folder), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def children(parent: int) -> list[int]:
    """Processes that a process started and that still run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == parent and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """A whole demo of two trials with a hidden effect: its folder and what it printed to stdout and stderr."""
    out = tmp_path_factory.mktemp("demo")
    process = demo(out, "--trials", "2", "--effect", "?")
    try:
        printed, complaints = process.communicate(timeout=400)
    finally:
        process.kill()
    assert process.returncode == 0, f"{printed}\n{complaints}"
    return out / "demo-1", printed, complaints


def test_the_demo_prints_the_table_and_the_path_of_the_report(finished: tuple[Path, str, str]) -> None:
    folder, printed, _ = finished
    page = next(line for line in printed.splitlines() if "report.html" in line and line.startswith("Done"))
    path = Path(page.split(": ", 1)[1])
    assert path == (folder / "gap" / "report.html").resolve()
    assert "<svg" in path.read_text(encoding="utf-8") or "<img" in path.read_text(encoding="utf-8")
    assert "Alikeness" in printed
    for word in ("k = 1", "k = 5", "motor_x", "motor_y", "jointly"):
        assert word in printed
    assert "Hidden in the testbed:" in printed


def test_without_a_terminal_progress_is_a_line_for_each_phase(finished: tuple[Path, str, str]) -> None:
    _, _, told = finished
    assert "\r" not in told
    lines = [line.split(",")[0] for line in told.splitlines() if line.startswith("trial ")]
    assert {f"trial {n}/2 playing" for n in (1, 2)} <= set(lines)
    assert all(one != other for one, other in pairwise(lines))


def test_the_demo_leaves_one_whole_bag_per_side_with_the_trials_marked(finished: tuple[Path, str, str]) -> None:
    folder, _, _ = finished
    command = find_sequence("paper_8s").commands[0]
    for side in ("real", "sim"):
        recording = read(folder / "bags" / f"paper_8s_{side}")
        assert recording.closed
        assert recording.metadata["sequence_hash"] == command.hash
        phases = [mark.phase for mark in recording.marks]
        # On a busy machine a trial may have been begun anew.
        assert phases.count("end") == 2
        assert phases.count("start") == 2 + phases.count("aborted")
        assert {"motor_x", "motor_y", "board_x", "board_y"} <= set(recording.topics[f"/{side}/joint_states"].joints)


def test_the_report_holds_every_k_and_where_the_model_fails(finished: tuple[Path, str, str]) -> None:
    folder, _, _ = finished
    content = json.loads((folder / "gap" / "compare.json").read_text(encoding="utf-8"))
    assert [row["k"] for row in content["alikeness"]] == [1, 2, 3, 4, 5]
    shares = [row["joint"] for row in content["alikeness"]]
    assert shares == sorted(shares)
    assert content["trials_real"] == content["trials_sim"] == 2
    # The plain model's time constant of a second is far from a servo's: it must be seen to fail.
    assert content["where_in_words"]
    assert content["spans"]


def test_ctrl_c_ends_every_process_and_leaves_whole_bags(tmp_path: Path) -> None:
    process = demo(tmp_path, "--trials", "4")
    try:
        logs = tmp_path / "demo-1" / "logs" / "analysis_node.log"
        deadline = time.monotonic() + 120
        while not (logs.exists() and "Recording" in logs.read_text()):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        started = children(process.pid)
        assert len(started) == len(BELOW)
        process.send_signal(signal.SIGINT)
        _, complaints = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "Interrupted" in complaints
    assert not [pid for pid in started if Path(f"/proc/{pid}").exists()]
    for side in ("real", "sim"):
        assert read(tmp_path / "demo-1" / "bags" / f"paper_8s_{side}").closed


def test_a_process_that_dies_is_named_with_its_last_lines(tmp_path: Path) -> None:
    process = demo(tmp_path, "--hw", "no_such_rig")
    try:
        _, complaints = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 1
    assert "hw_node ended with exit code 2" in complaints
    assert "no_such_rig" in complaints


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--sequence", "nothing"], "Unknown sequence 'nothing'"),
        (["--model", "nothing"], "Unknown model 'nothing'"),
        (["--trials", "0"], "expected a whole number of at least 1"),
    ],
)
def test_bad_input_ends_the_demo_with_exit_code_2(tmp_path: Path, options: list[str], told: str) -> None:
    process = demo(tmp_path / "out", *options)
    _, complaints = process.communicate(timeout=120)
    assert process.returncode == 2
    assert told in complaints
    assert not (tmp_path / "out").exists()
    assert os.listdir(tmp_path) == []
