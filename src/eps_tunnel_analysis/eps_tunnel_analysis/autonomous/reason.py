# SPDX-License-Identifier: Apache-2.0
"""The reason for a gap: a diagnosis of all that was played on the real side so far, and its files."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.autonomous.rig import Bags
from eps_tunnel_analysis.cli.diagnosing import write_diagnosis
from eps_tunnel_analysis.cli.folder import new_folder
from eps_tunnel_analysis.cli.main import parser
from eps_tunnel_analysis.cli.plays import load_recorded
from eps_tunnel_analysis.command_process import TIMING, spare_threads, timing_options
from eps_tunnel_analysis.diagnose.diagnose import Diagnosis, diagnose
from labyrinth_sim.model import Model


@dataclass(frozen=True)
class Reason:
    """A diagnosis, the content of its diagnosis.json, and the folder with that, report.html and, where two hypotheses
    are left, next_experiment.yaml."""

    diagnosis: Diagnosis
    content: Mapping[str, Any]
    folder: Path

    @property
    def report(self) -> Path:
        """The page for people."""
        return self.folder / "report.html"


@dataclass(frozen=True)
class Search:
    """How diagnoses are made.

    Attributes:
        candidates: names of effects to consider; None for the whole library.
        threads: of this machine; 0 leaves a core to the nodes.
        timing: s, uneven timing within trials that the rig is known to have.
    """

    candidates: tuple[str, ...] | None = None
    seed: int = 0
    threads: int = 0
    timing: float = TIMING


def find_reason(
    model: str,
    played: Sequence[Bags],
    folder: Path,
    search: Search,
    told: Callable[[str, int], None] | None = None,
    limit: float | None = None,
    once: Mapping[str, float] | None = None,
) -> Reason:
    """Diagnoses a model, by name or path, and writes the result into a new folder.

    Args:
        told: what is being done and how many roll-outs were made.
        limit: rad; an experiment that goes further is not proposed.
        once: as in `diagnose`.

    Raises:
        InputError: what `diagnose` raises, or bags that cannot be read.
    """
    arguments = _arguments(model, played, folder, search.timing)
    recorded = load_recorded(arguments, efforts=True)
    recorded = replace(recorded, model=within(recorded.model, limit) if limit else recorded.model)
    threads = search.threads or spare_threads()
    found = diagnose(recorded.model, recorded.plays, search.seed, search.candidates, threads, told, once=once)
    with new_folder(folder) as partial:
        content = write_diagnosis(partial, found, recorded, arguments)
    return Reason(found, content, folder)


def within(model: Model, limit: float) -> Model:
    """The model on a rig whose axes may be turned by `limit` rad at most, either way."""
    axes = tuple(replace(a, limits=(max(a.limits[0], -limit), min(a.limits[1], limit))) for a in model.rig.axes)
    return replace(model, rig=replace(model.rig, axes=axes))


def _arguments(model: str, played: Sequence[Bags], folder: Path, timing: float) -> argparse.Namespace:
    bags = [str(bag) for bags in played for bag in bags.real]
    given = ["diagnose", "--real", *bags, "--model", model, "--out", str(folder), *timing_options(timing)]
    return parser().parse_args(given)
