# SPDX-License-Identifier: Apache-2.0
"""A set of effects is ranked beside those of fewer that it contains; what is not needed is named in a note."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose import axis as axis_module
from eps_tunnel_analysis.diagnose import doubts
from eps_tunnel_analysis.diagnose.axis import near_hypotheses
from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.diagnose.rank import Hypothesis
from eps_tunnel_analysis.diagnose.refits import Refit


def refit(cost: float, *effects: str) -> Refit:
    return Refit(effects, np.zeros(1), np.full(4, np.sqrt(cost)), cost, 3, True)


def test_the_best_of_fewer_effects_is_ranked_however_much_it_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(axis_module, "hypothesis", lambda search, r, contains: Hypothesis(r, r.residuals))
    monkeypatch.setattr(axis_module, "contained", lambda *_: None)
    monkeypatch.setattr(axis_module, "inexact_share", lambda *_: 1.0)
    three = [refit(5.0 + 0.1 * i, "a.x", "b.x", f"{name}.x") for i, name in enumerate("cdefghijklmn")]
    fewer = [refit(9.6, "a.x", "b.x"), refit(54.0, "a.x"), refit(74.0, "b.x")]
    search: Any = None
    ranked = [h.refit.effects for h in near_hypotheses(search, refit(900.0), [*three, *fewer, refit(60.0, "z.x")])]
    assert ranked[:10] == [r.effects for r in three[:10]]
    assert ranked[10:] == [("a.x",), ("a.x", "b.x")]


def note(best: Refit, *others: Refit) -> list[str]:
    axis: Any = SimpleNamespace(search=None, best=best, refits=(best, *others), part=AxisPart(("x",), (), ()))
    return list(doubts._not_needed(axis))


def test_what_a_further_effect_would_take_away_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    contains = {("a.x", "b.x"), ("wide.x", "b.x")}
    monkeypatch.setattr(doubts, "contained", lambda _, larger, smaller: larger.effects in contains or None)
    best = refit(74.0, "a.x")
    (said,) = note(best, refit(9.6, "wide.x", "b.x"), refit(12.0, "a.x", "b.x"), refit(1.0, "c.x", "d.x"))
    assert said.startswith("Axis x: b.x + wide.x would leave 9.6 of the 74 floors that remain with a.x.")
    assert note(best, refit(70.0, "a.x", "b.x")) == [], "it takes too little"
    assert note(refit(1.0, "a.x"), refit(0.7, "a.x", "b.x")) == []
    assert note(refit(74.0), refit(9.6, "a.x", "b.x")) == [], "nothing is named that it could be beside"
