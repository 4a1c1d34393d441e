# SPDX-License-Identifier: Apache-2.0
"""Bags are whole for every rosbag2 reader, are never overwritten, and survive the death of their recorder."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from recording_cases import START, joints, write_bag
from rosbags.highlevel import AnyReader

from eps_tunnel_analysis.recording import BagWriter, RecordingError, read, repair
from eps_tunnel_analysis.recording.decode import JOINT_STATE
from labyrinth_sim.errors import InputError

PRELUDE = """
import sys, time
from pathlib import Path
sys.path[:0] = {path!r}
from eps_tunnel_analysis.recording import BagWriter, RecordingError
from mcap.reader import make_reader
from recording_cases import joints
writer = BagWriter(Path({bag!r}), {{"sequence": "eight_seconds"}})
writer.add_topic("/real/joint_states", "sensor_msgs/msg/JointState")
"""
RECORD_FOR_EVER = (
    PRELUDE
    + """
while True:
    now = time.time_ns()
    writer.write("/real/joint_states", now, joints(now, ["motor_x"], [1.0]))
    print(now, flush=True)
    time.sleep(0.002)
"""
)
RECORD_ON_A_FULL_DISK = (
    PRELUDE
    + """
import os, resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
try:
    for i in range(100_000):
        now = time.time_ns()
        writer.write("/real/joint_states", now, joints(now, ["motor_x"] , [int.from_bytes(os.urandom(4), "big")]))
        if i % 100 == 0:
            writer.flush()
except RecordingError as error:
    print(error)
    sys.exit(7)
"""
)


def script(template: str, bag: Path) -> list[str]:
    return [sys.executable, "-c", template.format(path=[p for p in sys.path if p], bag=str(bag))]


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """A bag whose recorder was killed by SIGKILL, and the stamp of the last message that it had written."""
    bag = tmp_path_factory.mktemp("killed") / "bag"
    with subprocess.Popen(script(RECORD_FOR_EVER, bag), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = last = int(process.stdout.readline())
        while last < first + 1_700_000_000:
            last = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split()
    assert process.returncode == -signal.SIGKILL
    return bag, max([last, *(int(line) for line in rest if len(line) == len(str(last)))])


@pytest.mark.realtime
def test_a_killed_recorder_loses_at_most_the_last_second(killed: tuple[Path, int]) -> None:
    bag, last = killed
    recording = read(bag)
    stamps = recording.topics["/real/joint_states"].log_times
    assert 0 <= last - int(stamps[-1]) < 1_000_000_000
    assert not recording.closed
    assert recording.metadata["sequence"] == "eight_seconds"
    assert f"recovered {len(stamps)} messages" in recording.notes[0]


def test_reading_what_a_killed_recorder_left_changes_nothing(killed: tuple[Path, int]) -> None:
    bag, _ = killed
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    read(bag)
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before
    assert "metadata.yaml" not in before


def test_a_repaired_bag_is_whole_for_rosbags(killed: tuple[Path, int], tmp_path: Path) -> None:
    bag, _ = killed
    repair(bag, tmp_path / "clean")
    count = len(read(bag).topics["/real/joint_states"])
    with AnyReader([tmp_path / "clean"]) as reader:
        assert sum(1 for _ in reader.messages()) == count
    clean = read(tmp_path / "clean")
    assert clean.closed
    assert clean.metadata["sequence"] == "eight_seconds"


@pytest.mark.parametrize("share", [0.4, 0.6])
def test_a_file_torn_anywhere_is_read_up_to_its_last_whole_chunk(
    killed: tuple[Path, int], tmp_path: Path, share: float
) -> None:
    bag, _ = killed
    data = (bag / "bag.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[: int(len(data) * share)])
    whole = read(bag).topics["/real/joint_states"].log_times
    found = read(torn).topics["/real/joint_states"].log_times
    assert 0 < len(found) < len(whole)
    assert (found == whole[: len(found)]).all()


def test_a_torn_chunk_of_zeros_is_not_taken_for_data(killed: tuple[Path, int], tmp_path: Path) -> None:
    bag, _ = killed
    data = (bag / "bag.mcap").read_bytes()
    lost = tmp_path / "lost.mcap"
    lost.write_bytes(data[: len(data) // 2] + bytes(len(data) - len(data) // 2))
    whole = read(bag).topics["/real/joint_states"].log_times
    found = read(lost).topics["/real/joint_states"].log_times
    assert (found == whole[: len(found)]).all()
    assert len(found) < len(whole)


def test_a_full_disk_stops_the_recording_clearly_and_keeps_what_was_written(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    done = subprocess.run(script(RECORD_ON_A_FULL_DISK, bag), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 7, done.stderr
    assert "recording stopped (File too large)" in done.stdout
    assert str(bag) in done.stdout
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    assert len(read(bag).topics["/real/joint_states"]) > 100


def test_a_closed_bag_reads_the_same_through_rosbags(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", metadata={"sequence": "eight_seconds", "model": "plain"})
    ours = read(bag)
    with AnyReader([bag]) as reader:
        theirs = [
            reader.deserialize(data, c.msgtype).position[0]
            for c, _, data in reader.messages()
            if c.topic == "/real/joint_states"
        ]
    assert np.array_equal(ours.topics["/real/joint_states"].columns["motor_x.position"], theirs)
    assert ours.metadata == {"sequence": "eight_seconds", "model": "plain"}
    assert ours.closed
    assert not ours.notes


def test_the_index_of_a_closed_bag_is_right_for_the_mcap_library(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", metadata={"sequence": "eight_seconds"})
    with (bag / "bag.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(1 for _ in reader.iter_messages()) == 402
        assert {c.topic for c in summary.channels.values()} == {"/real/joint_commands", "/real/joint_states"}
        assert all(chunk.compression == "zstd" for chunk in summary.chunk_indexes)


def test_a_closed_file_without_its_folder_still_tells_its_metadata(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", metadata={"sequence": "eight_seconds"})
    assert read(bag / "bag.mcap").metadata == {"sequence": "eight_seconds"}


def test_an_existing_folder_is_never_overwritten(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    before = (bag / "bag.mcap").read_bytes()
    with pytest.raises(InputError, match="exists already"):
        BagWriter(bag)
    with pytest.raises(InputError, match="exists already"):
        repair(bag, bag)
    assert (bag / "bag.mcap").read_bytes() == before


def test_a_failing_caller_leaves_a_whole_bag(tmp_path: Path) -> None:
    def record() -> None:
        with BagWriter(tmp_path / "bag") as writer:
            writer.add_topic("/real/joint_states", JOINT_STATE)
            writer.write("/real/joint_states", START, joints(START, ["motor_x"], [1.0]))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert read(tmp_path / "bag").closed


def test_writing_to_a_topic_that_was_not_announced_lists_those_that_were(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/real/joint_states", JOINT_STATE)
        with pytest.raises(InputError, match="Did you mean '/real/joint_states'"):
            writer.write("/real/joint_state", START, b"")
        with pytest.raises(InputError, match=r"unknown.*Source the workspace"):
            writer.add_topic("/real/other", "other_msgs/msg/Other")
        with pytest.raises(InputError, match="is of type"):
            writer.add_topic("/real/joint_states", "labyrinth_msgs/msg/BallState")
        writer.add_topic("/real/other", "other_msgs/msg/Other", "float64 x\n")
    with pytest.raises(RecordingError, match="closed"):
        writer.write("/real/joint_states", START, b"")


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(RecordingError, match=os.strerror(20)):
        BagWriter(tmp_path / "file" / "bag")
