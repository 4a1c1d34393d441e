# SPDX-License-Identifier: Apache-2.0
"""Lets the tests import the bench beside them, and sets it up."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from hw_bench import Bench


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
