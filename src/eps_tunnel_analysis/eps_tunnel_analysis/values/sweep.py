# SPDX-License-Identifier: Apache-2.0
"""What a change of one value, or of two together, would do to the alikeness and to the error.

A sweep goes over a range of them. A `WhatIf` is prepared once for one play, so that each value is answered quickly.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from eps_tunnel_analysis.alikeness import KS, Alikeness, alikeness_over_k, joint_against_itself, rig_against_itself
from eps_tunnel_analysis.error import command_error
from eps_tunnel_analysis.outputs import plain
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import Diverged, compared_signals, rollouts
from eps_tunnel_analysis.tunnel import build_tunnel, smooth
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array, Trials, locked

POINTS = 41  # of one value
POINTS_OF_A_PAIR = 15  # of each of two
MOST = 20_000  # points in all
POINTS_AT_ONCE = 64  # points that are simulated together
NEAR = (0.5, 2.0)  # times the model's value, if no range is given


@dataclass(frozen=True)
class SweptValue:
    """One value that is varied.

    Attributes:
        name, unit: the full parameter name and its unit.
        given: the model's own value.
        points: (n,) what is tried, in rising order.
    """

    name: str
    unit: str
    given: float
    points: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", locked(self.points))


@dataclass(frozen=True)
class Sweep:
    """Alikeness and error over one value or a pair.

    Attributes:
        values: the one or two that were varied.
        signals, units: m that were compared.
        ks: K factors on the real tunnel's width, rising.
        errors: (n,) or (n, n2) by m; E of equation 10, mean over the plays; inf where the simulation diverged.
        alikeness: the same by (K, m): share of all seen samples of the plays.
        joint: the same by (K,): share of samples alike in every signal.
        itself: (K,) what the rig reaches against itself, jointly; NaN with too few trials.
        notes: what was also done, in words.
    """

    values: tuple[SweptValue, ...]
    signals: tuple[str, ...]
    units: tuple[str, ...]
    ks: tuple[float, ...]
    errors: Array
    alikeness: Array
    joint: Array
    itself: tuple[float, ...]
    notes: tuple[str, ...] = ()

    @property
    def mean_error(self) -> Array:
        """(n,) or (n, n2): mean over the signals of the first one's unit, in that unit."""
        return np.asarray(self.errors[..., [u == self.units[0] for u in self.units]].mean(axis=-1))

    def best(self, of: Array, largest: bool) -> tuple[dict[str, float], float]:
        """Full name -> value where a figure (n,) or (n, n2) is best, and the figure there.

        On a plateau, such as an alikeness of 1, the middle one in the order of the points.
        """
        best = np.max(of) if largest else np.min(of)
        at = np.flatnonzero(of == best)
        where = np.unravel_index(at[len(at) // 2], of.shape)
        return {v.name: float(v.points[i]) for v, i in zip(self.values, where, strict=True)}, float(best)

    def rows(self) -> tuple[tuple[str, ...], list[tuple[float, ...]]]:
        """Header and rows in SI units, one for each point."""
        header = [v.name for v in self.values]
        header += [f"error_{s}" for s in self.signals]
        for k in self.ks:
            header += [*(f"alikeness_{s}_k{k:g}" for s in self.signals), f"alikeness_jointly_k{k:g}"]
            header += [f"alikeness_jointly_k{k:g}_rig"]
        rows = []
        for where in np.ndindex(*self.joint.shape[:-1]):
            row = [float(v.points[i]) for v, i in zip(self.values, where, strict=True)]
            row += self.errors[where].tolist()
            for i in range(len(self.ks)):
                row += [*self.alikeness[where][i].tolist(), float(self.joint[where][i]), self.itself[i]]
            rows.append(tuple(row))
        return tuple(header), rows

    def to_json(self) -> dict[str, Any]:
        """Plain dicts, lists, numbers and words; SI units."""
        least, error = self.best(self.mean_error, largest=False)
        content = {
            "values": [
                {"name": v.name, "unit": v.unit, "given": v.given, "points": v.points.tolist()} for v in self.values
            ],
            "signals": list(self.signals),
            "units": list(self.units),
            "k": list(self.ks),
            "least_error": {"at": least, "error": error},
            "most_alike": [
                {"k": k, "at": at, "alikeness": share, "rig_against_itself": rig}
                for k, (at, share), rig in zip(self.ks, self._most_alike(), self.itself, strict=True)
            ],
            "errors": self.errors.tolist(),
            "alikeness": self.alikeness.tolist(),
            "jointly": self.joint.tolist(),
            "notes": list(self.notes),
        }
        return {key: plain(value) for key, value in content.items()}

    def _most_alike(self) -> list[tuple[dict[str, float], float]]:
        return [self.best(self.joint[..., i], largest=True) for i in range(len(self.ks))]


def sweep(
    model: Model,
    plays: Sequence[Play],
    asked: Sequence[str],
    ks: Sequence[float] = KS,
    signals: Sequence[str] | None = None,
    nthread: int = 0,
    progress: Callable[[str, int], None] | None = None,
) -> Sweep:
    """Simulates the plays at every point and compares each with the recordings, as `compare` does.

    Args:
        asked: one or two `NAME`, `NAME=LOW:HIGH` or `NAME=LOW:HIGH:POINTS`. An effect that the model lacks is added,
            switched off except for what is swept.
        ks: factors on the real tunnel's width.
        progress: called with what is being done and how many points are done.

    Raises:
        InputError: unknown names, ranges out of bounds, more than two values, or what a comparison refuses.
    """
    if not 1 <= len(asked) <= 2:
        raise InputError(f"Sweep one value or two, got {len(asked)}: {', '.join(asked)}.")
    model, notes = with_effects(model, asked)
    known = {name for play in plays for name in play.known}
    values = _values(model, asked, known)
    factors = tuple(sorted({float(k) for k in ks}))
    names = compared_signals(model, [play.trials for play in plays], signals)
    runs = rollouts(model, plays)
    real = [play.trials.select(names) for play in plays]
    tunnels = [smooth(build_tunnel(trials)) for trials in real]
    points = np.array(list(product(*(v.points for v in values))))
    errors = np.zeros((len(points), len(names)))
    alike = np.zeros((len(points), len(factors), len(names)))
    jointly = np.zeros((len(points), len(factors)))
    seen, seen_jointly = np.zeros(len(names)), 0.0
    for tunnel in tunnels:
        there = ~np.isnan(tunnel.mean)
        seen, seen_jointly = seen + there.sum(axis=0), seen_jointly + float(there.all(axis=1).sum())
    for low in range(0, len(points), POINTS_AT_ONCE):
        some = points[low : low + POINTS_AT_ONCE]
        answers, _, _ = runs.simulate(model, [v.name for v in values], some, names, nthread)
        for row, answer in enumerate(answers, start=low):
            for number, (trials, tunnel) in enumerate(zip(real, tunnels, strict=True)):
                own = answer[runs.play == number][:, : len(trials.time)]
                if np.isnan(own).any():
                    errors[row] = np.inf
                    continue
                sim = build_tunnel(as_trials(trials, own))
                errors[row] += [
                    command_error(a, b) / len(plays) for a, b in zip(tunnel.mean.T, sim.mean.T, strict=True)
                ]
                for i, at_k in enumerate(alikeness_over_k(tunnel, smooth(sim), factors)):
                    alike[row, i] += at_k.alike.sum(axis=0)
                    jointly[row, i] += at_k.alike.all(axis=1).sum()
        if progress:
            progress("points", low + len(some))
    shape = tuple(len(v.points) for v in values)
    units = dict(zip(model.rig.signals, model.rig.units, strict=True))
    return Sweep(
        values=values,
        signals=names,
        units=tuple(units[n] for n in names),
        ks=factors,
        errors=locked(errors.reshape(*shape, -1)),
        alikeness=locked((alike / np.maximum(seen, 1.0)).reshape(*shape, len(factors), -1)),
        itself=tuple(joint_against_itself(real, factors).values()),
        joint=locked((jointly / max(seen_jointly, 1.0)).reshape(*shape, -1)),
        notes=notes,
    )


def as_trials(real: Trials, values: Array) -> Trials:
    """Simulated values (c, T, m) of one play, on its grid."""
    commands = np.broadcast_to(real.commands[:1], (len(values), *real.commands.shape[1:]))
    return Trials(real.time, real.signals, real.units, values, real.command_channels, commands)


def with_effects(model: Model, asked: Sequence[str]) -> tuple[Model, tuple[str, ...]]:
    """The model with the effects whose parameters are asked for, and a sentence on each that was added."""
    notes = []
    for text in asked:
        effect, _, rest = text.partition("=")[0].partition(".")
        place = rest.rpartition(".")[0]
        if effect not in model.registry.effects or place not in model.places(effect):
            continue
        if any((use.effect.name, use.place) == (effect, place) for use in model.effects):
            continue
        model = model.with_effect(effect, place, model.registry.effects[effect].off, "switched off")
        notes.append(f"The model has no {effect}.{place}; it is added, switched off except for what is swept.")
    return model, tuple(notes)


def _values(model: Model, asked: Sequence[str], known: set[str]) -> tuple[SweptValue, ...]:
    infos = model.parameters()
    complaints: list[str] = []
    values: list[SweptValue] = []
    for text in asked:
        name, equals, given = text.partition("=")
        if name not in infos:
            complaints.append(unknown_name("parameter", name, infos))
            continue
        if name in known:
            complaints.append(f"{name} is given as known for some recordings, so it cannot be swept. Omit its --known.")
        if name in [v.name for v in values]:
            complaints.append(f"{name} is named twice; sweep two different values.")
        info = infos[name]
        low, high = near(info.value, info.low, info.high)
        count = POINTS if len(asked) == 1 else POINTS_OF_A_PAIR
        if equals:
            try:
                low, high, count = _range(given, count)
            except ValueError:
                complaints.append(f"{text}: expected {name}=LOW:HIGH or {name}=LOW:HIGH:POINTS, as {name}=0.5:2:21.")
                continue
        if not (info.low <= low < high <= info.high and math.isfinite(low) and math.isfinite(high)):
            bounds = f"[{info.low:g}, {info.high:g}] {info.unit}"
            complaints.append(f"{text}: expected LOW below HIGH, both within {bounds}, got {low:g} and {high:g}.")
            continue
        if count < 2:
            complaints.append(f"{text}: expected at least 2 points, got {count}.")
            continue
        points = np.linspace(low, high, min(count, MOST + 1))
        if not equals and low < info.value < high:  # the model's own value is one of them
            points[np.argmin(np.abs(points - info.value))] = info.value
        values.append(SweptValue(name, info.unit, info.value, points))
    total = math.prod(len(v.points) for v in values)
    if total > MOST:
        complaints.append(f"{total} points are too many; ask for at most {MOST} in all.")
    if complaints:
        raise InputError(complaints)
    return tuple(values)


def _range(text: str, points: int) -> tuple[float, float, int]:
    """LOW:HIGH[:POINTS]. Raises ValueError for anything else."""
    low, high, *rest = text.split(":")
    if len(rest) > 1:
        raise ValueError(text)
    return float(low), float(high), int(rest[0]) if rest else points


def near(value: float, low: float, high: float) -> tuple[float, float]:
    """Half to twice the value, within the bounds; all of these around a value of 0."""
    if value == 0.0:
        return low, high
    ends = sorted(factor * value for factor in NEAR)
    return max(ends[0], low), min(ends[1], high)


@dataclass(frozen=True)
class Adjustable:
    """One value that can be moved.

    Attributes:
        name, unit: the full parameter name and its unit.
        given: what the model has; of an effect that it lacks, what switches this off.
        low, high: ends of the range that is offered, within the bounds.
        held: whether the model has it; False for an effect that it lacks.
    """

    name: str
    unit: str
    given: float
    low: float
    high: float
    held: bool


@dataclass(frozen=True)
class WhatIfAnswer:
    """The play with one value changed.

    Attributes:
        simulated: (T, m), mean over the roll-outs where the trials' commands differ.
        alikeness: at each factor k, rising.
    """

    simulated: Array
    alikeness: tuple[Alikeness, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "simulated", locked(self.simulated))


def adjustable(model: Model) -> tuple[Adjustable, ...]:
    """Values that can be moved: the model's own, half to twice, and what brings in each effect that it lacks."""
    values = [
        Adjustable(i.name, i.unit, i.value, *near(i.value, i.low, i.high), held=True)
        for i in model.parameters().values()
    ]
    for effect in model.registry.effects.values():
        for place in () if effect.nameless else model.places(effect):
            if any((use.effect.name, use.place) == (effect.name, place) for use in model.effects):
                continue
            infos = model.with_effect(effect.name, place, effect.off, "switched off").parameters()
            added = (infos[f"{effect.name}.{place}.{p.name}"] for p in effect.parameters)
            # Those that switch the effect on by themselves.
            switches = (i for i in added if i.off is not None)
            values += [Adjustable(i.name, i.unit, i.value, i.low, i.high, held=False) for i in switches]
    return tuple(a for a in values if a.low < a.high)


class WhatIf:
    """What one play would have looked like with another value: simulated again and again, prepared once.

    Attributes:
        model, play: as given.
        tunnel: of the play's trials, smoothed by equation 12.
        ks: factors on its width, rising.
        itself: what the rig reaches against itself at each k; empty with too few trials.
        given: the answer of the model as it is.
    """

    def __init__(self, model: Model, play: Play, ks: Sequence[float] = KS, nthread: int = 1) -> None:
        """Prepares the play.

        Raises:
            Diverged: the simulation of the model as it is went out of bounds.
            InputError: the play lacks commands or positions of the rig.
        """
        self.model, self.play, self._nthread = model, play, nthread
        self.ks = tuple(sorted({float(k) for k in ks}))
        self._names = compared_signals(model, [play.trials])
        self._real = play.trials.select(self._names)
        self.tunnel = smooth(build_tunnel(self._real))
        self.itself = rig_against_itself(self._real, self.ks)
        self._runs = rollouts(model, [play])
        self.given = self._answer(model, (), ())

    def with_value(self, name: str, value: float) -> WhatIfAnswer:
        """The answer with one value changed.

        Args:
            name: a full parameter name; of an effect that the model lacks, all its other values switch it off.
            value: within the parameter's bounds, in its unit.

        Raises:
            Diverged: the simulation went out of bounds.
            InputError: an unknown name, a value out of bounds, or one that is known for the recordings.
        """
        if name in self.play.known:
            raise InputError(f"{name} is known for these recordings ({self.play.known[name]:g}), so it is not moved.")
        model, _ = with_effects(self.model, (name,))
        infos = model.parameters()
        if name not in infos:
            raise InputError(unknown_name("parameter", name, infos))
        info = infos[name]
        if not info.low <= value <= info.high:
            raise InputError(f"{name} must lie within [{info.low:g}, {info.high:g}] {info.unit}, got {value:g}.")
        return self._answer(model, (name,), (value,))

    def _answer(self, model: Model, names: Sequence[str], values: Sequence[float]) -> WhatIfAnswer:
        table = np.array([values], dtype=float).reshape(1, len(names))
        answers, _, why = self._runs.simulate(model, names, table, self._names, self._nthread)
        if why:
            raise Diverged(f"With this value the simulation of '{model.name}' {why}. Try one nearer to the model's.")
        simulated = build_tunnel(as_trials(self._real, answers[0]))
        return WhatIfAnswer(simulated.mean, alikeness_over_k(self.tunnel, smooth(simulated), self.ks))
