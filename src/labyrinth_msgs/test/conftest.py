# SPDX-License-Identifier: Apache-2.0
"""A ROS domain for the tests that start nodes."""

from collections.abc import Iterator

import pytest
from domain_coordinator import domain_id


@pytest.fixture(scope="module")
def module_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine has."""
    with domain_id() as domain:
        yield domain
