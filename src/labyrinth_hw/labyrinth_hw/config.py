# SPDX-License-Identifier: Apache-2.0
"""Finds and reads YAML files of the rig by name: $EPS_TUNNEL_CONFIG, the source tree, then what was installed."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from labyrinth_hw.errors import InputError, unknown_name

VARIABLE = "EPS_TUNNEL_CONFIG"
SUFFIXES = (".yaml", ".yml")


def folders(kind: str) -> tuple[Path, ...]:
    """Existing folders that hold files of this kind ("hw", "testbed"), the first to be searched first."""
    found = {folder.resolve(): None for folder in _candidates(kind) if folder.is_dir()}
    return tuple(found)


def _candidates(kind: str) -> Iterator[Path]:
    for part in _split(VARIABLE):
        yield part / kind
    for parent in Path(__file__).resolve().parents:
        if (parent / "src" / "labyrinth_hw" / "package.xml").is_file():
            yield parent / "config" / kind
    for prefix in (*_split("AMENT_PREFIX_PATH"), Path(sys.prefix)):
        yield from sorted(prefix.glob(f"share/*/config/{kind}"))


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
    given = Path(name).expanduser()
    if given.is_file():
        return given.resolve()
    where = folders(kind)
    for folder in where:
        for candidate in (folder / given, *(folder / f"{given}{suffix}" for suffix in SUFFIXES)):
            if candidate.is_file():
                return candidate
    searched = ", ".join(map(str, where)) or f"(no folder named {kind} anywhere)"
    raise InputError(f"{unknown_name(kind + ' file', str(name), names(kind))} Searched: {searched}.")


def load(kind: str, name: str | Path) -> dict[str, Any]:
    """The mapping in a YAML file.

    Raises:
        InputError: no such file, no valid YAML, or no mapping.
    """
    path = find(kind, name)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a YAML file: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a mapping of names to values, got {type(content).__name__}.")
    return content


def find_geometry() -> Path | None:
    """The file of walls and holes, config/labyrinth_geometry.yaml, if there is one."""
    for folder in (*_split(VARIABLE), *(f.parent for f in folders("testbed")), *(f.parent for f in folders("hw"))):
        path = folder / "labyrinth_geometry.yaml"
        if path.is_file():
            return path
    for prefix in (*_split("AMENT_PREFIX_PATH"), Path(sys.prefix)):
        for path in sorted(prefix.glob("share/*/config/labyrinth_geometry.yaml")):
            return path
    return None
