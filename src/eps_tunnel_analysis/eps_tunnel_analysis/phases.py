# SPDX-License-Identifier: Apache-2.0
"""Where a model fails: what the command requested at each sample, and how the misfit is distributed over that."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.error import repeat_spread
from eps_tunnel_analysis.outputs import shown_number, shown_times, shown_unit, shown_value
from eps_tunnel_analysis.tunnel import build_tunnel
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.trials import Array, Trials

SETTLE = 0.5  # s after the command stopped during which the rig is still taken to be on its way
REVERSAL = 0.25  # s after the command turned round
STEP_SHARE = 0.25  # share of a motion; a start further than this from the first target was a step to it
SAME_POSE = 0.01  # share of the command's range within which two poses count as the same

MEANING = {
    "moving": f"the command moves, or moved less than {SETTLE:g} s ago",
    "reversal": f"the first {REVERSAL:g} s after the command reversed without a pause",
    "hold": "the command stands still away from where it started",
    "rest": "the command stands still where it started",
    "no command": "none was sent yet, or the drive was off",
}

MOVING = ("moving", "reversal")
LENGTHS = ("m", "m/s")
CROSSWISE = dict(zip(BALL_SIGNALS, BALL_SIGNALS[::-1], strict=True))
EXCESS = 0.05  # error share beyond the time share from which a phase is reported
NO_RANGE = 1e-9  # SI units; a signal with a smaller range stands still, and its error is taken as it is
NOWHERE = "Nowhere beyond what the rig itself repeats."
MOST_AMPLITUDES = 6  # more than these are put into as many equal classes


@dataclass(frozen=True)
class Phases:
    """What one command channel does at each of T samples.

    Attributes:
        phase: (T,) names, keys of MEANING.
        direction: (T,) sign of the latest motion: "up", "down" or "none" before the first.
        amplitude: (T,) size of the latest motion from turn to turn; 0 before the first.
    """

    phase: NDArray[np.str_]
    direction: NDArray[np.str_]
    amplitude: Array


@dataclass(frozen=True)
class _Motion:
    """One motion of the command: from sample `first` to sample `last`, by `change` rad."""

    first: int
    last: int
    change: float


def mean_command(trials: Trials) -> Array:
    """The command that the trials share, (T, u) rad: their median, so that jitter does not blunt a step."""
    seen = np.isfinite(trials.commands).any(axis=0)
    filled = np.where(seen, trials.commands, 0.0)
    return np.where(seen, np.nanmedian(filled, axis=0), np.nan)


def channel_of(signal: str, channels: Sequence[str]) -> str | None:
    """The command channel that moves a signal, by name: the same, its beginning, its last word, or the only one.

    A board that turns about one axis rolls the ball along the other.
    """
    signal = CROSSWISE.get(signal, signal)
    for channel in sorted(channels, key=len, reverse=True):
        if signal == channel or signal.startswith(f"{channel}_"):
            return channel
    by_axis = [c for c in channels if f"_{c.rsplit('_', 1)[-1]}_" in f"_{signal}_"]
    if len(by_axis) == 1:
        return by_axis[0]
    return channels[0] if len(channels) == 1 else None


def phases(time: Array, command: Array, before: float = np.nan) -> Phases:
    """The phases of one command channel (T,), which may be NaN where there was none.

    `before` is the target in rad that was held until time zero; where it is NaN, the first one was.
    """
    t = len(time)
    step = (time[-1] - time[0]) / (t - 1) if t > 1 else 1.0
    sent = np.isfinite(command)
    # One sample more than there are: the first stands for the time before zero.
    phase = np.full(t + 1, "no command", dtype=object)
    direction = np.full(t + 1, "none", dtype=object)
    amplitude = np.zeros(t + 1)
    if sent.any():
        held = command[np.maximum.accumulate(np.where(sent, np.arange(t), np.argmax(sent)))]
        held = np.concatenate([[before if np.isfinite(before) else held[0]], held])
        same = SAME_POSE * float(np.ptp(held))
        phase[:] = np.where(np.abs(held - held[0]) <= same, "rest", "hold")
        settle, turn = round(SETTLE / step), round(REVERSAL / step)
        last: _Motion | None = None
        for motion in _motions(held, settle, same):
            phase[motion.first : motion.last + settle + 1] = "moving"
            if last and motion.change * last.change < 0 and motion.first - last.last <= settle:
                phase[motion.first : motion.first + turn] = "reversal"
            direction[motion.first :] = "up" if motion.change > 0 else "down"
            amplitude[motion.first :] = abs(motion.change)
            last = motion
        phase[1:][~sent] = "no command"
    return Phases(phase[1:].astype(str), direction[1:].astype(str), amplitude[1:])


def target_before(time: Array, command: Array, measured: Array) -> float:
    """The target in rad until time zero, of a command (T,) that begins with a step; NaN where it does not.

    Trials begin with their first command, so that only the joint (T,) shows where it came from: it starts elsewhere,
    and goes to the target.
    """
    if not (len(time) and np.isfinite(command[0]) and np.isfinite(measured[0])):
        return np.nan
    jump = float(command[0] - measured[0])
    size = float(np.nanmax(np.abs(np.append(command, measured[0]) - command[0])))
    went = float(np.nanmax((measured[time <= time[0] + SETTLE] - measured[0]) * np.sign(jump)))
    if abs(jump) <= STEP_SHARE * size or went <= STEP_SHARE * abs(jump):
        return np.nan
    # A servo rests a little off its target; where the command returns to that later, its value is known.
    nearest = float(command[np.nanargmin(np.abs(command - measured[0]))])
    return nearest if abs(nearest - measured[0]) < STEP_SHARE * size else float(measured[0])


def _motions(command: Array, pause: int, smallest: float) -> list[_Motion]:
    """Motions of a command (T,) without NaN: split where it turns round or rests longer than `pause` samples."""
    moving = np.flatnonzero(np.diff(command)) + 1  # samples whose command differs from the one before
    if not len(moving):
        return []
    signs = np.sign(command[moving] - command[moving - 1])
    cuts = np.flatnonzero((np.diff(moving) > pause) | (np.diff(signs) != 0)) + 1
    motions = []
    for group in np.split(moving, cuts):
        first, last = int(group[0]), int(group[-1])
        change = float(command[last] - command[first - 1])
        if abs(change) > smallest:  # less is jitter between the trials
            motions.append(_Motion(first, last, change))
    return motions


@dataclass(frozen=True)
class Misfit:
    """The error of one signal within one group of samples; simulation minus real.

    Attributes:
        signal, unit: what it is.
        kind: how the samples were grouped: "phase", "direction", "phase and direction", "amplitude", "other axes",
            "axis", "trial".
        group: which group.
        time_share: share of the signal's seen samples in this group.
        error_share: share of the signal's summed squared error in this group; for kind "axis" the share among all
            signals, each in units of its repeat spread, or of its range where a spread is unknown.
        rms: in the signal's unit.
        mean: in the signal's unit; above 0 the simulation is too high.
        repeat_rms: the signal's repeat spread, RMS of the trials about their mean; NaN with one trial.
    """

    signal: str
    unit: str
    kind: str
    group: str
    time_share: float
    error_share: float
    rms: float
    mean: float
    repeat_rms: float = math.nan

    @property
    def times(self) -> float:
        """RMS in units of the repeat spread; NaN where that is unknown or zero. Up to 1 the rig does the same."""
        return self.rms / self.repeat_rms if self.repeat_rms > 0 else math.nan

    @property
    def excess(self) -> float:
        """Error share beyond the time share: 0 where the error is spread evenly over time."""
        return self.error_share - self.time_share


def where(real: Trials, sim: Trials) -> tuple[Misfit, ...]:
    """The misfit of every signal in every group, each kind of each signal worst first.

    Signals are weighed against each other in units of their repeat spread. Phases, direction and amplitude are those of
    the command channel that moves the signal. Both sides need the same signals and time.
    """
    measured, simulated = build_tunnel(real).mean, build_tunnel(sim).mean
    spread = [repeat_spread(real.values[:, :, i]) for i in range(len(real.signals))]
    command = mean_command(real)
    labels = {}
    for u, name in enumerate(real.command_channels):
        known = name in real.signals
        before = target_before(real.time, command[:, u], measured[:, real.index(name)]) if known else np.nan
        labels[name] = phases(real.time, command[:, u], before)
    rows: list[Misfit] = []
    for i, signal in enumerate(real.signals):
        error = simulated[:, i] - measured[:, i]
        channel = channel_of(signal, real.command_channels)
        groups: list[tuple[str, NDArray[np.str_]]] = []
        if channel is not None:
            slides = real.units[i] in LENGTHS and signal not in BALL_SIGNALS
            groups = list(_groupings(labels[channel], "m" if slides else "rad"))
            groups += [("other axes", _others(labels, channel))] if len(labels) > 1 else []
        for kind, names in groups:
            rows += _worst_first(_misfits(signal, real.units[i], kind, names, error))
        rows += _worst_first(_trial_misfits(real, i, simulated[:, i]))
    rows = _worst_first(_axis_misfits(real, simulated - measured, measured, spread)) + rows
    of = dict(zip(real.signals, spread, strict=True))
    return tuple(replace(m, repeat_rms=of[m.signal]) for m in rows)


def sentences(misfits: Iterable[Misfit], most: int = 3) -> tuple[str, ...]:
    """Where the model fails in words, worst first; NOWHERE if it is off by no more than the rig itself.

    Named are phases with far more of a signal's error than of its time, and signals whose error is spread evenly. They
    are ranked across signals by their RMS in units of the signal's repeat spread. Where a spread is unknown, the signal
    counts in relation to its range, and its phases by how uneven they are.
    """
    rows = list(misfits)
    axes = [m for m in rows if m.kind == "axis" and m.rms > 0]
    known = all(m.repeat_rms > 0 for m in axes)
    named: list[tuple[float, str]] = []
    for axis in axes:
        phases = [m for m in rows if (m.kind, m.signal) == ("phase and direction", axis.signal) and m.excess > EXCESS]
        named += [(m.times if known else axis.error_share * m.excess, _sentence(m)) for m in phases]
        if not phases:
            named.append((axis.times if known else axis.error_share * EXCESS, _even(axis)))
    beyond = [pair for pair in named if pair[0] > 1] if known else named
    if named and not beyond:
        return (NOWHERE,)
    return tuple(text for _, text in sorted(beyond, key=lambda pair: -pair[0])[:most])


def _sentence(m: Misfit) -> str:
    return (
        f"{m.signal}, {m.group}: {m.error_share:.0%} of its squared error in {m.time_share:.0%} of the time; {_off(m)}."
    )


def _even(m: Misfit) -> str:
    return f"{m.signal}: the error is spread evenly over the phases of the command; {_off(m)}."


def _off(m: Misfit) -> str:
    side = "above" if m.mean > 0 else "below"
    spread = "" if math.isnan(m.times) else f", {shown_times(m.times)} times the rig's repeat spread"
    return (
        f"the simulation is {shown_value(abs(m.mean), m.unit)} {side} the real mean on average "
        f"(RMS {shown_value(m.rms, m.unit)}{spread})"
    )


def _groupings(label: Phases, unit: str) -> Iterator[tuple[str, NDArray[np.str_]]]:
    way = np.where(np.isin(label.phase, MOVING), ", ", ", after moving ")
    both = np.char.add(np.char.add(np.char.add(label.phase, way), label.direction), "wards")
    both = np.where(label.direction == "none", np.char.add(label.phase, ", before the first motion"), both)
    yield "phase", label.phase
    yield "direction", label.direction
    yield "phase and direction", both
    yield "amplitude", _amplitude_names(label.amplitude, unit)


def _others(labels: Mapping[str, Phases], channel: str) -> NDArray[np.str_]:
    """Whether another channel's command is moving: errors that come and go with it are coupling."""
    moving = np.any([np.isin(label.phase, MOVING) for name, label in labels.items() if name != channel], axis=0)
    return np.where(moving, "another moves", "all others stand still")


def _amplitude_names(amplitude: Array, unit: str) -> NDArray[np.str_]:
    """Classes of the latest motion's size, which is in `unit`, named as people read it."""
    names = np.full(len(amplitude), "none", dtype=object)
    moved = amplitude > 0
    if moved.any():
        factor, shown = shown_unit(unit)
        sizes_of = np.round(factor * amplitude, 1)
        sizes = np.unique(sizes_of[moved])
        if len(sizes) <= MOST_AMPLITUDES:
            names[moved] = [f"{size:g} {shown}" for size in sizes_of[moved]]
        else:
            edges = np.linspace(0, sizes[-1], MOST_AMPLITUDES + 1)
            index = np.clip(np.searchsorted(edges, sizes_of[moved]) - 1, 0, MOST_AMPLITUDES - 1)
            names[moved] = [f"{shown_number(edges[i])} to {shown_number(edges[i + 1])} {shown}" for i in index]
    return names.astype(str)


def _misfits(signal: str, unit: str, kind: str, names: NDArray[np.str_], error: Array) -> list[Misfit]:
    seen = np.isfinite(error)
    total, count = float(np.sum(error[seen] ** 2)), int(seen.sum())
    rows = []
    for name in np.unique(names[seen]):
        e = error[seen & (names == name)]
        rows.append(_misfit(signal, unit, kind, str(name), e, count, total))
    return rows


def _trial_misfits(real: Trials, i: int, simulated: Array) -> list[Misfit]:
    errors = simulated - real.values[:, :, i]  # (p, T)
    seen = np.isfinite(errors)
    total, count = float(np.sum(errors[seen] ** 2)), int(seen.sum())
    return [
        _misfit(real.signals[i], real.units[i], "trial", f"trial {p + 1}", errors[p][seen[p]], count, total)
        for p in range(real.count)
        if seen[p].any()
    ]


def _axis_misfits(real: Trials, error: Array, measured: Array, spread: Sequence[float]) -> list[Misfit]:
    """One row per signal, the error of each in units of its repeat spread; of its range where a spread is unknown."""
    seen = np.isfinite(error)
    known = all(spread[i] > 0 for i in range(len(real.signals)) if seen[:, i].any())
    weighed = {}
    for i in range(len(real.signals)):
        if seen[:, i].any():
            span = float(np.ptp(measured[seen[:, i], i]))
            unit = spread[i] if known else span if span > NO_RANGE else 1.0
            weighed[i] = float(np.sum((error[seen[:, i], i] / unit) ** 2))
    total, count = math.fsum(weighed.values()), int(seen.sum())
    rows = []
    for i, weight in weighed.items():
        e = error[seen[:, i], i]
        group = channel_of(real.signals[i], real.command_channels) or real.signals[i]
        rms, mean = float(np.sqrt(np.mean(e**2))), float(np.mean(e))
        share = weight / total if total else 0.0
        rows.append(Misfit(real.signals[i], real.units[i], "axis", group, len(e) / count, share, rms, mean))
    return rows


def _misfit(signal: str, unit: str, kind: str, group: str, e: Array, count: int, total: float) -> Misfit:
    squared = float(np.sum(e**2))
    return Misfit(
        signal=signal,
        unit=unit,
        kind=kind,
        group=group,
        time_share=len(e) / count,
        error_share=squared / total if total else 0.0,
        rms=math.sqrt(squared / len(e)),
        mean=float(np.mean(e)),
    )


def _worst_first(rows: list[Misfit]) -> list[Misfit]:
    return sorted(rows, key=lambda m: (-m.error_share, m.group, m.signal))
