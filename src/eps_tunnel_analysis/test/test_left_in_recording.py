# SPDX-License-Identifier: Apache-2.0
"""Whether anything is left is a fact of the recording, however unevenly it is spread over it."""

import numpy as np
from rank_cases import FOLDS, SAMPLES, hypothesis

from eps_tunnel_analysis.diagnose.rank import UNKNOWN, rank

FEW = 150


def unknown(left: float, base: float = 5.0) -> float:
    """Probability that something is left where an effect leaves noise on one signal, and so much on another that is
    compared in two stretches only, all of it in one of them.
    """
    rng = np.random.default_rng(0)
    often = rng.standard_normal(SAMPLES)
    seldom = np.where(np.arange(2 * FEW) < FEW, rng.standard_normal(2 * FEW), 0.0)
    seldom *= np.sqrt(left / np.mean(seldom**2))
    residuals = np.concatenate([often, seldom])
    signals = np.repeat([0, 1], [SAMPLES, 2 * FEW])
    folds = np.concatenate([np.arange(SAMPLES) * FOLDS // SAMPLES, np.repeat([2, 9], FEW)])

    missing, true = hypothesis((), np.sqrt(base) * residuals), hypothesis(("true.x",), residuals)
    found = rank(missing, [true], folds, signals, tried=10, signals=signals)
    return found.probabilities[UNKNOWN]


def test_what_leaves_noise_leaves_nothing_though_most_of_it_is_in_one_stretch() -> None:
    assert unknown(1.1) < 0.05


def test_what_leaves_more_than_a_healthy_rig_does_leaves_something_wherever_it_is() -> None:
    assert unknown(4.0) > 0.95
