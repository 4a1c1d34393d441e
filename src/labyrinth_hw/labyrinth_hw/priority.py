# SPDX-License-Identifier: Apache-2.0
"""Real-time priority where the system grants it: a control loop that must not wait for a busy machine."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager


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
