# SPDX-License-Identifier: Apache-2.0
"""The page's requests, from JSON to values, checked by pydantic."""

import json
from dataclasses import dataclass
from typing import Annotated, Any, get_type_hints

from pydantic import Field, TypeAdapter, ValidationError

from labyrinth_sim.errors import InputError, unknown_name

MOST_TRIALS_ASKED = 1000
MOST_ADDED = 20
LONGEST_NAME = 1000  # characters; the path of a proposed experiment is a name too
LONGEST_REQUEST = 10_000  # characters of a message
LARGEST = 1e12  # size of a number; what JSON calls NaN or Infinity is none
WORD = "[A-Za-z0-9_]{1,60}"


def _field(what: str, **checks: Any) -> Any:
    """A field that must be `what`, as a complaint says it."""
    return Field(description=what, **checks)


@dataclass(frozen=True)
class ArmRequest:
    """Allows or forbids the page to move the rig."""

    on: Annotated[bool, _field("true or false", strict=True)]


@dataclass(frozen=True)
class PlayRequest:
    """Plays a sequence on both sides and records it; trials 0: as the sequence says."""

    sequence: Annotated[str, _field(f"a name of 1 to {LONGEST_NAME} characters", min_length=1, max_length=LONGEST_NAME)]
    trials: Annotated[
        int, _field(f"a whole number from 0 to {MOST_TRIALS_ASKED}", ge=0, le=MOST_TRIALS_ASKED, strict=True)
    ] = 0


@dataclass(frozen=True)
class StopRequest:
    """Stops the current job."""


@dataclass(frozen=True)
class DiagnoseRequest:
    """Asks what the model lacks, by the bags of the last run."""


@dataclass(frozen=True)
class AddRequest:
    """Adds effects to the model, fits them, and has the simulation run the result."""

    names: Annotated[
        tuple[Annotated[str, Field(pattern=rf"^{WORD}(\.{WORD})?$")], ...],
        _field(f"a list of up to {MOST_ADDED} effects as backlash.x", min_length=1, max_length=MOST_ADDED),
    ]


@dataclass(frozen=True)
class WhatIfRequest:
    """Simulates the last command of the last run with another value of the model.

    name: full parameter name, "" to end it; value: in the parameter's unit, None for what the model has.
    """

    name: Annotated[str, _field('a parameter as drive.x.p, or "" to end it', pattern=rf"^({WORD}(\.{WORD}){{1,3}})?$")]
    value: Annotated[
        float | None,
        _field(f"a number below {LARGEST:g}, or null for the model's own", gt=-LARGEST, lt=LARGEST, strict=True),
    ] = None


Request = ArmRequest | PlayRequest | StopRequest | DiagnoseRequest | AddRequest | WhatIfRequest
REQUESTS: dict[str, type[Request]] = {
    "arm": ArmRequest,
    "play": PlayRequest,
    "stop": StopRequest,
    "diagnose": DiagnoseRequest,
    "add": AddRequest,
    "what_if": WhatIfRequest,
}


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
    if content["do"] not in REQUESTS:
        raise InputError(unknown_name("request", content["do"], REQUESTS))
    kind = REQUESTS[content["do"]]
    try:
        return TypeAdapter[Request](kind).validate_python(content)
    except ValidationError as error:
        fields = get_type_hints(kind, include_extras=True)
        wrong = dict.fromkeys(str(one["loc"][0]) for one in error.errors())
        raise InputError(
            [f'"{n}" must be {fields[n].__metadata__[0].description}, got {content.get(n)!r:.200}.' for n in wrong]
        ) from error
