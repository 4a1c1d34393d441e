# SPDX-License-Identifier: Apache-2.0
"""Files that are complete or absent: written next to their final place, and moved there when everything is on the
disk."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labyrinth_sim.errors import InputError


def write_anew(file: Path, text: str) -> None:
    """Replaces a file, or makes it; whoever reads it, or interrupts, finds a whole one."""
    with beside(file) as partial:
        _write(partial, text, file)
        partial.replace(file)


def write_new(file: Path, text: str, by: str = "--out") -> None:
    """Makes a file, and the folder that it is in; never overwrites one.

    Args:
        by: by what the person named it, for the complaint.

    Raises:
        InputError: it exists.
        OSError: it cannot be written; nothing is left of it.
    """
    with folder_of(file), beside(file) as partial:
        _write(partial, text, file)
        try:
            os.link(partial, file)
        except OSError as error:  # there, or a file system without hard links
            if file.exists() or file.is_symlink():
                raise InputError(f"{by} {file}: exists already and is never overwritten. Name another.") from error
            partial.rename(file)


@contextmanager
def beside(file: Path) -> Iterator[Path]:
    """An empty file of the same kind next to another, to be filled and moved there; removed afterwards in any case."""
    handle, name = tempfile.mkstemp(prefix=f".{file.name[:100]}.", suffix=file.suffix[:20], dir=file.parent)
    os.close(handle)
    partial = Path(name)
    try:
        partial.chmod(0o666 & ~umask())  # mkstemp's are private
        yield partial
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def folder_of(file: Path) -> Iterator[Path]:
    """Makes the folder that a file or folder is to be in; takes it away again where that comes to nothing.

    Raises:
        OSError: it cannot be made.
    """
    missing = [folder for folder in file.parents if not folder.exists()]
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        yield file.parent
    except BaseException:
        for folder in missing:
            try:
                folder.rmdir()
            except OSError:  # never made, or in use
                break
        raise


def umask() -> int:
    """The bits that this process takes from the permissions of what it makes."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _write(file: Path, text: str, place: Path) -> None:
    """Fills a file that is to be moved to a place."""
    try:
        with file.open("w", encoding="utf-8", newline="") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:  # the system's own says not where
        raise OSError(error.errno, error.strerror, str(place)) from error
