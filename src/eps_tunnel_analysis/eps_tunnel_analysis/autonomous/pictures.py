# SPDX-License-Identifier: Apache-2.0
"""Pictures for the notebook."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from eps_tunnel_analysis.compare import Comparison
from eps_tunnel_analysis.diagnose.verdict import Verdict
from eps_tunnel_analysis.report.pictures import OUTSIDE, REAL, SIM, STYLE
from eps_tunnel_analysis.shown import shown_unit

LISTED = 6  # hypotheses
DPI = 110


def save(figure: Figure, path: Path) -> Path:
    """As PNG."""
    with mpl.rc_context(STYLE):
        figure.savefig(path, dpi=DPI)
    return path


def gap_picture(comparison: Comparison) -> Figure:
    """Simulation and tunnel of each signal relative to the real mean, where the tunnel's width can be seen."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 1.2 + 1.25 * len(comparison.signals)), layout="constrained")
        rows = figure.subplots(len(comparison.signals), 1, sharex=True, squeeze=False)[:, 0]
        real, sim, first = comparison.real_tunnel, comparison.sim_tunnel, comparison.alikeness[0]
        for i, (axes, signal) in enumerate(zip(rows, comparison.signals, strict=True)):
            factor, unit = shown_unit(real.units[i])
            low, high = (factor * (bound[:, i] - real.mean[:, i]) for bound in real.bounds(first.k_real))
            axes.fill_between(real.time, low, high, color=REAL, alpha=0.25, lw=0, label="real tunnel")
            axes.plot(real.time, factor * (sim.mean - real.mean)[:, i], color=SIM, lw=1, label="simulation")
            outside = first.seen[:, i] & ~first.alike[:, i]
            across = axes.get_xaxis_transform()
            axes.fill_between(
                real.time, 0, 1, where=outside, step="post", transform=across, color=OUTSIDE, alpha=0.08, lw=0
            )
            axes.set_ylabel(f"{signal}\n{unit}")
            axes.margins(x=0)
        rows[0].legend(ncols=2, frameon=False, loc="lower left", bbox_to_anchor=(0, 1))
        rows[0].set_title(f"relative to the real mean, k = {first.k_real:g}", loc="right", fontsize=9)
        rows[-1].set_xlabel("time in s")
    return figure


def hypotheses_picture(verdict: Verdict) -> Figure:
    """Probabilities; those of the stated set are filled."""
    shown = [(name, p) for name, p in verdict.set.items() if p >= 0.001][:LISTED][::-1]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 0.8 + 0.3 * len(shown)), layout="constrained")
        axes = figure.subplots()
        for row, (name, p) in enumerate(shown):
            axes.barh(row, 100 * p, color=REAL if name in verdict.stated else "#c9d3e3")
            axes.text(100 * p + 1, row, f"{p:.1%}", va="center", fontsize=8)
        axes.set_yticks(range(len(shown)), [name for name, _ in shown])
        axes.set(xlim=(0, 112), xlabel="probability in %", axisbelow=True)
        axes.grid(visible=False, axis="y")
    return figure


def left_over_picture(before: Comparison, after: Comparison | None) -> Figure:
    """Simulation minus real over the measured angle and over the speed, of the signal that is most beyond its noise."""
    off = [e.rms / e.repeat_rms if e.repeat_rms > 0 else e.rms / (e.range or np.inf) for e in before.errors]
    worst = int(np.argmax(off))
    factor, unit = shown_unit(before.real.units[worst])
    real = before.real_tunnel.mean[:, worst]
    speed = np.gradient(real, before.real.step)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.8), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, x, label in zip(panels, (real, speed), (f"angle in {unit}", f"speed in {unit}/s"), strict=True):
            for comparison, colour, name in ((before, SIM, "before"), (after, REAL, "with what is named")):
                if comparison is not None:
                    left = comparison.sim_tunnel.mean[:, worst] - comparison.real_tunnel.mean[:, worst]
                    axes.plot(factor * x, factor * left, ".", ms=2, color=colour, label=name)
            axes.set_xlabel(label)
        panels[0].set_ylabel(f"simulation − real, {unit}")
        panels[0].set_title(before.signals[worst], loc="left", fontsize=9)
        panels[0].legend(frameon=False, markerscale=4)
    return figure


def staircase_picture(steps: Sequence[tuple[str, float]], floor: float) -> Figure:
    """Error after each step (name, rad) against what the rig itself does not repeat (rad)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.8), layout="constrained")
        axes = figure.subplots()
        axes.bar(range(len(steps)), [1000 * error for _, error in steps], color=SIM, width=0.6)
        axes.axhline(1000 * floor, color=REAL, ls="--", lw=1, label="what the rig itself does not repeat")
        axes.set_xticks(range(len(steps)), [name for name, _ in steps])
        axes.set(ylabel="error E in mrad", axisbelow=True)
        axes.legend(frameon=False)
        axes.grid(visible=False, axis="x")
    return figure
