# SPDX-License-Identifier: Apache-2.0
"""Which commands are kept from the fit, to judge it afterwards."""

from collections.abc import Sequence

import numpy as np

from eps_tunnel_analysis.plays import Play
from labyrinth_sim.errors import InputError

SHARE = 0.2
"""held out unless told otherwise, rounded down: nothing of fewer than five commands"""


def hold_out(plays: Sequence[Play], amount: float | None, seed: int) -> tuple[int, ...]:
    """Numbers of the plays to hold out, drawn at random.

    Whole commands, never single trials: trials of one command repeat each other but for noise, so a model that was
    fitted to some of them has as good as seen the others.

    Args:
        amount: a number of plays if 1 or more, a share of them if below 1, rounded to at least one; None for SHARE.

    Raises:
        InputError: it would leave no play to fit.
    """
    count = len(plays)
    number = int(SHARE * count) if amount is None else int(amount) if amount >= 1 else round(amount * count)
    if amount is not None and 0.0 < amount < 1.0:
        number = max(number, 1)
    if number >= count:
        raise InputError(
            f"Cannot hold out {number} of {count} commands ({', '.join(p.name for p in plays)}): at least one must "
            "be left to fit. Record more commands, or hold out none (0)."
        )
    return tuple(sorted(int(i) for i in np.random.default_rng([seed, 1]).choice(count, number, replace=False)))
