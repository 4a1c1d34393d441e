# SPDX-License-Identifier: Apache-2.0
"""Bounds on what is asked for, whole files or none, and names that are no file names."""

import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from bag_files import servo_bag
from command_line import eps_tunnel, refused
from recording_cases import SECOND, START, joints, mark
from recording_cases import write_bag as one_servo

from eps_tunnel_analysis.cli import compare_command
from eps_tunnel_analysis.inputs import Reading, load_sides
from eps_tunnel_analysis.outputs import in_file_name
from eps_tunnel_analysis.recording import BagWriter, read_trials, to_trials
from eps_tunnel_analysis.recording.decode import JOINT_STATE, TRIAL, read_all
from eps_tunnel_analysis.recording.trials import to_plays
from labyrinth_sim.config import find
from labyrinth_sim.errors import InputError
from labyrinth_sim.whole_file import write_anew, write_new


def test_a_file_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    write_anew(tmp_path / "old", "before")
    monkeypatch.setattr(os, "fsync", full)
    for write, name in ((write_new, "new"), (write_anew, "old")):
        with pytest.raises(OSError, match="No space"):
            write(tmp_path / name, "text")
    assert [file.name for file in tmp_path.iterdir()] == ["old"]
    assert (tmp_path / "old").read_text() == "before"


def test_a_new_file_overwrites_nothing_with_and_without_hard_links(tmp_path: Path, monkeypatch) -> None:
    for links in (os.link, None):
        if links is None:
            monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(OSError(1, "no links here")))
        file = tmp_path / f"file_{links is None}"
        write_new(file, "first")
        with pytest.raises(InputError, match="never overwritten"):
            write_new(file, "second")
        assert file.read_text() == "first"
    assert len(list(tmp_path.iterdir())) == 2


def test_names_become_file_names_that_differ() -> None:
    names = ("motor_x", "a/b", "a~2f~b", "../x", "..", "grün", "a b", "a.b", "A+B-1")
    files = [in_file_name(name) for name in names]
    assert files[0] == "motor_x" and len(set(files)) == len(files)
    assert not any("/" in file or file.startswith(".") for file in files)


def test_a_signal_whose_name_is_no_file_name_is_compared_and_drawn(tmp_path: Path) -> None:
    for side in ("real", "sim"):
        servo_bag(tmp_path / side, side=f"/{side}", joint="../a/b", lag=0.05 if side == "real" else 0.08)
    result = eps_tunnel("compare", "--real", tmp_path / "real", "--sim", tmp_path / "sim", "--out", tmp_path / "gap")
    assert result.returncode == 0, result.stderr
    drawn = [file for file in (tmp_path / "gap").rglob("*") if in_file_name("../a/b") in file.name]
    assert drawn and sorted(path.name for path in tmp_path.iterdir()) == ["gap", "real", "sim"]


def marked(folder: Path, duration: float, apart: float = 1.0) -> Path:
    """Two seconds of one servo, marked as a trial of `duration` s; the end mark comes `apart` s after the start."""
    with BagWriter(folder) as writer:
        for topic, kind in (("/real/joint_commands", JOINT_STATE), ("/real/joint_states", JOINT_STATE),
                            ("/real/trial", TRIAL)):  # fmt: skip
            writer.add_topic(topic, kind)
        writer.write("/real/trial", START, mark(START, 0, 0, duration))
        for i in range(200):
            at = START + i * SECOND // 100
            for topic in ("/real/joint_commands", "/real/joint_states"):
                writer.write(topic, at, joints(at, ["motor_x"], [0.01 * i]))
        end = START + round(apart * SECOND)
        writer.write("/real/trial", end, mark(end, 1, 0, duration))
    return folder


def test_a_trial_too_long_for_a_grid_is_refused_before_one_is_made(tmp_path: Path) -> None:
    bag = marked(tmp_path / "bag", 1e5)
    for read in (to_trials, to_plays):
        with pytest.raises(InputError, match=r"trial 0: .* samples; expected at most 2000000"):
            read(read_all([bag]), signals=["motor_x"])


@pytest.mark.parametrize("duration", [math.nan, math.inf, -5.0, 1e7, 1e300])
def test_a_trial_whose_length_is_no_length_is_refused(tmp_path: Path, duration: float) -> None:
    with pytest.raises(InputError, match=re.escape(f"trial 0: its marks say that it lasts {duration:g} s")):
        read_trials([marked(tmp_path / "bag", duration)])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--rate", "1e9"), "must lie between 0.1 and 100000 Hz, got 1e9"),
        (("--rate", "1e300"), "must lie between 0.1 and 100000 Hz"),
        (("--rate", "nan"), "must lie between 0.1 and 100000 Hz"),
        (("--max-gap", "1e300"), "must lie between 0.0001 and 3600 s, got 1e300"),
    ],
)
def test_senseless_rates_and_gaps_are_refused_with_their_units(words, message) -> None:
    refused("compare", "--real", "no", "--sim", "no", *words, told=[message])


@pytest.mark.parametrize("number", ["-1", "1025", "2147483648", "9" * 5000, "1.5", "two"])
@pytest.mark.parametrize(
    "line",
    ["check --real no --model no", "sweep a --real no --model no", "diagnose --real no --model no --out no",
     "calibrate --real no --model no --out no", "new-rig no --bag no --out no",
     "changes --then no --now no --model no"],
)  # fmt: skip
def test_a_senseless_number_of_threads_is_refused(line: str, number: str) -> None:
    refused(*line.split(), "--threads", number, told=["expected a whole number from 0 to 1024, got"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--speed", "1e-300"), "must lie between 0.001 and 1000 times, got 1e-300"),
        (("--most-pause", "1e300"), "must lie between 0.001 and 3600 s"),
        (("--wait", "nan"), "must lie between 0 and 3600 s"),
    ],
)
def test_a_replay_that_would_never_end_is_refused(words, message) -> None:
    refused("replay", "no", *words, told=[message])


@pytest.mark.parametrize(
    ("rate", "message"), [("1e9", "must lie between 0.1 and 100000 Hz"), ("1e5", "rows; expected at most 2000000")]
)
def test_a_table_of_commands_is_bounded(tmp_path: Path, rate: str, message: str) -> None:
    sequence = tmp_path / "long.yaml"
    sequence.write_text("initial_deg: {a: 0}\ncommand: {a: [{hold: {lasts_s: 100}}]}\n")
    refused("sequences", sequence, "--csv", tmp_path / "out.csv", "--rate", rate, told=[message])
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("error", "words"), [(MemoryError(), "out of memory"), (RecursionError(), "nested too deeply")]
)
def test_what_is_too_large_or_too_deep_is_said_in_a_sentence(monkeypatch, error, words) -> None:
    def run(_: object) -> None:
        raise error

    monkeypatch.setattr(compare_command, "run", run)
    assert refused("compare", "--real", "no", "--sim", "no", told=[words]).startswith("eps-tunnel compare: ")


def test_the_rate_is_the_rigs_own(tmp_path: Path) -> None:
    file = tmp_path / "slow.yaml"
    text = find("rigs", "horn").read_text(encoding="utf-8")
    assert "sample_time: 0.01" in text
    file.write_text(text.replace("sample_time: 0.01", "sample_time: 0.02"), encoding="utf-8")
    bag = one_servo(tmp_path / "bag", names=["joint"])
    for reading, step in (
        (Reading(rig=str(file)), 0.02),
        (Reading(rig=str(file), rate=200.0), 0.005),
        (Reading(), 0.01),
    ):
        sides = load_sides([bag], [bag], reading=reading)
        assert sides.real.step == pytest.approx(step)
        assert any(value.startswith(f"{1 / step:g} Hz") for _, value in sides.facts)


def test_a_table_in_degrees_or_ticks(tmp_path: Path) -> None:
    rows = "".join(f"{i / 100},{i},{2 * i},{i}\n" for i in range(21))
    (tmp_path / "log.csv").write_text("t,goal,angle,amps\n" + rows)
    words = ("import-csv", tmp_path / "log.csv", "--time", "t", "--command", "motor_x=goal", "--position",
             "motor_x=angle", "--effort", "motor_x=amps")  # fmt: skip
    for name, options, factor in (("deg", ["--degrees"], math.pi / 180), ("ticks", ["--scale", "0.5"], 0.5)):
        result = eps_tunnel(*words, *options, "--out", tmp_path / name)
        assert result.returncode == 0, result.stderr
        trials = read_trials([tmp_path / name]).trials
        assert np.allclose(trials.commands[0, :, 0], factor * np.arange(21))
        assert np.allclose(trials.values[0, :, 0], 2 * factor * np.arange(21))
        assert np.allclose(trials.values[0, :, 1], np.arange(21)), "efforts keep their unit"


def test_errors_of_import_csv_begin_with_its_name(tmp_path: Path) -> None:
    said = refused("import-csv", tmp_path / "none.csv", "--time", "t", "--command", "a=b", "--position", "a=c", "--out",
                   tmp_path / "bag", told=["none.csv"])  # fmt: skip
    assert said.startswith("eps-tunnel import-csv: ")


def test_replay_imports_nothing_but_installed_interfaces(tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("rclpy")
    from eps_tunnel_analysis.nodes.replay import _classes

    package = tmp_path / "evil"
    (package / "msg").mkdir(parents=True)
    (package / "__init__.py").write_text("raise SystemExit('imported')")
    (package / "msg" / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    kinds = {"/a": "evil/msg/X", "/b": "this/msg/X", "/c": "std_msgs/msg/_string", "/d": "os.path/msg/X",
             "/e": "sensor_msgs/msg/JointState"}  # fmt: skip
    classes, left_out = _classes(kinds)
    assert list(classes) == ["/e"] and len(left_out) == 4
