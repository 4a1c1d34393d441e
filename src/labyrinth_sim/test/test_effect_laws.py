# SPDX-License-Identifier: Apache-2.0
"""Laws that every effect obeys; none is named here."""

import numpy as np
import pytest

from labyrinth_sim.effect import Effect, effects
from labyrinth_sim.model import Model, load_model, places
from labyrinth_sim.simulate import simulate

TIME = np.arange(201) * 0.01
EVERY = tuple(effects().values())


def play(model: Model, ball: bool) -> np.ndarray:
    """(T, m) of a lively command on both axes."""
    t = TIME
    u = 0.057 * np.sign(np.stack([np.sin(7 * t), np.sin(5 * t) * (t > 0.2)], axis=1))
    start = {"motor_x": 0.0, "ball_x": 0.1, "ball_y": 0.1} if ball else {"motor_x": 0.0}
    return np.asarray(simulate(model, t, u, start).values[0])


@pytest.fixture(scope="module")
def plain() -> Model:
    return load_model("labyrinth_manual")


@pytest.fixture(scope="module", params=EVERY, ids=lambda e: e.name)
def effect(request: pytest.FixtureRequest) -> Effect:
    assert isinstance(request.param, Effect)
    return request.param


def test_off_changes_no_bit(plain: Model, effect: Effect) -> None:
    ball = effect.where == "ball" or "ball" in effect.needs
    without = play(plain, ball)
    for place in places(plain.rig, effect):
        assert np.array_equal(play(plain.with_effect(effect, place, effect.off), ball), without)


def test_a_typical_value_shows(plain: Model, effect: Effect) -> None:
    ball = effect.where == "ball" or "ball" in effect.needs
    without = play(plain, ball)
    for place in places(plain.rig, effect):
        assert np.abs(play(plain.with_effect(effect, place), ball) - without).max() > 1e-5
