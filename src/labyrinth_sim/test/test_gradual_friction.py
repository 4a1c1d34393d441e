# SPDX-License-Identifier: Apache-2.0
"""Dry friction that sets in gradually, against its equation, and beside friction that does not."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from test_effect_equations import INERTIA, TIME, ModelOf, integrated, play


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("effect", "loses"), [("coulomb_friction", (1, -1)), ("direction_friction", (1,))])
def test_friction_that_sets_in_gradually(model_of: ModelOf, effect: str, loses: tuple[int, ...], sign: float) -> None:
    model = model_of("horn").with_effect(effect, "a", {"torque": 0.02, "slow": 0.1})
    loss = 0.02 / INERTIA if sign in loses else 0.0
    expected = integrated(lambda w: -loss * np.tanh(w / 0.1), [0.4], TIME)[:, 0]
    assert sign not in loses or expected[-1] < 0.05  # well into where it fades
    assert play(model, TIME, a_speed=sign * 0.4)["a_speed"] == pytest.approx(sign * expected, abs=4e-3)


@pytest.mark.parametrize("effect", ["coulomb_friction", "direction_friction"])
def test_it_is_sharp_unless_stated_and_close_to_that_where_it_sets_in_at_once(model_of: ModelOf, effect: str) -> None:
    sharp = model_of("horn").with_effect(effect, "a", {"torque": 0.02})
    assert sharp.values()[f"{effect}.a.slow"] == 0.0
    steep = sharp.with_values({f"{effect}.a.slow": 1e-3})
    runs = [play(model, TIME, a_speed=0.4)["a_speed"] for model in (sharp, steep)]
    assert runs[1] == pytest.approx(runs[0], abs=3e-3)
