# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can act on.

ValueError
└── InputError          bad input: files, names, values, shapes
RuntimeError
└── HardwareError       the rig does not answer as it should
    ├── PortError       a serial port is missing, in use or gone
    ├── BusError        a servo is missing, another model, or answers wrongly
    └── SensorError     the sensor line is silent or speaks another protocol
"""

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(ValueError):
    """Everything wrong with one input, all complaints together.

    Args:
        complaints: one sentence each: what came, what was expected, what to try.
    """

    def __init__(self, complaints: str | Iterable[str]) -> None:
        self.complaints: tuple[str, ...] = (complaints,) if isinstance(complaints, str) else tuple(complaints)
        super().__init__("\n".join(self.complaints))


class HardwareError(RuntimeError):
    """The rig does not answer as it should."""


class PortError(HardwareError):
    """A serial port is missing, in use or gone."""


class BusError(HardwareError):
    """A servo is missing, is another model, or answers wrongly."""


class SensorError(HardwareError):
    """The sensor line is silent or speaks another protocol."""


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> str:
    """A complaint about an unknown name, with the nearest valid one and the whole list."""
    names = sorted(valid)
    near = get_close_matches(name, names, n=1)
    hint = f" Did you mean '{near[0]}'?" if near else ""
    listing = ", ".join(names) if names else "(there are none)"
    return f"Unknown {kind} '{name}'.{hint} Available {kind} names: {listing}."
