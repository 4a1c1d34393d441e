# SPDX-License-Identifier: Apache-2.0
"""Candidates: each effect of the library at each place of the rig, and one model that holds them all switched off.

At its off values an effect changes nothing, bit for bit, so roll-outs of all candidates can share one compiled model
and run in one batch.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eps_tunnel_analysis.diagnose.noise import TICK_SHARE
from eps_tunnel_analysis.fit.problem import full_name
from labyrinth_sim.effect import Effect, Parameter, Size
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

FACTORS = (0.1, 0.3, 1.0, 3.0)  # times an effect's typical strength
LIMITS = 7  # values of a limit, as of a torque's, at least
LIMITS_PER_DECADE = 3
TICKS_APART = 1.056  # times the next finer one: the valley of a tick is some 4 % wide, and its edges show
FINEST_TICK = 0.05  # of the typical one; the coarsest
COARSEST_TICK = 0.95  # of the largest
MULTIPLES = 64  # of a known tick
BALL_VALUES = 25
MOST_CROSSED = 2  # values that only shape an effect, of which all combinations are tried


@dataclass(frozen=True)
class Candidate:
    """One effect at one place.

    Attributes:
        effect, place: the first two parts of a name such as `backlash.x.width`.
        axes: short names of the axes whose signals it can change; empty for the ball.
        parameters: full names of its fitted parameters.
        given: its other parameters by short name, such as the range of a curve.
        size: of the axis, with which its parameters' bounds and typical values scale.
        register: the tick of the goals or the sensor at its place, from a data sheet; 0 if that is unknown.
        coarsest: the coarsest tick that a sensor's readings allow.
    """

    effect: Effect
    place: str
    axes: tuple[str, ...]
    parameters: tuple[str, ...]
    given: Mapping[str, float] = field(default_factory=dict)
    size: Size = field(default_factory=Size)
    register: float = 0.0
    coarsest: float = np.inf

    @property
    def declared(self) -> tuple[Parameter, ...]:
        """Declarations of the fitted parameters, for an axis of this size."""
        sized = tuple(p.sized(self.size) for p in self.effect.parameters if p.fitted)
        if not np.isfinite(self.coarsest):
            return sized
        tick = sized[0]
        most = min(tick.high, self.coarsest)
        return (replace(tick, high=most, typical=min(tick.typical, most)), *sized[1:])

    @property
    def free(self) -> tuple[str, ...]:
        """Full names of those that a descent moves; the others are one of a few choices."""
        declared = zip(self.parameters, self.declared, strict=True)
        return tuple(name for name, p in declared if not p.choices)

    @property
    def kinds(self) -> int:
        """Of how many kinds it may be: all combinations of the choices that its parameters have."""
        return math.prod(len(p.choices) for p in self.declared if p.choices)

    @property
    def possible(self) -> bool:
        """Whether readings allow a tick that could be missing: one coarser than the register's, and not too fine."""
        return np.isinf(self.coarsest) or self.coarsest >= max(TICK_SHARE * self.register, self.finest)

    @property
    def finest(self) -> float:
        """The finest tick that is tried, in its unit."""
        return FINEST_TICK * self.effect.parameters[0].sized(self.size).typical

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
        rough: how many of the base values, the last ones, are known roughly and are moved last.
    """

    model: Model
    base: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    rough: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """K full parameter names: base first, then every candidate's."""
        return self.base + tuple(name for c in self.candidates for name in c.parameters)

    @property
    def highest(self) -> Array:
        """(K,) what the values may be at most: a sensor's readings may allow less than its effect does."""
        return np.array([np.inf for _ in self.base] + [p.high for c in self.candidates for p in c.declared])

    def find(self, name: str) -> Candidate:
        """A candidate by effect.place. Raises InputError that lists the valid names."""
        for candidate in self.candidates:
            if candidate.name == name:
                return candidate
        raise InputError(unknown_name("candidate", name, [c.name for c in self.candidates]))

    def base_of(self, values: Array) -> dict[str, float]:
        """Full name -> value of the base, of values (K,)."""
        return dict(zip(self.base, map(float, values), strict=False))

    def with_base(self, values: Array, base: Array) -> Array:
        """(K,) values, but with another's base values: the first of `base`, (B,) or (K,)."""
        size = len(self.base)
        return np.concatenate([base[:size], values[size:]])

    def of(self, names: Iterable[str]) -> tuple[Candidate, ...]:
        """The candidates of these names, in their order."""
        return tuple(self.find(name) for name in names)


def library(model: Model, base: Sequence[str], with_ball: bool = False, only: Iterable[str] | None = None) -> Library:
    """Every effect that can act on the rig and is not in the model yet.

    Args:
        base: full names of the values refitted with every candidate.
        with_ball: whether effects on the ball are candidates.
        only: names of effects to consider, `backlash` or at one place `backlash.x`; by default all of the model's
            registry except free curves.

    Raises:
        InputError: a name that it does not know.
    """
    model.registry.check(only or ())
    present = {(use.effect.name, use.place) for use in model.effects}
    stated = {name for name, _ in present}
    candidates: list[Candidate] = []
    chosen = None if only is None else set(only)
    for effect in model.registry.effects.values():
        if effect.nameless and chosen is None:
            continue
        if effect.where == "ball" and not with_ball:
            continue
        for place in model.places(effect):
            wanted = chosen is None or effect.name in chosen or f"{effect.name}.{place}" in chosen
            if not wanted or (effect.name, place) in present or (effect.everywhere and effect.name in stated):
                continue
            model = model.with_effect(effect, place, effect.off, "switched off")
            candidates.append(candidate(model, effect, place))
    return Library(model, tuple(base), tuple(candidates))


def loosely_known(model: Model, name: str) -> bool:
    """Whether a free value is stated by more than a guess: its drive declares so, or it belongs to an effect."""
    if model.values()[name] == 0.0:
        return False
    declared = [full_name(axis, own) for axis in model.rig.axes for own in model.drives[axis.name].kind.loose]
    return name in declared or any(name.startswith(f"{use.effect.name}.{use.place}.") for use in model.effects)


def candidate(model: Model, effect: Effect, place: str, given: Mapping[str, float] | None = None) -> Candidate:
    """An effect at a place as a candidate; `given` are its parameters that are not fitted, typical unless stated."""
    parameters = tuple(f"{effect.name}.{place}.{p.name}" for p in effect.parameters if p.fitted)
    size = model.size(place)
    kept = {p.name: p.sized(size).typical for p in effect.parameters if not p.fitted} | dict(given or {})
    axes, register = axes_of(model, effect, place), _register(model, effect, place)
    return Candidate(effect, place, axes, parameters, kept, size, register)


def _register(model: Model, effect: Effect, place: str) -> float:
    """The tick that a data sheet gives for a sensor or an axis's goals, which may share a name; 0 if none does."""
    if effect.where == "signal":
        return next((m.resolution for m in model.rig.measured if m.signal == place), 0.0)
    drive = model.drives.get(place)
    goal_tick = drive.values.get("goal_tick") if drive else None
    return goal_tick.value if goal_tick else 0.0


def with_curves(lib: Library, ranges: Mapping[tuple[str, str], Mapping[str, float]]) -> Library:
    """A library with free curves as further candidates.

    Args:
        ranges: (free curve, place) -> the range that it covers, from `added_force.visited`.
    """
    model, candidates = lib.model, list(lib.candidates)
    for (name, place), given in ranges.items():
        effect = model.registry.effect(name)
        model = model.with_effect(effect, place, {**effect.off, **given}, "switched off")
        candidates.append(candidate(model, effect, place, given))
    return replace(lib, model=model, candidates=tuple(candidates))


def axes_of(model: Model, effect: Effect, place: str) -> tuple[str, ...]:
    """Axes whose signals an effect can change at a place."""
    if effect.where == "ball":
        return ()
    if effect.where == "signal":
        return tuple(axis.name for axis in model.rig.axes if any(m.signal == place for m in axis.measured))
    return (place,)


def is_rough(candidate: Candidate) -> bool:
    """Whether its misfit is rough, so that a start's promise means little: true for the ball, which hits walls."""
    return not candidate.axes and len(candidate.declared) == 1


def starts(candidate: Candidate) -> Array:
    """Values (s, k) of a candidate's parameters from which to start.

    Values that switch the effect are tried small, typical and large, of either sign; those that only shape it (a
    period, a characteristic speed) at a few places between their bounds. Delay and backlash have kinks and valleys, so
    one start is never enough.
    """
    declared = candidate.declared
    if candidate.effect.nameless:  # a table's values act one by one and in proportion
        return np.array([[p.off or 0.0 for p in declared]])
    if is_tick(candidate):  # rounding fits at one value and hardly next to it
        rows = roundings(declared)
        finest, coarsest = candidate.finest, COARSEST_TICK * declared[0].high
        tried = np.geomspace(finest, coarsest, round(np.log(coarsest / finest) / np.log(TICKS_APART)) + 1)
        if candidate.register > 0.0:  # a register that lacks bits has whole multiples of its tick
            most = min(int(coarsest / candidate.register), MULTIPLES)
            tried = np.append(tried, candidate.register * np.arange(2, most + 1))
        return _with_ticks(rows, tried)
    if is_rough(candidate):
        spread = np.linspace(declared[0].low, declared[0].high, BALL_VALUES)[:, None]
        return spread[spread[:, 0] != declared[0].off]
    switching = [p for p in declared if p.off is not None]
    strengths = [[*row] for ladder in _ladders(switching) for row in ladder]
    shaping = [p for p in declared if p.off is None]
    shapes: Iterable[Sequence[float]] = _one_by_one(shaping)
    if len(shaping) <= MOST_CROSSED:
        shapes = itertools.product(*map(_spread, shaping))
    elif len([p for p in shaping if not p.settled]) <= MOST_CROSSED:  # a descent moves the others
        shapes = itertools.product(*([p.typical] if p.settled else _spread(p) for p in shaping))
    rows = []
    for strength, shape in itertools.product(strengths, shapes):
        values = iter(strength), iter(shape)
        rows.append([next(values[0] if p.off is not None else values[1]) for p in declared])
    return np.unique(np.array(rows), axis=0)


def roundings(declared: Sequence[Parameter]) -> list[list[float]]:
    """Typical values, with every way to round."""
    return [list(row) for row in itertools.product(*(p.choices or (p.typical,) for p in declared))]


def _with_ticks(rows: Sequence[Sequence[float]], ticks: Array) -> Array:
    """Every one of some rows of values with each tick in its first place."""
    found = np.repeat(np.asarray(rows, dtype=np.float64), len(ticks), axis=0)
    found[:, 0] = np.tile(ticks, len(rows))
    return found


def _spread(p: Parameter) -> Array:
    """A few values of a parameter that only shapes an effect: those declared, or some between its bounds."""
    if p.begin or p.choices:
        return np.array(p.begin or p.choices)
    return np.geomspace(p.low, p.high, 7)[1:-1] if p.low > 0 else np.linspace(p.low, p.high, 5)[:-1]


def _one_by_one(shaping: Sequence[Parameter]) -> list[list[float]]:
    """All at their typical values, and each of them elsewhere."""
    typical = [p.typical for p in shaping]
    rows = [typical]
    for k, p in enumerate(shaping):
        rows += [[*typical[:k], float(v), *typical[k + 1 :]] for v in _spread(p)]
    return rows


def is_tick(candidate: Candidate) -> bool:
    """Whether it rounds to ticks, its first value: its misfit has no slope over the tick."""
    declared = candidate.effect.parameters
    return declared[0].name == "tick"


def _ladders(switching: Sequence[Parameter]) -> Iterator[Array]:
    """Values (s, k) from weak to strong: of either sign about the off values; for limits, over all of their decades,
    each by itself and together.
    """
    if all(p.off == p.high and p.low > 0 for p in switching):
        decades = max(np.log10(p.high / p.low) for p in switching)
        count = max(LIMITS, round(LIMITS_PER_DECADE * decades) - 1)
        together = np.column_stack([np.geomspace(p.low, p.high, count + 2)[1:-1] for p in switching])
        yield together
        for k in range(len(switching)):
            alone = np.tile([p.high for p in switching], (count, 1))
            alone[:, k] = together[:, k]
            yield alone
        return
    for sign in (1.0, -1.0):
        rows = []
        for factor in FACTORS:
            row = [(p.off or 0.0) + sign * factor * (p.typical - (p.off or 0.0)) for p in switching]
            rows.append([min(max(v, p.low), p.high) for v, p in zip(row, switching, strict=True)])
        table = np.array(rows)
        yield table[(table != [p.off for p in switching]).any(axis=1)]  # the mirrored value may lie outside the bounds
