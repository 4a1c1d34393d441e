# SPDX-License-Identifier: Apache-2.0
"""Calibration: fit a model's free values to recorded plays, and say how far the answer can be trusted."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.fit.cma import CmaEs
from eps_tunnel_analysis.fit.es import EvolutionStrategy
from eps_tunnel_analysis.fit.evaluations import BudgetSpent, Evaluations, Progress
from eps_tunnel_analysis.fit.fitness import CommandError, Dissimilarity, Fitness
from eps_tunnel_analysis.fit.gauss_newton import GaussNewton
from eps_tunnel_analysis.fit.intervals import Intervals, combination, intervals, jacobian, unknown_intervals
from eps_tunnel_analysis.fit.journal import Journal
from eps_tunnel_analysis.fit.objective import Objective
from eps_tunnel_analysis.fit.problem import Problem, Residuals
from eps_tunnel_analysis.fit.result import Fit, Fitted
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

STEP = 1e-4  # of the finite differences for the intervals, normalised
AT_BOUND = 1e-3  # normalised distance at which a value counts as at its bound
NEGLIGIBLE_STEP = 1e-4  # normalised; a promise this close by is no promise
PROMISED_GAIN = 0.05  # of the squared residuals; less counts as converged
FITNESS = ("error", "srg")


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
        journal: checkpoint file; a run that broke off goes on from it.
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
    progress: Progress | None = None,
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
                     objective.mean.tobytes(), sorted(model.values().items()), settings.timestep))  # fmt: skip
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
            found = intervals(slopes, residuals, problem.blocks)
        except KeyboardInterrupt:  # again: whoever waits wants the values, not how sure they are
            interrupted = True
            residuals, slopes, found = np.zeros(0), np.empty((0, problem.size)), unknown_intervals(problem.size)
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
    half = found.half_width * span
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
        warnings=_warnings(problem, at_bound, found, gain, interrupted),
        about=settings.about,
    )


def make_problem(objective: Objective, settings: Settings) -> Problem:
    """What the optimisers see of an objective."""
    infos = objective.model.parameters()
    chosen = [infos[name] for name in objective.free]
    return Problem(
        names=objective.free,
        units=tuple(info.unit for info in chosen),
        low=np.array([info.low for info in chosen]),
        high=np.array([info.high for info in chosen]),
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
    # Not in the checkpoint either: a run that goes on after an interruption asks other questions next.
    evaluations.limit, evaluations.progress, evaluations.journal = None, None, None
    z = evaluations.best
    steps = np.where(z + STEP <= 1.0, STEP, -STEP)
    scaled = evaluations.problem.fitness.scaled
    answers = np.nan_to_num(scaled(evaluations.residuals(np.vstack([z, z + np.diag(steps)]))))
    return answers[0], jacobian(answers[0], answers[1:], steps)


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
    problem: Problem, at_bound: NDArray[np.bool_], found: Intervals, gain: float, interrupted: bool
) -> tuple[str, ...]:
    told = []
    if interrupted:
        told.append("The fit was interrupted; the values are the best until then.")
    elif gain >= PROMISED_GAIN:
        told.append(
            f"The fit has not converged: the slope promises another {100 * gain:.0f} % of the squared error. "
            "Give it more evaluations or another seed."
        )
    for name, bound in zip(problem.names, at_bound, strict=True):
        if bound:
            told.append(f"{name} lies at its bound: the truth may lie beyond, or it stands in for a missing effect.")
    for direction in found.loose:
        told.append(
            f"Not identifiable from these commands: {combination(direction, problem.names)} (in shares of the bounds) "
            "can change without the data objecting. Fix one of them, or record commands that excite it."
        )
    return tuple(told)
