# SPDX-License-Identifier: Apache-2.0
"""All that the page shows, with what changed since when; written by one thread, read by another."""

import math
import threading
import time
from dataclasses import asdict
from typing import Any

from eps_tunnel_analysis.monitor.parts import Log, Part
from eps_tunnel_analysis.monitor.tunnel_table import TunnelTable

KEPT = 30  # entries of the log


class State:
    """The newest part of each kind, and the tunnel table; every change gets a number greater than all before."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._parts: dict[str, tuple[int, Part]] = {}
        self._table = TunnelTable()
        self._revision = 0

    def put(self, part: Part) -> None:
        """Replaces the part of this kind; one that says the same as before is no change."""
        with self._lock:
            self._put(part)

    def note(self, text: str, level: str = "info") -> None:
        """Adds an entry to the log; level "error" is for what the user should see at once."""
        with self._lock:
            known = self._parts.get("log")
            entries = known[1].entries if known is not None and isinstance(known[1], Log) else ()
            number = entries[-1][0] + 1 if entries else 0
            self._put(Log((*entries, (number, time.time(), level, text))[-KEPT:]))

    def tunnel(self) -> "_Locked":
        """The tunnel table, to be used in a `with` statement."""
        return _Locked(self)

    def changes(self, seen: int) -> tuple[dict[str, Any], int]:
        """What changed after revision `seen` as plain values, NaN as None, and the revision now. All, from -1."""
        with self._lock:
            content: dict[str, Any] = {
                key: plain(asdict(part)) for key, (revision, part) in self._parts.items() if revision > seen
            }
            table = self._table.changes(seen)
            if table:
                content["tunnel"] = table
            return content, self._revision

    def _put(self, part: Part) -> None:
        key = type(part).__name__.lower()
        known = self._parts.get(key)
        if known is None or known[1] != part:
            self._revision += 1
            self._parts[key] = (self._revision, part)


class _Locked:
    """Lends the table while nobody else reads, and numbers the change."""

    def __init__(self, state: State) -> None:
        self._state = state

    def __enter__(self) -> TunnelTable:
        self._state._lock.acquire()
        self._state._revision += 1
        self._state._table.revision = self._state._revision
        return self._state._table

    def __exit__(self, *_: object) -> None:
        self._state._lock.release()


def plain(content: Any) -> Any:
    """Dicts, lists, words and finite numbers; what is not finite becomes None."""
    if isinstance(content, dict):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    return content
