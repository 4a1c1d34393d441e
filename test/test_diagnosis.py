# SPDX-License-Identifier: Apache-2.0
"""From an emulated rig with something wrong to its name; the rig's physics shares no line with the effects."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))

from short_sequence import SHORT

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.diagnose import base_values as base_values_module
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.axis_search import SearchOptions, axis_parts, axis_search
from eps_tunnel_analysis.diagnose.base_values import fitted_bases
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.diagnose.rank import itself
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command
from eps_tunnel_analysis.sequence_file import parse_sequence
from eps_tunnel_analysis.stamped import Series, StampedTrial
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import Run, run_offline
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.trials import Array, Trials

STEPS = [f"    - step: {{to_deg: {to}, lasts_s: {lasts}}}" for to, lasts in ((4, 0.8), (-4, 0.8), (4, 1.6))]
# One axis rests while the other still moves.
BOTH = SHORT.replace("  motor_y:", "    - hold: {lasts_s: 0.8}\n  motor_y:")
BOTH = BOTH.replace("    - hold: {lasts_s: 2.4}", "\n".join(STEPS))
FEW = ("gravity_load", "return_spring")
MORE = (*FEW, "coulomb_friction", "viscous_friction", "gain_error", "sensor_gain", "command_delay", "backlash")
ON_SENSORS = ("gravity_load", "sensor_bias", "sensor_delay")


def command(text: str = SHORT) -> Command:
    return parse_sequence(yaml.safe_load(text), "short", "short").commands[0]


def recorded(*effects: str, seed: int = 0, text: str = SHORT) -> Run:
    return run_offline(load_testbed("healthy", effects), *command(text).sample(100.0), 3, seed)


def as_play(run: Run, axes: str = "x", text: str = SHORT) -> Play:
    time, targets = command(text).sample(100.0)
    raw = [part[:, :, "xy".index(axis)] for axis in axes for part in (run.motor, run.board, run.effort)]
    values = np.stack([[np.interp(time, run.stamps[i], part[i]) for part in raw] for i in range(3)])
    names = tuple(name for axis in axes for name in (f"motor_{axis}", f"board_{axis}", f"motor_{axis}_effort"))
    trials = Trials(time, names, ("rad", "rad", "N m") * len(axes), values.swapaxes(1, 2), ("motor_x", "motor_y"),
                    np.tile(targets, (3, 1, 1)))  # fmt: skip
    sent = {name: Series(time, targets[:, u]) for u, name in enumerate(("motor_x", "motor_y"))}
    stamped = tuple(
        StampedTrial(float(time[-1]), sent,
                     {name: Series(run.stamps[i], part[i]) for name, part in zip(names, raw, strict=True)})
        for i in range(3)
    )  # fmt: skip
    return Play("short", trials, stamped=stamped)


def wrong_model() -> Model:
    return load_model("labyrinth_manual").with_values({"drive.x.p": 16.0, "drive.x.delay": 0.04})


SAID: list[tuple[object, ...]] = []
"""What the progress of `unbalanced` said, with the roll-outs so far."""


@pytest.fixture(scope="session")
def unbalanced() -> tuple[Play, Diagnosis]:
    """A recording of a rig out of balance, and its diagnosis on one thread."""
    play = as_play(recorded("gravity_load"))
    return play, diagnose(wrong_model(), [play], only=FEW, nthread=1, progress=lambda *said: SAID.append(said))


@pytest.mark.study
def test_a_rig_without_anything_wrong_is_called_complete() -> None:
    v = diagnose(wrong_model(), [as_play(recorded())], only=("gravity_load", "sensor_bias")).verdict
    assert (v.verdict, v.effects) == ("complete", ())
    assert v.floor["x"][0] < SETTINGS.healthy


def test_a_strong_effect_is_named_and_its_error_falls(unbalanced: tuple[Play, Diagnosis]) -> None:
    v = unbalanced[1].verdict
    assert (v.verdict, v.effects) == ("effect", ("gravity_load.x",))
    assert sum(v.set.values()) == pytest.approx(1.0)
    assert v.after.held_out < 0.5 * v.before.held_out
    assert v.after.alikeness > v.before.alikeness


@pytest.mark.study
def test_a_search_without_shortcuts_says_the_same(unbalanced: tuple[Play, Diagnosis]) -> None:
    quick, slow = (
        diagnose(wrong_model(), [unbalanced[0]], only=MORE, experiments=False, exhaustive=exhaustive).verdict
        for exhaustive in (False, True)
    )
    assert (slow.verdict, slow.effects) == (quick.verdict, quick.effects)
    assert slow.set == pytest.approx(quick.set, abs=0.02)
    assert slow.evaluations > quick.evaluations


@pytest.mark.study
def test_a_model_that_was_fitted_to_the_same_recording_is_diagnosed_in_fewer_rollouts(
    unbalanced: tuple[Play, Diagnosis],
) -> None:
    play, first = unbalanced
    anew, on = (
        diagnose(first.model, [play], only=("return_spring",), experiments=False, fitted=fitted).verdict
        for fitted in (False, True)
    )
    assert (on.verdict, on.effects) == (anew.verdict, anew.effects) == ("complete", ())
    assert on.floor["x"][0] == pytest.approx(anew.floor["x"][0], abs=0.2)
    assert on.evaluations < 0.6 * anew.evaluations


def test_other_base_values_are_tried_where_those_of_a_fitted_model_leave_too_much(
    unbalanced: tuple[Play, Diagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    play, first = unbalanced
    asked: list[Model] = []

    def counted(search: Search, values: Array, keep: int) -> list[Array]:
        asked.append(search.library.model)
        return [values]

    monkeypatch.setattr(base_values_module, "base_starts", counted)
    for model in (first.model, first.base_model):
        (part,) = axis_parts(model, [play])
        search = axis_search(model, [play], part, SearchOptions(only=()))
        known = {name: model.values()[name] for name in part.base}
        base_values_module.base_refit(search, known, fitted=True)
    assert [len(model.effects) for model in asked] == [0]


def test_what_leads_is_said_long_before_the_end(unbalanced: tuple[Play, Diagnosis]) -> None:
    leading = [made for what, made, _ in SAID if what == "axis x, gravity_load.x so far"]
    assert SAID[0][0] == "axis x"
    assert 0 < int(str(leading[0])) < 0.7 * unbalanced[1].verdict.evaluations


def test_what_is_said_of_an_axis_fits_together(unbalanced: tuple[Play, Diagnosis]) -> None:
    found = unbalanced[1]
    (x,) = found.verdict.axes.values()
    assert x.marginals["gravity_load.x"] > itself(0.9) > 0.1 > x.none + x.unknown
    share, low, high = x.explained["gravity_load.x"]
    assert 0.9 < low <= share <= high <= 1.0
    assert x.floors[1] < SETTINGS.healthy < x.floors[0]
    assert set(x.remaining) == {"motor_x", "board_x", "motor_x_effort"}
    assert {r.name for r in x.ranking} >= {"none", "gravity_load.x"}
    (axis,) = found.axes
    assert axis.held_out_error(["gravity_load.x"]) < axis.held_out_error([])


@pytest.mark.study
def test_trials_in_another_order_on_a_mirrored_axis_say_the_same(unbalanced: tuple[Play, Diagnosis]) -> None:
    play, one = unbalanced
    trials = replace(play.trials, values=-play.trials.values[::-1], commands=-play.trials.commands[::-1])
    mirrored = tuple(
        replace(t, commands={n: Series(s.time, -s.values) for n, s in t.commands.items()},
                signals={n: Series(s.time, -s.values) for n, s in t.signals.items()})
        for t in reversed(play.stamped)
    )  # fmt: skip
    other = diagnose(wrong_model(), [replace(play, trials=trials, stamped=mirrored)], only=FEW, nthread=1).verdict
    for name, p in one.verdict.set.items():
        assert other.set.get(name, 0.0) == pytest.approx(p, abs=0.02)


@pytest.mark.study
@pytest.mark.parametrize("name", ["sensor_bias", "sensor_delay"])
def test_effects_on_motion_and_on_sensors_are_told_apart(name: str) -> None:
    play = as_play(recorded(f"{name}=strong", seed=7))
    v = diagnose(wrong_model(), [play], only=ON_SENSORS, experiments=False).verdict
    assert f"{name}.motor_x" in v.stated
    assert v.verdict in ("effect", "undecided")
    assert len(v.stated) <= 2


@pytest.mark.parametrize(
    ("effect", "only"),
    [
        pytest.param("cogging", ("gravity_load",), marks=pytest.mark.study),
        ("irregular_commands", ()),
    ],
)
def test_what_no_effect_describes_is_called_unknown(effect: str, only: tuple[str, ...]) -> None:
    v = diagnose(wrong_model(), [as_play(recorded(effect))], only=only).verdict
    assert v.verdict == "unknown"
    assert v.effects == ()
    assert not any("assumed to be right" in note for note in v.notes)


@pytest.mark.study
def test_a_value_that_the_model_states_wrongly_is_doubted_where_no_effect_explains_what_is_left() -> None:
    weaker = wrong_model().with_values({"drive.x.torque": 0.25})
    v = diagnose(weaker, [as_play(recorded())], only=[]).verdict
    assert v.verdict == "unknown"
    assert v.notes[0].startswith("drive.x.torque is assumed to be right, 0.25 N m (set by hand).")


@pytest.mark.study
def test_an_axis_that_is_turned_along_is_told_though_the_model_is_wrong_about_the_other_s_drive() -> None:
    model = wrong_model().with_values({"drive.y.p": 13.0, "drive.y.delay": 0.045})
    play = as_play(recorded("cross_coupling.x", text=BOTH), "xy", BOTH)
    v = diagnose(model, [play], only=["cross_coupling"], experiments=False).verdict
    assert v.effects == ("cross_coupling.x",)
    allowed = SETTINGS.healthy + SETTINGS.form * v.floor["x"][0]
    assert v.floor["x"][1] < allowed < v.floor["x"][0]


@pytest.mark.study
def test_each_axis_is_judged_among_others_whose_values_are_refitted() -> None:
    model, how = wrong_model(), SearchOptions(only=(), nthread=1)
    play = as_play(recorded(text=BOTH), "xy", BOTH)
    parts = axis_parts(model, [play])
    bases = fitted_bases(model, [play], parts, how)
    among = bases.among(model, [play], parts[1])[0].values()
    # Its speed gain and inertia are refitted, too, and trade off with it in so short a play.
    assert among["drive.x.p"] == pytest.approx(20.0, rel=0.2)
    assert among["drive.y.p"] == model.values()["drive.y.p"]


def test_a_gain_that_is_known_of_a_recording_is_played_with_it() -> None:
    model = load_model("labyrinth_manual")
    recordings = [as_play(recorded(seed=seed)) for seed in (1, 2)]

    def left(gain: float) -> float:
        """What the base values leave where the first is said to have been played with this gain; both were with 20."""
        plays = [replace(recordings[0], known={"drive.x.p": gain}), recordings[1]]
        (part,) = axis_parts(model, plays)
        assert "drive.x.p" not in part.base
        search = axis_search(model, plays, part, SearchOptions(only=(), nthread=1))
        return float(np.mean(search.residuals(search.start[None]) ** 2))

    assert left(5.0) > 10.0 * left(20.0)


def test_the_verdict_is_the_same_bit_for_bit_on_more_threads_and_recordings_held_out_are_only_judged(
    unbalanced: tuple[Play, Diagnosis],
) -> None:
    play, one = unbalanced[0], unbalanced[1].verdict
    held = as_play(recorded("gravity_load", seed=4))
    other = diagnose(wrong_model(), [play], only=FEW, nthread=2, held=[held]).verdict
    assert dict(one.set) == dict(other.set)
    assert dict(one.values) == dict(other.values)
    assert other.after.held_out != one.after.held_out
    assert other.after.held_out < 0.5 * other.before.held_out


@pytest.mark.study
def test_the_commands_write_what_they_promise(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", recorded("gravity_load"), "short", command().hash)
    reading = ["--real", str(bag), "--model", "labyrinth_manual"]
    few = ["--candidates", "gravity_load"]
    assert main(["diagnose", *reading, *few, "--out", str(tmp_path / "why")]) == 0
    content = json.loads((tmp_path / "why" / "diagnosis.json").read_text())
    promised = "verdict effects set coverage where error_before error_after held_out_before held_out_after "
    promised += "alikeness_before alikeness_after next_experiment seed evaluations seconds"
    assert set(promised.split()) <= set(content)
    assert content["effects"] == ["gravity_load.x"]
    low, high = content["intervals"]["gravity_load.x.moment"]
    assert low < content["values"]["gravity_load.x.moment"] < high
    page = (tmp_path / "why" / "report.html").read_text()
    assert "gravity load" in page and "add-effect gravity_load.x" in page
    assert main(["add-effect", "gravity_load.x", *reading, "--out", str(tmp_path / "m2.yaml")]) == 0
    assert [u.effect.name for u in load_model(tmp_path / "m2.yaml").effects] == ["gravity_load"]
    assert main(["diagnose", *reading, "--out", str(tmp_path / "why")]) == 2  # never overwritten


@pytest.mark.study
def test_improve_stops_by_itself_and_each_effect_lowers_the_error(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", recorded("gravity_load"), "short", command().hash)
    few = ["--candidates", "gravity_load"]
    out = tmp_path / "better"
    assert main(["improve", "--real", str(bag), "--model", "labyrinth_manual", *few, "--out", str(out)]) == 0
    stairs = json.loads((out / "staircase.json").read_text())
    assert stairs["verdict"] == "complete"
    held = [step["held_out"] for step in stairs["steps"]]
    assert held[1:] == sorted(held[1:], reverse=True)
    assert held[-1] < 0.2 * held[0]
    assert (out / "step_1" / "model.yaml").exists()


def test_a_command_that_excites_nothing_is_told() -> None:
    play = as_play(recorded())
    still = replace(play.trials, commands=np.zeros_like(play.trials.commands))
    with pytest.raises(ValueError, match="excite"):
        diagnose(wrong_model(), [Play("still", still)])


@pytest.mark.parametrize(
    ("effects", "named"), [((), ()), pytest.param(("gravity_load",), ("gravity_load.x",), marks=pytest.mark.study)]
)
def test_one_trial_is_diagnosed_with_a_warning(effects: tuple[str, ...], named: tuple[str, ...]) -> None:
    play = as_play(recorded(*effects))
    single = replace(play.trials, values=play.trials.values[:1], commands=play.trials.commands[:1])
    v = diagnose(wrong_model(), [Play("one", single)], only=["gravity_load"]).verdict
    assert any("One trial" in note for note in v.notes)
    assert v.effects == named
    assert v.set["unknown"] < 0.01, "what is left lies within the sensors' noise"
