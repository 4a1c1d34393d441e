# SPDX-License-Identifier: Apache-2.0
"""CyberRunner as built: servos in current mode, ratios of the knobs, the board's tilt from the camera."""

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from labyrinth_hw.bus import ServoBus
from labyrinth_hw.control_tables import servo_model
from labyrinth_hw.errors import BusError
from labyrinth_hw.motors import CurrentLaw, Motor, MotorState
from labyrinth_hw.settings import MotorSection, load_hardware
from labyrinth_hw.testbed.bags import typestore, write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.live import LiveRig, LiveTestbed
from labyrinth_hw.testbed.offline import Run, run_offline

RATIO = np.array([0.073, 0.115])
TIME = np.arange(80) * 0.01
GOAL = np.radians(2.5) / RATIO


@pytest.fixture(scope="module")
def run() -> Run:
    """Two trials of a step by 2.5 degrees of the board."""
    return run_offline(load_testbed("cyberrunner"), TIME, np.where(TIME[:, None] > 0.1, GOAL, 0.0), 2, 1)


def test_the_knobs_turn_the_board_by_their_ratios(run: Run) -> None:
    assert run.motor[0, -1] == pytest.approx(GOAL, rel=0.08), "the knobs' friction leaves a rest"
    assert run.board[:, -1] == pytest.approx(RATIO * run.motor[:, -1], abs=4e-3)
    held = np.abs(run.effort[:, -10:]).max()
    assert 0.0 < held < 0.02, "at rest the current holds against friction only"


def test_the_camera_sees_the_tilt_at_its_own_times(run: Run) -> None:
    assert run.tilt is not None and run.tilt_stamps is not None
    assert np.allclose(np.diff(run.tilt_stamps, axis=1), 0.02)
    assert not np.isin(run.tilt_stamps, run.stamps).any()
    seen = np.array([np.interp(run.tilt_stamps[0], run.stamps[0], run.board[0, :, a]) for a in range(2)]).T
    assert np.abs(run.tilt[0] - seen).max() < 5e-3


def test_a_bag_holds_the_tilt_on_a_topic_of_its_own(run: Run, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", run, "step", "0")
    with AnyReader([tmp_path / "bag"], default_typestore=typestore()) as reader:
        names: dict[str, set[str]] = {}
        for connection, _, data in reader.messages():
            if connection.topic.endswith("states"):
                names.setdefault(connection.topic, set()).update(reader.deserialize(data, connection.msgtype).name)
    assert names == {"/real/joint_states": {"motor_x", "motor_y"}, "/real/board_states": {"board_x", "board_y"}}


def test_the_law_asks_for_a_current_signed_as_the_servo_counts() -> None:
    model = servo_model("XL330-M077")
    motor = Motor("m", 1, model, sign=-1, law=CurrentLaw(0.25, 0.01))
    state = MotorState(0.0, position=0.1, speed=2.0)
    assert motor.current(0.3, state) == pytest.approx(-(0.25 * 0.2 - 0.01 * 2.0) / model.torque_constant)
    assert motor.current(9.0, state, share=0.5) == pytest.approx(-0.5 * model.stall_torque / model.torque_constant)


@pytest.mark.parametrize(
    ("model", "more", "words"),
    [
        ("MX-12W", {"current_law": {"stiffness": 1.0}}, "follows no currents"),
        ("XL330-M077", {"operating_mode": "current"}, "come together"),
        ("XL330-M077", {"operating_mode": "position", "current_law": {"stiffness": 1.0}}, "come together"),
    ],
)
def test_what_does_not_fit_together_is_refused(model: str, more: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MotorSection.model_validate({"id": 1, "model": model, **more})


def test_servos_in_current_mode_reach_a_goal_under_their_law() -> None:
    given, motors = load_testbed("cyberrunner"), load_hardware("cyberrunner").motors
    rig = LiveRig(given.reality, given.servo, 1, 0.0, mode=given.mode)
    goals = (0.5, -0.3)
    for servo in rig.servos:
        servo.set("goal_current", 0.0)
        servo.set("torque_enable", 1.0)
    for now in np.arange(1, 200) * 0.005:
        rig.catch_up(now)
        rig.refresh()
        for motor, servo, goal in zip(motors, rig.servos, goals, strict=True):
            state = MotorState(now, servo.get("present_position"), servo.get("present_speed"))
            servo.set("goal_current", motor.current(goal, state))
    assert rig.plant.servo[0] == pytest.approx(goals, abs=0.04)
    assert rig.plant.board[0] == pytest.approx(RATIO * goals, abs=4e-3)


@pytest.mark.realtime
def test_currents_go_over_the_bus_and_the_mode_in_the_eeprom_is_left_alone(tmp_path: Path) -> None:
    given, settings = load_testbed("cyberrunner"), load_hardware("cyberrunner")
    rig = LiveRig(given.reality, given.servo, 1, time.monotonic(), mode=given.mode)
    testbed = LiveTestbed(rig, tmp_path, given.baud, given.sensor_baud, 1)
    stop = threading.Event()
    thread = threading.Thread(target=testbed.spin, args=(stop.is_set,), daemon=True)
    thread.start()
    bus = ServoBus(str(tmp_path / "servos"), given.baud, list(settings.motors), patience=1.0)
    try:
        bus.connect()
        bus.motors["motor_y"] = replace(bus.motors["motor_y"], law=None)
        with pytest.raises(BusError, match="operating mode 0; expected 3"):
            bus.prepare("motor_y")
        bus.motors = {motor.name: motor for motor in settings.motors}
        for name in bus.motors:
            bus.prepare(name)
        bus.write_currents({"motor_x": 0.2, "motor_y": -0.1}, bus.read_states())
        assert bus.read("motor_x", "goal_current") == pytest.approx(0.2 * 0.25 / 0.146, abs=0.01)
        assert bus.read("motor_y", "goal_current") == pytest.approx(-0.1 * 0.25 / 0.146, abs=0.01)
        rig.servos[0].set("operating_mode", 3)
        with pytest.raises(BusError, match="operating mode 3; expected 0"):
            bus.prepare("motor_x")
        assert [servo.raw("operating_mode") for servo in rig.servos] == [3, 0], "none was written"
    finally:
        bus.close()
        stop.set()
        thread.join(5.0)
        testbed.close()
