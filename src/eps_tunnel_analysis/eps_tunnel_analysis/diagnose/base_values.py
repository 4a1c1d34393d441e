# SPDX-License-Identifier: Apache-2.0
"""The values that a model already has, fitted before anything is added to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_search, joined, side_by_side
from eps_tunnel_analysis.diagnose.prescribed import Motions, coupled_with, measured_motions, with_prescribed_motion
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.roll_outs import STANDS
from eps_tunnel_analysis.diagnose.search import HOPELESS, Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

BASE_POINTS = 64  # values of the base tried before it is descended, and
BASE_STARTS = 8  # how many of them are descended
APART = 0.1  # of a value's span, between starts
NEAR_OWN = 0.2  # of a value's span, where half of them lie around the model's own
BASE_ROUNDS = 8  # of each descent
COMPARED_ROUNDS = 3  # of the finalists, before they are compared
VALLEY_POINTS = 8  # to either side of the best, along the direction that it determines least
MORE_DESCENTS = 3  # further descents at most, as long as the last one helped
GRADUAL = 3e-4  # rad/s, from which friction that sets in gradually is descended
BASE_FINALISTS = 3  # of the starts, descended to the end
SLEEPING_POINTS = 8  # from what is stated to a bound, at which a value that does not show is tried
WOKEN = 2  # of these values that are fitted from there


@dataclass(frozen=True)
class Bases:
    """Base values of several axes.

    Attributes:
        values: full name -> value.
        evaluations: roll-outs that it took.
        left: part -> floors that these values leave on it, where they were fitted.
        motions: of axes that inertia couples, as they were measured.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    evaluations: int = 0
    left: Mapping[str, float] = field(default_factory=dict)
    motions: Motions = field(default_factory=dict)

    def among(self, model: Model, plays: Sequence[Play], part: AxisPart) -> tuple[Model, list[Play]]:
        """The model and the plays for the search on one part: the axes that it is coupled with move as they were
        measured, the others by their refitted values.
        """
        fitted = model.with_values({n: v for n, v in self.values.items() if n not in part.base}, "refitted")
        return with_prescribed_motion(fitted, plays, self.motions, coupled_with(model, part.axes))

    def known(self, part: AxisPart) -> dict[str, float] | None:
        """The values of one part; None unless all are known."""
        return {n: self.values[n] for n in part.base} if part.base and set(part.base) <= set(self.values) else None


def stated_bases(model: Model, plays: Sequence[Play], parts: Sequence[AxisPart]) -> Bases:
    """The base values of every axis as the model states them."""
    stated = model.values()
    return Bases({n: stated[n] for part in parts for n in part.base}, motions=measured_motions(model, plays))


def fitted_bases(
    model: Model, plays: Sequence[Play], parts: Sequence[AxisPart], run: SearchOptions, roughly: bool = False
) -> Bases:
    """The base values of every axis, each fitted while the axes that it is coupled with move as they were measured;
    then axes together that are judged together.

    Args:
        roughly: as start values for diagnoses of each axis, and of coupled axes together, which fit them on.
    """
    chosen = [p for p in parts if p.base]
    groups = [group for group in joined(model, chosen) if len(group.axes) > 1]
    coupled = {name for group in groups for name in group.axes}
    if roughly and len(groups) == 1 and len(coupled) == len(chosen):
        groups = []  # its diagnosis is all that follows
    bases = Bases(motions=measured_motions(model, plays))
    for together in ([(p, roughly or p.name in coupled) for p in chosen], [(group, roughly) for group in groups]):
        if not together:
            continue
        fits = side_by_side(partial(_fitted, model, plays, bases), together, run)
        values = {n: v for one in (bases, *fits) for n, v in one.values.items()}
        left = {n: v for one in (bases, *fits) for n, v in one.left.items()}
        evaluations = bases.evaluations + sum(one.evaluations for one in fits)
        motions = measured_motions(model.with_values(values, "refitted"), plays) if bases.motions else {}
        bases = Bases(values, evaluations, left, motions)
    return bases


def _fitted(
    model: Model, plays: Sequence[Play], bases: Bases, part_roughly: tuple[AxisPart, bool], run: SearchOptions
) -> Bases:
    """The base values of one part, roughly or not, while the other parts have the values of `bases`."""
    part, roughly = part_roughly
    search = axis_search(*bases.among(model, plays, part), part, replace(run, only=()))
    refit = base_refit(search, bases.known(part), roughly)
    values = search.library.base_of(refit.values)
    return Bases(values, search.evaluations, {part.name: refit.cost})


def base_refit(
    search: Search, known: Mapping[str, float] | None = None, roughly: bool = False, fitted: bool = False
) -> Refit:
    """The base values alone: descended from the model's own and from the best of many others.

    Delay and D can compensate for each other, and a base stuck in the wrong valley makes any effect look good.

    Args:
        known: values from an earlier search; the descent continues from these.
        roughly: only in the best valley, judged by the fine level.
        fitted: the known values are the model's own, from an earlier diagnosis. If they leave more than a healthy rig
            does, other valleys are looked for as well.
    """
    if known is None:
        points = base_starts(search, search.start, BASE_STARTS)
    else:
        points = [search.library.with_base(search.start, np.array([known[name] for name in search.library.base]))]
    if roughly:
        return _in_valleys(search, points, first=True)[0]
    refit = base_from(search, points, first=True)
    if fitted and worst_floors(refit.residuals, search.signal) > SETTINGS.healthy:
        other = base_from(search, base_starts(search, search.start, BASE_STARTS))
        refit = min(refit, other, key=lambda r: r.objective)
        search.settle_at(refit)
    return refit


def base_starts(search: Search, values: Array, keep: int) -> list[Array]:
    """The (K,) values, and those with other base values that fit best out of many, each from a different valley."""
    size = len(search.library.base) - search.library.rough
    from scipy.stats import qmc  # half a second to import

    drawn = qmc.Sobol(size, rng=0, scramble=True).random(BASE_POINTS) if size else np.empty((0, 0))
    span = search.spans[:size]
    points = np.tile(values, (len(drawn) + 1, 1))
    near = len(drawn) // 2
    points[1 : near + 1, :size] = search.start[:size] + (drawn[:near] - 0.5) * NEAR_OWN * span
    points[near + 1 :, :size] = search.low[:size] + drawn[near:] * span
    points = search.within(points)
    cost = np.mean(search.residuals(points) ** 2, axis=1)
    cost[0] = -1.0  # the given values are tried in any case
    chosen: list[Array] = []
    for i in np.argsort(np.nan_to_num(cost, nan=np.inf), kind="stable"):
        if all(np.any(np.abs(points[i] - other)[:size] > APART * span) for other in chosen):
            chosen.append(points[i])
    return chosen[:keep]


def _in_valleys(search: Search, points: Sequence[Array], first: bool) -> list[Refit]:
    """The base values alone, descended at the fine level from the best valleys among (K,) values, best first.

    A single point is assumed to lie in it.

    Args:
        first: nothing was refitted before; then the noise floor is settled, too.
    """
    starts = [search.library.with_base(search.start, point) for point in points]
    if len(starts) > 1:
        finer = best_valleys(search, starts)
    else:
        finer = search.refit([((), starts[0])], 0, "fine", rough=False)
    joints = sensed_joints(search)
    if first and joints:
        search.settle_start(finer[0], joints)
        search.see_ticks(finer[0].values)
    search.feel(finer[0])
    last = search.refit([((), r.values) for r in finer], BASE_ROUNDS, "fine")
    return sorted(last, key=lambda r: r.objective)


def base_from(search: Search, points: Sequence[Array], first: bool = False) -> Refit:
    """The base values alone, descended from (K,) values whose effects do not count; the search is settled there.

    Args:
        first: nothing was refitted before; then the noise floor is settled, too.
    """
    valleys = _in_valleys(search, points, first)
    if not search.refine_at(valleys[0].values):
        valleys = valleys[:1]  # else the longer steps may have misjudged which is the best
    result = min(search.judged([((), r.values) for r in valleys], BASE_ROUNDS), key=lambda r: r.objective)
    if first and worst_floors(result.residuals, search.signal) > 1.0:
        (result,) = softened(search, [result])
        result = woken(search, result)
    for number in range(MORE_DESCENTS):
        if worst_floors(result.residuals, search.signal) < 1.0:
            break
        search.settle_at(result)
        if number:
            going = [result]
        else:
            away = search.refit([((), point) for point in along_valley(search, result)], BASE_ROUNDS)
            going = [r for r in away if r.objective < result.objective]
        before = result
        finished = search.judged([((), r.values) for r in going], BASE_ROUNDS)
        result = min([before, *finished], key=lambda r: r.objective)
        if result.objective > (1.0 - STANDS) * before.objective:
            break
    if first:
        agreement = search.ticks_agree(result)
        if agreement.any():
            search.see_ticks(result.values, agreement)
            result = search.judged([((), result.values)], BASE_ROUNDS)[0]
    search.settle_at(result)
    return result


def woken(search: Search, refit: Refit) -> Refit:
    """The base with values fitted that do not show near what is stated, but further off, if it leaves more than noise.

    A motor that turns more slowly than is stated limits only the fastest moves, and no slope leads there.
    """
    for _ in range(MORE_DESCENTS):
        sleeping = np.flatnonzero(search.idle & ~search.sharp)
        if not len(sleeping) or worst_floors(refit.residuals, search.signal) < 1.0:
            break
        search.settle_at(refit)
        found = [refit]
        for column, point in _showing(search, refit, sleeping)[:WOKEN]:
            search.idle[column] = False
            found += search.judged([((), point)], BASE_ROUNDS)
            search.idle[column] = True
        best = min(found, key=lambda r: r.objective)
        if best.objective > (1.0 - STANDS) * refit.objective:
            break
        search.feel(best)
        refit = min([best, *search.judged([((), best.values)], BASE_ROUNDS)], key=lambda r: r.objective)
    return refit


def _showing(search: Search, refit: Refit, columns: NDArray[np.int64]) -> list[tuple[int, Array]]:
    """Columns in which a value shows somewhere within its bounds, and (K,) where that fits best; best first."""
    shares = np.arange(1, SLEEPING_POINTS + 1) / SLEEPING_POINTS
    ways = [(column, end) for column in columns for end in (search.low[column], search.high[column])
            if end != refit.values[column]]  # fmt: skip
    if not ways:
        return []
    moved = np.repeat([column for column, _ in ways], SLEEPING_POINTS)
    points = np.tile(refit.values, (len(moved), 1))
    points[np.arange(len(moved)), moved] = np.ravel(
        [refit.values[column] + shares * (end - refit.values[column]) for column, end in ways]
    )
    there = search.residuals(points)
    shows = np.mean((there - refit.residuals) ** 2, axis=1) >= SETTINGS.unfelt
    found: dict[int, Array] = {}
    for row in np.argsort(np.mean(there**2, axis=1), kind="stable"):
        if shows[row]:
            found.setdefault(int(moved[row]), points[row])
    return list(found.items())


def softened(search: Search, refits: Sequence[Refit]) -> list[Refit]:
    """The refits with dry friction that sets in gradually where the model's own is sharp, if that fits any of them
    better.

    Torque noise lets a joint creep that friction should hold. How gradually it sets in is free from then on.
    """
    sharp = search.sharp
    if not sharp.any() or not refits:
        return list(refits)
    search.sharp = np.zeros_like(sharp)
    starts = [np.where(sharp & (r.values == 0.0), GRADUAL, r.values) for r in refits]
    jobs = [(search.library.of(r.effects), start) for r, start in zip(refits, starts, strict=True)]
    pairs = list(zip(refits, search.judged(jobs, BASE_ROUNDS), strict=True))
    if not any(softer.objective < (1.0 - STANDS) * before.objective for before, softer in pairs):
        search.sharp = sharp
        return list(refits)
    return [min(pair, key=lambda r: r.objective) for pair in pairs]


def best_valleys(search: Search, starts: Sequence[Array]) -> list[Refit]:
    """The base values alone, from the best of several (K,) values and from far along the best one's valley."""
    early = search.refit([((), point) for point in starts], BASE_ROUNDS, rough=False, race=np.inf)
    best = sorted(early, key=lambda r: r.objective)[:BASE_FINALISTS]
    finer = search.refit([((), r.values) for r in best], COMPARED_ROUNDS, "fine", rough=False)
    away = along_valley(search, min(finer, key=lambda r: r.objective))
    beside = search.refit([((), point) for point in away], BASE_ROUNDS, rough=False)
    finer += search.refit([((), r.values) for r in beside], COMPARED_ROUNDS, "fine", rough=False)
    return sorted(finer, key=lambda r: r.objective)[:BASE_FINALISTS]


def better_base(search: Search, base: Refit, points: Sequence[Array], best: float) -> Refit:
    """The base descended from those (K,) values that lie elsewhere, if it fits better; the search is settled there.

    Args:
        best: floors that the best set of effects leaves. Of a base that leaves many times more, another valley counts
            only if it is clearly deeper.
    """
    size = len(search.library.base)
    starts = [search.library.with_base(search.start, point) for point in points] if size else []
    span = search.spans[:size]
    apart = STANDS * max(1.0, base.objective)
    near = base.cost < HOPELESS * max(1.0, best)
    elsewhere = [
        r.values
        for r in search.refit([((), start) for start in starts], BASE_ROUNDS, rough=False)
        if r.objective < base.objective - apart
        or (
            near
            and r.objective < base.objective + apart
            and np.any(np.abs(r.values - base.values)[:size] > APART * span)
        )
    ]
    again = base_from(search, elsewhere) if elsewhere else base
    if again.cost < base.cost:
        return again
    search.settle_at(base)
    return base


def sensed_joints(search: Search) -> list[list[str]]:
    """For each joint whose position is compared, its signals, finest first."""
    joints: dict[str, list[str]] = {}
    for axis in search.library.model.rig.axes:
        for m in axis.finest_first:
            if m.quantity == "position" and m.signal in search.evidence.signals:
                joints.setdefault(m.joint, []).append(m.signal)
    return list(joints.values())


def along_valley(search: Search, refit: Refit) -> list[Array]:
    """(K,) values far from a refit's along the direction that it determines least, the best to either side.

    Values that can compensate for each other, such as D and delay, make a long valley with more than one minimum.
    """
    columns, weakest = search.weakest(refit)
    if not columns:
        return []
    span = search.spans[columns]
    width = (search.high - search.low)[columns] / span
    points = []
    for sign in (1.0, -1.0):
        here = (refit.values - search.low)[columns] / span
        way = sign * weakest
        ahead = np.where(way > 0.0, width - here, here)[way != 0.0]
        room = float(np.min(ahead / np.abs(way[way != 0.0])))
        tried = np.tile(refit.values, (VALLEY_POINTS, 1))
        tried[:, columns] += np.linspace(0.0, room, VALLEY_POINTS + 1)[1:, None] * way * span
        tried = search.within(tried)
        cost = np.mean(search.residuals(tried) ** 2, axis=1)
        points.append(tried[int(np.argmin(np.nan_to_num(cost, nan=np.inf)))])
    return points
