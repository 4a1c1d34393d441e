# SPDX-License-Identifier: Apache-2.0
"""What a missing force depends on: the share of the misfit that a smooth function of each variable predicts where it
was left out, compared with the same variable moved in time, which keeps its own rhythm but loses the rig's.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.signal import bilinear, lfilter

from eps_tunnel_analysis.diagnose.added_force import Motion, visited
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.law.design import DRAWS, Design, Explained, Predictor, Rows
from labyrinth_sim.curve import KNOTS, NAMES, curve, share_about, speed_knots, speed_share
from labyrinth_sim.trials import Array

SURROGATES = 39
LEAST_SHIFT = 0.7  # s by which a variable is moved at least
TURNS = (0.2, 0.8)  # of a play, within which the sign of a constant turns by chance
PERIODS = 120  # tried, evenly in the logarithm; a third of them for the level of chance
MOST_WAVES = 40.0  # within the range visited
LEAST_WAVES = 0.8
TRIED_IN_PAIRS = 3  # variables whose pairs are tried: those that explain most by themselves
COARSE = 5  # knots of a pair's surface over each of its variables
MOST_A_TURN = 60  # waves
FREQUENCIES = np.geomspace(2.0, 120.0, 41)  # rad/s, of a mass that may swing; a third for the level of chance
DAMPED = 0.05  # damping ratio with which it is looked for
MOSTLY = 0.8  # of the draws, in which a way that is moved in time explains no more than it mostly does
NEAR_WHOLE = 0.03  # of the waves a turn, by which they may miss a whole number; of ten where there are more
NO_MORE = 0.05  # of the misfit: a smaller gain in the share explained is not significant
SWING = "swing"
"""What a mass that swings on the joint is over; there is no free curve of it."""
OVER_SPEED = ("curve_speed", "curve_sensor_speed")
"""Free curves whose variable is a speed."""
OF_SENSORS = ("curve_sensor", "curve_sensor_speed")
"""Free curves of a sensor's error."""
FRICTION = (
    "curve_load_friction", "curve_angle_friction", "curve_other_friction", "curve_reversal", "curve_time_friction",
)  # fmt: skip
"""Free curves that are dry friction if they are constant, which a curve over the speed can be, too."""
PLAIN = (
    "curve_speed", "curve_angle", "curve_load_friction", "curve_sensor", "curve_sensor_speed", "curve_other",
    "curve_angle_friction", "curve_other_friction", "curve_reversal", "curve_time", "curve_time_friction",
)  # fmt: skip
"""Free curves, the plainest first: of those that explain as much as the best, the first one is named. Friction over
angle, load or time includes dry friction, and a constant is a curve over any variable."""


# ---- variables


@dataclass(frozen=True)
class Variable:
    """Something that a force, a friction or a sensor's error may depend on.

    Attributes:
        name: for people, as "angle".
        curve: the corresponding free curve.
        place: an axis, or a sensor's signal.
        rows: for each play, what each of the curve's knots adds over time: ten, or one for a direction.
        signal: number of the sensor; None for a force.
        shares: for each play (n,) its share of the curve's range; `signs` (n,), with which it acts. For forces.
    """

    name: str
    curve: str
    place: str
    rows: Rows = field(repr=False)
    signal: int | None = None
    shares: Rows = field(default=(), repr=False)
    signs: Rows = field(default=(), repr=False)

    @property
    def quantity(self) -> str:
        """The variable, whether it acts as a friction or not."""
        return self.name.partition(",")[0]


@dataclass(frozen=True)
class Judge:
    """What forces and sensors' errors explain beyond base values, and beyond a constant if there is one."""

    design: Design
    constant: Variable | None = None

    @cached_property
    def forces(self) -> Predictor:
        """Judges forces."""
        return self._about(self.design)

    @cached_property
    def sensors(self) -> Predictor:
        """Judges the errors of sensors."""
        return self._about(self.design.at(0))

    def explained(
        self, rows: Rows, signal: int | None = None, moved: Sequence[float] | None = None, curve: bool = False
    ) -> Explained:
        """What forces, or errors of a sensor, over time explain; see `Design.columns` and `Predictor.explained`."""
        predictor = self.forces if signal is None else self.sensors
        return predictor.explained(self.design.at(signal).columns(rows, signal, moved), curve)

    def _about(self, design: Design) -> Predictor:
        constant = self.constant
        return Predictor(design, design.columns(constant.rows, constant.signal) if constant else None)


def hats(share: Array) -> Array:
    """(n, 10) weight of each knot of a free curve at a share (n,) of its range."""
    weights = np.empty((len(share), KNOTS))
    for i, name in enumerate(NAMES):
        table = {other: np.full(1, 1.0 if other == name else 0.0) for other in NAMES}
        weights[:, i] = curve(table, share[None])[0]
    return weights


def knots_of(which: str, span: Mapping[str, float]) -> Array:
    """(10,) where the knots of a free curve lie, in the variable's own unit."""
    share = np.linspace(0.0, 1.0, KNOTS)
    if "half" in span:
        return np.asarray(span["centre"] + span["half"] * (2.0 * share - 1.0))
    if which in OVER_SPEED:
        return speed_knots(span["most"])
    return np.asarray(share * span.get("end", span.get("most", 1.0)))


def moving(motion: Motion) -> Array:
    """(K,) against the motion: minus the direction where the joint moves, 0 where it stands."""
    return -np.tanh(motion.speed / max(0.01 * float(np.abs(motion.speed).max()), 1e-9))


def swing(motion: Motion, frequency: float) -> Array:
    """(K,) rad/s^2, acceleration of a mass on a damped spring whose other end moves with the joint, at first at rest.

    `z'' = w^2 (q - z) + 2 d w (q' - z')`, so the joint feels `-J z''`.
    """
    rate = 1.0 / float(motion.time[1] - motion.time[0])
    damper, spring = 2.0 * DAMPED * frequency, frequency**2
    return np.asarray(lfilter(*bilinear([damper, spring, 0.0], [1.0, damper, spring], fs=rate), motion.speed))


def of_speed(speed: Array, spans: Mapping[str, Mapping[str, float]]) -> Array:
    """Share (K,) of the range of a curve over a speed."""
    most = np.full(1, spans["curve_speed"]["most"])
    return speed_share(speed[None], {"most": most})[0]


def shares(motion: Motion, spans: Mapping[str, Mapping[str, float]]) -> dict[str, tuple[str, Array, Array]]:
    """Free curve -> the variable's name, its share (K,) of the curve's range, and the sign (K,) that it acts with."""
    against, ones = moving(motion), np.ones(len(motion.time))

    def of_angle(angle: Array, span: Mapping[str, float]) -> Array:
        return np.asarray(share_about(angle, span["centre"], span["half"]))

    by_speed = of_speed(motion.speed, spans)
    angle, end = of_angle(motion.angle, spans["curve_angle"]), spans["curve_time"]["end"]
    by_curve = {
        "curve_speed": ("speed", by_speed, ones),
        "curve_angle": ("angle", angle, ones),
        "curve_angle_friction": ("angle, as friction", angle, against),
        "curve_load_friction": ("load, as friction", motion.load / spans["curve_load_friction"]["most"], against),
        "curve_reversal": (
            "time since reversal", motion.since / spans["curve_reversal"]["end"], -motion.direction,
        ),
        "curve_time": ("time", motion.time / end, ones),
        "curve_time_friction": ("time, as friction", motion.time / end, against),
    }  # fmt: skip
    if "curve_other" in spans:
        other = of_angle(motion.other, spans["curve_other"])
        by_curve |= {
            "curve_other": ("the other axis's angle", other, ones),
            "curve_other_friction": ("the other axis's angle, as friction", other, against),
        }
    return by_curve


def variables(design: Design, positions: Sequence[str]) -> list[Variable]:
    """Every variable that something may depend on; those of forces, then of sensors."""
    missing = design.missing
    spans = visited([p.motion for p in design.plays])
    each = [shares(p.motion, spans) for p in design.plays]
    every = []
    for name in each[0]:
        over = [p.at_nodes(own[name][1]) for p, own in zip(design.plays, each, strict=True)]
        signs = [p.at_nodes(own[name][2]) for p, own in zip(design.plays, each, strict=True)]
        rows = [
            np.column_stack([p.at_nodes(column) for column in (hats(own[name][1]) * own[name][2][:, None]).T])
            for p, own in zip(design.plays, each, strict=True)
        ]
        every.append(Variable(each[0][name][0], name, missing.axis, rows, shares=over, signs=signs))
    every += _of_command(design, spans["curve_angle"])
    directions = [p.at_nodes(p.motion.direction) for p in design.plays]
    over, signs = [0.5 + 0.5 * own for own in directions], [np.ones_like(own) for own in directions]
    every.append(
        Variable("direction", "curve_speed", missing.axis, [own[:, None] for own in directions], None, over, signs)
    )
    span = spans["curve_angle"]
    for number in sensors(design, positions):
        seen = design.at(number)
        over_angle = [hats(share_about(a, span["centre"], span["half"])) for a in seen.angles(number)]
        over_speed = [hats(of_speed(v, spans)) for v in seen.speeds(number)]
        every += [
            Variable(f"{what}, as a sensor's error", curve, missing.signals[number], errors, number)
            for what, curve, errors in zip(("angle", "speed"), OF_SENSORS, (over_angle, over_speed), strict=True)
        ]
    return every


def _of_command(design: Design, angles: Mapping[str, float]) -> list[Variable]:
    """The drive's target, over the range of the angles; zero while the drive is off, and none if it always is."""
    rows, over, signs = [], [], []
    for p in design.plays:
        on = np.isfinite(p.motion.command)
        share = np.where(on, share_about(np.nan_to_num(p.motion.command), angles["centre"], angles["half"]), 0.5)
        rows.append(np.column_stack([p.at_nodes(column) for column in (hats(share) * on[:, None]).T]))
        over.append(p.at_nodes(share))
        signs.append(p.at_nodes(on.astype(float)))
    if not any(own.any() for own in signs):
        return []
    return [Variable("command", "curve_angle", design.missing.axis, rows, None, over, signs)]


def constants(design: Design, positions: Sequence[str]) -> list[Variable]:
    """A force that does not vary, and an error of each sensor that does not."""
    axis, signals = design.missing.axis, design.missing.signals
    ways: list[tuple[str, str, str, int | None]] = [("constant force", "curve_angle", axis, None)]
    ways += [(f"constant error of {signals[i]}", "curve_sensor", signals[i], i) for i in sensors(design, positions)]
    return [
        Variable(name, which, place, [np.ones((len(angle), 1)) for angle in design.angles(number)], number)
        for name, which, place, number in ways
    ]


def _turned(design: Design, constant: Variable, rng: np.random.Generator) -> list[Array]:
    """Rows of a constant whose sign turns once in every play, as that of a slow misfit does."""
    rows = []
    for play, own in zip(design.plays, constant.rows, strict=True):
        time = play.nodes if constant.signal is None else play.time[play.signal == constant.signal]
        turns = float(rng.uniform(*TURNS)) * float(play.nodes[-1])
        rows.append(own * np.where(time < turns, -1.0, 1.0)[:, None])
    return rows


def pairs(every: Sequence[Variable], shares: Sequence[float]) -> list[Variable]:
    """Surfaces over two variables, of those forces that explain most by themselves.

    None is over the time: at each time a motion has one angle and one speed, so such a surface follows whatever varies.

    Args:
        shares: that each of the variables explains.
    """
    best: list[Variable] = []
    for _, i in sorted((-share, i) for i, share in enumerate(shares)):
        if every[i].signal is None and every[i].quantity not in ["time", *(v.quantity for v in best)]:
            best.append(every[i])
    best = best[:TRIED_IN_PAIRS]
    return [_pair(a, b) for i, a in enumerate(best) for b in best[i + 1 :]]


def _pair(a: Variable, b: Variable) -> Variable:
    rows = []
    for over_a, over_b, sign_a, sign_b in zip(a.shares, b.shares, a.signs, b.signs, strict=True):
        # Of two frictions one acts: the product would lose its direction.
        sign = sign_a if a.name != a.quantity else sign_b
        product = tents(over_a)[:, :, None] * tents(over_b)[:, None, :] * sign[:, None, None]
        rows.append(product.reshape(len(sign), -1))
    return Variable(f"{a.name} and {b.name}", a.curve, a.place, rows)


def tents(share: Array) -> Array:
    """(n, 5) weight of each of a few knots, linear between them."""
    place = (COARSE - 1) * np.clip(share, 0.0, 1.0)
    return np.asarray(np.maximum(1.0 - np.abs(place[:, None] - np.arange(COARSE)), 0.0))


def sensors(design: Design, positions: Sequence[str]) -> list[int]:
    """Numbers of the sensors whose own error can be identified; a single one's is not separable from the motion."""
    seen = [i for i, signal in enumerate(design.missing.signals) if signal in positions]
    return seen if len(seen) > 1 else []


# ---- results


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

    @property
    def over(self) -> str:
        """What a term that fits it is over: the free curve's variable, or SWING."""
        return SWING if self.frequency else self.curve

    @property
    def of_sensor(self) -> bool:
        """Whether it is the error of a sensor; a force otherwise."""
        return self.curve in OF_SENSORS

    @property
    def acts(self) -> tuple[str, bool]:
        """Where it acts: an axis and a sensor may have the same name."""
        return self.place, self.of_sensor


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
        max(judge.explained(_turned(judge.design, c, rng), c.signal).share for c in every) for _ in range(SURROGATES)
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
    moved = [_moved(judge, every, (waving, swinging), list(_shifts(design, rng))) for _ in range(SURROGATES)]
    *chances, of_pairs, of_waves, of_swings = by_chance(np.array(moved))
    explained: list[tuple[Dependence, Explained]] = []
    singly = [judge.explained(v.rows, v.signal, curve=True) for v in every]
    both = pairs(every, [e.share for e in singly])
    alone = len(every)
    explains = [*singly, *(judge.explained(v.rows) for v in both)]
    chances += [of_pairs] * len(both)
    for i, (variable, e, chance) in enumerate(zip([*every, *both], explains, chances, strict=True)):
        known = e.share, e.interval(seed), chance, _matters(e, chance)
        explained.append((Dependence(variable.name, variable.curve, variable.place, *known, pair=i >= alone), e))
    # Waves of a sensor have not been moved: chance may do as much as with any curve of it, or waves of a force.
    waving_by_chance: dict[int | None, float] = {None: of_waves}
    waving_by_chance |= {
        v.signal: max(of_waves, c) for v, c in zip(every, chances, strict=False) if v.curve == OF_SENSORS[0]
    }
    explained += waves(judge, positions, waving_by_chance, seed, ratios)
    explained.append(swings(judge, of_swings, seed))
    explained.sort(key=lambda pair: -pair[0].share)
    ordered = tuple(d for d, _ in explained)
    beyond_chance = [(d, e) for d, e in explained if d.named]
    if not beyond_chance:
        return Depends(ordered)
    best = beyond_chance[0][1]
    near = [d for d, e in beyond_chance if e.share > best.share - NO_MORE or not better(best, e, seed)]
    # Waves and swings have a value more to be fitted, so a smooth curve that explains as much is likelier.
    smooth = [d for d in near if not (d.period or d.frequency)]
    first = min(smooth or near, key=_plain)
    first = next((d for d in near if d.period and (d.variable, d.place) == (first.variable, first.place)), first)
    over_speed = first.over == "curve_speed"
    same = {first.variable, *(("direction", "speed") if over_speed else ())}
    friction = FRICTION if over_speed else ()
    ties = [d for d in near if d.acts != first.acts or (d.variable not in same and d.curve not in friction)]
    return Depends(ordered, first, tuple(d for d in ties if not d.pair or first.pair))


def _plain(d: Dependence) -> tuple[bool, int, bool]:
    """Lower for simpler variables: one variable before two, the direction before the speed, angle before command."""
    return d.pair, PLAIN.index(d.curve), d.variable in ("speed", "command")


def _moved(
    judge: Judge, every: Sequence[Variable], shaped: Sequence[Sequence[Rows]], moved: Sequence[float]
) -> list[float]:
    """Share that each variable explains once moved in time, and the most of any pair, of any waves, of any swing."""
    forces = [v for v in every if v.signal is None]
    acting = [*(v.rows for v in forces), *(rows for group in shaped for rows in group)]
    columns = judge.design.columns([np.hstack(rows) for rows in zip(*acting, strict=True)], None, moved)
    blocks = np.split(columns, np.cumsum([rows[0].shape[1] for rows in acting])[:-1], axis=1)
    shares = [judge.forces.explained(block, curve=True).share for block in blocks[: len(forces)]]
    surfaces = [judge.explained(v.rows, None, moved).share for v in pairs(forces, shares)]
    others = [judge.forces.explained(block).share for block in blocks[len(forces) :]]
    shares += [judge.explained(v.rows, v.signal, moved, curve=True).share for v in every if v.signal is not None]
    waving = len(shaped[0])
    return [*shares, max(surfaces, default=0.0), max(others[:waving]), max(others[waving:])]


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


def sines(design: Design, period: float, signal: int | None = None) -> list[Array]:
    """For each play (n, 2) sine and cosine over the angle, at its nodes or a sensor's samples."""
    turns = [2.0 * np.pi * angle / period for angle in design.at(signal).angles(signal)]
    return [np.column_stack([np.sin(turn), np.cos(turn)]) for turn in turns]


def periods(design: Design) -> Array:
    """(P,) rad, of waves over the angle that the visited range can resolve."""
    span = max(float(np.ptp(p.motion.angle)) for p in design.plays)
    return np.geomspace(span / MOST_WAVES, span / LEAST_WAVES, PERIODS)


def waves(
    judge: Judge, positions: Sequence[str], chances: Mapping[int | None, float], seed: int, ratios: Mapping[str, float]
) -> list[tuple[Dependence, Explained]]:
    """Waves over the angle, of a force and of each sensor, by the period that explains most.

    Args:
        chances: number of a sensor, None for a force -> share that chance explains.
    """
    design, missing, tried = judge.design, judge.design.missing, periods(judge.design)
    ways: list[tuple[str, str, str, int | None]] = [("angle", "curve_angle", missing.axis, None)]
    ways += [("angle, as a sensor's error", "curve_sensor", missing.signals[i], i) for i in sensors(design, positions)]
    dependences = []
    for name, which, place, signal in ways:

        def explained(period: float, signal: int | None = signal) -> Explained:
            return judge.explained(sines(design, period, signal), signal)

        def share(period: float, explained: Callable[[float], Explained] = explained) -> float:
            return explained(period).share

        best = refined(share, tried, int(np.argmax([share(float(p)) for p in tried])))
        e, chance = explained(best), chances[signal]
        known = e.share, e.interval(seed), chance, _matters(e, chance)
        dependences.append((Dependence(name, which, place, *known, best, traced(best, ratios)), e))
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
