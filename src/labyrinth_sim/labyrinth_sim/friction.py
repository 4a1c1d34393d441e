# SPDX-License-Identifier: Apache-2.0
"""Dry friction that sets in gradually, for laws of effects."""

import math

import numba

SLOWEST = 1e-6  # of the speed at which it sets in; slower, its slope is that at rest


@numba.njit  # type: ignore[untyped-decorator]
def gradual_damping(torque: float, speed: float, slow: float) -> float:
    """N m s/rad: torque tanh(|speed| / slow) over |speed|.

    As damping it is taken at the coming speed, so that it is stable at steps of any length.
    """
    ratio = abs(speed) / slow
    return torque / slow * (math.tanh(ratio) / ratio if ratio > SLOWEST else 1.0)
