# SPDX-License-Identifier: Apache-2.0
"""When the hardware node obeys, and that it ends: real processes on the emulated testbed."""

import signal

import pytest
from hw_bench import ROS_IN_REAL_TIME, SOON, Bench

pytestmark = ROS_IN_REAL_TIME
GOAL, LEVEL = (0.04, -0.03), (0.0, 0.0)


@pytest.fixture
def disarmed(bench: Bench) -> Bench:
    """The bench with testbed and node started as they are without a word on arming."""
    bench.start_testbed()
    bench.start_node(arm="false")
    bench.more_states(5)
    return bench


def refused(bench: Bench) -> int:
    return int(bench.status().get("commands refused", "0"))


def state_is(bench: Bench, state: str) -> None:
    bench.until(lambda: bench.status().get("state") == state, state)


def test_nothing_moves_before_the_rig_is_armed_nor_after_it_was_disarmed(disarmed: Bench) -> None:
    disarmed.command(GOAL)
    disarmed.until(lambda: refused(disarmed) > 30, "refused commands")
    assert disarmed.status()["state"] == "disarmed" and disarmed.reaches(LEVEL)
    assert disarmed.arm().success
    disarmed.until(lambda: disarmed.reaches(GOAL), "the goal once armed")
    assert disarmed.arm(False).success
    state_is(disarmed, "disarmed")
    disarmed.command(LEVEL)
    before = refused(disarmed)
    disarmed.until(lambda: refused(disarmed) > before + 30, "refused commands")
    assert not disarmed.reaches(LEVEL)


def test_the_lifecycle_opens_the_bus_arms_and_closes_it(bench: Bench) -> None:
    from lifecycle_msgs.msg import State, Transition
    from lifecycle_msgs.srv import ChangeState, GetState

    change, get = bench.client(ChangeState, "/hw_node/change_state"), bench.client(GetState, "/hw_node/get_state")

    def go(transition: int) -> bool:
        return bool(bench.call(change, ChangeState.Request(transition=Transition(id=transition))).success)

    def now() -> int:
        return int(bench.call(get, GetState.Request()).current_state.id)

    bench.start_testbed()
    bench.start_node(autostart="false")
    assert now() == State.PRIMARY_STATE_UNCONFIGURED
    assert not bench.arm().success
    assert not bench.states, "nothing is measured before it is configured"
    assert go(Transition.TRANSITION_CONFIGURE)
    bench.more_states(5)
    bench.command(GOAL)
    bench.more_states(50)
    assert bench.reaches(LEVEL)
    assert go(Transition.TRANSITION_ACTIVATE)
    bench.until(lambda: bench.reaches(GOAL), "the goal")
    assert go(Transition.TRANSITION_DEACTIVATE)
    state_is(bench, "disarmed")
    assert go(Transition.TRANSITION_CLEANUP)
    seen = len(bench.states)
    bench.tell("unplug servos")
    assert not go(Transition.TRANSITION_CONFIGURE), "no port, no configuration"
    assert now() == State.PRIMARY_STATE_UNCONFIGURED
    bench.tell("plug servos")
    assert go(Transition.TRANSITION_CONFIGURE)
    bench.until(lambda: len(bench.states) > seen + 20, "joint states once more")
    assert now() == State.PRIMARY_STATE_INACTIVE


def test_silence_disarms(bench: Bench) -> None:
    bench.start_testbed()
    bench.start_node(disarm_after=1.5)
    bench.command(GOAL)
    bench.until(lambda: bench.reaches(GOAL), "the goal")
    bench.command(None)
    bench.until(lambda: "no command for 1.5 s" in bench.status().get("message", ""), "disarmed by silence")
    bench.command(LEVEL)
    bench.until(lambda: refused(bench) > 30, "refused commands")
    assert not bench.reaches(LEVEL)
    assert bench.arm().success
    bench.until(lambda: bench.reaches(LEVEL), "motion once armed again")


def test_a_second_publisher_disarms_and_keeps_from_arming(running: Bench) -> None:
    running.command(GOAL)
    running.until(lambda: running.reaches(GOAL), "the goal")
    other = running.start_commander(LEVEL)
    running.until(lambda: "has 2 publishers" in running.status().get("message", ""), "disarmed")

    def refused_with_names() -> bool:
        answer = running.arm()
        assert not answer.success
        return "has 2 publishers (/commander, /peer); expected one" in answer.message

    running.until(refused_with_names, "the names of both")
    other.terminate()
    other.wait()

    def armed() -> bool:
        return bool(running.arm().success)

    running.until(armed, "arming once the other is gone")
    running.until(lambda: running.reaches(GOAL), "the goal")


def test_a_command_for_one_motor_does_not_revive_another_s_old_goal(running: Bench) -> None:
    """Hold level; one late message for motor_y, then silence; then commands that name motor_x alone."""
    running.command(LEVEL)
    state_is(running, "active")
    running.command(None)
    running.send_once(running.publisher_in_use, ahead=-0.185, motor_y=0.09)
    state_is(running, "holding")
    running.more_states(100)
    held = running.motor()[1]
    assert abs(held) < 0.05
    for _ in range(100):
        running.send_once(running.publisher_in_use, motor_x=0.04)
        running.more_states(2)
    assert running.motor()[0] == pytest.approx(0.04, abs=0.004)
    assert running.motor()[1] == pytest.approx(held, abs=0.004)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_without_a_clock_it_measures_stamps_no_negative_time_and_ends(bench: Bench, how: int) -> None:
    bench.start_testbed()
    bench.start_node(use_sim_time="true")
    bench.more_states(20)
    assert {(s.header.stamp.sec, s.header.stamp.nanosec) for s in bench.states} == {(0, 0)}
    assert bench.node is not None
    bench.node.send_signal(how)
    assert bench.ended(SOON)[0] == 0


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_while_it_waits_for_its_ports(bench: Bench, how: int) -> None:
    bench.start_node(connect_timeout=600.0)
    bench.until(lambda: bench.has_node("hw_node"), "the node")
    assert bench.node is not None
    bench.node.send_signal(how)
    assert bench.ended(SOON)[0] == 0


@pytest.mark.parametrize("met", ["the wait set", "a callback", "nothing"])
def test_a_context_taken_away_while_the_executor_gathers_what_to_wait_for_ends_the_node(
    monkeypatch: pytest.MonkeyPatch, domain: int, met: str
) -> None:
    """A signal comes at any moment; what the middleware refuses while the context stands is still an error."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.impl.implementation_singleton import rclpy_implementation

    from labyrinth_hw.nodes.start import spin

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("interrupted", context=context)
    real = rclpy_implementation.WaitSet

    def at_the_wait_set(*entities: object) -> object:
        if met == "nothing":
            raise rclpy_implementation.RCLError("refused")
        context.shutdown()
        if met == "a callback":
            raise rclpy_implementation.InvalidHandle("destroyed")
        return real(*entities)

    monkeypatch.setattr("rclpy.executors._rclpy.WaitSet", at_the_wait_set)
    try:
        executor = SingleThreadedExecutor(context=context)
        if met != "nothing":
            spin(node, executor)
        else:
            with pytest.raises(rclpy_implementation.RCLError, match="refused"):
                spin(node, executor)
    finally:
        node.destroy_node()
        context.try_shutdown()
