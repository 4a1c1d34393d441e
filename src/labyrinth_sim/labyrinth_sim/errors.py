# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can act on.

ValueError
└── InputError          bad input: files, names, values, shapes
"""

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from typing import TypeVar

T = TypeVar("T")
LONGEST_NAME = 200  # characters of an unknown name that are shown


class InputError(ValueError):
    """All errors in one input.

    Args:
        complaints: one sentence each: what came, what was expected, what to try.
    """

    def __init__(self, complaints: str | Iterable[str]) -> None:
        self.complaints: tuple[str, ...] = (complaints,) if isinstance(complaints, str) else tuple(complaints)
        super().__init__("\n".join(self.complaints))


class Complaints:
    """Collects the errors of several inputs, so that all are reported at once."""

    def __init__(self) -> None:
        self._found: list[str] = []

    def attempt(self, load: Callable[[], T]) -> T | None:
        """What `load` returns; None where it raises InputError, whose complaints are kept."""
        try:
            return load()
        except InputError as error:
            self._found += error.complaints
            return None

    def check(self) -> None:
        """Raises InputError with every complaint once, if there are any."""
        if self._found:
            raise InputError(dict.fromkeys(self._found))


def unknown_name(kind: str, name: str, valid: Iterable[str]) -> str:
    """A complaint about an unknown name, with the nearest valid one and the whole list."""
    names: Sequence[str] = sorted(valid)
    name = name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 3]}..."
    near = get_close_matches(name, names, n=1)
    hint = f" Did you mean '{near[0]}'?" if near else ""
    listing = ", ".join(names) if names else "(there are none)"
    return f"Unknown {kind} '{name}'.{hint} Available {kind} names: {listing}."
