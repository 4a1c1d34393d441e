# SPDX-License-Identifier: Apache-2.0
"""Bags published again, and followed live by the analysis node."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 and the built workspace: make setup")
pytest.importorskip("labyrinth_msgs", reason="needs ROS 2 and the built workspace: make setup")
sys.path.insert(0, str(Path(__file__).parent))

from nodes_under_test import Workplace, workplace

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.nodes.rig_processes import executable
from eps_tunnel_analysis.recording import BagWriter, read_trials
from eps_tunnel_analysis.recording.decode import JOINT_STATE, TRIAL, typestore
from labyrinth_msgs.msg import LiveCounters, Srg

pytestmark = pytest.mark.realtime
WORD = "std_msgs/msg/String"
STORE = typestore()
TYPES: Any = STORE.types
SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
SAMPLES = 101  # of a trial of one second


def header(stamp: int) -> Any:
    return TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](*divmod(stamp, SECOND)), "")


def bag(folder: Path, side: str, noise: float, trials: int = 2) -> Path:
    """Marked trials of a servo that follows a sine."""
    random = np.random.default_rng(len(side))
    with BagWriter(folder / f"sine_{side}") as writer:
        for topic, kind in (("joint_commands", JOINT_STATE), ("joint_states", JOINT_STATE), ("trial", TRIAL)):
            writer.add_topic(f"/{side}/{topic}", kind)
        for trial in range(trials):
            start = BEGIN + trial * 2 * SECOND
            for i in range(-30, SAMPLES + 20):
                at = start + i * SECOND // 100
                target = 0.05 * np.sin(6 * max(0, i) / 100)
                for topic, value in (("joint_commands", target), ("joint_states", target + noise * random.normal())):
                    message = TYPES[JOINT_STATE](header(at), ["servo"], np.array([value]), np.zeros(0), np.zeros(0))
                    writer.write(f"/{side}/{topic}", at, bytes(STORE.serialize_cdr(message, JOINT_STATE)))
                if i in (-1, SAMPLES - 1):
                    stamp, phase = (start, 0) if i < 0 else (start + SECOND, 1)
                    mark = TYPES[TRIAL](header(stamp), phase, "sine", "c" * 64, trial, 1.0)
                    writer.write(f"/{side}/trial", at + 1, bytes(STORE.serialize_cdr(mark, TRIAL)))
    return folder / f"sine_{side}"


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    return [bag(folder, "real", 0.002), bag(folder, "sim", 0.003)]


@pytest.fixture
def place(tmp_path: Path, domain: int) -> Iterator[Workplace]:
    with workplace(tmp_path, domain) as it:
        yield it


def replayed(place: Workplace, *arguments: object, **variables: str) -> subprocess.CompletedProcess[str]:
    """`eps-tunnel replay` to its end, with other variables of the environment."""
    command = [str(executable("eps_tunnel_analysis", "eps_tunnel")), "replay", *map(str, arguments)]
    with subprocess.Popen(
        command, env={**place.environment, **variables}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        place.until(lambda: process.poll() is not None)
        out, err = process.communicate()
    return subprocess.CompletedProcess(command, process.returncode, out, err)


def test_the_live_figures_of_replayed_bags_are_those_of_the_bags(place: Workplace, bags: list[Path]) -> None:
    told: list[Srg] = []
    counted: list[LiveCounters] = []
    place.node.create_subscription(Srg, "/srg", told.append, 100)
    place.node.create_subscription(LiveCounters, "/srg/counters", counted.append, 10)
    place.start("eps_tunnel_analysis", "analysis_node", use_sim_time=True)
    place.until(lambda: place.node.count_subscribers("/real/joint_states"))
    place.until(lambda: place.node.count_subscribers("/clock"))
    done = replayed(place, *bags, "--speed", 2, "--wait", 30)
    assert done.returncode == 0, done.stderr
    assert "Published" in done.stdout
    live = place.until(lambda: told and told[-1].trials == 2 and told[-1].samples == SAMPLES and told[-1])
    offline = compare(*(read_trials([path], signals=["servo"]).trials for path in bags))
    assert live.signals == ["servo"]
    assert live.alikeness.tolist() == [a.shares["servo"] for a in offline.alikeness]
    assert 0 < live.alikeness[0] < live.alikeness[-1]
    # The node's own clock follows /clock.
    at = place.until(lambda: counted and counted[-1].header.stamp.sec > 0 and counted[-1].header.stamp.sec)
    assert BEGIN // SECOND - 1 <= at <= BEGIN // SECOND + 4


@pytest.mark.parametrize("part", [["/real/joint_commands", "/real/joint_state"], []])
def test_what_cannot_be_replayed_is_refused(place: Workplace, bags: list[Path], part: list[str]) -> None:
    if part:
        done = replayed(place, *bags, "--topics", *part)
        assert "Did you mean '/real/joint_states'" in done.stderr
    else:
        done = replayed(place, place.folder / "nothing")
        assert "no such bag" in done.stderr
    assert done.returncode == 2


ILLEGAL = {  # name -> what is told of it
    "/a b": "/a b",
    "//x": "//x",
    "1abc": "1abc",
    "/real/1abc": "/real/1abc",
    "": "must not be empty",
    "/": "must not end with",
    "/real/{side}": "{side}",
    "/real/\x1b[2Jx": "\\x1b[2Jx",  # would clear a terminal
    "/real/joint_commands\0x": "\\x00x",  # C reads /real/joint_commands
    "/" + "long" * 100: "length",
}


def test_names_that_are_no_topics_are_refused_before_anything_is_created(
    place: Workplace, bags: list[Path], tmp_path: Path
) -> None:
    word = bytes(STORE.serialize_cdr(TYPES[WORD]("x"), WORD))
    with BagWriter(tmp_path / "odd") as writer:
        for topic in ("/fine", *ILLEGAL):
            writer.add_topic(topic, WORD)
            writer.write(topic, BEGIN, word)
    # ROS would not begin on such a domain.
    done = replayed(place, tmp_path / "odd", *bags, ROS_DOMAIN_ID="none")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr and "\x1b[2J" not in done.stderr
    complaints = [line for line in done.stderr.splitlines() if "A bag's topic" in line]
    assert len(complaints) == len(ILLEGAL), done.stderr
    assert all(any(words in line for line in complaints) for words in ILLEGAL.values())
    done = replayed(place, tmp_path / "odd", "--topics", "/fine", "--wait", 0)
    assert done.returncode == 0, done.stderr
    assert "Published 1 messages on 1 topics" in done.stdout


def test_a_rig_that_runs_gets_no_recorded_commands(place: Workplace, bags: list[Path]) -> None:
    place.start("labyrinth_sim", "sim_node")
    place.until(lambda: place.node.count_publishers("/sim/joint_states"))
    done = replayed(place, *bags, "--speed", 0.25)
    assert done.returncode == 2
    assert "/sim/joint_states is published by /sim" in done.stderr
