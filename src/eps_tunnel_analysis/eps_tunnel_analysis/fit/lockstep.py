# SPDX-License-Identifier: Apache-2.0
"""Many small least-squares problems descended side by side, so that each round is one batch of roll-outs.

Levenberg-Marquardt with a few dampings tried at once, in a box. A round costs each problem one roll-out per
free value for the Jacobian and one per damping for the step; the roll-outs of all problems go to the simulator
together.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.fit.differences import jacobian, moved
from labyrinth_sim.trials import Array

DAMPINGS = np.array([0.1, 1.0, 10.0])
FIRST_DAMPING = 1e-2
TRUST = 1e-12
LEAST_DAMPED = 1e-3  # damping of the step whose gain the slopes promise
KEPT_PROMISE = 0.25  # share of what cheaper slopes promise that a step has to gain, if their problem is to be certain
LEAST_PROMISE = 10.0  # times the tolerance: promising this much, slopes that led nowhere are taken by the simulator
RESCALED = 10.0  # times by which a finite difference grows or shrinks from round to round, at most
WIDER = 10.0  # times by which finite differences grow before a problem rests
SMALLEST_STEP, LARGEST_STEP = 1e-6, 0.05  # finite differences, normalised

#: (n, K) normalised values and (n,) the problem each row belongs to -> (n, R) residuals, NaN rows where diverged.
BatchResiduals = Callable[[Array, NDArray[np.int64]], Array]


@dataclass(frozen=True)
class Descent:
    """B problems after their descent.

    Attributes:
        z: (B, K) normalised values.
        cost: (B,) mean square of the residuals; inf where nothing finite was met.
        residuals: (B, R) at z.
        converged: (B,) the last round gained less than the tolerance.
        steps: (B, K) of the finite differences, normalised.
        evaluations: roll-outs in all.
    """

    z: Array
    cost: Array
    residuals: Array
    converged: NDArray[np.bool_]
    steps: Array
    evaluations: int


def descend(
    residuals: BatchResiduals,
    starts: Array,
    free: NDArray[np.bool_],
    rounds: int = 8,
    difference: float | Array = 1e-3,
    tolerance: float = 1e-4,
    hopeless: Callable[[Array], NDArray[np.bool_]] | None = None,
    response: float | None = None,
    relative: bool = False,
    slopes: BatchResiduals | None = None,
    width: float | Array = 1.0,
    near: float | None = None,
    certain: bool = False,
) -> Descent:
    """Descend every problem from its start.

    Args:
        residuals: the simulator.
        starts: (B, K) from 0 to width.
        free: (B, K) which values each problem may move.
        rounds: at most so many.
        difference: step of the finite differences, one for all or (K,), normalised.
        tolerance: relative gain below which a problem rests.
        hopeless: called with the costs (B,) after each round, returns which problems to stop early.
        response: root mean square by which a finite difference is to change the residuals; each is adapted to that.
            Too small a one measures the misfit's roughness from stiction and ticks instead of its slope; a problem
            that makes no progress continues with wider ones before it rests.
        relative: the response is a share of the root mean square that is left.
        slopes: a cheaper simulator, whose slopes replace the simulator's until a problem makes no progress with them.
        width: of the box, one for all values or (K,).
        near: of two problems that move the same values and whose residuals differ by less than this in mean square, or
            by less than its square of what the better one leaves, only that one goes on after a round. None for all.
        certain: a problem rests only where its own slopes let it, and takes these once the cheaper ones mislead it.
    """
    z = np.array(starts, dtype=np.float64)
    count, size = z.shape
    widths = np.broadcast_to(np.asarray(width, dtype=np.float64), (size,))
    z = np.clip(z, 0.0, widths)
    steps = np.tile(np.broadcast_to(np.asarray(difference, dtype=np.float64), (size,)), (count, 1))
    everyone = np.arange(count)
    at = residuals(z, everyone)
    cost = _cost(at)
    evaluations = count
    damping = np.full(count, FIRST_DAMPING)
    rest = ~np.isfinite(cost) | ~free.any(axis=1) | (cost == 0.0)
    converged = ~free.any(axis=1) | (cost == 0.0)
    jacobians: dict[int, tuple[Array, NDArray[np.int64]]] = {}
    cheap = np.full(count, slopes is not None)
    wide = np.ones(count)

    def stuck(b: int) -> None:
        """Continues with own slopes, then wider finite differences, or lets a problem rest that already has these."""
        if cheap[b] and certain:
            cheap[b] = False
            jacobians.pop(b, None)
            return
        if response is None or wide[b] == WIDER:
            rest[b] = converged[b] = True
            return
        wide[b] = WIDER
        damping[b] = FIRST_DAMPING
        steps[b] = np.minimum(steps[b] * WIDER, LARGEST_STEP)
        jacobians.pop(b, None)

    for _ in range(rounds):
        active = everyone[~rest]
        if len(active) == 0:
            break
        asked = np.array([b for b in active if b not in jacobians], dtype=np.int64)
        for simulator, own in ((slopes, asked[cheap[asked]]), (residuals, asked[~cheap[asked]])):
            if simulator is None or not len(own):
                continue
            here = at[own]
            if simulator is not residuals:
                here = simulator(z[own], own)
                evaluations += len(own)
            fresh, used = _jacobians(simulator, z, dict(zip(own, here, strict=True)), own, free, steps, widths)
            jacobians |= fresh
            evaluations += used
            if response is not None:
                for b, (jacobian, columns) in fresh.items():
                    size = np.sqrt(cost[b]) if relative else 1.0
                    steps[b, columns] = _adapted(steps[b, columns], jacobian, response * size * wide[b])
        tried = np.repeat(active, len(DAMPINGS))
        factors = np.tile(DAMPINGS, len(active)) * damping[tried]
        proposals = np.array(
            [_step(z[b], at[b], *jacobians[b], widths, f) for b, f in zip(tried, factors, strict=True)]
        )
        answers = residuals(proposals, tried)
        evaluations += len(tried)
        costs = _cost(answers).reshape(len(active), -1)
        for row, b in enumerate(active):
            winner = int(np.argmin(costs[row]))
            if costs[row, winner] >= cost[b]:
                furthest = _step(z[b], at[b], *jacobians[b], widths, LEAST_DAMPED)
                promise = _promise(z[b], at[b], *jacobians[b], furthest)
                if cheap[b] and promise > LEAST_PROMISE * tolerance:
                    cheap[b] = False
                    del jacobians[int(b)]
                    continue
                damping[b] *= 30.0
                if damping[b] > 1e6 or promise < tolerance:  # more damping promises even less
                    stuck(int(b))
                continue
            gain = 1.0 - costs[row, winner] / cost[b]
            pick = row * len(DAMPINGS) + winner
            if cheap[b] and certain:
                cheap[b] = gain >= KEPT_PROMISE * _promise(z[b], at[b], *jacobians[b], proposals[pick])
            z[b], at[b], cost[b] = proposals[pick], answers[pick], costs[row, winner]
            del jacobians[int(b)]
            damping[b] = np.clip(factors[pick] / 3.0, 1e-9, 1e6)
            if gain < tolerance:
                stuck(int(b))
        if hopeless is not None:
            rest |= hopeless(cost)
        if near is not None:
            rest |= _met(at, cost, rest, free, near)
    return Descent(z, cost, at, converged, steps / wide[:, None], evaluations)


class Race:
    """Which descents are given up after each round.

    Args:
        first: rounds that all of them make.
        reach: times the lowest cost above which one is given up.
        best: cost that was reached before; it counts as the lowest if it is.
    """

    def __init__(self, first: int, reach: float, best: float = np.inf) -> None:
        self.first, self.reach, self.best = first, reach, best
        self.rounds = 0

    def __call__(self, cost: Array) -> NDArray[np.bool_]:
        """(B,) whether each of the problems with costs (B,) after one more round is hopeless."""
        self.rounds += 1
        return np.asarray((self.rounds >= self.first) & (cost > self.reach * min(self.best, float(cost.min()))))


def _met(at: Array, cost: Array, rest: NDArray[np.bool_], free: NDArray[np.bool_], near: float) -> NDArray[np.bool_]:
    """(B,) which problems that do not `rest` (B,) have come to where a better one with the same free values is."""
    met = np.zeros(len(cost), dtype=bool)
    better: list[np.intp] = []
    for b in np.argsort(cost, kind="stable"):
        if not np.isfinite(cost[b]):
            break
        rivals = [] if rest[b] else [other for other in better if np.array_equal(free[b], free[other])]
        met[b] = any(np.mean((at[b] - at[o]) ** 2) < near * max(1.0, near * cost[o]) for o in rivals)
        if not met[b]:
            better.append(b)
    return met


def _cost(residuals: Array) -> Array:
    with np.errstate(over="ignore"):
        mean = np.mean(residuals**2, axis=1)
    return np.where(np.isfinite(mean), mean, np.inf)


def _jacobians(
    residuals: BatchResiduals,
    z: Array,
    at: Mapping[int, Array],
    active: NDArray[np.int64],
    free: NDArray[np.bool_],
    steps: Array,
    widths: Array,
) -> tuple[dict[int, tuple[Array, NDArray[np.int64]]], int]:
    """For each active problem its Jacobian (R, k) and the k columns of z it belongs to."""
    columns = {int(b): np.flatnonzero(free[b]) for b in active}
    points = {b: moved(z[b], steps[b], c, widths) for b, c in columns.items()}
    owners = np.concatenate([np.full(len(c), b) for b, c in columns.items()])
    answers = residuals(np.concatenate([where for where, _ in points.values()]), owners)
    slopes = {b: (jacobian(at[b], answers[owners == b], points[b][1]), c) for b, c in columns.items()}
    return slopes, len(owners)


def _promise(z: Array, at: Array, jacobian: Array, columns: NDArray[np.int64], ahead: Array) -> float:
    """Share of the cost that these slopes say is gained by going from z (K,) to `ahead` (K,)."""
    left = at + jacobian @ (ahead - z)[columns]
    return 1.0 - float(np.sum(left**2) / max(np.sum(at**2), np.finfo(float).tiny))


def _adapted(steps: Array, slopes: Array, response: float) -> Array:
    """(k,) finite differences that change residuals with slopes (R, k) by about `response`."""
    change = np.sqrt(np.mean(slopes**2, axis=0)) * steps
    factors = response / np.maximum(change, 1e-12)
    return np.asarray(np.clip(steps * np.clip(factors, 1.0 / RESCALED, RESCALED), SMALLEST_STEP, LARGEST_STEP))


def _step(z: Array, at: Array, jacobian: Array, columns: NDArray[np.int64], widths: Array, damping: float) -> Array:
    """One damped Gauss-Newton step, kept in the box; values pressed against a bound stay there for this step."""
    gradient = jacobian.T @ at
    here, most = z[columns], widths[columns]
    pressed = ((here <= 0.0) & (gradient > 0.0)) | ((here >= most) & (gradient < 0.0))
    moving = np.flatnonzero(~pressed)
    target = z.copy()
    if len(moving) == 0:
        return target
    j = jacobian[:, moving]
    normal = j.T @ j
    scale = np.diag(normal).copy()
    scale += TRUST * max(scale.max(), np.finfo(float).tiny)
    normal += damping * np.diag(scale)
    low, high = -here[moving], (most - here)[moving]
    step, held = np.zeros(len(moving)), np.zeros(len(moving), dtype=bool)
    while not held.all():
        rest = ~held
        right = -gradient[moving][rest] - normal[np.ix_(rest, held)] @ step[held]
        step[rest] = np.linalg.lstsq(normal[np.ix_(rest, rest)], right, rcond=None)[0]
        beyond = rest & ((step < low) | (step > high))
        if not beyond.any():
            break
        # Values that would go too far stop at their bounds, and the others compensate for that.
        step, held = np.clip(step, low, high), held | beyond
    target[columns[moving]] = np.clip(here[moving] + step, 0.0, most[moving])
    return target
