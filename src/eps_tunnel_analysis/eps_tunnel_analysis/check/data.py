# SPDX-License-Identifier: Apache-2.0
"""Quality of recordings: rates, jitter, gaps, clipped and stuck signals, limits, efforts, repeatability."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.outputs import shown_number, shown_value
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.recording.trials import MAX_GAP
from eps_tunnel_analysis.stamped import Series
from labyrinth_sim.model import Model
from labyrinth_sim.rig import Axis, Measured
from labyrinth_sim.trials import Array, runs

UNEVEN = 0.2  # jitter, as a share of the sample time, that is worth a word
LATE_COMMAND = 1.5  # sample times, beyond which a command is late
MANY_LATE = 0.02  # share of the commands
RAGGED = 0.02  # share of the samples, from which a signal counts as clipped
CLIPPED_RUN = 0.2  # s on end at the extreme
STILL_SHARE = 0.3  # share of a trial's time, during which a signal stands while its command moves
MOVED = 0.2  # share of the command's range, that counts as moving
DEGREES = 4.0 * np.pi  # rad; a reach beyond is hardly a servo's in rad
TOO_STRONG = 3.0  # times what a drive can give; efforts beyond are hardly N m
FEW = 5  # trials, below which what a rig repeats is known roughly only
NO_JITTER = 1e-6  # s of jitter that is none


@dataclass(frozen=True)
class Finding:
    """One finding about the recordings.

    Attributes:
        about: a signal, a command channel, a recording, or "".
        serious: whether something should be done about it.
        sentence: what was found, with its figures and units, and what to do.
    """

    about: str
    serious: bool
    sentence: str


def check_data(model: Model | None, plays: Sequence[Play], efforts: bool = True) -> tuple[Finding, ...]:
    """Everything about the recordings themselves.

    Args:
        model: has limits, units and what its drives can give; without one, only timing and repeats are checked.
        efforts: whether efforts were to be read.
    """
    findings: list[Finding] = []
    if model is None:
        trials = [trial for play in plays for trial in play.at_stamps]
        for name in trials[0].commands:
            findings += _timing(f"command {name}", [trial.commands[name] for trial in trials], commands=True)
        for name in trials[0].signals:
            findings += _timing(name, [trial.signals[name] for trial in trials])
        return (*findings, *_repeats(plays))
    unread = ("position", "torque") if efforts else ("position",)  # velocities are never compared
    for axis in model.rig.axes:
        findings += _commands(axis, plays)
        for measured in axis.measured:
            if all(measured.signal in play.trials.signals for play in plays):
                findings += _signal(model, axis, measured, plays)
            elif measured.quantity in unread:
                findings.append(Finding(measured.signal, False, f"{measured.signal} was not read or not recorded."))
    findings += _repeats(plays)
    return tuple(findings)


def sentences(findings: Sequence[Finding]) -> list[str]:
    """In words, the serious first and marked by `!`."""
    ordered = sorted(findings, key=lambda finding: not finding.serious)
    return [f"{'! ' if finding.serious else ''}{finding.sentence}" for finding in ordered]


def _commands(axis: Axis, plays: Sequence[Play]) -> Iterator[Finding]:
    series = [trial.commands[axis.command] for play in plays for trial in play.at_stamps]
    yield from _timing(f"command {axis.command}", series, commands=True)
    values = np.concatenate([s.values for s in series])
    off = float(np.mean(np.isnan(values)))
    sent = values[np.isfinite(values)]
    unit = axis.recorded.si
    if off > 0.0:
        yield Finding(axis.command, False, f"Drive {axis.name} is switched off for part of the recordings.")
    if not len(sent):
        yield Finding(
            axis.command, True, f"Command {axis.command} contains no numbers; nothing moves axis {axis.name}."
        )
        return
    low, high = float(sent.min()), float(sent.max())
    if low < axis.limits[0] or high > axis.limits[1]:
        yield Finding(
            axis.command, True,
            f"Command {axis.command} goes from {shown_value(low, unit)} to {shown_value(high, unit)}, beyond the "
            f"axis's limits of {shown_value(axis.limits[0], unit)} and {shown_value(axis.limits[1], unit)}. Mend "
            "'limits' or 'unit' in the rig file.",
        )  # fmt: skip
    if unit == "rad" and high - low > DEGREES:
        yield Finding(
            axis.command, True,
            f"Command {axis.command} spans {shown_number(high - low)} rad; is it recorded in degrees or ticks? "
            f"Then write 'command: {{channel: {axis.command}, unit: deg}}' in the rig file.",
        )  # fmt: skip


def _signal(model: Model, axis: Axis, measured: Measured, plays: Sequence[Play]) -> Iterator[Finding]:
    name, unit = measured.signal, measured.unit
    series = [trial.signals[name] for play in plays for trial in play.at_stamps]
    yield from _timing(name, series)
    values = np.concatenate([s.values for s in series])
    if not len(values):
        yield Finding(name, True, f"{name} has no samples.")
        return
    if np.ptp(values) == 0.0:
        yield Finding(name, True, f"{name} never changes: it is {shown_value(float(values[0]), unit)} throughout.")
        return
    yield from _clipped(axis, measured, plays)
    if measured.quantity == "position":
        yield from _stuck(axis, name, plays)
        if unit == "rad" and np.ptp(values) > DEGREES:
            yield Finding(
                name, True,
                f"{name} spans {shown_number(np.ptp(values))} rad; is it recorded in degrees or ticks? Then write "
                "'unit: deg', or 'unit: ticks' with 'ticks_per_turn', in the rig file.",
            )  # fmt: skip
    if measured.quantity == "torque":
        yield from _effort(model, axis, measured, values)


def _timing(name: str, series: Sequence[Series], commands: bool = False) -> Iterator[Finding]:
    steps = [np.diff(s.time) for s in series if len(s.time) > 1]
    if not steps:
        yield Finding(name, True, f"{name} has fewer than two samples in each trial.")
        return
    apart = np.concatenate(steps)
    period = float(np.median(apart))
    usual = apart[apart < LATE_COMMAND * period]
    jitter = float(np.std(usual)) if len(usual) else 0.0
    even = f"jitter {shown_number(1e3 * jitter, 2)} ms" if jitter > NO_JITTER else "evenly"
    words = f"{name}: {shown_number(1.0 / period, 4)} Hz, {even}"
    late = float(np.mean(apart > LATE_COMMAND * period))
    gaps = apart[apart > max(MAX_GAP, 5.0 * period)]
    if commands and late > MANY_LATE and period < MAX_GAP:
        words += f", {late:.1%} later than {LATE_COMMAND:g} periods"
    if len(gaps):
        words += f", {len(gaps)} gaps up to {shown_number(gaps.max())} s"
    ragged = jitter > UNEVEN * period
    uneven = ragged or (len(gaps) > 0 and not commands)
    advice = " Uneven timing within trials is not an effect of the rig; state it by --timing-ms." if ragged else ""
    advice += " Samples in a gap count as unseen." if len(gaps) and not commands else ""
    yield Finding(name, uneven, f"{words}.{advice}")


def _clipped(axis: Axis, measured: Measured, plays: Sequence[Play]) -> Iterator[Finding]:
    """Runs of samples at one and the same extreme while the command moves."""
    top, share = 0.0, []
    for play in plays:
        column = play.trials.index(measured.signal)
        command = play.trials.commands[0, :, play.trials.command_channels.index(axis.command)]
        moving = _moving(command, play.trials.step)
        for values in play.trials.values[:, :, column]:
            reach = float(np.nanmax(np.abs(values), initial=0.0))
            near = np.abs(np.abs(values) - reach) <= 1e-6 * max(reach, 1e-12)
            run = _in_long_runs(near & moving, max(5, round(CLIPPED_RUN / max(play.trials.step, 1e-9))))
            share.append(float(np.mean(run)))
            top = max(top, reach)
    if max(share) > RAGGED:
        where = "its drive's limit" if measured.quantity == "torque" else "a stop or the sensor's end"
        yield Finding(
            measured.signal, measured.quantity == "position",
            f"{measured.signal} stays at its extreme of {shown_value(top, measured.unit)} for up to {max(share):.0%} "
            f"of a trial while its command moves: {where}.",
        )  # fmt: skip


def _in_long_runs(flags: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """(T,) those that stand in runs of at least so many."""
    kept = np.zeros(len(flags), dtype=bool)
    for low, high in runs(flags):
        if high - low >= least:
            kept[low:high] = True
    return kept


def _moving(command: Array, step: float) -> NDArray[np.bool_]:
    """(T,) whether a command changes fast enough to cross its range in 10 s."""
    held = np.where(np.isfinite(command), command, 0.0)
    if len(held) < 2 or step <= 0.0:
        return np.zeros(len(held), dtype=bool)
    return np.asarray(np.abs(np.gradient(held, step)) > 0.1 * np.ptp(held)) & np.isfinite(command)


def _stuck(axis: Axis, name: str, plays: Sequence[Play]) -> Iterator[Finding]:
    worst = 0.0
    for play in plays:
        column = play.trials.index(name)
        command = play.trials.commands[0, :, play.trials.command_channels.index(axis.command)]
        span = float(np.nanmax(command) - np.nanmin(command)) if np.isfinite(command).any() else 0.0
        for values in play.trials.values[:, :, column]:
            edges = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
            for low, high in pairwise(edges):
                moved = np.ptp(np.nan_to_num(command[low:high])) if high - low > 1 else 0.0
                if span > 0.0 and moved > MOVED * span:
                    worst = max(worst, (high - low) / len(values))
    if worst > STILL_SHARE:
        yield Finding(
            name, True,
            f"{name} stands still for {worst:.0%} of a trial while its command moves: a stuck sensor, or a drive that "
            "was off.",
        )  # fmt: skip


def _effort(model: Model, axis: Axis, measured: Measured, values: Array) -> Iterator[Finding]:
    name, recorded = measured.signal, measured.recorded
    if recorded.free:
        yield Finding(
            name, False,
            f"{name} is recorded in {recorded.name}; the factor to a torque is not stated and is fitted. State "
            f"'{'torque_constant' if recorded.si == 'A' else 'stall_torque'}' in the rig file if you know it."
            if recorded.name != "raw" else f"{name} is recorded in an unknown unit; its factor is fitted.",
        )  # fmt: skip
        return
    kind = model.drives[axis.name].kind
    drive = model.drives[axis.name].values
    numbers = {p.name: drive[p.name].value if p.name in drive else p.typical for p in kind.parameters}
    full, most = kind.full(numbers) if kind.full else 0.0, float(np.abs(values).max())
    if full > 0.0 and most > TOO_STRONG * full:
        yield Finding(
            name, True,
            f"{name} reaches {shown_number(most)} {measured.unit}, but the drive gives {shown_number(full)} at most. "
            "If it is a current, a duty or counts, write 'unit: A', 'duty' or 'raw' next to it in the rig file.",
        )  # fmt: skip
    elif full > 0.0 and recorded.scale == 1.0 and 0.95 <= most <= 1.0 and full > TOO_STRONG:
        yield Finding(
            name, True,
            f"{name} never exceeds 1, though the drive can give {shown_number(full)} {measured.unit}: is it a duty? "
            "Then write 'unit: duty' next to it in the rig file.",
        )  # fmt: skip


def _repeats(plays: Sequence[Play]) -> Iterator[Finding]:
    counts = [play.trials.count for play in plays]
    words = f"{min(counts)} to {max(counts)}" if min(counts) < max(counts) else str(counts[0])
    recorded = f"{len(plays)} command{'s' * (len(plays) > 1)}, {words} trial{'s' * (max(counts) > 1)} of each."
    if min(counts) == 1:
        advice = (
            " With one trial the rig's repeatability is unknown: tunnels have no width, alikeness means nothing, and "
            "it cannot be said whether something unknown is left. Record five trials of each command."
        )
    elif min(counts) < FEW:
        advice = f" With fewer than {FEW} trials the tunnel's width is rough; record {FEW} or more."
    else:
        advice = ""
    yield Finding("", min(counts) == 1, recorded + advice)
    if len(plays) < 2:
        yield Finding(
            "", False, "Only one command: the held-out error is that of stretches of time. Record a second command and "
            "give it by --held-out."
        )  # fmt: skip
