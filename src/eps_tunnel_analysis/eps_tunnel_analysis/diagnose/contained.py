# SPDX-License-Identifier: Apache-2.0
"""Sets of effects that contain others, as a general form of an effect contains a simple one: none may fit worse."""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.diagnose.candidates import Candidate, starts
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Job, Refit, base_and_sets, lowest
from eps_tunnel_analysis.diagnose.roll_outs import Level
from eps_tunnel_analysis.diagnose.search import OUT_OF_REACH, Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.problem import AT_BOUND
from labyrinth_sim.trials import Array

ROUNDS = 6
NEAR_BEST = 2.0  # times the best refit's cost; what is within is searched again
STARTS_EACH = 3  # places where an effect of several values starts
TAKEN_APART = 3  # best sets of several effects, and of one, that are tried without each effect or with a simple form
MISFITTED = 1.02  # times the cost of a set that it contains; a refit that leaves more has not converged
A_LITTLE = 0.05  # of a typical effect, with which it begins where its off values have no slope


def nested_refits(search: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """The base and the refits. A refit that fits worse than sets it contains starts again from the best of these; sets
    contained in the best ones, the base among them, start again from the values of these, and so do simple forms of
    their effects.

    A set that contains another, or an effect that contains another one, can always imitate it, so it cannot fit worse;
    if it still does, it has not converged. And one more effect may have helped only because the drive's values left a
    wrong valley along with it, so these values are also tried without it.
    """
    fewer = _without_one(search, refits)
    reach = OUT_OF_REACH * max(1.0, lowest([base, *refits]).cost)
    jobs = [job for job, r in zip(fewer, search.refit(fewer, ROUNDS), strict=True) if r.cost < reach]
    jobs += _with_simpler(search, refits)
    for refit in refits:
        better = sorted((s for s in (base, *refits) if refit.cost > MISFITTED * s.cost), key=lambda s: s.cost)
        starts_again = (start for s in better if (start := contained(search, refit, s)) is not None)
        # From the best of them it cannot end above the others.
        tried = itertools.islice(starts_again, None if search.exhaustive else 1)
        jobs += [(search.library.of(refit.effects), start) for start in tried]
    bare, sets = base_and_sets([base, *refits, *search.judged(jobs, ROUNDS)])

    def misfits(refit: Refit) -> bool:
        return any(refit.cost > MISFITTED * s.cost and contained(search, refit, s) is not None for s in (bare, *sets))

    return bare, [replace(refit, converged=not misfits(refit)) for refit in sets]


def general_refits(search: Search, refits: Sequence[Refit]) -> list[Refit]:
    """Those near the best that leave something, and add something to fewer of their effects, with an effect replaced by
    a more general form that is not known to fit materially better. It starts from the simple form's values, with each
    value of its own that the simple one lacks.

    Where it only imitates the simple form, a general one may have no slope that leads away.
    """
    known = {frozenset(r.effects): r.cost for r in refits}
    best = min(known.values(), default=0.0)
    jobs: list[Job] = []
    near = [r for r in refits if r.cost < NEAR_BEST * best and leaves_something(search, r)]
    for refit in that_add_something(search, near, refits):
        for name, general in itertools.product(refit.effects, search.library.candidates):
            wider = replace(refit, effects=(*(n for n in refit.effects if n != name), general.name))
            shared = _shared(general, search.library.find(name))
            start = contained(search, wider, refit) if shared and general.name not in refit.effects else None
            if start is None or known.get(frozenset(wider.effects), np.inf) < refit.cost - SETTINGS.material:
                continue
            points = _spread(search, general, start, shared)
            jobs += [(search.library.of(wider.effects), point) for point in best_points(search, points, STARTS_EACH)]
    return search.best_of(jobs, ROUNDS, best) if jobs else []


def that_add_something(search: Search, refits: Sequence[Refit], known: Sequence[Refit]) -> list[Refit]:
    """The refits without those whose effects contain another known set of effects and explain no more that matters."""
    return [r for r in refits if search.exhaustive or not any(_adds_nothing(r, fewer) for fewer in known)]


def _adds_nothing(refit: Refit, fewer: Refit) -> bool:
    contains = bool(fewer.effects) and set(fewer.effects) < set(refit.effects)
    return contains and refit.cost > fewer.cost - SETTINGS.material


def best_points(search: Search, points: Array, count: int, level: Level = "coarse") -> Array:
    """(count, K) the best of values (n, K), best first."""
    cost = np.nan_to_num(np.mean(search.residuals(points, level) ** 2, axis=1), nan=np.inf)
    return np.asarray(points[np.argsort(cost, kind="stable")[:count]])


def _shared(general: Candidate, simple: Candidate) -> dict[str, str]:
    """Parameter of a general form -> parameter of a simple one that it is; none if it is no form of it."""
    return {own: its for own, its in _as_simple(general, simple) if isinstance(its, str)}


def _as_simple(general: Candidate, simple: Candidate) -> list[tuple[str, str | float]]:
    """Parameters of a general form, and what each has to be for it to act as a simple one at the same place: a
    parameter of that, or a number. Empty if it is no form of it.
    """
    rows = general.effect.contains if general.place == simple.place else ()
    return [(own, its) for own, effect, its in rows if effect == simple.effect.name]


def _spread(search: Search, general: Candidate, start: Array, kept: Collection[str]) -> Array:
    """(n, K) values with all combinations of a candidate's starts in those of its parameters that are not kept."""
    columns = search.columns(general)
    each = [
        [start[column]] if parameter.name in kept else np.unique(tried)
        for parameter, column, tried in zip(general.declared, columns, starts(general).T, strict=True)
    ]
    rows = list(itertools.product(*each))
    points = np.tile(start, (len(rows), 1))
    points[:, columns] = rows
    return search.within(points)


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
    return base_and_sets([base, *refits, *again])


def complete(search: Search, refit: Refit, allowed: float = SETTINGS.healthy) -> bool:
    """Whether a refit leaves too little for more to be looked for; `allowed` floors count as nothing missing."""
    return worst_floors(refit.residuals, search.signal) <= SETTINGS.close * allowed


def leaves_something(search: Search, refit: Refit) -> bool:
    """Whether a refit leaves more than noise, so that another valley may fit better."""
    return search.exhaustive or not complete(search, refit)


def _without_one(search: Search, refits: Sequence[Refit]) -> list[Job]:
    """The best sets of effects, single ones included, each without one effect, at the values of the full set.

    A general form of that effect may have left to it what it can do as well, such as the lower of two limits, so it is
    tried with its values, too.
    """
    jobs: list[Job] = []
    for refit in _best(refits):
        for name in refit.effects:
            kept, values = without(search, refit, name)
            if kept and {c.name for c in kept} in [{c.name for c in other} for other, _ in jobs]:
                continue
            jobs.append((kept, search.within(values)))
            simple = search.library.find(name)
            for general in (c for c in kept if _shared(c, simple)):
                taken_over = values.copy()
                for own, its in _shared(general, simple).items():
                    taken_over[_column(search, general, own)] = refit.values[_column(search, simple, its)]
                jobs.append((kept, search.within(taken_over)))
    return jobs


def without(search: Search, refit: Refit, name: str) -> Job:
    """The other effects of a refit, and its (K,) values with this one switched off."""
    values, columns = refit.values.copy(), search.columns(search.library.find(name))
    values[columns] = search.start[columns]
    return search.library.of(n for n in refit.effects if n != name), values


def _with_simpler(search: Search, refits: Sequence[Refit]) -> list[Job]:
    """The best sets, each with a simple form in the place of a general one that fits materially better, at its values.

    A general form may have left a wrong valley of the drive's values by itself.
    """
    known = {frozenset(r.effects): r.cost for r in refits}
    jobs: list[Job] = []
    for refit, simple in itertools.product(_best(refits), search.library.candidates):
        for name in refit.effects:
            general = search.library.find(name)
            shared = _shared(general, simple)
            if not shared or simple.name in refit.effects:
                continue
            others, values = without(search, refit, name)
            kept = (*others, simple)
            if known.get(frozenset(c.name for c in kept), np.inf) < refit.cost + SETTINGS.material:
                continue
            for its in set(shared.values()):
                own = [_column(search, general, o) for o, i in shared.items() if i == its]
                values[_column(search, simple, its)] = np.mean(refit.values[own])
            jobs.append((kept, search.within(values)))
    return jobs


def _best(refits: Sequence[Refit]) -> list[Refit]:
    """The best sets of several effects and of single ones."""
    ordered = sorted(refits, key=lambda r: r.cost)
    several, single = ([r for r in ordered if r.several == many] for many in (True, False))
    return [*several[:TAKEN_APART], *single[:TAKEN_APART]]


def contained(search: Search, larger: Refit, smaller: Refit) -> Array | None:
    """(K,) values at which the larger set does what the smaller one does, as far as its bounds allow; None if it
    cannot.
    """
    values = smaller.values.copy()
    added = [name for name in larger.effects if name not in smaller.effects]
    for name in (n for n in smaller.effects if n not in larger.effects):
        own = search.library.find(name)
        wider = [c for c in map(search.library.find, added) if _as_simple(c, own)]
        kept = {its for c in wider[:1] for _, its in _as_simple(c, own)}
        alone = [p.name for p in own.declared if p.off is not None and p.name not in kept]
        if not wider or not all(_is_off(search, own, name, smaller.values) for name in alone):
            return None
        general = wider[0]
        for parameter, its in _as_simple(general, own):
            number = its if isinstance(its, float) else smaller.values[_column(search, own, its)]
            values[_column(search, general, parameter)] = number
        values[search.columns(own)] = search.start[search.columns(own)]
        added.remove(general.name)
    if set(smaller.effects) == set(larger.effects):
        return None
    return search.within(weakly(search, values, added))


def weakly(search: Search, values: Array, effects: Sequence[str]) -> Array:
    """(K,) values with a little of some effects, because at their off values they have no slope."""
    weak = values.copy()
    for candidate in search.library.of(effects):
        for p, column in zip(candidate.declared, search.columns(candidate), strict=True):
            weak[column] = weak[column] if p.off is None else p.off + A_LITTLE * (p.typical - p.off)
    return weak


def _is_off(search: Search, candidate: Candidate, parameter: str, values: Array) -> bool:
    """Whether a candidate's parameter acts on nothing at values (K,), as far as a descent can tell."""
    place = _place(candidate, parameter)
    column, off = search.columns(candidate)[place], candidate.declared[place].off
    return off is not None and bool(abs(values[column] - off) < AT_BOUND * search.spans[column])


def _column(search: Search, candidate: Candidate, parameter: str) -> int:
    """Column of one of a candidate's parameters among the library's values."""
    return search.columns(candidate)[_place(candidate, parameter)]


def _place(candidate: Candidate, parameter: str) -> int:
    return [p.name for p in candidate.declared].index(parameter)
