# SPDX-License-Identifier: Apache-2.0
"""What the testbed reads and writes: rigs as YAML, sensor lines, bags."""

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from labyrinth_hw import config
from labyrinth_hw.errors import InputError
from labyrinth_hw.sensor_protocol import SensorSample, read_sample, sentence, unpack, write_sample
from labyrinth_hw.settings import load_hardware
from labyrinth_hw.testbed.command_line import main
from labyrinth_hw.testbed.hidden import build, load_testbed

COMMANDS = "time,motor_x,motor_y\n0,0,0\n0.5,0.04,-0.03\n1.0,0,0\n1.5,0,0\n"


@pytest.mark.parametrize("name", config.names("testbed"))
def test_every_rig_file_is_valid(name: str) -> None:
    assert load_testbed(name).servo.tick > 0


@pytest.mark.parametrize("name", config.names("hw"))
def test_every_hardware_file_is_valid(name: str) -> None:
    assert {motor.name for motor in load_hardware(name).motors} == {"motor_x", "motor_y"}


def test_all_complaints_about_a_rig_come_at_once() -> None:
    content = {
        "servo": "MX-46", "quantities": {"coulom": 1.0, "play": "wide"}, "colour": "red",
        "hidden": [{"effect": "backlsh", "axis": "z"}, {"axis": "x"}, {"effect": "backlash", "strength": "huge"}],
    }  # fmt: skip
    with pytest.raises(InputError) as told:
        build(content, "bad")
    text = str(told.value)
    for hint in ("'MX-64'", "'coulomb'", "expected a number", "'backlash'", "Unknown key", "expected {effect:", "weak"):
        assert hint in text, hint


def test_hidden_effects_of_the_file_and_of_the_command_line_add_up() -> None:
    rig = build({"hidden": [{"effect": "backlash", "axis": "y", "values": {"play": 0.01}}]}, "a", ["coulomb.x=weak"])
    assert [item.name for item in rig.hidden] == ["backlash.y", "coulomb_friction.x"]
    assert rig.reality.values["play"] == (0.0, 0.01)
    assert rig.reality.values["coulomb"] == (0.03, 0.0)


def test_sensor_lines_survive_the_way_and_damage_is_noticed() -> None:
    sample = SensorSample(7, 123456, 32768, 33000, 2, 1)
    line = write_sample(sample)
    assert read_sample(line) == sample
    assert unpack(sentence("R")) == "R"
    for at in range(1, len(line) - 1):
        spoiled = bytearray(line)
        spoiled[at] ^= 0x01
        assert read_sample(bytes(spoiled)) is None, at


def test_a_bag_holds_every_topic_and_every_trial(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text(COMMANDS)
    options = [
        "--config",
        "healthy",
        "--commands",
        str(tmp_path / "c.csv"),
        "--trials",
        "2",
        "--seed",
        "4",
        "--with-ball",
    ]
    for name in ("a", "b"):
        main([*options, "--bag", str(tmp_path / name)])
    with AnyReader([tmp_path / "a"]) as first, AnyReader([tmp_path / "b"]) as second:
        counts = {topic: info.msgcount for topic, info in first.topics.items()}
        assert counts["/real/joint_states"] == counts["/real/joint_commands"] == counts["/real/ball"] == 2 * 151
        assert counts["/real/trial"] == 4
        content = [(c.topic, t, bytes(raw)) for c, t, raw in first.messages()]
        assert content == [(c.topic, t, bytes(raw)) for c, t, raw in second.messages()], "same seed, same messages"
        kind = next(c for c in first.connections if c.topic == "/real/joint_states")
        states = [first.deserialize(raw, kind.msgtype) for _, _, raw in first.messages([kind])]
    assert states[0].name == ["motor_x", "motor_y", "board_x", "board_y"]
    moved = np.array([state.position for state in states[:151]])
    assert moved[95, :2] == pytest.approx([0.04, -0.03], abs=0.003)
    assert moved[95, 2:] == pytest.approx([0.04, -0.03], abs=0.003)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("time,motor_x\n0,0\n1,0\n", "columns"),
        ("time,motor_x,motor_y\n0,0,0\n0,1,1\n", "increasing"),
        (None, "cannot be read"),
    ],
)
def test_bad_commands_end_with_code_2(tmp_path: Path, capsys, content: str | None, complaint: str) -> None:
    if content is not None:
        (tmp_path / "c.csv").write_text(content)
    with pytest.raises(SystemExit) as ended:
        main(["--config", "healthy", "--commands", str(tmp_path / "c.csv"), "--bag", str(tmp_path / "bag")])
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err


def test_nothing_is_overwritten(tmp_path: Path, capsys) -> None:
    (tmp_path / "c.csv").write_text(COMMANDS)
    (tmp_path / "bag").mkdir()
    (tmp_path / "told.json").write_text("mine")
    for option in (
        ["--bag", str(tmp_path / "bag")],
        ["--reveal", str(tmp_path / "told.json"), "--bag", str(tmp_path / "x")],
    ):
        with pytest.raises(SystemExit):
            main(["--config", "healthy", "--commands", str(tmp_path / "c.csv"), *option])
        assert "exists and is left as it is" in capsys.readouterr().err
    assert (tmp_path / "told.json").read_text() == "mine"


def test_what_is_hidden_is_revealed_in_a_file_only(tmp_path: Path, capsys) -> None:
    (tmp_path / "c.csv").write_text(COMMANDS)
    options = ["--config", "healthy", "--draw", "--seed", "3", "--reveal", str(tmp_path / "told.json"), "--trials", "1"]
    main([*options, "--commands", str(tmp_path / "c.csv"), "--bag", str(tmp_path / "bag")])
    told = json.loads((tmp_path / "told.json").read_text())
    name = told["hidden"][0]["effect"]
    assert told["hidden"][0]["values"]
    assert name not in capsys.readouterr().out
