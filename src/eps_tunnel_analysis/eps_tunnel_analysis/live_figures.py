# SPDX-License-Identifier: Apache-2.0
"""What is told of the gap while it is measured: the samples just judged, and the shares so far."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.tunnel import Tunnel
from labyrinth_sim.trials import Array


@dataclass(frozen=True)
class Judged:
    """Samples judged for the first time: the tunnel of reality and the simulation in it.

    Attributes:
        real: of the real trials so far, the running one included.
        simulated: (n, m) mean of the simulated trials.
        alike: (n, m) at k = 1.
        stamp: ns, of the last of the samples in the running trial.
    """

    real: Tunnel
    simulated: Array
    alike: NDArray[np.bool_]
    stamp: int


@dataclass(frozen=True)
class Figures:
    """Shares of alike samples (equation 7) of one command so far.

    Attributes:
        command: its name.
        signals: m names.
        ks: n factors of the real tunnel.
        shares: (m, n); NaN for a signal not seen on both sides.
        joint: (n,) of samples alike in every signal.
        samples: N, how many samples were judged.
        trials: how many real trials form the tunnel, the running one included.
        complete: whether no trial is running.
    """

    command: str
    signals: tuple[str, ...]
    ks: tuple[float, ...]
    shares: Array
    joint: Array
    samples: int
    trials: int
    complete: bool
