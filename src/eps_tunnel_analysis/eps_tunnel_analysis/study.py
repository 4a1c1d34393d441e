# SPDX-License-Identifier: Apache-2.0
"""The short way in Python: recordings and a model in, the gap, its reason and a better model out.

docs/python.md shows it. What takes long to import is imported where it is needed.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from eps_tunnel_analysis.alikeness import KS
from eps_tunnel_analysis.compare import Comparison, compare
from eps_tunnel_analysis.inputs import Reading, Recorded, Sides, bags, load_recorded, load_sides, model_of
from eps_tunnel_analysis.outputs import circumstances, new_folder, refuse_existing, shown_share, shown_value, versions
from eps_tunnel_analysis.recording import TimeSource
from eps_tunnel_analysis.recording.trials import MAX_GAP
from eps_tunnel_analysis.report.next_step import after_comparison
from eps_tunnel_analysis.terminal import (
    fit_bars,
    print_calibration,
    print_comparison,
    print_verdict,
    rollout_progress,
    text_of,
)
from labyrinth_sim.errors import Complaints, InputError
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Trials

if TYPE_CHECKING:
    from eps_tunnel_analysis.calibration.from_bags import Calibration
    from eps_tunnel_analysis.check.check import Check
    from eps_tunnel_analysis.diagnose.axes import Diagnosis
    from eps_tunnel_analysis.diagnose.experiment import Experiment
    from eps_tunnel_analysis.diagnose.verdict import Verdict
    from eps_tunnel_analysis.law.proposal import Proposal
    from eps_tunnel_analysis.loop.reason import DiagnosisOptions
    from eps_tunnel_analysis.report.pictures import Picture

Named = str | Path
"""A file or a folder."""
WIDE_LINE = 140  # characters of a line where tables have many columns


def load(
    real: Named | Iterable[Named],
    model: Named | Model | None = None,
    *,
    simulated: Named | Iterable[Named] = (),
    known: Mapping[str, Mapping[str, float]] | None = None,
    held_out: Named | Iterable[Named] = (),
    candidates: Iterable[str] | None = None,
    effects: Named | None = None,
    rig: Named | None = None,
    signals: Iterable[str] | None = None,
    rate: float | None = None,
    time_source: TimeSource = "header",
    max_gap: float = MAX_GAP,
    cut_to_shortest: bool = False,
    timing: float = 0.0,
    seed: int = 0,
    threads: int = 0,
) -> "Study":
    """Recordings and what they are held against. The model is read at once, the recordings when they are needed.

    Args:
        real: bags of the real rig, or folders of bags; each bag is a trial, or holds trials that are marked in it.
        model: a Model, or the name or file of one.
        simulated: bags of the simulation, for `compare`; without them the model is played with the recorded commands.
        known: pattern of bags' paths -> full parameter name -> value that was set for these recordings, in SI, as
            {"*kp_100*": {"drive.pendulum.kp": 100.0}}.
        held_out: bags that are never fitted, only judged.
        candidates: names of the effects that a diagnosis considers; by default all.
        effects: folder with your own effect files.
        rig: name or file; by default the model's, or what the bags offer.
        signals: by default every position.
        rate: Hz of the common grid; by default the rig's, 100 without one.
        time_source: "header", the stamp set where the value was measured, or "log", when it was recorded.
        max_gap: s, longest pause that is bridged by a straight line.
        cut_to_shortest: cut trials of different length instead of refusing them.
        timing: s, uneven timing within trials that the rig is known to have.
        seed: of a fit's random draws; kept with a diagnosis.
        threads: 0 for one per CPU.

    Raises:
        InputError: all that is wrong with the model, the names, and the paths.
    """
    complaints = Complaints()
    folder = Path(effects) if effects is not None else None
    loaded = complaints.attempt(lambda: model_of(model, folder)) if model is not None else None
    every = [_paths(given) for given in (real, simulated, held_out)]
    for paths in every:
        complaints.attempt(lambda paths=paths: _existing(paths))  # type: ignore[misc]
    chosen = tuple(candidates) if candidates is not None else None
    if loaded and chosen:
        complaints.attempt(lambda: loaded.registry.check(chosen))
    complaints.check()
    reading = Reading(
        str(rig) if rig is not None else None, tuple(signals) if signals is not None else None, time_source, rate,
        max_gap, cut_to_shortest,
    )  # fmt: skip
    rules = [f"{pattern}:{name}={v!r}" for pattern, values in (known or {}).items() for name, v in values.items()]
    return Study(
        every[0], loaded, every[1], reading, folder, tuple(rules), every[2], chosen, timing, seed, threads
    )  # fmt: skip


@dataclass(frozen=True, repr=False)
class Study:
    """Recordings of a rig, and the model or the simulated recordings that they are held against.

    Attributes:
        real: bags, or folders of bags.
        model: itself, or its name or file; None where only simulated bags are compared.
        simulated: bags of the simulation.
        reading: how bags are read.
        effects: folder with effect files of the user.
        known: what was set differently in some bags, as PATTERN:NAME=VALUE.
        held_out: bags that are never fitted, only judged.
        candidates, timing, seed, threads: as in `load`.
    """

    real: tuple[Path, ...]
    model: Named | Model | None = None
    simulated: tuple[Path, ...] = ()
    reading: Reading = field(default_factory=Reading)
    effects: Path | None = None
    known: tuple[str, ...] = ()
    held_out: tuple[Path, ...] = ()
    candidates: tuple[str, ...] | None = None
    timing: float = 0.0
    seed: int = 0
    threads: int = 0

    @cached_property
    def sides(self) -> Sides:
        """Real and simulated trials of one command. Raises InputError: everything wrong with bags, rig and model."""
        if self.model is None and not self.simulated:
            raise InputError("Nothing to compare with. Name a model, or bags of the simulation by simulated=.")
        return load_sides(self.real, self.simulated, self.model, self.effects, self.reading, self.known)

    @property
    def trials(self) -> Trials:
        """The real trials that are compared. Raises InputError: as `sides`."""
        return self.sides.real

    @cached_property
    def recorded(self) -> Recorded:
        """Every recorded command with its trials, efforts and the ball among them, for `check` and `diagnose`.

        Raises:
            InputError: everything wrong with bags, rig and model; there is no model.
        """
        return self._options.recorded(self._model(), self.real)

    def compare(self, ks: Iterable[float] = KS, smoothed: bool = True, k_sim: float = 1.0) -> "StudyGap":
        """How far the simulation is from the rig, and where.

        Args:
            ks: factors of the real tunnel's width.
            smoothed: filter the tunnels' limits by equation 12.
            k_sim: factor of the simulated tunnel's width.

        Raises:
            InputError: as `sides` and `eps_tunnel_analysis.compare.compare`.
        """
        sides = self.sides
        comparison = compare(sides.real, sides.sim, ks, smoothed, k_sim, self.reading.signals)
        notes = (*sides.notes, *comparison.notes)
        model = str(self.model) if isinstance(self.model, str | Path) else sides.model.name if sides.model else None
        step = after_comparison(comparison, tuple(map(Path, self.real)), model, self.effects, self.known)
        return StudyGap(replace(comparison, notes=notes), sides.facts, sides.model, step, sides.checked)

    def check(self, progress: bool = True) -> "Check":
        """Quality of the recordings and which values and effects they can identify, before anything is fitted.

        Raises:
            InputError: as `recorded`.
        """
        from eps_tunnel_analysis.loop.reason import check_recorded

        with rollout_progress("bar" if progress else "none") as show:
            return check_recorded(self.recorded, self._options, show)

    def diagnose(self, progress: bool = True) -> "StudyReason":
        """Which physical effect the model lacks; minutes with all candidates.

        Raises:
            InputError: as `recorded`; no recorded command moves an axis that is measured.
        """
        from eps_tunnel_analysis.loop.reason import DiagnosisRun, diagnose_recorded

        recorded = self.recorded
        with rollout_progress("bar" if progress else "none") as show:
            diagnosed = diagnose_recorded(recorded, self._options, DiagnosisRun(show, propose=True))
        return StudyReason(diagnosed.diagnosis, recorded, self.real, diagnosed.proposal, diagnosed.checked)

    def calibrate(
        self,
        free: Iterable[str] = (),
        method: str = "gauss-newton",
        fitness: str = "error",
        hold_out: float | None = None,
        budget: int | None = None,
        axis_by_axis: bool | None = None,
        progress: bool = True,
    ) -> "StudyFit":
        """Fits the model's values.

        Args:
            free: patterns of full names, as "drive.x.*"; by default what drives and effects declare as free.
            method: "gauss-newton", "cma" or "es".
            fitness: "error" (equations 10 and 11) or "srg" (alikeness over k).
            hold_out: commands to hold out of the fit: a number, or a share below 1; by default a fifth, rounded down.
            budget: most evaluations of each fit, up to a batch more.
            axis_by_axis: one fit for each axis; by default only with "es".

        Raises:
            InputError: as `sides`; unknown names.
        """
        from eps_tunnel_analysis.calibration.calibrate import Settings
        from eps_tunnel_analysis.calibration.from_bags import calibrate_recorded, free_of
        from eps_tunnel_analysis.inputs import held_apart

        read = load_recorded(
            self._model(), self.real, self.reading, effects=self.effects, known=self.known, held_out=self.held_out
        )
        recorded, held = held_apart(read, hold_out, self.seed)
        signals = self.reading.signals
        settings = Settings(
            method, fitness, self.seed, signals=signals, held_out=held, nthread=self.threads, budget=budget
        )
        names = free_of(recorded, tuple(free), signals or ())
        by_axis = method == "es" if axis_by_axis is None else axis_by_axis
        with fit_bars("bar" if progress else "none") as bars:
            return StudyFit(calibrate_recorded(recorded, names, settings, by_axis, bars))

    def with_model(self, model: Named | Model) -> "Study":
        """The same recordings against another model."""
        return replace(self, model=model)

    @property
    def _options(self) -> "DiagnosisOptions":
        from eps_tunnel_analysis.loop.reason import DiagnosisOptions

        return DiagnosisOptions(
            self.candidates, self.seed, self.threads, self.timing, self.reading, self.effects, self.known,
            self.held_out,
        )  # fmt: skip

    def _model(self) -> Named | Model:
        if self.model is None:
            raise InputError("Name a model: eps.load(..., model=...).")
        return self.model

    def __repr__(self) -> str:
        model = f"model {_name(self.model)}" if self.model is not None else "no model"
        simulated = f", simulated {_listed(self.simulated)}" if self.simulated else ""
        held = f", held out {_listed(self.held_out)}" if self.held_out else ""
        return f"Study of {_listed(self.real)}, {model}{simulated}{held}"


class _InNotebook(ABC):
    """One line as repr, a screen of text as str, and text with a picture in a notebook."""

    @abstractmethod
    def plot(self) -> "Picture":
        """The picture that a notebook shows below the text."""

    @abstractmethod
    def _print(self, out: Console) -> None:
        """Writes the text."""

    def __str__(self) -> str:
        return text_of(self._print)

    def _repr_html_(self) -> str:
        return f'<pre style="white-space:pre-wrap">{escape(str(self))}</pre>{self.plot().svg}'


@dataclass(frozen=True, repr=False)
class StudyGap(_InNotebook):
    """How far a simulation is from the rig, and where.

    Attributes:
        comparison: tunnels, alikeness, errors, where it fails.
        facts: what was compared, as pairs of name and value.
        model: that was played; None for simulated bags.
        step: what to do next: a sentence and a command, "" where there is none.
        checked: what the real recordings are like, a sentence each, the serious first.
    """

    comparison: Comparison
    facts: tuple[tuple[str, str], ...] = ()
    model: Model | None = None
    step: tuple[str, str] = ("", "")
    checked: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        """Equation 10, mean over the signals in rad, or those in m where none turns."""
        return self.comparison.mean_error

    @property
    def alikeness(self) -> dict[float, float]:
        """k -> share of the samples that are alike in every signal."""
        return {a.k_real: a.joint for a in self.comparison.alikeness}

    def plot(self) -> "Picture":
        """Simulation and tunnel of each signal, relative to the real mean."""
        from eps_tunnel_analysis.report.pictures import Picture, gap_picture

        return Picture.of(gap_picture(self.comparison))

    def to_json(self) -> dict[str, Any]:
        """What compare.json holds."""
        sources = [list(fact) for fact in self.facts]
        return {"command": "compare", "versions": versions(), "sources": sources, **self.comparison.to_json()}

    def save(self, folder: Named) -> Path:
        """Writes report.html, compare.json, tables and pictures into a new folder; returns the report.

        Raises:
            InputError: the folder exists, or cannot be written.
        """
        from eps_tunnel_analysis.report.reports import write_comparison

        facts, name = [*self.facts, *circumstances()], _name(self.model) or "the simulation"
        with new_folder(Path(folder)) as partial:
            write_comparison(
                partial, self.comparison, self.to_json(), name, facts, self.step, Path(folder), checked=self.checked
            )
        return Path(folder) / "report.html"

    def _print(self, out: Console) -> None:
        print_comparison(self.comparison, out=out)

    def __repr__(self) -> str:
        from eps_tunnel_analysis.diagnose.falls import of_rig

        c, first = self.comparison, self.comparison.alikeness[0]
        itself = c.against_itself[0].joint if c.against_itself else float("nan")
        errors = ", ".join(f"{e.signal} {shown_value(e.command_error, e.unit)}" for e in c.errors)
        return (
            f"Gap of {c.real.count} real trial{'s' * (c.real.count > 1)} to {_name(self.model) or 'the simulation'}: "
            f"error {errors}; {shown_share(first.joint)} alike at k = {first.k_real:g}{of_rig(itself)}"
        )


@dataclass(frozen=True, repr=False)
class StudyReason(_InNotebook):
    """Which effect the model lacks.

    Attributes:
        diagnosis: the verdict, its models and comparisons, axis by axis.
        recorded: what was diagnosed.
        real: bags as they were named.
        proposal: a law, if the verdict is "unknown".
        checked: quality of the recordings and what they can identify.
    """

    diagnosis: "Diagnosis"
    recorded: Recorded
    real: tuple[Path, ...]
    proposal: "Proposal | None" = None
    checked: "Check | None" = None

    @property
    def verdict(self) -> "Verdict":
        """What is missing, how sure that is, and errors before and after."""
        return self.diagnosis.verdict

    @property
    def model(self) -> Model:
        """With the effects that are named, fitted; where none is, the given model with its values refitted."""
        from eps_tunnel_analysis.report.reports import better_model

        return better_model(self.diagnosis, self.recorded)

    @property
    def experiment(self) -> "Experiment | None":
        """What to play next where the recordings do not decide."""
        return self.diagnosis.experiment

    def plot(self) -> "Picture":
        """The hypotheses' probabilities."""
        from eps_tunnel_analysis.report.pictures import Picture, hypotheses_picture

        return Picture.of(hypotheses_picture(self.verdict))

    def to_json(self) -> dict[str, Any]:
        """What diagnosis.json holds of the verdict."""
        return self.verdict.to_json()

    def save(self, folder: Named) -> Path:
        """Writes report.html, diagnosis.json, model.yaml and what `diagnose` of the command line writes besides into a
        new folder; returns the report.

        Raises:
            InputError: the folder exists, or cannot be written.
        """
        from eps_tunnel_analysis.loop.reason import write_reason
        from eps_tunnel_analysis.report.reports import Findings

        refuse_existing(Path(folder))
        name = str(self.recorded.model.path or self.recorded.model.name)
        findings = Findings(self.diagnosis, self.recorded, self.proposal, self.checked)
        return write_reason(findings, Path(folder), self.real, name).report

    def _print(self, out: Console) -> None:
        print_verdict(self.verdict, self.recorded.notes, out, self.recorded.model.rig.position_unit)
        if self.proposal is not None:
            out.print(self.proposal.sentence, soft_wrap=True, markup=False)

    def __repr__(self) -> str:
        return self.verdict.sentence


@dataclass(frozen=True, repr=False)
class StudyFit:
    """A model whose values were fitted.

    Attributes:
        calibration: values with their intervals, errors before and after, and what is to be said of it.
    """

    calibration: "Calibration"

    @property
    def model(self) -> Model:
        """With the fitted values and where they come from."""
        return self.calibration.model

    @property
    def values(self) -> dict[str, float]:
        """Full parameter name -> fitted value, SI."""
        return self.calibration.result.values

    def save(self, file: Named) -> Path:
        """Writes the model, and the complete result next to it as .fit.json; returns the model's file.

        Raises:
            InputError: either exists, or cannot be written.
        """
        from eps_tunnel_analysis.calibration.from_bags import model_and_result, write_calibration

        files = model_and_result(Path(file))
        write_calibration(self.calibration, files)
        return files[0]

    def _print(self, out: Console) -> None:
        print_calibration(self.calibration.result, self.calibration.notes, out)

    def __str__(self) -> str:
        return text_of(self._print, WIDE_LINE)

    def _repr_html_(self) -> str:
        return f'<pre style="white-space:pre-wrap">{escape(str(self))}</pre>'

    def __repr__(self) -> str:
        result = self.calibration.result
        pairs = zip(result.before, result.after, strict=True)
        errors = (f"{b.signal} {shown_value(b.error, b.unit)} -> {shown_value(a.error, a.unit)}" for b, a in pairs)
        return f"Fit of {len(self.values)} values of {self.model.name}: error {', '.join(errors)}"


def _paths(given: Named | Iterable[Named]) -> tuple[Path, ...]:
    return (Path(given),) if isinstance(given, str | Path) else tuple(Path(path) for path in given)


def _existing(paths: Sequence[Path]) -> None:
    missing = [path for path in paths if not path.exists()]
    if missing:
        raise InputError(
            [f"{path}: no such bag or folder. Looked in {Path.cwd()}; name it from there." for path in missing]
        )
    bags(paths)


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(map(str, paths[:3])) + (f", ... ({len(paths)} in all)" if len(paths) > 3 else "")


def _name(model: Named | Model | None) -> str:
    return model.name if isinstance(model, Model) else str(model or "")
