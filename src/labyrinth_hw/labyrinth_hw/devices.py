# SPDX-License-Identifier: Apache-2.0
"""Where the emulated testbed leaves its devices, so that the hardware node finds them by itself."""

import os
import tempfile
from pathlib import Path

SERVOS, SENSORS, CAMERA, TESTBED = "servos", "sensors", "camera", "testbed"
VARIABLE = "LABYRINTH_TESTBED_DIR"


def default_link_dir() -> Path:
    """The folder: $LABYRINTH_TESTBED_DIR, else under the user's runtime folder, else under the one for scratch."""
    if VARIABLE in os.environ:
        return Path(os.environ[VARIABLE])
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / "labyrinth_testbed"
    return Path(tempfile.gettempdir()) / f"labyrinth_testbed_{os.getuid()}"


def device(path: str) -> str:
    """A serial device's path; a bare name means a link of the emulated testbed."""
    return path if "/" in path else str(default_link_dir() / path)


def camera_source(source: str) -> str | None:
    """A camera's source; for "testbed" the address that the testbed wrote down, None where there is none."""
    if source != TESTBED:
        return source
    try:
        return (default_link_dir() / CAMERA).read_text(encoding="utf-8").strip() or None
    except OSError:
        return None
