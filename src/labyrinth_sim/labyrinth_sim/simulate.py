# SPDX-License-Identifier: Apache-2.0
"""Roll-outs: parameter sets times commands, all at once."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labyrinth_sim.build import Placed, Plan, compiled, local_values
from labyrinth_sim.drive_limit import BEGINNING, END
from labyrinth_sim.effect import Filter, Values
from labyrinth_sim.efforts import between, efforts_between, means_of, missed
from labyrinth_sim.engine import Engine
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.filters import Chain, Map
from labyrinth_sim.first_state import first_state
from labyrinth_sim.model import Model
from labyrinth_sim.quantities import EFFORT, PLAIN
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array, Trials

CHUNK = 4096  # simulations stepped together, and
BATCH_BYTES = 2e8  # bytes of what is recorded of them; bound the memory of a large batch


@dataclass(frozen=True)
class BatchResult:
    """n parameter sets times c commands.

    Attributes:
        signals, units: m names and units.
        values: (n, c, T, m); NaN from the first sample on where a simulation failed.
        failed: (n, c) bool.
        messages: why, by (parameter set, command).
        steps: MuJoCo steps taken in all.
        efforts: signal -> (n, c, T * parts), what drives give from the start of each part of a sample on, if that has
            several.
    """

    signals: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    failed: NDArray[np.bool_]
    messages: Mapping[tuple[int, int], str]
    steps: int
    efforts: Mapping[str, Array]


def simulate(
    model: Model,
    time: Trials | ArrayLike,
    commands: ArrayLike | None = None,
    initial: Mapping[str, float] | None = None,
    *,
    with_ball: bool | None = None,
    timestep: float | None = None,
) -> Trials:
    """One roll-out of a model.

    Args:
        time: (T,) s in even steps; or measured `Trials`, whose first trial gives time, commands and first state.
        commands: (T, u) rad, held from each sample to the next; NaN where the drive is off.
        initial: signal -> value at the first sample; what is not given is 0.
        with_ball: simulate the ball too; None does so where `initial` says where it is.
        timestep: s, MuJoCo's; None for the MJCF's.

    Returns:
        Trials with one trial, all signals of the rig (the ball's with a ball).

    Raises:
        InputError: shapes, names, or a simulation that diverged.
    """
    if isinstance(time, Trials):
        trials = time
        known = [s for s in trials.signals if s in model.rig.signals]
        start = {s: float(trials.values[0, 0, trials.index(s)]) for s in known}
        initial = {**{s: v for s, v in start.items() if not np.isnan(v)}, **(initial or {})}
        time, commands = trials.time, commands if commands is not None else _commands_of(model, trials)
    if commands is None:
        raise InputError("simulate needs commands of shape (T, u), or Trials that carry them.")
    block = np.asarray(commands, float)
    first = {name: np.array([value]) for name, value in (initial or {}).items()}
    result = simulate_batch(
        model, (), np.empty((1, 0)), time, block[None], first, with_ball=with_ball, timestep=timestep, nthread=1
    )
    if result.failed.any():
        raise InputError(f"The simulation of '{model.name}' {result.messages[0, 0]}. Try a smaller timestep or gains.")
    return Trials(
        time=np.asarray(time, float),
        signals=result.signals,
        units=result.units,
        values=result.values[0],
        command_channels=model.rig.command_channels,
        commands=block[None],
    )


def _commands_of(model: Model, trials: Trials) -> Array:
    missing = [c for c in model.rig.command_channels if c not in trials.command_channels]
    if missing:
        raise InputError([unknown_name("command channel", name, trials.command_channels) for name in missing])
    columns = [trials.command_channels.index(c) for c in model.rig.command_channels]
    return np.asarray(trials.commands[0][:, columns])


def simulate_batch(
    model: Model,
    names: Sequence[str],
    values: ArrayLike,
    time: ArrayLike,
    commands: ArrayLike,
    initial: Mapping[str, ArrayLike] | None = None,
    *,
    per_command: Mapping[str, ArrayLike] | None = None,
    resting: ArrayLike | None = None,
    signals: Sequence[str] | None = None,
    with_ball: bool | None = None,
    timestep: float | None = None,
    nthread: int = 0,
    progress: Callable[[int], None] | None = None,
    extrapolate: bool = False,
    parts: int | None = None,
    as_run: bool = False,
) -> BatchResult:
    """Rolls out n parameter sets times c commands; the same answer bit for bit at any `nthread`.

    Args:
        model: gives the values of all parameters that are not in `names`.
        names: k full parameter names.
        values: (n, k), in the declared units and bounds.
        time: (T,) s in even steps.
        commands: (c, T, u) rad, held from each sample to the next, or (c, T * parts, u); NaN where the drive is off.
        initial: signal -> (c,) at the first sample, NaN where unknown.
        per_command: full parameter name -> (c,), for what is known to differ between commands, as a gain set by hand.
        resting: (c, u) bool, axes that rest under their first command as it begins, and so carry their load; the others
            go to it from where they stand. None where no axis does.
        signals: to return, in this order; all of the rig if None.
        with_ball: None simulates the ball where `initial` says where it is.
        timestep: s, MuJoCo's own step; rounded so that samples are whole numbers of steps.
        nthread: 0 for one per CPU.
        progress: called with the number of finished simulations.
        extrapolate: also step half as far, and extrapolate the motion to steps of no length (Richardson 1911): what
            MuJoCo's steps get wrong is of first order.
        parts: of each sample, over which the commands are means; they may change within it. One, or even. If more than
            one, steps half as far take their own, and efforts are computed for each part, but not with a ball.
        as_run: with parts: drives are limited by what they ask for as a step begins, as where a model runs step by
            step, and not by what they ask for as it ends.

    Raises:
        InputError: everything that is wrong with the arguments.
    """
    grid, block = np.asarray(time, float), np.asarray(commands, float)
    table = np.atleast_2d(np.asarray(values, float))
    ball = with_ball if with_ball is not None else bool(initial) and any(s in (initial or {}) for s in BALL_SIGNALS)
    pieces = parts or 1
    _check(model, names, table, grid, block, initial, per_command, resting, ball, timestep, pieces)
    n, c = len(table), len(block)
    step = float((grid[-1] - grid[0]) / (len(grid) - 1))
    even = even_timestep(step, timestep, model, ball)
    plans = [compiled(model, ball, even / half) for half in ((1, 2) if extrapolate else (1,))]
    plan = plans[0]
    shorter = 2 if pieces > 1 else 1
    apart = [(step, pieces), (step / shorter, pieces // shorter)][: len(plans)]
    every = tuple(m.signal for m in model.rig.measured) + (BALL_SIGNALS if ball else ())
    unseen = [unknown_name("simulated signal", name, every) for name in signals or () if name not in every]
    if unseen:
        raise InputError(unseen)
    columns = [every.index(name) for name in (every if signals is None else signals)]
    asked = {} if ball or pieces == 1 else model.rig.efforts
    efforts = {every.index(name): drive for name, drive in asked.items() if every.index(name) in columns}
    torques = [i for i, m in enumerate(model.rig.measured) if m.quantity == "torque"]
    smooth = np.setdiff1d(np.arange(len(every)), torques)
    out = np.empty((n * c, len(grid), len(columns)))
    within = np.empty((n * c, len(grid) * pieces, len(efforts)))
    messages: dict[tuple[int, int], str] = {}
    steps = done = 0
    sets, plays = np.divmod(np.arange(n * c), c)
    every_number = numbers_of(model, n * c)
    every_number |= {name: table[sets, column] for column, name in enumerate(names)}
    every_number |= {name: np.asarray(given, float)[plays] for name, given in (per_command or {}).items()}
    holds = np.zeros((c, block.shape[2]), dtype=bool) if resting is None else np.asarray(resting, dtype=bool)
    chunk = int(np.clip(BATCH_BYTES / (8 * len(grid) * (len(every) + pieces * block.shape[2])), 1, CHUNK))
    for which in _groups(plan, every_number, n * c, chunk):
        numbers = {name: given[which] for name, given in every_number.items()}
        first = {name: np.broadcast_to(np.asarray(v, float), (c,))[plays[which]] for name, v in (initial or {}).items()}
        acting = tuple(plan.acting(numbers))  # at the same places whatever the step
        here = [replace(each, effects=acting) for each in plans]
        first = undone(here[0], numbers, first)
        alone, shared = _moving_differently(plan, numbers, first, plays[which])
        own = {name: given[alone] for name, given in numbers.items()}
        owner = plays[which[alone]]
        start = {name: given[alone] for name, given in first.items()}
        qpos, qvel = first_state(model, plan.mj, ball, len(alone), start)
        before = rest_targets(plan, qpos, block[owner, 0], holds[owner])
        filters, reached = command_filters(here[0], own, step / pieces, before, holds[owner])
        targets = through(filters, block[owner])
        engines, told, rolled = [], [], []
        for each, (every_step, of_each) in zip(here, apart, strict=True):
            limits = None if parts is None else BEGINNING if as_run else END
            engine = Engine(model, each, own, len(alone), every_step, nthread, bool(efforts), limits)
            engine.start(qpos, qvel, reached)
            told.append(means_of(targets, of_each))
            rolled.append(engine.roll(told[-1]))
            steps += len(alone) * round(engine.substeps * step / engine.step) * (len(grid) - 1)
            engines.append(engine)
        raw = rolled[-1][:, :: round(step / apart[-1][0]), : len(every)].copy()
        if extrapolate:
            raw[..., smooth] += (raw - rolled[0][..., : len(every)])[..., smooth]
        raw = raw[shared]
        seen = through(measure_filters(model, here[0], numbers, step, raw[:, 0]), raw)
        out[which] = seen[:, :, columns]
        if efforts:
            moved = rolled[-1][..., len(every) :]
            motion = moved + missed(moved, rolled[0][..., len(every) :]) if extrapolate else moved
            sensors = measure_filters(model, here[0], numbers, step / pieces, raw[:, 0])
            around = between(raw, pieces) if any(sensors[column] for column in efforts) else raw
            for number, (column, drive) in enumerate(efforts.items()):
                own_columns = slice(2 * drive, 2 * drive + 2)
                effort = efforts_between(
                    engines[-1], drive, rolled[-1][..., column], moved[..., own_columns], motion[..., own_columns],
                    told[-1][..., drive], targets[..., drive], reached[:, drive],
                )  # fmt: skip
                within[which, :, number] = Chain(*sensors[column])(effort[shared], around)
        for engine in engines:
            gone = which[engine.failed[shared]]
            out[gone] = within[gone] = np.nan
            texts = [(i, engine.messages[int(k)]) for i, k in zip(which, shared, strict=True) if engine.failed[k]]
            messages |= {(int(sets[i]), int(plays[i])): text for i, text in texts}
        done += len(which)
        if progress:
            progress(done)
    failed = np.zeros((n, c), dtype=bool)
    for where in messages:
        failed[where] = True
    answers: Array = out.reshape(n, c, len(grid), len(columns))
    answers.setflags(write=False)
    chosen, units = tuple(every[i] for i in columns), tuple(model.rig.units[i] for i in columns)
    named = {every[column]: within[:, :, number].reshape(n, c, -1) for number, column in enumerate(efforts)}
    return BatchResult(chosen, units, answers, failed, messages, steps, named)


def _groups(plan: Plan, numbers: Mapping[str, Array], nsim: int, chunk: int) -> Iterator[NDArray[np.int64]]:
    """Simulations to step together, by number: those that MuJoCo can do alone, and those with work at every step."""
    stepping = [p.steps(numbers) for p in plan.effects]
    busy = np.any(stepping, axis=0) if stepping else np.zeros(nsim, dtype=bool)
    for group in (np.flatnonzero(~busy), np.flatnonzero(busy)):
        for low in range(0, len(group), chunk):
            yield group[low : low + chunk]


def _moving_differently(
    plan: Plan, numbers: Mapping[str, Array], first: Mapping[str, Array], plays: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Simulations that must be stepped, and for each one which of them moves as it does.

    Effects that only change what is measured leave the motion alone.
    """
    seen_only = (f"{EFFORT}.", *(p.prefix for p in plan.effects if p.effect.only_measures))
    parts = [given for name, given in numbers.items() if not name.startswith(seen_only)]
    table = np.column_stack([plays, *first.values(), *(given for given in parts if np.ptp(given) > 0.0)])
    _, alone, shared = np.unique(table, axis=0, return_index=True, return_inverse=True, equal_nan=True)
    return alone, np.ravel(shared)


def rest_targets(plan: Plan, qpos: Array, first: Array, resting: NDArray[np.bool_] | bool = False) -> Array:
    """(nsim, u) targets before the first sample: the first command where the axis rests under it, else where the axis
    stands; NaN where the drive starts switched off.
    """
    angles = np.stack([qpos[:, site.qpos] for _, _, site in plan.drives], axis=1)
    return np.where(np.isnan(first), np.nan, np.where(resting, first, angles))


def numbers_of(model: Model, nsim: int) -> dict[str, Array]:
    """Full parameter name -> (nsim,): all of the model's values but plain MJCF quantities that it leaves alone."""
    return {
        name: np.full(nsim, value)
        for name, value in model.values().items()
        if name.split(".")[0] not in PLAIN or name in model.quantities
    }


def even_timestep(step: float, timestep: float | None, model: Model, ball: bool) -> float:
    """MuJoCo's step, such that a sample is a whole number of steps."""
    own = timestep if timestep is not None else float(compiled(model, ball).mj.opt.timestep)
    return step / max(1, int(np.ceil(step / own - 1e-6)))


def _check(
    model: Model,
    names: Sequence[str],
    table: Array,
    grid: Array,
    block: Array,
    initial: Mapping[str, ArrayLike] | None,
    per_command: Mapping[str, ArrayLike] | None,
    resting: ArrayLike | None,
    ball: bool,
    timestep: float | None,
    pieces: int,
) -> None:
    known = model.parameters()
    complaints = [unknown_name("parameter", n, known) for n in (*names, *(per_command or {})) if n not in known]
    if len(set(names)) != len(names):
        complaints.append(f"Parameter names must differ from one another, got {list(names)}.")
    if table.ndim != 2 or table.shape[1] != len(names):
        complaints.append(f"values must have shape (n, {len(names)}), got {table.shape}.")
    elif not complaints:
        tried = {name: table[:, column] for column, name in enumerate(names)}
        tried |= {name: np.asarray(given, float) for name, given in (per_command or {}).items()}
        for name, numbers in tried.items():
            info = known[name]
            bad = numbers[~((numbers >= info.low) & (numbers <= info.high))]
            if bad.size:
                complaints.append(f"{name} must lie within [{info.low:g}, {info.high:g}] {info.unit}, got {bad[0]:g}.")
    if resting is not None and np.shape(resting) != (block.shape[0], block.shape[-1]):
        complaints.append(f"resting must have shape ({block.shape[0]}, {block.shape[-1]}), got {np.shape(resting)}.")
    for name, given in (per_command or {}).items():
        if np.shape(given) != block.shape[:1]:
            complaints.append(f"per_command['{name}'] must have shape ({len(block)},), got {np.shape(given)}.")
    complaints += [f"{n} is in both names and per_command; give it once." for n in names if n in (per_command or {})]
    u = len(model.rig.axes)
    if grid.ndim != 1 or len(grid) < 2 or not np.allclose(np.diff(grid), np.diff(grid).mean(), rtol=1e-6, atol=1e-9):
        complaints.append(f"time must be (T,) with T >= 2 even steps, got shape {grid.shape}. Resample first.")
    elif block.ndim != 3 or block.shape[1:] != (len(grid) * pieces, u):
        complaints.append(
            f"commands must have shape (c, {len(grid) * pieces}, {u}) for {', '.join(model.rig.command_channels)}, "
            f"got {block.shape}."
        )
    if pieces < 1 or (pieces > 1 and pieces % 2):
        complaints.append(f"parts must be 1 or even, got {pieces}.")
    if np.isinf(block).any():
        complaints.append("commands must be finite, or NaN where the drive is off.")
    valid = model.rig.signals
    complaints += [unknown_name("signal", name, valid) for name in (initial or {}) if name not in valid]
    if ball and not model.rig.ball:
        complaints.append(f"Rig '{model.rig.name}' has no ball.")
    if timestep is not None and not 1e-5 <= timestep <= 0.1:
        complaints.append(f"timestep must lie within [1e-05, 0.1] s, got {timestep:g}.")
    if complaints:
        raise InputError(complaints)


def command_filters(
    plan: Plan, values: Values, step: float, start: Array, resting: NDArray[np.bool_] | bool = False
) -> tuple[list[list[Filter]], Array]:
    """The filters of each command channel in order, the drive's own last, and (nsim, u) rad what they gave until now.

    Args:
        start: (nsim, u) rad, the targets until now; where the axis rests under them, what comes of them has passed
            through the filters long ago. Elsewhere they are what the drive was told in the end.
    """
    chains: list[list[Filter]] = []
    acting, reached, held = plan.acting(values), start.copy(), np.broadcast_to(resting, start.shape)
    for i, (drive, prefix, site) in enumerate(plan.drives):
        made = [
            partial(placed.effect.command, local_values(values, placed.prefix), placed.site, step)
            for placed in acting
            if placed.effect.command and placed.site.channel == i
        ]
        if drive.target:
            made.append(partial(drive.target, local_values(values, prefix), site, step))
        chain: list[Filter] = []
        for make in made:
            own = make(reached[:, i])
            if own is None:
                continue
            chain.append(own)
            if held[:, i].any():  # what follows begins with what this one gives at rest
                given = deepcopy(own)(reached[:, i, None], start[:, None])[:, 0]
                reached[:, i] = np.where(held[:, i], given, reached[:, i])
        chains.append(chain)
    return chains, reached


def measure_filters(model: Model, plan: Plan, values: Values, step: float, first: Array) -> list[list[Filter]]:
    """The filters of each signal in order; `first` is (nsim, m), the first sample."""
    names = [m.signal for m in model.rig.measured] + (list(BALL_SIGNALS) if plan.with_ball else [])
    chains: list[list[Filter]] = []
    acting = plan.acting(values)
    # An effort whose unit is open is read in that unit, as it was recorded.
    scales = {n.split(".")[1]: numbers for n, numbers in values.items() if n.startswith(f"{EFFORT}.")}
    for column, signal in enumerate(names):
        made = [
            placed.effect.measure(local_values(values, placed.prefix), site, step, first[:, column])
            for placed in acting
            if placed.effect.measure and (site := _sees(placed, signal)) is not None
        ]
        made.insert(0, _over(scales[signal]) if signal in scales else None)
        chains.append([f for f in made if f is not None])
    return chains


def _over(scale: Array) -> Map:
    return Map(lambda torque: torque / scale[:, None])


def _sees(placed: Placed, signal: str) -> Site | None:
    site, effect = placed.site, placed.effect
    if effect.where == "signal":
        return site if site.signal == signal else None
    if effect.where == "ball":
        return replace(site, signal=signal) if signal in BALL_SIGNALS else None
    own = site.axis is not None and any(m.signal == signal for m in site.axis.measured)
    return replace(site, signal=signal) if own else None


def through(chains: list[list[Filter]], block: Array) -> Array:
    """(nsim, K, channels) through each channel's filters."""
    if not any(chains):
        return block
    out = np.array(block)
    for i, chain in enumerate(chains):
        out[:, :, i] = Chain(*chain)(out[:, :, i], block)
    return out


def undone(plan: Plan, values: Values, given: Mapping[str, Array]) -> dict[str, Array]:
    """Signal -> (nsim,): what was there, from what was seen, by the effects that can invert it."""
    found = dict(given)
    for placed in reversed(plan.acting(values)):
        for signal, seen in found.items():
            if placed.effect.undo and (site := _sees(placed, signal)) is not None:
                found[signal] = placed.effect.undo(local_values(values, placed.prefix), site, seen)
    return found
