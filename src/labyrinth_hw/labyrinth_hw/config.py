# SPDX-License-Identifier: Apache-2.0
"""Finds, reads and checks the rig's YAML files: $EPS_TUNNEL_CONFIG, the source tree, then what was installed.

New files are written completely or not at all.
"""

import os
import site
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from yaml.events import CollectionEndEvent, CollectionStartEvent

from labyrinth_hw.errors import InputError, unknown_name

VARIABLE = "EPS_TUNNEL_CONFIG"
SUFFIXES = (".yaml", ".yml")
LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C where it was built
LARGEST = 1_000_000  # bytes of a file; a rig takes a few thousand
DEEPEST = 20  # levels of nesting; a rig has four
MOST = 20_000  # values, aliases written out

Place = tuple[str | int, ...]
Checked = TypeVar("Checked", bound="Section")


def _no_bool(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError(f"expected a number, got {value}")
    return value


Number = Annotated[float, BeforeValidator(_no_bool), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
Whole = Annotated[int, BeforeValidator(_no_bool)]


class Section(BaseModel):
    """A part of a file: the fields are its keys, and no others are allowed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True)
class YamlFile:
    """A file's content, and the line (from 1) on which each of its values begins."""

    path: Path
    content: Mapping[str, Any]
    lines: Mapping[Place, int]

    def checked(self, model: type[Checked]) -> Checked:
        """The content as a model. Raises InputError with every complaint and its place."""
        return check(model, self.content, str(self.path), self.lines)


def folders(kind: str) -> tuple[Path, ...]:
    """Existing folders that hold files of this kind ("hw", "testbed"), the first to be searched first."""
    existing = {folder.resolve(): None for folder in _candidates(kind) if folder.is_dir()}
    return tuple(existing)


def _candidates(kind: str) -> Iterator[Path]:
    for part in _split(VARIABLE):
        yield part / kind
    for parent in Path(__file__).resolve().parents:
        if (parent / "src" / "labyrinth_hw" / "package.xml").is_file():
            yield parent / "config" / kind
    for prefix in _prefixes():
        yield from sorted(prefix.glob(f"share/*/config/{kind}"))


def _prefixes() -> tuple[Path, ...]:
    return (*_split("AMENT_PREFIX_PATH"), Path(sys.prefix), Path(site.getuserbase()))


def _split(variable: str) -> list[Path]:
    return [Path(part) for part in os.environ.get(variable, "").split(os.pathsep) if part]


def names(kind: str) -> tuple[str, ...]:
    """Every name that `find` knows for this kind."""
    return tuple(
        sorted({file.stem for folder in folders(kind) for file in folder.iterdir() if file.suffix in SUFFIXES})
    )


def find(kind: str, name: str | Path) -> Path:
    """The file that a name or a path stands for.

    Raises:
        InputError: no such file; lists the valid names and the folders searched.
    """
    given = Path(os.path.expanduser(name))  # leaves a user that is not there as it is
    if os.path.isfile(given):  # False for a name that no file system takes, where is_file raises
        return given.resolve()
    where = folders(kind)
    for folder in where:
        for candidate in (folder / given, *(folder / f"{given}{suffix}" for suffix in SUFFIXES)):
            if os.path.isfile(candidate):
                return candidate
    searched = ", ".join(map(str, where)) or f"(no folder named {kind} anywhere)"
    raise InputError(f"{unknown_name(kind + ' file', str(name), names(kind))} Searched: {searched}.")


def find_geometry() -> Path | None:
    """The file of walls and holes, config/labyrinth_geometry.yaml, if there is one."""
    for folder in (*_split(VARIABLE), *(f.parent for f in folders("testbed")), *(f.parent for f in folders("hw"))):
        path = folder / "labyrinth_geometry.yaml"
        if path.is_file():
            return path
    for prefix in _prefixes():
        for path in sorted(prefix.glob("share/*/config/labyrinth_geometry.yaml")):
            return path
    return None


def read(path: Path | str) -> YamlFile:
    """The mapping in a YAML file.

    Raises:
        InputError: unreadable, too large, nested too deep, no valid YAML, or no mapping.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
        if len(data) > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST} bytes; is this the right file?")
        text = data.decode("utf-8")
        _check_depth(text, path)
        root = yaml.compose(text, Loader=LOADER)
        lines = dict(_lines(root, (), path)) if root is not None else {}
        if len(lines) > MOST:
            raise InputError(f"{path}: more than {MOST} values, aliases (*) written out; is this the right file?")
        content = yaml.load(data, Loader=LOADER)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error}.") from error
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a YAML file: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a mapping of names to values, got {type(content).__name__}.")
    return YamlFile(path, content, lines)


def _check_depth(text: str, path: Path) -> None:
    """Refuses by the parser's events what is nested so deep that the rest of it would run out of stack."""
    depth = 0
    for event in yaml.parse(text, Loader=LOADER):
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        _refuse_beyond_deepest(depth - 1, path, event.start_mark)  # the file is a mapping itself


def _refuse_beyond_deepest(depth: int, path: Path, mark: Any) -> None:
    if depth > DEEPEST:
        raise InputError(f"{path}, line {mark.line + 1}: nested deeper than {DEEPEST} levels.")


def _lines(node: yaml.Node, place: Place, path: Path, count: list[int] | None = None) -> Iterator[tuple[Place, int]]:
    """Place and line of every value, before anything is built; stops beyond the bounds."""
    count = [0] if count is None else count
    count[0] += 1
    _refuse_beyond_deepest(len(place), path, node.start_mark)
    yield place, node.start_mark.line + 1
    if count[0] > MOST:
        return
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _lines(item, (*place, index), path, count)
    elif isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            name = str(key.value)
            if name in seen:
                raise InputError(f"{path}, line {key.start_mark.line + 1}: '{name}' is there twice; keep one.")
            seen.add(name)
            yield from _lines(value, (*place, name), path, count)


def check(
    model: type[Checked], content: Mapping[str, Any], where: str, lines: Mapping[Place, int] | None = None
) -> Checked:
    """Content as a model.

    Args:
        model: what is expected.
        content: of a file.
        where: name of the file, for complaints.
        lines: of its values.

    Raises:
        InputError: every complaint at once, each with its place.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        complaints = [_complaint(model, dict(one), where, lines or {}) for one in error.errors(include_url=False)]
        raise InputError(complaints) from error


def _complaint(model: type[BaseModel], error: Mapping[str, Any], where: str, lines: Mapping[Place, int]) -> str:
    kind, value = error["type"], error["input"]
    place: Place = tuple(part for part in error["loc"] if part != "[key]")
    line = next((lines[place[:end]] for end in range(len(place), 0, -1) if place[:end] in lines), None)
    head = ", ".join([where, *([f"line {line}"] if line else []), *([".".join(map(str, place))] if place else [])])
    if kind == "missing":
        keys = _fields(model, place[:-1])
        return f"{head} is missing." + (f" Keys there: {', '.join(keys)}." if keys else "")
    if kind == "extra_forbidden":
        return f"{head}: {unknown_name('key', str(place[-1]), _fields(model, place[:-1]))}"
    if kind == "model_type":
        return f"{head}: expected the keys {', '.join(_fields(model, place))}, got {value!r:.60}."
    if kind == "value_error":
        return f"{head}: {error['ctx']['error']}"
    text = str(error["msg"]).replace("Input should be", "expected").replace("Keys should be", "expected keys that are")
    shown = repr(value)
    return f"{head}: {text}, got {shown if len(shown) <= 60 else shown[:57] + '...'}."


def _fields(model: Any, place: Place) -> list[str]:
    """Names of the fields at a place inside a model."""
    kind = model
    for part in place:
        inner = _section(kind)
        if inner is not None and str(part) in inner.model_fields:
            kind = inner.model_fields[str(part)].annotation
        else:
            kind = next((a for a in reversed(get_args(kind)) if a not in (Ellipsis, type(None))), None)
    inner = _section(kind)
    return [] if inner is None else list(inner.model_fields)


def _section(kind: Any) -> type[BaseModel] | None:
    """The model behind an annotation such as `Model | None`."""
    choices = (kind, *get_args(kind))
    return next((c for c in choices if isinstance(c, type) and issubclass(c, BaseModel)), None)


def write_new(path: Path, text: str) -> None:
    """Writes a file that must not exist yet, next to its final place, and moves it there.

    Raises:
        InputError: it exists, or cannot be written; nothing is left of it.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name[:100]}.", dir=path.parent)
        partial = Path(name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            partial.chmod(0o644)
            try:
                os.link(partial, path)
            except OSError:  # there, or a file system without hard links
                if path.exists() or path.is_symlink():
                    raise FileExistsError from None
                partial.rename(path)
        finally:
            partial.unlink(missing_ok=True)
    except FileExistsError:
        raise InputError(f"{path} exists and is left as it is; name another file.") from None
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}. Nothing is left of it.") from error
