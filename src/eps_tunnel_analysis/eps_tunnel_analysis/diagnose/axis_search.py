# SPDX-License-Identifier: Apache-2.0
"""One axis at a time: its signals, its candidates, and the refits of all of them.

Axes hardly couple, so an axis whose signals the model explains needs no candidates, and the others are searched with
half the values.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from eps_tunnel_analysis.diagnose.ball import BALL, BALL_DIFFERENCE, inexactness, on_ball, part_name, values_of
from eps_tunnel_analysis.diagnose.base_refit import base_starts
from eps_tunnel_analysis.diagnose.candidates import Library, library
from eps_tunnel_analysis.diagnose.refit import Job, Level, Look, Refit
from eps_tunnel_analysis.diagnose.samples import begun, floors, kept_samples, steady_efforts
from eps_tunnel_analysis.diagnose.search import DIFFERENCE, Search
from eps_tunnel_analysis.fit.free import by_axis, default_free
from eps_tunnel_analysis.fit.objective import Objective
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.effect import rivals
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS

COARSE = 0.005  # s, MuJoCo's step while searching
FINE = 0.0025  # s, where that errs
EXACT = 0.00125  # s, while judging; at 2.5 ms a torque that saturates in quick motion errs by half a floor
REBASED = 3  # refits whose base values are sought anew, each from
REBASE_STARTS = 3  # starts, its own among them
SHORTLIST = 12  # candidates refitted from their looks
LOOKS_EACH = 2
ROUNDS = 6

Progress = Callable[[str, int], None]
"""Told what is being done and how many roll-outs were made."""


@dataclass(frozen=True)
class AxisPart:
    """What belongs to one axis.

    Attributes:
        axis: its short name.
        signals: compared; positions first, then efforts.
        base: full names of the values refitted with every candidate.
    """

    axis: str
    signals: tuple[str, ...]
    base: tuple[str, ...]


def axis_parts(model: Model, plays: Sequence[Play]) -> list[AxisPart]:
    """Every axis that has a signal in all plays."""
    known = {name for play in plays for name in play.known}
    known |= values_of(model)  # shows in the ball alone
    names = [n for n in default_free(model) if n not in known and not _silent_integral(model, n)]
    base = {part.axis: part.free for part in by_axis(model, names, plays, None)}
    parts = []
    for axis in model.rig.axes:
        seen = [m for m in axis.measured if all(m.signal in p.trials.signals for p in plays)]
        chosen = [m.signal for q in ("position", "torque") for m in seen if m.quantity == q]
        if any(m.quantity == "position" for m in seen):
            parts.append(AxisPart(axis.name, tuple(chosen), tuple(base.get(axis.name, ()))))
    return parts


def ball_part() -> AxisPart:
    """The ball, judged as an axis is; without base values, for friction refitted would take up a latency."""
    return AxisPart(BALL, BALL_SIGNALS, ())


def _silent_integral(model: Model, name: str) -> bool:
    """A drive whose law has no integral part keeps none: it would stand in for any steady torque."""
    return name.startswith("drive.") and name.endswith(".i") and model.values()[name] == 0.0


def axis_search(
    model: Model,
    plays: Sequence[Play],
    part: AxisPart,
    only: Sequence[str] | None = None,
    nthread: int = 0,
    told: Progress | None = None,
) -> Search:
    """A search over the candidates of one axis."""
    whole = library(model, part.base, part.axis == BALL, only)
    mine = tuple(c for c in whole.candidates if c.axes == (part.axis,))
    if part.axis == BALL:
        mine = tuple(replace(c, axes=()) for c in whole.candidates if on_ball(c.effect))
    for candidate in whole.candidates:
        if candidate.name not in [c.name for c in mine]:
            whole = replace(whole, model=whole.model.without_effect(candidate.effect.name, candidate.place))
    lib = Library(whole.model, part.base, mine)
    steps: dict[Level, float] = {"coarse": COARSE, "fine": FINE, "exact": EXACT}
    levels = {k: Objective(lib.model, lib.names, plays, part.signals, step, nthread) for k, step in steps.items()}
    objective = levels["coarse"]
    torque = [m.signal for m in model.rig.measured if m.quantity == "torque"]
    channel = next((axis.command for axis in model.rig.axes if axis.name == part.axis), "")
    used = np.flatnonzero(~np.isin(objective.blocks % len(part.signals), efforts := _columns(part.signals, torque)))
    if efforts:
        used = np.sort(np.concatenate([used, steady_efforts(objective, plays, channel, efforts)]))
    used = used[begun(objective, plays)[used]]
    full = model.values().get(f"drive.{part.axis}.torque", 0.0)
    scale = floors(objective, plays, efforts, channel, full)
    if part.axis == BALL:
        scale = np.hypot(scale, inexactness(objective.samples * plays[0].trials.step))
    kept = kept_samples(objective, plays)
    count = partial(told, part_name(part.axis)) if told else None
    return Search(lib, levels, scale, kept, used, count, BALL_DIFFERENCE if part.axis == BALL else DIFFERENCE)


def _columns(signals: Sequence[str], which: Sequence[str]) -> list[int]:
    return [i for i, name in enumerate(signals) if name in which]


def next_refits(search: Search, on: Sequence[Refit], shortlist: int = SHORTLIST, unless: float = np.inf) -> list[Refit]:
    """Every candidate refitted on top of refits: looks, then descents of the most promising; best first.

    Args:
        on: the best first; where several effects act, one of them alone may not be what explains most.
        unless: nothing is refitted where no look promises less than this share of the best one's cost.
    """
    search.settle_at(on[0])
    size = len(search.library.base)
    nominal = on[0].values.copy()
    nominal[:size] = search.start[:size]
    points = [on[0], *(search.at(other.values, other) for other in on[1:])]
    # Base values that made up for the missing effect lie in the wrong valley; the model's own may not.
    if not np.allclose(nominal, on[0].values) or on[0].effects:
        points.append(search.at(nominal, on[0]))
    looks = search.looks(points, search.library.candidates)
    if looks and looks[0].promised > unless * on[0].cost:
        return []
    return _rebased(search, search.best_of(_jobs(search, points, looks, shortlist), ROUNDS))


def _jobs(search: Search, points: Sequence[Refit], looks: Sequence[Look], shortlist: float) -> list[Job]:
    """The best looks of each of the `shortlist` most promising sets, to be fitted on top of `points`.

    A set starts from every point that leads to it, for the base that fits best without an effect may lie in a valley
    where the effect does not help.
    """
    chosen: dict[frozenset[str], list[Look]] = {}
    for look in looks:
        name = frozenset([*points[look.on].effects, look.candidate.name])
        if name in chosen or len(chosen) < shortlist:
            chosen.setdefault(name, []).append(look)
    jobs: list[Job] = []
    for same in chosen.values():
        first = [look for i, look in enumerate(same) if look.on not in [other.on for other in same[:i]]]
        for look in (first if len(first) > 1 else same)[:LOOKS_EACH]:
            fitted = tuple(search.library.find(name) for name in points[look.on].effects)
            jobs.append(((*fitted, look.candidate), look.values))
    return jobs


def _rebased(search: Search, refits: Sequence[Refit]) -> list[Refit]:
    """The refits, the best of them descended again from other base values: those found may lie in a wrong valley.

    The others' base values are among those tried: whatever is missing, the drive is the same.
    """
    again: dict[frozenset[str], Refit] = {frozenset(refit.effects): refit for refit in refits}
    size = len(search.library.base)
    jobs: list[Job] = []
    for refit in refits[:REBASED] if size else ():
        points = base_starts(search, refit.values, REBASE_STARTS)[1:]
        others = [np.concatenate([r.values[:size], refit.values[size:]]) for r in refits[:REBASED] if r is not refit]
        jobs += [(tuple(search.library.find(n) for n in refit.effects), point) for point in (*points, *others)]
    for refit in search.best_of(jobs, ROUNDS) if jobs else []:
        if refit.overall < again[frozenset(refit.effects)].overall:
            again[frozenset(refit.effects)] = refit
    return sorted(again.values(), key=lambda r: (r.cost, r.effects))


def rival_refits(search: Search, best: Refit, tried: Sequence[Refit]) -> list[Refit]:
    """The refit with each of its effects replaced by those that it is mistaken for, where that was not tried yet."""
    known = {frozenset(r.effects) for r in tried}
    jobs: list[Job] = []
    for name in best.effects:
        others = tuple(search.library.find(n) for n in best.effects if n != name)
        mistaken = rivals(name.partition(".")[0])
        candidates = [c for c in search.library.candidates if c.effect.name in mistaken and c.name not in best.effects
                      and frozenset([*(o.name for o in others), c.name]) not in known]  # fmt: skip
        if not candidates:
            continue
        without = best.values.copy()
        columns = search.columns(search.library.find(name))
        without[columns] = search.start[columns]
        rest = replace(search.at(without, best), effects=tuple(o.name for o in others))
        jobs += _jobs(search, [rest], search.looks([rest], candidates), np.inf)
    return search.best_of(jobs, ROUNDS) if jobs else []
