# SPDX-License-Identifier: Apache-2.0
"""The normal distribution."""

from typing import Any

from labyrinth_sim.trials import Array


def ndtr(x: Array) -> Any:
    """Its distribution function, as SciPy's, which takes a quarter of a second to import and which few models need."""
    from scipy.special import ndtr as exact

    return exact(x)
