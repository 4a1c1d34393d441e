# SPDX-License-Identifier: Apache-2.0
"""Bags and a model in, a diagnosis or a model with effects out, with their files."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.calibration.validity import validity_of
from eps_tunnel_analysis.check.check import Check, check
from eps_tunnel_analysis.diagnose.addition import Addition, add_effects
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.diagnose.progress import RolloutProgress
from eps_tunnel_analysis.fit.cluster import Spread
from eps_tunnel_analysis.inputs import Reading, Recorded, load_recorded
from eps_tunnel_analysis.law.proposal import Proposal, confirmed, proposal_of
from eps_tunnel_analysis.outputs import new_folder, refuse_existing, refuse_files
from eps_tunnel_analysis.report.reports import Findings, model_provenance, was_fitted, write_diagnosis
from labyrinth_sim.model import Model, save_model
from labyrinth_sim.shown import shown


@dataclass(frozen=True)
class DiagnosisOptions:
    """How bags are read and diagnosed.

    Attributes:
        candidates: names of effects to consider; None for all that the registry knows.
        threads: 0 for one per CPU.
        timing: s, uneven timing within trials that the rig is known to have.
        effects: folder with effect files of the user's own.
        known: what was set differently in some bags, as PATTERN:NAME=VALUE.
        held_out: bags that are never fitted, only judged.
        exhaustive: without the search's shortcuts.
    """

    candidates: tuple[str, ...] | None = None
    seed: int = 0
    threads: int = 0
    timing: float = 0.0
    reading: Reading = field(default_factory=Reading)
    effects: Path | None = None
    known: tuple[str, ...] = ()
    held_out: tuple[Path, ...] = ()
    exhaustive: bool = False

    def recorded(self, model: str | Path | Model, real: Sequence[Path]) -> Recorded:
        """A model, or its name or file, and the plays in bags. Raises InputError: everything wrong with either."""
        return load_recorded(
            model, real, self.reading, effects=self.effects, known=self.known, timing=self.timing,
            held_out=self.held_out, efforts=True,
        )  # fmt: skip


@dataclass(frozen=True)
class DiagnosisRun:
    """The input of one diagnosis, apart from its options.

    Attributes:
        progress, levels, spread: as in `diagnose`.
        limit: rad; an experiment that goes further is not proposed.
        propose: if the verdict is "unknown", look for a law.
    """

    progress: RolloutProgress | None = None
    limit: float | None = None
    levels: Mapping[str, float] | None = None
    propose: bool = False
    spread: Spread | None = None


@shown
@dataclass(frozen=True)
class Reason:
    """A diagnosis of recordings, the content of its diagnosis.json, and the folder with that, report.html, model.yaml
    and, if two hypotheses are left, next_experiment.yaml."""

    diagnosis: Diagnosis
    recorded: Recorded
    content: Mapping[str, Any]
    folder: Path
    proposal: Proposal | None = None

    @property
    def report(self) -> Path:
        """The page for people."""
        return self.folder / "report.html"


def diagnose_bags(
    model: str,
    real: Sequence[Path],
    folder: Path,
    options: DiagnosisOptions,
    run: DiagnosisRun = DiagnosisRun(),
    show_check: Callable[[Check], None] | None = None,
) -> Reason:
    """Diagnoses a model, by name or path, and writes the result into a new folder.

    Args:
        show_check: called with the check of the recordings before anything is fitted.

    Raises:
        InputError: what `diagnose` raises, bags that cannot be read, or `folder` exists.
    """
    refuse_existing(folder)
    return write_reason(diagnose_recorded(options.recorded(model, real), options, run, show_check), folder, real, model)


def check_recorded(recorded: Recorded, options: DiagnosisOptions, progress: RolloutProgress | None = None) -> Check:
    """Quality of recordings and what they can identify, before anything is fitted."""
    return check(recorded.model, recorded.plays, recorded.notes, options.candidates, options.threads, progress)


def diagnose_recorded(
    recorded: Recorded,
    options: DiagnosisOptions,
    run: DiagnosisRun,
    show_check: Callable[[Check], None] | None = None,
) -> Findings:
    """Checks and diagnoses what was read by `options.recorded`; arguments and errors as in `diagnose_bags`."""
    checked = check_recorded(recorded, options, run.progress)
    if show_check:
        show_check(checked)
    diagnosis = diagnose(
        within(recorded.model, run.limit) if run.limit else recorded.model, recorded.plays, options.seed,
        options.candidates, options.threads, run.progress, levels=run.levels, held=recorded.held, spread=run.spread,
        exhaustive=options.exhaustive, fitted=was_fitted(recorded),
    )  # fmt: skip
    proposal = proposal_of(diagnosis, recorded.plays, options.threads, options.seed) if run.propose else None
    if proposal and recorded.held:
        proposal = confirmed(proposal, recorded.held, options.threads)
    return Findings(diagnosis, recorded, proposal, checked)


def write_reason(findings: Findings, folder: Path, real: Sequence[Path], model: str) -> Reason:
    """Writes a diagnosis into a new folder; arguments as in `write_diagnosis`. Raises InputError: it exists."""
    with new_folder(folder) as partial:
        content = write_diagnosis(partial, folder, findings, real, model)
    return Reason(findings.diagnosis, findings.recorded, content, folder, findings.proposal)


def add_to_model(
    model: str,
    real: Sequence[Path],
    names: Sequence[str],
    out: Path,
    options: DiagnosisOptions,
    progress: RolloutProgress | None = None,
) -> tuple[Addition, Recorded]:
    """Adds effects, `EFFECT.PLACE`, fitted to bags, and writes the model to `out` with its provenance.

    Returns:
        What was added, and what it was fitted to.

    Raises:
        InputError: `out` exists, bags that cannot be read, or what `add_effects` raises.
    """
    refuse_files(out)
    recorded = options.recorded(model, real)
    added = add_effects(recorded.model, recorded.plays, names, options.threads, progress, recorded.held)
    valid = validity_of(added.model, recorded.plays, recorded.held, recorded.bags)
    save_model(replace(added.model, provenance=model_provenance(recorded, names, added.errors), valid=valid), out)
    return added, recorded


def within(model: Model, limit: float) -> Model:
    """The model on a rig whose axes may be turned by `limit` rad at most, either way."""
    axes = tuple(replace(a, limits=(max(a.limits[0], -limit), min(a.limits[1], limit))) for a in model.rig.axes)
    return replace(model, rig=replace(model.rig, axes=axes))
