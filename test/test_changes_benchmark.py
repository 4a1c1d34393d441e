# SPDX-License-Identifier: Apache-2.0
"""How the benchmark of wear counts, and that every kind of wear is one that a verdict can name."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from changes import WEAR, as_then, command, figures, played

from eps_tunnel_analysis.diagnose.candidates import library


def said(wear: int, outcome: str, *named: str, stated: tuple[str, ...] = (), measured=None):
    kind = WEAR[wear]
    return {"wear": kind.name, "truth": kind.truth, "change": kind.change, "outcome": outcome, "named": list(named),
            "stated": list(stated), "measured": measured}  # fmt: skip


def test_a_change_is_right_undecided_or_wrong_and_nothing_counts_half() -> None:
    friction = "coulomb_friction.x"
    found = figures([
        said(2, "changed", friction, measured=[0.051, 0.002]),
        said(2, "changed", friction, measured=[0.055, 0.002]),
        said(2, "changed", friction, "drive.x.p"),
        said(2, "undecided", friction, stated=(friction, "drive.x.p")),
        said(2, "undecided", "drive.x.p", stated=("drive.x.p", "drive.x.d")),
        said(2, "nothing"),
        said(4, "nothing"),
        said(4, "undecided", friction, stated=("none", friction)),
    ])  # fmt: skip
    assert found["right"].value == pytest.approx(2 / 6) and found["right"].n == 6
    assert found["undecided"].value == pytest.approx(1 / 6) and found["wrong"].value == pytest.approx(3 / 6)
    assert found["false_alarm"].value == pytest.approx(1 / 2)
    assert found["interval_held"].value == pytest.approx(1 / 2) and found["interval_held"].n == 2
    assert found["right_friction"].n == 6 and found["right_belt"].value is None
    low, high = found["right"].interval or (0.0, 0.0)
    assert 0.0 < low < 2 / 6 < high < 1.0


@pytest.mark.study
def test_each_kind_can_be_named_and_shows_in_what_is_recorded() -> None:
    model = as_then()
    known = {c.name for c in library(model, ()).candidates} | {f"{u.effect.name}.{u.place}" for u in model.effects}
    assert {kind.truth for kind in WEAR if kind.truth} <= known
    every = {name for c in library(model, ()).candidates for name in c.parameters} | set(model.parameters())
    assert {kind.parameter for kind in WEAR if kind.parameter} <= every
    then, again = (played(seed, WEAR[-1]).trials.values.mean(axis=0) for seed in (1, 2))

    def off(now: np.ndarray) -> float:
        """Root mean square of the signal that differs most, rad."""
        return float(np.sqrt(np.mean((now - then)[:, :4] ** 2, axis=0)).max())

    for kind in WEAR[:-1]:
        assert off(played(3, kind).trials.values.mean(axis=0)) > 1.5 * off(again), kind.name
    assert command().duration == pytest.approx(4.0, abs=0.7)
