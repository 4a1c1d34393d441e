# SPDX-License-Identifier: Apache-2.0
"""Finds rigs, models, MJCF files and sequences by name, in a workspace, an installation or a source tree."""

import os
import site
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from labyrinth_sim.errors import InputError, unknown_name

SUFFIXES = (".yaml", ".yml", ".xml", ".urdf")
VARIABLE = "EPS_TUNNEL_CONFIG"


def folders(kind: str) -> tuple[Path, ...]:
    """Existing folders that hold files of this kind, the first to be searched first.

    Args:
        kind: name of a folder under config: "rigs", "models", "mjcf", "sequences", ...
    """
    existing: dict[Path, None] = {}
    for folder in _candidates(kind):
        if folder.is_dir():
            existing.setdefault(folder.resolve())
    return tuple(existing)


def _candidates(kind: str) -> Iterator[Path]:
    for folder in _split(VARIABLE):
        yield folder / kind
    # Walking up from this file finds the source tree; it comes first, so that a checkout uses the files it shows.
    for parent in Path(__file__).resolve().parents:
        if (parent / "src" / "labyrinth_sim" / "package.xml").is_file():
            yield parent / "config" / kind
    for prefix in (*_split("AMENT_PREFIX_PATH"), Path(sys.prefix), Path(site.getuserbase())):
        share = prefix / "share"
        if share.is_dir():
            yield from (folder / kind for folder in _of_packages(share, share.stat().st_mtime_ns))


@lru_cache(maxsize=64)
def _of_packages(share: Path, changed: int) -> tuple[Path, ...]:
    """Every package's config/ in a share/ that was `changed` then, ns; there may be hundreds of packages."""
    return tuple(sorted(share.glob("*/config")))


def _split(variable: str) -> list[Path]:
    return [Path(part) for part in os.environ.get(variable, "").split(os.pathsep) if part]


def names(kind: str) -> tuple[str, ...]:
    """Every name that `find` knows for this kind, in alphabetical order; files in subfolders as "folder/name"."""
    found = {
        file.relative_to(folder).with_suffix("").as_posix()
        for folder in folders(kind)
        for file in folder.rglob("*")
        if file.suffix in SUFFIXES and file.is_file()
    }
    return tuple(sorted(found))


def typed_path(text: str | Path) -> Path:
    """A path as a person types it: `~` and `~user` are home folders; of a user that is not there it stays as it is."""
    return Path(os.path.expanduser(text))  # Path.expanduser would raise


def find(kind: str, name: str | Path, beside: Path | None = None) -> Path:
    """The file that a name or a path stands for.

    An existing path is taken as it is. A name is looked up in each folder of $EPS_TUNNEL_CONFIG, in the source tree's
    config/, and in what packages installed. The suffix may be left out.

    Args:
        kind: "rigs", "models", "mjcf", "sequences", ...
        name: "labyrinth", "labyrinth.yaml", or a path.
        beside: the file in which the name stands; a relative path is then relative to that file's folder, whichever
            folder the program runs in.

    Raises:
        InputError: no such file; lists the valid names and the folders searched.
    """
    given = typed_path(name)
    path = beside.parent / given if beside else given
    if os.path.isfile(path):
        return path.resolve()
    where = folders(kind)
    for folder in where:
        for candidate in (folder / given, *(folder / f"{given}{suffix}" for suffix in SUFFIXES)):
            if os.path.isfile(candidate):
                return candidate
    places = (*([beside.parent] if beside else []), *where)
    searched = ", ".join(str(folder) for folder in places) or f"(no folder named {kind} anywhere)"
    raise InputError(
        f"{unknown_name(kind.removesuffix('s'), str(name), names(kind))} Searched: {searched}. "
        f"Give the path of a file, or name a folder that holds {kind}/ in ${VARIABLE}."
    )
