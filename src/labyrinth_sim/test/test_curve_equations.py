# SPDX-License-Identifier: Apache-2.0
"""Free curves against the equations that their files state, by tables whose cubic is a line."""

from collections.abc import Callable

import numpy as np
import pytest
from small_rigs import BELT_MOTOR, BELT_RATIO, DRIVES, INERTIA, OFF, SPRING, checks, integrated, play

from labyrinth_sim.curve import curve, over_speed, speed_knots, speed_share
from labyrinth_sim.model import Model

STIFF = DRIVES["torque_pd"]["stiffness"]
TIME = np.linspace(0.0, 0.3, 61)
ModelOf = Callable[..., Model]

LINE = {f"k{i + 1}": 0.09 * (2.0 * i / 9.0 - 1.0) for i in range(10)}  # from -0.09 to 0.09
LEVEL = {f"k{i + 1}": 0.05 for i in range(10)}
ROOT = np.linspace(-1.0, 1.0, 20001)
CENTRED = ", F through 10 values over centre +- half"
INNER = 7.0 / 9.0  # of the range about its middle, where the curve is the line


def test_a_curve_goes_through_its_values_and_halfway_by_keys_weights() -> None:
    rng = np.random.default_rng(4)
    table = rng.normal(size=(3, 10))
    values = {f"k{i + 1}": table[:, i] for i in range(10)}
    shares = np.tile(np.arange(10) / 9.0, (3, 1))
    assert curve(values, shares) == pytest.approx(table)
    halfway = curve(values, np.tile((np.arange(1, 8) + 0.5) / 9.0, (3, 1)))
    assert halfway == pytest.approx((9 * (table[:, 1:8] + table[:, 2:9]) - table[:, :7] - table[:, 3:]) / 16)
    places = np.linspace(0.0, 1.0, 37)
    parabola = {f"k{i + 1}": np.full(1, 0.3 - (i / 9.0 - 0.4) ** 2) for i in range(10)}
    assert curve(parabola, places[None])[0] == pytest.approx(0.3 - (places - 0.4) ** 2)
    assert curve(values, np.full(3, 1.7)) == pytest.approx(table[:, -1])
    assert curve(values, np.full(3, -2.0)) == pytest.approx(table[:, 0])


@checks("curve_angle", "torque = F(angle)" + CENTRED)
def test_curve_angle(model_of: ModelOf) -> None:
    """On the inner part of the range a line is a spring about the centre."""
    model = model_of("horn").with_effect("curve_angle", "a", {**LINE, "centre": 1.0, "half": 0.5})
    expected = integrated(lambda s: (s[1], 0.18 * (s[0] - 1.0) / INERTIA), [1.1, -0.4], TIME)[:, 0]
    assert np.ptp(expected) > 0.05 and np.abs(expected - 1.0).max() < 0.5 * INNER
    assert play(model, TIME, a=1.1, a_speed=-0.4)["a"] == pytest.approx(expected, abs=1e-4)
    beyond = play(model, TIME, a=2.0)["a_speed"]
    assert beyond == pytest.approx(0.09 / INERTIA * TIME, abs=1e-6)


@checks("curve_speed", "torque = F(speed), F through 10 values over -most to most")
@pytest.mark.parametrize("timestep", [None, 0.005])
def test_curve_speed(model_of: ModelOf, timestep: float | None) -> None:
    """A table of friction in proportion to the speed is viscous friction, from zero to the fastest."""
    table = dict(zip(LINE, (-0.1 * speed_knots(4.0)).tolist(), strict=True))
    model = model_of("horn").with_effect("curve_speed", "a", {**table, "most": 4.0})
    expected = 3.9 * np.exp(-0.1 / INERTIA * TIME)
    assert expected[-1] < 0.2
    close = {"abs": 1e-2} if timestep is None else {"abs": 5e-2}
    assert play(model, TIME, timestep=timestep, a_speed=3.9)["a_speed"] == pytest.approx(expected, **close)


def test_a_curve_over_speed_is_read_as_it_is_simulated() -> None:
    rng = np.random.default_rng(3)
    table, speeds = rng.normal(size=10), np.linspace(-2.17, 2.17, 45)
    values = {f"k{i + 1}": table[[i]] for i in range(10)}
    read = curve(values, speed_share(speeds[None], {"most": np.array([2.0])}))[0]
    simulated = np.array([over_speed(np.append(table, 2.0), speed) for speed in speeds])
    assert simulated[:, 0] == pytest.approx(read, abs=1e-12)
    assert curve(values, speed_share(speed_knots(2.0)[None], {"most": np.array([2.0])}))[0] == pytest.approx(table)
    ahead = np.array([over_speed(np.append(table, 2.0), speed + 1e-7)[0] for speed in speeds])
    assert simulated[1:-1, 1] == pytest.approx((ahead - simulated[:, 0])[1:-1] / 1e-7, rel=1e-3, abs=1e-3)


@checks("curve_time", "torque = F(time), F through 10 values over 0 to end")
def test_curve_time(model_of: ModelOf) -> None:
    model = model_of("horn").with_effect("curve_time", "a", {**LINE, "end": 0.27})
    inner = (TIME > 0.035) & (TIME < 0.235)
    gained = np.diff(play(model, TIME)["a_speed"][inner])
    middle = 0.5 * (TIME[inner][1:] + TIME[inner][:-1])
    assert gained == pytest.approx(0.005 * 0.09 * (middle / 0.135 - 1.0) / INERTIA, abs=2e-4)


@checks("curve_reversal", "torque = -F(time since reversal) sign(last speed), F through 10 values over 0 to end")
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_curve_reversal(model_of: ModelOf, sign: float) -> None:
    """A swing loses the work of 0.05 N m along its way until it reverses, and again on its way back."""
    model = model_of("swing").with_effect("curve_reversal", "a", {**LEVEL, "end": 0.1})
    swings = sign * play(model, np.linspace(0.0, 0.6, 1201), timestep=1e-4, a=sign * 0.5)["a"]
    assert swings.min() == pytest.approx(-0.5 + 2 * 0.05 / SPRING, abs=2e-3)
    rises = {**dict.fromkeys(LINE, 0.0), "k10": 0.05}
    late = play(model_of("horn").with_effect("curve_reversal", "a", {**rises, "end": 0.1}), TIME, a_speed=sign)
    assert late["a_speed"][TIME < 0.085] == pytest.approx(sign, abs=0.03)
    slows = np.diff(sign * late["a_speed"][(TIME > 0.105) & (TIME < 0.28)])
    assert slows == pytest.approx(-0.005 * 0.05 / INERTIA, abs=1e-5)


@checks("curve_other", "torque = F(other angle)" + CENTRED)
def test_curve_other(model_of: ModelOf) -> None:
    model = model_of("belts").with_effect("curve_other", "a", {**LINE, "centre": 0.0, "half": 1.0})
    rest = {name: signal[-1] for name, signal in play(model, np.linspace(0, 10, 501), [0.1, 0.5], 0.002).items()}
    # The drive and the belt hold the motor; the belt's load hangs free, so the drive alone carries the torque.
    assert STIFF * (rest["a"] - 0.1) == pytest.approx(0.09 * rest["b"], abs=1e-4)
    assert rest["b"] == pytest.approx(0.5, abs=1e-3)


@checks("curve_sensor", "angle' = angle + F(angle)" + CENTRED)
def test_curve_sensor(model_of: ModelOf) -> None:
    model = model_of("horn").with_effect("curve_sensor", "a", {**LINE, "centre": 0.4, "half": 0.9})
    seen = play(model, TIME, a_speed=0.5)["a"]  # of a joint that starts at zero
    assert seen == pytest.approx(0.5 * TIME + 0.1 * (0.5 * TIME - 0.4), abs=1e-6)


@checks("curve_sensor_other", "angle' = angle + F(other angle)" + CENTRED)
def test_curve_sensor_other(model_of: ModelOf) -> None:
    """Joints that start at zero, of which the other one moves; the drives are off."""
    model = model_of("pair").with_effect("curve_sensor_other", "a", {**LINE, "centre": 0.4, "half": 0.9})
    seen = play(model, TIME, b_speed=0.5)
    assert seen["b"] == pytest.approx(0.5 * TIME, abs=1e-6)
    assert seen["a"] == pytest.approx(0.1 * (0.5 * TIME - 0.4), abs=1e-6)


@checks("curve_sensor_speed", "angle' = angle + F(speed), F through 10 values over -most to most")
def test_curve_sensor_speed(model_of: ModelOf) -> None:
    """A line over the root of (almost) the speed, which is how its knots lie."""
    model = model_of("horn").with_effect("curve_sensor_speed", "a", {**LINE, "most": 4.0})
    for speed in (0.02, -0.7):
        seen = play(model, TIME, a_speed=speed)["a"]
        off = float(np.interp(speed, 4.0 * ROOT * (50.0 * np.abs(ROOT) + 1.0) / 51.0, 0.09 * ROOT))
        assert seen[0] == pytest.approx(0.0, abs=1e-9)  # at rest before the first sample, as far as it knows
        assert seen[1:] == pytest.approx(speed * TIME[1:] + off, abs=1e-4)


@checks("curve_angle_friction", "torque = -max(F(angle), 0) sign(speed)" + CENTRED)
@checks("curve_time_friction", "torque = -max(F(time), 0) sign(speed), F through 10 values over 0 to end")
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("effect", "given", "line"),
    [
        ("curve_angle_friction", {"centre": 1.0, "half": 1.0}, lambda time, angle: 0.09 * (angle - 1.0)),
        ("curve_time_friction", {"end": 0.2}, lambda time, angle: 0.09 * (time / 0.1 - 1.0)),
    ],
)
def test_friction_curves(
    model_of: ModelOf, effect: str, given: dict[str, float], line: Callable[[float, float], float], sign: float
) -> None:
    """Where the line is below zero there is no friction."""
    bare = model_of("horn").with_effect(effect, "a", given)
    model = with_line(bare, effect)
    time = np.linspace(0.0, 0.15, 151)

    def slope(state: np.ndarray) -> tuple[float, float, float]:
        now, angle, w = state
        return 1.0, w, -sign * max(line(now, angle), 0.0) / INERTIA

    expected = integrated(slope, [0.0, 1.0 - 0.3 * sign, sign * 4.0], time)[:, 2]
    assert np.abs(expected - sign * 4.0).max() > 0.1
    slowed = play(model, time, timestep=1e-4, a=1.0 - 0.3 * sign, a_speed=sign * 4.0)["a_speed"]
    assert slowed == pytest.approx(expected, abs=0.01)


@checks(
    "curve_load_friction",
    "torque = -max(F(|motor torque - load torque|), 0) sign(speed), F through 10 values over 0 to most",
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_curve_load_friction(model_of: ModelOf, sign: float) -> None:
    """A motor that gives 0.5 N m and nothing besides."""
    model = model_of("horn").with_values({"drive.a.torque": 0.5}).with_effect("curve_load_friction", "a", {"most": 0.6})
    speed = play(with_line(model, "curve_load_friction"), TIME, sign * 50.0, a_speed=sign)["a_speed"]
    expected = sign * (1.0 + (0.5 - 0.09 * (0.5 / 0.3 - 1.0)) / INERTIA * TIME)
    assert speed == pytest.approx(expected, abs=0.02)


@checks("curve_other_friction", "torque = -max(F(other angle), 0) sign(speed)" + CENTRED)
@pytest.mark.parametrize("other", [0.7, -0.5])
def test_curve_other_friction(model_of: ModelOf, other: float) -> None:
    """At first the belt pulls a motor the same with friction and without."""
    bare = model_of("belts")
    model = bare.with_effect("curve_other_friction", "a", {"centre": 0.3, "half": 1.0})
    model = with_line(model, "curve_other_friction")
    time = np.linspace(0.0, 0.01, 11)
    start = {"a_speed": 6.0, "b": other, "b_load": BELT_RATIO * other}
    ways = [play(m, time, OFF, 1e-4, **start)["a_speed"] for m in (bare, model)]
    expected = max(0.09 * (other - 0.3), 0.0) / BELT_MOTOR * time
    assert ways[0] - ways[1] == pytest.approx(expected, rel=0.02, abs=1e-4)


def with_line(model: Model, effect: str) -> Model:
    return model.with_values({f"{effect}.a.{name}": max(value, 0.0) for name, value in LINE.items()})
