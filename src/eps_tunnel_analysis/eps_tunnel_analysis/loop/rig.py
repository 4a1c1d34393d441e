# SPDX-License-Identifier: Apache-2.0
"""What the loop needs of a rig: to play on it and on its simulation."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol


class RigFailed(Exception):
    """A sequence was not played to its end, or a model not taken over; the text says why."""


@dataclass(frozen=True)
class Bags:
    """What one play left: paths of the bags of either side."""

    real: tuple[Path, ...]
    sim: tuple[Path, ...]


class PlayableRig(Protocol):
    """A rig and its simulation."""

    def play(self, sequence: str, trials: int, folder: Path) -> Bags:
        """Plays a sequence, by name or path, on both sides and records it into `folder`. Raises RigFailed."""

    def load(self, model: Path) -> None:
        """Has the simulation take over a model file. Raises RigFailed."""

    def limit(self) -> float:
        """The largest angle, rad, that may be commanded."""

    def tell(self, content: Mapping[str, Any], report: Path) -> None:
        """Makes a verdict known, as diagnosis.json holds it."""
