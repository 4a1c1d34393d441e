# SPDX-License-Identifier: Apache-2.0
"""What one axis lacks: single effects, sets of effects, and sets that contain them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_search
from eps_tunnel_analysis.diagnose.base_values import BASE_STARTS, Bases, base_refit, base_starts, better_base, softened
from eps_tunnel_analysis.diagnose.candidates import Candidate, starts
from eps_tunnel_analysis.diagnose.free_curves import free_curves, imitated
from eps_tunnel_analysis.diagnose.rank import Hypothesis, Ranking, left_out, rank, worst_floors
from eps_tunnel_analysis.diagnose.refits import Job, Refit, TrialPoint, best_by_set
from eps_tunnel_analysis.diagnose.repeats import Repeats, repeats
from eps_tunnel_analysis.diagnose.search import FEW_STARTS, OUT_OF_REACH, SHORTLIST, Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.ticks import tick_points
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.model import Model
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array

STATED_SHORTLIST = 10  # effects fitted on top of a base as stated, and
STATED_KEPT = 3  # how many of them go on with all values free
REBASED = 1  # refits whose base values are searched again, each from
REBASE_STARTS = 2  # starts, its own included
NEAR_BEST = 2.0  # times the best refit's cost; refits within that start again from its base values
POINTS_EACH = 2  # refits on top of which a set starts, and
STARTS_EACH = 3  # places in each where an effect of several values starts
ROUNDS = 6
PAIR_SHORTLIST = 4
MOST_EFFECTS = 3  # on one axis
BEGINNINGS = 3  # effects of which a little is added to the base, before further ones are tried, and
A_LITTLE = 0.05  # how much, of a typical one
RIVALS = 4  # of an effect that are refitted in its place
RUNNERS_UP = 2  # on which one more effect is tried, as on the best, if they leave no more than
RUNNING = 4.0  # times what the best leaves
TAKEN_APART = 3  # best sets of several effects, each of which is also tried without each of its effects
SOFTENED = 3  # best sets that are tried with friction of the model that sets in gradually
MISFITTED = 1.02  # times the cost of a set that it contains; a refit that leaves more has not converged


# ---- effects


def next_refits(
    search: Search, on: Sequence[Refit], shortlist: int = SHORTLIST, more: Sequence[Job] = ()
) -> list[Refit]:
    """Every candidate refitted on top of refits: trial points, then descents of the most promising; best first.

    Args:
        on: best first; if several effects act, one of them alone may not explain most.
        more: descended in any case.
    """
    search.settle_at(on[0])
    points = [on[0], *(search.at(other.values, other) for other in on[1:])]
    tried = search.trial_points(points, search.library.candidates)
    if not more and (not tried or tried[0].promised > on[0].cost - 0.5 * SETTINGS.material):
        return []
    return _rebased(search, search.best_of([*_jobs(search, points, tried, shortlist), *more], ROUNDS))


def stated_jobs(search: Search, base: Refit) -> list[Job]:
    """Effects that explain most with the base values as the model states them, if the base deviates from these.

    A base whose values have absorbed a missing effect hides which one it is: on top of it no effect explains more.
    """
    if search.strain(base.values) < SETTINGS.strained:
        return []
    firm = search.as_stated()
    start = np.where(search.firmness > 0.0, search.start, base.values)
    (stated,) = firm.refit([((), start)], ROUNDS)
    quick = [c for c in search.library.candidates if len(starts(c)) <= FEW_STARTS]
    tried = firm.trial_points([stated], quick)
    refits = best_by_set(firm.refit(_jobs(firm, [stated], tried, STATED_SHORTLIST), ROUNDS, race=np.inf))
    search.evaluations = firm.evaluations
    return [(search.library.of(r.effects), r.values) for r in refits[:STATED_KEPT]]


def _jobs(search: Search, points: Sequence[Refit], tried: Sequence[TrialPoint], shortlist: float) -> list[Job]:
    """The best trial points of each of the `shortlist` most promising sets, to be fitted on top of `points`.

    A set starts from every point that leads to it, because the base that fits best without an effect may lie in a
    valley where the effect does not help. An effect with several values starts from several of its own points, because
    the most promising ones may lie in a wrong valley, too.
    """
    chosen: dict[frozenset[str], list[TrialPoint]] = {}
    shortlist = np.inf if search.exhaustive else shortlist
    for point in tried:
        name = frozenset([*points[point.on].effects, point.candidate.name])
        if name in chosen or len(chosen) < shortlist:
            chosen.setdefault(name, []).append(point)
    jobs: list[Job] = []
    for same in chosen.values():
        for on in list(dict.fromkeys(point.on for point in same))[:POINTS_EACH]:
            fitted = search.library.of(points[on].effects)
            here = [point for point in same if point.on == on]
            many = STARTS_EACH if len(here[0].candidate.parameters) > 1 else 1
            jobs += [((*fitted, point.candidate), point.values) for point in here[:many]]
    return jobs


def _rebased(search: Search, refits: Sequence[Refit]) -> list[Refit]:
    """The refits, the best of them descended again from other base values, unless it leaves only noise: their own may
    lie in a wrong valley.

    A refit close to the best may be confused with it, so it starts again from the best one's base values: whatever is
    missing, the drive is the same.
    """
    size = len(search.library.base)
    jobs: list[Job] = []
    for refit in (r for r in refits[:REBASED] if size and leaves_something(search, r)):
        points = base_starts(search, refit.values, REBASE_STARTS)[1:] + search.beside_stated([refit], ROUNDS)
        jobs += [(search.library.of(refit.effects), point) for point in points]
    again = best_by_set([*refits, *(search.best_of(jobs, ROUNDS) if jobs else [])])
    near = [r for r in again[1:] if size and r.cost < NEAR_BEST * again[0].cost]
    beside = [np.concatenate([again[0].values[:size], r.values[size:]]) for r in near]
    named = [search.library.of(r.effects) for r in near]
    return best_by_set([*again, *search.judged(list(zip(named, beside, strict=True)), ROUNDS)])


def leaves_something(search: Search, refit: Refit) -> bool:
    """Whether a refit leaves more than noise, so that another valley may fit better."""
    return search.exhaustive or worst_floors(refit.residuals, search.signal) > SETTINGS.close * SETTINGS.healthy


def begun(search: Search, base: Refit, refits: Sequence[Refit]) -> list[Refit]:
    """The base with a little of one more effect, for each of those that explain most by themselves.

    Where something else acts as well, a tick above all, the values that an effect is fitted with by itself are wrong,
    and on top of them so is what explains most. Here the effect's slopes compensate for as much as they can.
    """
    single = [r.effects for r in sorted(refits, key=lambda r: r.cost) if len(r.effects) == 1][:BEGINNINGS]
    search.settle_at(base)
    return [replace(search.at(_weak(search, base.values, effects), base), effects=effects) for effects in single]


def _weak(search: Search, values: Array, effects: Sequence[str]) -> Array:
    """(K,) values with a little of some effects, because at their off values they have no slope."""
    weak = values.copy()
    for candidate in search.library.of(effects):
        for p, column in zip(candidate.declared, search.columns(candidate), strict=True):
            weak[column] = weak[column] if p.off is None else p.off + A_LITTLE * (p.typical - p.off)
    return weak


def tick_refits(search: Search, on: Sequence[Refit], allowed: float) -> list[Refit]:
    """Refits from the best ticks of commands on top of refits, where an axis leaves more than `allowed` floors."""
    points = tick_points(search, on, allowed)
    return search.best_of(_jobs(search, on, points, np.inf), ROUNDS) if points else []


def rival_refits(search: Search, best: Refit, tried: Sequence[Refit]) -> list[Refit]:
    """The best with each of its effects replaced by another: by its declared rivals, and by effects of other sets that
    were tried. The base values of the best are kept, because the drive is the same whatever is missing.

    A set that was tried before is fitted again only if this promises a lower cost than it reached.
    """
    known = {frozenset(r.effects): r.cost for r in tried}
    jobs: list[Job] = []
    for name in best.effects:
        others = search.library.of(n for n in best.effects if n != name)
        effect, registry = search.library.find(name).effect.name, search.library.model.registry
        mistaken = registry.rivals(effect) if effect in registry.effects else ()  # a drive's value has none
        rest = frozenset(other.name for other in others)
        candidates = [c for c in search.library.candidates if c.name not in best.effects
                      and (c.effect.name in mistaken or rest | {c.name} in known)]  # fmt: skip
        if not candidates:
            continue
        without = best.values.copy()
        columns = search.columns(search.library.find(name))
        without[columns] = search.start[columns]
        bare = replace(search.at(without, best), effects=tuple(o.name for o in others))
        points = search.trial_points([bare], candidates)
        promising = [p for p in points if p.promised < known.get(rest | {p.candidate.name}, np.inf)]
        jobs += _jobs(search, [bare], promising, RIVALS)
    return search.best_of(jobs, ROUNDS, best.cost) if jobs else []


def nested_refits(search: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """The base and the refits. A refit that fits worse than a set it contains starts again from that set; sets
    contained in the best ones, the base among them, start again from the values of these.

    A set that contains another, or an effect that contains another one, can always imitate it, so it cannot fit worse;
    if it still does, it has not converged. And one more effect may have helped only because the drive's values left a
    wrong valley along with it, so these values are also tried without it.
    """
    fewer = _without_one(search, refits)
    reach = OUT_OF_REACH * max(1.0, lowest([base, *refits]).cost)
    jobs = [job for job, r in zip(fewer, search.refit(fewer, ROUNDS), strict=True) if r.cost < reach]
    for refit in refits:
        for smaller in (base, *refits):
            if refit.cost <= MISFITTED * smaller.cost:
                continue
            start = _contained(search, refit, smaller)
            if start is not None:
                jobs.append((search.library.of(refit.effects), start))
    by_set = best_by_set([base, *refits, *search.judged(jobs, ROUNDS)])

    def misfits(refit: Refit) -> bool:
        return any(refit.cost > MISFITTED * s.cost and _contained(search, refit, s) is not None for s in by_set)

    bare = next(r for r in by_set if not r.effects)
    return bare, [replace(refit, converged=not misfits(refit)) for refit in by_set if refit.effects]


def with_fewer_again(search: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """The base and the refits; those that fit better with the values of a set that contains them start again there.

    Else a further effect would be named because the drive's values left a wrong valley along with it.
    """
    known = {frozenset(r.effects): r for r in (base, *refits)}
    jobs = [job for job in _without_one(search, refits) if frozenset(c.name for c in job[0]) in known]
    if not jobs:
        return base, list(refits)
    there = np.mean(search.residuals(np.array([values for _, values in jobs]), "exact") ** 2, axis=1)
    better = [
        (kept, values)
        for (kept, values), cost in zip(jobs, there, strict=True)
        if MISFITTED * (cost + search.held_at(values)) < known[frozenset(c.name for c in kept)].objective
    ]
    again = (replace(r, converged=known[frozenset(r.effects)].converged) for r in search.judged(better, ROUNDS))
    by_set = best_by_set([base, *refits, *again])
    return next(r for r in by_set if not r.effects), [r for r in by_set if r.effects]


def _without_one(search: Search, refits: Sequence[Refit]) -> list[Job]:
    """The best sets of effects, single ones included, each without one effect, at the values of the full set."""
    jobs: list[Job] = []
    ordered = sorted(refits, key=lambda r: r.cost)
    several, single = ([r for r in ordered if r.several == many] for many in (True, False))
    for refit in (*several[:TAKEN_APART], *single[:TAKEN_APART]):
        for name in refit.effects:
            kept = search.library.of(n for n in refit.effects if n != name)
            values, columns = refit.values.copy(), search.columns(search.library.find(name))
            values[columns] = search.start[columns]
            if not kept or {c.name for c in kept} not in [{c.name for c in other} for other, _ in jobs]:
                jobs.append((kept, np.clip(values, search.low, search.high)))
    return jobs


def _contained(search: Search, larger: Refit, smaller: Refit) -> Array | None:
    """(K,) values at which the larger set does what the smaller one does, as far as its bounds allow; None if it
    cannot.
    """
    values = smaller.values.copy()
    added = [name for name in larger.effects if name not in smaller.effects]
    for name in (n for n in smaller.effects if n not in larger.effects):
        own = search.library.find(name)
        wider = [c for c in map(search.library.find, added)
                 if c.place == own.place and own.effect.name in [name for _, name, _ in c.effect.contains]]  # fmt: skip
        kept = {its for c in wider[:1] for _, name, its in c.effect.contains if name == own.effect.name}
        alone = [p for p in own.declared if p.off is not None and p.name not in kept]
        if not wider or any(smaller.values[search.columns(own)[_place(own, p.name)]] != p.off for p in alone):
            return None
        general = wider[0]
        for parameter, contained, its in general.effect.contains:
            if contained == own.effect.name:
                number = its if isinstance(its, float) else smaller.values[search.columns(own)[_place(own, its)]]
                values[search.columns(general)[_place(general, parameter)]] = number
        values[search.columns(own)] = search.start[search.columns(own)]
        added.remove(general.name)
    if set(smaller.effects) == set(larger.effects):
        return None
    return np.clip(_weak(search, values, added), search.low, search.high)


def _place(candidate: Candidate, parameter: str) -> int:
    return [p.name for p in candidate.declared].index(parameter)


# ---- the axis


@shown
@dataclass(frozen=True)
class AxisDiagnosis:
    """The result for an axis, or for several coupled axes: refits, their ranking, what is left.

    Attributes:
        base: the base values alone.
        hypotheses: what was ranked, the base first.
        odd: signals whose trials differ in a way that no effect of the library explains.
        even: the ranking if uneven timing of the trials does not count against completeness.
        parts: axis -> the ranking if its own signals alone decide whether anything is left; empty for one axis.
    """

    part: AxisPart
    search: Search
    base: Refit
    refits: tuple[Refit, ...]
    hypotheses: tuple[Hypothesis, ...]
    ranking: Ranking
    even: Ranking
    odd: tuple[Repeats, ...] = ()
    parts: Mapping[str, Ranking] = field(default_factory=dict)

    @property
    def best(self) -> Refit:
        """The most probable refit, whether or not it explains everything; the base if that is more probable."""
        return self.of(self.ranking.ranked[0].effects) if self.ranking.ranked else self.base

    def of(self, effects: Sequence[str]) -> Refit:
        """The refit of a set of effects; the base if the set was not refitted."""
        return next((r for r in self.refits if set(r.effects) == set(effects)), self.base)

    def own(self, names: Collection[str]) -> list[Candidate]:
        """The given effects that act on this axis."""
        return [c for c in self.search.library.candidates if c.name in names]

    def acting(self, names: Collection[str]) -> Refit:
        """The refit of the given effects that act on this axis."""
        return self.of([c.name for c in self.own(names)])

    def held_out_error(self, effects: Sequence[str]) -> float:
        """rad (m for the ball): mean absolute error of positions in stretches of time that were left out of the fit."""
        own = next((h for h in self.hypotheses if set(h.refit.effects) == set(effects)), self.hypotheses[0])
        evidence = self.search.evidence
        units = dict(zip(evidence.model.rig.signals, evidence.model.rig.units, strict=True))
        angles = [i for i, name in enumerate(self.part.signals) if units.get(name, "m") in ("rad", "m")]
        here = np.isin(self.search.signal, angles)
        return float(np.mean(np.abs(own.left_out[here] * self.search.scale[here])))

    def signals_of(self, name: str) -> tuple[str, ...]:
        """The compared signals of one of the axes."""
        rig = self.search.library.model.rig
        own = {m.signal for axis in rig.axes if axis.name == name for m in axis.measured}
        return self.part.signals if self.part.axes == (name,) else tuple(s for s in self.part.signals if s in own)

    def floors(self, refit: Refit, name: str) -> float:
        """Floors that a refit leaves on one of the axes."""
        return float(np.mean(refit.residuals[self.samples_of(name)] ** 2))

    def worst(self, name: str) -> float:
        """Floors that the base leaves on the worst signal of one of the axes."""
        own = self.samples_of(name)
        return worst_floors(self.base.residuals[own], self.search.signal[own])

    def samples_of(self, name: str) -> NDArray[np.bool_]:
        """(R,) which of the compared samples belong to one of the axes."""
        return np.isin(self.search.signal, [self.part.signals.index(s) for s in self.signals_of(name)])

    def remaining(self, refit: Refit) -> dict[str, float]:
        """Signal -> floors that a refit leaves on it."""
        search = self.search
        return {
            name: float(np.mean(refit.residuals[search.signal == i] ** 2))
            for i, name in enumerate(self.part.signals)
            if (search.signal == i).any()
        }


def diagnose_axis(
    model: Model,
    plays: Sequence[Play],
    part: AxisPart,
    run: SearchOptions,
    level: float = 0.0,
    bases: Bases | None = None,
) -> AxisDiagnosis:
    """Names what one part lacks.

    Args:
        level: floors that the base left before effects were added in earlier steps.
        bases: base values of all axes, if there are several.
    """
    bases = bases or Bases()
    own, played = bases.among(model, plays, part)
    search = axis_search(own, played, part, run)
    base = base_refit(search, bases.known(part), fitted=run.fitted)
    floor = floor_known(plays)
    base, refits = refitted_sets(search, base, level=level, floor=floor)
    curves: list[Hypothesis] = []
    if floor and part.base and imitated(lowest([base, *refits]), search):
        over, free = free_curves(search, base, own, played, part)
        curves = [hypothesis(over, refit) for refit in free[:1]]
    return _judged(plays, part, search, base, refits, model, level, floor, curves)


def refitted_sets(
    search: Search, base: Refit, healthy: float = SETTINGS.healthy, level: float = 0.0, floor: bool = True,
    most: int = MOST_EFFECTS,
) -> tuple[Refit, list[Refit]]:  # fmt: skip
    """Sets of effects that may explain what the base leaves: single effects, then further ones on top of the best.

    Args:
        healthy: floors of the worst signal that count as nothing missing.
        level: floors that the base left before effects were added in earlier steps.
        floor: whether repeated trials show the noise floor; if not, more than one effect is tried if much is left.
        most: effects in a set.

    Returns:
        The base, from a better start if the effects showed one, and a refit of each set that was tried.
    """
    refits: list[Refit] = []
    allowed = healthy + SETTINGS.form * max(level - 1.0, 0.0)
    worst = worst_floors(base.residuals, search.signal)
    if search.library.candidates and (not floor or worst > SETTINGS.close * allowed):
        refits = next_refits(search, [base], more=stated_jobs(search, base))
        # An effect must not be named only because it led to a better start of the base.
        points = [r.values for r in sorted(refits, key=lambda r: r.cost)[:BASE_STARTS]]
        base = better_base(search, base, points, lowest([base, *refits]).cost)
        replaced = [lowest([base, *refits])]  # whose rivals were tried
        refits = best_by_set([*refits, *rival_refits(search, replaced[-1], refits)])
        base, refits = refined(search, base, refits)
        best = lowest([base, *refits])
        worth = _explains(base, best)
        lacking = partial(lacks_more, search, base, healthy=healthy, level=level, floor=floor)
        if lacking(best, refits):
            fitted = {r.effects: r for r in (base, best)}.values()
            ticks = tick_refits(search, [*fitted, *begun(search, base, refits)], allowed)
            refits = best_by_set([*refits, *ticks])
            best = lowest([best, *ticks])
            worth = _explains(base, best)
        for size in range(1, most):  # a tick may have been found beside an effect that is not the best by itself
            same = [r for r in refits if len(r.effects) == size]
            if not (worth and same and lacking(best, refits)):
                break
            on = lowest(same)
            beside = begun(search, base, refits) if size == 1 else []
            more = next_refits(search, [on, *_runners_up(on, refits), *beside], PAIR_SHORTLIST)
            if more:
                replaced.append(lowest(more))
                more += rival_refits(search, replaced[-1], [*refits, *more])
            refits = best_by_set([*refits, *more])
            best = lowest([best, *more])
            worth = _explains(on, best)
        base, refits = nested_refits(search, base, refits)
        best = lowest([base, *refits])
        if best.effects and not any(set(best.effects) == set(other.effects) for other in replaced):
            refits = best_by_set([*refits, *rival_refits(search, best, refits)])
        base, refits = refined(search, base, refits)
        base, refits = with_fewer_again(search, base, refits)
    return base, refits


def refined(search: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """The base and the refits; those near the best judged again, with friction of the model that sets in gradually and
    with shorter steps, if they need these.

    How long steps may be depends on what is left: while an effect is missing, the base needs no such accuracy.
    """
    refits = best_by_set([*refits, *softened(search, best_by_set(refits)[:SOFTENED])])
    best = lowest([base, *refits])
    if not (search.levels["fine"].extrapolate and search.refine_at(best.values)):
        return base, list(refits)
    near = [r for r in refits if r.cost < NEAR_BEST * max(best.cost, 1.0)]
    jobs = [(search.library.of(r.effects), r.values) for r in (base, *near)]
    again = search.judged(jobs, ROUNDS)
    search.settle_at(again[0])
    judged = {old.effects: replace(new, converged=old.converged) for old, new in zip(near, again[1:], strict=True)}
    return again[0], best_by_set([judged.get(r.effects, r) for r in refits])


def _judged(
    plays: Sequence[Play], part: AxisPart, search: Search, base: Refit, refits: Sequence[Refit], model: Model,
    level: float, floor: bool, curves: Sequence[Hypothesis] = (),
) -> AxisDiagnosis:  # fmt: skip
    hypotheses = near_hypotheses(search, base, refits)
    alone = hypothesis(search, base)
    differ = [(p, r) for p in plays for r in repeats(p.trials, _positions(model, part)) if r.sentence]
    drifts, uneven = any(r.drift for _, r in differ), any(r.jitter > p.timing for p, r in differ)
    tried = len(search.library.candidates)
    # The base's residuals on all samples show whether anything is missing; those on left-out ones, what explains it.
    whole = replace(alone, left_out=base.residuals)
    ranked = partial(rank, whole, hypotheses, search.folds, search.blocks, tried, curves, level=level,
                     drifts=drifts, floor=floor, signals=search.signal)  # fmt: skip
    even = ranked()
    diagnosis = AxisDiagnosis(
        part, search, base, tuple(refits), (alone, *hypotheses), _uneven(even) if uneven else even, even,
        tuple(r for _, r in differ),
    )  # fmt: skip
    parts = {name: ranked(asked=diagnosis.samples_of(name)) for name in part.axes} if len(part.axes) > 1 else {}
    return replace(diagnosis, parts={name: _uneven(r) if uneven else r for name, r in parts.items()})


def _uneven(ranking: Ranking) -> Ranking:
    """If trials differ in timing no model is complete, but an effect may still explain the rest."""
    ranked = tuple(replace(r, probability=r.probability * (1.0 - SETTINGS.odd)) if not r.effects else r
                   for r in ranking.ranked)  # fmt: skip
    lost = sum(a.probability - b.probability for a, b in zip(ranking.ranked, ranked, strict=True))
    return replace(ranking, ranked=ranked, unknown=ranking.unknown + lost)


def lacks_more(
    search: Search, base: Refit, best: Refit, refits: Sequence[Refit], healthy: float = SETTINGS.healthy,
    level: float = 0.0, floor: bool = True,
) -> bool:  # fmt: skip
    """Whether the best of some refits, or a rival that fits as well, leaves so much that more may be missing.

    What an effect may leave for its form, one of a single form may not. Without repeated trials, only a misfit far
    beyond the sensors' noise counts.
    """

    def allowed(refit: Refit) -> float:
        inexact = max(inexact_share(search, base, refit, refits), SETTINGS.exact)
        share = SETTINGS.close if floor else SETTINGS.unrepeated
        return share * (healthy + SETTINGS.form * max(inexact * base.cost, level))

    rivals = [r for r in refits if len(r.effects) >= len(best.effects) and r.cost < best.cost + SETTINGS.material]
    return any(worst_floors(r.residuals, search.signal) > allowed(r) for r in (best, *rivals))


def inexact_share(search: Search, base: Refit, refit: Refit, refits: Sequence[Refit]) -> float:
    """Share of the base's misfit that a refit's effects of inexact form explain: alone, or on top of the exact ones."""
    exact = frozenset(name for name in refit.effects if search.library.find(name).effect.exact)
    if not exact:
        return 1.0

    def left(part: Collection[str]) -> float:
        return min([base.cost, *(r.cost for r in refits if r.effects and set(r.effects) <= set(part))])

    explained = max(base.cost - left(set(refit.effects) - exact), left(exact) - refit.cost)
    return float(np.clip(explained / max(base.cost - 1.0, 1e-12), 0.0, 1.0))


def near_hypotheses(search: Search, base: Refit, refits: Sequence[Refit]) -> list[Hypothesis]:
    """The refits that are ranked: the best, and those close to it."""
    near = sorted(refits, key=lambda r: r.cost)
    near = [r for i, r in enumerate(near) if i < 4 or r.cost < RUNNING * max(near[0].cost, 1.0)][:10]
    return [
        replace(
            hypothesis(search, r, [o for o in near if o is not r and _contained(search, r, o) is not None]),
            inexact=inexact_share(search, base, r, refits),
        )
        for r in near
    ]


def hypothesis(search: Search, refit: Refit, contains: Sequence[Refit] = ()) -> Hypothesis:
    """A refit with its predictions for stretches of time left out of the fit, and the others that it contains."""
    columns = search.fitted(refit)
    span = search.spans[columns]
    room = (refit.values - search.low)[columns] / span, (search.high - refit.values)[columns] / span
    predicted = left_out(search.jacobian(refit), refit.residuals, search.folds, room,
                         search.firmness_at(refit.values)[columns])  # fmt: skip
    unused = _unused(search, refit)
    return Hypothesis(
        refit, predicted, tuple(frozenset(o.effects) for o in contains), search.strain(refit.values), unused=unused
    )


def _unused(search: Search, refit: Refit) -> int:
    """How many values of a refit's effects lie at a bound, and so are no longer free: a friction that sets in at once,
    a spring that does not harden. Of each effect one value counts in any case.
    """
    total = 0
    for candidate in search.library.of(refit.effects):
        columns = search.columns(candidate)
        total += min(int(search.at_bound(refit.values[columns], columns).sum()), len(columns) - 1)
    return total


def floor_known(plays: Sequence[Play]) -> bool:
    """Whether every play has repeated trials, which show the noise floor."""
    return all(play.trials.count > 1 for play in plays)


def _explains(before: Refit, after: Refit) -> bool:
    """Whether an added effect explains enough to continue from."""
    return before.cost - after.cost >= max(SETTINGS.material, SETTINGS.worthwhile * (before.cost - 1.0))


def lowest(refits: Sequence[Refit]) -> Refit:
    """The best refit; among equal ones, the one with the fewest effects."""
    return min(refits, key=lambda r: (r.objective, len(r.effects)))


def _runners_up(best: Refit, refits: Sequence[Refit]) -> list[Refit]:
    """The next best refits with as many effects."""
    same = [r for r in refits if len(r.effects) == len(best.effects) and set(r.effects) != set(best.effects)]
    near = [r for r in same if r.cost < RUNNING * best.cost]
    return sorted(near, key=lambda r: (r.cost, r.effects))[:RUNNERS_UP]


def _positions(model: Model, part: AxisPart) -> list[str]:
    return [signal for signal in model.rig.positions if signal in part.signals]
