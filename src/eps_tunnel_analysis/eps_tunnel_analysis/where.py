# SPDX-License-Identifier: Apache-2.0
"""Where a model fails: how its misfit spreads over phases of the command, directions, amplitudes, axes and trials."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.phases import MOVING, Phases, channel_of, mean_command, phases, target_before
from eps_tunnel_analysis.shown import shown_value
from eps_tunnel_analysis.tunnel import build_tunnel
from labyrinth_sim.trials import Array, Trials

UNEVEN = 0.05  # error share beyond the time share from which a phase is told
STANDS = 1e-9  # SI units; a signal with a smaller range stands still, and its error is taken as it is
MOST_AMPLITUDES = 6  # more than these are put into as many equal classes


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
            signals, each in relation to its own range.
        rms: in the signal's unit.
        mean: in the signal's unit; above 0 the simulation is too high.
    """

    signal: str
    unit: str
    kind: str
    group: str
    time_share: float
    error_share: float
    rms: float
    mean: float

    @property
    def excess(self) -> float:
        """Error share beyond the time share: 0 where the error is spread evenly over time."""
        return self.error_share - self.time_share


def where(real: Trials, sim: Trials) -> tuple[Misfit, ...]:
    """The misfit of every signal in every group, each kind of each signal worst first.

    Phases, direction and amplitude are those of the command channel that moves the signal. Both sides need the same
    signals and time.
    """
    measured, simulated = build_tunnel(real).mean, build_tunnel(sim).mean
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
            groups = list(_groupings(labels[channel]))
            groups += [("other axes", _others(labels, channel))] if len(labels) > 1 else []
        for kind, names in groups:
            rows += _worst_first(_misfits(signal, real.units[i], kind, names, error))
        rows += _worst_first(_trial_misfits(real, i, simulated[:, i]))
    return tuple(_worst_first(_axis_misfits(real, simulated - measured, measured)) + rows)


def sentences(misfits: Iterable[Misfit], most: int = 3) -> tuple[str, ...]:
    """Where the model fails in words, worst first.

    Told are phases with far more of a signal's error than of its time, and signals whose error is spread evenly; both
    weighed by the signal's share of all errors.
    """
    rows = list(misfits)
    told: list[tuple[float, str]] = []
    for axis in (m for m in rows if m.kind == "axis" and m.rms > 0):
        phase = [m for m in rows if (m.kind, m.signal) == ("phase and direction", axis.signal) and m.excess > UNEVEN]
        told += [(axis.error_share * m.excess, _sentence(m)) for m in phase]
        if not phase:
            told.append((axis.error_share * UNEVEN, _even(axis)))
    return tuple(text for _, text in sorted(told, key=lambda pair: -pair[0])[:most])


def _sentence(m: Misfit) -> str:
    return (
        f"{m.signal}, {m.group}: {m.error_share:.0%} of its squared error in {m.time_share:.0%} of the time; {_off(m)}."
    )


def _even(m: Misfit) -> str:
    return f"{m.signal}: the error is spread evenly over the phases of the command; {_off(m)}."


def _off(m: Misfit) -> str:
    side = "above" if m.mean > 0 else "below"
    return (
        f"the simulation is {shown_value(abs(m.mean), m.unit)} {side} the real mean on average "
        f"(RMS {shown_value(m.rms, m.unit)})"
    )


def _groupings(label: Phases) -> Iterator[tuple[str, NDArray[np.str_]]]:
    both = np.char.add(np.char.add(label.phase, ", going "), label.direction)
    both = np.where(label.direction == "none", np.char.add(label.phase, ", before the first motion"), both)
    yield "phase", label.phase
    yield "direction", label.direction
    yield "phase and direction", both
    yield "amplitude", _amplitude_names(label.amplitude)


def _others(labels: Mapping[str, Phases], channel: str) -> NDArray[np.str_]:
    """Whether another channel's command is on its way: errors that come and go with it are coupling."""
    moving = np.any([np.isin(label.phase, MOVING) for name, label in labels.items() if name != channel], axis=0)
    return np.where(moving, "another moves", "all others stand still")


def _amplitude_names(amplitude: Array) -> NDArray[np.str_]:
    """Classes of the latest motion's size, named in degrees."""
    names = np.full(len(amplitude), "none", dtype=object)
    moved = amplitude > 0
    if moved.any():
        degrees = np.round(np.degrees(amplitude), 1)
        sizes = np.unique(degrees[moved])
        if len(sizes) <= MOST_AMPLITUDES:
            names[moved] = [f"{d:g} deg" for d in degrees[moved]]
        else:
            edges = np.linspace(0, sizes[-1], MOST_AMPLITUDES + 1)
            index = np.clip(np.searchsorted(edges, degrees[moved]) - 1, 0, MOST_AMPLITUDES - 1)
            names[moved] = [f"{edges[i]:.3g} to {edges[i + 1]:.3g} deg" for i in index]
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


def _axis_misfits(real: Trials, error: Array, measured: Array) -> list[Misfit]:
    """One row per signal, the error of each in relation to its measured range."""
    seen = np.isfinite(error)
    weighed = {}
    for i in range(len(real.signals)):
        if seen[:, i].any():
            span = float(np.ptp(measured[seen[:, i], i]))
            span = span if span > STANDS else 1.0
            weighed[i] = float(np.sum((error[seen[:, i], i] / span) ** 2))
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
