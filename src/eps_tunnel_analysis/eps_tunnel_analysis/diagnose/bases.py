# SPDX-License-Identifier: Apache-2.0
"""All axes before one of them is searched: what couples to another axis turns along with that as it really moves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, Progress, axis_search
from eps_tunnel_analysis.diagnose.base_refit import base_refit
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.model import Model


@dataclass(frozen=True)
class Bases:
    """Base values of several axes, each refitted alone.

    Attributes:
        values: axis -> full name -> value, of axes that have any; empty for one axis, which has no others.
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
    nthread: int = 0,
    told: Progress | None = None,
) -> Bases:
    """The base values of every axis, with the other axes as the model has them."""
    found: dict[str, dict[str, float]] = {}
    evaluations = 0
    for part in [p for p in parts if p.base] if len(parts) > 1 else ():
        search = axis_search(model, plays, part, [], nthread=nthread, told=told)
        refit = base_refit(search)
        found[part.axis] = dict(zip(search.library.base, (float(v) for v in refit.values), strict=True))
        evaluations += search.evaluations
    return Bases(found, evaluations)
