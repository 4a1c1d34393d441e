# SPDX-License-Identifier: Apache-2.0
"""Lets the tests import the bench beside them, and sets it up."""

import os
import sys
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest
from domain_coordinator import domain_id

sys.path.insert(0, str(Path(__file__).parent))

from hw_bench import Bench

# Another one each time: what a killed node said may still linger on the last.
NUMBERS = count(os.getpid())


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine has."""
    with domain_id(lambda: 1 + next(NUMBERS) % 100) as domain:
        yield domain


@pytest.fixture
def bench(tmp_path: Path, domain: int) -> Iterator[Bench]:
    made = Bench(tmp_path, domain)
    yield made
    made.close()


@pytest.fixture
def running(bench: Bench) -> Bench:
    """The bench with testbed and node started, and joint states coming."""
    bench.start_testbed()
    bench.start_node()
    bench.more_states(5)
    return bench
