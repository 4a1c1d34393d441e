# SPDX-License-Identifier: Apache-2.0
"""A ROS 1 bag reads as the same messages in an MCAP file do; folders of bags several deep."""

from pathlib import Path

import numpy as np
import pytest
from bag_files import STORE, servo_bag
from command_line import eps_tunnel
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from eps_tunnel_analysis.inputs import bags
from eps_tunnel_analysis.recording import read
from eps_tunnel_analysis.recording.unpack import Allowance
from labyrinth_sim.errors import InputError

ROS1 = get_typestore(Stores.ROS1_NOETIC)
FORMATS = [None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4]


def as_ros1(bag: Path, file: Path, compression: Writer1.CompressionFormat | None = None) -> Path:
    """The messages of a rosbag2 folder as a recorder of ROS 1 writes them, and a topic of a type that is not read."""
    writer = Writer1(file)
    if compression:
        writer.set_compression(compression)
    with Reader(bag) as reader, writer:
        copies = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=ROS1) for c in reader.connections}
        info = writer.add_connection("/camera", "sensor_msgs/msg/CameraInfo", typestore=ROS1)
        for number, (connection, log_time, data) in enumerate(reader.messages()):
            message = STORE.deserialize_cdr(data, connection.msgtype)
            header = ROS1.types["std_msgs/msg/Header"](number, message.header.stamp, "frame")
            again = ROS1.types[connection.msgtype](
                header, message.name, message.position, message.velocity, message.effort
            )
            writer.write(copies[connection.id], log_time, ROS1.serialize_ros1(again, connection.msgtype))
        writer.write(info, log_time, b"anything")
    return file


@pytest.mark.parametrize("compression", FORMATS)
def test_a_ros1_bag_reads_as_the_same_in_mcap(tmp_path: Path, compression: Writer1.CompressionFormat | None) -> None:
    original = servo_bag(tmp_path / "bag")
    file = as_ros1(original, tmp_path / "old.bag", compression)
    with Reader1(file) as reader:
        assert reader.message_count > 300
    expected, found = read(original), read(file)
    assert found.others == {"/camera": "sensor_msgs/msg/CameraInfo"} and found.closed
    assert found.topics.keys() == expected.topics.keys() == {"/real/joint_commands", "/real/joint_states"}
    for name, topic in expected.topics.items():
        for source in ("header", "log"):
            assert np.array_equal(found.topics[name].stamps(source), topic.stamps(source))
        assert found.topics[name].columns.keys() == topic.columns.keys()
        for column, values in topic.columns.items():
            assert np.array_equal(found.topics[name].columns[column], values, equal_nan=True), column


def test_ros1_bags_are_compared_with_their_likes_and_named_by_their_folder(tmp_path: Path) -> None:
    for i in range(3):
        (tmp_path / "real").mkdir(exist_ok=True)
        as_ros1(servo_bag(tmp_path / f"bag{i}", noise=0.001 * i), tmp_path / "real" / f"run{i}.bag")
    servo_bag(tmp_path / "sim", lag=0.08, side="/sim")
    done = eps_tunnel("compare", "--real", tmp_path / "real", "--sim", tmp_path / "sim", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "3 real trials" in done.stdout
    with pytest.raises(InputError, match=r"name them one by one: run0.bag, run1.bag, run2.bag"):
        read(tmp_path / "real")


def test_a_torn_ros1_bag_and_one_that_swells_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = as_ros1(servo_bag(tmp_path / "bag"), tmp_path / "old.bag", Writer1.CompressionFormat.BZ2)
    content = file.read_bytes()
    for torn in (b"", content[:200], content[: len(content) // 2], b"no bag at all\n"):
        (tmp_path / "torn.bag").write_bytes(torn)
        with pytest.raises(InputError, match=r"torn.bag is not a complete ROS 1 bag .*rosbag reindex"):
            read(tmp_path / "torn.bag")
    monkeypatch.setattr(Allowance, "of", lambda files: Allowance(1000))
    with pytest.raises(InputError, match="becomes more than"):
        read(file)


def test_bags_three_folders_deep_are_found(tmp_path: Path) -> None:
    inside = tmp_path / "logs" / "monday" / "arm"
    inside.mkdir(parents=True)
    made = [servo_bag(inside / f"trial_{i}") for i in range(2)]
    assert bags([tmp_path / "logs"]) == made
    told = eps_tunnel("compare", "--real", tmp_path / "logs", "--sim", made[0], "--out", tmp_path / "out")
    assert told.returncode == 0, told.stderr
