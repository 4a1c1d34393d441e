# SPDX-License-Identifier: Apache-2.0
"""A sensor that is late, as a law: what its error depends on, and by how much it is late."""

import numpy as np
import pytest
from labyrinth_recordings import jerked, recorded

from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.law.depends import depends
from eps_tunnel_analysis.law.design import Design
from eps_tunnel_analysis.law.effect_file import declared, effect_file
from eps_tunnel_analysis.law.formula import Chosen, formulas, sensor_dictionary
from eps_tunnel_analysis.law.missing_force import missing_force
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model, load_model

PART = AxisPart(("x",), ("motor_x", "board_x"), ())
DELAY = 0.02  # s


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("labyrinth")


def alone(model: Model) -> Play:
    """Axis x moves alone."""
    command = jerked(3.1, 5.3, 601)
    return recorded(model, PART.signals, np.column_stack([command, np.zeros_like(command)]))


def design(model: Model, play: Play) -> Design:
    return Design.of(missing_force(model, [play], PART, nthread=1, passes=1))


@pytest.mark.study
def test_a_sensor_that_is_late_is_off_by_its_speed_and_its_delay_is_found(model: Model) -> None:
    late = model.with_effect("sensor_delay", "board_x", {"delay": DELAY})
    found = design(model, alone(late))
    first = depends(found, PART.signals).first
    assert first is not None
    assert (first.variable, first.curve, first.place) == (
        "speed, as a sensor's error", "curve_sensor_speed", "board_x"
    )  # fmt: skip
    (best, *_) = formulas(found, sensor_dictionary(found), PART.signals.index("board_x"))
    assert [c.term.name for c in best.terms] == ["late"]
    assert best.terms[0].values["delay"] == pytest.approx(DELAY, rel=0.1)


@pytest.mark.parametrize(("name", "values"), [
    ("play", {"width": 0.02}),
    pytest.param("far_end", {"share": 1.0, "frequency": 25.0, "damping": 0.05}, marks=pytest.mark.study),
])  # fmt: skip
def test_a_sensor_behind_a_play_or_a_flexible_link_is_found_by_its_term(
    model: Model, name: str, values: dict[str, float]
) -> None:
    terms = {term.name: term for term in sensor_dictionary(design(model, alone(model)))}
    behind = model.with_effect(declared(effect_file([Chosen(terms[name], values)])), "board_x")
    found = design(model, alone(behind))
    (best, *_) = formulas(found, sensor_dictionary(found), PART.signals.index("board_x"))
    term = best.terms[0]
    assert term.term.name == name
    for number in term.term.numbers[:2]:
        assert term.values[number.name] == pytest.approx(values[number.name], rel=0.1)


def test_no_sensor_is_early(model: Model) -> None:
    """The model says that it is late, and it is not: no delay can mend that."""
    late = model.with_effect("sensor_delay", "board_x", {"delay": DELAY})
    found = design(late, alone(model))
    laws = formulas(found, sensor_dictionary(found), PART.signals.index("board_x"))
    assert not [c for law in laws for c in law.terms if c.term.name == "late"]
