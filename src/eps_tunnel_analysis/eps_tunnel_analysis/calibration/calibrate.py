# SPDX-License-Identifier: Apache-2.0
"""Calibration: fit a model's free values to recorded plays, and say how far the answer can be trusted."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.alikeness import KS, rig_against_itself
from eps_tunnel_analysis.calibration.agreement import differing
from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.diagnose.discrepancy import Discrepancy, discrepancy, start_pose_deviation
from eps_tunnel_analysis.fit.evaluations import BudgetSpent, Evaluations, FitProgress, Improvement, Journal
from eps_tunnel_analysis.fit.intervals import (
    Intervals,
    combination,
    intervals,
    trade_offs,
    unknown_intervals,
    widened,
)
from eps_tunnel_analysis.fit.methods import CmaEs, EvolutionStrategy, GaussNewton
from eps_tunnel_analysis.fit.problem import (
    AT_BOUND,
    CommandError,
    Dissimilarity,
    Fitness,
    Objective,
    Part,
    Problem,
    Residuals,
    by_axis,
)
from eps_tunnel_analysis.outputs import plain, shown_value
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import Diverged, compared_signals, roll_out
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array

INTERVAL_STEP = 1e-4  # of the finite differences for the intervals, normalised
NEGLIGIBLE_STEP = 1e-4  # normalised; a smaller promised step does not count
PROMISED_GAIN = 0.05  # of the squared residuals; less counts as converged
FITNESS = ("error", "srg")
WORSE = 1.02  # times the error before; a recording beyond it is reported
WORSE_LISTED = 3  # recordings that got worse


@dataclass(frozen=True)
class Fitted:
    """One free parameter after a fit.

    Attributes:
        name, unit: the full parameter name and its unit.
        start, value: before and after, in that unit.
        half_width: of the 95 % interval, in that unit; NaN where no interval could be computed.
        low, high: the bounds.
        at_bound: the value lies at one of them, so the true one may lie beyond.
    """

    name: str
    unit: str
    start: float
    value: float
    half_width: float
    low: float
    high: float
    at_bound: bool


@shown
@dataclass(frozen=True)
class Fit:
    """The result of a calibration.

    Attributes:
        method, fitness, seed: how it was made.
        parameters: one for each free parameter.
        before, after: fitness on the commands that were fitted.
        held_out_before, held_out_after: on those that were not; NaN where none were held out.
        fitted_plays, held_out_plays: their names.
        converged: no step that the residuals' slope promises would gain 5 % or more.
        interrupted: ended by Ctrl-C; the values are the best until then.
        evaluations: parameter sets simulated, each on all commands.
        seconds: wall time.
        history: where the best improved.
        warnings: one sentence each.
        about: data, versions and whatever else the caller knows.
    """

    method: str
    fitness: str
    seed: int
    parameters: tuple[Fitted, ...]
    before: float
    after: float
    held_out_before: float
    held_out_after: float
    fitted_plays: tuple[str, ...]
    held_out_plays: tuple[str, ...]
    converged: bool
    interrupted: bool
    evaluations: int
    seconds: float
    history: tuple[Improvement, ...]
    warnings: tuple[str, ...]
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, float]:
        """Full parameter name -> fitted value."""
        return {p.name: p.value for p in self.parameters}

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; NaN becomes None."""
        return {key: plain(value) for key, value in asdict(self).items()}


@dataclass(frozen=True)
class Score:
    """One signal of one model over several plays.

    Attributes:
        signal, unit: what it is.
        error: E_C of equation 10, mean over the plays, in the signal's unit; inf where the simulation diverged.
        alikeness: k -> share of all seen samples within k times the smoothed tunnel (equations 7, 12, 13).
    """

    signal: str
    unit: str
    error: float
    alikeness: dict[float, float]


def judge(
    model: Model,
    plays: Sequence[Play],
    signals: Iterable[str] | None = None,
    ks: Sequence[float] = KS,
    timestep: float | None = None,
) -> tuple[Score, ...]:
    """Compares the model with each play, by tunnels and errors as `compare` does.

    Raises:
        InputError: unknown signals, or commands that the rig needs are missing.
    """
    return _judged(model, plays, signals, ks, timestep)[0]


def _judged(
    model: Model, plays: Sequence[Play], signals: Iterable[str] | None, ks: Sequence[float], timestep: float | None
) -> "_Judged":
    names = compared_signals(model, [play.trials for play in plays], signals)
    errors = np.full((len(plays), len(names)), np.inf)
    alike, seen = np.zeros((len(ks), len(names))), np.zeros((len(ks), len(names)))
    for number, play in enumerate(plays):
        real = play.trials.select(names)
        try:
            result = compare(real, roll_out(model, play, timestep), ks, signals=names)
        except Diverged:
            seen += (~np.isnan(real.values)).any(axis=0).sum(axis=0)
            continue
        errors[number] = [e.command_error for e in result.errors]
        alike += [a.alike.sum(axis=0) for a in result.alikeness]
        seen += [a.seen.sum(axis=0) for a in result.alikeness]
    units = dict(zip(model.rig.signals, model.rig.units, strict=True))
    shares = alike / np.maximum(seen, 1)  # (k, m)
    by_k = [dict(zip(sorted(ks), column, strict=True)) for column in shares.T.tolist()]
    scores = tuple(
        Score(name, units[name], float(error) / len(plays), share)
        for name, error, share in zip(names, errors.sum(axis=0), by_k, strict=True)
    )
    return scores, errors


_Judged = tuple[tuple[Score, ...], Array]
"""The scores over all plays, and the errors (c, m) of each."""


def judge_rig(
    model: Model, plays: Sequence[Play], signals: Iterable[str] | None = None, ks: Sequence[float] = KS
) -> dict[str, dict[float, float]]:
    """What the rig reaches against itself, to compare with `judge`: signal -> factor k -> share alike of all seen
    samples of the plays with enough trials; empty if no play has these.

    Raises:
        InputError: unknown signals.
    """
    names = compared_signals(model, [play.trials for play in plays], signals)
    alike, seen = np.zeros((len(ks), len(names))), np.zeros(len(names))
    for play in plays:
        real = play.trials.select(names)
        itself = rig_against_itself(real, ks)
        if not itself:
            continue
        samples = (~np.isnan(real.values)).any(axis=0).sum(axis=0)  # (m,)
        seen += samples
        alike += samples * np.nan_to_num([[at.shares[name] for name in names] for at in itself])
    shares = alike / np.maximum(seen, 1)
    return {name: dict(zip(ks, shares[:, i].tolist(), strict=True)) for i, name in enumerate(names) if seen[i]}


class Method(Protocol):
    """An optimiser."""

    @property
    def name(self) -> str: ...

    @property
    def budget(self) -> int: ...

    def run(self, evaluations: Evaluations, rng: np.random.Generator) -> None: ...


METHODS: dict[str, Callable[[], Method]] = {
    "es": EvolutionStrategy,
    "cma": CmaEs,
    "gauss-newton": GaussNewton,
}


@dataclass(frozen=True)
class Settings:
    """How to fit.

    Attributes:
        method: an optimiser, or the name of one with its usual settings.
        fitness: "error" (equations 10 and 11) or "srg" (the alikeness itself).
        seed: of every random draw.
        signals: which to compare; None for every measured position.
        held_out: numbers of the plays that are not fitted but judged afterwards.
        timestep: MuJoCo's step, s; None for the rig's own.
        nthread: 0 for one per CPU; the answer does not depend on it.
        journal: checkpoint file; an interrupted run continues from it.
        budget: evaluations after which to stop, at the end of a batch; None leaves it to the method.
        about: data and versions, kept with the result.
        spread: wraps the residual function, to send the same evaluations elsewhere.
    """

    method: Method | str = "gauss-newton"
    fitness: str = "error"
    seed: int = 0
    signals: tuple[str, ...] | None = None
    held_out: tuple[int, ...] = ()
    timestep: float | None = None
    nthread: int = 0
    journal: Path | None = None
    budget: int | None = None
    about: Mapping[str, Any] = field(default_factory=dict)
    spread: Callable[[Residuals], Residuals] | None = None

    def optimiser(self) -> Method:
        if not isinstance(self.method, str):
            return self.method
        if self.method not in METHODS:
            raise InputError(unknown_name("method", self.method, METHODS))
        return METHODS[self.method]()


def calibrate(
    model: Model,
    free: Sequence[str],
    plays: Sequence[Play],
    settings: Settings | None = None,
    progress: FitProgress | None = None,
) -> Fit:
    """Fit the free values of a model.

    Args:
        model: gives start values, bounds and whatever is not free.
        free: full parameter names.
        plays: the recorded commands.

    Raises:
        InputError: unknown names, no play left to fit, a start out of bounds.
    """
    settings = settings or Settings()
    method = settings.optimiser()
    if settings.fitness not in FITNESS:
        raise InputError(unknown_name("fitness", settings.fitness, FITNESS))
    wrong = [i for i in settings.held_out if not 0 <= i < len(plays)]
    fitted = [play for i, play in enumerate(plays) if i not in settings.held_out]
    kept = [play for i, play in enumerate(plays) if i in settings.held_out]
    if wrong or not fitted:
        raise InputError(f"Cannot hold out {list(settings.held_out)} of {len(plays)} plays and fit to the rest.")
    started = time.monotonic()
    objective = Objective(model, free, fitted, settings.signals, settings.timestep, settings.nthread)
    problem = make_problem(objective, settings)
    identity = repr((method, settings.fitness, settings.seed, problem.names, problem.low, problem.high, problem.start,
                     objective.mean.tobytes(), objective.rollouts.commands.tobytes(), sorted(model.values().items()),
                     settings.timestep))  # fmt: skip
    journal = Journal(settings.journal, identity) if settings.journal else None
    interrupted = False
    evaluations = Evaluations(problem, journal, progress, settings.budget)
    try:
        before = float(evaluations.fitness(problem.to_unit(problem.start)[None])[0])
        try:
            method.run(evaluations, np.random.default_rng(settings.seed))
        except BudgetSpent:
            pass
        except KeyboardInterrupt:
            interrupted = True
        try:
            residuals, slopes = _around(evaluations)
            interval = intervals(slopes, residuals, problem.blocks)
            at = objective, fitted, problem, evaluations.best, residuals, slopes
            lacking = discrepancy(*at)
            interval = widened(interval, np.hypot(lacking.deviation, start_pose_deviation(*at)))
            apart = differing(*at, lacking.deviation)
        except KeyboardInterrupt:  # again: the user wants the values now, without intervals
            interrupted = True
            residuals, slopes, interval = np.zeros(0), np.empty((0, problem.size)), unknown_intervals(problem.size)
            lacking, apart = Discrepancy(np.empty((0, problem.size))), ()
    finally:
        if journal:
            journal.close()
    values = problem.from_unit(evaluations.best)
    at_bound = np.minimum(evaluations.best, 1.0 - evaluations.best) < AT_BOUND
    gain = promised_gain(slopes[:, ~at_bound], residuals)
    after_held = [float("nan")] * 2
    if kept:
        unseen = Objective(model, free, kept, settings.signals, settings.timestep, settings.nthread)
        judge = _fitness(unseen, settings)
        after_held = [float(f) for f in judge(unseen(np.stack([problem.start, values])))]
    span = problem.high - problem.low
    half = interval.half_width * span
    return Fit(
        method=method.name,
        fitness=settings.fitness,
        seed=settings.seed,
        parameters=tuple(
            Fitted(n, u, float(s), float(v), float(h), float(lo), float(hi), bool(b))
            for n, u, s, v, h, lo, hi, b in zip(
                *(problem.names, problem.units, problem.start, values),
                *(half, problem.low, problem.high, at_bound),
                strict=True,
            )
        ),
        before=before,
        after=evaluations.best_fitness,
        held_out_before=after_held[0],
        held_out_after=after_held[1],
        fitted_plays=tuple(play.name for play in fitted),
        held_out_plays=tuple(play.name for play in kept),
        converged=not interrupted and gain < PROMISED_GAIN,
        interrupted=interrupted,
        evaluations=evaluations.count,
        seconds=time.monotonic() - started,
        history=tuple(evaluations.history),
        warnings=(
            *_warnings(problem, at_bound, interval, gain, interrupted),
            *_doubts(interval, lacking, values, span, problem),
            *(one.sentence for one in apart),
        ),
        about=settings.about,
    )


def make_problem(objective: Objective, settings: Settings) -> Problem:
    """What the optimisers see of an objective: each value within its bounds and a span of where it starts."""
    infos = objective.model.parameters()
    chosen = [infos[name] for name in objective.free]
    return Problem(
        names=objective.free,
        units=tuple(info.unit for info in chosen),
        low=np.array([max(info.low, info.value - info.span) for info in chosen]),
        high=np.array([min(info.high, info.value + info.span) for info in chosen]),
        start=np.array([info.value for info in chosen]),
        residuals=settings.spread(objective) if settings.spread else objective,
        fitness=_fitness(objective, settings),
        blocks=objective.blocks,
    )


def _fitness(objective: Objective, settings: Settings) -> Fitness:
    if settings.fitness == "srg":
        return Dissimilarity(objective.lower, objective.upper)
    return CommandError(objective.weights)


def _around(evaluations: Evaluations) -> tuple[Array, Array]:
    """Residuals (R,) and their slopes (R, k) at the best, in the fitness's scaling."""
    # Not in the checkpoint either: a run that continues after an interruption makes other evaluations next.
    evaluations.limit, evaluations.progress, evaluations.journal = None, None, None
    return evaluations.around(evaluations.best, INTERVAL_STEP)


def promised_gain(slopes: Array, residuals: Array) -> float:
    """Share of the squared residuals that one full Gauss-Newton step would take away if the model were linear."""
    power = float(residuals @ residuals)
    if power == 0.0 or slopes.shape[1] == 0 or not np.isfinite(slopes).all():
        return 0.0
    step = np.linalg.lstsq(slopes, residuals, rcond=None)[0]
    if np.abs(step).max() < NEGLIGIBLE_STEP:
        return 0.0
    return float(np.sum((slopes @ step) ** 2)) / power


def _warnings(
    problem: Problem, at_bound: NDArray[np.bool_], interval: Intervals, gain: float, interrupted: bool
) -> tuple[str, ...]:
    warnings = []
    if interrupted:
        warnings.append("The fit was interrupted; the values are the best until then.")
    elif gain >= PROMISED_GAIN:
        warnings.append(
            f"The fit has not converged: the slope promises another {100 * gain:.0f} % of the squared error. "
            "Give it more evaluations or another seed."
        )
    for name, bound in zip(problem.names, at_bound, strict=True):
        if bound:
            warnings.append(
                f"{name} lies at its bound: the truth may lie beyond, or it stands in for a missing effect."
            )
    for direction in interval.loose:
        warnings.append(
            f"Not identifiable from these commands: {combination(direction, problem.names)} (in shares of the bounds) "
            "can change without the data objecting. Fix one of them, or record commands that excite it."
        )
    return tuple(warnings)


def _doubts(interval: Intervals, lacking: Discrepancy, values: Array, span: Array, problem: Problem) -> list[str]:
    """What the intervals do not say by themselves."""
    warnings = trade_offs(interval, values, span, problem.names, lacking.shifts)
    if lacking.likely:
        warnings.append(
            "The model leaves more than noise, so the intervals allow for what a missing effect would have shifted (of "
            f"those tried, {lacking.likely} explains most to first order). `diagnose` names it."
        )
    return warnings


#: Called before each fit with its part and its likely number of evaluations; gives what reports the fit's progress.
Bars = Callable[[Part, int], FitProgress]


@dataclass(frozen=True)
class PlayChange:
    """One recording before and after a fit.

    Attributes:
        name: of the play; held_out: whether it was held out of the fit.
        before, after: E_C, mean over the signals of the first one's unit, in `unit`.
    """

    name: str
    held_out: bool
    before: float
    after: float
    unit: str

    @property
    def change(self) -> float:
        """Error after the fit over that before it; 1 where there was none."""
        return self.after / self.before if 0.0 < self.before < np.inf else 1.0


@shown
@dataclass(frozen=True)
class CalibrationResult:
    """Attributes:
    model: with the fitted values, their source not recorded yet; see `signed`.
    parts, fits: what was fitted, and how it went; one unless fitted axis by axis, fewer after an interruption.
    before, after: scores on the fitted plays, signal by signal.
    held_out_before, held_out_after: on those held out; empty where none were.
    itself, held_out_itself: what the rig reaches against itself on the same plays, from `judge_rig`.
    plays: each recording, worst change first.
    """

    model: Model
    parts: tuple[Part, ...]
    fits: tuple[Fit, ...]
    before: tuple[Score, ...]
    after: tuple[Score, ...]
    held_out_before: tuple[Score, ...]
    held_out_after: tuple[Score, ...]
    itself: Mapping[str, Mapping[float, float]]
    held_out_itself: Mapping[str, Mapping[float, float]]
    plays: tuple[PlayChange, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Full parameter name -> fitted value."""
        return {name: value for fit in self.fits for name, value in fit.values.items()}

    @property
    def interrupted(self) -> bool:
        return any(fit.interrupted for fit in self.fits)

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*_worse(self.plays), *(text for fit in self.fits for text in fit.warnings))

    def signed(self, source: str, provenance: Mapping[str, Any]) -> Model:
        """The model with `source` at each fitted value, and `provenance`."""
        return replace(self.model.with_values(self.values, source), provenance=dict(provenance))


def _changes(plays: Sequence[Play], held_out: bool, before: _Judged, after: _Judged) -> list[PlayChange]:
    """Of plays that were judged before and after, mean over the signals of the first one's unit."""
    scores, then = before
    unit = scores[0].unit
    same = [score.unit == unit for score in scores]
    rows = zip(plays, then[:, same], after[1][:, same], strict=True)
    return [PlayChange(p.name, held_out, float(np.nanmean(b)), float(np.nanmean(a)), unit) for p, b, a in rows]


def _worse(plays: Sequence[PlayChange]) -> list[str]:
    """Recordings that a fit made worse, which a mean over all recordings hides."""
    worse = [play for play in plays if play.change > WORSE]
    listed = [
        f"{p.name} ({'held out' if p.held_out else 'fitted'}), {shown_value(p.before, p.unit)} before, "
        f"{shown_value(p.after, p.unit)} after"
        for p in worse[:WORSE_LISTED]
    ]
    more = f"; {len(worse) - WORSE_LISTED} more" if len(worse) > WORSE_LISTED else ""
    return (
        [f"Worse than before on {len(worse)} of {len(plays)} recordings: {'; '.join(listed)}{more}."] if worse else []
    )


def calibrate_model(
    model: Model,
    plays: Sequence[Play],
    free: Sequence[str],
    settings: Settings,
    axis_by_axis: bool = False,
    bars: Bars | None = None,
) -> CalibrationResult:
    """Fits a model to plays.

    Args:
        free: full parameter names.
        settings: `held_out` counts the plays as given here; a checkpoint of a fit axis by axis is one file for each
            axis, named after it.
        axis_by_axis: one fit after the other, each to its axis's signals, as in the paper; else one for all.

    Raises:
        InputError: see `calibrate`.
    """
    everything = Part("", tuple(free), settings.signals, tuple(range(len(plays))))
    parts = by_axis(model, free, plays, settings.signals) if axis_by_axis else [everything]
    fits: list[Fit] = []
    fitted = model
    for part in parts:
        held = tuple(at for at, number in enumerate(part.plays) if number in settings.held_out)
        if len(held) == len(part.plays):
            names = ", ".join(plays[i].name for i in part.plays)
            raise InputError(
                f"Every command that moves axis {part.axis} is held out ({names}). Hold out fewer, or draw others by "
                "another seed."
            )
        journal = settings.journal
        if journal is not None and part.axis:
            journal = journal.with_name(f"{journal.name}.{part.axis}")
        own = replace(settings, signals=part.signals, held_out=held, journal=journal)
        bar = bars(part, settings.budget or settings.optimiser().budget) if bars else None
        fit = calibrate(fitted, part.free, [plays[i] for i in part.plays], own, bar)
        fits.append(fit)
        fitted = fitted.with_values(fit.values, "fitted")
        if fit.interrupted:
            break
    seen = [play for number, play in enumerate(plays) if number not in settings.held_out]
    unseen = [play for number, play in enumerate(plays) if number in settings.held_out]
    scores: list[tuple[Score, ...]] = []
    changes: list[PlayChange] = []
    for some, kept in ((seen, False), (unseen, True)):
        judged = [_judged(m, some, settings.signals, KS, settings.timestep) for m in (model, fitted) if some]
        scores += [score for score, _ in judged] or [(), ()]
        changes += _changes(some, kept, *judged) if some else []
    itself, held_itself = (judge_rig(model, some, settings.signals) if some else {} for some in (seen, unseen))
    before, after, held_before, held_after = scores
    return CalibrationResult(
        fitted, tuple(parts[: len(fits)]), tuple(fits), before, after, held_before, held_after, itself, held_itself,
        tuple(sorted(changes, key=lambda change: -change.change)),
    )  # fmt: skip
