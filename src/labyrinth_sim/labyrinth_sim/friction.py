# SPDX-License-Identifier: Apache-2.0
"""Dry friction that sets in gradually, for laws of effects."""

import math

import numba
import numpy as np

from labyrinth_sim.effect import Parameter, Values
from labyrinth_sim.trials import Array

TORQUE = Parameter(
    "torque", "N m", 0.0, 3.0, 0.0, 0.2, "0 to a third of what a drive of 10 N m gives at most", span=1.0
)
EITHER_WAY = Parameter(
    "torque", "N m", -3.0, 3.0, 0.0, 0.2, "at most as large as Coulomb friction, of either sign", span=2.0
)
SLOW = Parameter(
    "slow", "rad/s", 0.0, 0.1, None, 0.0, "v_c; faster than that grease would be felt as damping", settled=True
)
SLOWEST = 1e-6  # of the speed at which it sets in; slower, its slope is that at rest


def sharp(values: Values) -> Array:
    """(nsim,) N m: the torque where it acts at any speed, 0 where it sets in gradually."""
    return np.where(values["slow"] > 0.0, 0.0, values["torque"])


@numba.njit  # type: ignore[untyped-decorator]
def gradual_damping(torque: float, speed: float, slow: float) -> float:
    """N m s/rad: torque tanh(|speed| / slow) over |speed|.

    As damping it is taken at the coming speed, so that it is stable at steps of any length.
    """
    ratio = abs(speed) / slow
    return torque / slow * (math.tanh(ratio) / ratio if ratio > SLOWEST else 1.0)
