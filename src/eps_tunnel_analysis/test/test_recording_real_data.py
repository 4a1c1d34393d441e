# SPDX-License-Identifier: Apache-2.0
"""Recordings of real servos become trials. They lie beside the project and are skipped where they are absent."""

from pathlib import Path

import numpy as np
import pytest

from eps_tunnel_analysis.recording import read, read_trials
from labyrinth_sim.errors import InputError

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data beside the project")
MX106 = DATA / "mx106_no_load" / "motor_0"


@pytest.mark.parametrize(("motion", "seconds"), [("step", 19.49), ("triangle", 93.01), ("sine", 42.53)])
def test_three_repeats_are_three_trials(motion: str, seconds: float) -> None:
    result = read_trials([MX106 / motion / f"repeat_{i}" for i in (1, 2, 3)], signals=["joint"])
    trials = result.trials
    assert trials.count == 3
    assert trials.signals == ("joint",)
    assert trials.time[-1] == pytest.approx(seconds, abs=0.02)
    assert not np.isnan(trials.commands).any()
    # The servo answers each command after it was sent: the sample at time zero alone has no measurement before it.
    assert np.isnan(trials.values[:, 0]).all()
    assert not np.isnan(trials.values[:, 1:]).any()
    assert trials.values[:, 1:].std(axis=0).max() < 0.02


def test_time_source_moves_nothing_where_stamps_equal_log_times() -> None:
    by_header, by_log = (read(MX106 / "step" / "repeat_1", source) for source in ("header", "log"))
    for name in by_header.topics:
        assert (by_header.stamps(name) == by_log.stamps(name)).all()


def test_commands_are_nan_while_the_torque_is_off() -> None:
    trials = read_trials([DATA / "xl330_pendulum" / "kp_100" / "lift_and_drop"]).trials
    off = np.isnan(trials.commands[0, :, 0])
    assert not off[trials.time < 1.99].any()
    assert off[trials.time > 2.01].all()


def test_another_motion_is_no_trial_of_this_one() -> None:
    with pytest.raises(InputError, match="different length"):
        read_trials([MX106 / "step" / "repeat_1", MX106 / "sine" / "repeat_1"])
    with pytest.raises(InputError, match="same sequence"):
        read_trials([MX106 / "step" / "repeat_1", MX106 / "sine" / "repeat_1"], cut_to_shortest=True)
