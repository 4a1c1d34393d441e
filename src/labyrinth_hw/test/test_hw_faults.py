# SPDX-License-Identifier: Apache-2.0
"""Faults of the rig while the hardware node runs: what it tells, that it goes on or stops, that it comes back."""

import math
import time

import pytest
import yaml
from hw_bench import PATIENCE, ROS_IN_REAL_TIME, Bench

from labyrinth_hw import config

pytestmark = ROS_IN_REAL_TIME


def test_servos_unplugged_and_plugged_in_again(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    running.tell("unplug servos")
    running.until(lambda: "disconnected" in running.status().get("message", ""), "a word about the lost bus")
    before = len(running.states)
    running.command((0.0, 0.02))
    running.tell("plug servos")
    running.until(lambda: len(running.states) > before and running.reaches((0.0, 0.02)), "motion after the replug")
    running.until(lambda: running.status().get("reconnects") == "1", "the reconnect counted")


def test_bad_packets_and_late_servos_do_not_stop_the_rig(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.tell("noise servos 0.01")
    running.more_states(300)
    running.tell("noise servos 0")
    running.tell("late servos 0.004")
    running.more_states(20)
    running.tell("late servos 0")
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    assert running.status()["reconnects"] == "0"


def test_without_potentiometers_no_joint_state_is_told_and_the_servos_go_on(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    running.tell("unplug sensors")
    running.until(lambda: "no potentiometers" in running.status().get("message", ""), "a word about the sensor line")
    told, begun = len(running.states), int(running.status()["cycles without potentiometers"])
    running.command((0.0, 0.02))
    running.until(lambda: int(running.status()["cycles without potentiometers"]) > begun + 100, "periods passing")
    assert len(running.states) == told
    running.tell("plug sensors")
    running.until(lambda: len(running.states) > told, "joint states again")
    assert running.reaches((0.0, 0.02)), "the servos went on"
    assert all(math.isfinite(angle) for state in running.states for angle in state.position)
    assert all(len(state.name) == 4 for state in running.states)


@pytest.mark.study
def test_camera_gone_and_back_and_a_covered_lens(bench: Bench) -> None:
    bench.start_testbed("--video", "--video-rate", "15")
    bench.start_node()
    bench.until(lambda: any(ball.visible for ball in bench.balls), "the ball seen")
    bench.tell("cover")
    bench.until(lambda: not bench.balls[-1].visible, "a ball that is not seen")
    bench.until(lambda: "does not see the board" in bench.status().get("message", ""), "a word about the board")
    bench.tell("uncover")
    bench.until(lambda: bench.balls[-1].visible, "the ball seen again")
    bench.tell("unplug camera")
    bench.until(lambda: "no pictures" in bench.status().get("message", ""), "a word about the camera")
    seen = len(bench.balls)
    bench.more_states(50)
    assert len(bench.balls) == seen, "nothing is told about the ball without pictures"
    bench.tell("plug camera")
    bench.until(lambda: len(bench.balls) > seen and bench.balls[-1].visible, "the ball seen once more")
    bench.until(lambda: "no pictures" not in bench.status().get("message", ""), "good news about the camera")


@pytest.mark.parametrize(("servo", "stops"), [pytest.param("MX-64", False, marks=pytest.mark.study), ("MX-64-2", True)])
def test_after_kill_9_the_watchdog_of_protocol_2_stops_the_servos(bench: Bench, servo: str, stops: bool) -> None:
    from labyrinth_hw.bus import ServoBus
    from labyrinth_hw.control_tables import servo_model
    from labyrinth_hw.motors import Motor

    rig, view = (
        yaml.safe_load(config.find("testbed", "healthy").read_text()),
        yaml.safe_load(config.find("hw", "healthy").read_text()),
    )
    rig |= {"servo": servo, "quantities": {"command_rate": 0.05}}
    for motor in view["motors"].values():
        motor["model"] = servo
    for name, content in (("rig", rig), ("view", view)):
        (bench.folder / f"{name}.yaml").write_text(yaml.safe_dump(content))
    bench.start_testbed("--config", str(bench.folder / "rig.yaml"))
    bench.start_node(config=bench.folder / "view.yaml")
    bench.command((0.11, 0.0))
    bench.until(lambda: bool(bench.states) and 0.01 < bench.motor()[0] < 0.03, "a motor on its way")
    assert bench.node is not None
    bench.node.kill()
    bench.node.wait()
    motors = [Motor("motor_x", 1, servo_model(servo))]
    bus = ServoBus(str(bench.folder / "links" / "servos"), 1_000_000, motors, patience=1.0)
    # A watchdog is fed by any packet, so nobody asks the servos before it has fired.
    time.sleep(0.5)
    bus.connect()
    there = bus.read("motor_x", "present_position")
    goal = bus.read("motor_x", "goal_position")
    if stops:
        time.sleep(1.0)
        assert goal < 0.08 and abs(bus.read("motor_x", "present_position") - there) < 0.004
    else:
        assert goal == pytest.approx(0.11, abs=0.002)
        deadline = time.monotonic() + PATIENCE
        while abs(bus.read("motor_x", "present_position") - goal) > 0.004:
            assert time.monotonic() < deadline, "the servo goes on to its goal"
    bus.close()
    bench.states.clear()
    bench.command((0.0, 0.0))
    bench.start_node(config=bench.folder / "view.yaml")
    bench.until(lambda: bool(bench.states) and bench.reaches((0.0, 0.0)), "motion under the next node")


def test_a_vanished_peer_ends_motion_where_the_motor_is(bench: Bench) -> None:
    """The commands come from a process that is killed; the goal it gave is far away."""
    slow = {**yaml.safe_load(config.find("testbed", "healthy").read_text()), "quantities": {"command_rate": 0.05}}
    (bench.folder / "slow.yaml").write_text(yaml.safe_dump(slow))
    bench.start_testbed("--config", str(bench.folder / "slow.yaml"))
    bench.start_node()
    bench.more_states(5)
    peer = bench.start_commander((0.11, 0.0))
    bench.until(lambda: 0.01 < bench.motor()[0] < 0.03, "a motor on its way")
    peer.kill()
    peer.wait()
    bench.until(lambda: bench.status().get("state") == "holding", "holding")
    bench.more_states(20)
    held = bench.motor()[0]
    assert held < 0.09, "it did not go on to the goal"
    bench.more_states(50)
    assert abs(bench.motor()[0] - held) < 0.004


def test_commands_of_a_clock_that_stepped_are_judged_by_their_age(running: Bench) -> None:
    """A sender's clock may be off by the timeout, either way; a command is never fresh for longer than that."""
    running.command((0.03, 0.0), ahead=-10.0)
    running.until(lambda: int(running.status().get("commands refused", "0")) > 20, "old commands refused")
    assert running.status()["state"] == "waiting" and running.reaches((0.0, 0.0))
    refused = int(running.status()["commands refused"])
    running.command((0.03, 0.0), ahead=10.0)
    running.until(lambda: int(running.status()["commands refused"]) > refused + 20, "commands of the future refused")
    assert running.status()["state"] == "waiting" and running.reaches((0.0, 0.0))
    running.command((0.03, 0.0), ahead=0.15)
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    running.command(None)
    running.until(lambda: running.status().get("state") == "holding", "holding after silence")


def test_stamps_follow_a_clock_that_steps_and_count_it() -> None:
    from labyrinth_hw.nodes.messages import Stamps

    wall, steady = [1_000_000_000], [5.0]
    stamps = Stamps(lambda: wall[0], lambda: steady[0])
    assert stamps.at(4.9).nanosec == 900_000_000
    wall[0] += 3_600_000_000
    steady[0] += 3.6
    assert (stamps.at(8.6).sec, stamps.steps) == (4, 0)
    wall[0] -= 2_000_000_000
    assert (stamps.at(8.6).sec, stamps.steps) == (2, 1)


def test_stamps_do_not_jitter_where_the_process_was_interrupted() -> None:
    from labyrinth_hw.nodes.messages import Stamps

    readings = iter([5.0, 5.0, 6.0, 6.2])
    stamps = Stamps(lambda: 1_000_000_000, lambda: next(readings))
    first = stamps.at(5.0)
    assert stamps.at(5.0) == first and stamps.steps == 0


def test_a_killed_node_leaves_a_rig_that_the_next_one_can_take_over(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    assert running.node is not None
    running.node.kill()
    running.node.wait()
    running.states.clear()
    running.command((0.0, 0.0))
    running.start_node()
    running.until(lambda: running.reaches((0.0, 0.0)), "motion under the new node")


def test_a_second_node_on_the_port_refuses_with_code_2(running: Bench) -> None:
    first = running.node
    running.start_node()
    code, text = running.ended()
    running.node = first
    assert code == 2
    assert "in use by another program" in text
    running.more_states(20)
