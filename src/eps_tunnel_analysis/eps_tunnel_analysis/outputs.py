# SPDX-License-Identifier: Apache-2.0
"""Output of results: new folders, JSON, and values in the units people read."""

import errno
import json
import math
import platform
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from decimal import Decimal
from importlib import metadata
from pathlib import Path
from typing import Any

from labyrinth_sim.errors import InputError
from labyrinth_sim.whole_file import folder_of, umask

_SHOWN = {
    "rad": (180 / math.pi, "deg"),
    "rad/s": (180 / math.pi, "deg/s"),
    "m": (1000.0, "mm"),
    "m/s": (1000.0, "mm/s"),
    "1": (1.0, ""),
}
PLAIN = (1e-5, 1e6)  # from, below: numbers written out in full
MOST_TIMES = 1000.0  # how many times more does not matter
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
LIBRARIES_SHOWN = ("mujoco", "numpy", "rosbags", "scipy")


def refuse_existing(folder: Path) -> None:
    """Raises InputError where something of that name exists; to be called before the work starts."""
    if folder.exists() or folder.is_symlink():
        raise InputError(f"--out {folder}: exists already and is never overwritten. Name a folder that does not exist.")


def model_file(out: Path) -> Path:
    """The file that a model is written to: `out`, as YAML."""
    return out if out.suffix in (".yaml", ".yml") else out.with_name(out.name + ".yaml")


def refuse_files(*files: Path) -> None:
    """Raises InputError that lists those that exist; to be called before the work starts."""
    existing = [file for file in files if file.exists()]
    if existing:
        raise InputError([f"--out {file}: exists already and is never overwritten. Name another." for file in existing])


def in_file_name(name: str) -> str:
    """A signal's or a rig's name as part of a file's: what is not a letter, digit, '.', '_', '+' or '-' as ~ and its
    code, so that two names never share a file.
    """
    return re.sub(r"[^\w.+-]|^\.", lambda found: f"~{ord(found[0]):x}~", name, flags=re.ASCII)


def numbered_folder(out: Path, name: str, by: str = "--out") -> Path:
    """Makes the folder out/NAME-N with the first N from 1 that is free; two callers at once never get the same.

    Args:
        by: the option by which the user names another `out`, for the complaint.

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
    """A folder to write into, which gets its name only when everything is in it.

    Raises:
        InputError: it exists, or cannot be made, or the disk is full; nothing is left of it.
    """
    refuse_existing(folder)
    with ExitStack() as stack:
        try:
            stack.enter_context(folder_of(folder))
            partial = Path(tempfile.mkdtemp(prefix=f".{folder.name[:100]}.", dir=folder.parent))
        except OSError as error:
            raise InputError(
                f"--out {folder}: cannot be made ({error.strerror}). Name a folder you may write."
            ) from error
        try:
            yield partial
            partial.chmod(0o777 & ~umask())  # mkdtemp's are private
            refuse_existing(folder)
            partial.rename(folder)
        except BaseException as error:
            shutil.rmtree(partial, ignore_errors=True)
            if isinstance(error, OSError) and error.errno in DISK_FULL:
                reason = f"cannot be written ({error.strerror}). Nothing is left of it; free space, or name another."
                raise InputError(f"--out {folder}: {reason}") from error
            raise


def shown_unit(unit: str) -> tuple[float, str]:
    """Factor from an SI unit to the one people read, and that unit's name ("" where there is none)."""
    return _SHOWN.get(unit, (1.0, unit))


def shown_number(value: float, digits: int = 3) -> str:
    """A number as people write it, with `digits` that count: 160 for 163.2 and two digits. NaN is a dash."""
    if math.isnan(value):
        return "–"
    text = f"{value:.{digits}g}"
    mantissa, power, exponent = text.partition("e")
    if not power:
        return text
    if PLAIN[0] <= abs(value) < PLAIN[1]:
        return f"{Decimal(text):f}"
    ten = f"10^{int(exponent)}"
    return {"1": ten, "-1": f"-{ten}"}.get(mantissa, f"{mantissa} × {ten}")


def shown_times(ratio: float, digits: int = 2) -> str:
    """How many times as much, from 0: 160, or "over 1000". NaN is a dash."""
    return f"over {MOST_TIMES:.0f}" if ratio > MOST_TIMES else shown_number(ratio, digits)


def shown_value(value: float, unit: str, digits: int = 3) -> str:
    """A value in SI as people read it: shown_value(0.01, "rad") is "0.573 deg". NaN is a dash."""
    factor, name = shown_unit(unit)
    return "–" if math.isnan(value) else f"{shown_number(value * factor, digits)} {name}".rstrip()


def shown_share(share: float) -> str:
    """A share as a percentage with two digits after the point, as in the paper's tables. NaN is a dash."""
    return "–" if math.isnan(share) else f"{share * 100:.2f} %"


def version() -> str:
    """Version of this package."""
    return _version("eps_tunnel_analysis") or "(run from source)"


def versions() -> dict[str, str]:
    """Versions of this package, of Python, and the libraries on which figures depend."""
    libraries = {name: _version(name) for name in LIBRARIES_SHOWN}
    return {
        "eps_tunnel_analysis": version(),
        "python": platform.python_version(),
        **{name: v for name, v in libraries.items() if v},
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def plain(content: Any) -> Any:
    """Dicts, lists, words and finite numbers; what is not finite becomes None."""
    if isinstance(content, dict):
        return {str(key): plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [plain(value) for value in content]
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    return content


def json_text(content: Any) -> str:
    """`plain` content as JSON with a newline at its end; numbers that are not finite are null."""
    return json.dumps(plain(content), indent=1, allow_nan=False) + "\n"


def called() -> str:
    """The command that runs; "python" if it is not one of ours, as in a notebook."""
    return shlex.join(["eps-tunnel", *sys.argv[1:]]) if f"{__package__}.cli.main" in sys.modules else "python"


def circumstances(command: Sequence[str] | None = None) -> list[tuple[str, str]]:
    """By which command (default: the one that runs), with which versions, and when something is made."""
    return [
        ("command", shlex.join(command) if command else called()),
        ("versions", ", ".join(f"{name} {v}" for name, v in versions().items())),
        ("made", datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")),
    ]


def today() -> str:
    """The date (UTC) as a model's file has it."""
    return datetime.now(UTC).strftime("%Y-%m-%d")
