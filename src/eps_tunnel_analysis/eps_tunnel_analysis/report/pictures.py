# SPDX-License-Identifier: Apache-2.0
"""Pictures as files: a report's for papers and slides, and those of a notebook."""

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eps_tunnel_analysis.compare import JOINTLY, Comparison
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.verdict import Verdict
from eps_tunnel_analysis.outputs import in_file_name, shown_share, shown_unit
from labyrinth_sim.errors import InputError
from labyrinth_sim.whole_file import beside

REAL_COLOUR, SIM_COLOUR, OUTSIDE_COLOUR = "#1f5fd0", "#d9480f", "#d62839"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e8ebef",
    "svg.hashsalt": "eps_tunnel",  # the same comparison gives the same file
}
PICTURED_HYPOTHESES = 6  # hypotheses
DPI = 110
SUFFIXES = (".svg", ".png", ".pdf")


@dataclass(frozen=True)
class Picture:
    """A drawing as SVG, which a notebook shows, and the figure that it was drawn from, which can be saved."""

    svg: str = field(repr=False)
    figure: Figure = field(repr=False, compare=False)

    @classmethod
    def of(cls, figure: Figure) -> "Picture":
        text = io.StringIO()
        with mpl.rc_context(STYLE):
            figure.savefig(text, format="svg", metadata={"Date": None})
        drawing = text.getvalue()
        return cls(drawing[drawing.index("<svg") :], figure)  # without the XML declaration, so that it goes into HTML

    def _repr_svg_(self) -> str:
        return self.svg

    def save(self, path: str | Path) -> Path:
        """Writes .svg, .png or .pdf; a picture of that name is replaced.

        Raises:
            InputError: another suffix, or the file cannot be written.
        """
        file = Path(path)
        if file.suffix not in SUFFIXES:
            raise InputError(f"{file}: expected a name that ends in {', '.join(SUFFIXES)}.")
        try:
            with mpl.rc_context(STYLE), beside(file) as partial:
                self.figure.savefig(partial, dpi=DPI, metadata={"Date": None} if file.suffix == ".svg" else None)
                partial.replace(file)
        except OSError as error:
            raise InputError(f"{file}: cannot be written ({error.strerror}).") from error
        return file


def write_pictures(comparison: Comparison, folder: Path) -> tuple[Path, ...]:
    """tunnel_SIGNAL and alikeness_over_k, each as .svg and .png. Returns the files."""
    files: list[Path] = []
    with mpl.rc_context(STYLE):
        for i, signal in enumerate(comparison.signals):
            files += _save(_tunnel(comparison, i), folder / f"tunnel_{in_file_name(signal)}")
        files += _save(_over_k(comparison), folder / "alikeness_over_k")
    return tuple(files)


def _save(figure: Figure, stem: Path) -> Iterable[Path]:
    for suffix in (".svg", ".png"):
        path = stem.with_name(stem.name + suffix)
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
        axes.fill_between(
            real.time, low - centre, high - centre, color=REAL_COLOUR, alpha=0.2, lw=0, label="real tunnel"
        )
        axes.plot(real.time, mean - centre, color=REAL_COLOUR, lw=1.2, label="real mean")
        axes.plot(real.time, simulated - centre, color=SIM_COLOUR, lw=1.2, label="simulation")
        across = axes.get_xaxis_transform()
        axes.fill_between(
            real.time, 0, 1, where=outside, step="post", transform=across, color=OUTSIDE_COLOUR, alpha=0.08, lw=0
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
    for curve in comparison.curves:
        joint = curve.name == JOINTLY
        (line,) = axes.plot(ks, [100 * s for s in curve.shares], "o-", label=curve.name, lw=2.2 if joint else None)
        if joint:
            line.set_color("k")
        if curve.itself:
            axes.plot(ks, [100 * s for s in curve.itself], "--", color=line.get_color(), lw=1)
    if comparison.against_itself:
        axes.plot([], [], "--", color="grey", lw=1, label="the rig\nagainst itself")
    axes.set(xlabel="k", ylabel="alikeness in %", xticks=ks, ylim=(-3, 103))
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def save(figure: Figure, path: Path) -> Path:
    """As PNG."""
    with mpl.rc_context(STYLE), beside(path) as partial:
        figure.savefig(partial, dpi=DPI)
        partial.replace(path)
    return path


def _alike(comparison: Comparison) -> str:
    """The joint alikeness and that of the rig against itself, for a title."""
    rig = "".join(f", the rig itself {shown_share(a.joint)}" for a in comparison.against_itself[:1])
    return f"; alike {shown_share(comparison.alikeness[0].joint)}{rig}"


def gap_picture(comparison: Comparison) -> Figure:
    """Simulation and tunnel of each signal relative to the real mean, where the tunnel's width can be seen."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 1.2 + 1.25 * len(comparison.signals)), layout="constrained")
        rows = figure.subplots(len(comparison.signals), 1, sharex=True, squeeze=False)[:, 0]
        real, sim, first = comparison.real_tunnel, comparison.sim_tunnel, comparison.alikeness[0]
        for i, (axes, signal) in enumerate(zip(rows, comparison.signals, strict=True)):
            factor, unit = shown_unit(real.units[i])
            low, high = (factor * (bound[:, i] - real.mean[:, i]) for bound in real.bounds(first.k_real))
            axes.fill_between(real.time, low, high, color=REAL_COLOUR, alpha=0.25, lw=0, label="real tunnel")
            axes.plot(real.time, factor * (sim.mean - real.mean)[:, i], color=SIM_COLOUR, lw=1, label="simulation")
            outside = first.seen[:, i] & ~first.alike[:, i]
            across = axes.get_xaxis_transform()
            axes.fill_between(
                real.time, 0, 1, where=outside, step="post", transform=across, color=OUTSIDE_COLOUR, alpha=0.08, lw=0
            )
            axes.set_ylabel(f"{signal}\n{unit}")
            axes.margins(x=0)
        rows[0].legend(ncols=2, frameon=False, loc="lower left", bbox_to_anchor=(0, 1))
        rows[0].set_title(
            f"relative to the real mean, k = {first.k_real:g}{_alike(comparison)}", loc="right", fontsize=9
        )
        rows[-1].set_xlabel("time in s")
    return figure


def hypotheses_picture(verdict: Verdict) -> Figure:
    """Probabilities; those of the stated set are filled."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 0.8 + 0.3 * len(_likely(verdict))), layout="constrained")
        _bars(figure.subplots(), verdict)
    return figure


def _likely(verdict: Verdict) -> list[tuple[str, float]]:
    return [(name, p) for name, p in verdict.set.items() if p >= 0.001][:PICTURED_HYPOTHESES]


def _bars(axes: Axes, verdict: Verdict) -> None:
    shown = _likely(verdict)[::-1]
    for row, (name, p) in enumerate(shown):
        axes.barh(row, 100 * p, color=REAL_COLOUR if name in verdict.stated else "#c9d3e3")
        axes.text(100 * p + 1, row, f"{p:.1%}", va="center", fontsize=8)
    axes.set_yticks(range(len(shown)), [name for name, _ in shown])
    axes.set(xlim=(0, 118), ylim=(-0.6, max(len(shown), 3) - 0.4), xlabel="probability in %", axisbelow=True)
    axes.grid(visible=False, axis="y")


def last_model(verdict: Verdict) -> str:
    """Name of the best model of a diagnosis in pictures and tables."""
    if not verdict.effects:
        return "values refitted"
    return "with the likeliest" if verdict.verdict == "undecided" else "with what is named"


def answer_picture(diagnosis: Diagnosis) -> Figure:
    """The evidence for a verdict: the model as given and the best one in the tunnel, and the probabilities."""
    given, after, i = diagnosis.given, diagnosis.after, diagnosis.given.most_off
    real = given.real_tunnel
    factor, unit = shown_unit(real.units[i])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, 2.4), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        low, high = (factor * (bound - real.mean)[:, i] for bound in real.bounds())
        left.fill_between(real.time, low, high, color=REAL_COLOUR, alpha=0.25, lw=0, label="real trials")
        last = last_model(diagnosis.verdict)
        for c, colour, name in ((given, "#8b95a3", "model as given"), (after, SIM_COLOUR, last)):
            left.plot(real.time, factor * (c.sim_tunnel.mean - real.mean)[:, i], color=colour, lw=1, label=name)
        left.set(xlabel="time in s", ylabel=f"{given.signals[i]} − real mean, {unit}")
        left.margins(x=0)
        left.legend(frameon=False, fontsize=8, ncols=3, loc="lower left", bbox_to_anchor=(-0.05, 1))
        _bars(right, diagnosis.verdict)
        right.set_title(f"verdict: {diagnosis.verdict.verdict}", loc="left", fontsize=10)
    return figure


def left_over_picture(diagnosis: Diagnosis, alone: bool = False) -> Figure:
    """Simulation minus real over the measured angle or place and the speed, of the signal with the largest error
    relative to its noise.

    Args:
        alone: only of the refitted values, without the effects.
    """
    before, after = diagnosis.before, diagnosis.after
    worst = before.most_off
    shown = [(before, SIM_COLOUR, "before")]
    shown += [(after, REAL_COLOUR, last_model(diagnosis.verdict))] if diagnosis.verdict.effects and not alone else []
    factor, unit = shown_unit(before.real.units[worst])
    place = "angle" if before.real.units[worst] == "rad" else "place"
    real = before.real_tunnel.mean[:, worst]
    speed = np.gradient(real, before.real.step)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.8), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, x, label in zip(panels, (real, speed), (f"{place} in {unit}", f"speed in {unit}/s"), strict=True):
            for comparison, colour, name in shown:
                residual = comparison.sim_tunnel.mean[:, worst] - comparison.real_tunnel.mean[:, worst]
                axes.plot(factor * x, factor * residual, ".", ms=2, color=colour, label=name)
            axes.set_xlabel(label)
        panels[0].set_ylabel(f"simulation − real, {unit}")
        panels[0].set_title(before.signals[worst], loc="left", fontsize=9)
        panels[0].legend(frameon=False, markerscale=4)
    return figure


def staircase_picture(steps: Sequence[tuple[str, float]], floor: float, unit: str = "rad") -> Figure:
    """Error after each step (name, in `unit`) against the rig's own repeat error."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.8), layout="constrained")
        axes = figure.subplots()
        factor, shown = shown_unit(unit)
        axes.bar(range(len(steps)), [factor * error for _, error in steps], color=SIM_COLOUR, width=0.6)
        axes.axhline(factor * floor, color=REAL_COLOUR, ls="--", lw=1, label="the rig's own repeat error")
        axes.set_xticks(range(len(steps)), [name for name, _ in steps])
        axes.set(ylabel=f"error E in {shown}", axisbelow=True)
        axes.legend(frameon=False)
        axes.grid(visible=False, axis="x")
    return figure
