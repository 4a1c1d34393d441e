# SPDX-License-Identifier: Apache-2.0
"""The check before anything is fitted: what recordings are like, and what they can tell."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import eps_tunnel
from small_recordings import record, write_rig

from eps_tunnel_analysis.check.check import Check, check
from eps_tunnel_analysis.check.data import check_data
from eps_tunnel_analysis.check.excitation import excitation
from eps_tunnel_analysis.inputs import Recorded, load_recorded
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import load_model
from labyrinth_sim.trials import Trials

FEW = ["backlash", "coulomb_friction", "command_delay", "gain_error", "sensor_gain", "gravity_load"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Three trials of one command."""
    folder = tmp_path_factory.mktemp("check")
    model = load_model(write_rig(folder))
    bags = [record(model, folder / f"run{seed}", seed=seed) for seed in range(3)]
    return load_recorded(str(model.path), bags, efforts=True)


def changed(recorded: Recorded, **columns: np.ndarray) -> list[Play]:
    """The play with a signal, or the command, replaced in all trials; on its grid alone."""
    trials = recorded.plays[0].trials
    values, commands = np.array(trials.values), np.array(trials.commands)
    for name, column in columns.items():
        if name == "command":
            commands[:, :, 0] = column
        else:
            values[:, :, trials.index(name)] = column
    return [Play("", replace(trials, values=values, commands=commands))]


def told(recorded: Recorded, plays: list[Play]) -> str:
    return "\n".join(f.sentence for f in check_data(recorded.model, plays) if f.serious)


def test_good_recordings_have_nothing_serious(recorded: Recorded) -> None:
    assert told(recorded, list(recorded.plays)) == ""
    words = " ".join(f.sentence for f in check_data(recorded.model, recorded.plays))
    assert "command arm: 100 Hz" in words and "1 command, 3 trials of each. With fewer than 5" in words


def test_each_fault_of_the_data_is_told(recorded: Recorded) -> None:
    trials: Trials = recorded.plays[0].trials
    time, command = trials.time, trials.commands[0, :, 0]
    angle = trials.values[0, :, 0]
    for plays, words in (
        (changed(recorded, arm=np.clip(angle, -0.1, 0.1)), "stays at its extreme of 5.73 deg"),
        (changed(recorded, arm=np.full(len(time), 0.2)), "never changes"),
        (changed(recorded, arm=np.where(time < 1.5, angle[0], angle)), "stands still for 5"),
        (changed(recorded, command=3.0 * command), "beyond the axis's limits"),
        (changed(recorded, arm=angle * 57.3), "degrees or ticks"),
        (changed(recorded, arm_effort=np.sin(time) * 40.0), "write 'unit: A', 'duty' or 'raw'"),
        (changed(recorded, arm_effort=np.sin(3 * time)), "is it a duty?"),
        (changed(recorded, arm=np.where((time > 1.0) & (time < 1.3), np.nan, angle)), "3 gaps up to 0.3"),
    ):
        assert words in told(recorded, plays), words
    alone = Play("", replace(trials, values=trials.values[:1], commands=trials.commands[:1]))
    assert "Record five trials" in told(recorded, [alone])


def test_what_a_command_excites_and_what_it_cannot_tell_apart(recorded: Recorded) -> None:
    alone = [replace(play, trials=play.trials.select(["arm"])) for play in recorded.plays]  # no effort
    found = {one.name: one for one in excitation(recorded.model, alone, FEW, nthread=1)}
    assert found["drive.a.stiffness"].answer == found["coulomb_friction.a"].answer == "identifiable"
    assert found["drive.a.stiffness"].figure < 1.0
    scaled = found["gain_error.a"]
    assert scaled.answer == "weak" and "sensor_gain.arm" in scaled.confounded and scaled.mend
    assert found["command_delay.a"].answer == "no", "the drive's own delay takes it up"
    still = changed(recorded, command=np.zeros(300))
    nothing = {one.name: one for one in excitation(recorded.model, still, FEW, nthread=1)}
    assert nothing["drive.a.delay"].answer == "no" and "larger motions" in nothing["drive.a.delay"].mend
    assert nothing["gain_error.a"].answer == "no"


def test_text_and_json(recorded: Recorded, tmp_path: Path) -> None:
    checked = check(recorded.model, recorded.plays, ["A note."], ["backlash"], nthread=1)
    lines = checked.lines()
    assert isinstance(checked, Check) and "A note." in lines
    assert any(line.startswith("Effects of axis a that these commands excite.") for line in lines)
    assert json.loads(json.dumps(checked.to_json()))["excited"]
    bags = [str(path) for path, _ in recorded.bags]
    printed = eps_tunnel(
        "check", "--real", *bags, "--model", recorded.model.path, "--candidates", "backlash", "--json", "--threads", 1
    )
    content = json.loads(printed.stdout)
    assert content["command"] == "check" and {one["kind"] for one in content["excited"]} == {"value", "effect"}


def test_a_late_drive_is_moved_no_further_than_its_bounds(recorded: Recorded) -> None:
    """A delay in the middle of its bounds has less room to either side than it is moved by."""
    late = recorded.model.with_values({"drive.a.delay": 0.029})
    assert any(one.name == "drive.a.delay" for one in excitation(late, recorded.plays, ["backlash"], nthread=1))
