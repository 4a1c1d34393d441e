# SPDX-License-Identifier: Apache-2.0
"""The commands that are printed to be copied: they run as they stand."""

import shlex
from pathlib import Path

import pytest
from fit_cases import bag_of, plays

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.report.next_step import compare_with, next_commands

SLOW = "*slow*:drive.x.delay=0.05"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bags of two commands, one of them at another known value besides."""
    folder = tmp_path_factory.mktemp("bags")
    for name, play in zip(("a", "b", "slow_b"), plays((2.0, -3.0, -3.0), trials=1), strict=True):
        bag_of(folder / name, play.trials)
    return folder


def test_of_several_commands_the_next_comparison_takes_the_bags_of_one(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", "--real", str(folder), "--model", "labyrinth"]) == 2  # not all of them at once
    recorded = load_recorded("labyrinth", [folder], known=[SLOW])
    assert recorded.files == ((folder / "a",), (folder / "b",), (folder / "slow_b",))
    command = compare_with(recorded, [folder], "labyrinth")
    assert command == f"eps-tunnel compare --real {folder}/a --model labyrinth"
    assert not main(shlex.split(command)[1:])
    capsys.readouterr()


def test_one_command_is_compared_as_it_was_named(folder: Path) -> None:
    named = [folder / "b"]
    recorded = load_recorded("labyrinth", named)
    assert compare_with(recorded, named, "m.yaml", "gap") == (
        f"eps-tunnel compare --real {folder}/b --model m.yaml --out gap"
    )


def test_what_is_known_of_the_recordings_is_said_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow = [folder / "slow_b"]
    command = compare_with(load_recorded("labyrinth", slow, known=[SLOW]), slow, "labyrinth")
    assert command == f"eps-tunnel compare --real {folder}/slow_b --known '{SLOW}' --model labyrinth"
    assert not main(shlex.split(command)[1:])
    capsys.readouterr()
    recorded = load_recorded("labyrinth", [folder], known=[SLOW])
    _, add = next_commands(("backlash.x",), recorded, [folder], "labyrinth", Path("why"))
    assert f"--known '{SLOW}'" in add
