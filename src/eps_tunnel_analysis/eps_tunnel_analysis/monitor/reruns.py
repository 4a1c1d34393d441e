# SPDX-License-Identifier: Apache-2.0
"""Simulates the last command of a run again while a value of the model is moved, in a thread of its own."""

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.monitor.parts import Adjustables, Before, GapPart, WhatIfPart
from eps_tunnel_analysis.monitor.state import BEFORE, COLLECTING, LEAST_TRIALS, SIMULATED, UNSEEN, State, told_rows
from eps_tunnel_analysis.outputs import shown_number
from eps_tunnel_analysis.values.what_if import Adjustable, WhatIf, WhatIfAnswer, adjustable
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import load_model


@dataclass(frozen=True)
class _Wanted:
    """A value to move over some recordings; `turn` tells whether it was ended meanwhile."""

    bags: tuple[Path, ...]
    model: str
    adjustable: Adjustable
    value: float | None
    turn: int


class Reruns:
    """Of several requests that wait only the newest is done. May be used from any thread."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._lock = threading.Lock()
        self._threads = ThreadPoolExecutor(1, "rerun")
        self._bags, self._model = tuple[Path, ...](), ""
        self._offered = dict[str, Adjustable]()
        self._wanted: _Wanted | None = None
        self._turn = self._number = 0
        # Of the worker's thread alone:
        self._prepared: tuple[tuple[Path, ...], str, WhatIf] | None = None

    def use(self, bags: Sequence[Path], model: str) -> None:
        """From now on it is about these recordings and this model; about nothing where one of them is missing.

        Raises:
            InputError: the model cannot be read.
        """
        offered = adjustable(load_model(model)) if bags and model else ()
        with self._lock:
            self._bags, self._model = tuple(bags), model
            self._offered = {a.name: a for a in offered}
        self.end()
        self._state.put(Adjustables(offered))

    def ask(self, name: str, value: float | None) -> None:
        """Moves a value, None to what the model has; the answer is shown in the state, a complaint in its log.

        Raises:
            InputError: nothing is recorded yet, or the name is not offered.
        """
        with self._lock:
            if not self._offered:
                raise InputError("Play a sequence first: a value is moved over the recordings of the last run.")
            if name not in self._offered:
                raise InputError(unknown_name("parameter", name, self._offered))
            self._wanted = _Wanted(self._bags, self._model, self._offered[name], value, self._turn)
        self._threads.submit(self._next)

    def end(self) -> None:
        """Shows no answer any more, nor one that is under way."""
        with self._lock:
            self._wanted = None
            self._turn += 1
            self._state.show_what_if(WhatIfPart(), None)

    def close(self) -> None:
        """Waits until the one under way is done."""
        with self._lock:
            self._wanted = None
        self._threads.shutdown()

    def _next(self) -> None:
        with self._lock:
            wanted, self._wanted = self._wanted, None
        if wanted is None:
            return
        try:
            prepared = self._prepare(wanted)
            changed = None if wanted.value is None else prepared.with_value(wanted.adjustable.name, wanted.value)
            table = _table(prepared, changed)
        except Exception as error:  # a thread that died silently would leave the page waiting for ever
            known = isinstance(error, InputError | OSError)
            self._state.note(str(error) if known else f"It failed: {error!r}.", "error")
            return
        with self._lock:
            if wanted.turn == self._turn:
                self._number += 1
                part = _part(prepared, changed, wanted, self._number)
                self._state.show_what_if(part, {**table, "number": self._number})

    def _prepare(self, wanted: _Wanted) -> WhatIf:
        """Raises InputError."""
        if self._prepared is None or self._prepared[:2] != (wanted.bags, wanted.model):
            recorded = load_recorded(wanted.model, wanted.bags)
            self._prepared = (wanted.bags, wanted.model, WhatIf(recorded.model, recorded.plays[-1]))
        return self._prepared[2]


def _part(prepared: WhatIf, changed: WhatIfAnswer | None, wanted: _Wanted, number: int) -> WhatIfPart:
    moved, name, shown = wanted.adjustable, prepared.model.name, changed or prepared.given
    value = moved.given if wanted.value is None else wanted.value
    model = f"{name} with {moved.name} {shown_number(value, 4)} {moved.unit}".removesuffix(" 1") if changed else name
    gap = GapPart(
        model=model,
        signals=prepared.tunnel.signals,
        ks=prepared.ks,
        shares=tuple(tuple(a.shares[s] for a in shown.alikeness) for s in prepared.tunnel.signals),
        joint=tuple(a.joint for a in shown.alikeness),
        rig=tuple(one.joint for one in prepared.itself),
        rig_shares=tuple(tuple(one.shares[s] for one in prepared.itself) for s in prepared.tunnel.signals),
        samples=len(prepared.tunnel.time),
        trials=prepared.tunnel.trials,
    )
    before = Before(name, prepared.ks, tuple(a.joint for a in prepared.given.alikeness)) if changed else None
    return WhatIfPart(moved.name, moved.unit, value, moved.given, prepared.play.name, gap, before, number)


def _table(prepared: WhatIf, changed: WhatIfAnswer | None) -> dict[str, Any]:
    """The trajectories as `TunnelTable.changes` tells them; beside the changed one that of the model as it is."""
    tunnel, shown = prepared.tunnel, changed or prepared.given
    values = np.full((*tunnel.mean.shape, 5), np.nan)
    values[..., :SIMULATED] = np.stack([tunnel.mean, *tunnel.bounds()], axis=-1)
    values[..., SIMULATED] = shown.simulated
    if changed:
        values[..., BEFORE] = prepared.given.simulated
    least = shown.alikeness[0]
    judged = least.alike.astype(np.int8) if tunnel.trials >= LEAST_TRIALS else COLLECTING
    inside = np.where(least.seen, judged, UNSEEN).astype(np.int8)
    return {
        "key": "what if", "signals": list(tunnel.signals), "step": tunnel.step, "duration": float(tunnel.time[-1]),
        "whole": True, "rows": told_rows(range(len(tunnel.time)), values, inside),
    }  # fmt: skip
