# SPDX-License-Identifier: Apache-2.0
"""Sets of effects that may explain what an axis lacks: single effects, then further ones on top of the best."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from eps_tunnel_analysis.diagnose.base_values import BASE_STARTS, base_starts, better_base, sensed_joints, softened
from eps_tunnel_analysis.diagnose.candidates import Candidate, starts
from eps_tunnel_analysis.diagnose.contained import (
    NEAR_BEST,
    ROUNDS,
    STARTS_EACH,
    complete,
    general_refits,
    leaves_something,
    nested_refits,
    that_add_something,
    weakly,
    with_fewer_again,
    without,
)
from eps_tunnel_analysis.diagnose.guided import event_refits
from eps_tunnel_analysis.diagnose.rank import kept_of, with_form, worst_floors
from eps_tunnel_analysis.diagnose.refits import (
    Job,
    Refit,
    TrialPoint,
    base_and_sets,
    best_by_set,
    lowest,
    with_residuals,
)
from eps_tunnel_analysis.diagnose.search import FEW_STARTS, HOPELESS, SHORTLIST, Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.diagnose.ticks import tick_points, tick_starts
from eps_tunnel_analysis.diagnose.waves import wave_starts
from labyrinth_sim.trials import Array

STATED_SHORTLIST = 10  # effects fitted on top of a base as stated, and
STATED_KEPT = 3  # how many of them go on with all values free
REBASED = 1  # refits whose base values are searched again, each from
REBASE_STARTS = 2  # starts, its own included
POINTS_EACH = 2  # refits on top of which a set starts
PAIR_SHORTLIST = 4
MOST_EFFECTS = 3  # on one axis
BEGINNINGS = 3  # effects of which a little is added to the base, before further ones are tried
RIVALS = 4  # of an effect that are refitted in its place
RIVALS_ALONE = 2  # more, those that do most for it while the base values stay as they are
RUNNERS_UP = 2  # on which one more effect is tried, as on the best, if they leave no more than
RUNNING = 4.0  # times what the best leaves
NEAR_COMPLETE = 2.0  # times what counts as nothing missing; what leaves less is nearly complete
SETTLED_ROUNDS = 12  # at most, of the sets near the best, in the end
SOFTENED = 3  # best sets that are tried with friction of the model that sets in gradually

Lacking = Callable[[Refit], bool]
"""Whether the best refit leaves so much that more may be missing."""


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
    allowed = float(with_form(0.0, 1.0, level, healthy))
    if not search.library.candidates:
        return base, []
    base = _rested(search, base, allowed)
    if floor and complete(search, base, allowed):
        return base, []
    sought = base
    refits = next_refits(search, [base], more=stated_jobs(search, base))
    # An effect must not be named only because it led to a better start of the base.
    points = [r.values for r in sorted(refits, key=lambda r: r.cost)[:BASE_STARTS]]
    base = better_base(search, base, points, lowest([base, *refits]).cost)
    best = lowest([base, *refits])
    search.leading = best.effects if explains(base, best) else ()
    replaced: set[frozenset[str]] = set()  # sets whose rivals were tried
    if _helps(search, base, best):
        replaced.add(frozenset(best.effects))
        refits = best_by_set([*refits, *rival_refits(search, best, refits)])
    base, refits = started_again(search, *refined(search, base, refits), allowed)
    lacking = partial(lacks_more, search, healthy=healthy, floor=floor)
    best = lowest([base, *refits])
    if best.effects and lacking(best) and _nearly_complete(search, best, allowed):
        base, refits = refined(search, base, best_by_set([*refits, *far_along_valley(search, best)]))
        best = lowest([base, *refits])
    seek = partial(refitted_sets, search, healthy=healthy, level=level, floor=floor, most=most)
    again = partial(_sought_again, sought, lacking=lacking, seek=seek)
    grown = partial(_grown, search, lacking=lacking, replaced=replaced, allowed=allowed, most=most)
    if lacking(best):
        fitted = {r.effects: r for r in (base, best)}.values()
        ticks = tick_refits(
            search, [*fitted, *_beginnings(search, base, best, refits, allowed)], allowed, _given_up(search, best)
        )
        show = search.exhaustive or worst_floors(best.residuals, search.signal) > allowed
        more = [*ticks, *(event_refits(search, [*fitted], allowed) if show else [])]
        refits = best_by_set([*refits, *more])
        best = lowest([best, *more])
    if floor and lacking(best) and not _helps(search, base, best):
        return again(base, refits) or (base, refits)  # nothing explains what is missing, so that nothing beside it does
    tried = _calls_for_more(base, refits, lacking)
    base, refits = nested_refits(search, base, grown(base, refits) if tried else refits)
    if found := again(base, refits):
        return found
    if not tried and _calls_for_more(base, refits, lacking):  # an effect may show only now that it was started again
        base, refits = nested_refits(search, base, grown(base, refits))
    for _ in range(most):  # each effect of a set may have been chosen while another was wrong
        best = lowest([base, *refits])
        if not best.effects or frozenset(best.effects) in replaced:
            break
        replaced.add(frozenset(best.effects))
        refits = best_by_set([*refits, *rival_refits(search, best, refits)])
    refits = best_by_set([*refits, *general_refits(search, refits)])
    base, refits = started_again(search, *refined(search, base, refits), allowed)
    base, refits = with_fewer_again(search, base, refits)
    base, refits = settled(search, base, refits)
    return base, refits


def far_along_valley(search: Search, refit: Refit) -> list[Refit]:
    """The best refit of the same effects from far along the direction of the drive that a refit determines least.

    P, D and delay can make up for one another, and what the wrong ones leave would be taken for one more effect.
    """
    return search.best_of([(search.library.of(refit.effects), point) for point in search.along_weakest(refit)], ROUNDS)


def _calls_for_more(base: Refit, refits: Sequence[Refit], lacking: Lacking) -> bool:
    """Whether the best of some refits explains enough to continue from, and leaves something."""
    best = lowest([base, *refits])
    return explains(base, best) and lacking(best)


def _grown(
    search: Search, base: Refit, refits: Sequence[Refit], lacking: Lacking, replaced: set[frozenset[str]],
    allowed: float, most: int,
) -> list[Refit]:  # fmt: skip
    """The refits with further effects on top of the best, which calls for more, one more each time.

    Args:
        replaced: sets whose rivals were tried; it takes those of this function.
    """
    refits = list(refits)
    for size in range(1, most):  # a tick may have been found beside an effect that is not the best by itself
        same = [r for r in refits if len(r.effects) == size]
        if not same:
            break
        on = lowest(same)
        beside = _beginnings(search, base, on, refits, allowed) if size == 1 else []
        more = next_refits(search, [on, *_runners_up(on, refits), *beside], PAIR_SHORTLIST)
        if more:
            better = lowest(more)
            replaced.add(frozenset(better.effects))
            if search.exhaustive or explains(on, better):  # else any in its place does as much
                more += rival_refits(search, better, [*refits, *more])
        refits = best_by_set([*refits, *more])
        best = lowest([base, *refits])
        search.leading = best.effects
        if not (_leads_on(search, base, on, best, refits) and lacking(best)):
            break
    return refits


def _sought_again(
    sought: Refit, base: Refit, refits: Sequence[Refit], lacking: Lacking,
    seek: Callable[[Refit], tuple[Refit, list[Refit]]],
) -> tuple[Refit, list[Refit]] | None:  # fmt: skip
    """What `seek` finds from the base, if that now explains what effects did beside the one that they were sought from,
    and something is still left; None otherwise.

    Effects that only led the drive out of a wrong valley say nothing about what is missing on top of the right one.

    Args:
        seek: `refitted_sets` from a base, as it was called.
    """
    best = lowest([base, *refits])
    if not explains(sought, base) or explains(base, best) or not lacking(best):
        return None
    base, more = seek(base)
    return base, best_by_set([*refits, *more])


def _nearly_complete(search: Search, refit: Refit, allowed: float) -> bool:
    """Whether a refit leaves little more than what counts as nothing missing, `allowed` floors."""
    return worst_floors(refit.residuals, search.signal) <= NEAR_COMPLETE * allowed


def _rested(search: Search, base: Refit, allowed: float) -> Refit:
    """The base where it leaves little more than a healthy rig: its descents go on until it rests, with shorter steps if
    it needs these. What they stopped short of would be taken for something missing, and the whole library tried.
    """
    if complete(search, base, allowed) or not _nearly_complete(search, base, allowed):
        return base
    base, _ = refined(search, base, [])
    return base if complete(search, base, allowed) else settled(search, base, [])[0]


def settled(search: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """The base and the refits; those near the best go on at the steps that judge until they rest, from their own base
    values and from the best one's: whatever is missing, the drive is the same.

    So that none is ranked behind another one because its descent was stopped, or rests in a valley of its own.
    """
    best = lowest([base, *refits])
    near = [r for r in best_by_set([base, *refits])[:SHORTLIST] if r.cost < NEAR_BEST * max(best.cost, 1.0)]
    near = that_add_something(search, near, near)
    again = _gone_on(search, near, [r.values for r in near])
    near = best_by_set([*near, *again])
    if len(near) > 1:
        others = [near[1] if r is near[0] else near[0] for r in near]
        moved = [search.library.with_base(r.values, other.values) for other, r in zip(others, near, strict=True)]
        again += _gone_on(search, near, moved)
    return base_and_sets([base, *refits, *again])


def _gone_on(search: Search, refits: Sequence[Refit], points: Sequence[Array]) -> list[Refit]:
    """Refits descended again from values (K,) each, at the steps that judge."""
    jobs = [(search.library.of(r.effects), point) for r, point in zip(refits, points, strict=True)]
    again = search.refit(jobs, SETTLED_ROUNDS, "exact")
    return [replace(new, converged=old.converged) for old, new in zip(refits, again, strict=True)]


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
    base, *again = _judged_again(search, [base, *near])
    search.settle_at(base)
    judged = {r.effects: r for r in again}
    return base, best_by_set([judged.get(r.effects, r) for r in refits])


def _judged_again(search: Search, refits: Sequence[Refit]) -> list[Refit]:
    """Refits judged again from where they are."""
    again = search.judged([(search.library.of(r.effects), r.values) for r in refits], ROUNDS)
    return [replace(new, converged=old.converged) for old, new in zip(refits, again, strict=True)]


def started_again(search: Search, base: Refit, refits: Sequence[Refit], allowed: float) -> tuple[Refit, list[Refit]]:
    """The base and the refits, each play begun in the pose where the best of them puts it, if it leaves more than
    `allowed` floors: while an effect is missing, its misfit hides that of the pose.
    """
    best, joints = lowest([base, *refits]), sensed_joints(search)
    if not best.effects or not joints or complete(search, best, allowed):
        return base, list(refits)
    search.settle_start(best, joints)
    every = [base, *refits]
    rows = search.residuals(np.array([r.values for r in every]), "exact")
    base, refits = base_and_sets([with_residuals(r, row) for r, row in zip(every, rows, strict=True)])
    best = lowest([base, *refits])
    search.settle_at(best)
    near = [r for r in (base, *refits) if r.cost < NEAR_BEST * max(best.cost, 1.0)]
    return base_and_sets([base, *refits, *_judged_again(search, that_add_something(search, near, refits))])


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
    tried = _trial_points(search, points, search.library.candidates)
    if not more and (not tried or tried[0].promised > on[0].cost - 0.5 * SETTINGS.material):
        return []
    found = search.best_of([*_jobs(search, points, tried, shortlist), *more], ROUNDS)
    if found and explains(on[0], found[0]):
        search.leading = found[0].effects
    return _rebased(search, found)


def stated_jobs(search: Search, base: Refit) -> list[Job]:
    """Effects that explain most with the base values as the model states them, if the base deviates from these.

    A base whose values have absorbed a missing effect hides which one it is: on top of it no effect explains more.
    """
    if search.strain(base.values) < SETTINGS.strained:
        return []
    firm = search.as_stated()
    start = np.where(search.stated, search.start, base.values)
    (stated,) = firm.refit([((), start)], ROUNDS)
    quick = [c for c in search.library.candidates if _quick(c)]
    tried = firm.trial_points([stated], quick)
    refits = best_by_set(firm.refit(_jobs(firm, [stated], tried, STATED_SHORTLIST), ROUNDS, race=np.inf))
    search.evaluations = firm.evaluations
    return [(search.library.of(r.effects), r.values) for r in refits[:STATED_KEPT]]


def _trial_points(search: Search, on: Sequence[Refit], candidates: Sequence[Candidate]) -> list[TrialPoint]:
    """Every start of every candidate on top of refits, best first; of ticks and waves, the likeliest on the first."""
    likely = tick_starts(search, on[0], candidates) | wave_starts(search, on[0], candidates)
    return search.trial_points(on, candidates, likely)


def _quick(candidate: Candidate) -> bool:
    """Whether a candidate needs few starts, so that it costs little to try it again."""
    return len(starts(candidate)) <= FEW_STARTS


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
            jobs += [((*fitted, point.candidate), point.values) for point in _best_starts(search, here)]
    return jobs


def _best_starts(search: Search, points: Sequence[TrialPoint]) -> list[TrialPoint]:
    """Of one effect's trial points, best first: the best, more if it has several values, and the best of each kind."""
    columns, free = (of(points[0].candidate) for of in (search.columns, search.free_columns))
    kinds = [column for column in columns if column not in free]
    many = STARTS_EACH if len(columns) > 1 else 1
    seen: set[tuple[float, ...]] = set()
    chosen = []
    for number, point in enumerate(points):
        kind = tuple(point.values[kinds])
        if number < many or kind not in seen:
            chosen.append(point)
        seen.add(kind)
    return chosen


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
    beside = [search.library.with_base(r.values, again[0].values) for r in near]
    named = [search.library.of(r.effects) for r in near]
    return best_by_set([*again, *search.judged(list(zip(named, beside, strict=True)), ROUNDS)])


def _beginnings(search: Search, base: Refit, best: Refit, refits: Sequence[Refit], allowed: float) -> list[Refit]:
    """What `begun` gives, unless the best leaves little more than `allowed` floors: then its own values are right."""
    return [] if not search.exhaustive and _nearly_complete(search, best, allowed) else begun(search, base, refits)


def begun(search: Search, base: Refit, refits: Sequence[Refit]) -> list[Refit]:
    """The base with a little of one more effect, for each of those that explain most by themselves.

    Where something else acts as well, a tick above all, the values that an effect is fitted with by itself are wrong,
    and on top of them so is what explains most. Here the effect's slopes compensate for as much as they can.
    """
    single = [r.effects for r in sorted(refits, key=lambda r: r.cost) if len(r.effects) == 1][:BEGINNINGS]
    search.settle_at(base)
    return [replace(search.at(weakly(search, base.values, effects), base), effects=effects) for effects in single]


def tick_refits(search: Search, on: Sequence[Refit], allowed: float, most: float = np.inf) -> list[Refit]:
    """Refits from the best ticks of commands on top of refits, where an axis leaves more than `allowed` floors, and
    ticks promise less than `most`.
    """
    points = [p for p in tick_points(search, on, allowed) if p.promised < most]
    return search.best_of(_jobs(search, on, points, np.inf), ROUNDS) if points else []


def _given_up(search: Search, best: Refit) -> float:
    """Floors that a set may promise at most, to be tried beside a best one that leaves only noise.

    Where more is left a promise says too little: it is of one linear step, and a descent may end far below it.
    """
    noise = not search.exhaustive and best.cost <= SETTINGS.healthy
    return HOPELESS * max(best.cost, 1.0) if noise else np.inf


def rival_refits(search: Search, best: Refit, tried: Sequence[Refit]) -> list[Refit]:
    """The best with each of its effects replaced by another: by its declared rivals, and by effects of other sets that
    were tried; each of two by any other that needs few starts, because it was chosen while the other was missing, and
    for the two of three that was tried before. The base values of the best are kept, because the drive is the same
    whatever is missing.

    A set that was tried before is fitted again only if this promises a lower cost than it reached. Where the best
    leaves only noise, any is only if it promises no more than descents that are given up leave.
    """
    known = {frozenset(r.effects): r.cost for r in tried}
    most = _given_up(search, best)
    by_any = len(best.effects) == 2 or (best.several and search.exhaustive)
    jobs: list[Job] = []
    for name in best.effects:
        effect, registry = search.library.find(name).effect.name, search.library.model.registry
        mistaken = registry.rivals(effect) if effect in registry.effects else ()  # a drive's value has none
        others, values = without(search, best, name)
        rest = frozenset(other.name for other in others)
        candidates = [c for c in search.library.candidates if c.name not in best.effects
                      and (c.effect.name in mistaken or rest | {c.name} in known
                           or (by_any and _quick(c)))]  # fmt: skip
        if not candidates:
            continue
        bare = replace(search.at(values, best), effects=tuple(o.name for o in others))
        points = _trial_points(search, [bare], candidates)
        promising = [p for p in points if p.promised < min(known.get(rest | {p.candidate.name}, np.inf), most)]
        first = _jobs(search, [bare], promising, RIVALS)
        chosen = {fitted[-1].name for fitted, _ in first}
        left = sorted((p for p in promising if p.candidate.name not in chosen), key=lambda p: p.alone)
        jobs += [*first, *_jobs(search, [bare], left, RIVALS_ALONE)]
    return search.best_of(jobs, ROUNDS, best.cost) if jobs else []


def _runners_up(best: Refit, refits: Sequence[Refit]) -> list[Refit]:
    """The next best refits with as many effects."""
    same = [r for r in refits if len(r.effects) == len(best.effects) and set(r.effects) != set(best.effects)]
    near = [r for r in same if r.cost < RUNNING * best.cost]
    return sorted(near, key=lambda r: (r.cost, r.effects))[:RUNNERS_UP]


def lacks_more(search: Search, best: Refit, healthy: float = SETTINGS.healthy, floor: bool = True) -> bool:
    """Whether the best refit leaves so much that more may be missing.

    What an effect leaves for its form no further one takes to the noise, which only a search shows. Without repeated
    trials, only a misfit far beyond the sensors' noise counts.
    """
    return not complete(search, best, healthy if floor else SETTINGS.unrepeated * healthy)


def inexact_share(search: Search, base: Refit, refit: Refit, refits: Sequence[Refit]) -> float:
    """Share of the base's misfit that a refit's effects of inexact form explain: alone, or on top of the exact ones."""
    exact = frozenset(name for name in refit.effects if search.library.find(name).effect.exact)
    if not exact:
        return 1.0

    def left(part: Collection[str]) -> float:
        return min([base.cost, *(r.cost for r in refits if r.effects and set(r.effects) <= set(part))])

    explained = max(base.cost - left(set(refit.effects) - exact), left(exact) - refit.cost)
    return float(np.clip(explained / max(base.cost - 1.0, 1e-12), 0.0, 1.0))


def explains(before: Refit, after: Refit) -> bool:
    """Whether an added effect explains enough to continue from."""
    return _falls(before.cost, after.cost)


def _leads_on(search: Search, base: Refit, before: Refit, after: Refit, refits: Sequence[Refit]) -> bool:
    """Whether a further effect explains enough to try one more: a good part of what was left, and either so much that
    it is needed or nearly all. Otherwise one more would be no more needed.
    """
    share = SETTINGS.share * kept_of(inexact_share(search, base, before, refits))
    needed = before.cost - after.cost >= share * (base.cost - 1.0)
    nearly = _nearly_complete(search, after, SETTINGS.healthy)
    return explains(before, after) and (search.exhaustive or needed or nearly)


def _helps(search: Search, before: Refit, after: Refit) -> bool:
    """The same, or enough of the worst signal; always if nothing is to be given up."""
    worst = (worst_floors(r.residuals, search.signal) for r in (before, after))
    return search.exhaustive or explains(before, after) or _falls(*worst)


def _falls(before: float, after: float) -> bool:
    return before - after >= max(SETTINGS.material, SETTINGS.worthwhile * (before - 1.0))
