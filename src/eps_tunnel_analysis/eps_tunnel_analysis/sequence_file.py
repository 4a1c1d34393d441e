# SPDX-License-Identifier: Apache-2.0
"""Reads sequences from config/sequences/*.yaml.

A file holds one `command`, or several under `commands`; each is played `trials` times. Angles are given in degrees
(`to_deg`) or rad (`to`), positions of linear axes in mm (`to_mm`) or m (`to`); other quantities carry their unit in the
key, too (`lasts_s`, `frequency_hz`). With a `ratio` of load over driven angle for a channel, angles are the load's.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, create_model

from eps_tunnel_analysis.sequence import SHAPES, Command, Sequence, Shape
from labyrinth_sim import config
from labyrinth_sim.errors import unknown_name
from labyrinth_sim.yaml_file import Document, Entry, Text, Where, read_yaml, shortened, yaml_text

# Unit of a shape's number -> endings of its key in a file, each with the factor to that unit.
ENDINGS = {
    "rad": {"_deg": math.pi / 180.0, "_mm": 1e-3, "": 1.0},
    "s": {"_s": 1.0},
    "Hz": {"_hz": 1.0},
    "1": {"": 1.0},
}
LONGEST_COMMAND = 4 * 3600.0  # s
MOST_TRIALS_WRITTEN = 10_000


class _Key(Entry):
    noun = "key"


class _SequenceFile(_Key):
    description: Text = ""
    initial_deg: dict[str, float] | None = None
    initial_mm: dict[str, float] | None = None
    initial: dict[str, float] | None = None
    ratio: dict[str, Annotated[float, Field(gt=0.0, le=1e3)]] | None = None
    trials: int = Field(1, ge=1, le=MOST_TRIALS_WRITTEN)
    command: dict[str, Any] | None = None
    commands: dict[str, Any] | None = None


class _ShapeEntry(Entry):
    noun = "number"


def _schema(shape: type[Shape]) -> type[_ShapeEntry]:
    """The numbers of a shape as a file gives them; of a number with several keys each may be left out."""
    numbers: dict[str, Any] = {}
    for item in fields(shape):
        kind: Any = int if item.type in (int, "int") else float
        endings = ENDINGS[item.metadata["unit"]]
        several = len(endings) > 1
        declared = {"json_schema_extra": {"unit": item.metadata["unit"]}, **item.metadata["bounds"]}
        for ending in endings:
            # By alias, for pydantic's models have attributes of their own, `register` say.
            info: Any = Field(None if several else ..., alias=item.name + ending, **declared)
            numbers[f"{item.name}{ending}_number"] = (kind | None if several else kind, info)
    return create_model(shape.word, __base__=_ShapeEntry, **numbers)


_SCHEMAS = {word: _schema(shape) for word, shape in SHAPES.items()}


def load_sequence(path: Path) -> Sequence:
    """Reads one sequence file. Raises InputError with everything that is wrong with it."""
    return _sequence(read_yaml(path), path.stem)


def parse_sequence(data: object, name: str, source: str) -> Sequence:
    """The Sequence in a parsed YAML document. `source` opens each complaint. Raises InputError with all complaints."""
    return _sequence(Document(source, data), name)


def find_sequence(name: str) -> Sequence:
    """The sequence of a file's path, or of a name among config/sequences; `NAME/COMMAND` is that one command of it.

    Raises InputError listing the names.
    """
    stem, slash, part = name.partition("/")
    if not slash or name.endswith((".yaml", ".yml")):
        return load_sequence(config.find("sequences", name))
    sequence = load_sequence(config.find("sequences", stem))
    return replace(sequence, commands=(sequence.command(part),))


def _sequence(document: Document, name: str) -> Sequence:
    entry = document.read(_SequenceFile)
    initial = _initial(document)
    for channel in document.mapping(("ratio",)):
        if channel not in initial:
            document.complain(
                ("ratio", channel), unknown_name("channel", channel, initial) + " They come from initial_deg."
            )
    commands = [_command(document, where, full, initial) for where, full in _commands(document, name)]
    document.check()
    assert entry is not None
    return Sequence(name, entry.description.strip(), tuple(commands), entry.trials)


def _initial(document: Document) -> dict[str, float]:
    """Channel -> target before time zero, rad or m; 0 where the schema has refused it."""
    initial: dict[str, float] = {}
    for ending, factor in ENDINGS["rad"].items():
        key = f"initial{ending}"
        for channel, value in document.mapping((key,)).items():
            if channel in initial:
                document.complain((key, channel), "the channel has an initial target already.")
            usable = isinstance(value, int | float) and math.isfinite(value)
            initial[channel] = float(value) * factor / _ratio(document, channel) if usable else 0.0
    if not initial:
        document.complain(("initial_deg",), "expected a mapping from channel to degrees, got nothing.")
    return initial


def _commands(document: Document, name: str) -> Iterator[tuple[Where, str]]:
    """Where each command is, and its name in full."""
    one, several = document.value(("command",)), document.value(("commands",))
    if (one is None) == (several is None):
        document.complain((), "give either 'command' (one) or 'commands' (several, by name).")
    elif one is not None:
        yield ("command",), name
    elif several == {}:
        document.complain(("commands",), "expected a mapping from name to command, got {}.")
    else:
        yield from ((("commands", key), f"{name}/{key}") for key in document.mapping(("commands",)))


def _command(document: Document, where: Where, name: str, initial: dict[str, float]) -> Command:
    channels = document.mapping(where)
    if not channels:
        document.complain(where, "expected a mapping from channel to a list of shapes.")
    rows: dict[str, tuple[Shape, ...]] = {}
    for channel in channels:
        place = (*where, channel)
        if channel not in initial:
            document.complain(place, unknown_name("channel", channel, initial) + " They come from initial_deg.")
        count = len(document.sequence(place))
        if not count:
            document.complain(place, f"expected a list of shapes, got {shortened(document.value(place))}.")
        shapes = [_shape(document, (*place, i), _ratio(document, channel)) for i in range(count)]
        rows[channel] = tuple(shape for shape in shapes if shape)
        if math.fsum(shape.lasts for shape in rows[channel]) > LONGEST_COMMAND:
            document.complain(place, f"lasts longer than {LONGEST_COMMAND:g} s. Play it in parts.")
    return Command(name, tuple(initial), tuple(initial.values()), tuple(rows.get(c, ()) for c in initial))


def _ratio(document: Document, channel: str) -> float:
    """Angle of the load over that of the target; 1 where none is given, or one that the schema has refused."""
    given = document.mapping(("ratio",)).get(channel, 1.0)
    usable = isinstance(given, int | float) and not isinstance(given, bool) and math.isfinite(given) and given > 0.0
    return float(given) if usable else 1.0


def _shape(document: Document, where: Where, ratio: float) -> Shape | None:
    """One shape, its angles those of the target."""
    value = document.value(where)
    if not isinstance(value, dict) or len(value) != 1:
        text = f"expected one shape such as 'step: {{to_deg: 2, lasts_s: 1}}', got {shortened(value)}."
        document.complain(where, text)
        return None
    word = str(next(iter(value)))
    if word not in SHAPES:
        document.complain((*where, word), unknown_name("shape", word, SHAPES))
        return None
    where = (*where, word)
    entry = document.read(_SCHEMAS[word], where)
    given = entry.model_dump(by_alias=True, exclude_none=True) if entry else {}
    numbers: dict[str, Any] = {}
    for item in fields(SHAPES[word]):
        endings = ENDINGS[item.metadata["unit"]]
        present = [end for end in endings if document.value((*where, item.name + end)) is not None]
        if len(endings) > 1 and len(present) != 1 and isinstance(document.value(where), dict):
            keys = ", ".join(item.name + end for end in endings)
            document.complain(where, f"expected one of {keys}{' and no other' if present else ''}.")
        elif entry:
            number = given[item.name + present[0]]
            size = endings[present[0]] / (ratio if item.metadata["unit"] == "rad" else 1.0)
            numbers[item.name] = number if isinstance(number, int) else number * size
    return SHAPES[word](**numbers) if len(numbers) == len(fields(SHAPES[word])) else None


def sequence_text(command: Command, description: str, trials: int, linear: Collection[str] = ()) -> str:
    """A sequence file that holds one command.

    Args:
        linear: channels of slide joints, whose targets are given in mm; those of the others are in degrees.
    """
    ending = {channel: "_mm" if channel in linear else "_deg" for channel in command.channels}
    data: dict[str, Any] = {"description": description}
    for channel, target in zip(command.channels, command.initial, strict=True):
        data.setdefault(f"initial{ending[channel]}", {})[channel] = _given(target, ending[channel])
    rows = zip(command.channels, command.shapes, strict=True)
    data |= {"trials": trials, "command": {c: [_entry(shape, ending[c]) for shape in row] for c, row in rows if row}}
    return yaml_text(data)


def _entry(shape: Shape, ending: str) -> dict[str, dict[str, float]]:
    body = {}
    for item in fields(shape):
        value, unit = getattr(shape, item.name), item.metadata["unit"]
        end = ending if unit == "rad" else next(iter(ENDINGS[unit]))
        body[item.name + end] = _given(value, end) if unit == "rad" else value
    return {shape.word: body}


def _given(value: float, ending: str) -> float:
    return round(value / ENDINGS["rad"][ending], 6)
