# SPDX-License-Identifier: Apache-2.0
"""The command line as a user meets it: real processes, real bags."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import recording_cases
from bag_files import (
    SECONDS,
    START,
    STEP,
    String,
    command,
    grid,
    joint_states,
    response,
    servo_bag,
    write_bag,
)

from eps_tunnel_analysis.recording import BagWriter, read
from eps_tunnel_analysis.recording.message_types import BALL_STATE, JOINT_STATE, TRIAL

PATHS = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2] / "labyrinth_sim")]
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([*PATHS, os.environ.get("PYTHONPATH", "")]),
    "COLUMNS": "120",
}
COMMAND = [sys.executable, "-m", "eps_tunnel_analysis.cli"]


def eps_tunnel(*arguments, cwd=None):
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, env=ENVIRONMENT, cwd=cwd, timeout=120
    )


def refused(*arguments, told):
    """Runs a command that must end with exit code 2, without a traceback, and with all of `told` on stderr."""
    result = eps_tunnel(*arguments)
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    assert not result.stdout
    for text in told:
        assert str(text) in result.stderr
    return result.stderr


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    for i in range(3):
        servo_bag(folder / "real" / f"trial_{i}", noise=0.001 * i)
    servo_bag(folder / "sim", lag=0.08, side="/sim")
    return folder


def test_a_comparison_of_bags_writes_report_tables_and_pictures(bags, tmp_path):
    result = eps_tunnel("compare", "--real", bags / "real", "--sim", bags / "sim", "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert str(tmp_path / "out" / "report.html") in result.stdout
    assert "k = 5" in result.stdout
    assert "rise, going up" in result.stdout
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "report.html", "compare.json", "alikeness.csv", "errors.csv", "where.csv", "spans.csv", "tunnel.csv",
        "tunnel_servo.svg", "tunnel_servo.png", "alikeness_over_k.svg", "alikeness_over_k.png",
    }  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == ["out"]  # nothing partial stays behind
    with (tmp_path / "out" / "tunnel.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    mean = np.array([float(row["servo_mean"]) for row in rows])
    noise = np.mean([0.001 * i * np.sin(40 * grid()) for i in range(3)], axis=0)
    assert np.allclose(mean, response(grid()) + noise, atol=1e-9)


def test_json_is_all_that_stdout_gets_and_equals_the_file(bags, tmp_path):
    result = eps_tunnel(
        "compare", "--real", bags / "real", "--sim", bags / "sim", "--json", "--k", 2, 1, "--out", tmp_path / "out"
    )
    content = json.loads(result.stdout)
    assert content == json.loads((tmp_path / "out" / "compare.json").read_text())
    assert [a["k"] for a in content["alikeness"]] == [1, 2]
    assert 0 < content["alikeness"][0]["joint"] < content["alikeness"][1]["joint"] < 1
    error = response(grid(), 0.08) - response(grid())  # but for the mean of the noise
    assert content["errors"][0]["rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.02)


def test_reality_compared_with_itself_is_alike_everywhere(bags):
    result = eps_tunnel("compare", "--real", bags / "real", "--sim", bags / "real", "--json")
    assert all(a["joint"] == 1 for a in json.loads(result.stdout)["alikeness"])


def test_help_and_version_of_every_command():
    top = eps_tunnel("--help")
    assert top.returncode == 0
    assert "compare" in top.stdout
    assert "effects" in top.stdout
    assert eps_tunnel("--version").stdout.startswith("eps-tunnel ")
    for name in re.findall(r"^    (\w[\w-]*)  ", top.stdout, flags=re.MULTILINE):
        assert eps_tunnel(name, "--help").returncode == 0


def test_effects_are_listed_and_told():
    listed = json.loads(eps_tunnel("effects", "--json").stdout)
    assert {"backlash", "command_delay"} <= {e["name"] for e in listed}
    assert listed[0]["name"] in eps_tunnel("effects").stdout
    assert "Mistaken for" in eps_tunnel("effects", "backlash").stdout
    refused("effects", "backlashh", told=["Did you mean 'backlash'?"])


def test_a_damaged_bag_is_repaired_into_a_new_one(bags, tmp_path):
    damaged = tmp_path / "damaged"
    with BagWriter(damaged) as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        for i in range(200):
            at = START + i * STEP
            writer.write("/real/joint_states", at, recording_cases.joints(at, ["servo"], [0.001 * i]))
            if i == 99:
                writer.flush()
                flushed = next(damaged.glob("*.mcap")).stat().st_size
    file = next(damaged.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: flushed + 300])
    told = refused("compare", "--real", damaged, "--sim", bags / "sim", told=["eps-tunnel repair"])
    assert str(damaged) in told
    result = eps_tunnel("repair", damaged, "--out", tmp_path / "whole")
    assert result.returncode == 0, result.stderr
    saved = len(read(tmp_path / "whole").topics["/real/joint_states"])
    assert 100 <= saved < 200
    assert f"{saved} messages saved" in result.stdout
    sound = eps_tunnel("repair", bags / "sim", "--out", tmp_path / "copy")
    assert sound.returncode == 0, sound.stderr
    assert "The bag was whole" in sound.stdout
    assert eps_tunnel("compare", "--real", bags / "real", "--sim", tmp_path / "copy").returncode == 0
    refused("repair", bags / "sim", "--out", tmp_path / "copy", told=[tmp_path / "copy", "exists"])


def test_a_camera_that_recorded_nothing_is_left_out(bags, tmp_path):
    with BagWriter(tmp_path / "real") as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        writer.add_topic("/real/ball", BALL_STATE)
        for i in range(round(SECONDS * 100) + 1):
            at = START + i * STEP
            writer.write("/real/joint_states", at, recording_cases.joints(at, ["servo"], [0.001 * i]))
    result = eps_tunnel("compare", "--real", tmp_path / "real", "--sim", bags / "sim", "--json")
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["signals"] == ["servo"]
    refused("compare", "--real", tmp_path / "real", "--sim", bags / "sim", "--signals", "ball_x", told=["/real/ball"])


def test_a_table_is_imported_and_compared(bags, tmp_path):
    rows = [f"{t:.2f},{c:.6f},{v:.6f}" for t, c, v in zip(grid(), command(grid()), response(grid()), strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,goal,angle", *rows]) + "\n")
    columns = ("--time", "t", "--command", "servo=goal", "--position", "servo=angle")
    result = eps_tunnel("import-csv", tmp_path / "log.csv", *columns, "--out", tmp_path / "bag")
    assert result.returncode == 0, result.stderr
    content = json.loads(eps_tunnel("compare", "--real", tmp_path / "bag", "--sim", bags / "sim", "--json").stdout)
    assert content["signals"] == ["servo"]
    wrong = ("--time", "time", *columns[2:])
    refused(
        "import-csv", tmp_path / "log.csv", *wrong, "--out", tmp_path / "no", told=["log.csv", "column 'time'", "goal"]
    )
    refused("import-csv", tmp_path / "log.csv", *columns, "--out", tmp_path / "bag", told=[tmp_path / "bag", "exists"])
    refused("import-csv", tmp_path / "log.csv", "--time", "t", "--position", "angle", "--out", tmp_path / "no",
            told=["JOINT=COLUMN"])  # fmt: skip


def test_replay_of_no_bag_is_refused(tmp_path):
    refused("replay", tmp_path / "nothing", told=[])


# Bad input: every case ends with exit code 2 and names the file or the topic.


def test_no_bag(bags, tmp_path):
    refused("compare", "--real", tmp_path / "nothing", "--sim", bags / "sim", told=[tmp_path / "nothing"])


def test_all_bad_bags_of_both_sides_are_told_at_once(tmp_path):
    bad = [tmp_path / name for name in ("one", "two", "three")]
    refused("compare", "--real", *bad[:2], "--sim", bad[2], told=bad)


def test_an_empty_folder(bags, tmp_path):
    (tmp_path / "empty").mkdir()
    refused("compare", "--real", tmp_path / "empty", "--sim", bags / "sim", told=[tmp_path / "empty"])


def test_a_bag_without_messages(bags, tmp_path):
    write_bag(tmp_path / "silent", {"/real/joint_states": ("sensor_msgs/msg/JointState", [])})
    refused("compare", "--real", tmp_path / "silent", "--sim", bags / "sim", told=[tmp_path / "silent", "no messages"])


def test_a_bag_cut_off_before_anything_whole(bags, tmp_path):
    bag = servo_bag(tmp_path / "cut")
    file = bag / "cut.mcap"
    file.write_bytes(file.read_bytes()[:60])
    refused("compare", "--real", bag, "--sim", bags / "sim", told=[bag])


def test_a_file_that_is_no_bag(bags, tmp_path):
    (tmp_path / "letter.mcap").write_text("Dear reader, this is no bag.")
    refused("compare", "--real", tmp_path / "letter.mcap", "--sim", bags / "sim", told=["letter.mcap"])


def test_a_bag_of_something_else(bags, tmp_path):
    write_bag(tmp_path / "talk", {"/chatter": ("std_msgs/msg/String", [(START, String(data="hello"))])})
    refused("compare", "--real", tmp_path / "talk", "--sim", bags / "sim", told=[tmp_path / "talk"])


def test_a_missing_topic(bags, tmp_path):
    bag = servo_bag(tmp_path / "mute", commands=None, states=joint_states(response(grid())))
    refused("compare", "--real", bag, "--model", "labyrinth", told=[bag, "/real/joint_commands"])


def test_a_topic_of_another_type(bags, tmp_path):
    texts = "std_msgs/msg/String", [(START + i * STEP, String(data="0.1")) for i in range(200)]
    bag = servo_bag(tmp_path / "typed", states=texts)
    told = [bag, "/real/joint_states", "std_msgs/msg/String"]
    refused("compare", "--real", bag, "--model", "labyrinth", told=told)


def test_a_missing_joint(bags, tmp_path):
    refused("compare", "--real", bags / "real", "--model", "labyrinth", told=["trial_0", "motor_x"])


def test_trials_of_different_length(bags, tmp_path):
    short = servo_bag(tmp_path / "short", seconds=1.4)
    arguments = ("compare", "--real", bags / "real" / "trial_0", short, "--sim", bags / "sim")
    refused(*arguments, told=["short", "length"])


def test_trials_of_different_sequences(bags, tmp_path):
    other = servo_bag(tmp_path / "other", commands=joint_states(0.1 * np.sin(9 * grid())))
    refused("compare", "--real", bags / "real" / "trial_0", other, "--sim", bags / "sim", told=["other", "sequence"])


def marked_bag(folder, side, sequence_hash):
    """One trial with its marks on NS/trial."""
    time, stamp = grid(), START + STEP * np.arange(201)
    with BagWriter(folder) as writer:
        for topic in ("joint_commands", "joint_states"):
            writer.add_topic(f"{side}/{topic}", JOINT_STATE)
        writer.add_topic(f"{side}/trial", TRIAL)
        writer.write(f"{side}/trial", START, recording_cases.mark(START, 0, 0, SECONDS, sequence_hash))
        for at, target, value in zip(stamp, command(time), response(time), strict=True):
            for topic, position in (("joint_commands", target), ("joint_states", value)):
                writer.write(f"{side}/{topic}", int(at), recording_cases.joints(int(at), ["servo"], [position]))
        end = int(stamp[-1])
        writer.write(f"{side}/trial", end, recording_cases.mark(end, 1, 0, SECONDS, sequence_hash))
    return folder


def test_two_sides_that_played_different_sequences(tmp_path):
    real = marked_bag(tmp_path / "real", "/real", "a" * 64)
    same, other = marked_bag(tmp_path / "same", "/sim", "a" * 64), marked_bag(tmp_path / "other", "/sim", "b" * 64)
    assert eps_tunnel("compare", "--real", real, "--sim", same).returncode == 0
    refused("compare", "--real", real, "--sim", other, told=["different sequences", "aaaaaaaaaaaa", "bbbbbbbbbbbb"])


def test_two_sides_of_different_length(bags, tmp_path):
    short = servo_bag(tmp_path / "short", seconds=1.4, side="/sim")
    refused("compare", "--real", bags / "real", "--sim", short, told=["simulation at 1.4 s"])


def stamps(change):
    """Header stamps of 201 messages, changed in the middle."""
    log = START + STEP * np.arange(201)
    log[100] += change
    return log


@pytest.mark.parametrize(
    ("change", "word"), [(-50 * STEP, "backwards"), (-STEP, "duplicate")], ids=["backwards", "duplicate"]
)
def test_stamps_that_run_backwards_or_come_twice(bags, tmp_path, change, word):
    bag = servo_bag(tmp_path / "bag", states=joint_states(response(grid()), stamps=stamps(change)))
    refused("compare", "--real", bag, "--sim", bags / "sim", told=[bag, "/real/joint_states", word])


@pytest.mark.parametrize(("value", "word"), [(np.nan, "NaN"), (np.inf, "infinite")])
def test_values_that_are_no_numbers(bags, tmp_path, value, word):
    values = response(grid())
    values[50] = value
    bag = servo_bag(tmp_path / "bag", states=joint_states(values))
    refused("compare", "--real", bag, "--sim", bags / "sim", told=[bag, "/real/joint_states", word])


def test_a_rig_that_names_a_joint_the_mjcf_lacks(bags, tmp_path):
    (tmp_path / "horn.xml").write_text(
        '<mujoco><worldbody><body><joint name="shaft"/><geom size=".01" mass="1"/></body></worldbody></mujoco>'
    )
    (tmp_path / "rig.yaml").write_text(
        "name: bare\nmjcf: horn.xml\naxes:\n  a: {command: servo, actuator: servo, joint: shaaft, "
        "measured: {servo: {joint: shaaft, quantity: position}}}\n"
    )
    (tmp_path / "model.yaml").write_text(
        f"name: bare\nrig: {tmp_path / 'rig.yaml'}\ndrives: {{a: {{kind: velocity_pid, values: {{}}}}}}\neffects: []\n"
    )
    refused("compare", "--real", bags / "real", "--model", tmp_path / "model.yaml", told=["shaaft", "shaft"])


def test_an_unknown_model_or_rig_lists_the_known_ones(bags):
    refused("compare", "--real", bags / "real", "--model", "labyrint", told=["Did you mean 'labyrinth'?"])
    arguments = ("compare", "--real", bags / "real", "--sim", bags / "sim")
    refused(*arguments, "--rig", "labyrint", told=["Did you mean 'labyrinth'?"])


def test_an_unknown_signal_lists_the_known_ones(bags):
    arguments = ("compare", "--real", bags / "real", "--sim", bags / "sim", "--signals", "servoo")
    refused(*arguments, told=["Did you mean 'servo'?"])


@pytest.mark.parametrize(
    "option", [("--k", "0"), ("--k", "nan"), ("--rate", "-5"), ("--max-gap", "x"), ("--k-sim", "inf")]
)
def test_a_senseless_number(bags, option):
    refused("compare", "--real", bags / "real", "--sim", bags / "sim", *option, told=[option[0]])


def test_an_output_folder_that_exists_is_left_as_it_is(bags, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "precious").write_text("kept")
    arguments = ("compare", "--real", bags / "real", "--sim", bags / "sim", "--out", tmp_path / "out")
    refused(*arguments, told=[tmp_path / "out", "never overwritten"])
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["precious"]


def test_a_bag_named_twice(bags):
    bag = bags / "real" / "trial_0"
    refused("compare", "--real", bag, bag, "--sim", bags / "sim", told=[bag, "twice"])


@pytest.mark.realtime
def test_ctrl_c_ends_with_130_and_leaves_nothing_behind(bags, tmp_path):
    process = subprocess.Popen(
        [*COMMAND, "compare", "--real", bags / "real", "--sim", bags / "sim", "--rate", "20000", "--out",
         tmp_path / "out"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)  # until it writes into its folder
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    assert list(tmp_path.iterdir()) == []
