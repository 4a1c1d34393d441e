# SPDX-License-Identifier: Apache-2.0
"""What one axis lacks: the course from its base values over single effects to several, and the probabilities."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, Progress, axis_search, next_refits, rival_refits
from eps_tunnel_analysis.diagnose.base_refit import STARTS, base_from, base_refit
from eps_tunnel_analysis.diagnose.bases import Bases
from eps_tunnel_analysis.diagnose.calibration import CALIBRATION
from eps_tunnel_analysis.diagnose.gate import allowed, independent
from eps_tunnel_analysis.diagnose.rank import UNKNOWN, Ranked, penalty, rank
from eps_tunnel_analysis.diagnose.refit import Refit
from eps_tunnel_analysis.diagnose.repeats import Repeats, repeats
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.model import Model

FAR = 4.0  # times what may be left; further away a third effect is not looked for
MOST_EFFECTS = 3  # named together on one axis
PAIR_SHORTLIST = 8
RUNNERS_UP = 2  # on which one more effect is tried too, as on the best; no further away than
RUNNING = 4.0  # times what the best leaves
PROMISE = 0.6  # of the cost: where little is left, one more effect is looked for only if a look promises less
LEAST_INDEPENDENT = 30.0  # samples of a play: what is left may be correlated for long and still tells models apart
MOST_INDEPENDENT = 100.0  # no model is so exact that a few percent of what noise leaves would tell it from another


@dataclass(frozen=True)
class AxisDiagnosis:
    """What was found on one axis: refits of every set tried, the ranking, and what is left.

    Attributes:
        base, best: residuals before and after; `best` is the base where nothing is named.
        probabilities: name of a set -> probability, "none" and "unknown" among them.
        timed: the same probabilities if uneven timing of the trials is not held against completeness.
        odd: signals whose trials differ as no effect of the library makes them.
    """

    part: AxisPart
    search: Search
    base: Refit
    refits: tuple[Refit, ...]
    ranking: tuple[Ranked, ...]
    probabilities: Mapping[str, float]
    timed: Mapping[str, float]
    odd: tuple[Repeats, ...] = ()

    @property
    def best(self) -> Refit:
        """The most probable refit, whether or not it explains all; the base where that is more probable."""
        for ranked in self.ranking:
            for refit in (self.base, *self.refits):
                if refit.effects == ranked.effects:
                    return refit
        return self.base


def diagnose_axis(
    model: Model,
    plays: Sequence[Play],
    part: AxisPart,
    only: Sequence[str] | None,
    nthread: int,
    told: Progress | None,
    once: float,
    bases: Bases | None = None,
) -> AxisDiagnosis:
    """Names what one axis lacks.

    Args:
        once: this axis's; the others are those of `diagnose`.
        bases: of all axes, where there are several.
    """
    bases = bases or Bases()
    search = axis_search(bases.among(model, part.axis), plays, part, only, nthread=nthread, told=told)
    base = base_refit(search, bases.values.get(part.axis))
    tried = len(search.library.candidates)
    refits: list[Refit] = []
    floor = floor_known(plays)
    if tried and (not floor or base.overall > allowed(once) * CALIBRATION.clean):
        refits = next_refits(search, [base])
        base = _better_base(search, base, refits)
        best = _lowest([base, *refits])
        refits += rival_refits(search, best, refits)
        best = _lowest([base, *refits])
        # Without a floor nothing says when to stop, so one effect at a time is judged.
        enough = allowed(max(base.overall, once))
        while floor and best.overall > CALIBRATION.gate and 0 < len(best.effects) < MOST_EFFECTS:
            few = best.overall <= enough
            found = next_refits(search, [best, *_runners_up(best, refits)], PAIR_SHORTLIST, PROMISE if few else np.inf)
            found += rival_refits(search, _lowest(found), [*refits, *found]) if found else []
            if not found or not _needed(_lowest(found), best, few, search, tried):
                break
            refits += [r for r in found if set(r.effects) not in [set(o.effects) for o in refits]]
            fuller = _lowest(found)
            best = _without_idle(search, fuller, refits, tried)
            if best is not fuller or best.overall > FAR * enough:
                break
    samples = _independent(search, _lowest([base, *refits]))
    differ = [(p, r) for p in plays for r in repeats(p.trials, _positions(model, part)) if r.sentence]
    odd, drifts = tuple(r for _, r in differ), any(r.drift for _, r in differ)
    uneven = any(r.jitter > p.timing for p, r in differ)
    ranking, unknown = rank(base, refits, samples, tried, once, drifts, uneven, floor)
    probabilities = {r.name: r.probability for r in ranking} | {UNKNOWN: unknown}
    even, unknown = rank(base, refits, samples, tried, once, drifts, False, floor)
    timed = {r.name: r.probability for r in even} | {UNKNOWN: unknown}
    return AxisDiagnosis(part, search, base, tuple(refits), tuple(ranking), probabilities, timed, odd)


def floor_known(plays: Sequence[Play]) -> bool:
    """Whether every play has trials that tell what the rig repeats."""
    return all(play.trials.count > 1 for play in plays)


def _lowest(refits: Sequence[Refit]) -> Refit:
    return min(refits, key=lambda r: (r.overall, len(r.effects)))


def _runners_up(best: Refit, refits: Sequence[Refit]) -> list[Refit]:
    """The next best of as many effects."""
    same = [r for r in refits if len(r.effects) == len(best.effects) and set(r.effects) != set(best.effects)]
    near = [r for r in same if r.overall < RUNNING * best.overall]
    return sorted(near, key=lambda r: (r.overall, r.effects))[:RUNNERS_UP]


def _positions(model: Model, part: AxisPart) -> list[str]:
    return [m.signal for m in model.rig.measured if m.quantity == "position" and m.signal in part.signals]


def _better_base(search: Search, base: Refit, refits: Sequence[Refit]) -> Refit:
    """The base from the best refits' base values, if that is lower: an effect must not be named for a better start."""
    again = base_from(search, [r.values for r in sorted(refits, key=lambda r: r.overall)[:STARTS]])
    if again.overall < base.overall:
        return again
    search.settle_at(base)
    return base


def _needed(more: Refit, best: Refit, few: bool, search: Search, tried: int) -> bool:
    """Whether one more effect is called for: it pays, and where `few` is left anyway, it takes away most of that."""
    if few and more.overall > CALIBRATION.second * best.overall:
        return False
    return _worth(more, best, search, tried)


def _worth(more: Refit, best: Refit, search: Search, tried: int) -> bool:
    """Whether one more effect gains more than it costs."""
    n = _independent(search, more)
    pays = penalty(more.free - best.free, 1, n, tried)
    return 0.5 * n * np.log(best.overall / more.overall) / CALIBRATION.temperature > pays


def _without_idle(search: Search, found: Refit, singles: Sequence[Refit], tried: int) -> Refit:
    """The refit, or a smaller one that does as well: each named effect must be needed."""
    for name in found.effects[:-1]:
        rest = tuple(n for n in found.effects if n != name)
        smaller = next((r for r in singles if set(r.effects) == set(rest)), None)
        if smaller is not None and not _worth(found, smaller, search, tried):
            return smaller
    return found


def _independent(search: Search, refit: Refit) -> float:
    found = independent(refit.residuals, search.blocks)
    plays = search.objective.rollouts.commands.shape[0]
    return min(max(found, plays * LEAST_INDEPENDENT), plays * MOST_INDEPENDENT)
