# SPDX-License-Identifier: Apache-2.0
"""Says what this machine lacks for `make setup`, all at once, before anything is installed."""

import os
import platform
import shutil
import sys
import sysconfig
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

OLDEST = (3, 11)


def complaints(ros_installed: bool) -> Iterator[str]:
    """One sentence for each thing missing: what was found, what is needed, what to try."""
    version = ".".join(str(part) for part in sys.version_info[:3])
    if sys.version_info < OLDEST:
        yield (
            f"Python {version} at {sys.executable} is too old: {OLDEST[0]}.{OLDEST[1]} or newer is needed. "
            "Install one and run `make setup PYTHON=/path/to/python3`."
        )
    if find_spec("ensurepip") is None or find_spec("venv") is None:
        yield f"Python {version} has no venv module. On Debian and Ubuntu: apt install python3-venv."
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    if not header.is_file():
        yield f"{header} is missing; messages are built against it. On Debian and Ubuntu: apt install python3-dev."
    for tool, package in {"gcc": "gcc", "g++": "g++", "cmake": "cmake", "make": "make"}.items():
        if shutil.which(tool) is None:
            yield f"`{tool}` is not on PATH; messages are built with it. On Debian and Ubuntu: apt install {package}."
    if ros_installed:
        if shutil.which("colcon") is None:
            yield "ROS 2 is sourced but `colcon` is missing. On Ubuntu: apt install python3-colcon-common-extensions."
        return
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        yield (
            f"ROS 2 from PyPI exists for x86-64 Linux only and this is {platform.system()} on {platform.machine()}. "
            "Install ROS 2 Jazzy, Kilted or Lyrical, source its setup file and run `make setup` again."
        )
    if sys.version_info >= (3, 15):
        yield f"ROS 2 from PyPI ends at Python 3.14 and this is {version}. Run `make setup PYTHON=/path/to/python3.11`."


def main() -> int:
    found = list(complaints(ros_installed=bool(os.environ.get("ROS_DISTRO"))))
    for complaint in found:
        print(f"setup: {complaint}", file=sys.stderr)
    return 2 if found else 0


if __name__ == "__main__":
    sys.exit(main())
