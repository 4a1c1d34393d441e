# SPDX-License-Identifier: Apache-2.0
"""Formulas for a missing force: sets of a few terms of a dictionary, grown one term after the other by what they
predict on stretches of time that were left out.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_tunnel_analysis.diagnose.added_force import Motion, beside_another
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law.depends import FREQUENCIES, LATE, OF_COMMAND, OF_OTHER, SWING, refined
from eps_tunnel_analysis.law.design import COMMAND, Design, Predictor
from eps_tunnel_analysis.law.variables import (
    A_WAVE,
    DAMPED,
    LATENESS,
    apart,
    bent,
    commanded,
    followed,
    has_command,
    in_waves,
    moving,
    periods,
    sensors,
    swing,
    target,
)
from labyrinth_sim.filters import Play
from labyrinth_sim.trials import Array

MOST_TERMS = 4
BEAM = 2  # sets of equally many terms that are extended further
BEHIND = 0.1  # of what is left of the misfit, by which a runner-up may leave more
SIMPLER = 0.01  # of what is left of the misfit, that one more number in a term must explain
SHAPES = 9  # values tried of a speed or time that shapes a term
MOST_SHARE = 0.45  # of the load, as friction: just below 0.5, where a gear locks itself
TICKS = 27  # sizes tried, of the command's ticks
OF_A_COMMAND = {
    "target": OF_COMMAND, "stepped_target": OF_COMMAND, "target_other": OF_OTHER,
    **dict.fromkeys((f"target_{name}" for name in LATENESS), LATE),
}  # fmt: skip
"""What a term of the command acts as -> what it is over."""
OF_A_SENSOR = {"sensor": "curve_sensor", "late": "curve_sensor_speed", "play": "curve_sensor_speed",
               "far_end": SWING, "sensor_other": "curve_sensor_other"}  # fmt: skip
"""What a term of a sensor acts as -> the free curve over its variable."""
ADDS = ("torque", "friction", "damping", "sensor", "sensor_other", "target", "target_other")
"""What terms act as of which several add up; others are filters."""
LEAST_LEFT = 1e-6  # of the misfit
TRAVEL = "travel"
"""What bristles follow that bend before they slide."""
SURE = 0.0  # lower end of the interval of what one more term explains


@dataclass(frozen=True)
class Number:
    """One number of a term.

    Attributes:
        switches: whether the term vanishes where it is 0.
        times: how far its bounds lie from the fitted value; 0 bounds a phase.
        signed: whether it keeps the sign that it was fitted with.
        least, most: the smallest and the largest for such an effect.
        begins: where roll-outs begin, if the linear problem does not say.
    """

    name: str
    unit: str
    switches: bool
    times: float
    signed: bool = False
    most: float = math.inf
    least: float = -math.inf
    begins: float = math.nan


@dataclass(frozen=True)
class Term:
    """One entry of the dictionary.

    Attributes:
        name: prefix of its parameters.
        acts: "torque", "friction", "damping", "link", "bristles", or a key of OF_A_SENSOR or OF_A_COMMAND.
        formula: with numbers in braces, as code over `angle`, `speed`, `carried`, `since`, `time`, `other` (in a
            command, the other axis's), `target`, the law's state `s`, and `{followed}`, which follows what `follows`
            names.
        equation: the same for people.
        numbers: those of the formula, amplitudes first.
        shape: values of the number that is not linear; empty where all are. A term's only number may be one.
        columns: (K, 1 or 2) of a motion and the shape's value; of 2, sine and cosine.
        needs: "memory" for since and time, "other_axis".
        beside: further columns, for which no number stands.
        follows: "speed" or "angle", that a first-order memory follows, with the time constant `after`; SWING for the
            acceleration of a mass on a spring, with `frequency` and `damping`; TRAVEL for how far bristles are bent; ""
            for none.
    """

    name: str
    acts: str
    formula: str
    equation: str
    numbers: tuple[Number, ...]
    shape: tuple[float, ...]
    columns: Callable[[Motion, float], Array]
    needs: str = ""
    follows: str = ""
    beside: int = 0

    @property
    def once(self) -> bool:
        """Whether a law has it once at most."""
        return self.acts not in ADDS

    @property
    def waves(self) -> bool:
        """Whether it is a wave: of a size, a period and a phase."""
        return [n.name for n in self.numbers] == ["size", "period", "phase"]

    @property
    def over(self) -> str:
        """The free curve over its variable; SWING, LATE, OF_COMMAND or OF_OTHER; "" of a constant."""
        if self.follows == SWING:
            return SWING
        if self.acts in OF_A_SENSOR | OF_A_COMMAND:
            return (OF_A_SENSOR | OF_A_COMMAND)[self.acts]
        words = {*re.findall(r"\w+", self.formula), self.follows}
        friction = "_friction" if self.acts == "friction" else ""
        over = {"other": f"curve_other{friction}", "angle": f"curve_angle{friction}", "carried": "curve_load_friction",
                "since": "curve_reversal", TRAVEL: "curve_reversal", "time": "curve_time_friction",
                "speed": "curve_speed"}  # fmt: skip
        by_itself = "" if self.acts == "torque" else "curve_speed"  # friction and damping act against the motion
        return next((curve for word, curve in over.items() if word in words), by_itself)


@dataclass(frozen=True)
class Chosen:
    """A term with its numbers, by name, from the linear problem."""

    term: Term
    values: dict[str, float]


@dataclass(frozen=True)
class Formula:
    """Terms, and the share of the misfit that they explain together on left-out stretches, with its 90 % interval."""

    terms: tuple[Chosen, ...]
    share: float
    interval: tuple[float, float]


ON_SPRING = Number("frequency", "rad/s", False, 1.5), Number("damping", "1", False, 10.0, begins=DAMPED)
"""Numbers of a mass on a damped spring, after its size."""
SWINGING = tuple(float(w) for w in FREQUENCIES)


def _column(values: Array) -> Array:
    return np.asarray(values[:, None])


def _at_places(motion: Motion, period: float) -> Array:
    """(K, 3) friction in half waves, 1 / pi + sin / 2 to first order: their mean is nobody's number."""
    against = moving(motion)
    return np.column_stack([in_waves(motion.angle, period, 0.5 * against), against])


def _visited(motions: Sequence[Motion]) -> tuple[float, float, str]:
    """The least and the largest angle of motions, between which a power was found: beyond them it would grow without
    reason, so it keeps its value there; and the same in words.
    """
    low, high = (float(end(float(end(m.angle)) for m in motions)) for end in (min, max))
    digits = 2 - math.floor(math.log10(max(high - low, 1e-9)))
    low, high = round(low, digits), round(high, digits)
    return low, high, f"constant beyond {low:g} to {high:g}"


def dictionary(design: Design) -> list[Term]:
    """Every term that may act as a force on this axis."""
    motions = [p.motion for p in design.plays]
    fast = max(float(np.abs(m.speed).max()) for m in motions)
    long = max(float(m.time[-1]) for m in motions)
    waves = tuple(float(p) for p in periods(design))
    speeds = tuple(float(v) for v in np.geomspace(0.003, 0.5, SHAPES) * fast)
    times = tuple(float(t) for t in np.geomspace(0.02, 1.0, SHAPES))
    low, high, held = _visited(motions)
    bends = tuple(float(b) for b in np.geomspace(0.002, 0.5, SHAPES) * (high - low))
    torque, per_rad = "N m", "N m/rad"
    size, lag = Number("size", torque, True, 3.0), Number("after", "s", False, 10.0)
    wave = (size, Number("period", "rad", False, 1.3), Number("phase", "rad", False, 0.0))
    inertia = Number("inertia", "kg m^2", True, 3.0, True, least=0.0)
    terms = [
        Term("constant", "torque", "{size}", "T", (size,), (), lambda m, _: _column(np.ones_like(m.time))),
        Term("wave", "torque", "{size} * np.sin(2 * np.pi * angle / {period} + {phase})",
             "A sin(2 pi angle / L + phase)", wave, waves, lambda m, p: in_waves(m.angle, p)),
        Term("spring", "torque", "-{stiffness} * angle", "-k angle", (Number("stiffness", per_rad, True, 3.0),), (),
             lambda m, _: _column(-m.angle)),
        Term("bend", "torque", f"{{size}} * min(max(angle, {low}), {high})**2", f"c angle^2, {held}",
             (Number("size", "N m/rad^2", True, 3.0),), (), lambda m, _: _column(m.angle**2)),
        Term("cubic", "torque", f"-{{size}} * min(max(angle, {low}), {high})**3", f"-c angle^3, {held}",
             (Number("size", "N m/rad^3", True, 3.0),), (), lambda m, _: _column(-(m.angle**3))),
        Term("friction", "friction", "{size}", "F sign(speed)", (size,), (), lambda m, _: _column(moving(m))),
        Term("stribeck", "friction", "{size} * np.exp(-((speed / {slow}) ** 2))",
             "F exp(-(speed / v)^2) sign(speed)", (size, Number("slow", "rad/s", False, 10.0)), speeds,
             lambda m, v: _column(moving(m) * np.exp(-((m.speed / v) ** 2)))),
        Term("viscous", "damping", "{damping}", "B speed", (Number("damping", "N m s/rad", True, 3.0, True),), (),
             lambda m, _: _column(-m.speed)),
        Term("drag", "damping", "{size} * np.abs(speed)", "C speed |speed|",
             (Number("size", "N m s^2/rad^2", True, 3.0, True),), (), lambda m, _: _column(-m.speed * np.abs(m.speed))),
        Term("uneven", "torque", "-{damping} * np.abs(speed)", "D |speed|",
             (Number("damping", "N m s/rad", True, 3.0),), (), lambda m, _: _column(-np.abs(m.speed))),
        # No less than what the joint has itself: what follows the speed late would drive the joint.
        Term("trailing", "torque", "-max({damping}, -s.damping[s.dof]) * {followed}", "B speed, followed with T",
             (Number("damping", "N m s/rad", True, 3.0, True), lag), times,
             lambda m, t: _column(-followed(m, m.speed, t)), "", "speed"),
        Term("creeping", "torque", "-{stiffness} * {followed}", "k angle, followed with T",
             (Number("stiffness", per_rad, True, 3.0, True), lag), times,
             lambda m, t: _column(-followed(m, m.angle, t)), "", "angle"),
        Term("swinging", "torque", "-{inertia} * {followed}", "-J z'', z'' = w^2 (angle - z) + 2 d w (speed - z')",
             (inertia, *ON_SPRING), SWINGING, lambda m, w: _column(-swing(m, w)), "", SWING),
        Term("link", "link", "{inertia}", "J (angle'' - z''), z'' = w^2 (angle - z) + 2 d w (speed - z')",
             (replace(inertia, most=design.missing.inertia), *ON_SPRING), SWINGING,
             lambda m, w: _column(np.gradient(m.speed, m.time) - swing(m, w)), "", SWING),
        Term("bristles", "bristles", "{size}, {bend}", "-F z, z' = (speed - |speed| z) / b",
             (replace(size, signed=True, least=0.0), Number("bend", "rad", False, 10.0)), bends,
             lambda m, b: _column(-bent(m, b)), "", TRAVEL),
        Term("load", "friction", "{share} * carried", "mu |load| sign(speed)",
             (Number("share", "1", True, 3.0, True, MOST_SHARE),), (), lambda m, _: _column(moving(m) * m.load)),
        Term("tight", "friction", "{size} * np.sin(2 * np.pi * angle / {period} + {phase})",
             "F sin(2 pi angle / L + phase) sign(speed)", wave, waves, lambda m, p: in_waves(m.angle, p, moving(m))),
        Term("places", "friction", "{size} * max(np.sin(2 * np.pi * angle / {period} + {phase}), 0.0)",
             "F max(sin(2 pi angle / L + phase), 0) sign(speed)", wave, waves, _at_places, beside=1),
        Term("fading", "friction", "{size} * np.exp(-since / {after})",
             "F exp(-(time since reversal) / T) sign(speed)", (size, lag), times,
             lambda m, t: _column(-m.direction * np.exp(-m.since / t)), "memory"),
        Term("warming", "friction", "{size} * np.exp(-time / {after})", "F exp(-time / T) sign(speed)",
             (size, lag), tuple(float(t) for t in np.array([0.2, 0.5, 1.0, 2.0]) * long),
             lambda m, t: _column(moving(m) * np.exp(-m.time / t)), "memory"),
    ]  # fmt: skip
    if beside_another(motions):
        terms += [
            Term("coupling", "torque", "{stiffness} * other", "k other", (Number("stiffness", per_rad, True, 3.0),),
                 (), lambda m, _: _column(m.other), "other_axis"),
            Term("rubbing", "friction", "{slope} * np.abs(other)", "F |other| sign(speed)",
                 (Number("slope", per_rad, True, 3.0),), (), lambda m, _: _column(moving(m) * np.abs(m.other)),
                 "other_axis"),
        ]  # fmt: skip
    return terms


def sensor_dictionary(design: Design) -> list[Term]:
    """Every term that may be a sensor's error over what it measures, or its delay."""
    motions = [p.motion for p in design.plays]
    waves = tuple(float(p) for p in periods(design))
    low, high, held = _visited(motions)
    size = Number("size", "rad", True, 3.0)
    wave = (size, Number("period", "rad", False, 1.3), Number("phase", "rad", False, 0.0))
    share = Number("share", "1", True, 3.0)
    terms = [
        Term("offset", "sensor", "{size} + 0.0 * angle", "b", (size,), (), lambda m, _: _column(np.ones_like(m.angle))),
        Term("scale", "sensor", "{share} * angle", "g angle", (share,), (),
             lambda m, _: _column(m.angle)),
        Term("bend", "sensor", f"{{size}} * np.clip(angle, {low}, {high})**2", f"c angle^2, {held}",
             (Number("size", "1/rad", True, 3.0),), (), lambda m, _: _column(m.angle**2)),
        Term("wave", "sensor", "{size} * np.sin(2 * np.pi * angle / {period} + {phase})",
             "A sin(2 pi angle / L + phase)", wave, waves, lambda m, p: in_waves(m.angle, p)),
        Term("late", "late", "{delay}", "-T speed", (Number("delay", "s", True, 3.0, True, least=0.0),), (),
             lambda m, _: _column(-m.speed)),
        Term("play", "play", "{width}", "behind a play of w", (Number("width", "rad", True, 5.0, True, least=0.0),),
             tuple(float(w) for w in np.geomspace(0.003, 0.5, SHAPES) * (high - low)), _behind_a_play),
        Term("far_end", "far_end", "{share}, {frequency}, {damping}", "g (z - angle), z'' = w^2 (angle - z) + ...",
             (Number("share", "1", True, 3.0, True, 2.0, least=0.0), *ON_SPRING), SWINGING,
             lambda m, w: _column(-swing(m, w) / w**2)),
    ]  # fmt: skip
    if beside_another(motions):
        terms.append(Term("coupled", "sensor_other", "{share} * other", "c other", (share,), (),
                          lambda m, _: _column(m.other), "other_axis"))  # fmt: skip
    return terms


def _behind_a_play(motion: Motion, width: float) -> Array:
    return _column(Play(np.full(1, width))(motion.angle[None], motion.angle)[0] - motion.angle)


def command_dictionary(design: Design) -> list[Term]:
    """Every term that may be an error of an axis's command."""
    motions = [p.motion for p in design.at(COMMAND).plays]
    span = max(float(np.ptp(target(m))) for m in motions)
    waves = tuple(float(p) for p in periods(design, COMMAND))
    size, share = Number("size", "rad", True, 3.0), Number("share", "1", True, 3.0)
    wave = (size, Number("period", "rad", False, 1.3), Number("phase", "rad", False, 0.0))
    least = A_WAVE * apart(design)
    ticks = tuple(float(t) for t in span / np.geomspace(60.0, 2.0, TICKS) if t >= least)

    def only(name: str, unit: str) -> tuple[Number]:
        return (Number(name, unit, True, 5.0, True, least=0.0),)

    numbers = {"late": ("delay", "s", "command, T late"), "lag": ("after", "s", "command, followed with T"),
               "limit": ("slowness", "s/rad", "command, no faster than 1 / s"),
               "profile": ("slowness", "s^2/rad", "command, accelerated by 1 / s")}  # fmt: skip
    terms = [
        Term("offset", "target", "{size} + 0.0 * target", "b", (size,), (), lambda m, _: _column(np.ones_like(m.time))),
        Term("scale", "target", "{share} * target", "g command", (share,), (),
             lambda m, _: _column(target(m))),
        *(Term(name, f"target_{name}", f"{{{number}}}", equation, only(number, unit),
               tuple(float(s) for s in LATENESS[name].tried(design)), LATENESS[name].error)
          for name, (number, unit, equation) in numbers.items()),
    ]  # fmt: skip
    if waves:
        equation = "A sin(2 pi command / L + phase)"
        formula = "{size} * np.sin(2 * np.pi * target / {period} + {phase})"
        terms.append(Term("wave", "target", formula, equation, wave, waves, lambda m, p: in_waves(target(m), p)))
    if beside_another(motions):
        terms.append(Term("coupled", "target_other", "{share} * other", "c other command", (share,), (),
                          lambda m, _: _column(m.other_command), "other_axis"))  # fmt: skip
    if ticks:
        tick = only("tick", "rad")
        terms.append(Term("ticks", "stepped_target", "{tick}", "command in ticks of b", tick, ticks, _in_ticks))
    return terms


def _in_ticks(motion: Motion, tick: float) -> Array:
    return _column(tick * np.round(target(motion) / tick) - target(motion))


Dictionary = tuple[tuple[str, str], int | None, list[Term]]
"""A place where something may act, as `Dependence.acts` and as a number for `Design.columns`, and its terms."""


def dictionaries(design: Design, positions: Sequence[str]) -> list[Dictionary]:
    """The dictionary of each place.

    Args:
        positions: names of the axis's measured positions.
    """
    axis, signals = design.missing.axis, design.missing.signals
    every: list[Dictionary] = [((axis, "force"), None, dictionary(design))]
    every += [((signals[n], "sensor"), n, sensor_dictionary(design)) for n in sensors(design, positions)]
    if has_command(design):
        every.append(((axis, "command"), COMMAND, command_dictionary(design)))
    return every


def formulas(design: Design, terms: Sequence[Term], signal: int | None = None, seed: int = 0) -> list[Formula]:
    """The best sets of one, two and more terms, as long as one more matters; roll-outs choose among them.

    For each number of terms a runner-up is kept, too, and both are extended.

    Args:
        terms: to choose from.
        signal: number of the sensor whose error it is, COMMAND, or None for a force.
    """
    design = design.at(signal)
    material = SETTINGS.material / max(float(np.mean(design.y**2)), 1e-9)
    whole = Predictor(design)
    known: dict[tuple[str, float], Array] = {}
    beam = [_Set((), np.empty((len(design.y), 0)), 0.0)]
    best_sets: list[Formula] = []
    for _ in range(MOST_TERMS):
        grown: dict[tuple[str, ...], _Set] = {}
        for begun in beam:
            predictor = Predictor(design, begun.columns)
            least = max(material, SETTINGS.share * (1.0 - begun.share))
            scored: list[tuple[float, Term, float]] = []
            for term in terms:
                if any(term is other and (term.once or not term.shape) for other, _ in begun.chosen):
                    continue
                shape, share = best_shape(design, predictor, term, signal, known)
                scored.append((share - SIMPLER * len(term.numbers), term, shape))
            for _, term, shape in sorted(scored, key=lambda one: -one[0])[:BEAM]:
                more = np.hstack([begun.columns, _columns(design, term, shape, signal)])
                together = whole.explained(more)
                if not _possible((*begun.chosen, (term, shape)), together.weights):
                    continue
                gained = predictor.explained(more[:, begun.columns.shape[1] :])
                if together.share - begun.share < least or gained.interval(seed)[0] <= SURE:
                    continue
                one = _Set((*begun.chosen, (term, shape)), more, together.share)
                if one.key not in grown or grown[one.key].score < one.score:
                    grown[one.key] = one
        beam = sorted(grown.values(), key=lambda one: -one.score)[:BEAM]
        beam = [one for one in beam if one.score > beam[0].score - BEHIND]
        for one in beam:
            last = whole.explained(one.columns)
            values = tuple(_values(one.chosen, last.weights))
            best_sets.append(Formula(values, last.share, last.interval(seed)))
    return best_sets


@dataclass(frozen=True)
class _Set:
    """Terms with what shapes them, their columns, and the share of the misfit that they explain where left out."""

    chosen: tuple[tuple[Term, float], ...]
    columns: Array
    share: float

    @property
    def key(self) -> tuple[str, ...]:
        """The terms' names, in any order."""
        return tuple(sorted(term.name for term, _ in self.chosen))

    @property
    def score(self) -> float:
        """By how much it lowers the misfit, in the logarithm, less what each number must explain."""
        return -math.log(max(1.0 - self.share, LEAST_LEFT)) - SIMPLER * sum(len(t.numbers) for t, _ in self.chosen)


def _columns(design: Design, term: Term, shape: float, signal: int | None) -> Array:
    if signal is None:
        rows = [np.column_stack([p.at_nodes(c) for c in term.columns(p.motion, shape).T]) for p in design.plays]
    elif signal == COMMAND:
        rows = [p.about_nodes(commanded(p.motion, term.columns(p.motion, shape))) for p in design.plays]
    else:
        every = zip(*(term.columns(p.motion, shape).T for p in design.plays), strict=True)
        rows = [np.column_stack(seen) for seen in zip(*(design.seen(signal, each) for each in every), strict=True)]
    return design.columns(rows, signal)


def best_shape(
    design: Design, predictor: Predictor, term: Term, signal: int | None, known: dict[tuple[str, float], Array]
) -> tuple[float, float]:
    """The value that shapes a term best, and the share that it explains then; `known` keeps columns tried before."""

    def share(shape: float) -> float:
        return predictor.explained(_columns(design, term, shape, signal)).share

    def share_again(shape: float) -> float:
        if (term.name, shape) not in known:
            known[term.name, shape] = _columns(design, term, shape, signal)
        return predictor.explained(known[term.name, shape]).share

    if not term.shape:
        return 0.0, share_again(0.0)
    tried = [share_again(shape) for shape in term.shape]
    best = refined(share, np.array(term.shape), int(np.argmax(tried)))
    return best, share(best)


def _possible(chosen: Sequence[tuple[Term, float]], weights: Array) -> bool:
    """Whether no number is smaller than it can be, as a delay below zero."""
    every = ((number, c.values[number.name]) for c in _values(chosen, weights) for number in c.term.numbers)
    return all(value >= number.least for number, value in every)


def _values(chosen: Sequence[tuple[Term, float]], weights: Array) -> list[Chosen]:
    terms, first = [], 0
    for term, shape in chosen:
        names = [n.name for n in term.numbers]
        if term.waves:
            sine, cosine = weights[first], weights[first + 1]
            values = {"size": float(np.hypot(sine, cosine)), "period": shape, "phase": float(np.arctan2(cosine, sine))}
            first += 2 + term.beside
        elif term.shape and len(names) == 1:  # of the size that the shape gives it, or turned about
            values = {names[0]: math.copysign(shape, weights[first])}
            first += 1
        else:
            values = {n.name: n.begins for n in term.numbers}
            values.update(zip(names, (float(weights[first]), shape), strict=False))
            first += 1
        terms.append(Chosen(term, values))
    return terms
