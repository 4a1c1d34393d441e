# SPDX-License-Identifier: Apache-2.0
"""The other axis in what a sensor reads and in what is commanded, as a law."""

import numpy as np
import pytest
from labyrinth_recordings import jerked, recorded

from eps_tunnel_analysis.diagnose.added_force import Playing
from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.law.depends import OF_OTHER, depends
from eps_tunnel_analysis.law.design import COMMAND, Design
from eps_tunnel_analysis.law.effect_file import declared, effect_file
from eps_tunnel_analysis.law.formula import Chosen, Term, command_dictionary, formulas, sensor_dictionary
from eps_tunnel_analysis.law.missing_force import missing_force
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate

PART = AxisPart(("y",), ("motor_y", "board_y"), ())
BOARD = PART.signals.index("board_y")
SHARE = 0.08
SAMPLES = 351


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("labyrinth")


def both(model: Model) -> Play:
    """Both axes move, each at its own pace."""
    commands = np.column_stack([jerked(3.1, 5.3, SAMPLES), jerked(4.3, 2.2, SAMPLES, 0.05, 1.0)])
    return recorded(model, PART.signals, commands)


def design(model: Model, play: Play, commanded: bool = True) -> Design:
    return Design.of(missing_force(model, [play], PART, nthread=1, passes=1, commanded=commanded))


@pytest.fixture(scope="module")
def terms(model: Model) -> tuple[Term, Term]:
    """What couples the other axis into a sensor, and into a command."""
    right = design(model, both(model))
    of_sensor, of_command = (
        next(t for t in terms if t.name == "coupled") for terms in (sensor_dictionary(right), command_dictionary(right))
    )
    return of_sensor, of_command


@pytest.mark.study
def test_a_belt_that_the_other_axis_turns_is_an_error_of_the_sensor_behind_it(model: Model) -> None:
    found = design(model, both(model.with_effect("cross_coupling", "y", {"share": SHARE})), commanded=False)
    first = depends(found, PART.signals).first
    assert first is not None and (first.over, first.acts) == ("curve_sensor_other", ("board_y", "sensor"))
    (best, *_) = formulas(found, sensor_dictionary(found), BOARD)
    assert [c.term.name for c in best.terms] == ["coupled"]
    assert best.terms[0].values["share"] == pytest.approx(SHARE, rel=0.1)


def test_a_command_into_which_the_other_one_is_mixed_has_a_term(model: Model, terms: tuple[Term, Term]) -> None:
    mixed = model.with_effect(declared(effect_file([Chosen(terms[1], {"share": SHARE})])), "y")
    found = design(model, both(mixed))
    said = depends(found, PART.signals)
    assert said.first is not None and OF_OTHER in [d.over for d in (said.first, *said.ties)]
    (best, *_) = formulas(found, command_dictionary(found), COMMAND)
    assert [c.term.name for c in best.terms] == ["coupled"]
    assert best.terms[0].values["share"] == pytest.approx(SHARE, rel=0.25)  # to first order


def test_what_the_files_do_is_what_the_columns_say(model: Model, terms: tuple[Term, Term]) -> None:
    play = both(model)
    in_sensor, in_command = (declared(effect_file([Chosen(term, {"share": SHARE})])) for term in terms)
    trials = play.trials
    without, seen = (simulate(m, trials) for m in (model, model.with_effect(in_sensor, "board_y")))
    expected = SHARE * without.values[0, :, without.index("motor_x")]
    changed = seen.values[0] - without.values[0]
    assert changed[:, seen.index("board_y")] == pytest.approx(expected, abs=1e-9) and np.ptp(expected) > 1e-3
    assert not np.delete(changed, seen.index("board_y"), axis=1).any()
    plain, acting = (Playing(m, [play], "y", PART.signals) for m in (model, model.with_effect(in_command, "y")))
    error = SHARE * plain.motion(0).other_command
    added, without_it = plain.residuals_commanded(0, np.stack([error, 0.0 * error]))
    mixed = acting.residuals(0, np.zeros((1, acting.count(0))))[0]
    assert np.abs(mixed - without_it).max() > 1e-3
    assert np.abs(mixed - added).max() < 0.02 * np.abs(mixed - without_it).max()
