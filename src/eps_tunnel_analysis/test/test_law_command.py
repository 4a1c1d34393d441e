# SPDX-License-Identifier: Apache-2.0
"""Errors of a command as a law: one that takes effect late, and one that is off by an amount that depends on it."""

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.added_force import Playing
from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.law.depends import depends
from eps_tunnel_analysis.law.design import COMMAND, Design
from eps_tunnel_analysis.law.effect_file import declared, effect_file
from eps_tunnel_analysis.law.formula import Chosen, Term, command_dictionary, formulas
from eps_tunnel_analysis.law.missing_force import missing_force
from eps_tunnel_analysis.law.proposal import propose
from eps_tunnel_analysis.law.variables import LATENESS, apart, periods
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.report.law_section import law
from eps_tunnel_analysis.report.page import render
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Trials

PART = AxisPart(("pendulum",), ("pendulum",), ())
SIZE, PERIOD = 0.02, 0.5  # rad, of a command's waves


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("pendulum")


def played(model: Model, seed: int, off: bool = False) -> Play:
    """Three trials of a swing with steps on it, with the noise of an encoder."""
    t = np.arange(451) * 0.01
    command = (0.6 * np.sin(2.2 * t) + 0.3 * np.sign(np.sin(4.1 * t)) * (t > 0.3))[:, None]
    command = np.full_like(command, np.nan) if off else command
    fine = np.arange(4 * len(t) - 3) * 0.0025  # s: a firmware is quicker than what records it
    held = np.repeat(command, 4, axis=0)[: len(fine)]
    clean = simulate(model, fine, held, {"pendulum": 0.4} if off else None)
    seen = clean.values[:, ::4] + 1e-3 * np.random.default_rng(seed).normal(size=(3, len(t), len(clean.signals)))
    block = np.repeat(command[None], 3, axis=0)
    return Play("swing", Trials(t, clean.signals, clean.units, seen, clean.command_channels, block))


def design(model: Model, play: Play) -> Design:
    return Design.of(missing_force(model, [play], PART, nthread=1, passes=1, commanded=True))


@pytest.fixture(scope="module")
def terms(model: Model) -> dict[str, Term]:
    return {term.name: term for term in command_dictionary(design(model, played(model, 1)))}


def chosen(term: Term) -> tuple[Chosen, float, float]:
    """A term with numbers, its shape and its size."""
    shape = float(f"{term.shape[len(term.shape) // 2]:.3g}") if term.shape else 0.0  # as a file states it
    only = term.once
    values = {n.name: shape if only or n.name == "period" else 0.0 if n.name == "phase" else SIZE for n in term.numbers}
    return Chosen(term, values), shape, 1.0 if only else SIZE


def test_every_error_of_a_command_in_a_file_is_what_its_column_says(model: Model, terms: dict[str, Term]) -> None:
    assert {*LATENESS, "wave", "ticks", "scale", "offset"} == {*terms}
    play = played(model, 1)
    plain = Playing(model, [play], "pendulum", PART.signals)
    for name, term in terms.items():
        law, shape, size = chosen(term)
        acting = Playing(model.with_effect(declared(effect_file([law])), "pendulum"), [play], "pendulum", PART.signals)
        seen = acting.residuals(0, np.zeros((1, acting.count(0))))[0]
        error = size * term.columns(plain.motion(0), shape)[:, 0]
        added, without = plain.residuals_commanded(0, np.stack([error, 0.0 * error]))
        assert np.abs(seen - without).max() > 1e-3, name
        assert np.abs(seen - added).max() < 0.05 * np.abs(seen - without).max(), name


@pytest.mark.parametrize(("effect", "values", "found"), [
    ("rate_limit", {"rate": 1.5}, "limit"),
    pytest.param("motion_profile", {"acceleration": 8.0}, "profile", marks=pytest.mark.study),
    pytest.param("command_delay", {"delay": 0.06}, "late", marks=pytest.mark.study),
    pytest.param("positioning_error", {"amplitude": SIZE, "period": PERIOD}, "", marks=pytest.mark.study),
])  # fmt: skip
def test_what_is_wrong_with_a_command_is_named_and_has_a_term(
    model: Model, effect: str, values: dict[str, float], found: str
) -> None:
    play = played(model.with_effect(effect, "pendulum", values), 2)
    own = design(model, play)
    said = depends(own, PART.signals)
    assert said.first is not None
    near = [said.first, *said.ties]
    assert any(d.of_command and (d.late == found if found else d.period) for d in near), [d.variable for d in near]
    # A delay and a lag explain as much in the linear problem; roll-outs tell them apart.
    laws = [law.terms[0] for law in formulas(own, command_dictionary(own), COMMAND)[:2]]
    term = next(law for law in laws if law.term.name == (found or "wave"))
    number = next(iter(values.values()))
    expected = {"limit": 1.0 / number, "profile": 1.0 / number, "late": number, "": SIZE}[found]
    assert next(iter(term.values.values())) == pytest.approx(expected, rel=0.25)


@pytest.mark.study
def test_a_late_command_is_proposed_and_roll_outs_fit_it(model: Model) -> None:
    late = model.with_effect("motion_profile", "pendulum", {"acceleration": 8.0})
    found = propose(model, [played(late, 2)], PART, nthread=1)
    assert found.refit is not None and found.refit.held_out < 0.02 * found.base_held_out
    assert found.depends.first is not None and found.depends.first.late == "profile"
    assert "looks like a limit of the command's acceleration" in found.sentence
    slowness = found.refit.values["proposed_effect.pendulum.profile_slowness"]
    assert 1.0 / slowness == pytest.approx(8.0, rel=0.05)
    page = render("title", "subtitle", [law(found)])
    assert "looks like a limit of the command" in page
    assert 'stage="command"' in found.text and found.visit is not None and not found.curve


def test_nothing_is_said_of_a_command_that_is_right_or_absent(model: Model) -> None:
    right = depends(design(model, played(model, 3)), PART.signals)
    assert right.first is None and any(d.of_command for d in right.dependences)
    off = depends(design(model, played(model, 3, off=True)), PART.signals)
    assert not any(d.of_command for d in off.dependences)


def test_waves_over_a_command_of_few_values_are_not_tried(model: Model) -> None:
    """They could be any function of these values."""
    own = design(model, played(model, 1))
    assert apart(own) < 0.02 and len(periods(own, COMMAND)) > 50
    t = np.arange(451) * 0.01
    steps = np.array([0.0, 0.5, -0.3, 0.2, 0.6, -0.5, 0.1, 0.4, -0.2, 0.3])[(t // 0.45).astype(int) % 10][:, None]
    run = simulate(model, t, steps)
    play = Play("steps", Trials(t, run.signals, run.units, run.values, run.command_channels, steps[None]))
    few = design(model, play)
    assert apart(few) > 0.09 and {*LATENESS, "scale", "offset"} <= {term.name for term in command_dictionary(few)}
    assert not [p for p in periods(few, COMMAND) if p < 0.39]
    assert not [t for t in command_dictionary(few) if t.name == "ticks" and min(t.shape) < 0.39]
