# SPDX-License-Identifier: Apache-2.0
"""What belongs to one axis, the search over its candidates, and axes that are searched at the same time."""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import partial
from threading import Event
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.ball import BALL, BALL_DIFFERENCE, inexactness, on_ball, part_name, values_of
from eps_tunnel_analysis.diagnose.candidates import Candidate, Library, is_tick, library
from eps_tunnel_analysis.diagnose.evidence import Evidence, PlayEvidence, play_evidence
from eps_tunnel_analysis.diagnose.noise import largest_tick
from eps_tunnel_analysis.diagnose.progress import SearchProgress
from eps_tunnel_analysis.diagnose.roll_outs import DIFFERENCE, Level
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.fit.cluster import Spread
from eps_tunnel_analysis.fit.problem import by_axis, default_free, full_name
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.stamped import setpoints
from labyrinth_sim.build import axes_couple, compiled, coupled_axes
from labyrinth_sim.errors import InputError
from labyrinth_sim.friction import SLOW
from labyrinth_sim.model import Model
from labyrinth_sim.prescribed import prescribed
from labyrinth_sim.rig import BALL_SIGNALS, Axis
from labyrinth_sim.trials import Array

STEPS: Mapping[Level, float] = {"coarse": 0.005, "fine": 0.0025, "exact": 0.00125}
"""s between the steps of roll-outs: to search; and, if these cannot be extrapolated, where they err, and to judge"""
BEGUN = 0.25  # s after the start, before which nothing is compared: a roll-out starts where sensors say
SPEED_CHANGE = 0.1  # 1/s, relative to the command's range; more from one sample to the next is sudden
SETTLED = 0.25  # s after which a motion is steady again
EFFORT_STEP = 0.005  # of the largest effort: what a load register resolves, but no less than
LOAD_STEP = 0.001  # of the servo's full torque
EFFORT_SHARE = 0.05  # of the effort: how well a torque constant is known
MOST_TOGETHER = 2  # axes that inertia couples and that are judged together at most
MOVES = 1e-3  # rad; a command that spans less excites nothing

Item = TypeVar("Item")
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class SearchOptions:
    """Options that are passed along in one diagnosis.

    Attributes:
        only: names of the effects to consider; None for the whole library.
        nthread: 0 for one per CPU; the answer does not depend on it.
        progress: called now and then; see `SearchProgress`.
        spread: runs roll-outs elsewhere; None for this machine.
        exhaustive: without shortcuts: every effect is descended, and none given up before its descent has ended.
        fitted: the model's values were fitted to these recordings before.
    """

    only: tuple[str, ...] | None = None
    nthread: int = 0
    progress: SearchProgress | None = None
    spread: Spread | None = None
    exhaustive: bool = False
    fitted: bool = False


@dataclass(frozen=True)
class AxisPart:
    """What is judged together: an axis, several coupled axes, or the ball.

    Attributes:
        axes: their short names.
        signals: compared; positions first, then efforts.
        base: full names of the values refitted with every candidate.
        rough: how many of them, the last ones, are known roughly; they are moved only after the others fit.
    """

    axes: tuple[str, ...]
    signals: tuple[str, ...]
    base: tuple[str, ...]
    rough: int = 0

    @property
    def name(self) -> str:
        """Name of the axis; for several, all names."""
        return " and ".join(self.axes)

    @property
    def title(self) -> str:
        """In words."""
        return part_name(self.name) if len(self.axes) == 1 else f"axes {self.name}"

    @property
    def heading(self) -> str:
        """The title as a heading or a sentence begins with it."""
        return f"{self.title[0].upper()}{self.title[1:]}"

    def level(self, levels: Mapping[str, float] | None) -> float:
        """Mean of the floors given for its axes, axis -> floors; 0 if none are given."""
        return sum((levels or {}).get(name, 0.0) for name in self.axes) / len(self.axes)


def axis_parts(model: Model, plays: Sequence[Play]) -> list[AxisPart]:
    """Every axis that has a position in all plays."""
    known = {name for play in plays for name in play.known}
    known |= values_of(model)  # shows in the ball alone
    shared = [s for s in model.rig.signals if all(s in play.trials.signals for play in plays)]
    default = default_free(model, signals=shared)
    free = [n for n in default if n not in known and not _silent_integral(model, n)]
    base = {part.axis: part.free for part in by_axis(model, free, plays, None)}
    parts = []
    for axis in model.rig.axes:
        seen = [m for m in axis.measured if all(m.signal in p.trials.signals for p in plays)]
        chosen = [m.signal for q in ("position", "torque") for m in seen if m.quantity == q]
        if any(m.quantity == "position" for m in seen):
            own = tuple(base.get(axis.name, ()))
            rough = tuple(n for n in rough_values(model, axis) if n not in known and n not in own)
            parts.append(AxisPart((axis.name,), tuple(chosen), own + rough, len(rough)))
    return parts


def rough_values(model: Model, axis: Axis) -> tuple[str, ...]:
    """Stated values of an axis that are rarely known well: the drive's limits, the inertia that it turns, its belt.

    A value stated as 0 stays 0, unless the drive itself declares it uncertain, or dry friction sets in gradually by it.
    """
    mj = compiled(model, with_ball=False).mj
    body = mj.body(int(mj.joint(axis.load).bodyid[0])).name
    names = [f"body.{body}.mass", f"joint.{axis.load}.armature", f"joint.{axis.load}.damping"]
    names += [f"body.{body}.inertia"] if axes_couple(model) else []  # else the armature does the same
    names += [f"belt.{axis.belt}.{p}" for p in ("stiffness", "damping")] if axis.belt else []
    values = model.values()
    own = [full_name(axis, name) for name in model.drives[axis.name].kind.uncertain]
    dry = [f"{use.effect.name}.{axis.name}.{SLOW.name}" for use in model.effects
           if use.place == axis.name and SLOW in use.effect.parameters]  # fmt: skip
    return (*own, *(n for n in names if n not in own and values.get(n, 0.0) > 0.0), *dry)


def moved_parts(model: Model, parts: Sequence[AxisPart], plays: Sequence[Play]) -> list[AxisPart]:
    """The parts that a recorded command moves. Raises InputError if there are none."""
    moved = [p for p in parts if _is_moved(model, p, plays)]
    if not moved:
        raise InputError(
            "No recorded command moves an axis whose position is measured, so no effect can be seen. "
            "Play a sequence that moves every axis, config/sequences/excite_12s.yaml for one."
        )
    return moved


def _is_moved(model: Model, part: AxisPart, plays: Sequence[Play]) -> bool:
    channels = [axis.command for axis in model.rig.axes if axis.name in part.axes]
    commands = [_commands(p, channel) for p in plays for channel in channels]
    spans = [np.ptp(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in commands]
    return max(spans) > MOVES


def _commands(play: Play, channel: str) -> Array:
    return np.asarray(play.trials.commands[:, :, play.trials.command_channels.index(channel)])


def joined(model: Model, parts: Sequence[AxisPart], only: Sequence[str] | None = None) -> list[AxisPart]:
    """The parts, with coupled axes as one part: coupled by inertia, or by an effect of the model or of those asked for.

    More than a few axes that inertia alone couples stay parts of their own; each is judged while the others move as
    they were measured.
    """
    asked = {name.split(".")[0] for name in only or ()}
    couples = any(use.effect.couples for use in model.effects)
    whole = couples or any(e.couples for name, e in model.registry.effects.items() if name in asked)
    groups = [tuple(a.name for a in model.rig.axes)] if couples else coupled_axes(model)
    groups = [own for g in groups for own in ([(n,) for n in g] if len(g) > MOST_TOGETHER and not whole else [g])]
    merged = []
    for group in groups:
        own = [p for p in parts if set(p.axes) & set(group)]
        free = [n for p in own for n in p.base[: len(p.base) - p.rough]]
        rough = [n for p in own for n in p.base[len(p.base) - p.rough :]]
        if own:
            signals = tuple(n for p in own for n in p.signals)
            merged.append(AxisPart(tuple(n for p in own for n in p.axes), signals, (*free, *rough), len(rough)))
    return merged


def ball_part() -> AxisPart:
    """The ball, judged like an axis; without base values, because refitted friction would absorb a latency."""
    return AxisPart((BALL,), BALL_SIGNALS, ())


def _silent_integral(model: Model, name: str) -> bool:
    """Whether a drive's law has no integral part. It stays without one, which would stand in for any steady torque."""
    return name.startswith("drive.") and name.endswith(".i") and model.values()[name] == 0.0


def axis_search(model: Model, plays: Sequence[Play], part: AxisPart, run: SearchOptions) -> Search:
    """A search over the candidates of one part."""
    ball = part.axes == (BALL,)
    whole = library(model, part.base, ball, run.only)
    own = tuple(c for c in whole.candidates if c.axes and set(c.axes) <= set(part.axes))
    if prescribed(model):  # how the other joints are driven is not in it
        own = tuple(c for c in own if not c.effect.couples)
    own = tuple(c for c in (_as_read(c, plays) for c in own) if c.possible)
    own = _once(own, part.axes, run.only or ())
    if ball:
        own = tuple(replace(c, axes=()) for c in whole.candidates if on_ball(c.effect))
    for candidate in whole.candidates:
        if candidate.name not in [c.name for c in own]:
            whole = replace(whole, model=whole.model.without_effect(candidate.effect.name, candidate.place))
    return search_of(Library(whole.model, part.base, own, part.rough), plays, part, run)


def _as_read(candidate: Candidate, plays: Sequence[Play]) -> Candidate:
    """A sensor's ticks no coarser than its readings, which are whole ticks, have them; other effects as they are."""
    if candidate.effect.where != "signal" or not is_tick(candidate):
        return candidate
    read = [t.signals[candidate.place].values for p in plays for t in p.stamped if candidate.place in t.signals]
    return replace(candidate, coarsest=largest_tick(read))


def _once(candidates: Sequence[Candidate], axes: tuple[str, ...], asked: Sequence[str]) -> tuple[Candidate, ...]:
    """The candidates, of each effect that acts on all axes wherever it is stated only the first, and those asked for by
    name and place.
    """
    first = {c.effect.name: c for c in reversed(candidates)}
    return tuple(
        replace(c, axes=axes) if c.effect.everywhere else c
        for c in candidates
        if not c.effect.everywhere or c is first[c.effect.name] or c.name in asked
    )


def search_of(lib: Library, plays: Sequence[Play], part: AxisPart, run: SearchOptions) -> Search:
    """A search over a library's candidates."""
    seen = [play_evidence(lib.model, play, part.signals) for play in plays]
    # The drive's own ticks make the misfit rough wherever stiction lets it rest at any place within one.
    smooth = lib.model.with_values({n: 0.0 for n in lib.model.values() if n.endswith(".feedback_tick")}, "smoothed")
    ball, ticks = part.axes == (BALL,), smooth.values() != lib.model.values()
    rolled = partial(Evidence, free=lib.names, plays=seen, signals=part.signals, nthread=run.nthread, spread=run.spread)
    levels: dict[Level, Evidence] = {"coarse": rolled(smooth, step=STEPS["coarse"])}
    # Motions with contacts or ticks cannot be extrapolated.
    levels["fine"] = rolled(smooth, step=STEPS["fine" if ball else "coarse"], extrapolate=not ball)
    levels["exact"] = rolled(lib.model, step=STEPS["exact"]) if ball or ticks else levels["fine"]
    if not ball:
        own = float(compiled(lib.model, with_ball=False).mj.opt.timestep)
        levels["own"] = rolled(lib.model, step=own, as_run=True)
    evidence = levels["coarse"]
    torques = {m.signal: axis for axis in lib.model.rig.axes for m in axis.measured if m.quantity == "torque"}
    scale, used = evidence.floor.copy(), evidence.time >= BEGUN
    for number, play in enumerate(seen):
        for column, axis in [(i, torques[name]) for i, name in enumerate(part.signals) if name in torques]:
            full = lib.model.values().get(f"drive.{axis.name}.torque", 0.0)
            calm = _steady(play, axis.command)
            here = evidence.blocks == number * len(part.signals) + column
            still = calm[np.minimum((evidence.time[here] / play.width).astype(int), len(calm) - 1)]
            used[here] &= still
            values = evidence.mean[here]
            size = float(np.sqrt(np.mean(values[still] ** 2))) if still.any() else 0.0
            least = max(EFFORT_STEP * float(np.abs(values).max(initial=0.0)), LOAD_STEP * full)
            scale[here] = np.sqrt(scale[here] ** 2 + least**2 + (EFFORT_SHARE * size) ** 2)
    if ball:
        scale = np.hypot(scale, inexactness(evidence.time))
    count = partial(run.progress, part.title) if run.progress else None
    difference = BALL_DIFFERENCE if ball else DIFFERENCE
    search = Search(lib, levels, scale, np.flatnonzero(used), count, difference, run.exhaustive)
    search.see_ticks(search.start)
    return search


def _steady(play: PlayEvidence, channel: str) -> NDArray[np.bool_]:
    """For each bin of a play whether the command has not changed its speed suddenly for a while.

    Where it has, a drive's effort is a short peak, sampled once per controller cycle, and not comparable.
    """
    return is_steady(setpoints(play.trials, channel, play.width, int(play.seconds / play.width) + 1), play.width)


def is_steady(command: Array, step: float) -> NDArray[np.bool_]:
    """(T,) whether a command (T,) rad, NaN where the drive is off, has not changed its speed suddenly for a while."""
    held = np.where(np.isfinite(command), command, 0.0)
    speed = np.gradient(held, step) if len(held) > 1 else np.zeros_like(held)
    turn = np.abs(np.diff(speed, append=speed[-1:]))
    sudden = turn > SPEED_CHANGE * max(float(np.ptp(held)), 1e-9)
    recent = max(1, round(SETTLED / step))
    return np.asarray(np.convolve(sudden, np.ones(recent))[: len(sudden)] < 0.5) & np.isfinite(command)


class Stopped(Exception):
    """The search is no longer wanted."""


def side_by_side(
    search: Callable[[Item, SearchOptions], Answer], items: Sequence[Item], run: SearchOptions
) -> list[Answer]:
    """The result of a search for each item, in their order; it does not depend on how many run at once.

    The roll-outs of one axis alone are too few to keep all CPUs busy. An error, or Ctrl-C, in one ends the others at
    their next roll-outs.
    """
    if len(items) < 2 or (run.nthread or os.cpu_count() or 1) < 2:
        return [search(item, run) for item in items]
    stop = Event()

    def progress(what: str, count: int, leading: Sequence[str] = (), /) -> None:
        if stop.is_set():
            raise Stopped
        if run.progress:
            run.progress(what, count, leading)

    watched = replace(run, progress=progress)

    def one(item: Item) -> Answer:
        try:
            return search(item, watched)
        except BaseException:
            stop.set()
            raise

    with ThreadPoolExecutor(len(items)) as pool:
        futures = [pool.submit(one, item) for item in items]
        try:
            wait(futures)
        except BaseException:  # Ctrl-C comes here
            stop.set()
            raise
    errors = [error for future in futures if (error := future.exception())]
    if errors:
        raise min(errors, key=lambda error: isinstance(error, Stopped))
    return [future.result() for future in futures]
