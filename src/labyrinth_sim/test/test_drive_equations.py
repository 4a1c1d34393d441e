# SPDX-License-Identifier: Apache-2.0
"""Every drive against the equation that its own file states, in chosen states and under a sagging supply."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from small_rigs import DRIVES, INERTIA, SLEDGE, checks, play, torques

from labyrinth_sim.effect import drives as library
from labyrinth_sim.model import Model

STIFF = DRIVES["torque_pd"]["stiffness"]
ModelOf = Callable[..., Model]


@checks(
    "torque_pd",
    "torque = clip(K (target - angle) - C speed, -M min(1, 1 + b speed), M min(1, 1 - b speed)), b = back_emf",
)
@pytest.mark.parametrize(("angle", "speed", "target"), [(0.1, 0.0, 0.3), (0.1, 2.0, 0.3), (0.0, -1.0, -0.2)])
def test_torque_pd(model_of: ModelOf, angle: float, speed: float, target: float) -> None:
    torque = torques(model_of("horn"), [target], 1e-4, a=angle, a_speed=speed)[0]
    assert torque == pytest.approx(4.0 * (target - angle) - 0.2 * speed, abs=1e-9)


@checks(
    "velocity_pid",
    "v = P e + I sum(e_k dt_k) + D (e - e 10 ms before); "
    "torque = clip(G (v - speed), -M min(1, 1 + b speed), M min(1, 1 - b speed)), b = back_emf",
)
@pytest.mark.parametrize("step", [0.01, 0.005, 0.002])
def test_velocity_pid(model_of: ModelOf, step: float) -> None:
    time = np.arange(round(0.2 / step)) * step
    target = 0.1 * np.sin(20 * time) + 0.05  # on an axis that stands still at zero, so it is the error
    summed = np.cumsum(target) * step
    earlier = np.concatenate([[0.0], target])
    risen = target - np.interp(time - 0.01, np.concatenate([[-step], time]), earlier)  # D is meant for 10 ms a sample
    model = model_of("pair", "velocity_pid").with_values({"drive.a.p": 3.0, "drive.a.i": 15.0, "drive.a.d": -6.0})
    expected = 0.5 * (3.0 * target + 15.0 * summed - 6.0 * risen)
    assert torques(model, target, step) == pytest.approx(expected, abs=1e-9)


def test_velocity_pid_takes_the_speed_off(model_of: ModelOf) -> None:
    torque = torques(model_of("horn", "velocity_pid"), [0.3], 1e-4, a=0.1, a_speed=0.7)[0]
    assert torque == pytest.approx(0.5 * (8.0 * 0.2 - 0.7), abs=1e-9)


@checks(
    "pwm_servo",
    "duty = clip(k_p g (target - angle + T speed), -1, 1); torque = k_t (duty V - k_t speed) / R, T = feedback_delay",
)
@pytest.mark.parametrize("target", [0.2, 1.5, -1.5])
@pytest.mark.parametrize("speed", [0.0, 2.0])
@pytest.mark.parametrize("late", [0.0, 0.005])
def test_pwm_servo(model_of: ModelOf, target: float, speed: float, late: float) -> None:
    duty = min(max(400.0 / 150 * (target - 0.1 + late * speed), -1.0), 1.0)
    model = model_of("horn", "pwm_servo").with_values({"drive.a.feedback_delay": late})
    torque = torques(model, [target], 1e-4, a=0.1, a_speed=speed)[0]
    assert torque == pytest.approx(0.5 * (duty * 6.0 - 0.5 * speed) / 2.0, abs=1e-9)


@pytest.mark.parametrize("drive", ["torque_pd", "velocity_pid"])
@pytest.mark.parametrize("speed", [2.0, -1.0])
def test_back_emf_takes_torque_at_the_limit_and_none_below_or_braking(
    model_of: ModelOf, drive: str, speed: float
) -> None:
    model = model_of("horn", drive).with_values({"drive.a.back_emf": 0.2})
    for sign in (1.0, -1.0):
        limited = torques(model, [3.0 * sign], 1e-4, a_speed=speed)[0]
        # Braking, the current's limit holds.
        expected = 1.5 if sign * speed < 0 else 1.5 * (1.0 - 0.2 * abs(speed))
        assert limited == pytest.approx(sign * expected, abs=1e-9)
    damping = {"torque_pd": 0.2, "velocity_pid": 0.5}[drive]
    below = torques(model, [0.3], 1e-4, a=0.1, a_speed=speed)[0]
    assert below == pytest.approx(4.0 * 0.2 - damping * speed, abs=1e-9)


def test_back_emf_ends_at_the_no_load_speed(model_of: ModelOf) -> None:
    """M dw/dt = S (1 - b w), whatever the step."""
    model = model_of("sledge").with_values({"drive.a.back_emf": 0.2})
    time = np.linspace(0.0, 2.0, 101)
    expected = -np.expm1(-1.5 * 0.2 / SLEDGE * time) / 0.2
    assert play(model, time, 1e3, 0.002)["a_speed"] == pytest.approx(expected, abs=5e-3)


@checks(
    "dc_motor_servo",
    "duty = clip(k_p (target - angle) - k_d speed, -1, 1); current = clip((duty V - k_t N speed) / R, -I, I); "
    "torque = eta N k_t current; armature + N^2 rotor inertia",
)
@pytest.mark.parametrize("target", [0.2, 1.5, -1.5])
@pytest.mark.parametrize("speed", [0.0, 2.0, -5.0])
@pytest.mark.parametrize("limit", [200.0, 0.9])
def test_dc_motor_servo(model_of: ModelOf, target: float, speed: float, limit: float) -> None:
    model = model_of("horn", "dc_motor_servo").with_values({"drive.a.kd": 0.1, "drive.a.current_limit": limit})
    duty = min(max(4.0 / 1.5 * (target - 0.1) - 0.1 * speed, -1.0), 1.0)
    current = min(max((duty * 6.0 - 0.005 * 200.0 * speed) / 3.0, -limit), limit)
    torque = torques(model, [target], 1e-5, a=0.1, a_speed=speed)[0]
    assert torque == pytest.approx(0.75 * 200.0 * 0.005 * current, abs=1e-9)


def test_the_rotor_of_a_dc_motor_turns_with_the_gear(model_of: ModelOf) -> None:
    """At its limit of current the servo gives 0.6 N m, which INERTIA and 200^2 times the rotor's share."""
    values = {"drive.a.rotor_inertia": 1e-6, "drive.a.current_limit": 0.8}
    model = model_of("horn", "dc_motor_servo").with_values(values)
    time = np.linspace(0.0, 0.1, 11)
    expected = 0.6 / (INERTIA + 200.0**2 * 1e-6) * time
    assert play(model, time, 1e3)["a_speed"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_a_drive_says_what_it_gives_at_most_at_rest(model_of: ModelOf, drive: str) -> None:
    kind, defaults = model_of("pair", drive).drives["a"].kind, library()[drive].parameters
    assert kind.full is not None
    assert kind.full({p.name: DRIVES[drive].get(p.name, p.typical) for p in defaults}) == pytest.approx(1.5)


@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_a_drive_is_limited_either_way_and_takes_whole_ticks_late(model_of: ModelOf, drive: str) -> None:
    limited = torques(model_of("pair", drive), [0.3, 3.0, -3.0, -0.3])
    assert limited == pytest.approx([1.2, 1.5, -1.5, -1.2], abs=1e-9)
    late = model_of("pair", drive).with_values({"drive.a.delay": 0.02, "drive.a.goal_tick": 0.05})
    target = np.array([0.02, 0.03, 0.07, 0.13, 0.18, 0.18])
    assert torques(late, target) == pytest.approx(4.0 * np.array([0.0, 0.0, 0.0, 0.05, 0.05, 0.15]), abs=1e-9)


@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_a_drive_sees_its_angle_in_whole_ticks(model_of: ModelOf, drive: str) -> None:
    model = model_of("horn", drive)
    ticks = model.with_values({"drive.a.feedback_tick": 0.04})
    for angle, seen in ((0.05, 0.04), (0.061, 0.08), (-0.05, -0.04)):
        found, expected = torques(ticks, [0.1], 1e-4, a=angle), torques(model, [0.1], 1e-4, a=seen)
        assert found[0] == pytest.approx(expected[0], rel=1e-6)


SAG = (
    "V' = V - s V sum_i duty_i |torque_i| / torque_max,i; |torque_i| <= torque_max,i (V' / V - b_i speed_i), "
    "b_i = 1 / 6.5 s/rad where the drive has no back-EMF of its own"
)


@checks("supply_sag", SAG)
@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_supply_sag_at_a_standstill(model_of: ModelOf, drive: str) -> None:
    """V' / V is f. Each motor at full duty gives f of its torque."""
    sag = 0.8
    model = model_of("pair", drive).with_effect("supply_sag", "a", {"sag": sag})
    alone = 1 / (1 + sag)  # f = 1 - s f
    both = 1 / (1 + 2 * sag)  # f = 1 - 2 s f
    found = torques(model, np.array([[3.0, 0.0], [3.0, 3.0], [-3.0, 3.0]]))
    assert found == pytest.approx(1.5 * np.array([alone, both, -both]), abs=1e-6)


@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_one_supply_sags_for_all_drives_at_whatever_axis_it_is_stated(model_of: ModelOf, drive: str) -> None:
    """At full duty of both, f = 1 - 2 s f. Stated twice it does not sag twice."""
    model, asked = model_of("pair", drive), np.array([[3.0, 3.0]])
    for place in "ab":
        stated = model.with_effect("supply_sag", place, {"sag": 0.8})
        assert [torques(stated, asked, axis=axis)[0] for axis in "ab"] == pytest.approx([1.5 / 2.6] * 2, abs=1e-6)
    both = model.with_effect("supply_sag", "b", {"sag": 0.4}).with_effect("supply_sag", "a", {"sag": 0.8})
    found = [torques(both, asked, axis=axis)[0] for axis in "ab"]
    assert found == pytest.approx([1.5 / 2.6, 1.5 / 1.8], abs=1e-6)


@pytest.mark.parametrize("drive", ["torque_pd", "velocity_pid"])
def test_supply_sag_beside_a_motor_that_gives_less(model_of: ModelOf, drive: str) -> None:
    """A drive that regulates its torque gives the share t at a duty of t / f."""
    sag, t = 0.8, 0.2 / 1.5  # 0.05 rad off b asks for 0.2 N m
    model = model_of("pair", drive).with_effect("supply_sag", "a", {"sag": sag})
    beside = (1 + math.sqrt(1 - 4 * (1 + sag) * sag * t**2)) / (2 * (1 + sag))  # f = 1 - s (f + t^2 / f)
    alone = 1 / (1 + sag)  # of its torque at most
    asked = 1.5 / STIFF * np.array([[2.0, t], [0.3, t], [alone - 0.01, 0.0], [alone + 0.01, 0.0]])
    assert torques(model, asked) == pytest.approx(1.5 * np.array([beside, 0.3, alone - 0.01, alone]), abs=1e-6)


@pytest.mark.parametrize("drive", ["pwm_servo", "dc_motor_servo"])
@pytest.mark.parametrize("duty", [0.3, 0.7])
def test_supply_sag_of_a_servo_by_duty_cycle(model_of: ModelOf, drive: str, duty: float) -> None:
    """At a duty of its own a motor gives f of that: f = 1 - s duty (duty f)."""
    model = model_of("pair", drive).with_effect("supply_sag", "a", {"sag": 0.8})
    torque = torques(model, np.array([[duty * 1.5 / 4.0, 0.0]]))[0]
    assert torque == pytest.approx(1.5 * duty / (1 + 0.8 * duty**2), abs=1e-6)


@pytest.mark.parametrize("speed", [2.0, -2.0])
def test_supply_sag_in_motion(model_of: ModelOf, speed: float) -> None:
    """At full duty a motor gives f - n of its torque, n being back-EMF's share, and f = 1 - s (f - n)."""
    sag, n = 0.8, speed / 6.5
    model = model_of("horn").with_effect("supply_sag", "a", {"sag": sag})
    torque = torques(model, [3.0], 1e-4, a_speed=speed)[0]
    assert torque == pytest.approx(1.5 * ((1 + sag * n) / (1 + sag) - n), rel=1e-4)


@pytest.mark.parametrize("speed", [2.0, -2.0])
def test_supply_sag_goes_by_the_back_emf_that_a_drive_has(model_of: ModelOf, speed: float) -> None:
    sag, n = 0.8, 0.1 * speed
    model = model_of("horn").with_values({"drive.a.back_emf": 0.1}).with_effect("supply_sag", "a", {"sag": sag})
    torque = torques(model, [3.0], 1e-4, a_speed=speed)[0]
    assert torque == pytest.approx(1.5 * ((1 + sag * n) / (1 + sag) - n), rel=1e-6)
    by_duty = model_of("horn", "pwm_servo").with_effect("supply_sag", "a", {"sag": sag})
    duty, n = 0.6, 0.5 * speed / 6.0  # f = 1 - s duty (duty f - n)
    torque = torques(by_duty, [duty * 1.5 / 4.0], 1e-4, a_speed=speed)[0]
    factor = min((1 + sag * duty * n) / (1 + sag * duty**2), 1.0)
    assert torque == pytest.approx(1.5 * (duty * factor - n), rel=1e-6)


def test_hardly_any_sag_leaves_back_emf_out(model_of: ModelOf) -> None:
    model = model_of("horn").with_effect("supply_sag", "a", {"sag": 1e-6})
    assert torques(model, [3.0], 1e-4, a_speed=2.0)[0] == pytest.approx(1.5, rel=1e-4)
