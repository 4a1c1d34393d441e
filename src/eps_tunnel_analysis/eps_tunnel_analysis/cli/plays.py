# SPDX-License-Identifier: Apache-2.0
"""Recorded plays and the model to be fitted to them, as the command line names both."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from eps_tunnel_analysis.cli.sides import bag_hash, bags, read_bags, reading
from labyrinth_sim.errors import InputError

if TYPE_CHECKING:
    from eps_tunnel_analysis.plays import Play
    from labyrinth_sim.model import Model

T = TypeVar("T")


@dataclass(frozen=True)
class Recorded:
    """A model, the plays it is to be held against, and where these came from.

    Attributes:
        bags: path and SHA-256 of each bag.
        hashes: of the sequences, one for each play, "" where the bag tells none.
    """

    model: "Model"
    plays: "tuple[Play, ...]"
    hashes: tuple[str, ...]
    bags: tuple[tuple[Path, str], ...]
    notes: tuple[str, ...]


def load_recorded(arguments: argparse.Namespace) -> Recorded:
    """Reads --model and --real.

    Raises:
        InputError: everything wrong with either, at once.
    """
    from eps_tunnel_analysis.recording import to_plays
    from labyrinth_sim.model import load_model
    from labyrinth_sim.rig import load_rig

    complaints: list[str] = []

    def attempt(load: Callable[[], T]) -> T | None:
        try:
            return load()
        except InputError as error:
            complaints.extend(c for c in error.complaints if c not in complaints)
            return None

    model = attempt(lambda: load_model(arguments.model, arguments.effects))
    rig = attempt(lambda: load_rig(arguments.rig)) if arguments.rig else model.rig if model else None
    paths = attempt(lambda: bags(arguments.real))
    recordings = attempt(lambda: read_bags(paths, arguments)) if paths else None
    result = attempt(lambda: to_plays(recordings, rig, **reading(recordings, rig, arguments))) if recordings else None
    if complaints or model is None or result is None or paths is None:
        raise InputError(complaints)
    return Recorded(
        model,
        result.plays,
        tuple(r.sequence_hash for r in result.results),
        tuple((path, bag_hash(path)) for path in paths),
        result.notes,
    )
