# SPDX-License-Identifier: Apache-2.0
"""Where a model was shown to hold: the section `valid` of its file."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from pydantic import Field

from labyrinth_sim.errors import unknown_name
from labyrinth_sim.rig import Rig
from labyrinth_sim.yaml_file import Document, Entry, Text, Where


@dataclass(frozen=True)
class ShownSignal:
    """One signal of the recordings by which a model was judged.

    Attributes:
        unit: of the signal.
        low, high: what it went through, in that unit.
        speed: largest, in that unit per second; None of what is no position.
        error: E of equation 10 there, in that unit; None where it was not compared.
    """

    unit: str
    low: float
    high: float
    speed: float | None = None
    error: float | None = None


@dataclass(frozen=True)
class Validity:
    """The ranges over which a model was shown to hold.

    Attributes:
        signals: positions as recorded, and the drives' efforts as the model gives them.
        held_out: names of the recordings that were not fitted, whose errors the signals state; empty where the errors
            are those of what was fitted.
        recordings: all of them, with their dates where they are known.
    """

    signals: Mapping[str, ShownSignal]
    held_out: tuple[str, ...]
    recordings: tuple[str, ...]

    def to_yaml(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "signals": {
                name: {key: value for key, value in asdict(shown).items() if value is not None}
                for name, shown in self.signals.items()
            },
            "held_out": list(self.held_out),
            "recordings": list(self.recordings),
        }


NotNegative = Annotated[float, Field(ge=0.0)]


class _ShownEntry(Entry):
    noun = "key"
    unit: Text
    low: float
    high: float
    speed: NotNegative | None = None
    error: NotNegative | None = None


class _ValidEntry(Entry):
    noun = "key"
    signals: dict[str, Any]
    held_out: list[Text] | None = None
    recordings: list[Text] | None = None


def read_validity(document: Document, rig: Rig, where: Where = ("valid",)) -> Validity | None:
    """The section of a model's file; None where there is none, and, with complaints, where it does not fit."""
    if not isinstance(document.value(where), dict):
        return None
    entry = document.read(_ValidEntry, where)
    units = dict(zip(rig.signals, rig.units, strict=True))
    signals = {}
    for name in document.mapping((*where, "signals")):
        place = (*where, "signals", name)
        if name not in units:
            document.complain(place, unknown_name("signal", name, units))
            continue
        shown = document.read(_ShownEntry, place)
        if shown is None:
            continue
        if shown.unit != units[name]:
            document.complain((*place, "unit"), f"{name} is measured in {units[name]}, got unit '{shown.unit:.60}'.")
        if shown.low > shown.high:
            document.complain(place, f"'low' must not lie above 'high', got {shown.low:g} and {shown.high:g}.")
        signals[name] = ShownSignal(**shown.model_dump())
    return Validity(signals, tuple(entry.held_out or ()), tuple(entry.recordings or ())) if entry else None
