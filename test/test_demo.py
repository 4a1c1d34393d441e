# SPDX-License-Identifier: Apache-2.0
"""The demo from end to end, with a short sequence and few candidates; alone: pytest test/test_demo.py"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from short_sequence import SHORTER

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.loop.gap import Gap
from eps_tunnel_analysis.nodes.demo import _fall as fall
from eps_tunnel_analysis.nodes.demo import main as run_demo
from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.outputs import shown_share
from eps_tunnel_analysis.recording.decode import read
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_sim.model import load_model
from labyrinth_sim.trials import Trials

pytestmark = pytest.mark.realtime
FEW = ("--candidates", "gravity_load", "return_spring")
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
    """A whole demo of two trials and again two: its folder and what it printed to stdout and stderr."""
    out = tmp_path_factory.mktemp("demo")
    (out / "short.yaml").write_text(SHORTER)
    short = ("--sequence", str(out / "short.yaml"), "--trials", "2")
    process = demo(out, *short, *FEW, "--effect", "gravity_load.x=strong", "--seed", "3")
    try:
        printed, complaints = process.communicate(timeout=400)
    finally:
        process.kill()
    assert process.returncode == 0, f"{printed}\n{complaints}"
    return out / "demo-1", printed, complaints


def test_the_fall_is_told_beside_what_the_rig_reaches_against_itself() -> None:
    real = np.random.default_rng(1).normal(0.0, 1e-3, (3, 100, 1))
    gaps = [Gap(compare(trials(real), trials(np.full((1, 100, 1), off))), (), 0.0) for off in (0.02, 0.0)]
    assert gaps[1].itself > 0
    assert fall(*gaps).endswith(f"; the rig against itself reaches {shown_share(gaps[1].itself)}.")


def trials(values: np.ndarray) -> Trials:
    """Of one signal without a command."""
    none = np.zeros((*values.shape[:2], 0))
    return Trials(np.arange(values.shape[1]) * 0.01, ("motor_x",), ("rad",), values, (), none)


@pytest.mark.study
def test_the_demo_prints_the_table_and_the_path_of_the_report(finished: tuple[Path, str, str]) -> None:
    folder, printed, _ = finished
    page = next(line for line in printed.splitlines() if "report.html" in line and line.startswith("Done"))
    path = Path(page.split(": ", 1)[1])
    assert path == (folder / "report.html").resolve()
    told = path.read_text(encoding="utf-8")
    for word in ("gravity load", "The loop", "Where it failed", "Why", "The gap afterwards"):
        assert word in told
    for word in ("Alikeness", "k = 1", "k = 5", "motor_x", "motor_y", "jointly", "Hypotheses", "Before and after"):
        assert word in printed


@pytest.mark.study
def test_the_demo_names_what_it_hid_adds_it_and_the_error_falls(finished: tuple[Path, str, str]) -> None:
    folder, printed, _ = finished
    assert "Hidden in the testbed: gravity_load on x (strong). Right." in printed
    assert "the error fell by" in printed
    verdict = json.loads((folder / "diagnosis_1" / "diagnosis.json").read_text(encoding="utf-8"))
    assert (verdict["verdict"], verdict["effects"]) == ("effect", ["gravity_load.x"])
    assert [use.effect.name for use in load_model(folder / "model_1.yaml").effects] == ["gravity_load"]
    before, after = (
        json.loads((folder / gap / "compare.json").read_text(encoding="utf-8")) for gap in ("gap_1", "gap_2")
    )
    errors = [{e["signal"]: e["command_error"] for e in content["errors"]} for content in (before, after)]
    assert errors[1]["board_x"] < 0.5 * errors[0]["board_x"]
    assert "Simulates 'model_1' now" in (folder / "logs" / "sim_node.log").read_text()


@pytest.mark.study
def test_without_a_terminal_progress_is_a_line_for_each_phase(finished: tuple[Path, str, str]) -> None:
    _, _, told = finished
    assert "\r" not in told
    lines = [line.split(",")[0] for line in told.splitlines() if line.startswith("trial ")]
    assert {f"trial {n}/2 playing" for n in (1, 2)} <= set(lines)
    assert all(one != other for one, other in pairwise(lines))


@pytest.mark.study
def test_the_demo_leaves_one_whole_bag_per_side_with_the_trials_marked(finished: tuple[Path, str, str]) -> None:
    folder, _, _ = finished
    command = find_sequence(str(folder.parent / "short.yaml")).commands[0]
    for play, side in product(("play_1", "play_2"), ("real", "sim")):
        recording = read(folder / play / f"short_{side}")
        assert recording.closed
        assert recording.metadata["sequence_hash"] == command.hash
        phases = [mark.phase for mark in recording.marks]
        # On a busy machine a trial may have been begun anew.
        assert phases.count("end") == 2
        assert phases.count("start") == 2 + phases.count("aborted")
        assert {"motor_x", "motor_y", "board_x", "board_y"} <= set(recording.topics[f"/{side}/joint_states"].joints)


@pytest.mark.study
def test_the_report_holds_every_k_and_where_the_model_fails(finished: tuple[Path, str, str]) -> None:
    folder, _, _ = finished
    content = json.loads((folder / "gap_1" / "compare.json").read_text(encoding="utf-8"))
    assert [row["k"] for row in content["alikeness"]] == [1, 2, 3, 4, 5]
    shares = [row["joint"] for row in content["alikeness"]]
    assert shares == sorted(shares)
    assert content["trials_real"] == content["trials_sim"] == 2
    # The board hangs to one side, and the plain model's does not: it must be seen to fail.
    assert content["where_in_words"]
    assert content["spans"]


def test_ctrl_c_ends_every_process_and_leaves_whole_bags(tmp_path: Path) -> None:
    process = demo(tmp_path)
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
        assert read(tmp_path / "demo-1" / "play_1" / f"excite_12s_{side}").closed


def test_a_process_that_dies_is_named_with_its_last_lines(tmp_path: Path) -> None:
    process = demo(tmp_path, "--hw", "no_such_rig")
    try:
        _, complaints = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 1
    assert "hw_node ended with exit code 2" in complaints
    assert "no_such_rig" in complaints


@pytest.fixture
def own_ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What the demo sets for its whole process is given back."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def refused(*options: str) -> int | str | None:
    """The exit code of the demo, called in this process: to start Python takes longer than to refuse."""
    try:
        return run_demo(options)
    except SystemExit as end:  # argparse
        return end.code


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--sequence", "nothing"], "Unknown sequence 'nothing'"),
        (["--model", "nothing"], "Unknown model 'nothing'"),
        (["--trials", "0"], "expected a whole number of at least 1"),
        (["--candidates", "nothing"], "Unknown effect 'nothing'"),
    ],
)
@pytest.mark.usefixtures("own_ros")
def test_bad_input_ends_the_demo_with_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], told: str
) -> None:
    assert refused("--out", str(tmp_path / "out"), *options) == 2
    assert told in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


@pytest.mark.usefixtures("own_ros")
def test_an_effect_that_the_testbed_does_not_know_ends_the_demo_with_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused("--out", str(tmp_path), "--effect", "friktion") == 2
    complaints = capsys.readouterr().err
    assert "Unknown hidden effect 'friktion'" in complaints
    assert "coulomb_friction" in complaints
