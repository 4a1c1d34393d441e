# SPDX-License-Identifier: Apache-2.0
"""What changed between two dates, on the emulated rig, whose physics shares no line with the model's."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import testbed_cases

from eps_tunnel_analysis.diagnose.axis_search import SearchOptions
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command, Hold, Ramp, Step, Triangle
from eps_tunnel_analysis.values.changes import Changes, changes, over_dates
from labyrinth_hw.testbed.hidden import Hidden, hide
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model, load_model

WORN = np.radians(0.2)  # of slack, from the beginning
FRICTION = 0.05  # N m, from the beginning
CANDIDATES = ("backlash", "coulomb_friction", "viscous_friction", "belt_compliance", "sensor_bias", "gravity_load",
              "drive")  # fmt: skip


def command() -> Command:
    d = np.radians
    x = (Hold(0.3), Step(0.7, d(3.0)), Step(0.6, d(-2.0)), Ramp(0.8, d(2.0)), Triangle(1.2, d(1.5), 1.25), Step(0.4, 0))
    return Command("wear", ("motor_x", "motor_y"), (0.0, 0.0), (x, (Hold(4.0),)))


def played(seed: int, *more: Hidden, slack: float = WORN, friction: float = FRICTION) -> Play:
    first = (hide("backlash", "x", values={"play": slack}), hide("coulomb_friction", "x", values={"coulomb": friction}))
    return testbed_cases.play(testbed_cases.rig((*first, *more)), command(), seed)


@pytest.fixture(scope="module")
def then() -> Play:
    return played(1)


def model() -> Model:
    """Near the rig as it was; its values for the drive are the data sheet's."""
    known = load_model("labyrinth_mx64").with_effect("backlash", "x", {"width": float(WORN)})
    return known.with_effect("coulomb_friction", "x", {"torque": FRICTION})


def found(then: Play, now: Play) -> Changes:
    return changes(model(), [then], [now], CANDIDATES, keep_values=True, run=SearchOptions(None, 1))


def only_value(result: Changes) -> tuple[float, float, float]:
    (value,) = result.values
    return value.then, value.now, value.half_width


def test_a_rig_as_it_was_has_not_changed(then: Play) -> None:
    result = found(then, played(2))
    assert result.outcome == "nothing", result.sentence
    assert not result.values
    assert "Nothing changed" in result.sentence
    assert result.paired == (1, 1)


@pytest.mark.study
def test_a_belt_that_slackens_is_more_backlash(then: Play) -> None:
    result = found(then, played(3, slack=np.radians(0.5)))
    assert (result.outcome, result.named) == ("changed", ("backlash.x",)), result.sentence
    was, now, half = only_value(result)
    assert was == pytest.approx(WORN)
    # The rig's slack belt rattles as the model's does not, so the fitted width comes out a fifth low.
    assert now == pytest.approx(np.radians(0.5), rel=0.25) and half < now - was


def test_friction_that_doubles_is_named_and_measured(then: Play) -> None:
    result = found(then, played(4, friction=2 * FRICTION))
    assert (result.outcome, result.named) == ("changed", ("coulomb_friction.x",)), result.sentence
    was, now, half = only_value(result)
    assert abs(now - was - FRICTION) < half < 0.3 * FRICTION


@pytest.mark.study
def test_a_belt_that_stretches_is_an_effect_that_was_not_there(then: Play) -> None:
    result = found(then, played(5, hide("belt_compliance", "x", values={"belt_stiffness": 10.0})))
    assert (result.outcome, result.named) == ("changed", ("belt_compliance.x",)), result.sentence
    was, now, _ = only_value(result)
    assert was == 0.0
    assert 0.4 < now / (1 / 10 - 1 / 100) < 1.2  # a healthy belt has 100 N m/rad; the model's damps otherwise


@pytest.mark.study
def test_a_potentiometer_that_slipped_is_told_from_a_load_and_followed_over_dates(then: Play) -> None:
    slipped = played(6, hide("sensor_bias", "board_x", values={"pot_bias": 0.008}))
    result = found(then, slipped)
    assert (result.outcome, result.named) == ("changed", ("sensor_bias.board_x",)), result.sentence
    assert only_value(result)[1] == pytest.approx(0.008, abs=5e-4)
    half_way = played(7, hide("sensor_bias", "board_x", values={"pot_bias": 0.004}))
    dates = over_dates(
        result.model, {"then": [then], "may": [half_way], "now": [slipped]}, result.named, run=SearchOptions(None, 1)
    )
    assert [d.label for d in dates] == ["then", "may", "now"]
    assert dates[0].values == ()
    assert [d.values[0].now for d in dates[1:]] == pytest.approx([0.004, 0.008], abs=5e-4)
    assert dates[0].alikeness[5.0] > dates[1].alikeness[5.0] >= dates[2].alikeness[5.0]


def test_what_cannot_have_changed_is_refused(then: Play) -> None:
    with pytest.raises(InputError, match=r"Values that can change: drive\.x\.p"):
        changes(model(), [then], [then], ["frction"], keep_values=True)
