# SPDX-License-Identifier: Apache-2.0
"""Candidates: each effect of the library at each place of the rig, and one model that holds them all switched off.

At its off values an effect changes nothing, bit for bit, so roll-outs of all candidates can share one compiled model
and travel in one batch.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, effects
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

FACTORS = (0.1, 0.3, 1.0, 3.0)  # times an effect's typical strength
LIMITS = 7  # values of a limit, as of a torque's
TICKS = 128  # 2.7 % apart, for the valley of a tick is some 4 % wide
BALL_VALUES = 25


@dataclass(frozen=True)
class Candidate:
    """One effect at one place.

    Attributes:
        effect, place: as in `backlash.x.width`.
        axes: short names of the axes whose signals it can change; empty for the ball.
        parameters: full names of its parameters.
    """

    effect: Effect
    place: str
    axes: tuple[str, ...]
    parameters: tuple[str, ...]

    @property
    def name(self) -> str:
        """effect.place"""
        return f"{self.effect.name}.{self.place}"


@dataclass(frozen=True)
class Library:
    """The candidates and the model that holds them all.

    Attributes:
        model: the user's model with every candidate at its off values.
        base: full names of the values that are refitted with every candidate.
        candidates: in the library's order.
    """

    model: Model
    base: tuple[str, ...]
    candidates: tuple[Candidate, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """K full parameter names: base first, then every candidate's."""
        return self.base + tuple(name for c in self.candidates for name in c.parameters)

    def find(self, name: str) -> Candidate:
        """A candidate by effect.place. Raises InputError that lists the valid names."""
        for candidate in self.candidates:
            if candidate.name == name:
                return candidate
        raise InputError(unknown_name("candidate", name, [c.name for c in self.candidates]))


def library(model: Model, base: Sequence[str], with_ball: bool = False, only: Iterable[str] | None = None) -> Library:
    """Every effect that can act on the rig and is not in the model yet.

    Args:
        base: full names of the values refitted with every candidate.
        with_ball: whether effects on the ball are candidates.
        only: effect names to consider; all by default.
    """
    known = effects()
    unknown = [unknown_name("effect", name, known) for name in only or () if name not in known]
    if unknown:
        raise InputError(unknown)
    present = {(use.effect.name, use.place) for use in model.effects}
    found: list[Candidate] = []
    for effect in known.values():
        if (only is not None and effect.name not in set(only)) or (effect.where == "ball" and not with_ball):
            continue
        for place in model.places(effect):
            if (effect.name, place) in present:
                continue
            model = model.with_effect(effect, place, effect.off, "switched off")
            parameters = tuple(f"{effect.name}.{place}.{p.name}" for p in effect.parameters)
            found.append(Candidate(effect, place, axes_of(model, effect, place), parameters))
    return Library(model, tuple(base), tuple(found))


def axes_of(model: Model, effect: Effect, place: str) -> tuple[str, ...]:
    """Axes whose signals an effect can change at a place."""
    if effect.where == "ball":
        return ()
    if effect.where == "signal":
        return tuple(axis.name for axis in model.rig.axes if any(m.signal == place for m in axis.measured))
    return (place,)


def starts(candidate: Candidate) -> Array:
    """Values (s, k) of a candidate's parameters from which to look.

    Values that switch the effect are tried small, typical and large, of either sign; those that only shape it (a
    period, a characteristic speed) at a few places between their bounds. Delay and backlash have kinks and valleys, so
    one start is never enough.
    """
    declared = candidate.effect.parameters
    if is_tick(candidate):  # rounding fits at one value and hardly beside it
        ticks = np.tile([p.typical for p in declared], (TICKS, 1))
        ticks[:, 0] *= np.geomspace(0.1, 3.0, TICKS)
        return ticks
    if not candidate.axes and len(declared) == 1:  # of the ball: walls make the misfit rough
        spread = np.linspace(declared[0].low, declared[0].high, BALL_VALUES)[:, None]
        return spread[spread[:, 0] != declared[0].off]
    switching = [p for p in declared if p.off is not None]
    strengths = [[*row] for ladder in _ladders(switching) for row in ladder]
    shapes: list[list[float]] = [[]]
    for p in (p for p in declared if p.off is None):
        spread = np.geomspace(p.low, p.high, 7)[1:-1] if p.low > 0 else np.linspace(p.low, p.high, 5)[:-1]
        shapes = [[*row, float(v)] for row in shapes for v in spread]
    rows = []
    for strength in strengths:
        for shape in shapes:
            values = iter(strength), iter(shape)
            rows.append([next(values[0] if p.off is not None else values[1]) for p in declared])
    return np.unique(np.array(rows), axis=0)


def is_tick(candidate: Candidate) -> bool:
    """Whether it rounds to ticks, its first value: its misfit has no slope over the tick."""
    declared = candidate.effect.parameters
    return declared[0].name == "tick"


def _ladders(switching: Sequence[Parameter]) -> Iterator[Array]:
    """Values (s, k) from weak to strong: of either sign about the off values; of a limit, over all of its decades."""
    if all(p.off == p.high and p.low > 0 for p in switching):
        yield np.column_stack([np.geomspace(p.low, p.high, LIMITS + 2)[1:-1] for p in switching])
        return
    for sign in (1.0, -1.0):
        rows = []
        for factor in FACTORS:
            row = [(p.off or 0.0) + sign * factor * (p.typical - (p.off or 0.0)) for p in switching]
            rows.append([min(max(v, p.low), p.high) for v, p in zip(row, switching, strict=True)])
        table = np.array(rows)
        yield table[(table != [p.off for p in switching]).any(axis=1)]  # the mirrored value may lie outside the bounds
