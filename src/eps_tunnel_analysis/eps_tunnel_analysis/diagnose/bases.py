# SPDX-License-Identifier: Apache-2.0
"""All axes before one of them is searched: what couples to another axis turns along with that as it really moves.

Where nothing couples, the others need no such care.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, Progress, axis_search
from eps_tunnel_analysis.diagnose.base_refit import base_refit
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.effect import effects
from labyrinth_sim.model import Model


@dataclass(frozen=True)
class Bases:
    """Base values of several axes, each refitted alone.

    Attributes:
        values: axis -> full name -> value, of axes that have any; empty where no axis is moved by another.
        evaluations: roll-outs that it took.
    """

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    evaluations: int = 0

    def among(self, model: Model, axis: str) -> Model:
        """The model as one axis is searched on it: the other axes with their refitted values."""
        others = {n: v for other, values in self.values.items() if other != axis for n, v in values.items()}
        return model.with_values(others, "refitted")


def fitted_bases(
    model: Model,
    plays: Sequence[Play],
    parts: Sequence[AxisPart],
    only: Iterable[str] | None = None,
    nthread: int = 0,
    told: Progress | None = None,
) -> Bases:
    """The base values of every axis, with the other axes as the model has them.

    Args:
        only: names of the effects that will be considered; all of the library by default.
    """
    found: dict[str, dict[str, float]] = {}
    evaluations = 0
    for part in [p for p in parts if p.base] if len(parts) > 1 and _coupled(model, only) else ():
        search = axis_search(model, plays, part, [], nthread=nthread, told=told)
        refit = base_refit(search)
        found[part.axis] = dict(zip(search.library.base, (float(v) for v in refit.values), strict=True))
        evaluations += search.evaluations
    return Bases(found, evaluations)


def _coupled(model: Model, only: Iterable[str] | None) -> bool:
    """Whether an effect that the model has, or may get, couples axes."""
    known = effects()
    considered = known if only is None else set(only) & set(known)
    return any(use.effect.couples for use in model.effects) or any(known[name].couples for name in considered)
