# SPDX-License-Identifier: Apache-2.0
"""Refits without a diagnosis: the values that a model has, one effect beside them, and what is left of other plays."""

from collections.abc import Sequence

import numpy as np

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.base_values import fitted_bases
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.build import axes_couple
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

DELAYS = (0.005, 0.015, 0.025, 0.035)  # s, tried besides the model's own: no descent leaves a wrong one
FIRST, LAST = 4, 6  # rounds of descent
TRIED = 4  # starts of an effect that are descended


def quick_bases(model: Model, plays: Sequence[Play], parts: Sequence[AxisPart], nthread: int = 0) -> Model:
    """A model with the base values of every axis refitted from its own, at a tenth of a diagnosis's roll-outs."""
    for _ in range(2 if len(parts) > 1 and axes_couple(model) else 1):
        for part in parts:
            search = axis_search(model, plays, part, SearchOptions((), nthread))
            starts = [search.start]
            for column in (search.library.names.index(n) for n in part.base if n.endswith(".delay")):
                for delay in DELAYS:
                    starts.append(search.start.copy())
                    starts[-1][column] = np.clip(delay, search.low[column], search.high[column])
            early = sorted(search.refit([((), s) for s in starts], FIRST, rough=False), key=lambda r: r.cost)[:2]
            late = search.refit([((), r.values) for r in early], LAST, "fine")
            model = _with_base(model, search, min(late, key=lambda r: r.cost).values)
    return model


def thorough_bases(model: Model, plays: Sequence[Play], parts: Sequence[AxisPart], nthread: int = 0) -> Model:
    """The same as a diagnosis does it."""
    return model.with_values(fitted_bases(model, plays, parts, SearchOptions((), nthread)).values, "refitted")


def _with_base(model: Model, search: Search, values: Array) -> Model:
    named = dict(zip(search.library.base, (float(v) for v in values), strict=False))
    return model.with_values(named, "refitted")


def with_effect_fitted(model: Model, plays: Sequence[Play], axis: str, name: str, nthread: int = 0) -> Model:
    """A model with an effect of the library, `EFFECT.PLACE`, fitted together with an axis's base values."""
    part = next(p for p in axis_parts(model, plays) if p.name == axis)
    search = axis_search(model, plays, part, SearchOptions((name,), nthread))
    own = search.library.find(name)
    base = search.refit([((), search.start)], 1)[0]
    points = search.trial_points([base], [own])[:TRIED]
    early = search.refit([((own,), p.values) for p in points], FIRST)
    late = search.refit([((own,), r.values) for r in sorted(early, key=lambda r: r.cost)[:2]], LAST, "fine")
    best = min(late, key=lambda r: r.cost).values
    fitted = dict(zip(search.library.names, (float(v) for v in best), strict=True))
    result = _with_base(model.with_effect(own.effect, own.place, own.given), search, best)
    return result.with_values({n: fitted[n] for n in own.parameters}, "fitted")


def worst_on(model: Model, plays: Sequence[Play], part: AxisPart, nthread: int = 0) -> float:
    """Floors that a model leaves of the worst signal of an axis in plays, nothing being fitted."""
    search, residuals = _as_it_is(model, plays, part, nthread)
    return worst_floors(residuals, search.signal)


def floors_on(model: Model, plays: Sequence[Play], axis: str, nthread: int = 0) -> float:
    """Mean square in units of the noise floor that a model leaves of an axis in plays, nothing being fitted."""
    part = next(p for p in axis_parts(model, plays) if p.name == axis)
    return float(np.mean(_as_it_is(model, plays, part, nthread)[1] ** 2))


def _as_it_is(model: Model, plays: Sequence[Play], part: AxisPart, nthread: int) -> tuple[Search, Array]:
    """A search over nothing, and the (R,) residuals of the model at its own values."""
    search = axis_search(model, plays, part, SearchOptions((), nthread))
    return search, search.residuals(search.start[None], "exact")[0]
