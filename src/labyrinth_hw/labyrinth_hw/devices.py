# SPDX-License-Identifier: Apache-2.0
"""What the hardware node asks of the machine: where the emulated testbed leaves its devices, and real-time priority.

Priority is used if the system grants it, for a control loop that must not wait on a busy machine.
"""

import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
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


def ask_for_priority(level: int = 10, *, children: bool = False) -> bool:
    """First-come scheduling for the calling thread. Returns whether it was granted.

    Python threads take turns, so every thread of a process that runs a control loop needs it: one that waits for the
    processor while it has its turn holds up the others, whatever their own priority.

    Args:
        level: the higher goes first.
        children: whether threads and processes started from now on have it too.
    """
    try:
        policy = os.SCHED_FIFO if children else os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(threading.get_native_id(), policy, os.sched_param(level))
    except (AttributeError, OSError):
        return False
    return True


@contextmanager
def ordinary_priority() -> Iterator[None]:
    """What is started inside the block has ordinary scheduling: it is slow, and the servos go first."""
    thread = threading.get_native_id()
    try:
        policy, parameter = os.sched_getscheduler(thread), os.sched_getparam(thread)
        os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
    except (AttributeError, OSError):
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(thread, policy, parameter)
