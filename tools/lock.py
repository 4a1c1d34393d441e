# SPDX-License-Identifier: Apache-2.0
"""Writes the lock files: every release that the pins of requirements*.txt need, with the hashes of all its files.

`make lock` runs this. Releases that a lock file names already are kept while the pins allow it; delete the file to take
the newest. The result holds for every Python from the oldest on, so some lines carry a marker.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PINS, ROS_PINS = "requirements.txt", "requirements-ros.txt"
LOCK, ROS_LOCK = "requirements.lock", "requirements-ros.lock"
OLDEST = "3.11"
HEADER = "# Made by `make lock` from {}; do not edit.\n"


def entries(lock: str) -> dict[str, str]:
    """First line of each entry, which names release and marker -> the whole entry with hashes and comments."""
    found: dict[str, str] = {}
    first = ""
    for line in lock.splitlines(keepends=True):
        if line[0] not in " #":
            first = line
        if first:
            found[first] = found.get(first, "") + line
    return found


def resolve(pins: list[str], lock: str, *options: str) -> str:
    """Resolves the pins into a lock file and returns its text; a release that the file names already is preferred.

    Raises:
        CalledProcessError: the pins contradict each other; uv has said where.
    """
    command = [sys.executable, "-m", "uv", "pip", "compile", "--universal", "--python-version", OLDEST]
    command += ["--generate-hashes", "--no-header", "--no-config", "--quiet", *options, "--output-file", lock, *pins]
    subprocess.run(command, cwd=ROOT, check=True)
    return (ROOT / lock).read_text(encoding="utf-8")


def main() -> None:
    libraries = resolve([PINS], LOCK)
    (ROOT / LOCK).write_text(HEADER.format(PINS) + libraries, encoding="utf-8")
    everything = resolve([PINS, ROS_PINS], ROS_LOCK, "--constraints", LOCK)
    known = entries(libraries)
    rest = "".join(entry for first, entry in entries(everything).items() if first not in known)
    (ROOT / ROS_LOCK).write_text(HEADER.format(f"{ROS_PINS}, without what {LOCK} has") + rest, encoding="utf-8")


if __name__ == "__main__":
    main()
