# SPDX-License-Identifier: Apache-2.0
"""New files, whole or not there."""

import os
import tempfile
from pathlib import Path

from labyrinth_hw.errors import InputError


def write_new(path: Path, text: str) -> None:
    """Writes a file that must not exist yet, beside its place, and moves it there.

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
