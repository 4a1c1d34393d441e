# SPDX-License-Identifier: Apache-2.0
"""Free curves as rivals of named effects: forces over angle, speed, load, another axis or time, without a formula.

No form of an effect is exact, so the right one may leave some of what it explains. So may a sum of wrong ones. Where
one curve leaves nothing but noise and a sum of named effects does not, the sum only imitates the curve.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.diagnose.added_force import Playing, visited
from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, with_curves
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model

CURVE_ROUNDS = 12  # of a curve's descent
DESCENDED = 2  # curves that are descended: those that promise most to first order


def imitated(refit: Refit, search: Search) -> bool:
    """Whether a refit may be a sum of effects that only imitates another one: it has several and leaves more than a
    healthy rig does.
    """
    return refit.several and worst_floors(refit.residuals, search.signal) > SETTINGS.healthy


def free_curves(
    search: Search, base: Refit, model: Model, plays: Sequence[Play], part: AxisPart
) -> tuple[Search, list[Refit]]:
    """The free curves that explain most of what the base leaves, each refitted together with the base values.

    Args:
        search: of named effects, whose samples and noise floor count.
        base: refitted alone.
        model: as stated, without candidates.

    Returns:
        A search over the curves, and the refits, best first.
    """
    fitted = search.library.base_of(base.values)
    curves = search.over(_library(model, fitted, plays, part))
    start = curves.library.with_base(curves.start, base.values)
    alone = curves.at(start, replace(base, effects=(), steps=None))
    promised = sorted((_promised(curves, alone, c), c.name) for c in curves.library.candidates)
    chosen = curves.library.of(name for _, name in promised[:DESCENDED])
    refits = curves.judged([((c,), start) for c in chosen], CURVE_ROUNDS)
    search.evaluations = curves.evaluations
    return curves, sorted((r for r in refits if np.isfinite(r.cost)), key=lambda r: r.cost)


def _library(model: Model, fitted: Mapping[str, float], plays: Sequence[Play], part: AxisPart) -> Library:
    """Every free curve of a force at the axes of a part, over the range that the model visits with fitted values."""
    ranges: dict[tuple[str, str], Mapping[str, float]] = {}
    for axis in part.axes:
        playing = Playing(model.with_values(fitted, "refitted"), plays, axis, part.signals)
        spans = visited([playing.motion(number) for number in range(len(plays))])
        ranges |= {(name, axis): span for name, span in spans.items()}
    return with_curves(Library(model, part.base, (), part.rough), ranges)


def _promised(search: Search, base: Refit, curve: Candidate) -> float:
    """Floors that a curve leaves together with the base values, to first order."""
    changes = search.changes(replace(base, effects=(curve.name,)))
    by = np.linalg.lstsq(changes, -base.residuals, rcond=1e-6)[0]
    return float(np.mean((base.residuals + changes @ by) ** 2))
