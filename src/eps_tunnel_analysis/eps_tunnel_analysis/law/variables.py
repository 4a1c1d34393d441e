# SPDX-License-Identifier: Apache-2.0
"""What a force, a friction, or the error of a sensor or of the command may depend on, as columns over time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import exp

import numpy as np
from scipy.signal import bilinear, lfilter

from eps_tunnel_analysis.diagnose.added_force import Motion, visited
from eps_tunnel_analysis.law.design import COMMAND, Design, Rows
from labyrinth_sim.curve import KNOTS, NAMES, curve, share_about, speed_knots, speed_share
from labyrinth_sim.filters import Profile, RateLimit
from labyrinth_sim.trials import Array

PERIODS = 120  # of waves over an angle, tried evenly in the logarithm
MOST_WAVES = 40.0  # within the range visited
LEAST_WAVES = 0.8
A_WAVE = 4.0  # values of a command in each of its waves, at least
TRIED_IN_PAIRS = 3  # variables whose pairs are tried: those that explain most by themselves
COARSE = 5  # knots of a pair's surface over each of its variables
DAMPED = 0.05  # damping ratio with which a mass that swings is looked for
OVER_SPEED = ("curve_speed", "curve_sensor_speed")
"""Free curves whose variable is a speed."""
OF_SENSORS = ("curve_sensor", "curve_sensor_speed", "curve_sensor_other")
"""Free curves of a sensor's error."""
OVER_OTHER = ("curve_other", "curve_other_friction", "curve_sensor_other")
"""Free curves whose variable is the other axis's angle, or its command for an error of the command."""
ERROR_OF_COMMAND = "command, as the command's error"
OTHER = "the other axis's angle"
OTHER_IN_COMMAND = "the other axis's command, as the command's error"
TURNS = (0.2, 0.8)  # of a play, within which the sign of a constant turns by chance


@dataclass(frozen=True)
class Variable:
    """Something that a force, a friction, or an error of a sensor or of the command may depend on.

    Attributes:
        name: for people, as "angle".
        curve: the corresponding free curve.
        place: an axis, or a sensor's signal.
        rows: for each play, what each of the curve's knots adds over time: ten, or one for a direction.
        signal: number of the sensor, COMMAND, or None for a force.
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


def followed(motion: Motion, values: Array, after: float) -> Array:
    """(K,) a first-order memory of values (K,) over a motion's steps, with time constant `after` (s)."""
    keeps = exp(-(motion.time[1] - motion.time[0]) / after)
    return np.asarray(values[0] + lfilter([1.0 - keeps], [1.0, -keeps], values - values[0]))


def bent(motion: Motion, over: float) -> Array:
    """(K,) from -1 to 1, how far bristles are bent that bend over an angle before they slide: Dahl's friction.

    `z' = (speed - |speed| z) / over`, whose steps are exact.
    """
    travel = motion.speed * np.diff(motion.time, prepend=motion.time[0])
    keeps, ends = np.exp(-np.abs(travel) / over), np.sign(travel)
    states, now = np.empty(len(travel)), 0.0
    for k, (keep, end) in enumerate(zip(keeps.tolist(), ends.tolist(), strict=True)):
        now = end + (now - end) * keep
        states[k] = now
    return states


def target(motion: Motion) -> Array:
    """(K,) rad, the command; where the drive is off the joint's angle."""
    return np.where(np.isfinite(motion.command), motion.command, motion.angle)


def commanded(motion: Motion, errors: Array) -> Array:
    """(K, c) errors of the command over a motion's steps (K, c), which are none where the drive is off."""
    return np.asarray(np.where(np.isfinite(motion.command)[:, None], errors, 0.0))


def of_speed(speed: Array, spans: Mapping[str, Mapping[str, float]]) -> Array:
    """Share (K,) of the range of a curve over a speed."""
    most = np.full(1, spans["curve_speed"]["most"])
    return speed_share(speed[None], {"most": most})[0]


def of_other(angle: Array, spans: Mapping[str, Mapping[str, float]]) -> Array:
    """Share (K,) of the range of a curve over the other axis's angle (K,)."""
    return np.asarray(share_about(angle, spans["curve_other"]["centre"], spans["curve_other"]["half"]))


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
        other = of_other(motion.other, spans)
        by_curve |= {
            "curve_other": (OTHER, other, ones),
            "curve_other_friction": (f"{OTHER}, as friction", other, against),
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
        errors = {"angle": over_angle, "speed": over_speed}
        if "curve_other" in spans:
            others = seen.seen(number, [p.motion.other for p in seen.plays])
            errors[OTHER] = [hats(of_other(own, spans)) for own in others]
        every += [
            Variable(f"{what}, as a sensor's error", curve, missing.signals[number], own, number)
            for (what, own), curve in zip(errors.items(), OF_SENSORS, strict=False)
        ]
    if has_command(design):
        rows = [
            p.about_nodes(commanded(p.motion, hats(share_about(target(p.motion), span["centre"], span["half"]))))
            for p in design.at(COMMAND).plays
        ]
        every.append(Variable(ERROR_OF_COMMAND, "curve_angle", missing.axis, rows, COMMAND))
        if "curve_other" in spans:
            plays = design.at(COMMAND).plays
            rows = [p.about_nodes(commanded(p.motion, hats(of_other(p.motion.other_command, spans)))) for p in plays]
            every.append(Variable(OTHER_IN_COMMAND, "curve_other", missing.axis, rows, COMMAND))
    return every


def has_command(design: Design) -> bool:
    """Whether it is known how the axis answers to its command."""
    return any(answer.data.any() for answer in design.missing.commanded)


@dataclass(frozen=True)
class Lateness:
    """One way in which a command takes effect late.

    Attributes:
        title: for people.
        shapes: those tried, in s where the axis moves at 1 rad/s at most; `power` of that speed that they go down with.
        seen: (K,) of a motion and a shape, the command as it takes effect.
    """

    title: str
    shapes: tuple[float, ...]
    power: int
    seen: Callable[[Motion, float], Array]

    def tried(self, design: Design) -> Array:
        """(S,) shapes for these motions."""
        fast = max(float(np.abs(p.motion.speed).max()) for p in design.plays)
        return np.array(self.shapes) / fast**self.power

    def error(self, motion: Motion, shape: float) -> Array:
        """(K, 1) rad, the command's error over a motion's steps."""
        return np.asarray((self.seen(motion, shape) - target(motion))[:, None])

    def errors(self, design: Design, shape: float) -> list[Array]:
        """For each play (n, 1) rad, the same at its nodes."""
        return [p.about_nodes(commanded(p.motion, self.error(p.motion, shape))) for p in design.at(COMMAND).plays]


def _delayed(motion: Motion, delay: float) -> Array:
    return np.interp(motion.time - delay, motion.time, target(motion))


def _lagging(motion: Motion, after: float) -> Array:
    return followed(motion, target(motion), after)


def _slow(motion: Motion, slowness: float) -> Array:
    step, own = float(motion.time[1] - motion.time[0]), target(motion)
    return RateLimit(np.full(1, 1.0 / slowness), np.zeros(1, dtype=bool), step, own[:1])(own[None], own)[0]


def _profiled(motion: Motion, slowness: float) -> Array:
    step, own = float(motion.time[1] - motion.time[0]), target(motion)
    return Profile(np.full(1, 1.0 / slowness), np.full(1, np.inf), step, own[:1])(own[None], own)[0]


def _shapes(low: float, high: float) -> tuple[float, ...]:
    return tuple(float(s) for s in np.geomspace(low, high, 13))


LATENESS = {
    "late": Lateness("a delay of the command", _shapes(0.005, 0.3), 0, _delayed),
    "lag": Lateness("a lag of the command", _shapes(0.005, 1.0), 0, _lagging),
    "limit": Lateness("a limit of the command's speed", _shapes(0.3, 10.0), 1, _slow),
    "profile": Lateness("a limit of the command's acceleration", _shapes(0.002, 1.0), 1, _profiled),
}
"""Term of a formula -> the lateness that it is."""


def sines(design: Design, period: float, signal: int | None = None) -> list[Array]:
    """For each play (n, 2) sine and cosine over the angle, at its nodes or a sensor's samples; of COMMAND over the
    command.
    """
    if signal == COMMAND:
        plays = design.at(COMMAND).plays
        return [p.about_nodes(commanded(p.motion, in_waves(target(p.motion), period))) for p in plays]
    return [in_waves(angle, period) for angle in design.at(signal).angles(signal)]


def in_waves(angle: Array, period: float, factor: Array | float = 1.0) -> Array:
    """(n, 2) sine and cosine over an angle (n,), times a factor."""
    turn = 2.0 * np.pi * angle / period
    return np.column_stack([factor * np.sin(turn), factor * np.cos(turn)])


def periods(design: Design, signal: int | None = None) -> Array:
    """(P,) rad, of waves over the angle that the visited range resolves; of COMMAND its values must, too."""
    span = max(float(np.ptp(p.motion.angle)) for p in design.plays)
    every = np.geomspace(span / MOST_WAVES, span / LEAST_WAVES, PERIODS)
    return every[every >= A_WAVE * apart(design)] if signal == COMMAND else every


def apart(design: Design) -> float:
    """rad between neighbouring values of the command: half of its range lies between values that are no further apart.

    A command of few steps has few values, on which waves of any short period are any function at all.
    """
    values = np.unique(np.concatenate([target(p.motion) for p in design.at(COMMAND).plays]))
    gaps = np.sort(np.diff(values))
    return float(gaps[np.searchsorted(np.cumsum(gaps), 0.5 * gaps.sum())]) if len(gaps) else np.inf


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


def turned(design: Design, constant: Variable, rng: np.random.Generator) -> list[Array]:
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
