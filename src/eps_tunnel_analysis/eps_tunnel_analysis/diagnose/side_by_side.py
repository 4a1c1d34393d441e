# SPDX-License-Identifier: Apache-2.0
"""Axes that are searched at the same time: the roll-outs of one alone are too few to keep all CPUs busy."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from threading import Event
from typing import TypeVar

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions

Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Stopped(Exception):
    """The search is no longer wanted."""


def side_by_side(
    search: Callable[[Item, SearchOptions], Answer], items: Sequence[Item], run: SearchOptions
) -> list[Answer]:
    """What a search finds of each item, in their order; the answers do not depend on how many run at once.

    An error, or Ctrl-C, in one ends the others at their next roll-outs.
    """
    if len(items) < 2 or (run.nthread or os.cpu_count() or 1) < 2:
        return [search(item, run) for item in items]
    stop = Event()

    def progress(what: str, count: int) -> None:
        if stop.is_set():
            raise Stopped
        if run.progress:
            run.progress(what, count)

    watched = replace(run, progress=progress)

    def one(item: Item) -> Answer:
        try:
            return search(item, watched)
        except BaseException:
            stop.set()
            raise

    with ThreadPoolExecutor(len(items)) as pool:
        futures = [pool.submit(one, item) for item in items]
        try:
            wait(futures)
        except BaseException:  # Ctrl-C comes here
            stop.set()
            raise
    errors = [error for future in futures if (error := future.exception())]
    if errors:
        raise min(errors, key=lambda error: isinstance(error, Stopped))
    return [future.result() for future in futures]
