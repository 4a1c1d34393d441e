# SPDX-License-Identifier: Apache-2.0
"""How far a run is, and a bar that shows it."""

import sys
from dataclasses import dataclass
from types import TracebackType

from tqdm import tqdm


@dataclass(frozen=True)
class Progress:
    """trial: from 0, over all commands; phase: returning, settling, playing or recording; share: 0..1; time_left: s."""

    trial: int
    trials: int
    phase: str
    share: float
    time_left: float


class ProgressBar:
    """A bar on stderr, from 0 to 100 %; where that is no terminal, a line at each change of phase."""

    def __init__(self) -> None:
        self._told = ""
        self._bar = tqdm(
            total=100,
            bar_format="{desc}{percentage:3.0f}% |{bar}|{postfix}",
            file=sys.stderr,
            dynamic_ncols=True,
            leave=True,
            disable=None,  # where stderr is no terminal
        )

    def __enter__(self) -> "ProgressBar":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    def show(self, progress: Progress) -> None:
        doing = f"trial {progress.trial + 1}/{progress.trials} {progress.phase}"
        left = f"{progress.time_left:.0f} s left"
        if not self._bar.disable:
            self._bar.set_description_str(f"{doing:25}", refresh=False)
            self._bar.set_postfix_str(left, refresh=False)
            self._bar.update(100 * progress.share - self._bar.n)
        elif doing != self._told:
            print(f"{doing}, {100 * progress.share:.0f} %, {left}", file=sys.stderr, flush=True)
        self._told = doing
