# SPDX-License-Identifier: Apache-2.0
"""The gate, first and last: is what a model leaves unexplained what noise would leave?

A ranking always names somebody. So before anyone is named the base alone must fail the gate, and whoever is named must
pass it; if nobody does, the answer is "unknown".
"""

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.calibration import CALIBRATION
from eps_tunnel_analysis.fit.intervals import autocorrelation_length
from labyrinth_sim.trials import Array


def independent(residuals: Array, blocks: NDArray[np.int64]) -> float:
    """How many independent samples residuals (R,), in unbroken runs `blocks` (R,), are worth."""
    return len(residuals) / (2.0 * autocorrelation_length(residuals, blocks.astype(float)) + 1.0)


def allowed(base: float) -> float:
    """Mean square that may be left where the base leaves `base`: a strong effect is never matched to the last bit."""
    return CALIBRATION.gate + CALIBRATION.left_over * base


def unexplained(cost: float, base: float) -> float:
    """Probability that a model which leaves `cost`, where the base leaves `base`, still lacks something unknown."""
    return _logistic(np.log(max(cost, 1e-12) / allowed(base)) / CALIBRATION.unknown_width)


def complete(base: float, best: float, once: float = 0.0) -> float:
    """Probability that the base lacks nothing, from what it leaves and what the best candidate would leave.

    `once` is what was left before effects were added to it in earlier steps.
    """
    level = np.log(max(base, 1e-12) / allowed(once))
    gain = np.log(max(base, 1e-12) / max(best, 1e-12))
    return _logistic(-(level + CALIBRATION.gain_weight * (gain - CALIBRATION.gain)) / CALIBRATION.none_width)


def _logistic(x: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))))
