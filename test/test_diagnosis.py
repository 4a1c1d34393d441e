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
from eps_tunnel_analysis.diagnose.axis_search import axis_parts
from eps_tunnel_analysis.diagnose.bases import fitted_bases
from eps_tunnel_analysis.diagnose.calibration import CALIBRATION
from eps_tunnel_analysis.diagnose.diagnose import Diagnosis, diagnose
from eps_tunnel_analysis.diagnose.verdict import Verdict
from eps_tunnel_analysis.plays import Play
from eps_tunnel_analysis.sequence import Command
from eps_tunnel_analysis.sequence_file import parse_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import Run, run_offline
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.trials import Trials

STEPS = [f"    - step: {{to_deg: {to}, lasts_s: {lasts}}}" for to, lasts in ((4, 1.0), (-4, 1.0), (4, 2.0))]
BOTH = SHORT.replace("    - hold: {lasts_s: 4.0}", "\n".join(STEPS))
FEW = ("gravity_load", "return_spring", "coulomb_friction", "sensor_bias", "positioning_error", "sensor_delay")


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
    return Play("short", trials)


def wrong_model() -> Model:
    return load_model("labyrinth_manual").with_values({"drive.x.p": 16.0, "drive.x.delay": 0.04})


def diagnosed(*effects: str, seed: int = 0) -> Diagnosis:
    return diagnose(wrong_model(), [as_play(recorded(*effects, seed=seed))], only=FEW)


def test_a_rig_without_anything_wrong_is_called_complete() -> None:
    v = diagnosed().verdict
    assert (v.verdict, v.effects) == ("complete", ())


@pytest.mark.parametrize("effect", ["gravity_load", "coulomb_friction"])
def test_a_strong_effect_is_named_and_its_error_falls(effect: str) -> None:
    v = diagnosed(effect).verdict
    assert (v.verdict, v.effects) == ("effect", (f"{effect}.x",))
    assert sum(v.set.values()) == pytest.approx(1.0)
    assert v.after.held_out < 0.5 * v.before.held_out
    assert v.after.alikeness > v.before.alikeness


@pytest.mark.parametrize(
    ("effect", "name"),
    [
        ("gravity_load=medium", "gravity_load.x"),
        ("return_spring=strong", "return_spring.x"),
        ("sensor_bias=strong", "sensor_bias.motor_x"),
        ("sensor_delay=strong", "sensor_delay.motor_x"),
    ],
)
def test_effects_on_motion_and_on_sensors_are_told_apart(effect: str, name: str) -> None:
    v = diagnosed(effect, seed=7).verdict
    assert name in v.stated
    assert v.verdict in ("effect", "undecided")
    assert len(v.stated) <= 2


@pytest.mark.parametrize("effect", ["cogging", "irregular_commands"])
def test_what_no_effect_describes_is_called_unknown(effect: str) -> None:
    v = diagnosed(effect).verdict
    assert v.verdict == "unknown"
    assert v.effects == ()
    assert not any("taken for known" in note for note in v.notes)


def test_a_value_that_the_model_states_wrongly_is_doubted_where_no_effect_explains_what_is_left() -> None:
    weaker = wrong_model().with_values({"drive.x.torque": 1.0})
    v = diagnose(weaker, [as_play(recorded())], only=["gravity_load"]).verdict
    assert v.verdict == "unknown"
    assert v.notes[0].startswith("drive.x.torque is taken for known, 1 N m (set by hand).")


def test_an_axis_that_is_turned_along_is_told_though_the_model_is_wrong_about_the_other_s_drive() -> None:
    model = wrong_model().with_values({"drive.y.p": 13.0, "drive.y.delay": 0.045})
    play = as_play(recorded("cross_coupling.x", text=BOTH), "xy", BOTH)
    v = diagnose(model, [play], only=["cross_coupling"]).verdict
    assert v.effects == ("cross_coupling.x",)
    assert v.floor["x"][1] < CALIBRATION.gate < v.floor["x"][0]


def test_the_other_axes_are_refitted_first_only_where_something_couples() -> None:
    play = as_play(recorded(text=BOTH), "xy", BOTH)
    model = wrong_model()
    parts = axis_parts(model, [play])
    assert fitted_bases(model, [play], parts, ["gravity_load"]).values == {}
    coupled = model.with_effect("cross_coupling", "x", {"share": 0.0})
    among = fitted_bases(coupled, [play], parts, ["gravity_load"]).among(coupled, "y").values()
    assert among["drive.x.p"] == pytest.approx(20.0, rel=0.1)
    assert among["drive.y.p"] == model.values()["drive.y.p"]


def test_a_gain_that_is_known_of_a_recording_is_played_with_it() -> None:
    low, high = (as_play(recorded("gravity_load", seed=seed)) for seed in (1, 2))
    found = diagnose(wrong_model(), [replace(low, known={"drive.x.p": 5.0}), high], only=["gravity_load"])
    assert "drive.x.p" not in {name for axis in found.axes for name in axis.search.library.base}
    assert found.verdict.verdict == "unknown"  # for both were played with 20


@pytest.fixture(scope="module")
def unbalanced() -> tuple[Play, Verdict]:
    """A recording of a rig out of balance, and its diagnosis on one thread."""
    play = as_play(recorded("gravity_load"))
    return play, diagnose(wrong_model(), [play], only=["gravity_load"], nthread=1).verdict


def test_the_same_recordings_give_the_same_verdict_bit_for_bit(unbalanced: tuple[Play, Verdict]) -> None:
    play, one = unbalanced
    other = diagnose(wrong_model(), [play], only=["gravity_load"], nthread=2).verdict
    assert dict(one.set) == dict(other.set)
    assert dict(one.values) == dict(other.values)


def test_the_commands_write_what_they_promise(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", recorded("gravity_load"), "short", command().hash)
    reading = ["--real", str(bag), "--model", "labyrinth_manual"]
    few = ["--candidates", "gravity_load", "return_spring"]
    assert main(["diagnose", *reading, *few, "--out", str(tmp_path / "why")]) == 0
    content = json.loads((tmp_path / "why" / "diagnosis.json").read_text())
    promised = "verdict effects set coverage where error_before error_after held_out_before held_out_after "
    promised += "alikeness_before alikeness_after next_experiment seed evaluations seconds"
    assert set(promised.split()) <= set(content)
    assert content["effects"] == ["gravity_load.x"]
    page = (tmp_path / "why" / "report.html").read_text()
    assert "gravity load" in page and "add-effect gravity_load.x" in page
    assert main(["add-effect", "gravity_load.x", *reading, "--out", str(tmp_path / "m2.yaml")]) == 0
    assert [u.effect.name for u in load_model(tmp_path / "m2.yaml").effects] == ["gravity_load"]
    assert main(["diagnose", *reading, "--out", str(tmp_path / "why")]) == 2  # never overwritten


def test_improve_stops_by_itself_and_each_effect_lowers_the_error(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", recorded("gravity_load"), "short", command().hash)
    few = ["--candidates", "gravity_load", "return_spring"]
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


@pytest.mark.parametrize(("effects", "named"), [((), ()), (("gravity_load",), ("gravity_load.x",))])
def test_one_trial_is_diagnosed_with_a_warning(effects: tuple[str, ...], named: tuple[str, ...]) -> None:
    play = as_play(recorded(*effects))
    single = replace(play.trials, values=play.trials.values[:1], commands=play.trials.commands[:1])
    v = diagnose(wrong_model(), [Play("one", single)], only=["gravity_load"]).verdict
    assert any("One trial" in note for note in v.notes)
    assert v.effects == named
    assert v.set["unknown"] == 0.0


def test_recordings_held_out_are_judged_and_never_fitted(unbalanced: tuple[Play, Verdict]) -> None:
    fitted, alone = unbalanced
    held = as_play(recorded("gravity_load", seed=4))
    judged = diagnose(wrong_model(), [fitted], only=["gravity_load"], held=[held]).verdict
    assert judged.values == alone.values
    assert judged.after.held_out != alone.after.held_out
    assert judged.after.held_out < 0.5 * judged.before.held_out
