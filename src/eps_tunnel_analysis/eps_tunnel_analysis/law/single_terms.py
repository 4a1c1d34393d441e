# SPDX-License-Identifier: Apache-2.0
"""Every term of the dictionaries by itself, in roll-outs that begin at many of its values; and one more on the best.

The linear problem is rough where base values make up for most of what is missing, or where an axis sticks: a term may
explain nothing there, and nearly all once the base values are refitted together with it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.diagnose.axis import hypothesis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, search_of
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library
from eps_tunnel_analysis.diagnose.refits import Job, Refit
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law.depends import Dependence, Depends
from eps_tunnel_analysis.law.design import Design, Explained, Predictor
from eps_tunnel_analysis.law.effect_file import declared, effect_file
from eps_tunnel_analysis.law.formula import Chosen, Dictionary, Formula, Number, Term, best_shape
from eps_tunnel_analysis.law.refit import library_of
from eps_tunnel_analysis.simulated import Play
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

FARTHEST = 10.0  # times its typical size or shape, of what a term may be
OF_LOAD = 0.1  # of the drive's load, root mean square: the typical size of a force, where less is missing
OF_MOTION = 0.03  # of the range of angles: the typical size of an error of a sensor or of the command
PROMISING = 8  # terms that are descended: those that promise most to first order
TERM_ROUNDS = 10  # of descent
KEPT = 3
STANDS_FOR = ("command", "direction")  # variables that are tried as forces, but that no term of a force is over


def single_terms(
    design: Design, dependence: Depends, model: Model, plays: Sequence[Play], part: AxisPart,
    dictionaries: Sequence[Dictionary], nthread: int = 0, seed: int = 0,
) -> list[tuple[Dependence, Formula]]:  # fmt: skip
    """Formulas of one term that leave least in roll-outs, and explain more than chance does of what they are over; and
    of two where one leaves much.

    Waves are left out: the linear problem finds their period, and roll-outs from a wrong one do not.

    Args:
        model: without them, its values refitted.
        dictionaries: of every place where something may act.
    """
    every = list(_terms(design, dependence, dictionaries))
    placed = []
    for i, (way, chosen) in enumerate(every):
        effect = declared(effect_file([chosen]))
        placed.append((replace(effect, name=f"{effect.name}_{i}"), way.place))
    library = library_of(model, part, placed)
    owner = dict(zip((c.name for c in library.candidates), every, strict=True))

    def acts(refit: Refit) -> tuple[str, str]:
        return owner[refit.effects[0]][0].acts

    search = search_of(library, plays, part, SearchOptions((), nthread))
    base = search.refit([((), search.start)], 1)[0]
    alone = _descended(search, [base], library.candidates)[:KEPT]
    best = [refit for refit in alone if acts(refit) == acts(alone[0])]
    more: list[Refit] = []
    if best and best[0].cost > SETTINGS.law_complete:
        here = [c for c in library.candidates if owner[c.name][0].acts == acts(best[0])]
        enough = best[0].cost - max(SETTINGS.material, SETTINGS.share * best[0].cost)
        more = [refit for refit in _descended(search, best, here)[:KEPT] if refit.cost <= enough]
    laws = []
    without = _left_out(search, base)
    for refit in [*alone, *more]:
        explained = _explained(without, _left_out(search, refit), len(search.used))
        ways = [owner[name][0] for name in refit.effects]
        if explained.share > ways[0].chance:
            share, interval = explained.share, explained.interval(seed)
            terms = tuple(_fitted(owner[name][1], name, refit, library) for name in refit.effects)
            laws.append((replace(ways[0], share=share, interval=interval, named=True), Formula(terms, share, interval)))
    return laws


def _descended(search: Search, begun: Sequence[Refit], candidates: Sequence[Candidate]) -> list[Refit]:
    """Refits with one more term than any of some has, best first, of those that promise most to first order."""
    promised: dict[frozenset[str], tuple[float, Job]] = {}
    for refit in begun:
        for point in search.trial_points([refit], candidates):
            added = (*search.library.of(refit.effects), point.candidate)
            key = frozenset(c.name for c in added)
            if key not in promised or point.promised < promised[key][0]:
                promised[key] = point.promised, (added, point.values)
    most = sorted(promised.values(), key=lambda one: one[0])[:PROMISING]
    return search.best_of([job for _, job in most], TERM_ROUNDS)


def _fitted(chosen: Chosen, name: str, refit: Refit, library: Library) -> Chosen:
    """A term with the numbers of a refit, in which it is the effect of this name."""
    values = dict(zip(library.names, refit.values, strict=True))
    prefix = f"{name}.{chosen.term.name}_"
    return replace(chosen, values={n.name: float(values[prefix + n.name]) for n in chosen.term.numbers})


def _left_out(search: Search, refit: Refit) -> Array:
    """(F,) sum of squares that a refit leaves in each stretch of time that was left out."""
    return np.asarray(np.bincount(search.folds, hypothesis(search, refit).left_out ** 2), dtype=np.float64)


def _explained(without: Array, left: Array, samples: int) -> Explained:
    """What terms explain where they leave (F,) of (F,) squares in each stretch."""
    share, fall = 1.0 - left.sum() / without.sum(), (without.sum() - left.sum()) / samples
    return Explained(float(share), np.column_stack([without, left]), np.empty(0), float(fall))


def _terms(
    design: Design, dependence: Depends, dictionaries: Sequence[Dictionary]
) -> Iterator[tuple[Dependence, Chosen]]:
    """Every term that is no wave, of a typical size and the shape that is best in the linear problem, with what it is
    over.
    """
    error = OF_MOTION * max(float(np.ptp(p.motion.angle)) for p in design.plays)
    loads = np.concatenate([p.motion.load for p in design.plays])
    force = max(design.missing.size, OF_LOAD * float(np.sqrt(np.mean(loads**2))))
    for acts, number, terms in dictionaries:
        size = force if number is None else error
        about = design.at(number)
        linear, motions = Predictor(about), [p.motion for p in about.plays]
        for term in terms:
            way = _way(dependence, acts, term)
            if way is None or "period" in [n.name for n in term.numbers]:
                continue
            shape, _ = best_shape(about, linear, term, number, {})
            moves = np.concatenate([term.columns(m, shape) for m in motions])
            yield way, _typical(term, shape, size / max(float(np.sqrt(np.mean(moves**2))), 1e-12))


def _way(dependence: Depends, acts: tuple[str, str], term: Term) -> Dependence | None:
    """What a term that acts somewhere is over; None of a constant, which is found if the linear problem names it."""
    there = [d for d in dependence.dependences
             if d.acts == acts and not (d.pair or d.constant) and d.variable not in STANDS_FOR]  # fmt: skip
    same = [d for d in there if d.over == term.over and (not d.late or term.acts == f"target_{d.late}")]
    return max(same or (there if term.over else ()), key=lambda d: d.share, default=None)


def _typical(term: Term, shape: float, size: float) -> Chosen:
    """A term of a typical size and shape, with room to either side."""
    values = {}
    for number in term.numbers:
        shapes = not number.switches or (term.shape and len(term.numbers) == 1)
        begins = number.begins if np.isfinite(number.begins) else shape
        values[number.name] = begins if shapes else min(size, number.most)
    numbers = tuple(_roomy(n) for n in term.numbers)
    return Chosen(replace(term, numbers=numbers), values)


def _roomy(number: Number) -> Number:
    return replace(number, times=max(number.times, FARTHEST))
