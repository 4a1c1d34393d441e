# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that nobody else who asks this way has, so that two demos on one machine do not hear each other."""

import os
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager

from labyrinth_sim.errors import InputError

DOMAINS = 100  # 1 to this; beyond 101 the ports of a domain reach into those that Linux hands out by chance


def _lock_port(domain: int) -> int:
    """The last UDP port of a domain by the DDS interoperability protocol (RTPS 9.6.1): that of a 120th participant."""
    return 7400 + 250 * domain + 249


@contextmanager
def own_domain(first: int | None = None) -> Iterator[int]:
    """A domain from 1 to 100, kept until the end; `first` is where the search begins, by default the process id.

    The lock is a port, not a file: it is shared as widely as the network in which nodes hear each other.
    """
    start = (os.getpid() if first is None else first) - 1
    for i in range(DOMAINS):
        domain = 1 + (start + i) % DOMAINS
        lock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with closing(lock):
            try:
                lock.bind(("127.0.0.1", _lock_port(domain)))
            except OSError:
                continue
            yield domain
            return
    raise InputError(f"All {DOMAINS} ROS domains are in use on this machine. End some demos or tests.")
