# SPDX-License-Identifier: Apache-2.0
"""Progress of a fit on stderr: a bar for people, or lines for programs."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

if TYPE_CHECKING:
    from eps_tunnel_analysis.fit.evaluations import Progress
    from eps_tunnel_analysis.fit.free import Part
    from eps_tunnel_analysis.fit.study import Bars

LINE_EVERY = 0.2
"""s between two lines"""


@contextmanager
def bars(kind: str) -> "Iterator[Bars | None]":
    """What `calibrate_model` tells its progress to: "bar", "lines" (one JSON object each) or "none"."""
    if kind == "none":
        yield None
        return
    if kind == "lines":
        yield _lines
        return
    open_bars: list[Any] = []

    def new(part: "Part", budget: int) -> "Progress":
        _close(open_bars)
        name = f"axis {part.axis} " if part.axis else ""
        bar: Any = tqdm(
            total=budget, desc=f"{name}evaluations", unit="", file=sys.stderr, dynamic_ncols=True, leave=True
        )
        open_bars.append(bar)

        def show(count: int, best: float) -> None:
            bar.total = max(budget, count)
            bar.set_postfix_str(f"best {best:.6g}", refresh=False)
            bar.update(count - bar.n)

        return show

    try:
        yield new
    finally:
        _close(open_bars)


def _close(open_bars: list[Any]) -> None:
    while open_bars:
        open_bars.pop().close()


def _lines(part: "Part", budget: int) -> "Callable[[int, float], None]":
    last = 0.0

    def show(count: int, best: float) -> None:
        nonlocal last
        if time.monotonic() - last >= LINE_EVERY:
            last = time.monotonic()
            line = {"axis": part.axis, "evaluations": count, "of": max(budget, count), "best": best}
            print(json.dumps(line), file=sys.stderr, flush=True)

    return show
