# SPDX-License-Identifier: Apache-2.0
"""Reads sequences from config/sequences/*.yaml.

A file holds one `command`, or several under `commands`; each is played `trials` times. Angles stand in degrees
(`to_deg`) or rad (`to`), other quantities carry their unit in the key too (`lasts_s`, `frequency_hz`).
"""

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import yaml

from eps_tunnel_analysis.sequence import Command, Sequence
from eps_tunnel_analysis.sequence_shapes import SHAPES, Shape
from labyrinth_sim import config
from labyrinth_sim.errors import InputError, unknown_name

SUFFIXES = {"s": "_s", "Hz": "_hz", "rad": "_deg", "1": ""}
KEYS = ("description", "initial_deg", "trials", "command", "commands")
_BOUNDS = {"above": "above", "least": "at least", "most": "at most"}


def load_sequence(path: Path) -> Sequence:
    """Reads one sequence file. Raises InputError with everything that is wrong with it."""
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), Loader=_UniqueKeys)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}). Give the path of a sequence file.") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid YAML: {error}") from error
    return parse_sequence(document, path.stem, str(path))


def parse_sequence(document: object, name: str, source: str) -> Sequence:
    """The Sequence in a parsed YAML document. `source` opens each complaint. Raises InputError with all complaints."""
    parser = _Parser(source)
    sequence = parser.sequence(document, name)
    if parser.complaints or sequence is None:
        raise InputError(parser.complaints)
    return sequence


def find_sequence(name: str) -> Sequence:
    """The sequence of a file's path, or of a name among config/sequences; `NAME/COMMAND` is that one command of it.

    Raises InputError listing the names.
    """
    stem, slash, part = name.partition("/")
    if not slash or name.endswith((".yaml", ".yml")):
        return load_sequence(config.find("sequences", name))
    sequence = load_sequence(config.find("sequences", stem))
    return replace(sequence, commands=(sequence.command(part),))


class _UniqueKeys(yaml.SafeLoader):
    """Refuses a key given twice, where YAML would silently keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"key '{key.value}' stands here twice", problem_mark=key.start_mark)
            seen.add(key.value)
        return dict(super().construct_mapping(node, deep))


class _Parser:
    """Collects complaints while it reads, so that all of them can be told at once."""

    def __init__(self, source: str) -> None:
        self.source, self.complaints = source, list[str]()

    def complain(self, where: str, message: str) -> None:
        self.complaints.append(f"{self.source}: {where}: {message}" if where else f"{self.source}: {message}")

    def sequence(self, document: object, name: str) -> Sequence | None:
        if not isinstance(document, dict):
            self.complain("", f"expected a mapping with the keys {', '.join(KEYS)}; got {_kind(document)}.")
            return None
        for key in document:
            if key not in KEYS:
                self.complain("", unknown_name("key", str(key), KEYS))
        initial = self.initial(document.get("initial_deg"))
        trials = document.get("trials", 1)
        if isinstance(trials, bool) or not isinstance(trials, int) or trials < 1:
            self.complain("trials", f"expected a whole number of at least 1, got {trials!r}.")
        if ("command" in document) == ("commands" in document):
            self.complain("", "give either 'command' (one) or 'commands' (several, by name).")
            return None
        bodies = {"": document["command"]} if "command" in document else document["commands"]
        if not isinstance(bodies, dict) or not bodies:
            self.complain("commands", f"expected a mapping from name to command, got {_kind(bodies)}.")
            return None
        commands = []
        for key, body in bodies.items():
            where = f"commands.{key}" if key != "" else "command"
            commands.append(self.command(where, f"{name}/{key}" if key != "" else name, initial, body))
        if self.complaints:
            return None
        return Sequence(name, str(document.get("description", "")).strip(), tuple(commands), trials)

    def initial(self, value: object) -> dict[str, float]:
        if not isinstance(value, dict) or not value:
            self.complain("initial_deg", f"expected a mapping from channel to degrees, got {_kind(value)}.")
            return {}
        return {
            str(channel): math.radians(self.number(f"initial_deg.{channel}", angle, {}) or 0.0)
            for channel, angle in value.items()
        }

    def command(self, where: str, name: str, initial: dict[str, float], body: object) -> Command:
        rows: dict[str, tuple[Shape, ...]] = {}
        if not isinstance(body, dict) or not body:
            self.complain(where, f"expected a mapping from channel to a list of shapes, got {_kind(body)}.")
            body = {}
        for channel, entries in body.items():
            if channel not in initial:
                self.complain(where, unknown_name("channel", str(channel), initial) + " They come from initial_deg.")
            if not isinstance(entries, list) or not entries:
                self.complain(f"{where}.{channel}", f"expected a list of shapes, got {_kind(entries)}.")
                entries = []
            shapes = [self.shape(f"{where}.{channel}[{i}]", entry) for i, entry in enumerate(entries)]
            rows[str(channel)] = tuple(shape for shape in shapes if shape is not None)
        return Command(name, tuple(initial), tuple(initial.values()), tuple(rows.get(c, ()) for c in initial))

    def shape(self, where: str, entry: object) -> Shape | None:
        if not isinstance(entry, dict) or len(entry) != 1:
            self.complain(where, f"expected one shape such as 'step: {{to_deg: 2, lasts_s: 1}}', got {_kind(entry)}.")
            return None
        word, body = next(iter(entry.items()))
        if word not in SHAPES:
            self.complain(where, unknown_name("shape", str(word), SHAPES))
            return None
        where = f"{where}.{word}"
        if not isinstance(body, dict):
            self.complain(where, f"expected a mapping of its numbers, got {_kind(body)}.")
            return None
        values, used = {}, set[str]()
        for item in fields(SHAPES[word]):
            unit = item.metadata["unit"]
            keys = [item.name + SUFFIXES[unit]] + ([item.name] if unit == "rad" else [])
            given = [key for key in keys if key in body]
            used.update(keys)
            if len(given) != 1:
                self.complain(where, f"expected {' or '.join(keys)}{' but not both' if given else ''}.")
                continue
            number = self.number(f"{where}.{given[0]}", body[given[0]], item.metadata, whole=item.type in (int, "int"))
            if number is not None:
                values[item.name] = math.radians(number) if given[0].endswith("_deg") else number
        for key in body:
            if key not in used:
                self.complain(where, unknown_name("number", str(key), used))
        return SHAPES[word](**values) if len(values) == len(fields(SHAPES[word])) else None

    def number(self, where: str, value: object, bounds: Mapping[str, Any], whole: bool = False) -> float | None:
        if isinstance(value, bool) or not isinstance(value, int if whole else int | float) or not math.isfinite(value):
            hint = " (YAML wants 1.0e-3, not 1e-3)" if isinstance(value, str) and "e" in value else ""
            self.complain(where, f"expected a finite {'whole ' if whole else ''}number, got {value!r}{hint}.")
            return None
        low, high = bounds.get("least", -math.inf), bounds.get("most", math.inf)
        if not low <= value <= high or value <= bounds.get("above", -math.inf):
            asked = " and ".join(f"{word} {bounds[key]:g}" for key, word in _BOUNDS.items() if key in bounds)
            self.complain(where, f"must be {asked} {bounds['unit']}, got {value!r}.")
            return None
        return int(value) if whole else float(value)


def _kind(value: object) -> str:
    return "nothing" if value is None else f"{type(value).__name__} {value!r:.60}"
