# SPDX-License-Identifier: Apache-2.0
"""What may be sent to the servos."""

import math

import pytest

from labyrinth_hw.control_tables import PROTOCOL_1_ERRORS
from labyrinth_hw.errors import InputError
from labyrinth_hw.motors import MotorState
from labyrinth_hw.safety import SPEEDING_SAMPLES, VOLTAGE_SAMPLES, Goal, Limits, Safety, State

LIMITS = Limits(angle=0.1, speed=5.0, temperature=70.0, voltage=(9.0, 16.0))


def machine() -> Safety:
    """One motor, armed."""
    safety = Safety({"motor_x": LIMITS}, 0.2, None, {"motor_x": PROTOCOL_1_ERRORS})
    safety.arm(0.0)
    return safety


def state(position: float = 0.0, **more: float) -> dict[str, MotorState]:
    return {"motor_x": MotorState(0.0, position, **more)}  # type: ignore[arg-type]


def command(goal: float, received: float = 0.0) -> dict[str, Goal]:
    return {"motor_x": Goal(goal, received)}


def test_nothing_moves_before_the_first_command() -> None:
    order = machine().step(0.0, state(), {})
    assert (order.torque, order.goals) == (False, None)


def test_an_old_first_command_does_not_move_either() -> None:
    order = machine().step(1.0, state(), command(0.05, received=0.7))
    assert (order.torque, order.goals) == (False, None)


def test_a_fresh_command_is_followed() -> None:
    order = machine().step(0.1, state(), command(0.05))
    assert order.torque and order.goals == {"motor_x": 0.05}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_goals_are_clipped_to_the_limits_and_this_is_told(sign: float) -> None:
    order = machine().step(0.1, state(), command(0.3 * sign))
    assert order.goals == {"motor_x": 0.1 * sign} and order.clipped == {"motor_x"}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_overshoot_that_is_allowed_does_not_stop(sign: float) -> None:
    safety = machine()
    safety.step(0.0, state(), command(0.0))
    assert safety.step(0.01, state(sign * (0.1 + LIMITS.overshoot - 0.01)), command(0.0)).torque


def test_without_fresh_commands_motion_stops_where_the_motor_is() -> None:
    safety = machine()
    safety.step(0.1, state(), command(0.08))
    held = safety.step(0.31, state(0.033), command(0.08))
    assert safety.state is State.HOLDING
    assert held.torque and held.goals == {"motor_x": 0.033}
    assert safety.step(0.5, state(0.035), {}).goals == {"motor_x": 0.033}
    assert safety.step(0.6, state(0.033), command(0.08, 0.6)).goals == {"motor_x": 0.08}


@pytest.mark.parametrize(
    ("measured", "reason"),
    [
        (state(temperature=71.0), "71 degC passed the limit of 70 degC"),
        (state(alarm=0x20), "overload"),
        (state(alarm=0x04), "overheating"),
        (state(0.1 + LIMITS.overshoot + 0.01), "motor_x: 10.3 deg passed the limit of 5.7 deg"),
        (state(-0.1 - LIMITS.overshoot - 0.01), "motor_x: -10.3 deg passed the limit of 5.7 deg"),
    ],
)
def test_a_violation_stops_until_reset(measured: dict[str, MotorState], reason: str) -> None:
    safety = machine()
    safety.step(0.0, state(), command(0.0))
    assert not safety.step(0.01, measured, command(0.0)).torque
    assert reason in safety.reasons[0]
    assert not safety.step(0.02, state(), command(0.0, 0.02)).torque, "it must stay off without reset"
    safety.reset()
    assert not safety.step(0.03, state(), command(0.0, 0.03)).torque, "it must stay off until armed"
    safety.arm(0.04)
    assert safety.step(0.05, state(), command(0.0, 0.05)).torque


def test_speed_and_voltage_must_be_wrong_for_some_samples() -> None:
    safety = machine()
    for k in range(SPEEDING_SAMPLES - 1):
        assert safety.step(0.0, state(speed=6.0), command(0.0)).torque, k
    assert safety.step(0.0, state(speed=0.0), command(0.0)).torque
    for _ in range(SPEEDING_SAMPLES):
        order = safety.step(0.0, state(speed=-6.0), command(0.0))
    assert not order.torque
    safety.reset()
    safety.arm(0.0)
    for _ in range(VOLTAGE_SAMPLES):
        order = safety.step(0.0, state(voltage=8.0), command(0.0))
    assert not order.torque and "8.0 V" in safety.reasons[0]


def test_a_lost_bus_needs_a_new_command_but_does_not_lift_a_stop() -> None:
    safety = machine()
    safety.step(0.0, state(), command(0.05))
    safety.lost_contact()
    assert safety.state is State.WAITING
    safety.step(0.0, state(alarm=0x20), {})
    safety.lost_contact()
    assert safety.state is State.STOPPED
    with pytest.raises(InputError, match="overload"):
        safety.arm(0.1)


def test_disarmed_nothing_moves_and_what_came_before_arming_does_not_count() -> None:
    safety = Safety({"motor_x": LIMITS})
    assert not safety.step(0.1, state(), command(0.05, 0.1)).torque
    safety.arm(0.12)
    assert not safety.step(0.13, state(), command(0.05, 0.1)).torque
    assert safety.step(0.14, state(), command(0.05, 0.14)).torque
    safety.disarm()
    assert not safety.step(0.15, state(), command(0.05, 0.15)).torque


def test_silence_disarms() -> None:
    safety = Safety({"motor_x": LIMITS}, disarm_after=5.0)
    safety.arm(0.0)
    safety.step(1.0, state(), command(0.05, 1.0))
    assert safety.step(5.9, state(), {}).torque, "holding"
    assert safety.step(5.95, state(), command(0.05, 1.0)).torque
    assert not safety.step(6.1, state(), {}).torque
    assert safety.state is State.DISARMED and safety.reasons == ("no command for 5 s",)
    safety.arm(7.0)
    assert not safety.step(11.9, state(), {}).torque and safety.armed
    safety.step(12.1, state(), {})
    assert not safety.armed, "armed and never commanded"


def test_the_timeout_holds_motor_by_motor() -> None:
    safety = Safety({"motor_x": LIMITS, "motor_y": LIMITS})
    safety.arm(0.0)
    at = {"motor_x": MotorState(0.0, 0.01), "motor_y": MotorState(0.0, -0.02)}
    order = safety.step(0.1, at, {"motor_x": Goal(0.05, 0.1)})
    assert order.goals == {"motor_x": 0.05, "motor_y": -0.02}, "never commanded, so it stays"
    assert order.commanded == {"motor_x"}
    old = {"motor_y": Goal(0.09, 0.15)}
    assert safety.step(0.2, at, {"motor_x": Goal(0.05, 0.2), **old}).goals == {"motor_x": 0.05, "motor_y": 0.09}
    moved = {**at, "motor_y": MotorState(0.0, 0.03)}
    order = safety.step(6.0, moved, {"motor_x": Goal(0.06, 6.0), **old})
    assert order.goals == {"motor_x": 0.06, "motor_y": 0.03}, "an old goal is not revived by another motor's command"


@pytest.mark.parametrize("goals", [{}, {"motor_z": 0.0}, {"motor_x": math.nan}, {"motor_x": math.inf}])
def test_invalid_commands_are_refused_with_a_reason(goals: dict[str, float]) -> None:
    safety = machine()
    with pytest.raises(InputError, match="motor_x"):
        safety.check(goals)
