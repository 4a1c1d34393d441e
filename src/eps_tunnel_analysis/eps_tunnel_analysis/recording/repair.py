# SPDX-License-Identifier: Apache-2.0
"""A clean copy of a bag that was never closed, or was damaged after."""

from pathlib import Path

from eps_tunnel_analysis.recording.bag import SUFFIXES, Bag, read_bag, recovered
from eps_tunnel_analysis.recording.writer import BagWriter
from labyrinth_sim.errors import InputError


def repair(bag: Path, out: Path) -> str:
    """Copies every whole chunk of `bag` into the new folder `out`; the original stays as it is.

    Returns:
        One sentence on what was saved.

    Raises:
        InputError: there is no bag, nothing whole in it, or `out` exists.
    """
    bag, out = Path(bag), Path(out)
    whole = _whole(bag)
    with BagWriter(out, whole.metadata) as writer:
        for name, topic in whole.topics.items():
            writer.add_topic(name, topic.type, topic.definition.data or None)
        messages = (
            (t, name, m) for name, raw in whole.topics.items() for t, m in zip(raw.log_times, raw.messages, strict=True)
        )
        for log_time, name, message in sorted(messages, key=lambda entry: entry[0]):
            writer.write(name, log_time, message)
    count = sum(len(raw.messages) for raw in whole.topics.values())
    return f"{out}: {count} messages saved. {whole.recovered or 'The bag was whole.'}"


def _whole(bag: Path) -> Bag:
    try:
        return read_bag(bag)
    except InputError:
        files = [bag] if bag.is_file() else sorted(file for file in bag.glob("*") if file.suffix in SUFFIXES)
        if len(files) != 1 or files[0].suffix != ".mcap":
            raise
        return recovered(bag, files[0])
