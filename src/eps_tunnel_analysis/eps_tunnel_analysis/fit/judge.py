# SPDX-License-Identifier: Apache-2.0
"""How good a model is on recorded plays, signal by signal: the paper's error and its alikeness."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.alikeness import KS
from eps_tunnel_analysis.fit.objective import Objective
from eps_tunnel_analysis.plays import Play
from labyrinth_sim.model import Model


@dataclass(frozen=True)
class Score:
    """One signal of one model over several plays.

    Attributes:
        signal, unit: what it is.
        error: E_C of equation 10, mean over the plays, in the signal's unit; inf where the simulation diverged.
        alikeness: k -> share of all seen samples within k times the smoothed tunnel (equations 7, 12, 13).
    """

    signal: str
    unit: str
    error: float
    alikeness: dict[float, float]


def judge(
    model: Model,
    plays: Sequence[Play],
    signals: Iterable[str] | None = None,
    ks: Sequence[float] = KS,
    timestep: float | None = None,
) -> tuple[Score, ...]:
    """Rolls the model out on each play. Raises InputError as `Objective` does."""
    objective = Objective(model, (), plays, signals, timestep)
    residuals = np.nan_to_num(objective(np.empty((1, 0)))[0], nan=np.inf)
    inside = {k: (-k * objective.lower <= residuals) & (residuals <= k * objective.upper) for k in ks}
    columns = objective.blocks % len(objective.signals)
    units = dict(zip(model.rig.signals, model.rig.units, strict=True))
    scores = []
    for column, signal in enumerate(objective.signals):
        mine = columns == column
        error = float(np.abs(residuals[mine]) @ objective.weights[mine]) / len(plays)
        shares = {float(k): float(inside[k][mine].mean()) for k in ks}
        scores.append(Score(signal, units[signal], error, shares))
    return tuple(scores)
