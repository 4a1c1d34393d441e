# SPDX-License-Identifier: Apache-2.0
"""The same evaluations on a Dask cluster.

Workers need this software and the rig's files at the same paths. An evaluation is a pure function of its values, so
where it runs, in what company, and how often (a worker that dies has its share done again) changes no bit.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from eps_tunnel_analysis.fit.problem import Residuals
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

SHARE = 8  # rows of a batch that a worker gets at least; fewer would be all overhead
RETRIES = 5  # deaths of a worker over one share before it is given up
CONNECT_S = 20.0


@contextmanager
def cluster(address: str, timeout: float = CONNECT_S) -> Iterator[Callable[[Residuals], Residuals]]:
    """Connects to a scheduler; gives what turns a residual function into one whose work is done there.

    Args:
        address: as `tcp://host:8786`.
        timeout: s to wait for the scheduler.

    Raises:
        InputError: nobody answers, no worker is there, or `distributed` is not installed.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs the package 'distributed'; install what requirements.txt names.") from error
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: nobody answers ({type(error).__name__}). Start one with `dask scheduler` and "
            f"workers with `dask worker {address}`, then name it as tcp://HOST:PORT."
        ) from error
    try:
        workers = len(client.scheduler_info()["workers"])
        if workers == 0:
            raise InputError(f"--scheduler {address}: it has no workers. Start some: `dask worker {address}`.")

        def spread(residuals: Residuals) -> Residuals:
            return _Spread(client, residuals)

        yield spread
    finally:
        client.close()


class _Spread:
    """A residual function whose rows are shared out among the workers."""

    def __init__(self, client: Any, residuals: Residuals) -> None:
        self._client = client
        # Scattered data dies with the worker that holds it; a submitted constant is made anew.
        self._there = client.submit(_same, residuals, retries=RETRIES, pure=False)

    def __call__(self, values: Array) -> Array:
        threads = max(1, sum(self._client.nthreads().values()))
        count = max(1, min(threads, -(-len(values) // SHARE)))
        futures = self._client.map(
            _part, np.array_split(values, count), residuals=self._there, retries=RETRIES, pure=False
        )
        return np.concatenate(self._client.gather(futures))


def _same(residuals: Residuals) -> Residuals:
    return residuals


def _part(values: Array, residuals: Residuals) -> Array:
    return residuals(values)
