# SPDX-License-Identifier: Apache-2.0
"""What a missing force depends on: the share of the misfit that a smooth function of each variable predicts where it
was left out, compared with the same variable moved in time, which keeps its own rhythm but loses the rig's.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law.design import COMMAND, DRAWS, Design, Explained, Predictor, Rows
from eps_tunnel_analysis.law.variables import (
    ERROR_OF_COMMAND,
    LATENESS,
    OF_SENSORS,
    OVER_OTHER,
    Variable,
    constants,
    has_command,
    pairs,
    periods,
    sensors,
    sines,
    swing,
    turned,
    variables,
)
from labyrinth_sim.trials import Array

SURROGATES = 39
LEAST_SHIFT = 0.7  # s by which a variable is moved at least
MOST_A_TURN = 60  # waves
FREQUENCIES = np.geomspace(2.0, 120.0, 41)  # rad/s, of a mass that may swing; a third for the level of chance
MOSTLY = 0.8  # of the draws, in which a way that is moved in time explains no more than it mostly does
NEAR_WHOLE = 0.03  # of the waves a turn, by which they may miss a whole number; of ten where there are more
NO_MORE = 0.05  # of the misfit: a smaller gain in the share explained is not significant
SWING = "swing"
"""What a mass that swings on the joint is over; there is no free curve of it."""
OF_COMMAND = "command"
"""What an error of the command over the command is over."""
OF_OTHER = "other_command"
"""What an error of the command over the other axis's command is over."""
LATE = "late"
"""What a command that takes effect late is over."""
FRICTION = (
    "curve_load_friction", "curve_angle_friction", "curve_other_friction", "curve_reversal", "curve_time_friction",
)  # fmt: skip
"""Free curves that are dry friction if they are constant, which a curve over the speed can be, too."""
PLAIN = (
    "curve_speed", "curve_angle", "curve_load_friction", "curve_sensor", "curve_sensor_speed", "curve_other",
    "curve_sensor_other",
    "curve_angle_friction", "curve_other_friction", "curve_reversal", "curve_time", "curve_time_friction",
)  # fmt: skip
"""Free curves, the plainest first: of those that explain as much as the best, the first one is named. Friction over
angle, load or time includes dry friction, and a constant is a curve over any variable."""


@dataclass(frozen=True)
class Judge:
    """What forces, and errors of sensors and the command, explain beyond base values, and a constant if there is."""

    design: Design
    constant: Variable | None = None

    @cached_property
    def forces(self) -> Predictor:
        """Judges forces."""
        return self._about(self.design)

    @cached_property
    def errors(self) -> Predictor:
        """Judges the errors of sensors and of the command."""
        return self._about(self.design.at(COMMAND))

    def explained(
        self, rows: Rows, signal: int | None = None, moved: Sequence[float] | None = None, curve: bool = False
    ) -> Explained:
        """What forces, or errors of a sensor or of the command, over time explain; see `Design.columns`."""
        predictor = self.forces if signal is None else self.errors
        return predictor.explained(self.design.at(signal).columns(rows, signal, moved), curve)

    def _about(self, design: Design) -> Predictor:
        constant = self.constant
        return Predictor(design, design.columns(constant.rows, constant.signal) if constant else None)


@dataclass(frozen=True)
class Dependence:
    """What a missing force depends on.

    Attributes:
        variable: for people; `curve`, `place`: the corresponding free curve.
        share: of the misfit, on stretches left out of the fit; with `interval`, 90 %.
        chance: share of its own that chance explains; see `by_chance`.
        named: whether it explains more than chance does, and enough to be worth reporting.
        period: rad of the waves over the angle that explain it better than a smooth function, else None.
        traced: what turns with that period, as the rig file states ratios; "" if nothing does.
        pair: whether it is over two variables at once; `curve` is then of the one that explains more by itself.
        constant: whether it is over none; `curve` is then over the angle.
        frequency: rad/s, of a mass that swings on the joint, else None; `curve` is then over the speed.
        of_command: whether it is an error of the command.
        late: of a command that takes effect late in which way, a key of LATENESS; `curve` is then over the speed.
    """

    variable: str
    curve: str
    place: str
    share: float
    interval: tuple[float, float]
    chance: float
    named: bool
    period: float | None = None
    traced: str = ""
    pair: bool = False
    constant: bool = False
    frequency: float | None = None
    of_command: bool = False
    late: str = ""

    @property
    def over(self) -> str:
        """What a term that fits it is over: the free curve's variable, SWING, LATE, OF_COMMAND or OF_OTHER."""
        if self.of_command:
            return LATE if self.late else OF_OTHER if self.curve in OVER_OTHER else OF_COMMAND
        return SWING if self.frequency else self.curve

    @property
    def of_sensor(self) -> bool:
        """Whether it is the error of a sensor; otherwise a force, or an error of the command."""
        return self.curve in OF_SENSORS

    @property
    def acts(self) -> tuple[str, str]:
        """Where it acts: an axis and a sensor may have the same name."""
        return self.place, "sensor" if self.of_sensor else "command" if self.of_command else "force"


@dataclass(frozen=True)
class Depends:
    """All variables of an axis.

    Attributes:
        dependences: what explains most first.
        first: what is named; None if nothing explains more than chance.
        ties: what explains as much as that in these recordings, at the 5 % level.
    """

    dependences: tuple[Dependence, ...]
    first: Dependence | None = None
    ties: tuple[Dependence, ...] = ()

    @property
    def chance(self) -> float:
        """Share that chance explains of what is named, or of what explains most."""
        most = self.first or next(iter(self.dependences), None)
        return most.chance if most else 0.0

    @property
    def words(self) -> str:
        """The variable, or those that these recordings cannot separate."""
        if self.first is None:
            return ""
        return " or ".join(dict.fromkeys(d.variable for d in (self.first, *self.ties)))


def depends(
    design: Design, positions: Sequence[str], seed: int = 0, ratios: Mapping[str, float] | None = None
) -> Depends:
    """What a missing force depends on.

    A constant comes first: moved in time it stays the same, and a curve over any variable includes it. If it explains
    more than one whose sign turns once, variables are judged by what they explain beyond it.

    Args:
        positions: names of the axis's measured positions.
        ratios: what turns -> radians of it for each radian of the joint, to trace periods by.
    """
    rng = np.random.default_rng(seed)
    judge = Judge(design)
    steady = constant(judge, positions, rng, seed)
    if steady is None:
        return varying(judge, positions, rng, seed, ratios or {})
    first, always = steady
    beyond = varying(Judge(design, always), positions, rng, seed, ratios or {})
    best = beyond.first
    if best and (best.acts == first.acts or best.share * (1.0 - first.share) > first.share):
        return beyond
    return Depends((first, *beyond.dependences), first)


def constant(
    judge: Judge, positions: Sequence[str], rng: np.random.Generator, seed: int
) -> tuple[Dependence, Variable] | None:
    """The constant that explains most; None if that is no more than chance."""
    every = constants(judge.design, positions)
    chances = [
        max(judge.explained(turned(judge.design, c, rng), c.signal).share for c in every) for _ in range(SURROGATES)
    ]
    chance = float(np.quantile(chances, 1.0 - SETTINGS.law_level))
    e, best = max(((judge.explained(c.rows, c.signal), c) for c in every), key=lambda one: one[0].share)
    if not _matters(e, chance) or e.interval(seed)[0] <= 0.0:
        return None
    known = e.share, e.interval(seed), chance, True
    return Dependence(best.name, best.curve, best.place, *known, constant=True), best


def varying(
    judge: Judge, positions: Sequence[str], rng: np.random.Generator, seed: int, ratios: Mapping[str, float]
) -> Depends:
    """What a missing force depends on besides what is always there."""
    design = judge.design
    every = variables(design, positions)
    swinging = [swung(design, float(w)) for w in FREQUENCIES[::3]]
    waving = [sines(design, float(p)) for p in periods(design)[::3]]
    ways = LATENESS.values() if has_command(design) else ()
    late = [way.errors(design, float(shape)) for way in ways for shape in way.tried(design)[::3]]
    moved = [_moved(judge, every, (waving, swinging), late, list(_shifts(design, rng))) for _ in range(SURROGATES)]
    *chances, of_pairs, of_waves, of_swings, of_lateness = by_chance(np.array(moved))
    explained: list[tuple[Dependence, Explained]] = []
    singly = [judge.explained(v.rows, v.signal, curve=True) for v in every]
    both = pairs(every, [e.share for e in singly])
    alone = len(every)
    explains = [*singly, *(judge.explained(v.rows) for v in both)]
    chances += [of_pairs] * len(both)
    for i, (variable, e, chance) in enumerate(zip([*every, *both], explains, chances, strict=True)):
        known = e.share, e.interval(seed), chance, _matters(e, chance)
        of_command = variable.signal == COMMAND
        named = Dependence(
            variable.name, variable.curve, variable.place, *known, pair=i >= alone, of_command=of_command
        )
        explained.append((named, e))
    # Waves of a sensor or the command have not been moved: chance may do as much as with any curve of it, or waves of a
    # force.
    waving_by_chance: dict[int | None, float] = {None: of_waves}
    waving_by_chance |= {
        v.signal: max(of_waves, c)
        for v, c in zip(every, chances, strict=False)
        if v.curve == OF_SENSORS[0] or v.name == ERROR_OF_COMMAND
    }
    explained += waves(judge, positions, waving_by_chance, seed, ratios)
    explained.append(swings(judge, of_swings, seed))
    if has_command(design):
        explained += [lateness(judge, name, of_lateness, seed) for name in LATENESS]
    explained.sort(key=lambda pair: -pair[0].share)
    ordered = tuple(d for d, _ in explained)
    beyond_chance = [(d, e) for d, e in explained if d.named]
    if not beyond_chance:
        return Depends(ordered)
    best = beyond_chance[0][1]
    near = [d for d, e in beyond_chance if e.share > best.share - NO_MORE or not better(best, e, seed)]
    # Waves, swings and late commands have a value more to be fitted, so a smooth curve that explains as much is
    # likelier. A command asks for about what the axis does, so a force comes before an error of the command.
    smooth = [d for d in near if not (d.period or d.frequency or d.of_command)]
    first = min(smooth or near, key=_plain)
    first = next((d for d in near if d.period and (d.variable, d.acts) == (first.variable, first.acts)), first)
    over_speed = first.over == "curve_speed"
    same = {first.variable, *(("direction", "speed") if over_speed else ())}
    friction = FRICTION if over_speed else ()
    ties = [d for d in near if d.acts != first.acts or (d.variable not in same and d.curve not in friction)]
    return Depends(ordered, first, tuple(d for d in ties if not d.pair or first.pair))


def _plain(d: Dependence) -> tuple[bool, bool, int, bool]:
    """Lower for simpler variables: one variable before two, forces and sensors before the command, the direction before
    the speed, angle before command.
    """
    return d.pair, d.of_command, PLAIN.index(d.curve), d.variable in ("speed", "command")


def _moved(
    judge: Judge, every: Sequence[Variable], shaped: Sequence[Sequence[Rows]], late: Sequence[Rows],
    moved: Sequence[float],
) -> list[float]:  # fmt: skip
    """Share that each variable explains once moved in time, and the most of any pair, waves, swing, and lateness."""
    forces = [v for v in every if v.signal is None]
    acting = [*(v.rows for v in forces), *(rows for group in shaped for rows in group)]
    columns = judge.design.columns([np.hstack(rows) for rows in zip(*acting, strict=True)], None, moved)
    blocks = np.split(columns, np.cumsum([rows[0].shape[1] for rows in acting])[:-1], axis=1)
    shares = [judge.forces.explained(block, curve=True).share for block in blocks[: len(forces)]]
    surfaces = [judge.explained(v.rows, None, moved).share for v in pairs(forces, shares)]
    others = [judge.forces.explained(block).share for block in blocks[len(forces) :]]
    shares += [judge.explained(v.rows, v.signal, moved, curve=True).share for v in every if v.signal is not None]
    waving = len(shaped[0])
    lateness = max((judge.explained(rows, COMMAND, moved).share for rows in late), default=0.0)
    return [*shares, max(surfaces, default=0.0), max(others[:waving]), max(others[waving:]), lateness]


def by_chance(shares: Array) -> list[float]:
    """(V,) share of each of V ways that none exceeds by chance in all but `law_level` of the draws.

    Some ways, such as a slow error of a sensor, explain much of any slow misfit. So the factor by which each lowers the
    misfit is counted from what it mostly does once it is moved in time, and the largest of all ways in a draw decides,
    as in Westfall, Young: Resampling-based multiple testing, 1993, section 2.5.

    Args:
        shares: (draws, V) that each explains once it is moved in time.
    """
    falls = -np.log1p(-np.clip(shares, 0.0, 1.0 - 1e-12))  # what predicts worse than nothing says no more than nothing
    mostly = np.quantile(falls, MOSTLY, axis=0)
    most = float(np.quantile((falls - mostly).max(axis=1), 1.0 - SETTINGS.law_level, method="higher"))
    return [float(c) for c in -np.expm1(-(mostly + most))]


def better(one: Explained, other: Explained, seed: int) -> bool:
    """Whether one explains more than another in all but `law_level` of the draws of stretches.

    Each is counted in shares of its own misfit: that of forces is about another motion than that of sensors' errors.
    """
    gains = other.left - one.left
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(len(gains), np.full(len(gains), 1.0 / len(gains)), DRAWS)
    return bool(np.quantile(counts @ gains, SETTINGS.law_level) > 0.0)


def _matters(e: Explained, chance: float) -> bool:
    """Whether something explains more of the misfit than chance does, and enough to be worth reporting."""
    return e.share > max(chance, 0.0) and e.fall >= SETTINGS.material


def _shifts(design: Design, rng: np.random.Generator) -> Iterator[float]:
    for play in design.plays:
        least = min(LEAST_SHIFT / max(float(play.nodes[-1]), 1e-9), 0.4)
        yield float(rng.uniform(least, 1.0 - least))


def waves(
    judge: Judge, positions: Sequence[str], chances: Mapping[int | None, float], seed: int, ratios: Mapping[str, float]
) -> list[tuple[Dependence, Explained]]:
    """Waves over the angle, of a force, of each sensor and of the command, by the period that explains most.

    Args:
        chances: number of a sensor, COMMAND, None for a force -> share that chance explains.
    """
    design, missing = judge.design, judge.design.missing
    ways: list[tuple[str, str, str, int | None]] = [("angle", "curve_angle", missing.axis, None)]
    ways += [("angle, as a sensor's error", "curve_sensor", missing.signals[i], i) for i in sensors(design, positions)]
    if has_command(design) and len(periods(design, COMMAND)):
        ways.append((ERROR_OF_COMMAND, "curve_angle", missing.axis, COMMAND))
    dependences = []
    for name, which, place, signal in ways:
        tried = periods(design, signal)

        def explained(period: float, signal: int | None = signal) -> Explained:
            return judge.explained(sines(design, period, signal), signal)

        def share(period: float, explained: Callable[[float], Explained] = explained) -> float:
            return explained(period).share

        best = refined(share, tried, int(np.argmax([share(float(p)) for p in tried])))
        e, chance = explained(best), chances[signal]
        known = e.share, e.interval(seed), chance, _matters(e, chance)
        of_command, turns = signal == COMMAND, traced(best, ratios)
        waved = Dependence(name, which, place, *known, period=best, traced=turns, of_command=of_command)
        dependences.append((waved, e))
    return dependences


def swung(design: Design, frequency: float) -> list[Array]:
    """For each play (n, 1) what a mass that swings on the joint does to it, per inertia, at its nodes."""
    return [-p.at_nodes(swing(p.motion, frequency))[:, None] for p in design.plays]


def swings(judge: Judge, chance: float, seed: int) -> tuple[Dependence, Explained]:
    """A mass that swings on the joint, at the frequency that explains most."""

    def explained(frequency: float) -> Explained:
        return judge.explained(swung(judge.design, frequency))

    def share(frequency: float) -> float:
        return explained(frequency).share

    best = refined(share, FREQUENCIES, int(np.argmax([share(float(w)) for w in FREQUENCIES])))
    e = explained(best)
    known = e.share, e.interval(seed), chance, _matters(e, chance)
    return Dependence("a swing of its own", "curve_speed", judge.design.missing.axis, *known, frequency=best), e


def lateness(judge: Judge, name: str, chance: float, seed: int) -> tuple[Dependence, Explained]:
    """A command that takes effect late in one way of LATENESS, by the shape that explains most."""
    way = LATENESS[name]

    def explained(shape: float) -> Explained:
        return judge.explained(way.errors(judge.design, shape), COMMAND)

    def share(shape: float) -> float:
        return explained(shape).share

    tried = way.tried(judge.design)
    e = explained(refined(share, tried, int(np.argmax([share(float(s)) for s in tried]))))
    known = e.share, e.interval(seed), chance, _matters(e, chance)
    axis = judge.design.missing.axis
    return Dependence(way.title, "curve_speed", axis, *known, of_command=True, late=name), e


def refined(share: Callable[[float], float], tried: Array, best: int) -> float:
    """The value about the best of those tried that explains most, by golden sections in the logarithm."""
    low, high = np.log(tried[max(best - 1, 0)]), np.log(tried[min(best + 1, len(tried) - 1)])
    part = 0.5 * (np.sqrt(5.0) - 1.0)
    a, b = high - part * (high - low), low + part * (high - low)
    fa, fb = share(float(np.exp(a))), share(float(np.exp(b)))
    for _ in range(14):
        if fa > fb:
            high, b, fb = b, a, fa
            a = high - part * (high - low)
            fa = share(float(np.exp(a)))
        else:
            low, a, fa = a, b, fb
            b = low + part * (high - low)
            fb = share(float(np.exp(b)))
    return float(np.exp(0.5 * (low + high)))


def traced(period: float, ratios: Mapping[str, float]) -> str:
    """What turns a whole number of times, up to 60 waves a turn, in this period of the joint, rad.

    Of several the one with the fewest waves a turn, because most parts that are not round have one or two.
    """
    candidates = []
    for name, ratio in ratios.items():
        waves_a_turn = 2.0 * np.pi / (period * abs(ratio))
        whole = round(waves_a_turn)
        if 1 <= whole <= MOST_A_TURN and abs(waves_a_turn - whole) < NEAR_WHOLE * min(whole, 10):
            candidates.append((whole, name))
    if not candidates:
        return ""
    whole, name = min(candidates)
    return f"{whole} wave{'s' if whole > 1 else ''} a turn of the {name}"
