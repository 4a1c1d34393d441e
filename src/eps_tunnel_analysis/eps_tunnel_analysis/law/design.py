# SPDX-License-Identifier: Apache-2.0
"""What forces and sensors' errors change, as one linear problem: the residuals of an axis, and how much of them columns
explain where they were left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law.missing_force import MissingForce, PlayAnswer
from labyrinth_sim.trials import Array

RIDGE = 1e-4  # of the mean square of what a column changes
BENDS = (0.0, 1e-2, 1.0)  # weights tried of a curve's squared curvature, in the same unit
DRAWS = 400  # of the block bootstrap

COMMAND = -1
"""Stands for an axis's command where a number stands for a sensor."""

Rows = Sequence[Array]
"""For each play, what acts over time, (n, K)."""


@dataclass(frozen=True)
class Design:
    """All residuals of an axis, linear in forces, or in errors of sensors or of the command: R samples, F stretches of
    time.

    Forces act on the motion with the missing force, which friction makes another than that without it. If a sensor or
    the command is wrong, no force is missing, so their errors are added to the model's own motion.

    Attributes:
        missing: the plays' answers.
        y: (R,) residuals without any force, in units of the noise floor.
        fold: (R,) stretch of time.
        base: (R, k) what refitted values can compensate for.
    """

    missing: MissingForce
    y: Array
    fold: NDArray[np.int64]
    base: Array
    plays: tuple[PlayAnswer, ...] = field(repr=False)

    @classmethod
    def of(cls, missing: MissingForce) -> "Design":
        """Of forces."""
        return cls._about(missing, missing.plays)

    @cached_property
    def _unforced(self) -> "Design":
        return self._about(self.missing, self.missing.unforced)

    def at(self, signal: int | None) -> "Design":
        """The one for the error of a sensor with this number, or of the COMMAND; None for a force."""
        return self if signal is None else self._unforced

    @classmethod
    def _about(cls, missing: MissingForce, plays: tuple[PlayAnswer, ...]) -> "Design":
        y = np.concatenate([p.residuals for p in plays])
        fold = np.concatenate([p.fold for p in plays])
        return cls(missing, y, fold, np.concatenate([p.base for p in plays]), plays)

    def columns(self, rows: Rows, signal: int | None = None, moved: Sequence[float] | None = None) -> Array:
        """(R, K) change of the residuals by what acts over time.

        Args:
            rows: for each play, forces (n, K) N m or errors of the command (n, K) rad at its nodes; or errors (r, K) at
                the samples of one sensor.
            signal: number of that sensor, COMMAND, or None for a force.
            moved: share of its length by which each play's rows are moved in time, around the end.
        """
        parts = []
        for i, (play, own) in enumerate(zip(self.plays, rows, strict=True)):
            shifted = own if moved is None else np.roll(own, round(moved[i] * len(own)), axis=0)
            if signal is None or signal == COMMAND:
                parts.append((play.answer if signal is None else self.missing.commanded[i]) @ shifted)
                continue
            here = np.flatnonzero(play.signal == signal)
            block = np.zeros((len(play.time), own.shape[1]))
            block[here] = shifted / play.scale[here, None]
            parts.append(block)
        return np.concatenate(parts)

    def angles(self, signal: int | None = None) -> list[Array]:
        """For each play the joint's angle at its nodes (n,), or at the samples (r,) of one sensor."""
        if signal is None:
            return [p.at_nodes(p.motion.angle) for p in self.plays]
        return self.seen(signal, [p.motion.angle for p in self.plays])

    def speeds(self, signal: int) -> list[Array]:
        """For each play the joint's speed (r,) at the samples of one sensor."""
        return self.seen(signal, [p.motion.speed for p in self.plays])

    def seen(self, signal: int, over: Sequence[Array]) -> list[Array]:
        """For each play what its motion has over time, at the samples (r,) of one sensor."""
        return [np.interp(p.time[p.signal == signal], p.motion.time, own)
                for p, own in zip(self.plays, over, strict=True)]  # fmt: skip


@dataclass(frozen=True)
class Explained:
    """What some columns explain on stretches of time that were left out.

    Attributes:
        share: of the misfit beyond what base values compensate for.
        stretches: (F, 2) sum of squares in each stretch without the columns and with them.
        weights: (K,) of the columns, fitted to everything.
        fall: by how many floors, on average over all samples.
    """

    share: float
    stretches: Array
    weights: Array
    fall: float

    @property
    def left(self) -> Array:
        """(F,) share of the misfit that is left in each stretch."""
        return np.asarray(self.stretches[:, 1] / max(float(self.stretches[:, 0].sum()), 1e-300))

    def interval(self, seed: int = 0) -> tuple[float, float]:
        """90 % of the share, by a bootstrap of the stretches."""
        rng = np.random.default_rng(seed)
        counts = rng.multinomial(len(self.stretches), np.full(len(self.stretches), 1 / len(self.stretches)), DRAWS)
        sums = counts @ self.stretches
        shares = 1.0 - sums[:, 1] / np.maximum(sums[:, 0], 1e-300)
        return float(np.quantile(shares, 0.05)), float(np.quantile(shares, 0.95))


class Predictor:
    """Least squares with each stretch of time left out in turn, for many sets of columns on the same residuals.

    Args:
        always: (R, k) columns besides the base values that are always there.
    """

    def __init__(self, design: Design, always: Array | None = None) -> None:
        base = design.base if always is None else np.hstack([design.base, always])
        self._order = np.argsort(design.fold, kind="stable")
        folds = design.fold[self._order]
        self._edges = np.flatnonzero(np.diff(folds, prepend=folds[0] - 1))[1:]
        self._always, self._y = self._stretches(base), self._stretches(design.y)
        self._own = np.array([y @ y for y in self._y])
        self._grams = np.array([a.T @ a for a in self._always])
        self._rights = np.array([a.T @ y for a, y in zip(self._always, self._y, strict=True)])
        self._size = base.shape[1]
        self._without = self._left_out(self._grams, self._rights)[0]

    def explained(self, columns: Array, curve: bool = False) -> Explained:
        """What columns (R, K) explain in addition to those that are always there.

        Args:
            curve: whether they are the neighbouring knots of a curve, as smooth as predicts best.
        """
        own, size = self._stretches(columns), self._size
        total = size + columns.shape[1]
        grams, rights = np.empty((len(own), total, total)), np.empty((len(own), total))
        grams[:, :size, :size], rights[:, :size] = self._grams, self._rights
        for f, (part, always, y) in enumerate(zip(own, self._always, self._y, strict=True)):
            grams[f, size:, size:] = part.T @ part
            grams[f, size:, :size] = part.T @ always
            grams[f, :size, size:] = grams[f, size:, :size].T
            rights[f, size:] = part.T @ y
        best: tuple[Array, Array] | None = None
        for bends in BENDS if curve else (0.0,):
            squares, weights = self._left_out(grams, rights, bends)
            if best is None or squares.sum() < best[0].sum():
                best = squares, weights
        assert best is not None
        share = 1.0 - best[0].sum() / max(self._without.sum(), 1e-300)
        fall = float((self._without - best[0]).sum() / len(self._order))
        return Explained(float(share), np.column_stack([self._without, best[0]]), best[1][size:], fall)

    def _stretches(self, rows: Array) -> list[Array]:
        return np.split(rows[self._order], self._edges)

    def _left_out(self, grams: Array, rights: Array, bends: float = 0.0) -> tuple[Array, Array]:
        """(F,) squares left in each stretch by a fit to the others, and (K,) weights fitted to all."""
        if not grams.shape[1]:
            return self._own.copy(), np.empty(0)
        gram, right = grams.sum(axis=0), rights.sum(axis=0)
        diagonal = np.diag(gram)
        ridge = np.diag(RIDGE * np.maximum(diagonal, 1e-12 * max(float(diagonal.max()), 1e-300)))
        if bends:
            knots = np.diff(np.eye(len(gram) - self._size), 2, axis=0)
            ridge[self._size :, self._size :] += bends * float(diagonal[self._size :].mean()) * knots.T @ knots
        weights = -np.linalg.solve(gram - grams + ridge, (right - rights)[:, :, None])[:, :, 0]
        bent = np.einsum("fk,fkl,fl->f", weights, grams, weights)
        squares = self._own + 2.0 * np.einsum("fk,fk->f", weights, rights) + bent
        return squares, -np.linalg.solve(gram + ridge, right)


def half_widths(design: Design, columns: Array) -> Array:
    """(K,) half of the 90 % interval of columns' weights (R, K), fitted to everything together with the base values."""
    every = np.hstack([design.base, columns])
    gram = every.T @ every
    ridge = np.diag(RIDGE * np.maximum(np.diag(gram), 1e-12 * max(float(np.diag(gram).max()), 1e-300)))
    inverse = np.linalg.inv(gram + ridge)
    remaining = design.y - every @ (inverse @ (every.T @ design.y))
    spread = max(float(np.mean(remaining**2)), 1.0) * SETTINGS.correlated
    return np.asarray(1.645 * np.sqrt(spread * np.diag(inverse))[design.base.shape[1] :])
