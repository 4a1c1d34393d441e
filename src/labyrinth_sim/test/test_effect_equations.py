# SPDX-License-Identifier: Apache-2.0
"""Every effect and every drive against the equation that its own file states, by numbers worked out here.

To add one: a test under `@checks(name, equation)`, the equation as in the file; of a drive in
`test_drive_equations`, of a free curve in `test_curve_equations`, of the ball in `test_ball_equations`. Nothing
here compares a roll-out with another roll-out.
"""

import importlib
import math
import pkgutil
from collections.abc import Callable

import numpy as np
import pytest
import test_ball_equations  # noqa: F401  its import registers its checks
import test_curve_equations  # noqa: F401
import test_drive_equations  # noqa: F401
from small_rigs import (
    ARM,
    BELT_D,
    BELT_K,
    BELT_MOTOR,
    BELT_RATIO,
    CHECKED,
    DRIVES,
    INERTIA,
    MASS,
    SLEDGE,
    SPRING,
    G,
    checks,
    integrated,
    play,
    torques,
)

import labyrinth_sim.drives
import labyrinth_sim.effects
from labyrinth_sim.model import Model

STIFF = DRIVES["torque_pd"]["stiffness"]
MOST = DRIVES["torque_pd"]["torque"]
ModelOf = Callable[..., Model]


# Effects on the command and inside the drive: the torque of a stiff drive on an axis that stands still at zero shows
# which target it sees.


def seen(model: Model, target: np.ndarray) -> np.ndarray:
    """(T,) rad, the target that axis a's drive sees of a target every 10 ms."""
    return torques(model, target) / STIFF


@checks("command_delay", "u'(t) = u(t - T)")
@pytest.mark.parametrize("delay", [0.02, 0.024, 0.03])
def test_command_delay(model_of: ModelOf, delay: float) -> None:
    model = model_of("pair").with_effect("command_delay", "a", {"delay": delay})
    time = np.arange(20) * 0.01
    ramp = seen(model, 2.0 * time)
    assert ramp[5:] == pytest.approx(2.0 * (time - delay)[5:], abs=1e-9)
    # What is held for a sample comes in two parts where the delay is no whole number of samples.
    step = seen(model, np.where(time >= 0.1, 0.3, 0.0))
    held = np.clip((time + 0.01 - (0.1 + delay)) / 0.01, 0.0, 1.0)
    assert step == pytest.approx(0.3 * held, abs=1e-9)


@checks("command_quantisation", "u' = q round(u / q - c)")
@pytest.mark.parametrize(
    ("cut", "expected"),
    [(0.0, [0.0, 0.0, 0.02, 0.02, 0.04, 0.0, -0.02, -0.06]), (0.5, [0.0, 0.0, 0.0, 0.02, 0.02, -0.02, -0.02, -0.06])],
)
def test_command_quantisation(model_of: ModelOf, cut: float, expected: list[float]) -> None:
    model = model_of("pair").with_effect("command_quantisation", "a", {"tick": 0.02, "cut": cut})
    target = np.array([0.0, 0.009, 0.011, 0.029, 0.031, -0.009, -0.011, -0.06])
    assert seen(model, target) == pytest.approx(expected, abs=1e-9)


@checks("gain_error", "u' = (1 + g) u")
@pytest.mark.parametrize("share", [0.2, -0.1])
def test_gain_error(model_of: ModelOf, share: float) -> None:
    model = model_of("pair").with_effect("gain_error", "a", {"share": share})
    target = np.array([0.0, 0.1, -0.2])
    assert seen(model, target) == pytest.approx((1 + share) * target, abs=1e-9)


@checks("positioning_error", "u' = u + (1 - s) A sin(2 pi u / L + phase); e' = e + s A sin(2 pi angle / L + phase)")
@pytest.mark.parametrize("share", [0.0, 1.0, 0.3])
def test_positioning_error(model_of: ModelOf, share: float) -> None:
    """Of a joint that stands still somewhere: what the drive makes of its targets."""
    values = {"amplitude": 0.03, "period": 0.2, "phase": 0.5, "seen": share}
    model = model_of("pair").with_effect("positioning_error", "a", values)
    target, angle = np.linspace(-0.1, 0.1, 11), 0.02

    def wave(at: np.ndarray | float) -> np.ndarray:
        return np.asarray(0.03 * np.sin(2 * np.pi * at / 0.2 + 0.5))

    errors = target - angle + (1.0 - share) * wave(target) + share * wave(angle)
    assert torques(model, target, a=angle) == pytest.approx(DRIVES["torque_pd"]["stiffness"] * errors, abs=1e-9)


@checks("rate_limit", "|du'/dt| <= r")
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rate_limit(model_of: ModelOf, sign: float) -> None:
    model = model_of("pair").with_effect("rate_limit", "a", {"rate": 3.0})
    time = np.arange(40) * 0.01
    fast = seen(model, np.full(40, sign * 0.25))
    travelled = np.minimum(0.25, 3.0 * np.linspace(0.0, 0.4, 40 * 1000, endpoint=False))
    assert fast == pytest.approx(sign * travelled.reshape(40, 1000).mean(axis=1), abs=1e-4)
    slow = sign * 0.2 * np.sin(10 * time)  # at most 2 rad/s
    assert seen(model, slow) == pytest.approx(slow, abs=3.0 * 0.01 / 2)


@checks("motion_profile", "|d2u'/dt2| <= a, |du'/dt| <= v, in the shortest time without passing u")
@pytest.mark.parametrize(("way", "takes"), [(0.5, 0.75), (-0.5, 0.75), (0.04, 0.2)])
def test_motion_profile(model_of: ModelOf, way: float, takes: float) -> None:
    """At 4 rad/s^2 and 1 rad/s: 0.25 s up, 0.25 s along, 0.25 s down; the short way never at full speed."""
    model = model_of("pair").with_values({"drive.a.torque": 5.0})
    model = model.with_effect("motion_profile", "a", {"acceleration": 4.0, "speed": 1.0})
    led = seen(model, np.full(100, way))
    up = math.sqrt(abs(way) / 4.0) if abs(way) < 0.25 else 0.25
    top = min(4.0 * up, 1.0)
    fine = np.arange(100 * 100) * 1e-4
    speed = np.clip(np.minimum(4.0 * fine, 4.0 * (takes - fine)), 0.0, top)
    travelled = np.cumsum(speed) * 1e-4
    assert led == pytest.approx(math.copysign(1.0, way) * travelled.reshape(100, 100).mean(axis=1), abs=5e-4)
    assert led[-1] == pytest.approx(way, abs=1e-5)


def test_a_profile_without_a_limit_on_the_acceleration_limits_the_rate(model_of: ModelOf) -> None:
    model = model_of("pair").with_effect("motion_profile", "a", {"acceleration": 5000.0, "speed": 3.0})
    travelled = np.minimum(0.25, 3.0 * np.linspace(0.0, 0.4, 40 * 1000, endpoint=False))
    assert seen(model, np.full(40, 0.25)) == pytest.approx(travelled.reshape(40, 1000).mean(axis=1), abs=1e-4)


@checks(
    "duty_cut_back",
    "|duty| <= s while |duty asked for| >= b for longer than T; of a drive that regulates its torque, torques in place "
    "of duties, as shares of the largest",
)
@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_duty_cut_back(model_of: ModelOf, drive: str) -> None:
    """1.5 N m is full duty: asked for 80 % at least for 50 ms; asked for less between, the time starts anew."""
    model = model_of("pair", drive).with_effect("duty_cut_back", "a", {"share": 0.2, "bound": 0.8, "time": 0.05})
    asked = np.repeat([1.0, 1.4, -1.3, 0.6, 1.3], [3, 7, 3, 2, 6])
    given = asked.copy()
    given[8:13], given[20] = 0.3 * np.sign(asked[8:13]), 0.3
    assert torques(model, asked / STIFF) == pytest.approx(given, abs=1e-9)
    sooner = model.with_values({"duty_cut_back.a.time": 0.045}, "test")
    given[7], given[19] = 0.9, 0.9  # cut in the second half of the step: half of the way from 1.5 N m to 0.3
    assert torques(sooner, asked / STIFF) == pytest.approx(given, abs=1e-9)


@pytest.mark.parametrize("drive", ["torque_pd", "velocity_pid"])
@pytest.mark.parametrize(("bound", "given"), [(0.5, 0.6), (0.3, 0.3)])
def test_a_cut_back_of_a_regulated_torque_leaves_back_emf_out(
    model_of: ModelOf, drive: str, bound: float, given: float
) -> None:
    """At 1 rad/s 0.6 N m of 1.5 N m take six tenths of the voltage, and four of the torque."""
    model = model_of("horn", drive).with_values({"drive.a.back_emf": 0.2})
    at = [float(torques(model, [target], 1e-4, a_speed=1.0)[0]) for target in (0.2, 0.3)]
    target = 0.2 + 0.1 * (0.6 - at[0]) / (at[1] - at[0])
    model = model.with_effect("duty_cut_back", "a", {"share": 0.2, "bound": bound, "time": 0.0})
    assert torques(model, [target], 1e-4, a_speed=1.0)[0] == pytest.approx(given, abs=1e-4)


@checks("cross_coupling", "load = r motor + c other load (with a belt); u' = u + c u_other (without)")
@pytest.mark.parametrize("share", [0.25, -0.1])
def test_cross_coupling_without_a_belt(model_of: ModelOf, share: float) -> None:
    model = model_of("pair").with_effect("cross_coupling", "a", {"share": share})
    target = np.array([[0.0, 0.2], [0.1, 0.0], [0.1, -0.2]])
    assert torques(model, target) / STIFF == pytest.approx(target[:, 0] + share * target[:, 1], abs=1e-9)
    assert torques(model, target, axis="b") / STIFF == pytest.approx(target[:, 1], abs=1e-9)


@pytest.mark.parametrize("share", [0.25, -0.1])
def test_cross_coupling_with_a_belt(model_of: ModelOf, share: float) -> None:
    model = model_of("belts").with_effect("cross_coupling", "a", {"share": share})
    rest = {name: signal[-1] for name, signal in play(model, np.linspace(0, 10, 501), [0.1, -0.2], 0.002).items()}
    assert (rest["a"], rest["b"]) == pytest.approx((0.1, -0.2), abs=1e-4)
    assert rest["b_load"] == pytest.approx(BELT_RATIO * -0.2, abs=1e-4)
    assert rest["a_load"] == pytest.approx(BELT_RATIO * 0.1 + share * BELT_RATIO * -0.2, abs=1e-4)


@checks("dead_band", "e' = 0 while |e| <= w, else e - (1 - j) w sign(e)")
@pytest.mark.parametrize(("jump", "near", "far"), [(0.0, 0.04, 0.6), (1.0, 0.24, 0.8), (0.4, 0.12, 0.68)])
@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_dead_band(model_of: ModelOf, drive: str, jump: float, near: float, far: float) -> None:
    model = model_of("pair", drive).with_effect("dead_band", "a", {"half_width": 0.05, "jump": jump})
    assert torques(model, [0.0, 0.04, -0.04, 0.06, 0.2, -0.2]) == pytest.approx([0, 0, 0, near, far, -far], abs=1e-9)


@checks(
    "torque_saturation",
    "|torque| <= s torque_max; of a drive that knows no current, |duty| <= s; "
    "x / (1 + x^(1/r))^r of the limit where x of it is asked for, r > 0 being the softness",
)
@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_torque_saturation(model_of: ModelOf, drive: str) -> None:
    model = model_of("pair", drive).with_effect("torque_saturation", "a", {"share": 0.4})
    assert torques(model, [0.1, 0.2, -0.1, -0.2]) == pytest.approx([0.4, 0.6, -0.4, -0.6], abs=1e-9)
    soft = model.with_values({"torque_saturation.a.softness": 0.5})
    asked = np.array([0.1, 0.15, 0.3, -0.1, -0.3]) / 0.15
    expected = 0.6 * asked / np.sqrt(1.0 + asked**2)
    assert torques(soft, [0.1, 0.15, 0.3, -0.1, -0.3]) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("drive", ["torque_pd", "velocity_pid"])
@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_a_soft_limit_of_the_current_is_one_of_the_law(model_of: ModelOf, drive: str, speed: float) -> None:
    """Back-EMF takes nothing of what the law asks for, far below the torque-speed line."""
    model = model_of("horn", drive).with_values({"drive.a.back_emf": 0.2})
    asked = torques(model, [0.2], 1e-4, a_speed=speed)[0]
    assert 0.2 < abs(asked) < 1.4
    model = model.with_effect("torque_saturation", "a", {"share": 0.4, "softness": 0.5})
    expected = asked / math.sqrt(1.0 + (asked / 0.6) ** 2)
    assert torques(model, [0.2], 1e-4, a_speed=speed)[0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("drive", ["torque_pd", "velocity_pid"])
@pytest.mark.parametrize(("speed", "forwards", "braking"), [(0.0, 0.6, -0.6), (2.0, 0.6, -0.6), (4.0, 0.3, -0.6)])
def test_a_limited_current_leaves_the_torque_to_back_emf_at_high_speed_only(
    model_of: ModelOf, drive: str, speed: float, forwards: float, braking: float
) -> None:
    model = model_of("horn", drive).with_values({"drive.a.back_emf": 0.2})
    model = model.with_effect("torque_saturation", "a", {"share": 0.4})
    for target, expected in ((9.0, forwards), (-9.0, braking)):
        assert torques(model, [target], 1e-4, a_speed=speed)[0] == pytest.approx(expected, abs=1e-9)


def test_a_limited_duty_leaves_the_torque_to_back_emf_at_any_speed(model_of: ModelOf) -> None:
    model = model_of("horn", "pwm_servo").with_effect("torque_saturation", "a", {"share": 0.4})
    assert torques(model, [9.0], 1e-4, a_speed=2.0)[0] == pytest.approx(0.5 * (0.4 * 6.0 - 0.5 * 2.0) / 2.0, abs=1e-9)
    soft = model.with_values({"torque_saturation.a.softness": 0.5})
    asked = (torques(model, [0.1], 1e-4, a_speed=2.0)[0] + 0.25) / 0.6
    expected = 0.6 * asked / math.sqrt(1.0 + asked**2) - 0.25
    assert torques(soft, [0.1], 1e-4, a_speed=2.0)[0] == pytest.approx(expected, rel=1e-4)


# Friction: with the drive off nothing else acts, and what the speed loses is the torque over the inertia. MuJoCo takes
# it for viscous below the speed that it would take away within a step, so that the end of a motion is a short tail.

TIME = np.linspace(0.0, 0.3, 61)
TAIL = 0.001  # s


@checks(
    "coulomb_friction", "torque = -F sign(speed); at rest |torque| <= F; -F tanh(speed / v_c) if it sets in gradually"
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_coulomb_friction(model_of: ModelOf, sign: float) -> None:
    model = model_of("horn").with_effect("coulomb_friction", "a", {"torque": 0.05})
    coasts = play(model, TIME, a_speed=sign)["a_speed"]
    expected = 1.0 - 0.05 / INERTIA * TIME
    moves = expected > 0.05 / INERTIA * TAIL
    assert coasts[moves] == pytest.approx(sign * expected[moves], abs=1e-6)
    assert coasts[-1] == pytest.approx(0.0, abs=1e-5)
    pushed = {share: play(model, TIME, sign * share * 0.05 / STIFF)["a"][-1] for share in (0.9, 2.0)}
    assert pushed[0.9] == pytest.approx(0.0, abs=1e-4)
    assert sign * pushed[2.0] > 0.01


@checks("viscous_friction", "torque = -B speed")
def test_viscous_friction(model_of: ModelOf) -> None:
    model = model_of("horn").with_effect("viscous_friction", "a", {"damping": 0.1})
    assert play(model, TIME, a_speed=2.0)["a_speed"] == pytest.approx(2 * np.exp(-0.1 / INERTIA * TIME), abs=2e-3)


@checks("stribeck_friction", "F = F_s exp(-(speed / v_s)^2) on top of Coulomb friction; torque = -F sign(speed)")
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("coulomb", [0.0, 0.02])
def test_stribeck_friction(model_of: ModelOf, sign: float, coulomb: float) -> None:
    model = model_of("horn").with_effect("coulomb_friction", "a", {"torque": coulomb})
    model = model.with_effect("stribeck_friction", "a", {"extra": 0.1, "speed": 0.5})
    expected = integrated(lambda w: -(coulomb + 0.1 * np.exp(-((w / 0.5) ** 2))) / INERTIA, [0.8], TIME)[:, 0]
    moves = expected > (coulomb + 0.1) / INERTIA * TAIL
    assert 0.3 < moves.mean() < 0.95 and expected[moves][-1] < 0.2  # fast and slow motion
    assert play(model, TIME, a_speed=sign * 0.8)["a_speed"][moves] == pytest.approx(sign * expected[moves], abs=3e-3)


@checks(
    "direction_friction",
    "F = T for speed > 0 and 0 for speed < 0 if T > 0; the other way round if T < 0; "
    "T tanh(|speed| / v_c) if it sets in gradually",
)
@pytest.mark.parametrize("torque", [0.04, -0.04])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_direction_friction(model_of: ModelOf, torque: float, sign: float) -> None:
    model = model_of("horn").with_effect("direction_friction", "a", {"torque": torque})
    loss = 0.04 / INERTIA if torque * sign > 0 else 0.0
    time = np.linspace(0.0, 0.2, 41)  # never at rest
    assert play(model, time, a_speed=sign)["a_speed"] == pytest.approx(sign * (1.0 - loss * time), abs=2e-3)


@checks("load_friction", "F = mu |motor torque - load torque| + nu |load torque|; torque = -F sign(speed)")
@checks(
    "directional_load_friction",
    "F = mu |motor torque - load torque| + nu |load torque|, mu = mu_1 where the motor is the stronger, "
    "else mu_2; torque = -F sign(speed)",
)
@pytest.mark.parametrize("speed", [3.0, -3.0])
@pytest.mark.parametrize("motor", [0.5, 0.1, -0.5])  # N m, beside 0.196 N m of the arm's weight
@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("load_friction", {"share": 0.3}),
        ("load_friction", {"share": 0.1, "bearings": 0.5}),
        ("directional_load_friction", {"driving": 0.1, "driven": 0.4}),
        ("directional_load_friction", {"driving": 0.2, "driven": 0.1, "bearings": 0.4}),
    ],
)
def test_friction_under_load(
    model_of: ModelOf, effect: str, values: dict[str, float], motor: float, speed: float
) -> None:
    """An arm with a weight, 20 ms under a constant torque of the motor."""
    model = model_of("arm").with_values({"drive.a.torque": abs(motor)}).with_effect(effect, "a", values)
    inertia = INERTIA + MASS * ARM**2

    def slope(state: np.ndarray) -> tuple[float, float]:
        angle, w = state
        load = MASS * G * ARM * math.cos(angle)
        mu = values.get("share", values.get("driving" if abs(motor) >= abs(load) else "driven", 0.0))
        friction = mu * abs(motor - load) + values.get("bearings", 0.0) * abs(load)
        return w, (motor + load - friction * np.sign(w)) / inertia

    time = np.linspace(0.0, 0.02, 11)
    expected = integrated(slope, [0.0, speed], time)[:, 1]
    assert play(model, time, math.copysign(3.0, motor), 5e-5, a_speed=speed)["a_speed"] == pytest.approx(
        expected, abs=0.01 * np.abs(expected - speed).max()
    )


@checks("constant_torque", "torque = T")
@pytest.mark.parametrize("torque", [0.05, -0.05])
def test_constant_torque(model_of: ModelOf, torque: float) -> None:
    model = model_of("horn").with_effect("constant_torque", "a", {"torque": torque})
    expected = 0.4 + torque / INERTIA * TIME
    assert play(model, TIME, a=2.0, a_speed=0.4)["a_speed"] == pytest.approx(expected, abs=1e-6)


@checks(
    "direction_viscous_friction",
    "torque = -B speed for speed > 0 and 0 for speed < 0 if B > 0; -|B| speed for speed < 0 if B < 0",
)
@pytest.mark.parametrize("damping", [0.1, -0.1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_direction_viscous_friction(model_of: ModelOf, damping: float, sign: float) -> None:
    model = model_of("horn").with_effect("direction_viscous_friction", "a", {"damping": damping})
    rate = 0.1 / INERTIA if damping * sign > 0 else 0.0
    assert play(model, TIME, a_speed=2 * sign)["a_speed"] == pytest.approx(2 * sign * np.exp(-rate * TIME), abs=2e-3)


LUGRE = "dz/dt = speed - |speed| z / z_s, z_s = b (1 + e exp(-(speed / v_s)^2)); torque = -F/b (z + 1 ms dz/dt)"


@checks("lugre_friction", LUGRE)
@pytest.mark.parametrize("extra", [0.0, 0.6])
@pytest.mark.parametrize("bend", [0.002, 0.03])
def test_lugre_friction(model_of: ModelOf, bend: float, extra: float) -> None:
    """A swing comes to rest on its bristles."""
    values = {"torque": 0.03, "bend": bend, "extra": extra, "speed": 0.2}
    model = model_of("swing").with_effect("lugre_friction", "a", values)

    def slope(state: np.ndarray) -> tuple[float, ...]:
        angle, w, z = state
        rate = w - abs(w) * z / (bend * (1 + extra * math.exp(-((w / 0.2) ** 2))))
        return w, (-SPRING * angle - 0.03 / bend * (z + 1e-3 * rate)) / INERTIA, rate

    time = np.linspace(0.0, 0.8, 81)
    expected = integrated(slope, [0.1, 0.0, 0.0], time)[:, 0]
    assert play(model, time, timestep=1e-4, a=0.1)["a"] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("bend", [0.03, 1e-4])
def test_lugre_friction_bends_and_slides_at_any_step(model_of: ModelOf, bend: float) -> None:
    """Drawn slowly, friction is F (1 - exp(-angle / b)) while it grows; drawn on, F. At MuJoCo steps of 10 ms."""
    model = model_of("horn").with_effect("lugre_friction", "a", {"torque": 0.3, "bend": bend, "extra": 0.0})
    slow = np.interp(np.arange(601), [0, 500, 600], [0.0, 0.03, 0.03])
    drawn = play(model, np.arange(601) * 0.01, slow[:, None], 0.01)["a"][-1]
    assert STIFF * (0.03 - drawn) == pytest.approx(-0.3 * math.expm1(-drawn / bend), rel=0.01)
    ramp = 0.5 * np.arange(301) * 0.01
    slides = play(model, np.arange(301) * 0.01, ramp[:, None], 0.01)["a_effort"][-1]
    assert slides == pytest.approx(0.3, abs=0.01)


def exact_stick_slip(target: np.ndarray, step: float, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """(T,) rad and N m of a servo of 200 N m/rad and 10 N m s/rad on a sledge that sticks and slides exactly."""
    h, angle, speed = step / 100, 0.0, 0.0
    angles, efforts = [0.0], [0.0]
    for goal in target[:-1]:
        for _ in range(100):
            pull = 200.0 * (goal - angle) - 10.0 * speed
            if speed == 0.0 and abs(pull) <= friction:
                continue
            along = np.sign(speed) or np.sign(pull)
            after = speed + h * (pull - friction * along) / SLEDGE
            after = 0.0 if after * along < 0.0 else after
            angle += h * 0.5 * (speed + after)
            speed = after
        angles.append(angle)
        efforts.append(200.0 * (goal - angle) - 10.0 * speed)
    return np.array(angles), np.array(efforts)


@pytest.mark.parametrize("step", [0.01, 0.001])
def test_position_and_effort_under_friction_are_those_of_an_exact_integrator(model_of: ModelOf, step: float) -> None:
    """To .01 % of the travel and .8 % of the effort; with MuJoCo's own time constant of friction the effort would be
    1.3 % off, and shorter steps would not help."""
    time = np.arange(0.0, 4.0, step)
    target = 0.05 * (1.0 - np.cos(np.pi * time))
    values = {"drive.a.stiffness": 200.0, "drive.a.damping": 10.0, "drive.a.torque": 10.0}
    model = model_of("sledge").with_values(values).with_effect("coulomb_friction", "a", {"torque": 0.2})
    found = play(model, time, target[:, None], 0.000125, a=0.0, a_speed=0.0)
    angle, effort = exact_stick_slip(target, step, 0.2)
    assert np.sqrt(np.mean((found["a"] - angle) ** 2)) < 1e-4 * np.ptp(angle)
    # The law at the sample itself: what is measured is the effort of MuJoCo's last step, under the same command.
    law = 200.0 * (np.roll(target, 1) - found["a"]) - 10.0 * found["a_speed"]
    assert np.sqrt(np.mean((law - effort)[1:] ** 2)) < 0.008 * np.sqrt(np.mean(effort**2))


# Loads and belts.


@checks("gravity_load", "torque = M g cos(angle), M = mass times distance, at 50 mm from the axis")
@pytest.mark.parametrize("moment", [0.02, -0.02])
@pytest.mark.parametrize("angle", [0.0, 0.8])
def test_gravity_load(model_of: ModelOf, moment: float, angle: float) -> None:
    model = model_of("beam").with_effect("gravity_load", "a", {"moment": moment})
    inertia = INERTIA + abs(moment) * 0.05
    expected = integrated(lambda s: (s[1], moment * G * math.cos(s[0]) / inertia), [angle, 0.0], TIME)
    assert play(model, TIME, a=angle)["a"] == pytest.approx(expected[:, 0], abs=2e-3)
    upright = model_of("horn").with_effect("gravity_load", "a", {"moment": moment})
    assert play(upright, TIME, a=angle)["a"] == pytest.approx(angle, abs=1e-9)


@checks("return_spring", "torque = -k angle")
def test_return_spring(model_of: ModelOf) -> None:
    model = model_of("horn").with_effect("return_spring", "a", {"stiffness": 2.0})
    assert play(model, TIME, a=0.1)["a"] == pytest.approx(0.1 * np.cos(math.sqrt(2.0 / INERTIA) * TIME), abs=2e-4)


def belt(torque: Callable[[float, float], float], on_load: Callable[..., float], start: float) -> np.ndarray:
    """(T, 4) motor, load and their speeds, the load first turned by `start`, the motor's drive off.

    Args:
        torque: of the belt, N m, from stretch, rad, and its rate.
        on_load: N m, from stretch, the load's angle and speed.
    """

    def slope(state: np.ndarray) -> tuple[float, ...]:
        motor, load, w_motor, w_load = state
        stretch = BELT_RATIO * motor - load
        pull = torque(stretch, BELT_RATIO * w_motor - w_load)
        on = on_load(stretch, load, w_load)
        return w_motor, w_load, -BELT_RATIO * pull / BELT_MOTOR, (pull + on) / INERTIA

    return integrated(slope, [0.0, start, 0.0, 0.0], TIME)


@pytest.mark.parametrize(
    ("stiffness", "expected_from"), [(0.0, lambda s, load, w: 0.0), (1.5, lambda s, load, w: -1.5 * load)]
)
def test_a_belt_and_a_return_spring_behind_it(
    model_of: ModelOf, stiffness: float, expected_from: Callable[..., float]
) -> None:
    model = model_of("belts").with_effect("return_spring", "a", {"stiffness": stiffness})
    expected = belt(lambda s, rate: BELT_K * s + BELT_D * rate, expected_from, 0.1)
    found = play(model, TIME, timestep=1e-4, a=0.0, a_load=0.1)
    assert found["a"] == pytest.approx(expected[:, 0], abs=3e-4)
    assert found["a_load"] == pytest.approx(expected[:, 1], abs=3e-4)


@checks("belt_compliance", "belt torque = s / (1/k + c) + d (h + (1 - h) / (1 + k c)) ds/dt, s = r motor - board")
@pytest.mark.parametrize("keep", [0.0, 0.3, 1.0])
def test_belt_compliance(model_of: ModelOf, keep: float) -> None:
    c = 0.8
    model = model_of("belts").with_effect("belt_compliance", "a", {"compliance": c, "damper": keep})
    damping = BELT_D * (keep + (1 - keep) / (1 + BELT_K * c))
    expected = belt(lambda s, rate: s / (1 / BELT_K + c) + damping * rate, lambda s, load, w: 0.0, 0.1)
    found = play(model, TIME, timestep=1e-4, a=0.0, a_load=0.1)
    assert found["a"] == pytest.approx(expected[:, 0], abs=3e-4)
    assert found["a_load"] == pytest.approx(expected[:, 1], abs=3e-4)


@checks(
    "backlash",
    "belt torque = k (s - clip(s, -w/2, w/2)) + d ds/dt where |s| > w/2, else 0, s = r motor - board; without "
    "a belt, angle' trails by at most w/2",
)
@pytest.mark.parametrize("hold", [1e-4, 5e-3])
def test_backlash_of_a_belt(model_of: ModelOf, hold: float) -> None:
    model = model_of("belts").with_effect("backlash", "a", {"width": 0.06, "hold": hold})

    def pull(s: float, rate: float) -> float:
        return BELT_K * (s - np.clip(s, -0.03, 0.03)) + BELT_D * rate if abs(s) > 0.03 else 0.0

    expected = belt(pull, lambda s, load, w: -hold * np.sign(w) if abs(s) < 0.03 else 0.0, 0.1)
    found = play(model, TIME, timestep=5e-5, a=0.0, a_load=0.1)
    assert found["a"] == pytest.approx(expected[:, 0], abs=5e-4)
    assert found["a_load"] == pytest.approx(expected[:, 1], abs=5e-4)


def test_backlash_without_a_belt(model_of: ModelOf) -> None:
    """On a swing the angle is a sine; what is seen stands still for the gap's width after each turn."""
    model = model_of("swing").with_effect("backlash", "a", {"width": 0.06})
    period = 2 * math.pi / math.sqrt(SPRING / INERTIA)
    time = np.linspace(0.0, 1.25 * period, 251)
    angle = 0.1 * np.cos(math.sqrt(SPRING / INERTIA) * time)
    falls, rises = time <= period / 2, (time > period / 2) & (time <= period)
    expected = np.where(falls, np.minimum(0.1, angle + 0.03), np.minimum(0.07, angle + 0.03))
    expected = np.where(rises, np.maximum(-0.07, angle - 0.03), expected)
    found = play(model, time, timestep=time[1] / 50, a=0.1)
    assert found["a"] == pytest.approx(expected, abs=3e-4)


# Sensors: a horn that nothing acts on turns at constant speed, a swing goes in sines.


@checks("sensor_bias", "angle' = angle + b")
def test_sensor_bias(model_of: ModelOf) -> None:
    model = model_of("horn").with_effect("sensor_bias", "a", {"bias": -0.03})
    assert play(model, TIME, a_speed=0.5)["a"] == pytest.approx(0.5 * TIME - 0.03, abs=1e-9)


@checks("sensor_gain", "angle' = g angle")
def test_sensor_gain(model_of: ModelOf) -> None:
    model = model_of("horn").with_effect("sensor_gain", "a", {"gain": 1.2})
    assert play(model, TIME, a_speed=0.5)["a"] == pytest.approx(1.2 * 0.5 * TIME, abs=1e-9)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("sensor_bias", {"bias": -0.03}),
        ("sensor_gain", {"gain": 1.2}),
        ("curve_sensor", {**{f"k{i + 1}": 0.02 * i - 0.09 for i in range(10)}, "centre": 0.4, "half": 0.9}),
    ],
)
def test_a_roll_out_starts_where_its_sensor_shows_it(model_of: ModelOf, effect: str, values: dict[str, float]) -> None:
    model = model_of("horn").with_effect(effect, "a", values)
    assert play(model, TIME, a=0.3)["a"] == pytest.approx(0.3, abs=1e-6)


@checks("sensor_delay", "angle'(t) = angle(t - T)")
@pytest.mark.parametrize("delay", [0.003, 0.0085, 0.02])
def test_sensor_delay(model_of: ModelOf, delay: float) -> None:
    late = np.maximum(TIME - delay, 0.0)
    model = model_of("swing").with_effect("sensor_delay", "a", {"delay": delay})
    found = play(model, TIME, a=0.1)["a"]
    assert found == pytest.approx(0.1 * np.cos(math.sqrt(SPRING / INERTIA) * late), abs=3e-4)


@checks(
    "sensor_lag",
    "tau d(angle')/dt + angle' = angle; in place of the share m of it the mean of angle over the last 2 tau",
)
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("tau", [0.002, 0.008, 0.05])
def test_sensor_lag(model_of: ModelOf, tau: float, share: float) -> None:
    values = {"time_constant": tau, "averaged": share}
    turning = play(model_of("horn").with_effect("sensor_lag", "a", values), TIME, a_speed=0.5)["a"]
    late, inside = TIME - tau * -np.expm1(-TIME / tau), np.minimum(TIME, 2 * tau)  # a mean begins where the axis does
    assert turning == pytest.approx(
        0.5 * ((1 - share) * late + share * inside * (TIME - inside / 2) / (2 * tau)), abs=1e-9
    )
    w = math.sqrt(SPRING / INERTIA)
    swinging = play(model_of("swing").with_effect("sensor_lag", "a", values), TIME, a=0.1)["a"]
    steady = (np.cos(w * TIME) + w * tau * np.sin(w * TIME)) / (1 + (w * tau) ** 2)
    first = steady + (1.0 - 1.0 / (1 + (w * tau) ** 2)) * np.exp(-TIME / tau)
    mean = (2 * tau - inside + (np.sin(w * TIME) - np.sin(w * (TIME - inside))) / w) / (2 * tau)
    assert swinging == pytest.approx(0.1 * ((1 - share) * first + share * mean), abs=3e-4)


@checks("sensor_quantisation", "angle' = E[q round((angle + noise) / q - c)]")
@pytest.mark.parametrize(("noise", "cut"), [(0.0, 0.0), (0.001, 0.0), (0.009, 0.0), (0.0, 0.5), (0.004, 0.5)])
def test_sensor_quantisation(model_of: ModelOf, noise: float, cut: float) -> None:
    tick = 0.02
    model = model_of("horn").with_effect("sensor_quantisation", "a", {"tick": tick, "noise": noise, "cut": cut})
    angle = 0.001 + 0.5 * TIME - 0.05

    def mean(value: float) -> float:
        if noise == 0.0:
            return tick * math.floor(value / tick + 0.5)
        below = [0.5 * (1 + math.erf(((n + 0.5) * tick - value) / noise / math.sqrt(2))) for n in range(-20, 21)]
        return tick * float(np.sum(np.arange(-19, 21) * np.diff(below)))

    expected = [mean(value - cut * tick) for value in angle]
    assert play(model, TIME, a=angle[0], a_speed=0.5)["a"] == pytest.approx(expected, abs=1e-3 * tick)


@pytest.mark.parametrize(("package", "symbol"), [(labyrinth_sim.effects, "EFFECT"), (labyrinth_sim.drives, "DRIVE")])
def test_each_is_checked_and_its_equation_is_the_one_that_was_checked(package: object, symbol: str) -> None:
    names = [f"{package.__name__}.{info.name}" for info in pkgutil.iter_modules(package.__path__)]
    stated = {item.name: item.equation for item in (getattr(importlib.import_module(n), symbol) for n in names)}
    unchecked = sorted(set(stated) - set(CHECKED))
    assert not unchecked, f"Write a test under @checks(...) for each of {unchecked}."
    changed = {name: equation for name, equation in stated.items() if set(CHECKED[name]) != {equation}}
    assert not changed, f"These equations are not those that their tests check: {changed}."
