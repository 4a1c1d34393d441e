# SPDX-License-Identifier: Apache-2.0
"""Work on a Dask cluster: the rows of a batch distributed among its workers, or one task per item.

Workers need this software and the rig's files at the same paths. An evaluation is a pure function of its values, so
where it runs, with which other rows, and how often (the share of a worker that dies is repeated) changes no bit.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from eps_tunnel_analysis.fit.problem import Residuals
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

ROWS_EACH = 8  # rows of a batch that a worker gets at least; fewer would be all overhead
RETRIES = 5  # workers that may die over one share before it is given up
CONNECT_S = 20.0
Spread = Callable[[Residuals], Residuals]
"""Turns a residual function into an equivalent one whose rows are evaluated elsewhere."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def connected(address: str, timeout: float = CONNECT_S) -> Iterator[Any]:
    """A `distributed.Client` of a scheduler.

    Args:
        address: as `tcp://host:8786`.
        timeout: s to wait for the scheduler.

    Raises:
        InputError: no scheduler answers, no worker is there, or `distributed` is not installed.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs the package 'distributed'; install those of requirements.txt.") from error
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no scheduler ({type(error).__name__}). Start one with `dask scheduler` and "
            f"workers with `dask worker {address}`, then name it as tcp://HOST:PORT."
        ) from error
    try:
        workers = len(client.scheduler_info()["workers"])
        if workers == 0:
            raise InputError(f"--scheduler {address}: it has no workers. Start some: `dask worker {address}`.")
        yield client
    finally:
        client.close()


@contextmanager
def cluster(address: str, timeout: float = CONNECT_S) -> Iterator[Spread]:
    """Connects to a scheduler; gives a wrapper that turns a residual function into one evaluated there.

    Args, Raises: as `connected`.
    """
    with connected(address, timeout) as client:

        def spread(residuals: Residuals) -> Residuals:
            return _Spread(client, residuals)

        yield spread


def each(client: Any, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """The result of `work` for each item, one task each, in order of completion."""
    from distributed import as_completed

    futures = client.map(work, list(items), retries=RETRIES, pure=False)
    for done in as_completed(futures, loop=client.loop):
        yield done.result()
        done.release()


class _Spread:
    """A residual function whose rows are distributed among the workers."""

    def __init__(self, client: Any, residuals: Residuals) -> None:
        self._client, self._residuals = client, residuals
        # Scattered data dies with the worker that holds it; a submitted constant is made anew.
        self._there = client.submit(_same, residuals, retries=RETRIES, pure=False)

    def __call__(self, values: Array) -> Array:
        if len(values) < ROWS_EACH:
            return self._residuals(values)  # faster here than sending it
        threads = max(1, sum(self._client.nthreads().values()))
        count = max(1, min(threads, -(-len(values) // ROWS_EACH)))
        futures = self._client.map(
            _part, np.array_split(values, count), residuals=self._there, retries=RETRIES, pure=False
        )
        return np.concatenate(self._client.gather(futures))


def _same(residuals: Residuals) -> Residuals:
    return residuals


def _part(values: Array, residuals: Residuals) -> Array:
    return residuals(values)
