# SPDX-License-Identifier: Apache-2.0
"""Every effect of the library obeys the laws of effects."""

import pytest
from effect_laws import LAWS, Law, Played, Scenes, every_scene, played

from labyrinth_sim.effect import Effect, effects


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    return every_scene()


@pytest.fixture(scope="module")
def without(scenes: Scenes) -> Played:
    return played(scenes)


@pytest.mark.parametrize("effect", effects().values(), ids=lambda e: e.name)
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_law(law: Law, effect: Effect, scenes: Scenes, without: Played) -> None:
    law(effect, scenes, without)
