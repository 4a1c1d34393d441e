# SPDX-License-Identifier: Apache-2.0
"""From recordings of a force that no effect of the library is, to its formula, its file and a model with it."""

import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.added_force import Motion, Playing
from eps_tunnel_analysis.diagnose.axis_search import AxisPart
from eps_tunnel_analysis.law import proposal as proposal_module
from eps_tunnel_analysis.law.depends import Dependence, Depends
from eps_tunnel_analysis.law.design import Design
from eps_tunnel_analysis.law.effect_file import declared, effect_file
from eps_tunnel_analysis.law.formula import Chosen, Formula, dictionary, formulas, sensor_dictionary
from eps_tunnel_analysis.law.missing_force import MissingForce, missing_force
from eps_tunnel_analysis.law.naming import as_proposed, refuted, ways, with_first
from eps_tunnel_analysis.law.proposal import (
    Confirmation,
    Proposal,
    Refitted,
    confirmed,
    fewer_terms,
    propose,
    runs_away,
)
from eps_tunnel_analysis.outputs import json_text, plain
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.report.law_section import law
from eps_tunnel_analysis.report.page import Chart, render
from eps_tunnel_analysis.sequence import Chirp
from eps_tunnel_analysis.sequence_file import load_sequence
from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Trials

SIZE, PERIOD, PHASE = 0.03, 0.35, 0.5  # N m, rad, rad: of the waves that are hidden
PART = AxisPart(("pendulum",), ("pendulum",), ())
SECONDS = 4.0
WITHIN = 0.7, 0.95  # an interval of a share


def waves(live: Live, site: Site, values: Values) -> None:
    live.applied[:, site.dof] += values["size"] * np.sin(2 * np.pi * live.qpos[:, site.qpos] / PERIOD + PHASE)


WAVES = Effect(
    "hidden_waves", "", "", "", (Parameter("size", "N m", 0.0, 1.0, 0.0, SIZE, ""),), "force", "", "by_angle", (), "",
    step=waves,
)  # fmt: skip


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("pendulum")


def played(model: Model, seed: int, slow: float = 0.4) -> Play:
    """Three trials of two sines, with the noise of an encoder."""
    t = np.arange(round(SECONDS / 0.01) + 1) * 0.01
    command = (np.sin(2 * np.pi * slow * t) + 0.4 * np.sin(2 * np.pi * 1.1 * t))[:, None]
    clean = simulate(model, t, command)
    noise = np.random.default_rng(seed).normal(size=(3, *clean.values.shape[1:]))
    values = clean.values + 1e-3 * noise
    block = np.repeat(command[None], 3, axis=0)
    return Play("sines", Trials(clean.time, clean.signals, clean.units, values, clean.command_channels, block))


@pytest.fixture(scope="module")
def hidden(model: Model) -> Model:
    return model.with_effect(WAVES, "pendulum")


@pytest.fixture(scope="module")
def proposal(model: Model, hidden: Model) -> Proposal:
    """Without terms by themselves, of which none is a wave: test_law_single_terms.py tries those."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proposal_module, "single_terms", lambda *_: [])
        return propose(model, [played(hidden, 1)], PART, nthread=1)


def test_a_hidden_wave_is_found_with_its_period_size_and_phase(proposal: Proposal) -> None:
    first = proposal.depends.first
    assert first is not None and first.period is not None
    assert (first.curve, first.place) == ("curve_angle", "pendulum")
    assert first.period == pytest.approx(PERIOD, rel=0.03)
    assert first.share > 0.8
    assert proposal.kind == "formula" and proposal.refit is not None
    values = {name.rpartition(".")[2]: v for name, v in proposal.refit.values.items()}
    assert values["wave_size"] == pytest.approx(SIZE, rel=0.05)
    assert values["wave_period"] == pytest.approx(PERIOD, rel=0.01)
    assert values["wave_phase"] == pytest.approx(PHASE, abs=0.1)
    assert proposal.refit.intervals["proposed_effect.pendulum.wave_size"] < 0.2 * SIZE
    assert proposal.refit.held_out < 0.02 * proposal.base_held_out


INERTIA, FREQUENCY, DAMPED = 0.03, 9.0, 0.04  # kg m^2, rad/s, 1: of the mass that swings


def hang(spec: mujoco.MjSpec, site: Site) -> None:
    """A body of its own, on a spring: what is proposed is no body."""
    joint = spec.joint(site.the_axis.joint)
    body = joint.parent.add_body(name="swinging", mass=1e-9, inertia=[INERTIA] * 3, ipos=joint.pos)
    body.explicitinertial = True
    stiffness, damping = INERTIA * FREQUENCY**2, 2.0 * DAMPED * FREQUENCY * INERTIA
    body.add_joint(name="swings", axis=joint.axis, pos=joint.pos, stiffness=stiffness, damping=damping)


@pytest.mark.study
def test_a_mass_that_swings_on_the_joint_is_found_with_its_frequency_and_inertia(model: Model) -> None:
    swings = replace(WAVES, name="hidden_mass", step=None, spec=hang)
    hidden = model.with_effect(swings, "pendulum")
    found = propose(model, [played(hidden, 1)], PART, nthread=1)
    assert found.depends.first is not None and found.depends.first.frequency == pytest.approx(FREQUENCY, rel=0.05)
    assert found.kind == "formula" and found.refit is not None
    values = {name.rpartition(".")[2]: v for name, v in found.refit.values.items()}
    assert values["swinging_frequency"] == pytest.approx(FREQUENCY, rel=0.03)
    assert values["swinging_inertia"] == pytest.approx(INERTIA, rel=0.1)
    assert found.refit.held_out < 0.02 * found.base_held_out
    assert found.visit is not None and found.visit.name == "visit_swing_pendulum"
    (chirp,) = (shape for shape in found.visit.command.shapes[0] if isinstance(shape, Chirp))
    assert chirp.start_frequency < FREQUENCY / (2.0 * np.pi) < chirp.end_frequency
    assert f"a mass that swings on it at {FREQUENCY / (2.0 * np.pi):.1f}" in found.sentence
    again = confirmed(found, [played(hidden, 2, slow=0.7)], nthread=1)
    assert again.confirmation is not None and again.confirmation.holds


def test_another_command_confirms_what_is_proposed_or_not(proposal: Proposal, model: Model, hidden: Model) -> None:
    assert proposal.confirmation is None and "not confirmed" in proposal.sentence
    right = confirmed(proposal, [played(hidden, 2, slow=0.7)], nthread=1)
    assert right.confirmation is not None and right.confirmation.holds
    assert right.confirmation.after < 0.1 * right.confirmation.before
    assert "Confirmed on another command" in right.sentence and right.to_json()["confirmed"] is True
    # A rig without the waves: there the law that was found does harm.
    wrong = confirmed(proposal, [played(model, 2, slow=0.7)], nthread=1)
    assert wrong.confirmation is not None and not wrong.confirmation.holds
    assert not Confirmation(0.5, 0.4).holds  # nothing is left to explain there


@pytest.mark.study
def test_a_law_that_runs_away_where_the_recordings_did_not_go_is_none(
    model: Model, proposal: Proposal, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert proposal.model is not None and proposal.visit is not None
    command = proposal.visit.command
    assert not runs_away(proposal.model, command)
    terms = {term.name: term for term in dictionary(Design.of(missing_force(model, [played(model, 3)], PART, 1)))}

    def with_term(name: str, size: str) -> Model:
        chosen = Chosen(terms[name], {size: -50.0, "after": 0.02})
        late = model.with_effect(declared(effect_file((chosen,))), "pendulum")
        return late.with_values({f"proposed_effect.pendulum.{name}_{size}": -50.0})

    assert runs_away(with_term("creeping", "stiffness"), command)
    assert not runs_away(with_term("trailing", "damping"), command), "it must not drive the joint"
    monkeypatch.setattr(proposal_module, "runs_away", lambda *_: True)
    assert propose(model, [played(model.with_effect(WAVES, "pendulum"), 1)], PART, nthread=1).kind != "formula"


def test_what_is_proposed_holds_on_another_command(proposal: Proposal, model: Model, hidden: Model) -> None:
    other = played(hidden, 2, slow=0.7).trials
    before, after = (
        np.sqrt(np.mean((simulate(m, other).values[0, :, 0] - other.values[:, :, 0].mean(axis=0)) ** 2))
        for m in (model, proposal.model)
        if m is not None
    )
    assert after < 0.1 * before


def test_the_file_is_an_effect_and_the_model_reads_it(proposal: Proposal, tmp_path: Path) -> None:
    proposal.write(tmp_path)
    again = load_model(tmp_path / "proposed_model.yaml", tmp_path)
    assert again.values() == pytest.approx(proposal.model.values() if proposal.model else {})
    assert "proposed_effect" in again.registry.effects
    with pytest.raises(FileExistsError):
        proposal.write(tmp_path)


def test_report_and_json_tell_variable_formula_and_what_is_left(proposal: Proposal) -> None:
    page = render("title", "subtitle", [law(proposal)])
    assert "without a formula" in page and "To see more of it, play visit_angle_pendulum.yaml" in page
    assert "A sin(2 pi angle / L + phase)" in page and "proposed_effect.pendulum.wave_period" in page
    first = proposal.depends.first
    assert first is not None and first.period is not None
    period = f"{np.degrees(first.period):.4g} deg"
    assert f"with a period of {period}" in proposal.sentence and page.count(period) >= 2
    assert re.search(r"wave_period</td><td[^>]*>20\.\d+ deg ± [0-9.]+ deg<", page)
    assert f"{np.degrees(proposal.curve[0][0]):.3g}</td>" in page and "angle, deg</th>" in page
    content = json.loads(json_text(plain(proposal.to_json())))
    assert content["file"] == "proposed_effect.py" and content["depends_on"][0]["named"] is True
    assert content["refit"]["held_out"] < content["base_held_out"]


def test_the_force_is_drawn_over_every_variable_beside_the_models_own_and_with_what_is_left(proposal: Proposal) -> None:
    charts = {b.label: b for b in law(proposal).blocks if isinstance(b, Chart)}
    over = {"angle", "speed", "direction", "load", "command", "time since reversal", "time"}
    assert {f"Missing force over {name}" for name in over} <= set(charts)
    force, drive = charts["Missing force over load"].lines
    assert force.spread is not None and drive.values.std() > force.values.std()
    assert len(charts["pendulum: how trials differ, over their number"].x) == 3
    curve = charts["What is missing over angle, without a formula"]
    # Ten knots are too few for these waves, and the band says so.
    assert curve.lines[0].spread is not None and (curve.lines[0].spread > 0.005).all()
    before, after = charts["What is left over time"].lines
    assert after.values.std() < 0.2 * before.values.std()


def test_the_command_that_is_proposed_stays_within_the_limits_and_visits_what_was_not(
    proposal: Proposal, model: Model, tmp_path: Path
) -> None:
    proposal.write(tmp_path)
    assert proposal.visit is not None
    command = load_sequence(tmp_path / f"{proposal.visit.name}.yaml").commands[0]
    _, targets = command.sample(100.0)
    angle = proposal.missing.plays[0].motion.angle
    low, high = model.rig.axis("pendulum").limits
    assert low <= targets.min() < angle.min() and angle.max() < targets.max() <= high
    assert proposal.visit.unvisited and all(a < b for a, b in proposal.visit.unvisited)


def test_a_healthy_rig_is_silent(model: Model) -> None:
    found = propose(model, [played(model, 3)], PART, nthread=1)
    assert found.depends.first is None
    assert (found.kind, found.text, found.model) == ("", "", None)


@pytest.mark.study
def test_friction_at_places_is_found_as_half_waves(model: Model) -> None:
    """Without any dry friction in the model, which could take the half waves' mean."""

    def tight(live: Live, site: Site, values: Values) -> None:
        wave = np.sin(2 * np.pi * live.qpos[:, site.qpos] / 0.9 + 0.4)
        live["dof_frictionloss"][:, site.dof] += values["size"] * np.maximum(wave, 0.0)

    effect = replace(WAVES, name="hidden_places", step=tight, touches=("dof_frictionloss",))
    free = model.with_values({"coulomb_friction.pendulum.torque": 0.0})
    play = played(free.with_effect(effect, "pendulum", {"size": 0.05}), 1)
    found = Design.of(missing_force(free, [play], PART, nthread=1))
    (best, *_) = formulas(found, dictionary(found))
    term = best.terms[0]
    assert term.term.name == "places"
    assert (term.values["size"], term.values["period"]) == (pytest.approx(0.05, rel=0.3), pytest.approx(0.9, rel=0.05))


@pytest.fixture(scope="module")
def missing(model: Model) -> MissingForce:
    return missing_force(model, [played(model, 4)], PART, nthread=1, passes=1)


def test_a_term_says_what_it_depends_on_and_that_is_named(missing: MissingForce) -> None:
    terms = {t.name: t for t in (*dictionary(Design.of(missing)), *sensor_dictionary(Design.of(missing)))}
    over = {name: term.over for name, term in terms.items()}
    assert over | {"constant": "", "stribeck": "curve_speed", "drag": "curve_speed", "trailing": "curve_speed",
                   "cubic": "curve_angle", "creeping": "curve_angle", "tight": "curve_angle_friction",
                   "places": "curve_angle_friction",
                   "load": "curve_load_friction", "fading": "curve_reversal", "warming": "curve_time_friction",
                   "friction": "curve_speed", "link": "swing", "bristles": "curve_reversal",
                   "offset": "curve_sensor"} == over  # fmt: skip

    def dependence(variable: str, curve: str, share: float, named: bool = True) -> Dependence:
        return Dependence(variable, curve, "a", share, (0.0, 1.0), 0.1, named)

    speed, load = dependence("speed", "curve_speed", 0.7), dependence("load, as friction", "curve_load_friction", 0.72)
    found = Depends((load, speed), speed, (load,))
    chosen = Formula((Chosen(terms["load"], {"share": 0.1}), Chosen(terms["drag"], {"size": 0.1})), 0.8, (0.7, 0.9))
    proposed = as_proposed(found, chosen, speed, 0.8, WITHIN)
    assert proposed.first == load and proposed.ties == (speed,)
    chance = replace(found, dependences=(replace(load, named=False), speed))
    assert as_proposed(chance, chosen, speed, 0.8, WITHIN).first == speed
    # A constant is nothing that a formula without any may be named for.
    steady = replace(dependence("constant force", "curve_angle", 0.7), constant=True)
    bare = Depends((steady, replace(load, named=False)), steady)
    assert as_proposed(bare, chosen, steady, 0.8, WITHIN).first == replace(load, share=0.8, interval=WITHIN)
    assert as_proposed(bare, chosen, steady, 0.05, WITHIN).first == steady
    with_it = replace(chosen, terms=(*chosen.terms, Chosen(terms["constant"], {"size": 0.1})))
    assert as_proposed(bare, with_it, steady, 0.8, WITHIN).first == steady
    # What roll-outs found and the linear problem does not name stands first, with its share in roll-outs.
    own = replace(load, share=0.9)
    by_roll_outs = as_proposed(Depends((speed, replace(load, named=False)), speed), chosen, own, 0.9, WITHIN)
    assert by_roll_outs == Depends((own, speed), own, (speed,))
    assert as_proposed(Depends((load,)), chosen, own, 0.9, WITHIN).first is None
    assert with_first(Depends((load, speed)), own) == Depends((own, speed), own)
    # A sensor may have the name of the axis.
    read = replace(speed, variable="speed, as a sensor's error", curve="curve_sensor_speed")
    tied = replace(found, ties=(load, read))
    assert ways(tied) == [speed, read]
    # What explains more than chance by acting elsewhere is tried, too, though less in its own linear problem.
    target = replace(load, variable="a lag of the command", share=0.3, of_command=True, late="lag")
    assert ways(replace(found, dependences=(load, speed, read, target))) == [speed, read, target]
    assert ways(replace(found, dependences=(load, speed, replace(target, named=False)))) == [speed]
    # Where roll-outs bear out nothing, no command is late.
    assert refuted(Depends((target, load), target, (load,))) == Depends((target, load), load)
    assert refuted(Depends((target,), target)).first is None
    assert as_proposed(tied, Formula((Chosen(terms["offset"], {}),), 0.8, (0.7, 0.9)), read, 0.8, WITHIN).first == read


def test_a_formula_keeps_no_term_that_another_one_stood_for(missing: MissingForce) -> None:
    """The best of two terms, and what it leaves without either, as if roll-outs had said so."""
    terms = {t.name: Chosen(t, {n.name: 0.1 for n in t.numbers}) for t in dictionary(Design.of(missing))}
    way = Dependence("speed", "curve_speed", "a", 0.7, (0.0, 1.0), 0.1, True)

    def attempt(names: tuple[str, ...], left: float) -> Any:
        law, refit = Formula(tuple(terms[name] for name in names), 0.9, (0.8, 1.0)), Refitted({}, {}, {}, left, left)
        return SimpleNamespace(law=law, refit=refit, way=way, numbers=sum(len(c.term.numbers) for c in law.terms))

    def kept(best: Any, leaves: dict[tuple[str, ...], float]) -> tuple[str, ...]:
        def attempts(laws: Iterable[Formula], way: Dependence) -> list[Any]:
            names = (tuple(c.term.name for c in law.terms) for law in laws)
            return [attempt(n, leaves[n]) for n in names if n in leaves]

        return tuple(c.term.name for c in fewer_terms([best], best, attempts)[-1].law.terms)

    two = attempt(("wave", "viscous"), 1.0)
    assert kept(two, {("wave",): 200.0, ("viscous",): 1.2}) == ("viscous",)
    assert kept(two, {("wave",): 200.0, ("viscous",): 9.0, ("viscous", "wave"): 1.0}) == ("viscous", "wave")
    assert kept(two, {("wave",): 9.0, ("viscous",): 200.0}) == ("wave", "viscous")
    three = attempt(("wave", "viscous", "spring"), 1.0)
    assert kept(three, {("viscous", "spring"): 1.1, ("spring",): 1.3, ("viscous",): 50.0}) == ("spring",)


@pytest.mark.study
def test_each_term_of_a_file_is_the_force_that_its_column_says(missing: MissingForce, model: Model) -> None:
    """A model with a term against the same force added over time. Friction sticks as no such force does."""
    play = played(model, 4)
    terms = [term for term in dictionary(Design.of(missing)) if term.needs != "other_axis"]
    shapes = {term.name: term.shape[len(term.shape) // 2] if term.shape else 0.0 for term in terms}
    chosen = []
    for term in terms:
        values = {n.name: min(0.02, n.most) if n.switches else shapes[term.name] for n in term.numbers}
        values |= {n.name: n.begins for n in term.numbers if np.isfinite(n.begins)}
        chosen.append(Chosen(term, values | ({"phase": 0.0} if "phase" in values else {})))
    every = [declared(effect_file(some)) for some in (chosen[::2], chosen[1::2])]
    assert sum(len(effect.parameters) for effect in every) == sum(len(term.numbers) for term in terms)
    for number, c in enumerate(chosen):
        term, effect = c.term, every[number % 2]
        off = {p.name: p.typical if p.off is None else p.off for p in effect.parameters}
        switch = next(n.name for n in term.numbers if n.switches)
        size = c.values[switch]
        own = model.with_effect(effect, "pendulum", {**off, f"{term.name}_{switch}": size})
        acting = Playing(own, [play], "pendulum", PART.signals)
        assert np.isfinite(acting.residuals(0, np.zeros((1, acting.count(0))))).all(), term.name
        if term.acts not in ("torque", "damping", "link", "bristles"):
            continue
        force = size * term.columns(acting.motion(0), shapes[term.name])[:, 0]
        seen = acting.residuals(0, np.zeros((1, len(force))))[0]
        same, without = Playing(model, [play], "pendulum", PART.signals).residuals(
            0, np.stack([force, np.zeros(len(force))])
        )
        # The acceleration of a link is a difference of speeds, and the column of bristles has none of their damping.
        off_by = {"link": 0.03, "bristles": 0.06}.get(term.acts, 0.02)
        assert np.abs(seen - same).max() < off_by * np.abs(seen - without).max(), term.name


def test_every_term_of_a_sensor_is_read(missing: MissingForce, model: Model) -> None:
    for term in sensor_dictionary(Design.of(missing)):
        values = {n.name: 0.02 if n.switches else 0.3 for n in term.numbers}
        effect = declared(effect_file([Chosen(term, values)]))
        shifted = simulate(model.with_effect(effect, "pendulum"), played(model, 4).trials)
        assert np.isfinite(shifted.values).all()


@pytest.mark.parametrize("sensor", [False, True])
def test_a_power_of_the_angle_does_not_grow_beyond_what_was_recorded(missing: MissingForce, sensor: bool) -> None:
    design = Design.of(missing)
    low = min(float(p.motion.angle.min()) for p in design.plays)
    high = max(float(p.motion.angle.max()) for p in design.plays)
    for term in (sensor_dictionary if sensor else dictionary)(design):
        if term.name not in ("bend", "cubic"):
            continue
        at = np.array([low, 0.3 * low + 0.7 * high, high, 5.0 * high - low, 5.0 * low - high])
        seen = [eval(term.formula.format(size="2.0"), {"np": np, "angle": float(a)}) for a in at]
        inside = term.columns(cast(Motion, SimpleNamespace(angle=at[:2])), 0.0)[:, 0]
        assert seen[:2] == pytest.approx(2.0 * inside, rel=0.05)
        assert seen[3:] == pytest.approx([seen[2], seen[0]], rel=0.02)
