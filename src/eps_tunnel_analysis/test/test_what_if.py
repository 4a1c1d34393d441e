# SPDX-License-Identifier: Apache-2.0
"""One value moved over one play: the answer is that of a model which has the value."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import TRUTH, made_by, plays, start, step

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import roll_out
from eps_tunnel_analysis.values.sweep import WhatIf, adjustable
from labyrinth_sim.errors import InputError


def test_an_answer_is_what_compare_says_of_a_model_with_that_value() -> None:
    model, (play,) = start().with_values(TRUTH), plays((3.0,))
    prepared = WhatIf(model, play)
    for p in (12.0, 18.0):
        simulated = roll_out(model.with_values({"drive.x.p": p}), play)
        shown = compare(play.trials, simulated, prepared.ks, signals=prepared.tunnel.signals)
        answer = prepared.with_value("drive.x.p", p)
        assert [a.joint for a in answer.alikeness] == [a.joint for a in shown.alikeness]
        np.testing.assert_array_equal(answer.simulated, simulated.select(prepared.tunnel.signals).values[0])
        assert prepared.itself == shown.against_itself
    assert [a.joint for a in answer.alikeness] == [a.joint for a in prepared.given.alikeness]


def test_an_effect_that_the_model_lacks_comes_in_by_its_value() -> None:
    model = start().with_values(TRUTH)
    real = model.with_effect("backlash", "x", {"width": 0.01})
    prepared = WhatIf(model, Play("", made_by(real, step(4.0))))
    assert prepared.with_value("backlash.x.width", 0.0).alikeness[0].joint == prepared.given.alikeness[0].joint
    assert prepared.with_value("backlash.x.width", 0.01).alikeness[0].joint > prepared.given.alikeness[0].joint + 0.2


def test_what_is_offered_can_be_moved_within_its_range() -> None:
    model = start().with_values({"drive.x.p": 15.0}).with_effect("backlash", "x", {"width": 0.01})
    offered = {a.name: a for a in adjustable(model)}
    assert (offered["drive.x.p"].low, offered["drive.x.p"].given, offered["drive.x.p"].high) == (7.5, 15.0, 25.0)
    assert offered["backlash.x.width"].held
    assert not offered["backlash.y.width"].held
    assert "backlash.y.hold" not in offered, "alone it changes nothing"
    prepared = WhatIf(model, plays((3.0,))[0])
    for name in ("drive.x.p", "belt.belt_x.stiffness", "rate_limit.x.rate", "gravity_load.y.moment"):
        for value in (offered[name].low, offered[name].high):
            assert prepared.with_value(name, value).simulated.shape == prepared.given.simulated.shape


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [("drive.x.q", 1.0, "Did you mean 'drive.x"), ("drive.x.p", 26.0, "within"), ("drive.x.p", float("nan"), "within"),
     ("drive.y.p", 3.0, "known for these recordings")],
)  # fmt: skip
def test_what_cannot_be_moved_is_refused(name: str, value: float, complaint: str) -> None:
    (play,) = plays((3.0,))
    prepared = WhatIf(start(), replace(play, known={"drive.y.p": 2.0}))
    with pytest.raises(InputError, match=complaint):
        prepared.with_value(name, value)
