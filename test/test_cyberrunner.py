# SPDX-License-Identifier: Apache-2.0
"""CyberRunner as built, from the emulated rig's bag to a named effect."""

import numpy as np
import pytest

from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.diagnose import diagnose
from eps_tunnel_analysis.inputs import Recorded, load_recorded
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Three trials of a command of axis y alone, on a board that is out of balance there."""
    time = np.arange(150) * 0.01
    knob = np.radians(2.5) / 0.115
    goals = np.where(time < 0.5, knob * (time > 0.2), knob * np.sin(9.0 * (time - 0.5)))
    commands = np.column_stack([np.zeros(150), goals])
    rig = load_testbed("cyberrunner", ["gravity_load.y=medium"])
    bag = write_bag(tmp_path_factory.mktemp("cyberrunner") / "bag", run_offline(rig, time, commands, 3, 4), "c", "0")
    return load_recorded("cyberrunner", [bag], efforts=True)


@pytest.fixture(scope="module")
def diagnosis(recorded: Recorded) -> Diagnosis:
    return diagnose(recorded.model, recorded.plays, only=["gravity_load"], nthread=1, experiments=False)


def test_the_tilt_is_read_at_the_cameras_own_stamps(recorded: Recorded) -> None:
    trial = recorded.plays[0].at_stamps[0]
    assert np.median(np.diff(trial.signals["board_y"].time)) == pytest.approx(0.02, abs=1e-6)
    assert np.median(np.diff(trial.signals["motor_y"].time)) == pytest.approx(0.01, abs=1e-3)


@pytest.mark.study
def test_what_the_board_lacks_is_named(diagnosis: Diagnosis) -> None:
    assert diagnosis.verdict.effects == ("gravity_load.y",), diagnosis.verdict.sentence
    values = diagnosis.model.values()
    sag = values["gravity_load.y.moment"] * 9.81 / values["drive.y.stiffness"]  # what the position alone determines
    assert sag == pytest.approx(-0.12 / 0.25, rel=0.15)
