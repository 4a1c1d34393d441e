# SPDX-License-Identifier: Apache-2.0
"""Pictures of values: the effect of changing them, and how they change from date to date."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from eps_tunnel_analysis.outputs import shown_share, shown_unit
from eps_tunnel_analysis.report.pictures import REAL_COLOUR, STYLE
from eps_tunnel_analysis.values.changes import DateOfRig
from eps_tunnel_analysis.values.sweep import Sweep, SweptValue
from labyrinth_sim.trials import Array

GIVEN_COLOUR = "#495057"
SHADES = "viridis"
ITSELF = "the rig\nagainst itself"


def save_svg(figure: Figure, path: Path) -> Path:
    """As SVG; the same figure gives the same file."""
    with mpl.rc_context(STYLE):
        figure.savefig(path, metadata={"Date": None})
    return path


def sweep_picture(sweep: Sweep) -> Figure:
    """Alikeness at each k and error: lines over one value, maps over a pair."""
    with mpl.rc_context(STYLE):
        return _lines(sweep) if len(sweep.values) == 1 else _maps(sweep)


def _lines(sweep: Sweep) -> Figure:
    (value,) = sweep.values
    scale, label = _axis(value)
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for i, k in enumerate(sweep.ks):
        shade = 0.85 * (1.0 - i / max(len(sweep.ks), 2))
        above.plot(scale * value.points, 100 * sweep.joint[:, i], ".-", color=str(shade * 0.8), label=f"k = {k:g}")
        if np.isfinite(sweep.itself[i]):
            above.axhline(100 * sweep.itself[i], color=str(shade * 0.8), ls=":", lw=1)
    if np.isfinite(sweep.itself).any():
        above.plot([], [], ":", color="0.4", lw=1, label=ITSELF)
    what = "alike in every signal" if len(sweep.signals) > 1 else "alikeness"
    above.set(ylabel=f"{what}, %", ylim=(-3, 103))
    for i, signal in enumerate(sweep.signals):
        factor, unit = shown_unit(sweep.units[i])
        finite = np.where(np.isfinite(sweep.errors[:, i]), sweep.errors[:, i], np.nan)
        below.plot(scale * value.points, factor * finite, ".-", label=f"{signal}, {unit}" if unit else signal)
    below.set(ylabel="error E", xlabel=label)
    below.set_ylim(bottom=0.0)
    for axes in (above, below):
        axes.axvline(scale * value.given, color=GIVEN_COLOUR, ls="--", lw=1)
        axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    above.set_title("dashed: the model's own value", loc="right", fontsize=9)
    return figure


def _maps(sweep: Sweep) -> Figure:
    first, second = sweep.values
    (scale1, label1), (scale2, label2) = _axis(first), _axis(second)
    factor, unit = shown_unit(sweep.units[0])
    error = factor * sweep.mean_error
    panels: list[tuple[str, Array, tuple[float, float] | None]]
    panels = [
        (f"alikeness, k = {k:g}, %{_of_rig(sweep.itself[i])}", 100 * sweep.joint[..., i], (0, 100))
        for i, k in enumerate(sweep.ks)
    ]
    panels.append((f"error E, {unit}" if unit else "error E", np.where(np.isfinite(error), error, np.nan), None))
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(0.6 + 2.9 * columns, 0.6 + 2.5 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (title, shown, limits) in zip(grid.flat, panels, strict=False):
        low, high = limits or (None, None)
        drawn = axes.pcolormesh(
            scale2 * second.points, scale1 * first.points, shown, cmap=SHADES if limits else f"{SHADES}_r", vmin=low,
            vmax=high, shading="nearest", rasterized=True,
        )  # fmt: skip
        axes.plot(scale2 * second.given, scale1 * first.given, "x", color="white", mew=2)
        axes.set_title(title, fontsize=9)
        axes.grid(visible=False)
        figure.colorbar(drawn, ax=axes)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    figure.supxlabel(f"{label2}; cross: the model's own values", fontsize=9)
    figure.supylabel(label1, fontsize=9)
    return figure


def dates_picture(dates: Sequence[DateOfRig]) -> Figure:
    """Alikeness at each k of the first date's model, and each watched value with its interval, date by date."""
    watched = list(dict.fromkeys(v.name for date in dates for v in date.values))
    at = np.arange(len(dates))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.4 + 1.8 * len(watched)), layout="constrained")
        rows = figure.subplots(1 + len(watched), 1, sharex=True, squeeze=False)[:, 0]
        ks = list(dates[0].alikeness)
        for i, k in enumerate(ks):
            shade = 0.85 * (1.0 - i / max(len(ks), 2))
            colour = str(0.8 * shade)
            rows[0].plot(at, [100 * d.alikeness[k] for d in dates], "o-", color=colour, label=f"k = {k:g}")
            rows[0].plot(at, [100 * d.itself[k] for d in dates], "o:", color=colour, lw=1, ms=3)
        if any(np.isfinite(share) for d in dates for share in d.itself.values()):
            rows[0].plot([], [], "o:", color="0.4", lw=1, ms=3, label=ITSELF)
        rows[0].set(ylabel="alike in every signal, %", ylim=(-3, 103))
        rows[0].legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
        for axes, name in zip(rows[1:], watched, strict=True):
            known = [(i, v) for i, d in enumerate(dates) for v in d.values if v.name == name]
            factor, unit = shown_unit(known[0][1].unit)
            axes.errorbar(
                [i for i, _ in known], [factor * v.now for _, v in known],
                yerr=[factor * v.half_width for _, v in known], fmt="o", color=REAL_COLOUR, capsize=3,
            )  # fmt: skip
            axes.axhline(factor * known[0][1].then, color=GIVEN_COLOUR, ls="--", lw=1)
            axes.set_ylabel(f"{name}\n{unit}" if unit else name)
        rows[-1].set_xticks(at, [d.label for d in dates], rotation=20)
        rows[0].set_title("dashed: the first date; bars: 95 %" if watched else "", loc="right", fontsize=9)
    return figure


def _of_rig(share: float) -> str:
    """What the rig reaches against itself, as the second line of a title; empty where unknown."""
    return f"\nthe rig against itself {shown_share(share)}" if np.isfinite(share) else ""


def _axis(value: SweptValue) -> tuple[float, str]:
    factor, unit = shown_unit(value.unit)
    return factor, f"{value.name} in {unit}" if unit else value.name
