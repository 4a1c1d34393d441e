# SPDX-License-Identifier: Apache-2.0
"""Every term of the dictionaries by itself, in roll-outs that begin at many of its values; and one more on the best.

The linear problem is rough where base values make up for most of what is missing, or where an axis sticks: a term may
explain nothing there, and nearly all once the base values are refitted together with it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.diagnose.axis import hypothesis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, search_of
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library
from eps_tunnel_analysis.diagnose.rank import Hypothesis
from eps_tunnel_analysis.diagnose.refits import Job, Refit, TrialPoint
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law.depends import Dependence, Depends
from eps_tunnel_analysis.law.design import Design, Explained, Predictor
from eps_tunnel_analysis.law.effect_file import declared, effect_file
from eps_tunnel_analysis.law.formula import Chosen, Dictionary, Formula, Number, Term, best_shape
from eps_tunnel_analysis.law.refit import library_of
from eps_tunnel_analysis.law.variables import LEAST_WAVES
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model
from labyrinth_sim.trials import Array

FARTHEST = 10.0  # times its typical size or shape, of what a term may be
OF_LOAD = 0.1  # of the drive's load, root mean square: the typical size of a force, where less is missing
OF_MOTION = 0.03  # of the range of angles: the typical size of an error of a sensor or of the command
PROMISING = 8  # terms that are descended: those that promise most to first order
TERM_ROUNDS = 10  # of descent
KEPT = 3
PHASES = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)  # rad, of waves that are tried
MOST_PLACES = 10.0  # half waves of friction within the visited range; more are found by the linear problem
SPACED = 0.06  # between periods tried, relative
WAVES = 3  # periods from which a term that is a wave is descended
STANDS_FOR = ("command", "direction")  # variables that are tried as forces, but that no term of a force is over


def single_terms(
    design: Design, dependence: Depends, model: Model, plays: Sequence[Play], part: AxisPart,
    dictionaries: Sequence[Dictionary], nthread: int = 0, seed: int = 0,
) -> list[tuple[Dependence, Formula]]:  # fmt: skip
    """Formulas of one term that leave least in roll-outs, and explain more than chance does of what they are over; and
    of two where one leaves much and the linear problem names something. Otherwise two terms have too many numbers: what
    two poses miss by, most pairs explain.

    Waves of a force, and of friction, begin at many periods. Those of a sensor and of the command are left out, because
    the linear problem finds their period in any case.

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

    waves = {name: _begun(chosen) for name, (_, chosen) in owner.items() if chosen.term.waves}
    search = search_of(library, plays, part, SearchOptions((), nthread))
    base = search.refit([((), search.start)], 1)[0]
    alone = _descended(search, [base], library.candidates, waves)[:KEPT]
    best = [refit for refit in alone if acts(refit) == acts(alone[0])]
    more: list[Refit] = []
    if best and dependence.first and best[0].cost > SETTINGS.law_complete:
        here = [c for c in library.candidates if owner[c.name][0].acts == acts(best[0]) and c.name not in waves]
        enough = best[0].cost - max(SETTINGS.material, SETTINGS.share * best[0].cost)
        more = [refit for refit in _descended(search, best, here, {})[:KEPT] if refit.cost <= enough]
    laws = []
    without = hypothesis(search, base)
    for refit in [*alone, *more]:
        explained = explained_by(search, without, hypothesis(search, refit))
        ways = [owner[name][0] for name in refit.effects]
        if explained.share > ways[0].chance:
            share, interval = explained.share, explained.interval(seed)
            terms = tuple(_fitted(owner[name][1], name, refit, library) for name in refit.effects)
            laws.append((replace(ways[0], share=share, interval=interval, named=True), Formula(terms, share, interval)))
    return laws


def _descended(
    search: Search, begun: Sequence[Refit], candidates: Sequence[Candidate], waves: Mapping[str, Array]
) -> list[Refit]:
    """Refits with one more term than any of some has, best first, of those that promise most to first order.

    Args:
        waves: candidate that is a wave -> (s, k) values at which it begins. Such a one is descended from several.
    """
    promised: dict[frozenset[str], tuple[tuple[Candidate, ...], list[TrialPoint]]] = {}
    for refit in begun:
        for point in search.trial_points([refit], candidates, waves):
            added = (*search.library.of(refit.effects), point.candidate)
            promised.setdefault(frozenset(c.name for c in added), (added, []))[1].append(point)
    for _, points in promised.values():
        points.sort(key=lambda point: point.promised)
    jobs: list[Job] = []
    for added, points in sorted(promised.values(), key=lambda one: one[1][0].promised)[:PROMISING]:
        chosen = _periods_apart(search, points) if points[0].candidate.name in waves else points[:1]
        jobs += [(added, point.values) for point in chosen]
    return search.best_of(jobs, TERM_ROUNDS)


def _fitted(chosen: Chosen, name: str, refit: Refit, library: Library) -> Chosen:
    """A term with the numbers of a refit, in which it is the effect of this name."""
    values = dict(zip(library.names, refit.values, strict=True))
    prefix = f"{name}.{chosen.term.name}_"
    return replace(chosen, values={n.name: float(values[prefix + n.name]) for n in chosen.term.numbers})


def explained_by(search: Search, base: Hypothesis, terms: Hypothesis) -> Explained:
    """What terms explain in roll-outs, on the stretches of time that were left out."""
    without, left = (np.bincount(search.folds, h.left_out**2).astype(np.float64) for h in (base, terms))
    share, fall = 1.0 - left.sum() / without.sum(), (without.sum() - left.sum()) / len(search.used)
    return Explained(float(share), np.column_stack([without, left]), np.empty(0), float(fall))


def _terms(
    design: Design, dependence: Depends, dictionaries: Sequence[Dictionary]
) -> Iterator[tuple[Dependence, Chosen]]:
    """Every term but waves of sensors and the command, of a typical size and the shape that is best in the linear
    problem, with what it is over.
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
            if way is None or (term.waves and number is not None):
                continue
            shape = _middle(term.shape) if term.waves else best_shape(about, linear, term, number, {})[0]
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
        begins = number.begins if np.isfinite(number.begins) else shape if number.times else 0.0
        values[number.name] = begins if shapes else min(size, number.most)
    numbers = tuple(_roomy(n) for n in term.numbers)
    return Chosen(replace(term, numbers=numbers), values)


def _roomy(number: Number) -> Number:
    return replace(number, times=max(number.times, FARTHEST)) if number.times else number


def _middle(periods: Sequence[float]) -> float:
    """The geometric mean of the shortest and the longest."""
    return float(np.sqrt(min(periods) * max(periods)))


def _begun(chosen: Chosen) -> Array:
    """(s, 3) size, period and phase at which waves begin."""
    longest = max(chosen.term.shape)
    shortest = min(chosen.term.shape) if chosen.term.acts == "torque" else longest * LEAST_WAVES / MOST_PLACES
    periods = np.geomspace(shortest, longest, 1 + round(np.log(longest / shortest) / SPACED))
    return np.array([(chosen.values["size"], period, phase) for period in periods for phase in PHASES])


def _periods_apart(search: Search, points: Sequence[TrialPoint]) -> list[TrialPoint]:
    """The best points of a wave, best first, of periods that are no neighbours."""
    kept: list[TrialPoint] = []
    column = search.columns(points[0].candidate)[1]
    for point in points:
        if all(abs(np.log(point.values[column] / other.values[column])) > 2.0 * SPACED for other in kept):
            kept.append(point)
    return kept[:WAVES]
