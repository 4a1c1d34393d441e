# SPDX-License-Identifier: Apache-2.0
"""The report's pictures as SVG and PNG files, for papers and slides."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.shown import shown_unit

REAL, SIM, OUTSIDE = "#1f5fd0", "#d9480f", "#d62839"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e8ebef",
    "svg.hashsalt": "eps_tunnel",  # the same comparison gives the same file
}


def write_pictures(comparison: Comparison, folder: Path) -> tuple[Path, ...]:
    """tunnel_SIGNAL and alikeness_over_k, each as .svg and .png. Returns the files."""
    files: list[Path] = []
    with mpl.rc_context(STYLE):
        for i, signal in enumerate(comparison.signals):
            files += _save(_tunnel(comparison, i), folder / f"tunnel_{signal}")
        files += _save(_over_k(comparison), folder / "alikeness_over_k")
    return tuple(files)


def _save(figure: Figure, stem: Path) -> Iterable[Path]:
    for suffix in (".svg", ".png"):
        path = stem.with_suffix(suffix)
        figure.savefig(path, dpi=160, metadata={"Date": None} if suffix == ".svg" else None)
        yield path


def _tunnel(comparison: Comparison, i: int) -> Figure:
    """The paper's figure 5: trajectories above, deviation from the real mean below."""
    real, sim, first = comparison.real_tunnel, comparison.sim_tunnel, comparison.alikeness[0]
    factor, unit = shown_unit(real.units[i])
    low, high = (factor * bound[:, i] for bound in real.bounds(first.k_real))
    mean, simulated = factor * real.mean[:, i], factor * sim.mean[:, i]
    outside = first.seen[:, i] & ~first.alike[:, i]
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for axes, centre in ((above, np.zeros_like(mean)), (below, mean)):
        axes.fill_between(real.time, low - centre, high - centre, color=REAL, alpha=0.2, lw=0, label="real tunnel")
        axes.plot(real.time, mean - centre, color=REAL, lw=1.2, label="real mean")
        axes.plot(real.time, simulated - centre, color=SIM, lw=1.2, label="simulation")
        across = axes.get_xaxis_transform()
        axes.fill_between(
            real.time, 0, 1, where=outside, step="post", transform=across, color=OUTSIDE, alpha=0.08, lw=0
        )
    above.set_ylabel(f"{comparison.signals[i]} in {unit}" if unit else comparison.signals[i])
    below.set_ylabel(f"− real mean, {unit}" if unit else "− real mean")
    below.set_xlabel("time in s")
    below.margins(x=0)
    above.legend(ncols=3, frameon=False, loc="lower left", bbox_to_anchor=(0, 1))
    above.set_title(f"k = {first.k_real:g}", loc="right", fontsize=9)
    return figure


def _over_k(comparison: Comparison) -> Figure:
    figure = Figure(figsize=(5.4, 3.2), layout="constrained")
    axes: Axes = figure.subplots()
    ks = [a.k_real for a in comparison.alikeness]
    for name in comparison.signals:
        axes.plot(ks, [100 * a.shares[name] for a in comparison.alikeness], "o-", label=name)
    if len(comparison.signals) > 1:
        axes.plot(ks, [100 * a.joint for a in comparison.alikeness], "ko-", lw=2.2, label="jointly")
    axes.set(xlabel="k", ylabel="alikeness in %", xticks=ks, ylim=(-3, 103))
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure
