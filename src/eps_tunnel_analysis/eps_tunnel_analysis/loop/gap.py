# SPDX-License-Identifier: Apache-2.0
"""What the loop needs from a rig, and the gap of a play on it, from the bags of both sides."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from eps_tunnel_analysis.alikeness import KS
from eps_tunnel_analysis.check.data import check_data, sentences
from eps_tunnel_analysis.compare import Comparison, compare
from eps_tunnel_analysis.diagnose.repeats import repeats
from eps_tunnel_analysis.error import error_unit, mean_error
from eps_tunnel_analysis.outputs import circumstances, new_folder, versions
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording import Recording, read, to_trials
from eps_tunnel_analysis.recording.trials import RATE
from eps_tunnel_analysis.report.next_step import after_comparison
from eps_tunnel_analysis.report.reports import write_comparison
from labyrinth_sim.errors import InputError
from labyrinth_sim.rig import Rig


class RigFailed(Exception):
    """A sequence was not played to its end, or a model was not loaded; the text says why."""


@dataclass(frozen=True)
class Bags:
    """The bags of one play, by side."""

    real: tuple[Path, ...]
    sim: tuple[Path, ...]


class PlayableRig(Protocol):
    """A rig and its simulation."""

    def play(self, sequence: str, trials: int, folder: Path) -> Bags:
        """Plays a sequence, by name or path, on both sides and records it into `folder`. Raises RigFailed."""

    def load(self, model: Path) -> None:
        """Loads a model file into the simulation. Raises RigFailed."""

    def limit(self) -> float:
        """The largest angle, rad, that may be commanded."""

    def publish(self, content: Mapping[str, Any], report: Path) -> None:
        """Publishes a verdict, in the form of diagnosis.json."""


@dataclass(frozen=True)
class Gap:
    """The comparison of one play.

    Attributes:
        comparison: of the positions.
        notes: on what was left out.
        jitter: s, by which samples or commands of the real trials seem to be early or late; 0 if they repeat.
    """

    comparison: Comparison
    notes: tuple[str, ...]
    jitter: float

    @property
    def unit(self) -> str:
        """Unit of the errors: that of the signals; rad if some turn and some slide."""
        return error_unit(self.comparison.real.units)

    @property
    def error(self) -> float:
        """Equation 10, mean over the signals in `unit`."""
        return self.comparison.mean_error

    @property
    def repeats(self) -> float:
        """The rig's own repeat error: RMS about the mean of its trials, mean over the signals in `unit`."""
        return mean_error([e.repeat_rms for e in self.comparison.errors], self.comparison.real.units)

    @property
    def alikeness(self) -> dict[float, float]:
        """Joint share of alike samples by k."""
        return {a.k_real: a.joint for a in self.comparison.alikeness}

    @property
    def itself(self) -> float:
        """Joint share that the rig reaches against itself at the smallest k; NaN with too few trials."""
        known = self.comparison.against_itself
        return known[0].joint if known else float("nan")


def measure_gap(bags: Bags, rig: Rig, ks: Sequence[float] = KS) -> Gap:
    """Compares the measured positions of both sides.

    Signals that were not measured throughout every trial, as on a machine that was too busy, are left out, with a note.

    Raises:
        InputError: unreadable bags, or no signal left.
    """
    real, sim = ([read(path) for path in paths] for paths in (bags.real, bags.sim))
    names, notes = _throughout([*real, *sim], rig)
    trials = to_trials(real, rig, signals=names, rate=rig.rate).trials
    comparison = compare(trials, to_trials(sim, rig, signals=names, rate=rig.rate).trials, ks)
    return Gap(comparison, (*notes, *comparison.notes), max(r.jitter for r in repeats(trials, names)))


def write_gap(gap: Gap, bags: Bags, folder: Path, name: str, model: str) -> None:
    """Report and tables, as `compare` writes them, into a new folder; `name` and path of the simulated model."""
    command = ["eps-tunnel", "compare", "--real", *map(str, bags.real), "--sim", *map(str, bags.sim)]
    rate = 1.0 / gap.comparison.real.step
    command += [] if np.isclose(rate, RATE) else ["--rate", f"{rate:g}"]
    facts = [
        *(("real bag", str(bag)) for bag in bags.real),
        *(("simulated bag", str(bag)) for bag in bags.sim),
        *(("note", note) for note in gap.notes),
        *circumstances(command),
    ]
    sources = [[kind, value] for kind, value in facts if kind.endswith("bag")]
    content = {"command": "compare", "versions": versions(), "sources": sources, **gap.comparison.to_json()}
    content["notes"] = list(gap.notes)
    with new_folder(folder) as partial:
        step = after_comparison(gap.comparison, bags.real, model, None)
        checked = sentences(check_data(None, [Play("", gap.comparison.real)]))
        write_comparison(partial, gap.comparison, content, name, facts, step, folder, pictures=False, checked=checked)


def _throughout(recordings: Sequence[Recording], rig: Rig) -> tuple[list[str], list[str]]:
    """The positions measured throughout, and notes on the others."""
    left_out: dict[str, str] = {}
    for name in rig.positions:
        for recording in recordings:
            try:
                to_trials([recording], rig, signals=[name], rate=rig.rate)
            except InputError as error:
                left_out[name] = f"{name} is left out. {error}"
    if len(left_out) == len(rig.positions):
        raise InputError(list(left_out.values()))
    return [name for name in rig.positions if name not in left_out], list(left_out.values())
