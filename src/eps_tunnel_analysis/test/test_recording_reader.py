# SPDX-License-Identifier: Apache-2.0
"""What is read equals what was written, and what cannot be read is told by file, topic and what would be right."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_cases import SECOND, START, STORE, ball, joints, mark, write_bag
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from eps_tunnel_analysis.recording import BagWriter, read, read_all
from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE, TRIAL, decode_constant
from labyrinth_sim.errors import InputError

finite = st.floats(allow_nan=False, width=64)
names = st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9), unique=True, max_size=4)


@given(names, st.lists(st.tuples(st.integers(0, 2**31 - 1), finite), min_size=1, max_size=5), st.integers(0, 7))
def test_decoding_as_one_array_equals_decoding_message_by_message(
    joint_names: list[str], stamped: list[tuple[int, float]], present: int
) -> None:
    fields = [joint_names if present >> bit & 1 else [] for bit in range(3)]
    raws = [
        joints(stamp, joint_names, *([value + i for i in range(len(f))] for f in fields)) for stamp, value in stamped
    ]
    decoded = decode_constant(raws, JOINT_STATE, STORE)
    assert decoded is not None
    numbers, strings = decoded
    assert strings["name"] == joint_names
    for i, raw in enumerate(raws):
        message = STORE.deserialize_cdr(raw, JOINT_STATE)
        for field in ("position", "velocity", "effort"):
            assert np.array_equal(numbers[field][i], getattr(message, field))
        assert numbers["header.stamp.nanosec"][i] == message.header.stamp.nanosec


@given(st.text(st.characters(codec="ascii", exclude_characters="\0"), min_size=1, max_size=4), names)
def test_messages_of_different_layout_are_never_taken_for_one(name: str, other: list[str]) -> None:
    raws = [joints(START, [name], [1.0]), joints(START, other, [1.0] * len(other))]
    assert (decode_constant(raws, JOINT_STATE, STORE) is None) == (other != [name])


@given(st.binary(max_size=90))
def test_bytes_that_are_no_message_never_become_numbers_silently(junk: bytes) -> None:
    good = joints(START, ["motor_x"], [1.0])
    if junk[:36] != good[:36]:
        assert decode_constant([good, junk], JOINT_STATE, STORE) is None or len(junk) == len(good)


def test_all_bad_bags_are_told_at_once_and_none_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_all([tmp_path / "one", write_bag(tmp_path / "good"), tmp_path / "two", tmp_path / "one"])
    assert all(str(tmp_path / name) in text for name, text in zip(("one", "two"), caught.value.complaints, strict=True))
    with pytest.raises(InputError, match="No bags named"):
        read_all([])


def test_names_that_change_their_order_are_matched_by_name(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        writer.write("/real/joint_states", START, joints(START, ["a", "b"], [1.0, 2.0]))
        writer.write("/real/joint_states", START + 1, joints(START + 1, ["b", "a"], [4.0, 3.0]))
    columns = read(tmp_path / "bag").topics["/real/joint_states"].columns
    assert columns["a.position"].tolist() == [1.0, 3.0]
    assert columns["b.position"].tolist() == [2.0, 4.0]


def test_ball_and_joints_come_back_as_written(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/ball", BALL_STATE)
        for i in range(3):
            writer.write("/real/ball", START + i, ball(START + i, i != 1, 0.1 * i, -0.1 * i))
    topic = read(tmp_path / "bag").topics["/real/ball"]
    assert topic.columns["visible"].tolist() == [1.0, 0.0, 1.0]
    assert topic.columns["x"].tolist() == [0.0, 0.1, 0.2]
    assert topic.header_stamps is not None
    assert topic.header_stamps.tolist() == [START, START + 1, START + 2]


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.NONE),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.FILE),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
    ],
)
def test_every_storage_and_compression_reads_the_same(
    tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode
) -> None:
    original = write_bag(tmp_path / "original", seconds=0.5)
    writer = Writer(tmp_path / "copy", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with Reader(original) as reader, writer:
        copies = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=STORE) for c in reader.connections}
        for connection, log_time, data in reader.messages():
            writer.write(copies[connection.id], log_time, data)
    expected, found = read(original), read(tmp_path / "copy")
    for name, topic in expected.topics.items():
        assert np.array_equal(found.stamps(name), expected.stamps(name))
        assert np.array_equal(found.topics[name].columns["motor_x.position"], topic.columns["motor_x.position"])
    if mode in (CompressionMode.NONE, CompressionMode.STORAGE):
        file = next(f for f in (tmp_path / "copy").iterdir() if f.suffix in (".mcap", ".db3"))
        assert read(file).topics.keys() == expected.topics.keys()


def test_time_source_is_the_callers_choice(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", late=5_000_000)
    by_header, by_log = read(bag), read(bag, "log")
    for name in by_header.topics:
        assert (by_log.stamps(name) - by_header.stamps(name) == 5_000_000).all()
    with pytest.raises(InputError, match="Available time source names: header, log"):
        read(bag, "clock")  # type: ignore[arg-type]


def told(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_what_is_no_bag_is_told(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("hello", encoding="utf-8")
    (tmp_path / "zero.mcap").touch()
    (tmp_path / "zero.db3").touch()
    (tmp_path / "other.mcap").write_bytes(b"not an MCAP file, though it is called so")
    (tmp_path / "other.db3").write_bytes(b"not a database, though it is called so" * 99)
    assert "no such bag" in told(tmp_path / "missing")
    assert "no bag in this folder" in told(tmp_path / "empty")
    assert "not a bag" in told(tmp_path / "notes.txt")
    assert "is empty" in told(tmp_path / "zero.mcap")
    assert "not an MCAP file" in told(tmp_path / "other.mcap")
    for name in ("zero.db3", "other.db3"):
        assert "Expected a rosbag2 folder" in told(tmp_path / name)
    write_bag(tmp_path / "parent" / "bag_a")
    assert "name them one by one: bag_a" in told(tmp_path / "parent")
    assert "name the bag's folder" in told(tmp_path / "parent" / "bag_a" / "metadata.yaml")


def test_a_bag_without_messages_is_told(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
    assert "holds no messages" in told(tmp_path / "bag")


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_closed_bag_that_was_cut_is_refused(tmp_path: Path, share: float) -> None:
    bag = write_bag(tmp_path / "bag")
    file = bag / "bag.mcap"
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])
    assert "not a complete bag" in told(bag)


def test_a_flipped_bit_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    data = bytearray((bag / "bag.mcap").read_bytes())
    data[1500] ^= 0x10
    (bag / "bag.mcap").write_bytes(data)
    assert "not a complete bag" in told(bag)


def test_a_missing_file_of_a_bag_is_told(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    (bag / "bag.mcap").unlink()
    assert "bag.mcap" in told(bag)
    shutil.rmtree(bag)


def test_time_that_runs_backwards_is_refused_and_the_other_clock_offered(tmp_path: Path) -> None:
    stamps = START + np.arange(201) * SECOND // 100
    stamps[100:] -= SECOND // 2
    bag = write_bag(tmp_path / "bag", stamps=stamps)
    complaint = told(bag)
    assert "topic '/real/joint_states': the header time runs backwards at 1 of 200 steps" in complaint
    assert "time source 'log'" in complaint
    assert len(read(bag, "log").topics) == 2


def test_duplicate_and_missing_stamps_are_refused(tmp_path: Path) -> None:
    stamps = START + np.arange(201) * SECOND // 100
    stamps[7] = stamps[6]
    complaint = told(write_bag(tmp_path / "twice", stamps=stamps))
    assert "duplicate stamps) at 1 of 200 steps, first at message 7" in complaint
    assert "all header stamps are zero" in told(write_bag(tmp_path / "zero", stamps=np.zeros(201, dtype=np.int64)))


def test_events_may_share_a_stamp(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/trial", TRIAL)
        for phase, trial in ((0, 0), (1, 0), (0, 1), (1, 1)):
            at = START + (phase + trial) * SECOND
            writer.write("/real/trial", at, mark(at, phase, trial, 1.0))
    marks = read(tmp_path / "bag").marks
    assert [(m.phase, m.trial) for m in marks] == [("start", 0), ("end", 0), ("start", 1), ("end", 1)]


def test_a_topic_without_messages_is_told_as_such(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        writer.write("/real/joint_states", START, joints(START, ["a"], [1.0]))
        writer.flush()
        writer.add_topic("/real/ball", BALL_STATE)
    with pytest.raises(InputError, match="'/real/ball' has no messages"):
        read(tmp_path / "bag").topic("/real/ball", BALL_STATE)


def test_values_that_do_not_fit_their_joints_are_refused(tmp_path: Path) -> None:
    for folder, message in (
        ("few", joints(START, ["a", "b"], [1.0])),
        ("twice", joints(START, ["a", "a"], [1.0, 1.0])),
        ("junk", joints(START, ["a"], [1.0])[:-20]),
    ):
        with BagWriter(tmp_path / folder) as writer:
            writer.add_topic("/real/joint_states", JOINT_STATE)
            writer.write("/real/joint_states", START, message)
        assert "/real/joint_states" in told(tmp_path / folder)
