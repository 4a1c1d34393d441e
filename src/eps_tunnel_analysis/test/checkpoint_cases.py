# SPDX-License-Identifier: Apache-2.0
"""A small fit by every method, as a process that waits at a given evaluation to be killed."""

import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from fit_cases import plays, start

from eps_tunnel_analysis.calibration.calibrate import Fit, Settings, calibrate
from eps_tunnel_analysis.fit.methods import CmaEs, EvolutionStrategy, GaussNewton

METHODS = {
    "es": EvolutionStrategy(offspring=8, generations=5),
    "cma": CmaEs(budget=40),
    "gauss-newton": GaussNewton(scouts=8, starts=2, rounds=4, passes=1),
}
FREE = ("drive.x.p", "drive.x.delay")


def fit(method: str, journal: Path | None = None, progress: Callable[[int, float], None] | None = None) -> Fit:
    settings = Settings(method=METHODS[method], seed=3, signals=("motor_x",), held_out=(1,), nthread=1, journal=journal)
    return calibrate(start(), FREE, plays((-3.0, 4.0), trials=2), settings, progress)


def fit_until(method: str, journal: Path, count: int, ready: Connection) -> None:
    """Fits until `count` evaluations are done, says so, and waits; sends the result where it comes to one."""
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def wait(done: int, _: float) -> None:
        if done >= count:
            ready.send(done)
            signal.pause()

    result = fit(method, journal, wait)
    ready.send((result.interrupted, result.evaluations))
