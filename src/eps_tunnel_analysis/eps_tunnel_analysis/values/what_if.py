# SPDX-License-Identifier: Apache-2.0
"""What one play would have looked like with another value of the model; prepared once, so that an answer is quick."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.alikeness import KS, Alikeness, alikeness_over_k, rig_against_itself
from eps_tunnel_analysis.simulated import Diverged, Play, compared_signals, rollouts
from eps_tunnel_analysis.tunnel import build_tunnel, smooth
from eps_tunnel_analysis.values.sweep import as_trials, near, with_effects
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array, locked


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
    found = [
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
            found += [Adjustable(i.name, i.unit, i.value, i.low, i.high, held=False) for i in switches]
    return tuple(a for a in found if a.low < a.high)


class WhatIf:
    """One play, simulated again and again with another value.

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
            InputError: an unknown name, a value out of bounds, or one that is known of the recordings.
        """
        if name in self.play.known:
            raise InputError(f"{name} is known of these recordings ({self.play.known[name]:g}), so it is not moved.")
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
