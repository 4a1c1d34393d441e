# SPDX-License-Identifier: Apache-2.0
"""The page's requests, from JSON to values."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from labyrinth_sim.errors import InputError, unknown_name

MOST_TRIALS_ASKED = 1000
MOST_ADDED = 20
LONGEST_NAME = 1000  # characters; the path of a proposed experiment is a name too
LONGEST_REQUEST = 10_000  # characters of a message
LARGEST = 1e12  # size of a number; what JSON calls NaN or Infinity is none
_PARAMETER = re.compile(r"\w{1,60}(\.\w{1,60}){1,3}", re.ASCII)
_EFFECT = re.compile(r"\w{1,60}(\.\w{1,60})?", re.ASCII)


@dataclass(frozen=True)
class ArmRequest:
    """Allows or forbids the page to move the rig."""

    on: bool


@dataclass(frozen=True)
class PlayRequest:
    """Plays a sequence on both sides and records it; trials 0: as the sequence says."""

    sequence: str
    trials: int


@dataclass(frozen=True)
class StopRequest:
    """Stops the current job."""


@dataclass(frozen=True)
class DiagnoseRequest:
    """Asks what the model lacks, by the bags of the last run."""


@dataclass(frozen=True)
class AddRequest:
    """Adds effects to the model, fits them, and has the simulation run the result."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class WhatIfRequest:
    """Simulates the last command of the last run with another value of the model.

    name: full parameter name, "" to end it; value: in the parameter's unit, None for what the model has.
    """

    name: str
    value: float | None


Request = ArmRequest | PlayRequest | StopRequest | DiagnoseRequest | AddRequest | WhatIfRequest


def parse_request(text: str | bytes) -> Request:
    """A message of the page as `{"do": "play", "sequence": "paper_8s", "trials": 3}`.

    Raises:
        InputError: no JSON, an unknown word, a field that is missing or of the wrong kind.
    """
    if len(text) > LONGEST_REQUEST:
        raise InputError(f"A request of {len(text)} characters is too long; at most {LONGEST_REQUEST}.")
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InputError(f"A request must be JSON: {error}.") from error
    except RecursionError as error:
        raise InputError("A request is an object with plain entries; this one is nested too deeply.") from error
    if not isinstance(content, dict) or not isinstance(content.get("do"), str):
        raise InputError('A request must be an object with an entry "do".')
    if content["do"] not in _READERS:
        raise InputError(unknown_name("request", content["do"], _READERS))
    return _READERS[content["do"]](content)


def _play(content: Mapping[str, Any]) -> PlayRequest:
    trials = content.get("trials", 0)
    if isinstance(trials, bool) or not isinstance(trials, int) or not 0 <= trials <= MOST_TRIALS_ASKED:
        raise InputError(f'"trials" must be a whole number from 0 to {MOST_TRIALS_ASKED}, got {trials!r:.200}.')
    return PlayRequest(_word(content, "sequence"), trials)


def _add(content: Mapping[str, Any]) -> AddRequest:
    names = content.get("names")
    if not isinstance(names, list) or not 0 < len(names) <= MOST_ADDED or not all(map(_is_effect, names)):
        raise InputError(f'"names" must be a list of up to {MOST_ADDED} effects as backlash.x, got {names!r:.200}.')
    return AddRequest(tuple(names))


def _arm(content: Mapping[str, Any]) -> ArmRequest:
    if not isinstance(content.get("on"), bool):
        raise InputError(f'"on" must be true or false, got {content.get("on")!r:.200}.')
    return ArmRequest(content["on"])


def _what_if(content: Mapping[str, Any]) -> WhatIfRequest:
    name, value = content.get("name"), content.get("value")
    if name != "" and not (isinstance(name, str) and len(name) <= LONGEST_NAME and _PARAMETER.fullmatch(name)):
        raise InputError(f'"name" must be a parameter as drive.x.p, or "" to end it, got {name!r:.200}.')
    if value is None:
        return WhatIfRequest(name, None)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise InputError(
            f'"value" must be a number below {LARGEST:g}, or null for the model\'s own, got {value!r:.200}.'
        )
    return WhatIfRequest(name, float(value))


def _word(content: Mapping[str, Any], key: str) -> str:
    word = content.get(key)
    if not isinstance(word, str) or not 0 < len(word) <= LONGEST_NAME:
        raise InputError(f'"{key}" must be a name of 1 to {LONGEST_NAME} characters, got {word!r:.200}.')
    return word


def _is_effect(name: object) -> bool:
    return isinstance(name, str) and _EFFECT.fullmatch(name) is not None


_READERS: dict[str, Callable[[Mapping[str, Any]], Request]] = {
    "arm": _arm,
    "play": _play,
    "stop": lambda _: StopRequest(),
    "diagnose": lambda _: DiagnoseRequest(),
    "add": _add,
    "what_if": _what_if,
}
