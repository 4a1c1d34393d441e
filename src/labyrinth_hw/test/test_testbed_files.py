# SPDX-License-Identifier: Apache-2.0
"""What the testbed reads and writes: rigs as YAML, sensor lines, bags."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from labyrinth_hw import config
from labyrinth_hw.errors import InputError
from labyrinth_hw.sensors import SensorSample, read_sample, sentence, unpack, write_sample
from labyrinth_hw.settings import load_hardware
from labyrinth_hw.testbed.command_line import main
from labyrinth_hw.testbed.hidden import TestbedConfig, TestbedFile, build, load_testbed


def rig_of(content: dict, effects: list[str]) -> TestbedConfig:
    return build(TestbedFile.model_validate(content), "a", effects)


COMMANDS = "time,motor_x,motor_y\n0,0,0\n0.5,0.04,-0.03\n1.0,0,0\n1.5,0,0\n"


@pytest.mark.parametrize("name", config.names("testbed"))
def test_every_rig_file_is_valid(name: str) -> None:
    assert load_testbed(name).servo.tick > 0


@pytest.mark.parametrize("name", config.names("hw"))
def test_every_hardware_file_is_valid(name: str) -> None:
    assert {motor.name for motor in load_hardware(name).motors} == {"motor_x", "motor_y"}


BAD_RIG = """
servo: MX-46
quantities: {coulom: 1.0, play: wide, p: {x: 1, z: 3}, d: true}
colour: red
hidden:
  - {effect: backlsh, axis: z}
  - {axis: x}
  - {effect: backlash, strength: huge}
  - backlash
"""
BAD_HARDWARE = """
servo_port: {path: servos}
motors:
  motor_x: {id: one, model: MX-46, sgn: 1}
  motor_y: {id: true, model: XL330-M077, operating_mode: curent}
limits:
  motor_x: {angle: 3}
camera: {source: 0, size: [640]}
compensation: {motor_x: {angles_deg: [1, 0], errors_deg: [0, 0]}}
"""


@pytest.mark.parametrize(
    ("text", "load", "complaints"),
    [
        (
            BAD_RIG,
            load_testbed,
            (
                "line 2, servo: Unknown servo model 'MX-46'. Did you mean 'MX-64'?",
                "line 3, quantities.coulom: Unknown quantity 'coulom'. Did you mean 'coulomb'?",
                "line 3, quantities.play: expected a number",
                "line 3, quantities.p.z: Unknown key 'z'",
                "line 3, quantities.d: expected a number",
                "line 4, colour: Unknown key",
                "line 6, hidden.0: Unknown hidden effect 'backlsh'. Did you mean 'backlash'?",
                "line 7, hidden.1.effect is missing",
                "line 8, hidden.2: Unknown strength 'huge'",
                "line 9, hidden.3: expected the keys effect, axis, strength, values, got 'backlash'",
            ),
        ),
        (
            BAD_HARDWARE,
            load_hardware,
            (
                "line 2, servo_port.baud is missing. Keys there: path, baud.",
                "line 4, motors.motor_x.id: expected a valid integer",
                "line 4, motors.motor_x.model: Unknown servo model 'MX-46'. Did you mean 'MX-64'?",
                "line 4, motors.motor_x.sgn: Unknown key 'sgn'. Did you mean 'sign'?",
                "line 5, motors.motor_y.id: expected a number, got True",
                "line 5, motors.motor_y.operating_mode: expected 'current',",
                "line 7, limits.motor_x.angle: Unknown key 'angle'. Did you mean 'angle_deg'?",
                "line 8, camera.size.1 is missing",
                "line 9, compensation.motor_x: The angles of the error map must increase.",
            ),
        ),
    ],
    ids=["testbed", "hw"],
)
def test_all_complaints_about_a_file_come_at_once_with_their_places(
    tmp_path: Path, text: str, load: Callable, complaints: tuple[str, ...]
) -> None:
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(InputError) as refused:
        load(tmp_path / "bad.yaml")
    for complaint in complaints:
        assert complaint in str(refused.value), complaint


SERVO_PORT = "servo_port: {path: servos, baud: 57600}\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("motors: {motor_x: {id: 1, model: MX-64}, motor_y: {id: 1, model: MX-64}}", "an id of its own"),
        ("motors: {motor_x: {id: 1, model: MX-64}}\nlimits: {motor_z: {}}", "'motor_z' is no motor of this file"),
        ("motors: {motor_x: {id: 1, model: MX-64}}\nsensor_port: {path: a, baud: 9600}", "the sensor line has two"),
        ("motors: {motor_x: {id: 1, model: MX-64, operating_mode: position}}", "MX-64 has none"),
        ("motors: {motor_x: {id: 1, model: XL430-W250, operating_mode: current_based_position}}", "no current"),
        ("motors: {motor_x: {id: 1, model: MX-64}}\nlayout: esy", "Unknown layout 'esy'"),
    ],
)
def test_what_contradicts_itself_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "bad.yaml").write_text(SERVO_PORT + text)
    with pytest.raises(InputError, match=complaint):
        load_hardware(tmp_path / "bad.yaml")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a: &x [*x]", "nested deeper than 20 levels"),
        ("a: " + 400_000 * "[", "line 1: nested deeper than 20 levels"),
        ("a0: &a0 [1]\n" + "\n".join(f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 9)), "20000"),
        ("servo: MX-64\nservo: MX-106", "line 2: 'servo' is there twice"),
        ("1: 2", "expected keys that are strings, got 1"),
        ("servo: 2020-99-99", "not a YAML file"),
        ("[1]", "expected a mapping"),
        ("# " + 1_000_000 * "x", "larger than"),
    ],
    ids=["itself", "deep", "aliases", "twice", "number", "date", "list", "large"],
)
def test_files_that_are_no_rig_are_refused_with_a_sentence(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(InputError, match=complaint):
        load_testbed(tmp_path / "bad.yaml")


def test_hidden_effects_of_the_file_and_of_the_command_line_add_up() -> None:
    rig = rig_of({"hidden": [{"effect": "backlash", "axis": "y", "values": {"play": 0.01}}]}, ["coulomb.x=weak"])
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


@pytest.mark.parametrize(
    ("table", "options", "complaint"),
    [
        (COMMANDS, ["--trials", str(2**64)], "expected 1 to 10000 trials"),
        (COMMANDS, ["--trials", "0"], "expected 1 to 10000 trials"),
        (COMMANDS, ["--trials", "1", "--seed", "-1"], "--seed -1: expected a whole number from 0"),
        (COMMANDS + "1e300,0,0\n", [], "the commands last 1e+300 s; expected at most 14400 s"),
    ],
)
def test_bags_out_of_all_bounds_are_refused(
    tmp_path: Path, capsys, table: str, options: list[str], complaint: str
) -> None:
    (tmp_path / "c.csv").write_text(table)
    with pytest.raises(SystemExit) as ended:
        main(["--config", "healthy", "--commands", str(tmp_path / "c.csv"), "--bag", str(tmp_path / "bag"), *options])
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("name", ["x" * 5000, "~nobody-of-this-name/x", "", "/dev/zero"])
def test_a_name_that_no_file_can_have_is_unknown(tmp_path: Path, capsys, name: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--config", name, "--commands", "no", "--bag", str(tmp_path / "bag")])
    assert ended.value.code == 2
    assert "Unknown testbed file" in capsys.readouterr().err


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


FULL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
from labyrinth_hw.testbed.command_line import main
main(sys.argv[1:])
"""


def test_on_a_full_disk_nothing_is_left_of_a_bag(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text(COMMANDS)
    options = ["--config", "healthy", "--seed", "1", "--commands", str(tmp_path / "c.csv"), "--trials", "1"]
    told = ["--reveal", str(tmp_path / "told.json")]
    command = [sys.executable, "-c", FULL, *options, *told, "--bag", str(tmp_path / "bag")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert "bag cannot be written: File too large. Nothing is left of it." in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["c.csv"]
