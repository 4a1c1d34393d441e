# SPDX-License-Identifier: Apache-2.0
"""Cases: a drawn rig, what is wrong with it and how plainly that shows, what is played, and the files of all that."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path as File
from typing import Any

import numpy as np
from counting import spelled
from scipy.optimize import least_squares, lsq_linear

from drawn_rigs.commands import SHARES, STYLES
from drawn_rigs.effects import CONTAINED_BY, Form, forms_of
from drawn_rigs.files import write_bags, write_rig
from drawn_rigs.physics import Array, DivergedError
from drawn_rigs.reading import library_names
from drawn_rigs.reality import Plan, Reality, clean, record
from drawn_rigs.rigs import LAWS, PLANTS, Loose, Rig, draw_rig

COUNTS = {"single": 1, "healthy": 0, "pair": 2, "left_out": 1, "outside": 1}  # of what is wrong
KINDS = {"single": 0.38, "healthy": 0.2, "pair": 0.12, "left_out": 0.15, "outside": 0.15}
RATES = (50.0, 100.0, 100.0, 125.0, 200.0, 250.0, 500.0)  # Hz
VISIBLE = (0.3, 30.0)  # times the floor, between which strengths are drawn; pairs from 3 on
PAIRS_FROM = 3.0
MESSAGES = 16_000  # in a case's bags; more trials are not drawn
ENOUGH = 0.5  # of the least visibility; what cannot even show that much is not hidden in that rig
LADDER = 7  # strengths tried before the one that shows as it should
SECANTS = 2
REFITS = 8  # rounds in which other values of the drive make up for what is hidden, as far as they can
SHORTER = (1.0, 0.5, 0.25, 0.1)  # of a round's step, the first that helps
FARTHEST = 0.8  # of a value that a refit may move freely, per round
TRUST_ROUNDS = 25  # of the trust region
ROUNDS = 0.002  # s, a multiple of every firmware's round
LOG_SHIFT = 0.02  # by which the slope of a logarithm is taken
LOG_FARTHEST = 7.0  # that it may move
LARGEST_D = 20.0  # 1/s, of either sign, as far as the library's drive searches
STARTS_OF_D = (-10.0, 10.0)  # 1/s more than before: no descent from one valley finds the other
FAR = 1e6  # floors, where a roll-out diverges
SETTLED = 0.25  # s from a trial's start that do not count: a model starts where the sensors say
REPLICAS = 4  # trials from which the noise floor is taken
TOLERANCE = 5e-4  # share of a motion that does not matter, as docs/diagnosis.md says


@dataclass(frozen=True)
class Hidden:
    """One thing that is wrong.

    Attributes:
        effect, place, form: what, where, and which form of it.
        strength: in the form's own unit.
        deviation: by how much it moves the positions, root mean square over the floor of the mean of the trials.
        visibility: the same, after all that other values of the drive and the stated ones can make up for.
        first_order: the same to first order; the strength was chosen by this.
        also: names in the library that are as right, because the form is literally theirs.
        elsewhere: other places at which it is the same thing, as one supply feeds all axes.
        period: rad, of what goes by waves over the angle; 0 for the others.
    """

    effect: str
    place: str
    form: str
    strength: float
    deviation: float
    visibility: float
    first_order: float
    also: tuple[str, ...] = ()
    elsewhere: tuple[str, ...] = ()
    period: float = 0.0

    @property
    def name(self) -> str:
        """effect.place, as a verdict names it."""
        return f"{self.effect}.{self.place}"

    @property
    def names(self) -> tuple[str, ...]:
        """Every name that is right, `name` first, that of all places together last."""
        places = (self.place, *self.elsewhere)
        names = [f"{effect}.{place}" for effect in (self.effect, *self.also) for place in places]
        every = " + ".join(sorted(f"{self.effect}.{place}" for place in places))
        return (*names, every) if self.elsewhere else tuple(names)


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        seed: everything follows from it.
        kind: "single", "healthy", "pair", "left_out" (of the library) or "outside" (it).
        rig, law: kinds of rig and drive.
        hidden: what is wrong; nothing where healthy.
        only: names of the effects that may be considered, None for all.
        model: file of the model; `bags` those of the recordings.
        styles: of the commands, one for each play.
        rate, trials: Hz of the readings; trials of each play.
        fresh: bags of one more command, that is never fitted; none unless requested.
    """

    seed: int
    kind: str
    rig: str
    law: str
    hidden: tuple[Hidden, ...]
    only: tuple[str, ...] | None
    model: File
    bags: tuple[File, ...]
    styles: tuple[str, ...]
    rate: float
    trials: int
    fresh: tuple[File, ...] = ()

    @property
    def truth(self) -> str:
        """The hypothesis that is true: "none", "unknown", or the effects' names."""
        if self.kind in ("outside", "left_out"):
            return "unknown"
        return " + ".join(sorted(h.name for h in self.hidden)) or "none"

    @property
    def visibility(self) -> float:
        """That of what shows least; 0 where nothing is hidden."""
        return min((h.visibility for h in self.hidden), default=0.0)

    @property
    def as_true(self) -> tuple[str, ...]:
        """Hypotheses that are as true as `truth`, in the same way of writing."""
        if self.truth in ("none", "unknown"):
            return ()
        every = [spelled(" + ".join(names)) for names in itertools.product(*(h.names for h in self.hidden))]
        return tuple(name for name in every if name != self.truth)

    def to_json(self) -> dict[str, Any]:
        """What a record keeps of it."""
        return {
            "seed": self.seed, "kind": self.kind, "truth": self.truth, "as_true": list(self.as_true),
            "rig": self.rig, "law": self.law, "hidden": [asdict(h) | {"names": h.names} for h in self.hidden],
            "styles": list(self.styles), "rate": self.rate,
            "trials": self.trials,
        }  # fmt: skip


def draw(
    seed: int, folder: File, rig: str | None = None, kind: str | None = None, effect: str | None = None,
    fresh: bool = False, form: str | None = None,
) -> Case:  # fmt: skip
    """The case of a seed; its files are written into a folder.

    Args:
        rig: kind of rig instead of a drawn one; likewise `kind` of case.
        effect: what is hidden, instead of something drawn; `form`, in which form, of an effect that has it.
        fresh: record one more command.
    """
    rng = np.random.default_rng([seed, 19])
    chosen = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    drawn_rig, law = str(rng.choice(list(PLANTS))), str(rng.choice(LAWS))
    kind, rig = kind or chosen, rig or drawn_rig
    while True:  # a rig with everything that is drawn may be unusable
        try:
            return _draw(rng, seed, folder, kind, rig, law, effect, fresh, form)
        except DivergedError:
            continue


def _draw(
    rng: np.random.Generator, seed: int, folder: File, kind: str, rig_kind: str, law: str, effect: str | None,
    fresh: bool, way: str | None,
) -> Case:  # fmt: skip
    rig = draw_rig(rng, rig_kind, law)
    rate, seconds = float(rng.choice(RATES)), float(rng.uniform(6.0, 12.0))
    plays = 1 if rng.random() < 0.7 else 2
    most = max(1, int(MESSAGES / plays / (seconds * rate)))
    trials = min(int(rng.integers(1, 11)), most)
    styles = tuple(str(s) for s in rng.choice(list(STYLES), plays, p=[SHARES[s] for s in STYLES]))
    plans = [_plan(rng, rig, style, rate, seconds) for style in styles]
    view_of = partial(View.of, plans, trials=trials, seed=seed)
    healthy = view_of(rig.reality)
    reality, hidden = rig.reality, []
    for form, axis, place in _possible(rng, rig, kind, way):
        if len(hidden) == COUNTS[kind]:
            break
        if effect and form.effect != effect:
            continue
        low = PAIRS_FROM if kind == "pair" else VISIBLE[0]
        wanted = float(np.exp(rng.uniform(np.log(low), np.log(VISIBLE[1]))))
        shape = rng.random(5)
        sign = float(rng.choice([-1.0, 1.0])) if form.signed else 1.0
        item = calibrated(rig, healthy, view_of, form, axis, place, wanted, sign, shape)
        if item.first_order >= ENOUGH * low:  # no motion of this rig shows the others
            reality = form.apply(rig, reality, axis, place, sign * item.strength, shape)
            hidden.append(replace(item, period=_period(reality, form.effect, axis)))
    folder.mkdir(parents=True, exist_ok=True)
    marked = bool(rng.random() < 0.7)
    bags: list[File] = []
    for number, (style, plan) in enumerate(zip(styles, plans, strict=True)):
        trial_seed = seed * 10 + number
        recorded = record(reality, plan, trials, trial_seed)
        bags += write_bags(folder, rig, f"{style}_{number}", recorded, plan.seconds, marked)
    only = None
    if kind == "left_out":
        gone = {hidden[0].effect, *CONTAINED_BY.get(hidden[0].effect, ())}
        only = tuple(name for name in library_names() if name not in gone)
    model = write_rig(folder, rig, rate)
    more = _fresh(seed, folder, rig, reality, styles, rate, seconds, trials) if fresh else ()
    return Case(seed, kind, rig.kind, law, tuple(hidden), only, model, tuple(bags), styles, rate, trials, more)


def _fresh(
    seed: int, folder: File, rig: Rig, reality: Reality, played: Sequence[str], rate: float, seconds: float, trials: int
) -> tuple[File, ...]:
    """Bags of one more command, of a style that was not played; none where the rig does not survive it."""
    rng = np.random.default_rng([seed, 20])
    style = str(rng.choice([s for s in STYLES if s not in played and s != "paper"]))
    plan = _plan(rng, rig, style, rate, seconds)
    try:
        recorded = record(reality, plan, trials, seed * 10 + 8)
    except DivergedError:
        return ()
    return tuple(write_bags(folder, rig, f"{style}_fresh", recorded, plan.seconds, True))


PERIODS = {"cogging": "cogging_period", "eccentric_gear": "uneven_period", "tight_places": "tight_period"}


def _period(reality: Reality, effect: str, axis: int) -> float:
    """rad, of the waves that an effect makes over the angle; 0 where it makes none."""
    if effect not in PERIODS:
        return 0.0
    ripples = [s.ripple_period for s in reality.sensors.values() if s.axis == axis and s.ripple]
    return float(ripples[0] if ripples else reality.physics.of(axis, PERIODS[effect]))


def _plan(rng: np.random.Generator, rig: Rig, style: str, rate: float, seconds: float) -> Plan:
    sending = rate if rng.random() < 0.6 else min(rate, 100.0)
    times = np.arange(0.0, seconds, 1.0 / sending)
    targets = STYLES[style](rng, times, np.array(rig.reach))
    step = 1.0 / max(rate, sending)
    return Plan(
        times, targets, seconds, rate,
        send_jitter=step * float(rng.choice([0.0, rng.uniform(0.0, 0.1)])),
        stamp_jitter=step * float(rng.choice([0.0, rng.uniform(0.0, 0.03)])),
    )  # fmt: skip


def _possible(rng: np.random.Generator, rig: Rig, kind: str, way: str | None = None) -> Iterator[tuple[Form, int, str]]:
    """Forms with their axis and place, one of each effect, in a drawn order; a certain one of those that have it."""
    possible = forms_of(rig, outside=kind == "outside")
    for name in rng.permutation(sorted({form.effect for form, _, _ in possible})) if COUNTS[kind] else ():
        own = [entry for entry in possible if entry[0].effect == name]
        ways = sorted({entry[0].name for entry in own})
        chosen = way if way in ways else str(rng.choice(ways))
        places = [entry for entry in own if entry[0].name == chosen]
        yield places[int(rng.integers(len(places)))]


def _floors(reality: Reality, plan: Plan, trials: int, seed: int) -> dict[str, float]:
    """Noise floor of the mean of the trials, of every position, and what of its motion does not matter."""
    runs = record(reality, plan, REPLICAS, seed * 10 + 9)
    still = clean(reality, plan)
    times = np.arange(len(next(iter(still.values())))) / plan.rate
    floors = {}
    for name, sensor in reality.sensors.items():
        if sensor.quantity in ("motor", "load"):
            inside = (times > SETTLED) & (times < plan.seconds - 0.1)
            on_grid = np.array([np.interp(times, run.stamps, run.readings[name])[inside] for run in runs])
            varies = float(np.mean(np.var(on_grid, axis=0, ddof=1)))
            # Of the ticks' error that part remains in a mean which noise does not spread (Widrow and Kollar 2008).
            stays = sensor.tick**2 / 12 * float(np.exp(-((2 * np.pi * sensor.noise / sensor.tick) ** 2)))
            allowed = TOLERANCE * float(np.std(still[name][int(SETTLED * plan.rate) :]))
            floors[name] = float(np.sqrt(max(varies, stays) / trials + stays * (1 - 1 / trials) + allowed**2))
    return floors


@dataclass(frozen=True)
class View:
    """What is played, and the noise floor of the mean of the trials there.

    Attributes:
        plans: one for each play.
        floors: of each play: position -> its unit.
    """

    plans: tuple[Plan, ...]
    floors: tuple[dict[str, float], ...]

    @classmethod
    def of(cls, plans: Sequence[Plan], reality: Reality, trials: int, seed: int) -> "View":
        """The floors that a reality's own trials show."""
        return cls(tuple(plans), tuple(_floors(reality, plan, trials, seed) for plan in plans))

    @property
    def first(self) -> "View":
        """The first play alone."""
        return View(self.plans[:1], self.floors[:1])

    def beside(self, other: "View") -> "View":
        """With the larger of two floors."""
        both = zip(self.floors, other.floors, strict=True)
        return View(self.plans, tuple({name: max(own[name], one[name]) for name in own} for own, one in both))

    def stacked(self, reality: Reality) -> Array:
        """(N,) all positions over their floors, from where a start has been forgotten, signal by signal."""
        seen = [clean(reality, plan) for plan in self.plans]
        every = zip(seen, self.floors, self.plans, strict=True)
        parts = [(readings, floors, int(SETTLED * plan.rate)) for readings, floors, plan in every]
        return np.concatenate([r[name][first:] / f[name] for name in self.floors[0] for r, f, first in parts])

    def size(self, apart: Array) -> float:
        """Root mean square of the signal that differs most."""
        return float(np.sqrt(np.max(np.mean(apart.reshape(len(self.floors[0]), -1) ** 2, axis=1))))


def calibrated(
    rig: Rig, healthy: View, view_of: Callable[[Reality], View], form: Form, axis: int, place: str, wanted: float,
    sign: float, shape: Array,
) -> Hidden:  # fmt: skip
    """The strength at which a form shows `wanted` times the floor in the first play to first order, as nearly as its
    range allows.

    Args:
        healthy: the floors without it; `view_of`, those that a reality's own trials show.
    """
    before = form.before(rig.reality, axis) if form.before else rig.reality
    view = healthy.first

    def hidden(strength: float, seen: tuple[float, float]) -> Hidden:
        visible = seen[1]
        if 0.0 < visible < np.inf:
            changed = form.apply(rig, before, axis, place, sign * strength, shape)
            # What makes trials differ hides itself: a rig's own trials are all that shows its floor.
            own = view_of(changed).beside(healthy)
            visible = _refitted(rig, before, changed, own, axis)
        elsewhere = tuple(name for name in rig.axes if name != place) if form.everywhere else ()
        return Hidden(form.effect, place, form.name, strength, seen[0], visible, seen[1], form.also, elsewhere)

    without = view.stacked(before)
    slopes, low, high, _ = _slopes(rig, before, view, without, axis)

    def shows(strength: float) -> tuple[float, float]:
        try:
            changed = form.apply(rig, before, axis, place, sign * strength, shape)
            apart = view.stacked(changed) - without
        except DivergedError:
            return np.inf, np.inf
        remaining = apart
        if slopes.size:
            remaining = apart - slopes @ lsq_linear(slopes, apart, bounds=(low, high)).x
        return view.size(apart), view.size(remaining)

    below: tuple[float, tuple[float, float]] | None = None
    above: tuple[float, tuple[float, float]] | None = None
    for strength in np.geomspace(form.low, form.high, LADDER):
        seen = shows(float(strength))
        if not np.isfinite(seen[1]):
            break
        if seen[1] >= wanted:
            above = float(strength), seen
            break
        below = float(strength), seen
    if above is None or below is None:
        return hidden(*(above or below or (form.low, (0.0, 0.0))))
    for _ in range(SECANTS):
        rise = np.log(above[1][1] / max(below[1][1], 1e-9))
        share = np.clip(np.log(wanted / max(below[1][1], 1e-9)) / max(rise, 1e-9), 0.05, 0.95)
        strength = float(below[0] * (above[0] / below[0]) ** share)
        seen = shows(strength)
        below, above = ((strength, seen), above) if seen[1] < wanted else (below, (strength, seen))
    return hidden(strength, seen)


def _refitted(rig: Rig, before: Reality, changed: Reality, view: View, axis: int) -> float:
    """How a reality differs from another one whose loose values are fitted to it in whole roll-outs.

    Slopes at the true values alone exaggerate: a drive that a large effect moves far can compensate for more of it.
    Two searches, as either may stop too early: Gauss-Newton with bounded steps, and a trust region in which values
    that are free and positive move as logarithms. The smallest difference on their way counts.
    """
    shown = view.stacked(changed)
    return min(_by_bounded_steps(rig, before, shown, view, axis), _by_trust_region(rig, before, shown, view, axis))


def _by_bounded_steps(rig: Rig, before: Reality, shown: Array, view: View, axis: int) -> float:
    fitted, apart = before, view.stacked(before) - shown
    least = view.size(apart)
    cost = float(apart @ apart)
    for _ in range(REFITS):
        slopes, low, high, loose = _slopes(rig, fitted, view, apart + shown, axis)
        if not loose:
            break
        change = lsq_linear(slopes, -apart, bounds=(np.maximum(low, -1e6), np.minimum(high, 1e6))).x
        for share in SHORTER:
            there = _moved(fitted, loose, share * change)
            try:
                rest = view.stacked(there) - shown
            except DivergedError:
                continue
            if float(rest @ rest) < cost:
                break
        else:
            break
        gained = cost - float(rest @ rest)
        fitted, apart, cost = there, rest, float(rest @ rest)
        least = min(least, view.size(apart))
        if gained < 0.02 * cost:
            break
    return least


def _by_trust_region(rig: Rig, before: Reality, shown: Array, view: View, axis: int) -> float:
    values = _movable(rig, axis)
    own = np.array([_value(before, loose) for loose in values])
    true = np.array([_value(rig.reality, loose) for loose in values])
    signed = np.array([rig.law == "velocity_pid" and loose.name == "d" for loose in values])  # D of either sign
    free = np.array([not np.isfinite(loose.low) and value > 0 for loose, value in zip(values, own, strict=True)])
    free &= ~signed
    scale = np.array([loose.step for loose in values])
    # A delay is moved by whole rounds of the firmware: it waits for the next one anyway.
    shift = np.array([ROUNDS if loose.name == "delay" else loose.step for loose in values]) / scale
    shift[free] = LOG_SHIFT
    low = (np.array([max(loose.low + value, 0.0) for loose, value in zip(values, true, strict=True)]) - own) / scale
    high = (np.array([loose.high + value for loose, value in zip(values, true, strict=True)]) - own) / scale
    low, high = np.minimum(low, 0.0) - 1e-9, np.maximum(high, 0.0) + 1e-9
    low[free], high[free] = -LOG_FARTHEST, LOG_FARTHEST
    low[signed], high[signed] = (-LARGEST_D - own[signed]) / scale[signed], (LARGEST_D - own[signed]) / scale[signed]
    least = np.inf

    def apart(moved: Array) -> Array:
        nonlocal least
        reality = before
        grown = own * np.exp(np.where(free, moved, 0.0))
        for loose, value in zip(values, np.where(free, grown, own + scale * moved), strict=True):
            reality = _with(reality, loose, float(value))
        try:
            rest = view.stacked(reality) - shown
        except DivergedError:
            return np.full(len(shown), FAR)
        least = min(least, view.size(rest))
        return rest

    def slopes(moved: Array) -> Array:
        here = apart(moved)
        ways = np.where(moved + shift > high, -shift, shift)
        columns = [(apart(moved + way * unit) - here) / way for way, unit in zip(ways, np.eye(len(ways)), strict=True)]
        return np.column_stack(columns)

    for d in (0.0, *(STARTS_OF_D if signed.any() else ())):
        start = np.where(signed, np.clip(d / scale, low, high), 0.0)
        least_squares(apart, start, jac=slopes, bounds=(low, high), x_scale="jac", max_nfev=TRUST_ROUNDS,
                      ftol=1e-3)  # fmt: skip
    return least


def _movable(rig: Rig, axis: int) -> list[Loose]:
    """What a refit of an axis may move: its own values, and those of axes that shake it."""
    return [loose for loose in rig.loose if loose.axis == axis or rig.kind == "two_link_arm"]


def _moved(reality: Reality, every: Sequence[Loose], change: Array) -> Reality:
    """A reality with loose values moved by so many of their steps; free ones no further than a round may."""
    for loose, by in zip(every, change, strict=True):
        own = _value(reality, loose)
        away = float(by) * loose.step
        if not np.isfinite(loose.low) and own:
            away = float(np.clip(away, -FARTHEST * abs(own), FARTHEST * abs(own)))
        reality = _with(reality, loose, own + away)
    return reality


def _value(reality: Reality, loose: Loose) -> float:
    return reality.paths[loose.axis].delay if loose.name == "delay" else reality.physics.of(loose.axis, loose.name)


def _with(reality: Reality, loose: Loose, value: float) -> Reality:
    if loose.name == "delay":
        return reality.with_path(loose.axis, delay=max(value, 0.0))
    return reality.with_axis(loose.axis, **{loose.name: value})


def _slopes(
    rig: Rig, before: Reality, view: View, healthy: Array, axis: int
) -> tuple[Array, Array, Array, list[Loose]]:
    """(N, k) change of the positions with each value that a refit may move, scaled to steps, the bounds (k,) of how
    many steps it may move from here, and which values these are.
    """
    columns, low, high, moved = [], [], [], []
    for loose in _movable(rig, axis):
        true, own = _value(rig.reality, loose), _value(before, loose)
        shift = loose.step
        if loose.name == "delay":
            bounds = -own, max(true + loose.high - own, 0.0)
            shift = loose.step if bounds[1] > loose.step else -loose.step
        else:
            bounds = loose.low + true - own, loose.high + true - own
        if bounds[0] == bounds[1]:
            continue
        try:
            there = view.stacked(_with(before, loose, own + shift))
        except DivergedError:
            continue
        columns.append((there - healthy) / shift * loose.step)
        low.append(min(bounds[0] / loose.step, -1e-9))
        high.append(max(bounds[1] / loose.step, 1e-9))
        moved.append(loose)
    if not columns:
        return np.empty((len(healthy), 0)), np.empty(0), np.empty(0), []
    return np.column_stack(columns), np.array(low), np.array(high), moved
