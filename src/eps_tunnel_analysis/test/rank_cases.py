# SPDX-License-Identifier: Apache-2.0
"""Hypotheses made of residuals, for tests of what is ranked."""

from collections.abc import Sequence

import numpy as np

from eps_tunnel_analysis.diagnose.rank import Hypothesis
from eps_tunnel_analysis.diagnose.refits import Refit

SAMPLES, FOLDS = 1200, 16


def hypothesis(effects: Sequence[str], residuals: np.ndarray, free: int | None = None) -> Hypothesis:
    """What leaves residuals (R,), fitted or left out; with three free values and one for each effect unless told."""
    cost = float(np.mean(residuals**2))
    many = 3 + len(effects) if free is None else free
    return Hypothesis(Refit(tuple(effects), np.zeros(1), residuals, cost, many, True), residuals)
