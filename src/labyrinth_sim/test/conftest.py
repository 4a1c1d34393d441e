# SPDX-License-Identifier: Apache-2.0
"""Lets the tests import the modules beside them; the small rigs, and a ROS domain for each that starts a node."""

import os
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest
from domain_coordinator import domain_id

from labyrinth_sim.model import Model

sys.path.insert(0, str(Path(__file__).parent))

# Another one each time: what a killed node said may still linger on the last.
NUMBERS = count(os.getpid())


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test on this machine has."""
    with domain_id(lambda: 1 + next(NUMBERS) % 100) as domain:
        yield domain


@pytest.fixture(scope="module")
def model_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Model]:
    """The model of a rig of `small_rigs` with a drive."""
    from small_rigs import small

    folder: Path = tmp_path_factory.mktemp("rigs")
    made: dict[tuple[str, str], Model] = {}

    def model(rig: str, drive: str = "torque_pd") -> Model:
        if (rig, drive) not in made:
            made[rig, drive] = small(folder, rig, drive)
        return made[rig, drive]

    return model
