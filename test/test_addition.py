# SPDX-License-Identifier: Apache-2.0
"""Adding effects: the same answer as the diagnosis that named them, and an honest word on what that is worth."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from test_diagnosis import as_play, recorded, wrong_model

from eps_tunnel_analysis.diagnose.addition import Addition, add_effects, addition_of
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.diagnose.falls import by_recording, fall_sentences
from eps_tunnel_analysis.diagnose.verdict import Errors, PlayError
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.simulate import simulate

HIDDEN_MOMENT = 0.35 / 9.81  # kg m, of the strong load on the emulated rig, 0.35 N m


@pytest.fixture(scope="module")
def loaded() -> tuple[Play, Addition]:
    """A recording of a rig out of balance, and the load added without a diagnosis."""
    play = as_play(recorded("gravity_load=strong", seed=3))
    return play, add_effects(wrong_model(), [play], ["gravity_load.x"], 1)


@pytest.mark.study
@pytest.mark.parametrize("name", ["gravity_load.x", "sensor_bias.motor_x"])
def test_the_same_recordings_give_the_same_values_as_the_diagnosis(name: str, loaded: tuple[Play, Addition]) -> None:
    effect = name.partition(".")[0]
    play = loaded[0] if effect == "gravity_load" else as_play(recorded(f"{effect}=strong", seed=3))
    diagnosis = diagnose(wrong_model(), [play], only=[effect], nthread=1, experiments=False)
    assert name in diagnosis.verdict.effects
    named = diagnosis.verdict.effects
    alone = loaded[1] if named == ("gravity_load.x",) else add_effects(wrong_model(), [play], named, 1)
    said = addition_of(diagnosis, named, [play])
    main = [n for n in said.values if n.startswith(effect)]
    for value in main:
        assert alone.values[value] == pytest.approx(said.values[value], rel=0.02)
    assert alone.after.error == pytest.approx(said.after.error, rel=0.05)
    assert alone.before.error == pytest.approx(said.before.error, rel=0.05)
    assert alone.given == said.given
    assert dict(said.values) == dict(diagnosis.verdict.values)
    assert alone.after.held_out != alone.after.error  # of stretches left out, though no recording was held out


def swung(*names: str) -> Play:
    """Three seconds of the bare horn with effects of typical size, three noisy trials."""
    rig = load_model("horn").with_values({"drive.horn.stiffness": 12.0})
    for name in names:
        rig = rig.with_effect(name, "horn")
    time = np.arange(300) * 0.01
    run = simulate(rig, time, 0.5 * np.sin(2 * time**1.5)[:, None]).select(["joint"])
    values = np.repeat(run.values, 3, axis=0)
    values += 1e-4 * np.random.default_rng(1).standard_normal(values.shape)
    return Play("swing", replace(run, values=values, commands=np.repeat(run.commands, 3, axis=0)))


def between(name: str, other: str) -> tuple[Play, Diagnosis]:
    """A recording of the horn with one effect, and its diagnosis with that and another considered."""
    play = swung(name)
    return play, diagnose(load_model("horn"), [play], only=[name, other], nthread=1)


@pytest.fixture(scope="module")
def rubbing() -> tuple[Play, Diagnosis]:
    return between("coulomb_friction", "viscous_friction")


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "other"),
    [("coulomb_friction", "viscous_friction"), ("dead_band", "backlash"), ("constant_torque", "return_spring")],
)
def test_what_a_diagnosis_of_several_candidates_names_is_added_with_the_same_values(
    name: str, other: str, rubbing: tuple[Play, Diagnosis]
) -> None:
    play, diagnosis = rubbing if name == "coulomb_friction" else between(name, other)
    named = diagnosis.verdict.effects
    assert named == (f"{name}.horn",)
    alone = add_effects(load_model("horn"), [play], named, 1)
    said = diagnosis.verdict.values
    assert alone.values.keys() == said.keys()
    for value in (n for n in said if n.startswith((name, "drive"))):
        least = 0.01 if value.endswith(".jump") else 1e-4  # a share of which little shows
        assert alone.values[value] == pytest.approx(said[value], rel=0.02, abs=least), value
    assert alone.after.error == pytest.approx(diagnosis.verdict.after.error, rel=0.02)
    assert alone.before.error == pytest.approx(diagnosis.verdict.before.error, rel=0.02)


@pytest.mark.study
def test_a_fit_that_has_not_converged_is_told(rubbing: tuple[Play, Diagnosis]) -> None:
    (play, diagnosis), name = rubbing, "coulomb_friction.horn"
    assert not any("converged" in text for text in addition_of(diagnosis, [name], [play]).doubts)
    (axis,) = diagnosis.axes
    still = replace(diagnosis, axes=(replace(axis, refits=tuple(replace(r, converged=False) for r in axis.refits)),))
    added = addition_of(still, [name], [play])
    told = f"The fit of {name} has not converged: other values may fit better."
    assert added.doubts[-1] == told and told in added.sentences
    assert not any("converged" in text for text in addition_of(still, [], [play]).doubts), "the values alone are no fit"


def test_what_is_not_there_is_not_added_at_values_that_fit_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    play, model = swung("viscous_friction"), load_model("horn").with_effect("viscous_friction", "horn")
    diagnosis = diagnose(model, [play], only=["torque_saturation"], nthread=1)
    (axis,) = diagnosis.axes
    search = axis.search
    astray = search.start.copy()
    astray[search.library.names.index("torque_saturation.horn.share")] = 0.01
    like = replace(axis.base, effects=("torque_saturation.horn",))
    monkeypatch.setattr(search, "best_of", lambda *_: [search.at(astray, like)])
    untried = replace(diagnosis, axes=(replace(axis, refits=()),))
    added = addition_of(untried, ["torque_saturation.horn"], [play])
    assert added.values["torque_saturation.horn.share"] > 0.2
    assert added.after.error < 1.02 * added.before.error


@pytest.mark.study
def test_the_interval_of_a_named_effect_holds_what_was_hidden(loaded: tuple[Play, Addition]) -> None:
    added = loaded[1]
    low, high = added.intervals["gravity_load.x.moment"]
    value = added.values["gravity_load.x.moment"]
    assert low < value < high and high - low < 0.1 * abs(value)
    assert low <= -HIDDEN_MOMENT <= high
    assert set(added.intervals) <= set(added.values)
    infos = added.model.parameters()
    assert all(infos[n].low <= a <= added.values[n] <= b <= infos[n].high for n, (a, b) in added.intervals.items())
    assert added.to_json()["intervals"]["gravity_load.x.moment"] == [low, high]


@pytest.mark.study
def test_values_at_their_bounds_are_told() -> None:
    added = add_effects(load_model("horn"), [swung()], ["coulomb_friction.horn", "command_delay.horn"], 1)
    at = [n for n, v in added.values.items() if v == 0.0 and not n.startswith("drive.")]
    assert at
    assert all(any(text.startswith(f"{n} lies at its bound") for text in added.doubts) for n in at)
    assert added.values["drive.horn.back_emf"] == 0.0
    assert not any(text.startswith("drive.horn.back_emf") for text in added.doubts), "it stays as stated"
    assert added.doubts[-1] in added.sentences


def test_what_cannot_be_added_is_refused_before_anything_is_fitted() -> None:
    play, model = as_play(recorded()), wrong_model()
    with pytest.raises(InputError, match="Did you mean 'backlash"):
        add_effects(model, [play], ["backlash.z"])
    with pytest.raises(InputError, match="is in the model already"):
        add_effects(model.with_effect("backlash", "x"), [play], ["backlash.x"])
    still = replace(play, trials=replace(play.trials, commands=0 * play.trials.commands))
    with pytest.raises(InputError, match="excite"):
        add_effects(model, [still], ["backlash.x"])


def errors(error: float, held_out: float, alikeness: float) -> Errors:
    return Errors(error, held_out, alikeness)


def plays(*errors: float) -> tuple[PlayError, ...]:
    return tuple(PlayError(f"play {i}", i == len(errors) - 1, error) for i, error in enumerate(errors))


def test_a_recording_that_got_worse_is_told_first_and_every_fall_names_its_yardstick() -> None:
    three = (errors(0.02, 0.025, 0.1), errors(0.04, 0.05, 0.05), errors(0.01, 0.0225, 0.5))
    each = (plays(0.02, 0.02, 0.025), plays(0.03, 0.05, 0.05), plays(0.008, 0.012, 0.04))
    assert [one.name for one in by_recording(each)] == ["play 2", "play 1", "play 0"]
    worse, fitted, held, alike = fall_sentences(three, each)
    assert worse.startswith("Worse than the model as given on 1 of 3 recordings: play 2 (held out), 1.43 deg as given")
    assert "50% lower than that of the model as given" in fitted
    assert "75% lower than with its values refitted" in fitted
    assert held.startswith("On recordings held out, ")
    assert "10% lower than that of the model as given" in held
    assert "10.00 % as given" in alike
    assert "leave it out" in fall_sentences((three[0], three[2], three[1]), each)[-1]
    one = tuple(p[:1] for p in each)
    assert fall_sentences(three, one)[1].startswith("On stretches of time left out of the fit, ")
