# SPDX-License-Identifier: Apache-2.0
"""The error map and the slack: found by leading the emulated rig through its range, and gone when switched on."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labyrinth_hw.compensation import Compensation, Compensator, measured_map
from labyrinth_hw.config import check
from labyrinth_hw.control_tables import servo_model
from labyrinth_hw.errors import InputError
from labyrinth_hw.hardware import Hardware
from labyrinth_hw.nodes.calibrate_motors import calibrate, lead, rest
from labyrinth_hw.sensors import Slope
from labyrinth_hw.settings import CompensationSection, load_hardware
from labyrinth_hw.testbed.live import LiveRig, LiveTestbed
from labyrinth_hw.testbed.quantities import HEALTHY

FLAWED = {"error_amplitude": {"x": 0.012}, "error_count": 60.0, "play": {"y": 0.012}, "board_friction": 0.02}


@pytest.fixture
def flawed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An emulated rig with a positioning error on x and play on y."""
    monkeypatch.setenv("LABYRINTH_TESTBED_DIR", str(tmp_path))
    rig = LiveRig(HEALTHY.with_values(FLAWED), servo_model("MX-64"), 3, time.monotonic())
    testbed = LiveTestbed(rig, tmp_path, 1_000_000, 115_200, 3)
    stop = threading.Event()
    thread = threading.Thread(target=testbed.spin, args=(stop.is_set,), daemon=True)
    thread.start()
    yield
    stop.set()
    thread.join()
    testbed.close()


def rests(hardware: Hardware, goals: list[float], axis: int) -> float:
    """Where the board rests after these goals, rad, met one after the other."""
    at: dict[str, float] = {}
    for goal in goals:
        # A board that is thrown coasts within its play, and then rests anywhere in it.
        at = lead(hardware, at, {"motor_x": goal, "motor_y": goal})
    return rest(hardware, at, axis, 0.4, 20)


@pytest.mark.study
@pytest.mark.realtime
def test_calibration_finds_the_flaws_and_compensation_removes_them(flawed: None) -> None:
    hardware = Hardware(load_hardware("healthy"))
    hardware.connect()
    hardware.arm()
    try:
        found = calibrate(hardware, 3.0, 1.0, 0.3, 5)
    finally:
        hardware.close()
    assert np.abs(found["motor_x"].errors).max() == pytest.approx(0.012, rel=0.25)
    assert np.abs(found["motor_y"].errors).max() < 0.002
    assert found["motor_x"].slack < 0.002
    assert found["motor_y"].slack == pytest.approx(0.012, rel=0.25)

    settings = replace(load_hardware("healthy"), compensation=found)
    hardware = Hardware(settings, position_error=True, slack=True)
    hardware.connect()
    hardware.arm()
    try:
        worst = found["motor_x"].angles[int(np.abs(found["motor_x"].errors).argmax())]
        assert abs(rests(hardware, [worst], 0) - worst) < 0.4 * 0.012
        up, down = rests(hardware, [-0.03, 0.02], 1), rests(hardware, [0.05, 0.02], 1)
    finally:
        hardware.close()
    assert abs(down - up) < 0.4 * 0.012


def test_the_map_is_the_mean_of_both_directions_and_slack_their_difference() -> None:
    goals = [-0.02, 0.0, 0.02]
    found = measured_map(
        goals,
        [-0.02 + 0.001 - 0.002, -0.002, 0.02 - 0.001 - 0.002],
        [-0.02 + 0.001 + 0.002, 0.002, 0.02 - 0.001 + 0.002],
    )
    assert found.errors == pytest.approx([0.001, 0.0, -0.001])
    assert found.slack == pytest.approx(0.004)


def test_switched_off_it_changes_nothing() -> None:
    entry = Compensation((-0.1, 0.1), (0.01, 0.02), 0.01)
    off = Compensator({"motor_x": entry}, position_error=False, slack=False)
    assert off.goals({"motor_x": 0.05}) == {"motor_x": 0.05}


def test_slack_is_taken_up_in_the_direction_of_travel() -> None:
    on = Compensator({"motor_x": Compensation(slack=0.01)}, position_error=False, slack=True)
    assert on.goals({"motor_x": 0.0})["motor_x"] == 0.0
    assert on.goals({"motor_x": 0.02})["motor_x"] == pytest.approx(0.025)
    assert on.goals({"motor_x": 0.02})["motor_x"] == pytest.approx(0.025)
    assert on.goals({"motor_x": 0.01})["motor_x"] == pytest.approx(0.005)


def test_a_map_survives_its_file() -> None:
    entry = Compensation(
        tuple(np.radians([-1.0, 0.0, 1.0])), tuple(np.radians([0.1, 0.0, -0.2])), float(np.radians(0.3))
    )
    again = CompensationSection.of(entry).compensation()
    assert again.errors == pytest.approx(entry.errors) and again.slack == pytest.approx(entry.slack)


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ({"angles": [1]}, "Unknown key 'angles'"),
        ({"angles_deg": [0, 1], "errors_deg": [0]}, "as many errors"),
        ({"angles_deg": [1, 0], "errors_deg": [0, 0]}, "must increase"),
        ({"slack_deg": -1}, "slack >= 0"),
    ],
)
def test_bad_maps_are_refused(entry: dict, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        check(CompensationSection, entry, "rig.yaml")


def test_the_board_s_speed_is_that_of_now_and_needs_a_full_window() -> None:
    """A parabola's end slope is met exactly, at uneven times too."""
    slope, rng = Slope(), np.random.default_rng(2)
    times = np.cumsum(rng.uniform(0.008, 0.012, 7))
    told = [slope.add(t, 0.1 + 0.2 * t + 3.0 * t**2, -0.5 * t) for t in times]
    assert all(np.isnan(speed) for speeds in told[:-1] for speed in speeds)
    assert told[-1] == pytest.approx((0.2 + 6.0 * times[-1], -0.5))
    assert np.isnan(slope.add(times[-1] + 1.0, 0.0, 0.0)[0]), "old samples are forgotten"
