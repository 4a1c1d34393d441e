# SPDX-License-Identifier: Apache-2.0
"""Figures 4 and 5 of the paper with the emulated rig's trajectories."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import roll_out
from eps_tunnel_analysis.tunnel import Tunnel, build_tunnel
from labyrinth_sim.model import Model

DEGREES = 180 / np.pi
STYLES = {"standard": ":", "manual": "--", "ES": "-."}


def draw_figure_4(out: Path, play: Play, sets: Mapping[str, Model]) -> None:
    """One rotation of phi_X: real, and simulated with each set of parameters."""
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    tunnel = build_tunnel(play.trials)
    axes.plot(tunnel.time, tunnel.mean[:, tunnel.index("board_x")] * DEGREES, "k-", label="real")
    for name, model in sets.items():
        run = roll_out(model, play)
        axes.plot(run.time, run.values[0, :, run.index("board_x")] * DEGREES, STYLES[name], label=name)
    axes.set(xlabel="time (s)", ylabel=r"$\phi_X$ (deg)", title=f"Rotation {play.name.split('/')[-1]}")
    axes.legend(loc="lower right")
    _save(figure, out / "figure_4")


def draw_figure_5(out: Path, play: Play, tunnel: Tunnel, model: Model) -> None:
    """The tunnel of phi_X at kR = 1 and 3 with the simulated trajectory, at the end of its first step."""
    figure, panels = plt.subplots(2, 1, figsize=(6, 6), sharex=True, layout="constrained")
    column = tunnel.index("board_x")
    run = roll_out(model, play)
    simulated = run.values[0, :, run.index("board_x")] * DEGREES
    for axes, k in zip(panels, (1.0, 3.0), strict=True):
        low, high = tunnel.bounds(k)
        axes.plot(tunnel.time, tunnel.mean[:, column] * DEGREES, "k-", label="real, mean")
        axes.plot(tunnel.time, low[:, column] * DEGREES, "k--", lw=0.8, label="limits of the tunnel")
        axes.plot(tunnel.time, high[:, column] * DEGREES, "k--", lw=0.8)
        axes.plot(tunnel.time, simulated, ":", color="tab:red", label="simulated, ES")
        axes.set(ylabel=r"$\phi_X$ (deg)", title=f"$k_R$ = {k:g}", xlim=(0.0, 1.0))
    panels[0].legend()
    panels[-1].set_xlabel("time (s)")
    _save(figure, out / "figure_5")


def _save(figure: plt.Figure, stem: Path) -> None:
    for suffix in (".png", ".svg"):
        figure.savefig(stem.with_suffix(suffix), dpi=150)
    plt.close(figure)
