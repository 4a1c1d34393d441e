# SPDX-License-Identifier: Apache-2.0
"""What the page may ask for, from JSON to values."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from labyrinth_sim.errors import InputError, unknown_name

MOST_TRIALS = 1000
LONGEST = 10_000  # characters of a message


@dataclass(frozen=True)
class Arm:
    """Allows the page to move the rig, or no longer."""

    on: bool


@dataclass(frozen=True)
class Play:
    """Plays a sequence on both sides and records it; trials 0: as the sequence says."""

    sequence: str
    trials: int


@dataclass(frozen=True)
class Stop:
    """Stops whatever is under way."""


@dataclass(frozen=True)
class Diagnose:
    """Asks what the model lacks, by the bags of the last run."""


@dataclass(frozen=True)
class Add:
    """Adds effects to the model, fits them, and has the simulation run the result."""

    names: tuple[str, ...]


Request = Arm | Play | Stop | Diagnose | Add


def parse_request(text: str | bytes) -> Request:
    """A message of the page as `{"do": "play", "sequence": "paper_8s", "trials": 3}`.

    Raises:
        InputError: no JSON, an unknown word, a field that is missing or of the wrong kind.
    """
    if len(text) > LONGEST:
        raise InputError(f"A request of {len(text)} characters is too long; at most {LONGEST}.")
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InputError(f"A request must be JSON: {error}.") from error
    if not isinstance(content, dict) or not isinstance(content.get("do"), str):
        raise InputError('A request must be an object with an entry "do".')
    if content["do"] not in _READERS:
        raise InputError(unknown_name("request", content["do"], _READERS))
    return _READERS[content["do"]](content)


def _play(content: Mapping[str, Any]) -> Play:
    trials = content.get("trials", 0)
    if isinstance(trials, bool) or not isinstance(trials, int) or not 0 <= trials <= MOST_TRIALS:
        raise InputError(f'"trials" must be a whole number from 0 to {MOST_TRIALS}, got {trials!r}.')
    return Play(_word(content, "sequence"), trials)


def _add(content: Mapping[str, Any]) -> Add:
    names = content.get("names")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) and n for n in names):
        raise InputError(f'"names" must be a list of effects as backlash.x, got {names!r}.')
    return Add(tuple(names))


def _arm(content: Mapping[str, Any]) -> Arm:
    if not isinstance(content.get("on"), bool):
        raise InputError(f'"on" must be true or false, got {content.get("on")!r}.')
    return Arm(content["on"])


def _word(content: Mapping[str, Any], key: str) -> str:
    word = content.get(key)
    if not isinstance(word, str) or not word:
        raise InputError(f'"{key}" must be a name, got {word!r}.')
    return word


_READERS: dict[str, Callable[[Mapping[str, Any]], Request]] = {
    "arm": _arm,
    "play": _play,
    "stop": lambda _: Stop(),
    "diagnose": lambda _: Diagnose(),
    "add": _add,
}
