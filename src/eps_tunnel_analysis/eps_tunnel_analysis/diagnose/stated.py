# SPDX-License-Identifier: Apache-2.0
"""What is expected of a value that a model states: to be near it, unless what is stated is simply wrong.

Student's t distribution (Lange, Little, Taylor: Robust statistical modeling using the t distribution, Journal of the
American Statistical Association 84, 1989): near the stated value it is like a Gaussian, and far from it a value that is
off by twice as much is hardly less likely.
"""

import numpy as np

from eps_tunnel_analysis.diagnose.settings import SETTINGS
from labyrinth_sim.trials import Array


def strain_of(off: Array) -> Array:
    """Minus twice the logarithm of the likelihood of values, from their deviations in units of what is expected."""
    return np.asarray((SETTINGS.tails + 1.0) * np.log1p(off**2 / SETTINGS.tails))


def residual_of(off: Array) -> Array:
    """The same as residuals, whose squares add up to it."""
    return np.asarray(np.sign(off) * np.sqrt(strain_of(off)))


def weight_of(off: Array) -> Array:
    """By how much less firmly a value that is off is held than a Gaussian would hold it."""
    return np.asarray((SETTINGS.tails + 1.0) / (SETTINGS.tails + off**2))
