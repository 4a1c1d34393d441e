# SPDX-License-Identifier: Apache-2.0
"""The commands that are printed to be copied: they run as they stand."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from command_line import eps_tunnel
from fit_cases import bag_of, plays
from small_recordings import record, write_rig

from eps_tunnel_analysis.cli.main import main, parser
from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.report.next_step import after_check, compare_with, next_commands
from labyrinth_sim.model import load_model

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


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The model of one arm, and the folder with three trials of it."""
    folder = tmp_path_factory.mktemp("arm")
    file = write_rig(folder)
    (folder / "bags").mkdir()
    for seed in range(3):
        record(load_model(file), folder / "bags" / f"run{seed}", seed=seed)
    return file, folder / "bags"


def test_a_check_ends_with_the_diagnosis_to_type(arm: tuple[Path, Path]) -> None:
    model, bags = arm
    read = ("--real", bags, "--known", "*run*:drive.a.delay=0", "--model", model)
    printed = eps_tunnel("check", *read, "--candidates", "backlash", "--threads", 1)
    assert not printed.returncode, printed.stderr
    words, command = printed.stdout.splitlines()[-2:]
    assert words == "Next: find out which physical effect the model lacks."
    assert shlex.split(command) == ["eps-tunnel", "diagnose", *map(str, read), "--out", "why"]
    assert parser().parse_args(shlex.split(command)[1:]).command == "diagnose"
    assert "begin with !" in after_check(True, [bags], str(model), None)[0]


@pytest.mark.study
def test_an_addition_ends_with_the_comparison_to_type(
    arm: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    model, bags = arm
    read = ("--real", bags, "--model", model, "--threads", 1)
    printed = eps_tunnel("add-effect", "coulomb_friction.a", *read, "--out", "better.yaml")
    assert not printed.returncode, printed.stderr
    words, command = printed.stdout.splitlines()[-2:]
    assert words == "Next: check that the gap is closed."
    assert command.split() == f"eps-tunnel compare --real {bags} --model better.yaml --out better-gap".split()
    assert not main(shlex.split(command)[1:])
    assert (tmp_path / "better-gap" / "report.html").is_file()


def test_a_designed_experiment_ends_with_its_commands_to_type(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    call = ("--for", "values", "--model", "labyrinth_mx64", "--free", "drive.x.p", "--seconds", 2, "--threads", 1)
    printed = eps_tunnel("next-experiment", *call, "--out", "next.yaml")
    assert not printed.returncode, printed.stderr
    words, command = printed.stdout.splitlines()[-2:]
    assert words.startswith("Next: play next.yaml")
    assert not main(shlex.split(command)[1:])
    assert len(np.loadtxt(tmp_path / "next.csv", delimiter=",", skiprows=1)) > 100
