# SPDX-License-Identifier: Apache-2.0
"""A bag of the testbed that lost a bit is refused, or reads as if it had not."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from eps_tunnel_analysis.recording import Recording, read
from labyrinth_hw.testbed import load_layout, load_testbed, run_offline, write_bag
from labyrinth_sim.errors import InputError

FLIPS = 100
TIME = np.arange(0.0, 0.5, 0.01)


def content(recording: Recording) -> dict[str, object]:
    """Everything that a reader hands on, in a form that can be compared; topics without a message hold nothing."""
    topics = {
        name: (
            topic.type,
            topic.log_times.tolist(),
            None if topic.header_stamps is None else topic.header_stamps.tolist(),
            {key: column.tobytes() for key, column in topic.columns.items()},
        )
        for name, topic in recording.topics.items()
        if len(topic)
    }
    return {"topics": topics, "marks": recording.marks, "metadata": dict(recording.metadata)}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    commands = 0.03 * np.column_stack([np.sin(8 * TIME), np.cos(5 * TIME)])
    run = run_offline(load_testbed("healthy"), TIME, commands, 2, 3, load_layout("medium"))
    return write_bag(tmp_path_factory.mktemp("whole") / "bag", run, "short", "0" * 64)


def test_one_flipped_bit_is_refused_or_changes_nothing(bag: Path, tmp_path: Path) -> None:
    whole = content(read(bag))
    files = sorted(file.relative_to(bag) for file in bag.iterdir())
    sizes = np.array([(bag / file).stat().st_size for file in files])
    rng = np.random.default_rng(22)
    refused = 0
    for k in range(FLIPS):
        which = int(rng.choice(len(files), p=sizes / sizes.sum()))
        at, bit = int(rng.integers(sizes[which])), int(rng.integers(8))
        copy = tmp_path / f"bag{k}" / bag.name
        shutil.copytree(bag, copy)
        data = bytearray((copy / files[which]).read_bytes())
        data[at] ^= 1 << bit
        (copy / files[which]).write_bytes(data)
        try:
            seen = content(read(copy))
        except InputError:
            refused += 1
        else:
            assert seen == whole, f"bit {bit} of byte {at} of {files[which]} reads as other data"
    assert refused > FLIPS / 4, "most of the file is messages, so most flips must be noticed"


def test_chunks_data_and_summary_carry_checksums(bag: Path) -> None:
    with (bag / "bag.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) > 4 * len(TIME)
        assert len(reader.get_summary().chunk_indexes) >= 1
    data = (bag / "bag.mcap").read_bytes()
    footer = data[-8 - 20 :]
    assert footer[16:20] != bytes(4), "of the summary"
    end = int.from_bytes(footer[:8], "little")
    assert data[end - 13 : end - 4] == b"\x0f" + (4).to_bytes(8, "little")
    assert data[end - 4 : end] != bytes(4), "of the data section"
