# SPDX-License-Identifier: Apache-2.0
"""What is left, over position, speed, time since a reversal, and time: before and after."""

from typing import Any

import numpy as np

from eps_tunnel_analysis.diagnose.diagnose import Diagnosis
from eps_tunnel_analysis.phases import channel_of, mean_command
from eps_tunnel_analysis.report.page import Block, Chart, Heading, Section
from eps_tunnel_analysis.shown import shown_unit
from labyrinth_sim.trials import Array, Trials

EVERY = 3  # samples drawn
LONGEST = 1.5  # s since a reversal


def evidence(diagnosis: Diagnosis) -> Section:
    """Four charts for each signal of an axis that had something missing; for all where none had."""
    before, after = diagnosis.before, diagnosis.after
    worth = [s for axis in diagnosis.axes if axis.refits for s in axis.part.signals if s in before.signals]
    blocks: list[Block] = []
    for signal in worth or before.signals[:1]:
        i = before.signals.index(signal)
        factor, unit = shown_unit(before.real.units[i])
        real = before.real_tunnel.mean[:, i]
        speed = np.gradient(real, before.real.step)
        left = [factor * (c.sim_tunnel.mean[:, i] - real) for c in (before, after)]
        blocks.append(Heading(signal))
        for label, x in (
            (f"measured {'angle' if before.real.units[i] == 'rad' else 'place'} in {unit}", factor * real),
            (f"measured speed in {unit}/s", factor * speed),
            ("time since the command turned round in s", _since_reversal(before.real, signal)),
            ("time in s", before.real.time),
        ):
            blocks.append(_chart(signal, label, np.asarray(x), left[0], left[1], unit, bool(diagnosis.verdict.effects)))
    return Section(
        "Evidence",
        blocks,
        lead="Simulation minus real. A curve or a loop in one of these is physics the model lacks; a cloud about zero "
        "is noise.",
    )


def _chart(signal: str, label: str, x: Array, before: Array, after: Array, unit: str, named: bool) -> Chart:
    traces = [("before", before, "var(--sim)")] + ([("after", after, "var(--real)")] if named else [])
    drawn = np.isfinite(x)
    data: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": name,
            "x": [float(v) for v in x[drawn][::EVERY]],
            "y": [float(v) for v in y[drawn][::EVERY]],
            "marker": {"size": 3, "color": colour},
        }
        for name, y, colour in traces
    ]
    return Chart(
        data=data,
        layout={
            "xaxis": {"title": {"text": label, "standoff": 4}},
            "yaxis": {"title": {"text": f"simulation − real, {unit}", "standoff": 4}},
            "hovermode": "closest",
        },
        label=f"What is left of {signal} over {label}",
        height=260,
    )


def _since_reversal(real: Trials, signal: str) -> Array:
    """(T,) s since the command of a signal last changed its direction, NaN before and long after."""
    channel = channel_of(signal, real.command_channels)
    if channel is None:
        return np.full(len(real.time), np.nan)
    command = mean_command(real)[:, real.command_channels.index(channel)]
    moves = np.sign(np.diff(np.nan_to_num(command), prepend=0.0))
    since = np.full(len(moves), np.nan)
    last, at = 0.0, -1
    for k, move in enumerate(moves):
        if move and move != last:
            at, last = k, move
        if at >= 0:
            since[k] = (k - at) * real.step
    return np.where(since <= LONGEST, since, np.nan)
