# SPDX-License-Identifier: Apache-2.0
"""Output folders: whole or not at all, and never one that exists; files that are written anew, always whole."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labyrinth_sim.errors import InputError


def refuse_existing(folder: Path) -> None:
    """Raises InputError where something of that name exists; to be called before the work starts."""
    if folder.exists() or folder.is_symlink():
        raise InputError(f"--out {folder}: exists already and is never overwritten. Name a folder that does not exist.")


def model_file(out: Path) -> Path:
    """The file that a model is written to: `out`, as YAML."""
    return out if out.suffix in (".yaml", ".yml") else out.with_name(out.name + ".yaml")


def refuse_files(*files: Path) -> None:
    """Raises InputError that lists those that exist; to be called before the work starts."""
    there = [file for file in files if file.exists()]
    if there:
        raise InputError([f"--out {file}: exists already and is never overwritten. Name another." for file in there])


def write_anew(file: Path, text: str) -> None:
    """Replaces a file, or makes it; whoever reads it, or interrupts, finds a whole one."""
    partial = file.with_name(f".{file.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(file)


def numbered_folder(out: Path, name: str, by: str = "--out") -> Path:
    """Makes the folder out/NAME-N with the first N from 1 that is free; two callers at once never get the same.

    Args:
        by: by what the person names another `out`, for the complaint.

    Raises:
        InputError: none can be made.
    """
    number = 1
    while True:
        folder = out / f"{name}-{number}"
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            number += 1
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror}). Choose another folder by {by}.") from error


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A folder to write into, which takes its name only when everything is in it.

    Raises:
        InputError: it exists, or cannot be made.
    """
    refuse_existing(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be made ({error.strerror}). Name a folder you may write.") from error
    try:
        yield partial
        umask = os.umask(0)
        os.umask(umask)
        partial.chmod(0o777 & ~umask)  # mkdtemp's are private
        refuse_existing(folder)
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
