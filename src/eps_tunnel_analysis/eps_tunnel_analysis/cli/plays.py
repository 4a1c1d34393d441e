# SPDX-License-Identifier: Apache-2.0
"""Recorded plays and the model to be fitted to them, as the command line names both."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.sides import bag_hash, bags, reading
from labyrinth_sim.errors import Complaints, InputError

if TYPE_CHECKING:
    from eps_tunnel_analysis.plays import Play
    from eps_tunnel_analysis.recording import Recording, TrialsResult
    from eps_tunnel_analysis.recording.plays import PlaysResult
    from labyrinth_sim.model import Model
    from labyrinth_sim.rig import Rig


@dataclass(frozen=True)
class Recorded:
    """A model, the plays it is to be held against, and where these came from.

    Attributes:
        bags: path and SHA-256 of each bag.
        hashes: of the sequences, one for each play, "" where the bag tells none.
        held: plays that are only judged.
    """

    model: "Model"
    plays: "tuple[Play, ...]"
    hashes: tuple[str, ...]
    bags: tuple[tuple[Path, str], ...]
    notes: tuple[str, ...]
    held: "tuple[Play, ...]" = ()


def load_recorded(arguments: argparse.Namespace, efforts: bool = False) -> Recorded:
    """Reads --model and --real; with `efforts`, these and the ball too where all bags have them.

    Raises:
        InputError: everything wrong with either, at once.
    """
    from labyrinth_sim.model import load_model
    from labyrinth_sim.rig import load_rig

    complaints = Complaints()
    attempt = complaints.attempt
    model = attempt(lambda: load_model(arguments.model, arguments.effects))
    rig = attempt(lambda: load_rig(arguments.rig)) if arguments.rig else model.rig if model else None
    paths = attempt(lambda: bags(arguments.real))
    held_paths = attempt(lambda: bags(getattr(arguments, "held_out", None) or []))
    known = attempt(lambda: known_of([*(paths or []), *(held_paths or [])], getattr(arguments, "known", None) or []))
    read = held = None
    if known is not None:
        read = attempt(lambda: _plays(paths, rig, arguments, known, efforts)) if paths is not None else None
        held = attempt(lambda: _plays(held_paths, rig, arguments, known, efforts)) if held_paths else None
    complaints.check()
    assert model is not None and read is not None and paths is not None
    return Recorded(
        model,
        read.plays,
        tuple(r.sequence_hash for r in read.results),
        tuple((path, bag_hash(path)) for path in (*paths, *(held_paths or []))),
        (*read.notes, *(held.notes if held else ())),
        held.plays if held else (),
    )


def _milliseconds(text: str) -> float:
    """In s."""
    value = float(text)
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected milliseconds from 0 on, got {text}")
    return value / 1e3


def add_known_arguments(parser: argparse.ArgumentParser) -> None:
    """--known, --timing-ms and --held-out."""
    parser.add_argument(
        "--known",
        nargs="+",
        metavar="PATTERN:NAME=VALUE",
        help="what was set differently in some bags: those whose path matches PATTERN were recorded with this value, "
        "as '*kp_100*:drive.pendulum.kp=100'",
    )
    parser.add_argument(
        "--timing-ms",
        dest="timing",
        type=_milliseconds,
        metavar="MS",
        help="uneven timing of commands or samples within trials that this rig is known to have; more counts as "
        "something missing (default: 0.29 of a sample; beside nodes, which share a computer, 10)",
    )
    parser.add_argument(
        "--held-out", nargs="+", metavar="BAG", type=Path, help="recordings that are never fitted, only judged"
    )


def known_of(paths: Sequence[Path], rules: Sequence[str]) -> dict[Path, dict[str, float]]:
    """What is known of each bag. Raises InputError for rules that cannot be read or that no bag matches."""
    known: dict[Path, dict[str, float]] = {path: {} for path in paths}
    complaints = []
    for rule in rules:
        pattern, _, setting = rule.partition(":")
        name, _, text = setting.partition("=")
        try:
            value = float(text)
        except ValueError:
            complaints.append(f"--known {rule}: expected PATTERN:NAME=NUMBER, as '*kp_100*:drive.x.kp=100'.")
            continue
        matching = [path for path in paths if fnmatch(str(path), pattern)]
        if not matching:
            complaints.append(f"--known {rule}: no bag's path matches '{pattern}'. Bags: {', '.join(map(str, paths))}.")
        for path in matching:
            known[path][name] = value
    if complaints:
        raise InputError(complaints)
    return known


def _plays(
    paths: Sequence[Path],
    rig: "Rig | None",
    arguments: argparse.Namespace,
    known: Mapping[Path, Mapping[str, float]],
    efforts: bool,
) -> "PlaysResult":
    """The plays of bags; the same command under other known values is another play."""
    from eps_tunnel_analysis.plays import Play
    from eps_tunnel_analysis.recording import read_all, to_plays
    from eps_tunnel_analysis.recording.plays import PlaysResult

    recordings = read_all(paths, arguments.time_source)
    how = reading(recordings, rig, arguments, efforts)
    groups: dict[tuple[tuple[str, float], ...], list[Recording]] = {}
    for path, recording in zip(paths, recordings, strict=True):
        groups.setdefault(tuple(sorted(known[path].items())), []).append(recording)
    timing = getattr(arguments, "timing", None) or 0.0
    plays: list[Play] = []
    results: list[TrialsResult] = []
    notes: list[str] = []
    for values, group in groups.items():
        found = to_plays(group, rig, **how)
        told = ", ".join(f"{name} {value:g}" for name, value in values)
        plays += [Play(f"{p.name}, {told}" if told else p.name, p.trials, dict(values), timing) for p in found.plays]
        results += found.results
        notes += found.notes
    return PlaysResult(tuple(plays), tuple(results), tuple(dict.fromkeys(notes)))
