# SPDX-License-Identifier: Apache-2.0
"""Tests of a law: refits without a diagnosis, and the command that shows the law best.

A refit fits the values that a model has, or one effect together with them, and gives what is left on other plays. The
command goes where the recordings did not, in the variable that the law depends on.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.added_force import Motion
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, SearchOptions, axis_parts, axis_search, search_of
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, candidate
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.law.depends import Dependence
from eps_tunnel_analysis.law.variables import OVER_OTHER, OVER_SPEED
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Chirp, Command, Hold, Ramp, Shape, Triangle
from eps_tunnel_analysis.sequence_file import sequence_text
from labyrinth_sim.effect import Effect
from labyrinth_sim.model import Model
from labyrinth_sim.rig import Axis
from labyrinth_sim.trials import Array

FIRST, LAST = 4, 6  # rounds of descent
TRIED = 4  # starts of an effect that are descended

BINS = 10
RARE = 0.01  # of the time, below which a tenth of a range counts as not visited
STRETCH = 1.5  # times the visited range of angles, at most
WITHIN = 0.9  # of the rig's limits
SPEEDS = (0.02, 0.06, 0.15, 0.4, 0.8)  # of the fastest motion so far
SLOWEST, QUICKEST = 0.25, 3.0  # Hz, of triangles
AT_ONE_SPEED = 2.0  # s at one speed
SWEEP = 4.0  # s for one slow sweep over all angles
PAUSES = (0.15, 0.4, 1.0)  # s between reversals


def with_effect_fitted(model: Model, plays: Sequence[Play], axis: str, name: str, nthread: int = 0) -> Model:
    """A model with an effect of the library, `EFFECT.PLACE`, fitted together with an axis's base values."""
    part = next(p for p in axis_parts(model, plays) if p.name == axis)
    search = axis_search(model, plays, part, SearchOptions((name,), nthread))
    return _fitted(model, search, search.library.find(name))


def with_own_effect_fitted(
    model: Model, plays: Sequence[Play], axis: str, effect: Effect, place: str, nthread: int = 0
) -> Model:
    """The same with an effect that no library has, at a place."""
    part = next(p for p in axis_parts(model, plays) if p.name == axis)
    lib = library_of(model, part, [(effect, place)])
    return _fitted(model, search_of(lib, plays, part, SearchOptions((), nthread)), lib.candidates[0])


def library_of(model: Model, part: AxisPart, placed: Sequence[tuple[Effect, str]]) -> Library:
    """Effects that no registry has, each at its place, switched off in the model, as candidates for one axis."""
    for effect, place in placed:
        model = model.with_effect(effect, place, effect.off, "switched off")
    return Library(model, part.base, tuple(candidate(model, *each) for each in placed), part.rough)


def _fitted(model: Model, search: Search, own: Candidate) -> Model:
    base = search.refit([((), search.start)], 1)[0]
    points = search.trial_points([base], [own])[:TRIED]
    early = search.refit([((own,), p.values) for p in points], FIRST)
    late = search.refit([((own,), r.values) for r in sorted(early, key=lambda r: r.cost)[:2]], LAST, "fine")
    best = min(late, key=lambda r: r.cost).values
    fitted = dict(zip(search.library.names, (float(v) for v in best), strict=True))
    added = model.with_effect(own.effect, own.place, own.given)
    result = added.with_values({n: fitted[n] for n in search.library.base}, "refitted")
    return result.with_values({n: fitted[n] for n in own.parameters}, "fitted")


def floors_on(model: Model, plays: Sequence[Play], axis: str, nthread: int = 0) -> float:
    """Mean square in units of the noise floor that a model leaves of an axis in plays, nothing being fitted."""
    part = next(p for p in axis_parts(model, plays) if p.name == axis)
    search = axis_search(model, plays, part, SearchOptions((), nthread))
    return float(np.mean(search.residuals(search.start[None], "exact") ** 2))


@dataclass(frozen=True)
class Visit:
    """A sequence to play.

    Attributes:
        name: of the sequence.
        command: what is played.
        unvisited: spans of the variable, low to high in its unit, that the recordings hardly visit.
        reason: in words.
        linear: channels of slide joints.
    """

    name: str
    command: Command
    unvisited: tuple[tuple[float, float], ...]
    reason: str
    linear: tuple[str, ...] = ()

    def to_yaml(self, trials: int = 5) -> str:
        """A sequence file, ready to play."""
        return sequence_text(self.command, self.reason, trials, self.linear)


def visit(model: Model, axis: str, depends: Dependence, motions: Sequence[Motion]) -> Visit:
    """The sequence that visits what the recordings do not.

    Args:
        depends: what is named.
        motions: of the axis in the recordings.
    """
    own = model.rig.axis(axis)
    low, high = _allowed(own, motions)
    shapes = _shapes(depends, low, high, max(float(np.abs(m.speed).max()) for m in motions))
    lasts = math.fsum(s.lasts for s in shapes)
    rows = tuple(tuple(shapes) if a is own else _along(a, own, motions, depends.curve, lasts) for a in model.rig.axes)
    word = depends.over.removeprefix("curve_")
    name, channels = f"visit_{word}_{axis}", model.rig.command_channels
    spans, unit = _unvisited(depends.over, motions, low, high), "m" if own.slides else "rad"
    unit += "/s" if depends.over in OVER_SPEED else ""
    parts = ", ".join(f"{a:.3g} to {b:.3g} {unit}" for a, b in spans)
    reason = f"Visits {depends.variable} evenly" + (f"; hardly recorded so far: {parts}." if parts else ".")
    linear = tuple(a.command for a in model.rig.axes if a.slides)
    return Visit(name, Command(name, channels, (0.0,) * len(channels), rows), spans, reason, linear)


def _allowed(axis: Axis, motions: Sequence[Motion]) -> tuple[float, float]:
    """Angles that may be commanded: a little beyond those visited, within the rig's limits."""
    low, high = min(float(m.angle.min()) for m in motions), max(float(m.angle.max()) for m in motions)
    more = 0.5 * (STRETCH - 1.0) * (high - low)
    return max(low - more, WITHIN * axis.limits[0]), min(high + more, WITHIN * axis.limits[1])


def _shapes(depends: Dependence, low: float, high: float, fast: float) -> list[Shape]:
    """For the axis itself, from its middle."""
    curve, middle, half = depends.curve, round(0.5 * (low + high), 4), round(0.5 * (high - low), 4)
    shapes: list[Shape] = [Ramp(1.0, middle), Hold(0.3)]
    if depends.frequency:
        waves = depends.frequency / (2.0 * math.pi)
        amplitude = min(0.5 * fast / depends.frequency, half)  # as fast as recorded where it is quickest
        shapes += [Chirp(3.0 * SWEEP, round(amplitude, 5), round(0.5 * waves, 3), round(2.0 * waves, 3))]
    elif curve in (*OVER_SPEED, "curve_load_friction"):
        for speed in (share * fast for share in SPEEDS):
            frequency = min(max(speed / (4.0 * half), SLOWEST), QUICKEST)
            periods = math.ceil(AT_ONE_SPEED * frequency)
            shapes.append(Triangle(periods / frequency, min(speed / (4.0 * frequency), half), frequency))
    elif curve == "curve_reversal":
        for pause in PAUSES:
            frequency = 0.5 / pause
            speed = min(0.3 * fast, half / (0.5 * pause))
            shapes.append(Triangle(max(2.0, 4.0 / frequency), 0.5 * speed * pause, frequency))
    else:
        shapes += [Triangle(SWEEP, half, 1.0 / SWEEP), Triangle(SWEEP, half, 2.0 / SWEEP)]
        shapes += [Triangle(SWEEP, 0.5 * half, 3.0 / SWEEP)]
        if curve.startswith("curve_time"):
            shapes += [Triangle(5.0 * SWEEP, 0.5 * half, 3.0 / SWEEP)]
    return [*shapes, Hold(0.5)]


def _along(axis: Axis, own: Axis, motions: Sequence[Motion], curve: str, lasts: float) -> tuple[Shape, ...]:
    """For another axis: at rest, or slowly over its range if the law depends on it."""
    if curve not in OVER_OTHER:
        return (Hold(lasts),)
    half = max((float(np.abs(m.other).max(initial=0.0)) for m in motions), default=0.0)
    half = min(STRETCH * half, WITHIN * min(abs(limit) for limit in axis.limits))
    return (Triangle(lasts, half, 1.5 / lasts),)


def _unvisited(curve: str, motions: Sequence[Motion], low: float, high: float) -> tuple[tuple[float, float], ...]:
    """Spans of angle or speed that less than RARE of the time was spent in; of other variables none."""
    if curve in OVER_SPEED:
        values = np.concatenate([m.speed for m in motions])
        edges = np.linspace(-1.0, 1.0, BINS + 1) * float(np.abs(values).max())
    elif curve in ("curve_angle", "curve_angle_friction", "curve_sensor"):
        values = np.concatenate([m.angle for m in motions])
        edges = np.linspace(low, high, BINS + 1)
    else:
        return ()
    return _joined(np.histogram(values, edges)[0] < RARE * len(values), edges)


def _joined(empty: NDArray[np.bool_], edges: Array) -> tuple[tuple[float, float], ...]:
    spans: list[tuple[float, float]] = []
    for here, low, high in zip(empty.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if here and spans and spans[-1][1] == low:
            spans[-1] = spans[-1][0], high
        elif here:
            spans.append((low, high))
    return tuple(spans)
