# SPDX-License-Identifier: Apache-2.0
"""Real-time priority where the system grants it: a control loop that must not wait for a busy machine."""

import os
import threading


def ask_for_priority(level: int = 10) -> bool:
    """First-come scheduling for the calling thread, not for its children. Returns whether it was granted."""
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(threading.get_native_id(), policy, os.sched_param(level))
    except (AttributeError, OSError):
        return False
    return True
