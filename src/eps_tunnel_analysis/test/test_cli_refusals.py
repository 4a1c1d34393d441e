# SPDX-License-Identifier: Apache-2.0
"""Bad input: every case ends with exit code 2 and names the file or the topic."""

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
from command_line import eps_tunnel, refused

from eps_tunnel_analysis.recording import BagWriter
from eps_tunnel_analysis.recording.decode import JOINT_STATE, TRIAL


def test_replay_of_no_bag_is_refused(tmp_path):
    refused("replay", tmp_path / "nothing", told=[])


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
