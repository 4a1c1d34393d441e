# SPDX-License-Identifier: Apache-2.0
"""The hardware node as a real process, on the emulated testbed as another one."""

import itertools
import signal
import time

import pytest
from hw_bench import PATIENCE, ROS_IN_REAL_TIME, Bench

pytestmark = ROS_IN_REAL_TIME


def test_commands_move_both_axes_and_states_are_complete(running: Bench) -> None:
    running.command((0.05, -0.03))
    running.until(lambda: running.reaches((0.05, -0.03)), "both motors at their goals")
    running.more_states(100)
    state = running.states[-1]
    assert list(state.name) == ["motor_x", "motor_y", "board_x", "board_y"]
    assert state.position[2] == pytest.approx(0.05, abs=0.004)
    assert state.position[3] == pytest.approx(-0.03, abs=0.004)
    stamps = [s.header.stamp.sec + 1e-9 * s.header.stamp.nanosec for s in running.states[-100:]]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert abs(stamps[-1] - time.time()) < PATIENCE
    running.until(lambda: running.status().get("state") == "active", "diagnostics that tell the state")
    assert running.status()["motor_x temperature [degC]"] == "30"


def test_without_commands_the_rig_holds_and_goes_on_with_the_next(running: Bench) -> None:
    running.command((0.04, 0.0))
    running.until(lambda: running.reaches((0.04, 0.0)), "the goal")
    running.command(None)
    running.until(lambda: running.status().get("state") == "holding", "holding after silence")
    running.more_states(30)
    assert running.reaches((0.04, 0.0))
    running.command((0.0, 0.0))
    running.until(lambda: running.reaches((0.0, 0.0)), "the next goal")


def test_an_overload_switches_torque_off_until_reset(running: Bench) -> None:
    running.command((0.03, 0.0))
    running.until(lambda: running.reaches((0.03, 0.0)), "the goal")
    running.tell("alarm x 0x20")
    running.until(lambda: running.status().get("state") == "stopped", "the stop")
    assert "motor_x: the servo reports overload" in running.status()["message"]
    running.command((-0.03, 0.0))
    running.more_states(50)
    assert running.motor()[0] > -0.01, "nothing may move while stopped"
    running.tell("heal x")
    running.reset()
    running.until(lambda: running.status().get("state") == "disarmed", "the reset")
    running.more_states(50)
    assert running.motor()[0] > -0.01, "nothing may move before it is armed again"
    assert running.arm().success
    running.until(lambda: running.reaches((-0.03, 0.0)), "motion after the reset")


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_torque_goes_off_when_the_node_ends(bench: Bench, how: int) -> None:
    from labyrinth_hw.bus import ServoBus
    from labyrinth_hw.control_tables import servo_model
    from labyrinth_hw.motors import Motor

    bench.start_testbed()
    bench.start_node()
    bench.command((0.03, 0.0))
    bench.until(lambda: bool(bench.states) and bench.reaches((0.03, 0.0)), "the goal")
    assert bench.node is not None
    bench.node.send_signal(how)
    code, said = bench.ended()
    assert code == 0, said
    motors = [Motor("motor_x", 1, servo_model("MX-64"))]
    bus = ServoBus(str(bench.folder / "links" / "servos"), 1_000_000, motors, patience=1.0)
    bus.connect()
    assert bus.read("motor_x", "torque_enable") == 0
    bus.close()


def test_a_node_that_starts_first_waits_for_its_ports(bench: Bench) -> None:
    bench.start_node(connect_timeout=PATIENCE)
    bench.start_testbed()
    bench.more_states(5)


def test_a_node_waits_for_servos_that_answer_later(bench: Bench) -> None:
    bench.start_testbed()
    bench.tell("late servos 0.05")
    bench.start_node(connect_timeout=PATIENCE)
    bench.until(lambda: "Found nothing" in bench.said(), "a node that waits")
    bench.tell("late servos 0")
    bench.more_states(5)


def test_dry_run_measures_but_moves_nothing(bench: Bench) -> None:
    bench.start_testbed()
    bench.start_node(dry_run="true")
    bench.command((0.05, 0.05))
    bench.more_states(100)
    assert bench.reaches((0.0, 0.0))


def test_the_ball_is_seen_lost_and_supplied(bench: Bench) -> None:
    from std_srvs.srv import Trigger

    from labyrinth_msgs.msg import BallEvent

    bench.start_testbed("--video", "--video-rate", "15")
    bench.start_node()
    start = (0.166, 0.2205)  # of the medium layout's path

    def near_start() -> bool:
        ball = bench.balls[-1] if bench.balls else None
        return ball is not None and ball.visible and max(abs(ball.x - start[0]), abs(ball.y - start[1])) < 0.005

    bench.until(near_start, "the ball at its start")
    bench.command((-0.06, -0.06))
    for goal in ((0.06, -0.06), (0.06, 0.06), (-0.06, 0.06), (0.06, -0.06), (0.06, 0.06)):
        for _ in range(25):
            bench.more_states(5)
            if any(event.kind == BallEvent.LOST for event in bench.events):
                break
        bench.command(goal)
    bench.until(lambda: any(event.kind == BallEvent.LOST for event in bench.events), "the ball lost")
    bench.command((0.0, 0.0))
    bench.until(lambda: bench.reaches((0.0, 0.0)), "a level board")
    bench.until(bench.supply.call_async(Trigger.Request()).done, "the depot's service")
    bench.until(lambda: any(event.kind == BallEvent.SUPPLIED for event in bench.events), "the ball supplied")
    bench.until(near_start, "the ball at its start again")


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"config": "papr"}, "Did you mean 'paper'"),
        ({"rate": "5.0"}, "rate"),
        ({"spede": "1"}, "Unknown parameters"),
        ({"connect_timeout": "0.2"}, "does not exist"),
    ],
)
def test_bad_parameters_and_missing_hardware_end_with_code_2(bench: Bench, parameters: dict, complaint: str) -> None:
    bench.start_node(**parameters)
    code, text = bench.ended()
    assert code == 2
    assert complaint in text
