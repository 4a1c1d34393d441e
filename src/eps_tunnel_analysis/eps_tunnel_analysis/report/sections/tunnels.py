# SPDX-License-Identifier: Apache-2.0
"""Tunnel and simulation of each signal, as in the paper's figure 5, with the deviation below on its own scale."""

from typing import Any

import numpy as np

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.phases import channel_of, mean_command
from eps_tunnel_analysis.report.page import Block, Chart, Heading, KPicker, Section
from eps_tunnel_analysis.shown import shown_unit
from labyrinth_sim.trials import Array


def tunnels(comparison: Comparison) -> Section:
    """One chart a signal: trajectories above, deviation from the real mean below, time outside shaded."""
    blocks: list[Block] = [KPicker([a.k_real for a in comparison.alikeness])]
    for i, signal in enumerate(comparison.signals):
        blocks += [Heading(signal), _chart(comparison, i)]
    smoothed = " Its limits are smoothed over 11 samples (equation 12)." if comparison.real_tunnel.smoothed else ""
    return Section(
        "Tunnels",
        blocks,
        lead=f"The band is the tunnel of {comparison.real.count} real trial{'s' * (comparison.real.count > 1)}."
        f"{smoothed} Below, the same relative to the real mean, where the width can be seen. Red marks the time "
        "outside. Drag to zoom, double-click to return.",
    )


def _chart(comparison: Comparison, i: int) -> Chart:
    real, sim = comparison.real_tunnel, comparison.sim_tunnel
    factor, unit = shown_unit(real.units[i])
    mean, lower, upper = (factor * a[:, i] for a in (real.mean, real.lower, real.upper))
    simulated, low, high = (factor * a[:, i] for a in (sim.mean, *sim.bounds(comparison.alikeness[0].k_sim)))
    data: list[dict[str, Any]] = []

    def add(name: str, axis: str, **extra: Any) -> None:
        trace = {"type": "scatter", "mode": "lines", "name": name, "x0": float(real.time[0]), "dx": real.step}
        data.append({**trace, "yaxis": axis, "hovertemplate": "%{y:.4g}", **extra})

    def line(name: str, y: Array, axis: str = "y", **extra: Any) -> None:
        add(name, axis, y=_numbers(y), **extra)

    def band(centre: Array, axis: str, legend: bool) -> None:
        edge = {"line": {"width": 0}, "hoverinfo": "skip", "hovertemplate": None, "legendgroup": "tunnel"}
        for deviation, fill in ((lower, None), (upper, "tonexty")):
            meta = {"centre": _numbers(centre), "deviation": _numbers(deviation)}
            extra = (
                {"fill": fill, "fillcolor": "var(--tunnel)", "showlegend": legend} if fill else {"showlegend": False}
            )
            add("tunnel", axis, meta=meta, **edge, **extra)

    band(mean, "y", True)
    channel = channel_of(comparison.signals[i], comparison.real.command_channels)
    if channel is not None and real.units[i] == "rad":
        command = factor * mean_command(comparison.real)[:, comparison.real.command_channels.index(channel)]
        line("command", command, line={"color": "var(--command)", "width": 1, "dash": "dot", "shape": "hv"})
    line("real mean", mean, line={"color": "var(--real)", "width": 1.6})
    line("simulation", simulated, line={"color": "var(--sim)", "width": 1.6})
    band(np.zeros_like(mean), "y2", False)
    if comparison.sim.count > 1:
        for edge in (low, high):
            thin = {"color": "var(--sim)", "width": 0.8, "dash": "dot"}
            line("simulation's limits", edge - mean, "y2", line=thin, showlegend=False)
    line("simulation − real", simulated - mean, "y2", line={"color": "var(--sim)", "width": 1.4}, showlegend=False)
    name = comparison.signals[i]
    return Chart(
        data=data,
        layout={
            "xaxis": {"title": {"text": "time in s", "standoff": 4}, "anchor": "y2"},
            "yaxis": {"title": {"text": unit, "standoff": 4}, "domain": [0.45, 1]},
            "yaxis2": {"title": {"text": f"− real mean, {unit}", "standoff": 4}, "domain": [0, 0.38], "zeroline": True},
        },
        label=f"Tunnel of {name} over time with the simulated trajectory",
        height=480,
        outside={f"{a.k_real:g}": [(s.start, s.end) for s in a.spans(name)] for a in comparison.alikeness},
    )


def _numbers(values: Array) -> list[float]:
    return [float(v) for v in values]
