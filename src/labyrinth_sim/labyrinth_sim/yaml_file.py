# SPDX-License-Identifier: Apache-2.0
"""YAML files: read within bounds, checked by pydantic, every complaint with the line that it is about.

Plain words mean what they do in YAML 1.2: `1e-3` is a number, `on` and `2024-01-31` are text. Keys are always text.
"""

import re
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from labyrinth_sim.config import find
from labyrinth_sim.errors import InputError, unknown_name

LARGEST = 1 << 20  # bytes of a file
MOST_FILE_VALUES = 20_000  # in a file, those that aliases repeat included; of long text each VALUE characters are one
VALUE = 64  # characters
DEEPEST = 40  # mappings and lists within each other
LONGEST_NUMBER = 40  # characters
MOST_COMPLAINTS = 50  # of one file
SHOWN = 60  # characters of a value in a complaint

Where = tuple[str | int, ...]
"""Keys and list indices that lead to a value."""

_INT = re.compile(r"[-+]?[0-9]+$|0x[0-9a-fA-F]+$")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$")
_DIGITS = list("-+.0123456789")
_LINE_ENDS = re.compile("[\x85\u2028\u2029\ufeff]")


def _tag(name: str) -> str:
    return f"tag:yaml.org,2002:{name}"


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """PyYAML's parser, in C where it was built, with the plain words of YAML 1.2."""

    yaml_implicit_resolvers: ClassVar[dict[str, list[Any]]] = {}


_Loader.add_implicit_resolver(_tag("null"), re.compile(r"(~|null|Null|NULL|)$"), ["~", "n", "N", ""])
_Loader.add_implicit_resolver(_tag("bool"), re.compile(r"(true|True|TRUE|false|False|FALSE)$"), list("tTfF"))
_Loader.add_implicit_resolver(_tag("int"), _INT, _DIGITS)
_Loader.add_implicit_resolver(_tag("float"), _FLOAT, _DIGITS)
_Loader.add_implicit_resolver(_tag("merge"), re.compile(r"<<$"), ["<"])


class _Dumper(yaml.SafeDumper):
    """Quotes text that YAML 1.1 or YAML 1.2 would take for something else."""


_Dumper.add_implicit_resolver(_tag("int"), _INT, _DIGITS)
_Dumper.add_implicit_resolver(_tag("float"), _FLOAT, _DIGITS)


def _text(value: object) -> object:
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


Text = Annotated[str, BeforeValidator(_text)]
"""Text; a number that stands for a name or a unit, as in `unit: 1`, is text too."""


class Entry(BaseModel):
    """Schema of one mapping: unknown keys, and values of another type, are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
    noun: ClassVar[str] = "entry"
    """What an unknown key is called."""


S = TypeVar("S", bound=Entry)


@dataclass
class Document:
    """The content of a YAML file while it is being checked.

    Attributes:
        source: of the file, opens every complaint.
        data: mappings with text as keys, lists, text, numbers, booleans, None.
        lines: of each value, from 1; empty where the data came from elsewhere.
        found: complaints so far, each with its line.
    """

    source: str
    data: Any
    lines: Mapping[Where, int] = field(default_factory=dict)
    found: list[tuple[int, str]] = field(default_factory=list)

    @property
    def complaints(self) -> list[str]:
        """So far, in the order of their lines."""
        return [text for _, text in sorted(self.found, key=lambda complaint: complaint[0])]

    def complain(self, where: Where, text: str, name: str | None = None) -> None:
        """Adds a complaint about a value; `name` stands for it where it is known by another than its place.

        Raises:
            InputError: with all so far, once there are MOST_COMPLAINTS; the rest of such a file is not checked.
        """
        known = next((where[:n] for n in range(len(where), -1, -1) if where[:n] in self.lines), None)
        line = 0 if known is None else self.lines[known]
        source = f"{self.source}:{line}" if line else self.source
        about = _dotted(where) if name is None else name
        complaint = f"{source}: {about}: {text}" if about else f"{source}: {text}"
        if (line, complaint) not in self.found:
            self.found.append((line, complaint))
        if len(self.found) >= MOST_COMPLAINTS:
            raise InputError([*self.complaints, f"{self.source}: the rest was not checked."])

    def value(self, where: Where) -> Any:
        """What stands at a place; None where nothing does."""
        data = self.data
        for key in where:
            if isinstance(data, dict):
                data = data.get(str(key))
            elif isinstance(data, list) and isinstance(key, int) and key < len(data):
                data = data[key]
            else:
                return None
        return data

    def mapping(self, where: Where) -> dict[str, Any]:
        """The mapping at a place; empty where nothing stands, or with a complaint where something else does."""
        value = self.value(where)
        if value is None or isinstance(value, dict):
            return value or {}
        self.complain(where, f"expected a mapping, got {shortened(value)}.")
        return {}

    def sequence(self, where: Where) -> list[Any]:
        """The list at a place; empty where nothing stands, or with a complaint where something else does."""
        value = self.value(where)
        if value is None or isinstance(value, list):
            return value or []
        self.complain(where, f"expected a list, got {shortened(value)}.")
        return []

    def file(self, where: Where, kind: str, path: Path) -> Path | None:
        """The file of this kind that a name in the file `path` stands for; None, with a complaint, where there is none.

        A value that is no text is left to the schema to refuse.
        """
        name = _text(self.value(where))
        if not isinstance(name, str):
            return None
        try:
            return find(kind, name, beside=path)
        except InputError as error:
            self.complain(where, str(error))
            return None

    def read(self, schema: type[S], where: Where = (), name: str | None = None) -> S | None:
        """The mapping at a place as the schema has it; None, with all complaints, where it does not fit.

        Args:
            name: by which complaints call it, where it is known by another than its place.
        """
        try:
            return schema.model_validate(self.value(where))
        except ValidationError as error:
            for details in error.errors(include_url=False):
                self._explain(schema, where, name, details)
            return None

    def _explain(self, schema: type[Entry], where: Where, name: str | None, details: Mapping[str, Any]) -> None:
        loc, kind = details["loc"], details["type"]
        called = _dotted(where) if name is None else name
        known = {info.alias or key: info for key, info in schema.model_fields.items()}
        if kind == "missing":
            self.complain((*where, *loc[:-1]), f"'{loc[-1]}' is missing.", _joined(called, loc[:-1]))
        elif kind == "extra_forbidden":
            text = unknown_name(schema.noun, str(loc[-1]), known)
            self.complain((*where, *loc), text, _joined(called, loc[:-1]))
        else:
            info = known.get(str(loc[0])) if loc else None
            extra = info.json_schema_extra if info else None
            unit = f" {extra['unit']}" if isinstance(extra, dict) and "unit" in extra else ""
            expected = _expectation(kind, details["msg"], unit)
            got = "" if kind == "value_error" else f", got {shortened(details['input'])}."
            self.complain((*where, *loc), f"{expected}{got}", _joined(called, loc))

    def check(self) -> None:
        """Raises InputError with every complaint, if there are any."""
        if self.found:
            raise InputError(self.complaints)


_EXPECTED = {
    "model_type": "a mapping",
    "dict_type": "a mapping",
    "list_type": "a list",
    "string_type": "text",
    "float_type": "a number",
    "int_type": "a whole number",
    "finite_number": "a finite number",
}


def _expectation(kind: str, message: str, unit: str) -> str:
    if kind == "value_error":
        return message.removeprefix("Value error, ")
    if kind in _EXPECTED:
        return f"expected {_EXPECTED[kind]}"
    expected = message.removeprefix("Input should be ")
    if expected == message:
        return message
    return f"must be {expected}{unit}" if "than" in kind else f"expected {expected}"


def _joined(called: str, loc: Where) -> str:
    rest = _dotted(loc)
    return rest if not called else called + (rest if rest.startswith("[") or not rest else f".{rest}")


def _dotted(where: Where) -> str:
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{_cut(key)}" for key in where)
    return text.removeprefix(".")


def shortened(value: object) -> str:
    """A value as a complaint shows it, in a few words."""
    return "nothing" if value is None else _cut(_SHORT.repr(value))


def _cut(text: str) -> str:
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxdict, _SHORT.maxlist, _SHORT.maxstring, _SHORT.maxother = 2, 4, 4, SHOWN - 3, SHOWN


def read_yaml(path: Path) -> Document:
    """Reads a YAML file that holds one mapping.

    Raises:
        InputError: no such file; no YAML; larger, deeper or with more values than any file of this project has any use
            for; no mapping.
    """
    try:
        if not path.is_file():
            raise FileNotFoundError(0, "there is no such file")
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        text = raw.decode("utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}). Give the path of a YAML file.") from error
    except UnicodeDecodeError as error:
        if len(raw) <= LARGEST:
            raise InputError(f"{path}: not valid YAML: byte {error.start} is no UTF-8.") from error
        text = ""
    if len(raw) > LARGEST:
        raise InputError(f"{path}: larger than {LARGEST >> 20} MiB, which no file of this kind is. Name another file.")
    return parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> Document:
    """The document in a text; `source` opens every complaint. Raises InputError as `read_yaml` does."""
    try:
        _check_bounds(text, source)
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{source}:{mark.line + 1}" if mark else source
        reason = ", ".join(part for part in (error.context, error.problem) if part)
        raise InputError(f"{place}: not valid YAML: {reason}.") from error
    except yaml.YAMLError as error:
        raise InputError(f"{source}: not valid YAML: {str(error).splitlines()[0]}.") from error
    except InputError:
        raise
    except ValueError as error:  # PyYAML's own, as for the escape \UFFFFFFFF
        raise InputError(f"{source}: not valid YAML: {error}.") from error
    lines: dict[Where, int] = {}
    data = None if node is None else _construct(node, source, (), lines)
    if not isinstance(data, dict):
        raise InputError(f"{source}: expected a mapping, got {shortened(data)}.")
    return Document(source, data, lines)


def _check_bounds(text: str, source: str) -> None:
    """Refuses by the parser's events, before anything is built, what is too deep or becomes too large by aliases."""
    total = 0
    anchors: dict[str, tuple[int, int]] = {}  # values and levels of what each anchor names
    unfinished: list[tuple[str | None, int, int]] = []  # anchor, values before it, levels within it
    for event in yaml.parse(text, Loader=_Loader):
        line = f"{source}:{event.start_mark.line + 1}" if event.start_mark else source
        levels = 0
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in anchors:
                raise InputError(f"{line}: the alias *{event.anchor} names nothing that is complete before it.")
            size, levels = anchors[event.anchor]
            total += size
        elif isinstance(event, yaml.ScalarEvent):
            size = 1 + len(event.value) // VALUE
            total += size
            if event.anchor:
                anchors[event.anchor] = (size, 0)
        elif isinstance(event, yaml.CollectionStartEvent):
            unfinished.append((event.anchor, total, 0))
            total += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before, inner = unfinished.pop()
            levels = inner + 1
            if anchor:
                anchors[anchor] = (total - before, levels)
        if unfinished:
            anchor, before, inner = unfinished[-1]
            unfinished[-1] = (anchor, before, max(inner, levels))
        if len(unfinished) + levels > DEEPEST:
            raise InputError(f"{line}: more than {DEEPEST} mappings and lists within each other.")
        if total > MOST_FILE_VALUES:
            raise InputError(f"{line}: more than {MOST_FILE_VALUES} values, those that aliases repeat included.")


def _construct(node: yaml.Node, source: str, where: Where, lines: dict[Where, int]) -> Any:
    lines.setdefault(where, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode) and node.tag == _tag("map"):
        return _construct_mapping(node, source, where, lines)
    if isinstance(node, yaml.SequenceNode) and node.tag == _tag("seq"):
        return [_construct(item, source, (*where, i), lines) for i, item in enumerate(node.value)]
    if isinstance(node, yaml.ScalarNode):
        return _construct_scalar(node, source)
    raise InputError(f"{source}:{node.start_mark.line + 1}: the tag {_cut(node.tag)} is not used here. Leave it out.")


def _construct_mapping(node: yaml.MappingNode, source: str, where: Where, lines: dict[Where, int]) -> dict[str, Any]:
    own: dict[str, Any] = {}
    merged: dict[str, Any] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise InputError(f"{source}:{line}: a key must be one word, got a {key.id}.")
        if key.tag == _tag("merge"):
            parts = value.value if isinstance(value, yaml.SequenceNode) else [value]
            for part in parts:
                if not isinstance(part, yaml.MappingNode):
                    raise InputError(f"{source}:{line}: '<<' takes a mapping, or a list of mappings.")
                merged = {**_construct_mapping(part, source, where, lines), **merged}
            continue
        if key.value in own:
            raise InputError(f"{source}:{line}: the key '{_cut(key.value)}' is given twice.")
        lines[*where, key.value] = line
        own[key.value] = _construct(value, source, (*where, key.value), lines)
    return {**merged, **own}


def _construct_scalar(node: yaml.ScalarNode, source: str) -> Any:
    line, text, kind = node.start_mark.line + 1, node.value, node.tag.rpartition(":")[2]
    if node.tag not in {_tag(name) for name in ("null", "bool", "int", "float", "str", "merge")}:
        raise InputError(f"{source}:{line}: the tag {_cut(node.tag)} is not used here. Leave it out.")
    if kind in ("int", "float"):
        if len(text) > LONGEST_NUMBER:
            raise InputError(f"{source}:{line}: a number of {len(text)} characters; at most {LONGEST_NUMBER} are read.")
        try:
            return int(text, 16 if text.startswith("0x") else 10) if kind == "int" else float(_python_float(text))
        except ValueError as error:
            raise InputError(f"{source}:{line}: expected a number, got {shortened(text)}.") from error
    if kind == "bool":
        return text.lower() == "true"
    return None if kind == "null" else text


def _python_float(text: str) -> str:
    return text.lower().replace(".inf", "inf").replace(".nan", "nan")


def yaml_text(data: Mapping[str, Any]) -> str:
    """A YAML text that `read_yaml` reads as the same data, under the licence's line."""
    for unicode in (True, False):
        body = yaml.dump(dict(data), Dumper=_Dumper, sort_keys=False, allow_unicode=unicode, width=120)
        if not _LINE_ENDS.search(body):  # PyYAML writes them as they are, which a reader takes for a line's end
            break
    return f"# SPDX-License-Identifier: Apache-2.0\n{body}"
