# SPDX-License-Identifier: Apache-2.0
"""Lets the tests import the modules of cases beside them, takes as long as a busy machine needs, and has bags."""

import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one servo on both sides; not to be changed."""
    from bag_files import both_sides

    return both_sides(tmp_path_factory.mktemp("bags"))
