# SPDX-License-Identifier: Apache-2.0
"""The validity region of a model that was compared with recordings, for its file."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from eps_tunnel_analysis.calibration.calibrate import judge
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording.bag import read_bag
from eps_tunnel_analysis.simulated import Diverged, roll_out
from eps_tunnel_analysis.valid import ranges
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model
from labyrinth_sim.validity import Validity
from labyrinth_sim.yaml_file import read_yaml

FIRST_YEAR = 2000  # of the calendar; clocks that show less count from when a device was switched on


def validity_of(
    model: Model, plays: Sequence[Play], held: Sequence[Play], bags: Sequence[tuple[Path, str]]
) -> Validity | None:
    """Where a model was shown to hold.

    Args:
        plays, held: what was fitted, and what was not; the errors are those of the latter if there are any.
        bags: path and SHA-256 of each recording.

    Returns:
        None if the simulation diverges on one of them.
    """
    every = [*plays, *held]
    try:
        spans = ranges([play.trials for play in every], [roll_out(model, play) for play in every])
    except Diverged:
        return None
    for score in judge(model, held or plays):
        if score.signal in spans:
            spans[score.signal] = replace(spans[score.signal], error=score.error)
    return Validity(spans, tuple(p.name for p in held), tuple(_recorded(path, digest) for path, digest in bags))


def _recorded(bag: Path, digest: str) -> str:
    """A recording as the section names it: its path, the start of its SHA-256, and when it began, if that is
    known.
    """
    return " ".join([f"{bag} {digest[:12]}", *([begun] if (begun := begun_at(bag)) else [])])


def begun_at(bag: Path) -> str | None:
    """When a recording began, as "2026-05-02 14:03 UTC": by its metadata, else by its first message; None if neither
    has a date.
    """
    try:
        stamp = _first_stamp(bag)
        begun = datetime.fromtimestamp(stamp / 1e9, UTC)
    except (InputError, OSError, OverflowError, TypeError, ValueError):
        return None
    return f"{begun:%Y-%m-%d %H:%M} UTC" if begun.year >= FIRST_YEAR else None


def _first_stamp(bag: Path) -> int:
    """ns since 1970."""
    file = bag / "metadata.yaml"
    if file.is_file():
        stamp = read_yaml(file).value(("rosbag2_bagfile_information", "starting_time", "nanoseconds_since_epoch"))
        if isinstance(stamp, int):
            return stamp
    return min(topic.log_times[0] for topic in read_bag(bag).topics.values() if topic.log_times)
